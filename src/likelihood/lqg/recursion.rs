//! The exact likelihood of trials, with its gradient and Fisher's information.
//!
//! ```text
//! e = z − Hŝ,  Σ = HPHᵀ + N,  G = (FPHᵀ + X)Σ⁻¹,  ŝ⁺ = Fŝ + Γd + Ge,  P⁺ = FPFᵀ + Q − GΣGᵀ
//! log p = −½ Σ_k (log det Σ_k + e_kᵀΣ_k⁻¹e_k + c log 2π)
//! ```
//! P does not depend on the data: one covariance recursion serves all trials, and ends where it stands still. All
//! derivatives are those of these equations, carried forward beside them; the information is `Σ_k ∂eᵀΣ⁻¹∂e + ½ tr
//! Σ⁻¹∂Σ Σ⁻¹∂Σ`, whose expectation is Fisher's and which is never indefinite.

use super::covariance::{Linear, Step, covariances, is_control_silent};
use super::design::{Design, Member};
use super::joint::Joint;
use super::kernel::{add, dot};
use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Samples of a trial between two such questions.
const SAMPLES_BETWEEN_CHECKS: usize = 20_000;
/// Samples of all trials at most.
pub const MAX_SAMPLES: usize = 2_000_000;
/// Numbers of the steps of one covariance recursion at most: they are held in memory.
const MAX_NUMBERS: usize = 40_000_000;
/// A first control below this share of the largest one is zero.
const ZERO: f64 = 1e-9;

/// A trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// d, samples × q.
    pub disturbance: DMatrix<f64>,
    /// z: y, then u where it was recorded; samples × channels.
    pub measured: DMatrix<f64>,
}

/// Trials that do not fit the design.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RecordError {
    /// No trial.
    #[error("there is no trial")]
    Empty,
    /// A signal has the wrong size.
    #[error("the {signal} of trial {trial} (counted from 0) is {rows}x{columns} and must have {expected} columns")]
    Size {
        /// The trial.
        trial: usize,
        /// `disturbance` or `measured signals`.
        signal: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
        /// Columns that it must have, and as many rows as the other signal.
        expected: usize,
    },
    /// More samples than are taken.
    #[error("there are {samples} samples in all; {MAX_SAMPLES} at most are taken")]
    TooLong {
        /// Samples of all trials.
        samples: usize,
    },
    /// A trial whose covariance recursion would not be held in memory.
    #[error("a trial of {samples} samples is too long for {parameters} parameters: it may have {most} at most")]
    TooLarge {
        /// Samples of the longest trial.
        samples: usize,
        /// Parameters.
        parameters: usize,
        /// Samples that it may have.
        most: usize,
    },
    /// A command that moves before anything was sensed.
    #[error(
        "trial {trial} (counted from 0) does not start at rest: its first control, recorded exactly, is not zero, \
         though the belief is zero there"
    )]
    NotAtRest {
        /// The trial.
        trial: usize,
    },
}

/// A trial as the recursion takes it, sample by sample.
#[derive(Debug, Clone, PartialEq)]
struct Trial {
    /// Γd, 2n × samples.
    drive: DMatrix<f64>,
    /// z, channels × samples.
    measured: DMatrix<f64>,
}

/// Trials with what is known of the person.
#[derive(Debug, Clone, PartialEq)]
pub struct Problem<'a> {
    design: &'a Design,
    trials: Vec<Trial>,
    samples: usize,
}

/// The likelihood at a point.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The natural logarithm of the density.
    pub log_likelihood: f64,
    /// Its gradient; empty where it was not asked for.
    pub gradient: DVector<f64>,
    /// Fisher's information at the data; empty as the gradient.
    pub information: DMatrix<f64>,
}

impl<'a> Problem<'a> {
    /// Checks the trials.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn new(design: &'a Design, records: &[Record]) -> Result<Self, RecordError> {
        if records.is_empty() {
            return Err(RecordError::Empty);
        }
        let [_, _, p, q] = design.sizes();
        let channels = design.channels();
        let gamma = design.disturbance();
        let mut trials = Vec::new();
        let mut samples = 0;
        let is_silent = is_control_silent(design);
        for (trial, record) in records.iter().enumerate() {
            let parts = [("disturbance", &record.disturbance, q), ("measured signals", &record.measured, channels)];
            for (signal, found, expected) in parts {
                let (rows, columns) = found.shape();
                if columns != expected || rows != record.measured.nrows() || rows == 0 {
                    return Err(RecordError::Size { trial, signal, rows, columns, expected });
                }
            }
            let controls = record.measured.columns(p, channels - p);
            if is_silent && controls.row(0).amax() > ZERO * controls.amax() {
                return Err(RecordError::NotAtRest { trial });
            }
            samples += record.measured.nrows();
            trials
                .push(Trial { drive: &gamma * record.disturbance.transpose(), measured: record.measured.transpose() });
        }
        if samples > MAX_SAMPLES {
            return Err(RecordError::TooLong { samples });
        }
        let parameters = design.free().count();
        let width = gamma.nrows();
        let each = (width + channels) * channels * (parameters + 1) + parameters * (parameters + 1);
        let most = MAX_NUMBERS / each;
        let found = Self { design, trials, samples };
        if found.longest() > most {
            return Err(RecordError::TooLarge { samples: found.longest(), parameters, most });
        }
        Ok(found)
    }

    /// What is known of the person.
    #[must_use]
    pub fn design(&self) -> &'a Design {
        self.design
    }

    /// Samples of all trials.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Whether the experimenter moved anything.
    #[must_use]
    pub fn is_disturbed(&self) -> bool {
        self.trials.iter().any(|trial| trial.drive.iter().any(|v| *v != 0.0))
    }

    /// Of every output the mean square of its second differences over six, which is the variance of white noise on a
    /// signal that is smooth beside it; positive.
    pub(super) fn roughness(&self) -> Vec<f64> {
        let [_, _, p, _] = self.design.sizes();
        let one = |output: usize| {
            let (mut sum, mut count) = (0.0, 0.0);
            for trial in &self.trials {
                let y = trial.measured.row(output);
                for k in 2..y.len() {
                    sum += (y[k] - 2.0 * y[k - 1] + y[k - 2]).powi(2);
                    count += 6.0;
                }
            }
            if count > 0.0 && sum > 0.0 { sum / count } else { f64::MIN_POSITIVE.sqrt() }
        };
        (0..p).map(one).collect()
    }

    /// Log likelihood at θ, with gradient and information if asked; `None` where the person is not defined there, or a
    /// covariance is not positive definite.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn evaluate(&self, theta: &[f64], slopes: bool, ctl: &Ctl) -> Result<Option<Evaluation>, Stopped> {
        ctl.check()?;
        let Some(member) = self.design.member(theta, slopes) else { return Ok(None) };
        self.of_member(&member, ctl)
    }

    /// The same of a person who need not be optimal for anything.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn of_member(&self, member: &Member, ctl: &Ctl) -> Result<Option<Evaluation>, Stopped> {
        let Some((linear, steps)) = covariances(self.design, member, self.longest(), ctl)? else { return Ok(None) };
        let count = member.slopes.len();
        let parts: Result<Vec<_>, Stopped> =
            self.trials.par_iter().map(|trial| along(trial, &linear, &steps, ctl, None)).collect();
        let mut all = Evaluation {
            log_likelihood: 0.0,
            gradient: DVector::zeros(count),
            information: DMatrix::zeros(count, count),
        };
        // One after the other, whoever was ready first.
        for part in parts? {
            all.log_likelihood += part.log_likelihood;
            all.gradient += part.gradient;
            all.information += part.information;
        }
        let last = steps.len() - 1;
        for (at, step) in steps.iter().enumerate() {
            let lengths = self.trials.iter().map(|trial| trial.measured.ncols());
            let uses = |n: usize| if at < last { usize::from(n > at) } else { n.saturating_sub(last) };
            let times = lengths.map(uses).sum::<usize>() as f64;
            for (sum, of_step) in all.gradient.iter_mut().zip(&step.half_traces) {
                *sum -= times * of_step;
            }
            for (sum, of_step) in all.information.iter_mut().zip(&step.information) {
                *sum += times * of_step;
            }
        }
        let is_finite =
            all.log_likelihood.is_finite() && all.gradient.iter().chain(all.information.iter()).all(|v| v.is_finite());
        Ok(is_finite.then_some(all))
    }

    /// Prediction errors of every trial at θ in units of their own standard deviations, samples × channels; `None` as
    /// in [`Self::evaluate`].
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn innovations(&self, theta: &[f64], ctl: &Ctl) -> Result<Option<Vec<DMatrix<f64>>>, Stopped> {
        let Some(member) = self.design.member(theta, false) else { return Ok(None) };
        let Some((linear, steps)) = covariances(self.design, &member, self.longest(), ctl)? else { return Ok(None) };
        let mut all = Vec::new();
        for trial in &self.trials {
            let mut errors = DMatrix::zeros(trial.measured.nrows(), trial.measured.ncols());
            along(trial, &linear, &steps, ctl, Some(&mut errors))?;
            for (k, mut column) in errors.column_iter_mut().enumerate() {
                let step = &steps[k.min(steps.len() - 1)];
                for (value, deviation) in column.iter_mut().zip(&step.deviations) {
                    *value = if *deviation > 0.0 { *value / deviation } else { 0.0 };
                }
            }
            all.push(errors.transpose());
        }
        Ok(Some(all))
    }

    /// Samples of the longest trial.
    fn longest(&self) -> usize {
        self.trials.iter().map(|trial| trial.measured.ncols()).max().unwrap_or(0)
    }
}

/// The predictor along a trial; the information is that of the prediction errors alone.
fn along(
    trial: &Trial,
    linear: &Linear,
    steps: &[Step],
    ctl: &Ctl,
    mut errors: Option<&mut DMatrix<f64>>,
) -> Result<Evaluation, Stopped> {
    let Joint { f, h, .. } = &linear.joint;
    let (channels, width) = h.shape();
    let count = linear.slopes.len();
    let (f, h) = (f.as_slice(), h.as_slice());
    let (mut s, mut s_next) = (vec![0.0; width], vec![0.0; width]);
    let (mut ds, mut ds_next) = (vec![0.0; width * count], vec![0.0; width]);
    let (mut e, mut de, mut weighted) = (vec![0.0; channels], vec![0.0; channels * count], vec![0.0; channels]);
    let mut turned = vec![0.0; channels];
    let mut result =
        Evaluation { log_likelihood: 0.0, gradient: DVector::zeros(count), information: DMatrix::zeros(count, count) };
    let constant = (2.0 * std::f64::consts::PI).ln();
    let samples = trial.measured.as_slice().chunks_exact(channels).zip(trial.drive.as_slice().chunks_exact(width));
    for (k, (z, drive)) in samples.enumerate() {
        if k % SAMPLES_BETWEEN_CHECKS == 0 {
            ctl.check()?;
        }
        let step = &steps[k.min(steps.len() - 1)];
        e.copy_from_slice(z);
        add(&mut e, h, &s, -1.0);
        if let Some(errors) = errors.as_deref_mut() {
            errors.column_mut(k).copy_from_slice(&e);
        }
        weighted.fill(0.0);
        add(&mut weighted, &step.inverse, &e, 1.0);
        result.log_likelihood -= 0.5 * (step.log_det + dot(&e, &weighted) + step.told as f64 * constant);
        for (i, (slope, moves_gains)) in linear.slopes.iter().enumerate() {
            let de = &mut de[i * channels..(i + 1) * channels];
            let ds = &mut ds[i * width..(i + 1) * width];
            de.fill(0.0);
            add(de, h, ds, -1.0);
            ds_next.fill(0.0);
            add(&mut ds_next, f, ds, 1.0);
            if *moves_gains {
                add(de, slope.h.as_slice(), &s, -1.0);
                add(&mut ds_next, slope.f.as_slice(), &s, 1.0);
            }
            let gain = width * channels;
            add(&mut ds_next, &step.gain_slopes[i * gain..(i + 1) * gain], &e, 1.0);
            add(&mut ds_next, &step.gain, de, 1.0);
            ds.copy_from_slice(&ds_next);
            turned.fill(0.0);
            let sigma = channels * channels;
            add(&mut turned, &step.sigma_slopes[i * sigma..(i + 1) * sigma], &weighted, 1.0);
            result.gradient[i] += 0.5 * dot(&weighted, &turned) - dot(de, &weighted);
        }
        for i in 0..count {
            turned.fill(0.0);
            add(&mut turned, &step.inverse, &de[i * channels..(i + 1) * channels], 1.0);
            for j in 0..=i {
                result.information[(i, j)] += dot(&turned, &de[j * channels..(j + 1) * channels]);
            }
        }
        s_next.copy_from_slice(drive);
        add(&mut s_next, f, &s, 1.0);
        add(&mut s_next, &step.gain, &e, 1.0);
        std::mem::swap(&mut s, &mut s_next);
    }
    for i in 0..count {
        for j in 0..i {
            result.information[(j, i)] = result.information[(i, j)];
        }
    }
    Ok(result)
}
