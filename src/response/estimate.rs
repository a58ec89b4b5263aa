//! The estimate: segments transformed at the lines, and averaged.

use super::FrequencyData;
use super::error::{FrequencyError, other};
use super::excited::{excited_lines, strongest};
use super::segments::{self, Segment};
use super::settings::{Channels, CheckedSettings, EndSample, FrequencySettings, Response, Stimulus};
use super::spectrum::{direct_transform, grid_transform, line_power, prepare};
use super::variance::{average, coherence, dark_lines, noise_power};
use super::warnings::{EstimateWarning, is_periodic};
use crate::ctl::Ctl;
use crate::trial::Trial;
use num_complex::Complex64;
use rayon::prelude::*;
use std::borrow::Cow;
use std::f64::consts::PI;

/// Trials count as equally sampled up to this relative difference of their sample times: what rounding of printed time
/// columns leaves.
const SAMPLE_TIME_TOLERANCE: f64 = 1e-6;

/// A line counts as on the grid up to this fraction of the grid's step.
pub(super) const GRID_TOLERANCE: f64 = 1e-3;

/// An amplitude below this fraction of the signal's largest value is the rounding of the transform, not a signal.
const ZERO_AMPLITUDE: f64 = 1e-10;

/// A segment that went into an estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UsedSegment {
    /// The trial, from 0.
    pub trial: usize,
    /// Its first sample, in seconds from the trial's first.
    pub start_s: f64,
    /// Its length in seconds: the period of its grid.
    pub length_s: f64,
    /// The samples that were summed.
    pub samples: usize,
}

/// Where variances come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VarianceSource {
    /// The scatter of the segments.
    Repetition,
    /// The output's power on nearby lines without a stimulus.
    NearbyLines,
}

/// A closed-loop frequency response with all that belongs to it; arrays are equally long, in increasing frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Frequencies in Hz.
    pub frequency_hz: Vec<f64>,
    /// Angular frequencies in rad/s.
    pub omega_rad_s: Vec<f64>,
    /// The response; `None` where the input has no power at all (to rounding).
    pub h: Vec<Option<Complex64>>,
    /// `E|H − E H|²`, where it is known.
    pub variance: Vec<Option<f64>>,
    /// Where the variances come from; `None` if none is known.
    pub variance_source: Option<VarianceSource>,
    /// Mean square of the input's sinusoid on each line, averaged over segments, in squared units of the input.
    pub input_power: Vec<f64>,
    /// The same of the segment in which it is weakest.
    pub input_power_minimum: Vec<f64>,
    /// `|Σ R̄Y|²/(Σ|R|² Σ|Y|²)` over segments; `None` of a single one.
    pub coherence: Vec<Option<f64>>,
    /// Segments averaged on each line.
    pub averages: Vec<usize>,
    /// The segments.
    pub segments: Vec<UsedSegment>,
    /// Step of the grid of the shortest segment, in Hz.
    pub resolution_hz: f64,
    /// Equivalent noise bandwidth of the window on that grid, in Hz.
    pub noise_bandwidth_hz: f64,
    /// What must be read before using it.
    pub warnings: Vec<EstimateWarning>,
}

impl Estimate {
    /// The data as identification takes them; lines without a response are left out (a warning names them).
    #[must_use]
    pub fn data(&self) -> FrequencyData {
        let known: Vec<usize> = (0..self.h.len()).filter(|i| self.h[*i].is_some()).collect();
        FrequencyData {
            omega_rad_s: known.iter().map(|i| self.omega_rad_s[*i]).collect(),
            h: known.iter().filter_map(|i| self.h[*i]).collect(),
            variance: known.iter().map(|i| self.variance[*i]).collect(),
        }
    }
}

/// The response from command to output; see the module's description for the formulas.
///
/// # Errors
/// [`FrequencyError`].
pub fn estimate(trials: &[&Trial], settings: &FrequencySettings) -> Result<Estimate, FrequencyError> {
    estimate_between(trials, &settings.check()?, Channels::default(), &Ctl::new())
}

/// The response between two signals. `ctl` counts segments.
///
/// # Errors
/// [`FrequencyError`]; [`FrequencyError::Stopped`] soon after `ctl` says so.
pub fn estimate_between(
    trials: &[&Trial],
    settings: &CheckedSettings,
    channels: Channels,
    ctl: &Ctl,
) -> Result<Estimate, FrequencyError> {
    let job = Job::new(trials, settings, channels)?;
    let frequency_hz = match &settings.frequency_hz {
        Some(named) => named.clone(),
        None => job.excited(ctl)?,
    };
    for trial in trials {
        let nyquist_hz = 0.5 / trial.sample_time_s;
        // A line printed as half a rounded sampling rate is the Nyquist line.
        let above = frequency_hz.iter().position(|line| *line >= nyquist_hz * (1.0 - 1e-9));
        if let Some(line) = above {
            return Err(FrequencyError::LineAboveNyquist {
                line,
                frequency_hz: frequency_hz[line],
                nyquist_hz,
                sample_time_s: trial.sample_time_s,
            });
        }
    }
    ctl.set_total(job.pieces.len() as u64);
    let transformed: Vec<Transformed> = job
        .pieces
        .par_iter()
        .map(|piece| {
            let transformed = job.transform(piece, &frequency_hz, ctl)?;
            ctl.advance(1);
            Ok(transformed)
        })
        .collect::<Result<_, FrequencyError>>()?;
    for trial in 0..trials.len() {
        let powerless = |(piece, transformed): (&Piece, &Transformed)| {
            piece.trial != trial || transformed.pairs.iter().all(Option::is_none)
        };
        if job.pieces.iter().zip(&transformed).all(powerless) {
            return Err(job.no_power(trial));
        }
    }
    Ok(job.assemble(frequency_hz, &transformed))
}

/// A segment of a trial.
pub(super) struct Piece {
    pub trial: usize,
    pub segment: Segment,
}

/// A segment at the lines.
pub(super) struct Transformed {
    /// `(R, Y)`; `None` where the input has no power.
    pub pairs: Vec<Option<(Complex64, Complex64)>>,
    /// Input power at the lines, and of its strongest line.
    pub power: Vec<f64>,
    pub strongest: f64,
    /// Lines on which the other stimulus has power too.
    pub shared: Vec<bool>,
    pub periodic: bool,
    /// `S/|R|²` at the lines, for a single segment.
    nearby_variance: Vec<Option<f64>>,
}

pub(super) struct Job<'a> {
    pub trials: &'a [&'a Trial],
    pub settings: &'a CheckedSettings,
    pub channels: Channels,
    pub pieces: Vec<Piece>,
    /// Samples at the end of trials that are in no segment, the largest number.
    pub unused: usize,
}

impl<'a> Job<'a> {
    fn new(trials: &'a [&'a Trial], settings: &'a CheckedSettings, channels: Channels) -> Result<Self, FrequencyError> {
        let first_s = trials.first().ok_or(FrequencyError::NoTrial)?.sample_time_s;
        let mut job = Self { trials, settings, channels, pieces: Vec::new(), unused: 0 };
        for (index, trial) in trials.iter().enumerate() {
            if (trial.sample_time_s - first_s).abs() > SAMPLE_TIME_TOLERANCE * first_s {
                let sample_time_s = trial.sample_time_s;
                return Err(FrequencyError::SampleTimesDiffer { trial: index, sample_time_s, first_s });
            }
            if channels.input == Stimulus::Disturbance && trial.signals.disturbance.is_none() {
                return Err(FrequencyError::NoDisturbance { trial: index });
            }
            let (segments, unused) = segments::place(index, trial, settings)?;
            job.pieces.extend(segments.into_iter().map(|segment| Piece { trial: index, segment }));
            job.unused = job.unused.max(unused);
        }
        Ok(job)
    }

    fn stimulus(&self, trial: usize, stimulus: Stimulus) -> Option<&'a [f64]> {
        match stimulus {
            Stimulus::Command => Some(&self.trials[trial].signals.command),
            Stimulus::Disturbance => self.trials[trial].signals.disturbance.as_deref(),
        }
    }

    /// The input's column, which `new` made sure of.
    fn input(&self, trial: usize) -> &'a [f64] {
        self.stimulus(trial, self.channels.input).unwrap_or_default()
    }

    fn output(&self, trial: usize) -> Cow<'a, [f64]> {
        let trial = self.trials[trial];
        match self.channels.output {
            Response::Output => Cow::Borrowed(&trial.signals.output),
            Response::Control => Cow::Borrowed(&trial.signals.control),
            Response::Error => Cow::Owned(trial.error()),
        }
    }

    fn cut(&self, column: &[f64], segment: &Segment) -> Vec<f64> {
        let settings = self.settings.settings();
        prepare(&column[segment.start..segment.start + segment.samples], settings.detrend, settings.window)
    }

    fn window_sum(&self, samples: usize) -> f64 {
        let window = self.settings.settings().window;
        (0..samples).map(|i| window.value(i, samples)).sum()
    }

    /// Power of a column on the grid of a segment.
    fn grid_power(&self, column: &[f64], segment: &Segment) -> Vec<f64> {
        let sum = self.window_sum(segment.samples);
        let grid = grid_transform(&self.cut(column, segment));
        grid.iter().enumerate().map(|(k, x)| line_power(*x, sum, k == 0)).collect()
    }

    fn no_power(&self, trial: usize) -> FrequencyError {
        let input = self.channels.input;
        let moves = |column: &[f64]| column.iter().any(|x| *x != column[0]);
        let other_has_power = self.stimulus(trial, other(input)).is_some_and(moves);
        FrequencyError::NoPower { trial, input, other_has_power }
    }

    /// The excited lines of the common grid, in Hz.
    fn excited(&self, ctl: &Ctl) -> Result<Vec<f64>, FrequencyError> {
        let first = self.pieces[0].segment;
        if let Some(piece) = self.pieces.iter().find(|piece| piece.segment.samples != first.samples) {
            return Err(FrequencyError::UnequalSegments {
                trial: piece.trial,
                segment: piece.segment.number,
                samples: piece.segment.samples,
                first: first.samples,
            });
        }
        let mut mean = vec![0.0; first.samples / 2 + 1];
        let mut has_power = vec![false; self.trials.len()];
        for piece in &self.pieces {
            ctl.check()?;
            let column = self.input(piece.trial);
            let power = self.grid_power(column, &piece.segment);
            let floor = 2.0 * (ZERO_AMPLITUDE * largest(column, &piece.segment)).powi(2);
            has_power[piece.trial] |= strongest(&power) > floor;
            for (sum, power) in mean.iter_mut().zip(&power) {
                *sum += power / self.pieces.len() as f64;
            }
        }
        if let Some(trial) = has_power.iter().position(|has| !has) {
            return Err(self.no_power(trial));
        }
        let settings = self.settings.settings();
        let step_hz = 1.0 / (first.samples as f64 * self.trials[0].sample_time_s);
        let [low, high] = settings.band_hz.unwrap_or([0.0, f64::INFINITY]);
        // Band edges are meant to hold the lines that they name.
        let slack = GRID_TOLERANCE * step_hz;
        let lines: Vec<f64> = excited_lines(&mean, first.samples, settings)
            .into_iter()
            .map(|k| k as f64 * step_hz)
            .filter(|f| *f >= low - slack && *f <= high + slack)
            .collect();
        if lines.is_empty() {
            return Err(FrequencyError::NothingExcited { input: self.channels.input, band_hz: settings.band_hz });
        }
        Ok(lines)
    }

    fn transform(&self, piece: &Piece, frequency_hz: &[f64], ctl: &Ctl) -> Result<Transformed, FrequencyError> {
        let segment = &piece.segment;
        let dt = self.trials[piece.trial].sample_time_s;
        let column = self.input(piece.trial);
        let other = self.stimulus(piece.trial, other(self.channels.input));
        let input = self.cut(column, segment);
        let output = self.cut(&self.output(piece.trial), segment);
        let beside = other.map(|other| self.cut(other, segment)).unwrap_or_default();
        let window_sum = self.window_sum(segment.samples);
        let zero = ZERO_AMPLITUDE * window_sum * largest(column, segment);
        let power = self.grid_power(column, segment);
        let beside_power = other.map(|other| self.grid_power(other, segment)).unwrap_or_default();
        let threshold = self.settings.settings().power_threshold * strongest(&beside_power);

        let mut pairs = Vec::with_capacity(frequency_hz.len());
        let mut line_powers = Vec::with_capacity(frequency_hz.len());
        let mut shared = Vec::with_capacity(frequency_hz.len());
        for frequency in frequency_hz {
            ctl.check()?;
            let x = direct_transform(&[&input, &output, &beside], frequency * dt);
            pairs.push((x[0].norm() > zero).then_some((x[0], x[1])));
            line_powers.push(line_power(x[0], window_sum, *frequency == 0.0));
            shared.push(threshold > 0.0 && line_power(x[2], window_sum, *frequency == 0.0) >= threshold);
        }
        let nearby_variance = if self.pieces.len() == 1 {
            let stimuli = if beside_power.is_empty() { vec![power.clone()] } else { vec![power.clone(), beside_power] };
            self.nearby_variance(segment, dt, frequency_hz, &pairs, &output, &stimuli)
        } else {
            Vec::new()
        };
        Ok(Transformed {
            pairs,
            power: line_powers,
            strongest: strongest(&power),
            shared,
            periodic: is_periodic(column, segment),
            nearby_variance,
        })
    }

    fn nearby_variance(
        &self,
        segment: &Segment,
        dt: f64,
        frequency_hz: &[f64],
        pairs: &[Option<(Complex64, Complex64)>],
        output: &[f64],
        stimuli_power: &[Vec<f64>],
    ) -> Vec<Option<f64>> {
        if self.settings.end_sample == EndSample::Included {
            return vec![None; frequency_hz.len()];
        }
        let dark = dark_lines(stimuli_power, self.settings.settings().window);
        let grid = grid_transform(output);
        let at = |(frequency, pair): (&f64, &Option<(Complex64, Complex64)>)| {
            let (r, _) = pair.as_ref()?;
            let line = on_grid(*frequency, segment.period as f64 * dt)?;
            Some(noise_power(&grid, &dark, line)? / r.norm_sqr())
        };
        frequency_hz.iter().zip(pairs).map(at).collect()
    }

    fn assemble(&self, frequency_hz: Vec<f64>, transformed: &[Transformed]) -> Estimate {
        let how = self.settings.settings().average;
        let lines = frequency_hz.len();
        let count = transformed.len() as f64;
        let mut h = Vec::with_capacity(lines);
        let mut variance = Vec::with_capacity(lines);
        let mut coherences = Vec::with_capacity(lines);
        let mut averages = Vec::with_capacity(lines);
        let mut input_power = Vec::with_capacity(lines);
        let mut input_power_minimum = Vec::with_capacity(lines);
        for line in 0..lines {
            let pairs: Vec<(Complex64, Complex64)> = transformed.iter().filter_map(|t| t.pairs[line]).collect();
            let averaged = average(&pairs, how);
            let nearby = transformed[0].nearby_variance.get(line).copied().flatten();
            h.push(averaged.map(|(h, _)| h));
            variance.push(averaged.and_then(|(_, variance)| variance.or(nearby)));
            coherences.push(coherence(&pairs));
            averages.push(pairs.len());
            input_power.push(transformed.iter().map(|t| t.power[line]).sum::<f64>() / count);
            input_power_minimum.push(transformed.iter().map(|t| t.power[line]).fold(f64::INFINITY, f64::min));
        }
        let source = if transformed.len() >= 2 { VarianceSource::Repetition } else { VarianceSource::NearbyLines };
        let shortest = self
            .pieces
            .iter()
            .map(|piece| piece.segment.period as f64 * self.trials[piece.trial].sample_time_s)
            .fold(f64::INFINITY, f64::min);
        let mut estimate = Estimate {
            omega_rad_s: frequency_hz.iter().map(|f| 2.0 * PI * f).collect(),
            frequency_hz,
            h,
            variance_source: variance.iter().any(Option::is_some).then_some(source),
            variance,
            input_power,
            input_power_minimum,
            coherence: coherences,
            averages,
            segments: self.pieces.iter().map(|piece| self.used(piece)).collect(),
            resolution_hz: 1.0 / shortest,
            noise_bandwidth_hz: self.settings.settings().window.noise_bandwidth_lines() / shortest,
            warnings: Vec::new(),
        };
        estimate.warnings = self.warnings(&estimate, transformed);
        estimate
    }

    fn used(&self, piece: &Piece) -> UsedSegment {
        let dt = self.trials[piece.trial].sample_time_s;
        UsedSegment {
            trial: piece.trial,
            start_s: piece.segment.start as f64 * dt,
            length_s: piece.segment.period as f64 * dt,
            samples: piece.segment.samples,
        }
    }
}

/// The grid line that a frequency is, if it is one.
pub(super) fn on_grid(frequency_hz: f64, length_s: f64) -> Option<usize> {
    let cycles = frequency_hz * length_s;
    ((cycles - cycles.round()).abs() <= GRID_TOLERANCE).then_some(cycles.round() as usize)
}

fn largest(column: &[f64], segment: &Segment) -> f64 {
    column[segment.start..segment.start + segment.samples].iter().fold(0.0, |most, x| most.max(x.abs()))
}
