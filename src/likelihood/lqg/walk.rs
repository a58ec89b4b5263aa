//! The predictor along a trial.

use super::course::Course;
use super::covariance::{Scratch, State, Step, step};
use super::jet::Jet;
use super::kernel::{add, dot};
use super::recursion::Evaluation;
use crate::ctl::{Ctl, Stopped};
use nalgebra::DMatrix;

/// Samples of a trial between two questions whether to go on.
const SAMPLES_BETWEEN_CHECKS: usize = 20_000;
/// The same where each has a covariance of its own.
const STEPS_BETWEEN_CHECKS: usize = 200;

/// A trial as the recursion takes it, sample by sample.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Trial {
    /// d, q × samples.
    pub disturbance: DMatrix<f64>,
    /// z, channels × samples.
    pub measured: DMatrix<f64>,
    /// s at the first sample.
    pub start: Vec<f64>,
    /// Densities that it stands for: times that determinants and constants count.
    pub densities: f64,
    /// Times that its squares count.
    pub weight: f64,
}

impl Trial {
    /// Whether the expected course of another is that of this one.
    pub(super) fn has_course_of(&self, other: &Self) -> bool {
        self.start == other.start && self.disturbance == other.disturbance
    }

    /// Fewer trials with the same likelihood; `None` where there are none.
    ///
    /// Of trials with one course the errors are one linear map of the records. Mean and scatter tell all: the mean
    /// stands for all densities, and the scatter's root, by rows, for trials without a density around zero.
    pub(super) fn sufficient(trials: &[&Self]) -> Option<Vec<Self>> {
        let mut rest: Vec<&Self> = trials.to_vec();
        let mut found = Vec::new();
        while let Some(first) = rest.first().copied() {
            let (same, others): (Vec<&Self>, Vec<&Self>) = rest.into_iter().partition(|t| first.has_course_of(t));
            rest = others;
            let (channels, samples) = first.measured.shape();
            if same.len() <= channels * samples + 1 {
                found.extend(same.into_iter().cloned());
                continue;
            }
            let number = same.len() as f64;
            let mean = same.iter().fold(DMatrix::zeros(channels, samples), |sum, t| sum + &t.measured) / number;
            let scatter = DMatrix::from_fn(same.len(), channels * samples, |row, column| {
                same[row].measured.as_slice()[column] - mean.as_slice()[column]
            });
            for row in scatter.qr().r().row_iter() {
                found.push(Self {
                    disturbance: DMatrix::zeros(first.disturbance.nrows(), samples),
                    measured: DMatrix::from_iterator(channels, samples, row.iter().copied()),
                    start: vec![0.0; first.start.len()],
                    densities: 0.0,
                    weight: 1.0,
                });
            }
            found.push(Self { measured: mean, densities: number, weight: number, ..first.clone() });
        }
        (found.len() < trials.len()).then_some(found)
    }
}

/// Where the predictor is.
pub(super) struct Walker {
    s: Vec<f64>,
    s_next: Vec<f64>,
    /// One after the other, as of all derivatives.
    ds: Vec<f64>,
    ds_next: Vec<f64>,
    e: Vec<f64>,
    de: Vec<f64>,
    weighted: Vec<f64>,
    turned: Vec<f64>,
    result: Evaluation,
}

impl Walker {
    /// The likelihood of a trial; the information is that of the prediction errors, and traces are left to
    /// [`Course::add_traces`] where covariances are those of all trials. `None` where a covariance is not positive
    /// definite. `errors`, channels × samples, takes the errors in units of their own standard deviations.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub(super) fn along(
        trial: &Trial,
        course: &Course<'_>,
        ctl: &Ctl,
        mut errors: Option<&mut DMatrix<f64>>,
    ) -> Result<Option<Evaluation>, Stopped> {
        let (channels, width) = course.joint(0).h.shape();
        let count = course.count();
        let mut walker = Self {
            s: trial.start.clone(),
            s_next: vec![0.0; width],
            ds: vec![0.0; width * count],
            ds_next: vec![0.0; width],
            e: vec![0.0; channels],
            de: vec![0.0; channels * count],
            weighted: vec![0.0; channels],
            turned: vec![0.0; channels],
            result: Evaluation::zero(count),
        };
        // The covariance of this trial alone, where it has one.
        let mut own: Option<(State, Scratch)> = if course.step(0).is_none() {
            let Some(state) = course.first() else { return Ok(None) };
            let scratch = Scratch::new(width, channels, &state);
            Some((state, scratch))
        } else {
            None
        };
        let between = if own.is_some() { STEPS_BETWEEN_CHECKS } else { SAMPLES_BETWEEN_CHECKS };
        let q = trial.disturbance.nrows();
        let samples = trial.measured.as_slice().chunks_exact(channels);
        for (k, (z, d)) in samples.zip(trial.disturbance.as_slice().chunks_exact(q)).enumerate() {
            if k % between == 0 {
                ctl.check()?;
            }
            walker.miss(course, k, z, d);
            match &mut own {
                None => {
                    let Some(step) = course.step(k) else { return Ok(None) };
                    walker.take(course, k, step, d, trial);
                    note(&mut errors, k, &walker.e, step);
                }
                Some((state, scratch)) => {
                    let (s, e) = (Jet::column(&walker.s, &walker.ds), Jet::column(&walker.e, &walker.de));
                    let Some(grown) = course.grown_by_data(k, state, [&s, &e]) else { return Ok(None) };
                    let Some(step) = step(course.joint(k), &grown, state, course.told(k), scratch) else {
                        return Ok(None);
                    };
                    std::mem::swap(state, &mut scratch.next);
                    step.add_traces(trial.densities, &mut walker.result);
                    walker.take(course, k, &step, d, trial);
                    note(&mut errors, k, &walker.e, &step);
                }
            }
        }
        let mut result = walker.result;
        for i in 0..count {
            for j in 0..i {
                result.information[(j, i)] = result.information[(i, j)];
            }
        }
        Ok(Some(result))
    }

    /// The error of a sample, with its derivatives.
    fn miss(&mut self, course: &Course<'_>, k: usize, z: &[f64], d: &[f64]) {
        let joint = course.joint(k);
        let channels = self.e.len();
        let width = self.s.len();
        self.e.copy_from_slice(z);
        add(&mut self.e, joint.h.value(), &self.s, -1.0);
        add(&mut self.e, joint.through.value(), d, -1.0);
        for i in 0..course.count() {
            let de = &mut self.de[i * channels..(i + 1) * channels];
            de.fill(0.0);
            add(de, joint.h.value(), &self.ds[i * width..(i + 1) * width], -1.0);
            if let Some(dh) = joint.h.slope(i) {
                add(de, dh, &self.s, -1.0);
            }
            if let Some(through) = joint.through.slope(i) {
                add(de, through, d, -1.0);
            }
        }
    }

    /// Takes a sample in, and goes on to the next.
    fn take(&mut self, course: &Course<'_>, k: usize, step: &Step, d: &[f64], trial: &Trial) {
        let joint = course.joint(k);
        let (channels, width, count) = (self.e.len(), self.s.len(), course.count());
        let constant = (2.0 * std::f64::consts::PI).ln();
        self.weighted.fill(0.0);
        add(&mut self.weighted, &step.inverse, &self.e, 1.0);
        let densities = trial.densities * (step.log_det + step.told as f64 * constant);
        self.result.log_likelihood -= 0.5 * (densities + trial.weight * dot(&self.e, &self.weighted));
        let (gain, sigma) = (width * channels, channels * channels);
        for i in 0..count {
            let de = &self.de[i * channels..(i + 1) * channels];
            let ds = &mut self.ds[i * width..(i + 1) * width];
            self.ds_next.fill(0.0);
            add(&mut self.ds_next, joint.f.value(), ds, 1.0);
            if let Some(df) = joint.f.slope(i) {
                add(&mut self.ds_next, df, &self.s, 1.0);
            }
            if let Some(drive) = joint.drive.slope(i) {
                add(&mut self.ds_next, drive, d, 1.0);
            }
            add(&mut self.ds_next, &step.gain_slopes[i * gain..(i + 1) * gain], &self.e, 1.0);
            add(&mut self.ds_next, &step.gain, de, 1.0);
            ds.copy_from_slice(&self.ds_next);
            self.turned.fill(0.0);
            add(&mut self.turned, &step.sigma_slopes[i * sigma..(i + 1) * sigma], &self.weighted, 1.0);
            let moved = 0.5 * dot(&self.weighted, &self.turned) - dot(de, &self.weighted);
            self.result.gradient[i] += trial.weight * moved;
        }
        for i in 0..count {
            self.turned.fill(0.0);
            add(&mut self.turned, &step.inverse, &self.de[i * channels..(i + 1) * channels], 1.0);
            for j in 0..=i {
                let shared = dot(&self.turned, &self.de[j * channels..(j + 1) * channels]);
                self.result.information[(i, j)] += trial.weight * shared;
            }
        }
        self.s_next.fill(0.0);
        add(&mut self.s_next, joint.f.value(), &self.s, 1.0);
        add(&mut self.s_next, joint.drive.value(), d, 1.0);
        add(&mut self.s_next, &step.gain, &self.e, 1.0);
        std::mem::swap(&mut self.s, &mut self.s_next);
    }
}

/// Writes an error down in units of its deviation; zero of a channel that tells nothing.
fn note(errors: &mut Option<&mut DMatrix<f64>>, k: usize, e: &[f64], step: &Step) {
    if let Some(errors) = errors {
        for ((entry, value), deviation) in errors.column_mut(k).iter_mut().zip(e).zip(&step.deviations) {
            *entry = if *deviation > 0.0 { value / deviation } else { 0.0 };
        }
    }
}
