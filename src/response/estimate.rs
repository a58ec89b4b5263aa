//! The estimate: segments transformed at the lines, and averaged.

use super::error::{FrequencyError, other};
use super::excited::strongest;
use super::grids::Grids;
use super::job::{Job, Piece, Removal, Transformed, ZERO_AMPLITUDE, largest, on_grid};
use super::lines;
use super::removal::{Local, are_significant};
use super::result::{Estimate, UsedSegment, VarianceSource};
use super::segments::{self, Segment};
use super::settings::{Channels, CheckedSettings, EndSample, FrequencySettings, Response, Stimulus, Window};
use super::spectrum::{direct_transform, grid_transform, line_power, prepare};
use super::usable::usable;
use super::variance::{average, coherence, dark_lines, noise_power};
use crate::ctl::Ctl;
use crate::trial::Trial;
use num_complex::Complex64;
use rayon::prelude::*;
use std::borrow::Cow;
use std::f64::consts::PI;

/// Trials count as equally sampled up to this relative difference of their sample times: what rounding of printed time
/// columns leaves.
const SAMPLE_TIME_TOLERANCE: f64 = 1e-6;

/// Local polynomials are no more exact than this share of the response, which differences of it do not pass for
/// leakage.
const PRECISION: f64 = 1e-4;

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
    let grids = job.grids(ctl)?;
    let frequency_hz = match &settings.frequency_hz {
        Some(named) => named.clone(),
        None => job.excited(&grids)?,
    };
    let segments: Vec<(usize, Segment)> = job.pieces.iter().map(|piece| (piece.trial, piece.segment)).collect();
    lines::check(&frequency_hz, trials, &segments, settings)?;
    ctl.set_total(job.pieces.len() as u64);
    let transformed: Vec<Transformed> = job
        .pieces
        .par_iter()
        .zip(&grids)
        .map(|(piece, grids)| {
            let transformed = job.transform(piece, grids, &frequency_hz, ctl)?;
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
    let (removal, local) = job.removal(&grids, &frequency_hz, ctl)?;
    Ok(job.assemble(frequency_hz, &transformed, &grids, &local, removal))
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

    /// What becomes of transients, and the local polynomials where they are needed for it.
    fn removal(
        &self,
        grids: &[Grids],
        frequency_hz: &[f64],
        ctl: &Ctl,
    ) -> Result<(Removal, Vec<Option<Local>>), FrequencyError> {
        let is_periodic = self.removes_transients() && self.is_periodic(frequency_hz);
        let alike = if is_periodic { self.dark_lines_are_alike(grids, frequency_hz) } else { None };
        if alike == Some(false) {
            return Ok((Removal::Nothing, vec![None; frequency_hz.len()]));
        }
        let local = self.local(grids, frequency_hz, ctl)?;
        let removal = if !self.removes_transients() || local.iter().all(Option::is_none) {
            Removal::None
        } else if !is_periodic {
            Removal::Local
        } else if alike == Some(true) || are_significant(&local) {
            Removal::Corrected
        } else {
            Removal::Nothing
        };
        Ok((removal, local))
    }

    pub(super) fn stimulus(&self, trial: usize, stimulus: Stimulus) -> Option<&'a [f64]> {
        match stimulus {
            Stimulus::Command => Some(&self.trials[trial].signals.command),
            Stimulus::Disturbance => self.trials[trial].signals.disturbance.as_deref(),
        }
    }

    /// The input's column, which `new` made sure of.
    pub(super) fn input(&self, trial: usize) -> &'a [f64] {
        self.stimulus(trial, self.channels.input).unwrap_or_default()
    }

    pub(super) fn output(&self, trial: usize) -> Cow<'a, [f64]> {
        let trial = self.trials[trial];
        match self.channels.output {
            Response::Output => Cow::Borrowed(&trial.signals.output),
            Response::Control => Cow::Borrowed(&trial.signals.control),
            Response::Error => Cow::Owned(trial.error()),
        }
    }

    fn cut(&self, column: &[f64], segment: &Segment) -> Vec<f64> {
        let settings = self.settings.settings();
        prepare(&column[segment.start..segment.start + segment.samples], self.settings.detrend, settings.window)
    }

    fn window_sum(&self, samples: usize) -> f64 {
        let window = self.settings.settings().window;
        (0..samples).map(|i| window.value(i, samples)).sum()
    }

    pub(super) fn no_power(&self, trial: usize) -> FrequencyError {
        let input = self.channels.input;
        let moves = |column: &[f64]| column.iter().any(|x| *x != column[0]);
        let other_has_power = self.stimulus(trial, other(input)).is_some_and(moves);
        FrequencyError::NoPower { trial, input, other_has_power }
    }

    fn transform(
        &self,
        piece: &Piece,
        grids: &Grids,
        frequency_hz: &[f64],
        ctl: &Ctl,
    ) -> Result<Transformed, FrequencyError> {
        let segment = &piece.segment;
        let dt = self.trials[piece.trial].sample_time_s;
        let length_s = segment.period as f64 * dt;
        let column = self.input(piece.trial);
        // On their own grid, without a window, the segments are transformed already.
        let on_own_grid = self.settings.end_sample == EndSample::Excluded
            && self.settings.settings().window == Window::Rectangular
            && self.removes_transients();
        let window_sum = self.window_sum(segment.samples);
        let zero = ZERO_AMPLITUDE * window_sum * largest(column, segment);
        let threshold = self.settings.settings().power_threshold * strongest(&grids.other_power);

        let cut = || {
            let other = self.stimulus(piece.trial, other(self.channels.input));
            let other = other.filter(|_| threshold > 0.0).map(|other| self.cut(other, segment)).unwrap_or_default();
            [self.cut(column, segment), self.cut(&self.output(piece.trial), segment), other]
        };
        let mut columns: Option<[Vec<f64>; 3]> = None;
        let mut pairs = Vec::with_capacity(frequency_hz.len());
        let mut line_powers = Vec::with_capacity(frequency_hz.len());
        let mut shared = Vec::with_capacity(frequency_hz.len());
        for frequency in frequency_hz {
            ctl.check()?;
            let at_zero = *frequency == 0.0;
            let known = on_grid(*frequency, length_s).filter(|_| on_own_grid);
            let (r, y, other_power) = if let Some(k) = known {
                let other_power = grids.other_power.get(k).copied().unwrap_or(0.0);
                (grids.input[k], grids.output[k], other_power)
            } else {
                let [input, output, other] = columns.get_or_insert_with(cut);
                let x = direct_transform(&[input, output, other], frequency * dt);
                (x[0], x[1], line_power(x[2], window_sum, at_zero))
            };
            pairs.push((r.norm() > zero).then_some((r, y)));
            line_powers.push(line_power(r, window_sum, at_zero));
            shared.push(threshold > 0.0 && other_power >= threshold);
        }
        let nearby_variance = if self.pieces.len() == 1 {
            self.nearby_variance(segment, dt, frequency_hz, &pairs, grids)
        } else {
            vec![]
        };
        Ok(Transformed { pairs, power: line_powers, strongest: strongest(&grids.power), shared, nearby_variance })
    }

    fn nearby_variance(
        &self,
        segment: &Segment,
        dt: f64,
        frequency_hz: &[f64],
        pairs: &[Option<(Complex64, Complex64)>],
        grids: &Grids,
    ) -> Vec<Option<f64>> {
        let settings = self.settings.settings();
        if self.settings.end_sample == EndSample::Included {
            return vec![None; frequency_hz.len()];
        }
        let window = settings.window;
        let stimuli: Vec<Vec<f64>> =
            [&grids.power, &grids.other_power].into_iter().filter(|p| !p.is_empty()).cloned().collect();
        let dark = dark_lines(&stimuli, window);
        let windowed: Vec<Complex64>;
        let grid = if self.removes_transients() {
            &grids.output
        } else {
            windowed = grid_transform(&self.cut(&self.output(self.pieces[0].trial), segment));
            &windowed
        };
        let at = |(frequency, pair): (&f64, &Option<(Complex64, Complex64)>)| {
            let (r, _) = pair.as_ref()?;
            let line = on_grid(*frequency, segment.period as f64 * dt)?;
            Some(noise_power(grid, &dark, line)? / r.norm_sqr())
        };
        frequency_hz.iter().zip(pairs).map(at).collect()
    }

    fn assemble(
        &self,
        frequency_hz: Vec<f64>,
        transformed: &[Transformed],
        grids: &[Grids],
        local: &[Option<Local>],
        removal: Removal,
    ) -> Estimate {
        let count = transformed.len() as f64;
        let shortest = self
            .pieces
            .iter()
            .map(|piece| piece.segment.period as f64 * self.trials[piece.trial].sample_time_s)
            .fold(f64::INFINITY, f64::min);
        let found: Vec<Line> =
            (0..frequency_hz.len()).map(|line| self.line(line, transformed, local[line].as_ref(), removal)).collect();
        let h: Vec<Option<Complex64>> = found.iter().map(|line| line.h).collect();
        let variance: Vec<Option<f64>> = found.iter().map(|line| line.variance).collect();
        let leakage: Vec<Option<f64>> = found.iter().map(|line| line.leakage).collect();
        let source = match removal {
            Removal::Local => VarianceSource::LocalPolynomial,
            _ if transformed.len() >= 2 => VarianceSource::Repetition,
            Removal::Corrected => VarianceSource::LocalPolynomial,
            _ => VarianceSource::NearbyLines,
        };
        let freedom = local.iter().flatten().map(|line| line.degrees_of_freedom).reduce(f64::min);
        let mut estimate = Estimate {
            omega_rad_s: frequency_hz.iter().map(|f| 2.0 * PI * f).collect(),
            usable: usable(&h, &variance, &leakage, local, removal),
            variance_source: variance.iter().any(Option::is_some).then_some(source),
            input_power: (0..frequency_hz.len())
                .map(|line| transformed.iter().map(|t| t.power[line]).sum::<f64>() / count)
                .collect(),
            input_power_minimum: (0..frequency_hz.len())
                .map(|line| transformed.iter().map(|t| t.power[line]).fold(f64::INFINITY, f64::min))
                .collect(),
            frequency_hz,
            h,
            variance,
            leakage,
            coherence: found.iter().map(|line| line.coherence).collect(),
            averages: found.iter().map(|line| line.averages).collect(),
            degrees_of_freedom: freedom.filter(|_| source == VarianceSource::LocalPolynomial),
            transients_removed: matches!(removal, Removal::Corrected | Removal::Local),
            segments: self.pieces.iter().zip(grids).map(|(piece, grids)| self.used(piece, grids)).collect(),
            resolution_hz: 1.0 / shortest,
            noise_bandwidth_hz: self.settings.settings().window.noise_bandwidth_lines() / shortest,
            warnings: Vec::new(),
        };
        estimate.warnings = self.warnings(&estimate, transformed);
        estimate
    }

    fn line(&self, line: usize, transformed: &[Transformed], local: Option<&Local>, removal: Removal) -> Line {
        let taken_off = matches!(removal, Removal::Corrected | Removal::Local);
        let pairs: Vec<(Complex64, Complex64)> = transformed
            .iter()
            .enumerate()
            .filter_map(|(i, t)| {
                let (r, y) = t.pairs[line]?;
                let transient = local.filter(|_| taken_off).and_then(|l| l.transients[i]).unwrap_or_default();
                Some((r, y - transient))
            })
            .collect();
        let averaged = average(&pairs, self.settings.settings().average);
        let nearby = transformed[0].nearby_variance.get(line).copied().flatten();
        let (h, variance) = match (removal, averaged, local) {
            (_, None, _) => (None, None),
            (Removal::Local, Some(_), Some(local)) => (Some(local.h), Some(local.mean_square_error)),
            (Removal::Corrected, Some((h, variance)), Some(local)) => {
                (Some(h), variance.or(Some(local.mean_square_error)))
            }
            (_, Some((h, variance)), _) => (Some(h), variance.or(nearby)),
        };
        let leakage = match (removal, h, local) {
            (Removal::Nothing, Some(_), _) => Some(0.0),
            (Removal::Local | Removal::Corrected, Some(_), Some(local)) => Some(local.leakage),
            // What differs from the local polynomials, beyond what noise makes of both.
            (Removal::None, Some(h), Some(local)) => {
                let noise = local.ratio_variance + local.mean_square_error + (PRECISION * h.norm()).powi(2);
                let difference = (h - local.h).norm_sqr();
                if local.is_told {
                    Some(if difference > noise { (difference - noise).sqrt() } else { 0.0 })
                } else {
                    // The polynomials may err as much as they may leave of the transient: a bound of both.
                    Some((difference - local.ratio_variance).max(0.0).sqrt() + local.leakage)
                }
            }
            _ => None,
        };
        let kept = match (h, leakage) {
            (Some(h), Some(leakage)) if h.norm_sqr() > 0.0 => h.norm_sqr() / (h.norm_sqr() + leakage * leakage),
            _ => 1.0,
        };
        let coherence = coherence(&pairs).map(|share| share * kept);
        Line { h, variance, leakage, coherence, averages: pairs.len() }
    }

    fn used(&self, piece: &Piece, grids: &Grids) -> UsedSegment {
        let dt = self.trials[piece.trial].sample_time_s;
        UsedSegment {
            trial: piece.trial,
            start_s: piece.segment.start as f64 * dt,
            length_s: piece.segment.period as f64 * dt,
            samples: piece.segment.samples,
            slope_per_s: grids.slope.map(|slope| slope / dt).filter(|_| self.removes_transients()),
        }
    }
}

/// What is found at a line.
struct Line {
    h: Option<Complex64>,
    variance: Option<f64>,
    leakage: Option<f64>,
    coherence: Option<f64>,
    averages: usize,
}
