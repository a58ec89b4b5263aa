//! Why there is no estimate.

use super::segments::MIN_SAMPLES;
use super::settings::{SettingsError, Stimulus};
use crate::ctl::Stopped;

/// Why there is no estimate. Trials and segments count from 0 here, and from 1 in the texts.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FrequencyError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// A setting cannot be.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// There is no trial.
    #[error("there is no trial")]
    NoTrial,
    /// Trials with different sample times are not averaged.
    #[error(
        "trial {} has a sample time of {sample_time_s} s, trial 1 of {first_s} s; only trials with equal sample times \
         are combined",
        .trial + 1
    )]
    SampleTimesDiffer {
        /// The trial.
        trial: usize,
        /// Its sample time.
        sample_time_s: f64,
        /// That of the first trial.
        first_s: f64,
    },
    /// Lines that a sampled signal does not have.
    #[error(
        "the line {frequency_hz} Hz is at or above the Nyquist frequency, {nyquist_hz} Hz at the sample time of \
         {sample_time_s} s"
    )]
    LineAboveNyquist {
        /// Position of the line.
        line: usize,
        /// The line.
        frequency_hz: f64,
        /// Half the sampling rate.
        nyquist_hz: f64,
        /// The sample time.
        sample_time_s: f64,
    },
    /// Lines that the window does not tell apart.
    #[error(
        "the lines {below_hz} Hz and {frequency_hz} Hz are nearer than {least_hz} Hz, which is what a segment of \
         {length_s} s with this window tells apart: each would be made of both"
    )]
    LinesTooClose {
        /// Position of the upper line.
        line: usize,
        /// Whether the lines were named in the settings.
        named: bool,
        /// The lower line.
        below_hz: f64,
        /// The upper line.
        frequency_hz: f64,
        /// The least distance.
        least_hz: f64,
        /// Length of the shortest segment.
        length_s: f64,
        /// Whether another window would tell them apart.
        windowed: bool,
    },
    /// A segment that the record does not hold.
    #[error(
        "segment {} runs from {start_s} s to {end_s} s, and the record of trial {} ends at {record_s} s",
        .segment + 1, .trial + 1
    )]
    SegmentOutside {
        /// The trial.
        trial: usize,
        /// The segment.
        segment: usize,
        /// Its start.
        start_s: f64,
        /// Its end.
        end_s: f64,
        /// Number of samples times the sample time.
        record_s: f64,
    },
    /// A segment of hardly any samples.
    #[error(
        "segment {} of trial {} has {samples} samples, and needs at least {MIN_SAMPLES}",
        .segment + 1, .trial + 1
    )]
    SegmentTooShort {
        /// The trial.
        trial: usize,
        /// The segment.
        segment: usize,
        /// Its samples.
        samples: usize,
    },
    /// Excited lines are lines of one grid, which segments of different lengths do not have.
    #[error(
        "segment {} of trial {} has {samples} samples, the first segment {first}; excited lines are looked for on one \
         grid",
        .segment + 1, .trial + 1
    )]
    UnequalSegments {
        /// The trial.
        trial: usize,
        /// The segment.
        segment: usize,
        /// Its samples.
        samples: usize,
        /// Samples of the first segment.
        first: usize,
    },
    /// The disturbance is the input, and was not recorded.
    #[error("trial {} has no disturbance column", .trial + 1)]
    NoDisturbance {
        /// The trial.
        trial: usize,
    },
    /// The input has no power at any line.
    #[error("{}", no_power_text(*.trial, *.input, *.other_has_power))]
    NoPower {
        /// The trial.
        trial: usize,
        /// The input.
        input: Stimulus,
        /// Whether the other stimulus was recorded and moves.
        other_has_power: bool,
    },
    /// No line of the grid is excited (within the band).
    #[error("the {} excites no line{}", name(*.input), band_text(*.band_hz))]
    NothingExcited {
        /// The input.
        input: Stimulus,
        /// The band.
        band_hz: Option<[f64; 2]>,
    },
}

pub(super) fn name(stimulus: Stimulus) -> &'static str {
    match stimulus {
        Stimulus::Command => "command",
        Stimulus::Disturbance => "disturbance",
    }
}

pub(super) fn other(stimulus: Stimulus) -> Stimulus {
    match stimulus {
        Stimulus::Command => Stimulus::Disturbance,
        Stimulus::Disturbance => Stimulus::Command,
    }
}

fn no_power_text(trial: usize, input: Stimulus, other_has_power: bool) -> String {
    let (input, other) = (name(input), name(other(input)));
    let which = trial + 1;
    let end = if other_has_power {
        format!("; its {other} does, so this trial informs only the response to the {other}")
    } else {
        String::new()
    };
    format!(
        "the {input} of trial {which} carries no power at any of the lines, so the response to it cannot be \
         identified{end}"
    )
}

fn band_text(band_hz: Option<[f64; 2]>) -> String {
    band_hz.map_or_else(String::new, |[low, high]| format!(" from {low} to {high} Hz"))
}
