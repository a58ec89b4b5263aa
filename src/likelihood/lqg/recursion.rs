//! The exact likelihood of trials, with its gradient and Fisher's information.
//!
//! ```text
//! e = z − Hŝ,  Σ = HPHᵀ + N,  G = (FPHᵀ + X)Σ⁻¹,  ŝ⁺ = Fŝ + Γd + Ge,  P⁺ = FPFᵀ + Q − GΣGᵀ
//! log p = −½ Σ_k (log det Σ_k + e_kᵀΣ_k⁻¹e_k + c log 2π)
//! ```
//! P does not depend on the data: one covariance recursion serves all trials, and ends where it stands still. All
//! derivatives are those of these equations, carried forward beside them; the information is `Σ_k ∂eᵀΣ⁻¹∂e + ½ tr
//! Σ⁻¹∂Σ Σ⁻¹∂Σ`, whose expectation is Fisher's and which is never indefinite.

use super::course::{self, Course};
use super::design::{Design, Role};
use super::walk::{Trial, Walker, along, lots};
use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

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
    /// The state and the belief that it starts from; zero where it says nothing. Only where trials start at rest.
    pub initial: Option<[DVector<f64>; 2]>,
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
    /// Trials of another length than the horizon has.
    #[error(
        "trial {trial} (counted from 0) has {samples} samples, and a horizon of {steps} controls has {}: trials of \
         unequal length have no common gains",
        steps + 1
    )]
    Horizon {
        /// The trial.
        trial: usize,
        /// Its samples.
        samples: usize,
        /// Controls of the horizon.
        steps: usize,
    },
    /// An initial state of another size than the plant has.
    #[error("the initial state and belief of trial {trial} (counted from 0) must have {states} and {own} entries")]
    Initial {
        /// The trial.
        trial: usize,
        /// States of the plant.
        states: usize,
        /// States of the person's model of it.
        own: usize,
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

/// Trials that share their covariances.
#[derive(Debug, Clone, PartialEq)]
struct Group {
    /// Where the person's belief starts.
    belief: DVector<f64>,
    /// The trials, with their places among all.
    trials: Vec<(usize, Trial)>,
    /// Fewer trials with the same likelihood, where there are.
    sufficient: Option<Vec<Trial>>,
}

/// Trials with what is known of the person.
#[derive(Debug, Clone, PartialEq)]
pub struct Problem<'a> {
    design: &'a Design,
    groups: Vec<Group>,
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
        let [n, _, _, q] = design.sizes();
        let own = design.width() - n;
        let (channels, outputs) = (design.channels(), design.outputs());
        let mut samples = 0;
        let mut groups: Vec<Group> = Vec::new();
        let is_silent = design.is_control_silent();
        let is_grown = design.has(Role::ControlDependentNoise);
        for (trial, record) in records.iter().enumerate() {
            let parts = [("disturbance", &record.disturbance, q), ("measured signals", &record.measured, channels)];
            for (signal, found, expected) in parts {
                let (rows, columns) = found.shape();
                if columns != expected || rows != record.measured.nrows() || rows == 0 {
                    return Err(RecordError::Size { trial, signal, rows, columns, expected });
                }
            }
            let rows = record.measured.nrows();
            if let Some(horizon) = design.horizon.filter(|horizon| horizon.steps + 1 != rows) {
                return Err(RecordError::Horizon { trial, samples: rows, steps: horizon.steps });
            }
            let [state, belief] = record.initial.clone().unwrap_or_else(|| [DVector::zeros(n), DVector::zeros(own)]);
            if state.len() != n || belief.len() != own {
                return Err(RecordError::Initial { trial, states: n, own });
            }
            let controls = record.measured.columns(outputs, channels - outputs);
            if is_silent && belief.amax() == 0.0 && controls.row(0).amax() > ZERO * controls.amax() {
                return Err(RecordError::NotAtRest { trial });
            }
            samples += rows;
            let one = Trial {
                disturbance: record.disturbance.transpose(),
                measured: record.measured.transpose(),
                start: state.iter().chain(belief.iter()).copied().collect(),
                densities: 1.0,
                weight: 1.0,
            };
            // Noise that grows with the control has other covariances for every start and every disturbance.
            let same = |group: &&mut Group| {
                !is_grown || group.trials.first().is_some_and(|(_, first)| first.has_course_of(&one))
            };
            match groups.iter_mut().find(same) {
                Some(group) => group.trials.push((trial, one)),
                None => groups.push(Group { belief, trials: vec![(trial, one)], sufficient: None }),
            }
        }
        if samples > MAX_SAMPLES {
            return Err(RecordError::TooLong { samples });
        }
        // What noise of the control comes to along a trial is no sum over trials.
        if !course::is_of_each_trial(design) {
            for group in &mut groups {
                let trials: Vec<&Trial> = group.trials.iter().map(|(_, trial)| trial).collect();
                group.sufficient = Trial::sufficient(&trials);
            }
        }
        let parameters = design.free().count();
        let width = design.width();
        let each = (width + channels) * channels * (parameters + 1) + parameters * (parameters + 1);
        // Gains of their own make systems of their own.
        let own_gains = if design.horizon.is_some() { 2 * width * width * (parameters + 1) } else { 0 };
        let most = MAX_NUMBERS / (each + own_gains);
        let found = Self { design, groups, samples };
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
        self.trials().any(|(_, trial)| trial.disturbance.iter().any(|v| *v != 0.0))
    }

    /// Of every output the mean square of its second differences over six, which is the variance of white noise on a
    /// signal that is smooth beside it; positive.
    pub(super) fn roughness(&self) -> Vec<f64> {
        let one = |output: usize| {
            let (mut sum, mut count) = (0.0, 0.0);
            for (_, trial) in self.trials() {
                let y = trial.measured.row(output);
                for k in 2..y.len() {
                    sum += (y[k] - 2.0 * y[k - 1] + y[k - 2]).powi(2);
                    count += 6.0;
                }
            }
            if count > 0.0 && sum > 0.0 { sum / count } else { f64::MIN_POSITIVE.sqrt() }
        };
        (0..self.design.outputs()).map(one).collect()
    }

    /// The trials, with their places.
    fn trials(&self) -> impl Iterator<Item = &(usize, Trial)> {
        self.groups.iter().flat_map(|group| &group.trials)
    }

    /// Log likelihood at θ, with gradient and information if asked; `None` where the person is not defined there, or a
    /// covariance is not positive definite.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn evaluate(&self, theta: &[f64], derivatives: bool, ctl: &Ctl) -> Result<Option<Evaluation>, Stopped> {
        ctl.check()?;
        let mut all = Evaluation::zero(if derivatives { theta.len() } else { 0 });
        for group in &self.groups {
            let Some(course) = self.course(group, theta, derivatives, ctl)? else { return Ok(None) };
            let lots = match &group.sufficient {
                Some(trials) => lots(trials.iter()),
                None => lots(group.trials.iter().map(|(_, trial)| trial)),
            };
            let parts: Result<Vec<_>, Stopped> = lots.par_iter().map(|lot| along(lot, &course, ctl)).collect();
            // One after the other, whoever was ready first.
            for part in parts? {
                let Some(part) = part else { return Ok(None) };
                all.add(&part);
            }
            course.add_traces(group.trials.iter().map(|(_, trial)| trial.measured.ncols()), &mut all);
        }
        let is_finite =
            all.log_likelihood.is_finite() && all.gradient.iter().chain(all.information.iter()).all(|v| v.is_finite());
        Ok(is_finite.then_some(all))
    }

    /// The predictor of a group's trials.
    fn course(&self, group: &Group, theta: &[f64], slopes: bool, ctl: &Ctl) -> Result<Option<Course<'a>>, Stopped> {
        let longest = group.trials.iter().map(|(_, trial)| trial.measured.ncols()).max().unwrap_or(0);
        let Some(gains) = self.design.gains(theta, slopes, Some(&group.belief), &|| ctl.check().is_err()) else {
            // There are none, or somebody asked to stop on the way.
            ctl.check()?;
            return Ok(None);
        };
        let first = group.trials.first().map(|(_, trial)| trial);
        Course::new(self.design, self.design.joints(theta, &gains, slopes), first, longest, ctl)
    }

    /// Prediction errors of every trial at θ in units of their own standard deviations, samples × channels; `None` as
    /// in [`Self::evaluate`].
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn innovations(&self, theta: &[f64], ctl: &Ctl) -> Result<Option<Vec<DMatrix<f64>>>, Stopped> {
        let mut all: Vec<(usize, DMatrix<f64>)> = Vec::new();
        for group in &self.groups {
            let Some(course) = self.course(group, theta, false, ctl)? else { return Ok(None) };
            for (place, trial) in &group.trials {
                let mut errors = DMatrix::zeros(trial.measured.nrows(), trial.measured.ncols());
                if Walker::<1>::along([trial], &course, ctl, Some(&mut errors))?.is_none() {
                    return Ok(None);
                }
                all.push((*place, errors.transpose()));
            }
        }
        all.sort_by_key(|(place, _)| *place);
        Ok(Some(all.into_iter().map(|(_, errors)| errors).collect()))
    }

    /// Samples of the longest trial.
    fn longest(&self) -> usize {
        self.trials().map(|(_, trial)| trial.measured.ncols()).max().unwrap_or(0)
    }
}

impl Evaluation {
    pub(super) fn zero(count: usize) -> Self {
        Self { log_likelihood: 0.0, gradient: DVector::zeros(count), information: DMatrix::zeros(count, count) }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.log_likelihood += other.log_likelihood;
        self.gradient += &other.gradient;
        self.information += &other.information;
    }
}
