//! Command, disturbance, control and output of every segment at the lines: what an estimate with two stimuli starts
//! from.
//!
//! Values are amplitudes, `2 X(ω)/Σw`: a sinusoid `a cos(ωt + φ)`, `t` from the start of the segment, has `a e^{jφ}`.

use super::error::FrequencyError;
use super::excited::{excited_lines, strongest};
use super::job::{GRID_TOLERANCE, on_grid};
use super::segments::{self, Segment};
use super::settings::{CheckedSettings, Detrend, EndSample, Stimulus, Window};
use super::spectrum::{direct_transform, grid_transform, line_power, prepare};
use super::variance::dark_lines;
use super::warnings::{EstimateWarning, hertz, is_periodic};
use super::{drift, lines};
use crate::ctl::Ctl;
use crate::trial::Trial;
use num_complex::Complex64;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Trials count as equally sampled up to this relative difference of their sample times.
const SAMPLE_TIME_TOLERANCE: f64 = 1e-6;

/// An amplitude below this fraction of the signal's largest value is the rounding of the record, not a stimulus.
const ZERO_AMPLITUDE: f64 = 1e-10;

/// How far from a line its noise is looked for, in lines, and how many dark lines are used at most.
const REACH: usize = 16;
const MOST_DARK_LINES: usize = 12;
const FEWEST_DARK_LINES: usize = 4;

/// The noise of control and output next to a line, from lines without a stimulus.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearbyNoise {
    /// Mean `|U|²`.
    pub control: f64,
    /// Mean `|Y|²`.
    pub output: f64,
    /// Mean `U Ȳ`.
    pub cross: Complex64,
    /// Lines that were averaged.
    pub lines: usize,
}

/// A segment at the lines.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentLines {
    /// Its trial, from 0.
    pub trial: usize,
    /// Command R at each line; exactly 0 where it is not excited.
    pub command: Vec<Complex64>,
    /// Disturbance D at each line; exactly 0 where it is not excited.
    pub disturbance: Vec<Complex64>,
    /// Control U.
    pub control: Vec<Complex64>,
    /// Output Y.
    pub output: Vec<Complex64>,
    /// The noise beside each line, where there are dark lines enough.
    pub noise: Vec<Option<NearbyNoise>>,
    /// Variance of control and output over the samples of the segment.
    pub variance: [f64; 2],
}

/// All segments of all trials at the lines.
#[derive(Debug, Clone, PartialEq)]
pub struct StimulusLines {
    /// Frequencies in Hz, increasing, none of them 0.
    pub frequency_hz: Vec<f64>,
    /// Angular frequencies in rad/s.
    pub omega_rad_s: Vec<f64>,
    /// Number of trials.
    pub trials: usize,
    /// The segments, in the order of the trials.
    pub segments: Vec<SegmentLines>,
    /// What must be read.
    pub warnings: Vec<EstimateWarning>,
}

impl StimulusLines {
    /// Whether a stimulus excites any line of any trial.
    #[must_use]
    pub fn has(&self, stimulus: Stimulus) -> bool {
        let column = |segment: &SegmentLines| match stimulus {
            Stimulus::Command => segment.command.iter().any(|x| x.norm_sqr() > 0.0),
            Stimulus::Disturbance => segment.disturbance.iter().any(|x| x.norm_sqr() > 0.0),
        };
        self.segments.iter().any(column)
    }
}

struct Piece {
    trial: usize,
    segment: Segment,
    /// Power of r and d on the segment's grid.
    power: [Vec<f64>; 2],
    /// Whether each of them is periodic with the segment, or silent.
    periodic: [bool; 2],
}

/// Transforms r, d, u and y of every segment at the lines that the settings name, or at every line that r or d excites.
///
/// A stimulus counts as excited on a line of a segment if it has `power_threshold` of the power of its strongest line
/// in that segment. A trial may lack one of the stimuli, or have it at zero throughout. `ctl` counts segments.
///
/// # Errors
/// [`FrequencyError`]; [`FrequencyError::NothingExcited`] where neither stimulus has power anywhere.
pub fn stimulus_lines(
    trials: &[&Trial],
    settings: &CheckedSettings,
    ctl: &Ctl,
) -> Result<StimulusLines, FrequencyError> {
    let pieces = pieces(trials, settings)?;
    let frequency_hz: Vec<f64> = match &settings.frequency_hz {
        // Nothing is estimated at 0 Hz, where r and d are constants.
        Some(named) => named.iter().copied().filter(|f| *f > 0.0).collect(),
        None => excited(trials, &pieces, settings)?,
    };
    let segments: Vec<(usize, Segment)> = pieces.iter().map(|piece| (piece.trial, piece.segment)).collect();
    lines::check(&frequency_hz, trials, &segments, settings)?;
    ctl.set_total(pieces.len() as u64);
    let segments = pieces
        .par_iter()
        .map(|piece| {
            ctl.check()?;
            let lines = transform(trials[piece.trial], piece, settings, &frequency_hz);
            ctl.advance(1);
            Ok(lines)
        })
        .collect::<Result<Vec<_>, FrequencyError>>()?;
    let omega_rad_s = frequency_hz.iter().map(|f| TAU * f).collect();
    let warnings = warnings(trials, &pieces, &frequency_hz);
    Ok(StimulusLines { frequency_hz, omega_rad_s, trials: trials.len(), segments, warnings })
}

fn column(trial: &Trial, stimulus: usize) -> Option<&[f64]> {
    if stimulus == 0 { Some(&trial.signals.command) } else { trial.signals.disturbance.as_deref() }
}

fn window_sum(settings: &CheckedSettings, samples: usize) -> f64 {
    let window = settings.settings().window;
    (0..samples).map(|i| window.value(i, samples)).sum()
}

fn cut(column: &[f64], segment: &Segment, settings: &CheckedSettings) -> Vec<f64> {
    let window = settings.settings().window;
    prepare(&column[segment.start..segment.start + segment.samples], detrend(settings), window)
}

/// A straight line fitted to a periodic signal takes of its sinusoids; the slope of control and output is estimated
/// between the stimuli's lines and taken off instead ([`slopes`]).
fn detrend(settings: &CheckedSettings) -> Detrend {
    match (settings.detrend, settings.settings().window) {
        (Detrend::Line, Window::Rectangular) => Detrend::Mean,
        (detrend, _) => detrend,
    }
}

/// Slopes of control and output in units a sample, where they stand above the noise.
fn slopes(columns: &[Vec<f64>; 4], dark: &[bool], settings: &CheckedSettings) -> [Option<f64>; 2] {
    if settings.detrend != Detrend::Line || settings.settings().window != Window::Rectangular {
        return [None; 2];
    }
    let samples = columns[2].len();
    let command = if columns[0].is_empty() { &columns[1] } else { &columns[0] };
    if command.is_empty() {
        return [None; 2];
    }
    let input = grid_transform(command);
    [2, 3].map(|i| drift::slope(&input, &grid_transform(&columns[i]), dark, samples))
}

fn pieces(trials: &[&Trial], settings: &CheckedSettings) -> Result<Vec<Piece>, FrequencyError> {
    let first_s = trials.first().ok_or(FrequencyError::NoTrial)?.sample_time_s;
    let mut pieces = Vec::new();
    for (index, trial) in trials.iter().enumerate() {
        if (trial.sample_time_s - first_s).abs() > SAMPLE_TIME_TOLERANCE * first_s {
            let sample_time_s = trial.sample_time_s;
            return Err(FrequencyError::SampleTimesDiffer { trial: index, sample_time_s, first_s });
        }
        let (segments, _) = segments::place(index, trial, settings)?;
        for segment in segments {
            let sum = window_sum(settings, segment.samples);
            let mut power = [const { Vec::new() }; 2];
            let mut periodic = [true; 2];
            for stimulus in 0..2 {
                let Some(column) = column(trial, stimulus) else { continue };
                let range = &column[segment.start..segment.start + segment.samples];
                let largest = range.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
                let grid = grid_transform(&cut(column, &segment, settings));
                let own: Vec<f64> = grid.iter().enumerate().map(|(k, x)| line_power(*x, sum, k == 0)).collect();
                if strongest(&own) > 2.0 * (ZERO_AMPLITUDE * largest).powi(2) {
                    periodic[stimulus] = is_periodic(column, &segment);
                    power[stimulus] = own;
                }
            }
            pieces.push(Piece { trial: index, segment, power, periodic });
        }
    }
    Ok(pieces)
}

/// Lines that r or d excites, on the common grid.
fn excited(trials: &[&Trial], pieces: &[Piece], settings: &CheckedSettings) -> Result<Vec<f64>, FrequencyError> {
    let first = pieces.first().ok_or(FrequencyError::NoTrial)?.segment;
    if let Some(piece) = pieces.iter().find(|piece| piece.segment.samples != first.samples) {
        return Err(FrequencyError::UnequalSegments {
            trial: piece.trial,
            segment: piece.segment.number,
            samples: piece.segment.samples,
            first: first.samples,
        });
    }
    let own = settings.settings();
    let step_hz = 1.0 / (first.samples as f64 * trials[0].sample_time_s);
    let [low, high] = own.band_hz.unwrap_or([0.0, f64::INFINITY]);
    let slack = GRID_TOLERANCE * step_hz;
    let mut lines: Vec<usize> = Vec::new();
    for stimulus in 0..2 {
        let with: Vec<&Piece> = pieces.iter().filter(|piece| !piece.power[stimulus].is_empty()).collect();
        let mut mean = vec![0.0; first.samples / 2 + 1];
        for piece in &with {
            for (sum, power) in mean.iter_mut().zip(&piece.power[stimulus]) {
                *sum += power / with.len() as f64;
            }
        }
        lines.extend(excited_lines(&mean, first.samples, own));
    }
    lines.sort_unstable();
    lines.dedup();
    let lines: Vec<f64> =
        lines.into_iter().map(|k| k as f64 * step_hz).filter(|f| *f >= low - slack && *f <= high + slack).collect();
    if lines.is_empty() {
        return Err(FrequencyError::NothingExcited { input: Stimulus::Command, band_hz: own.band_hz });
    }
    Ok(lines)
}

fn transform(trial: &Trial, piece: &Piece, settings: &CheckedSettings, frequency_hz: &[f64]) -> SegmentLines {
    let segment = &piece.segment;
    let scale = 2.0 / window_sum(settings, segment.samples);
    let empty = Vec::new();
    let stimulus = |which: usize| match column(trial, which) {
        Some(column) if !piece.power[which].is_empty() => cut(column, segment, settings),
        _ => empty.clone(),
    };
    let columns = [
        stimulus(0),
        stimulus(1),
        cut(&trial.signals.control, segment, settings),
        cut(&trial.signals.output, segment, settings),
    ];
    let powers: Vec<Vec<f64>> = piece.power.iter().filter(|p| !p.is_empty()).cloned().collect();
    let dark = if powers.is_empty() {
        vec![true; segment.samples / 2 + 1]
    } else {
        dark_lines(&powers, settings.settings().window)
    };
    let mut columns = columns;
    for (i, slope) in [2, 3].into_iter().zip(slopes(&columns, &dark, settings)) {
        if let Some(slope) = slope {
            let middle = 0.5 * (segment.samples as f64 - 1.0);
            columns[i].iter_mut().enumerate().for_each(|(k, x)| *x -= slope * (k as f64 - middle));
        }
    }
    let refs: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let mut at = [const { Vec::new() }; 4];
    for frequency in frequency_hz {
        let x = direct_transform(&refs, frequency * trial.sample_time_s);
        for (i, value) in x.into_iter().enumerate() {
            let mut value = value * scale;
            if i < 2 {
                // The power of a line is half its squared amplitude.
                let threshold = settings.settings().power_threshold * strongest(&piece.power[i]);
                if 0.5 * value.norm_sqr() < threshold || piece.power[i].is_empty() {
                    value = Complex64::default();
                }
            }
            at[i].push(value);
        }
    }
    let noise = if settings.end_sample == EndSample::Included {
        vec![None; frequency_hz.len()]
    } else {
        let grids = [grid_transform(&columns[2]), grid_transform(&columns[3])];
        let length_s = segment.period as f64 * trial.sample_time_s;
        frequency_hz.iter().map(|f| nearby(&grids, &dark, on_grid(*f, length_s)?, scale)).collect()
    };
    let [command, disturbance, control, output] = at;
    let range = segment.start..segment.start + segment.samples;
    let variance = [&trial.signals.control, &trial.signals.output].map(|column| variance(&column[range.clone()]));
    SegmentLines { trial: piece.trial, command, disturbance, control, output, noise, variance }
}

fn variance(x: &[f64]) -> f64 {
    let count = x.len() as f64;
    let mean = x.iter().sum::<f64>() / count;
    x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count
}

fn nearby(grids: &[Vec<Complex64>; 2], dark: &[bool], k: usize, scale: f64) -> Option<NearbyNoise> {
    let mut noise = NearbyNoise { control: 0.0, output: 0.0, cross: Complex64::default(), lines: 0 };
    for distance in 1..=REACH {
        for line in [k.checked_sub(distance), k.checked_add(distance)].into_iter().flatten() {
            if line > 0 && dark.get(line) == Some(&true) && noise.lines < MOST_DARK_LINES {
                let (u, y) = (grids[0][line] * scale, grids[1][line] * scale);
                noise.control += u.norm_sqr();
                noise.output += y.norm_sqr();
                noise.cross += u * y.conj();
                noise.lines += 1;
            }
        }
    }
    let count = noise.lines as f64;
    (noise.lines >= FEWEST_DARK_LINES).then(|| NearbyNoise {
        control: noise.control / count,
        output: noise.output / count,
        cross: noise.cross / count,
        lines: noise.lines,
    })
}

fn warnings(trials: &[&Trial], pieces: &[Piece], frequency_hz: &[f64]) -> Vec<EstimateWarning> {
    let mut warnings = Vec::new();
    for (stimulus, name) in ["command", "disturbance"].into_iter().enumerate() {
        let rough = pieces.iter().filter(|piece| !piece.periodic[stimulus]).count();
        if rough > 0 {
            let message = format!(
                "the {name} is not periodic with {rough} of {} segments: transients leak into all lines, and the \
                 responses are biased even without noise",
                pieces.len()
            );
            warnings.push(EstimateWarning::new("leakage", message));
        }
    }
    let off: Vec<f64> = frequency_hz
        .iter()
        .copied()
        .filter(|f| {
            pieces.iter().any(|p| on_grid(*f, p.segment.period as f64 * trials[p.trial].sample_time_s).is_none())
        })
        .collect();
    if !off.is_empty() {
        let message =
            format!("{} are on no line of the segments' grid: neighbouring lines leak into them", hertz(&off));
        warnings.push(EstimateWarning::new("leakage", message));
    }
    warnings
}
