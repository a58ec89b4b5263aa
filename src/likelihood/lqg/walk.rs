//! The predictor along a trial.

use super::course::Course;
use super::covariance::{Scratch, State, Step, step};
use super::jet::Jet;
use super::recursion::Evaluation;
use crate::ctl::{Ctl, Stopped};
use nalgebra::DMatrix;

/// Samples of a trial between two questions whether to go on.
const SAMPLES_BETWEEN_CHECKS: usize = 20_000;
/// The same where each has a covariance of its own.
const STEPS_BETWEEN_CHECKS: usize = 5;

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

/// A number of each of some trials.
type Lanes<const N: usize> = [f64; N];

/// `out += sign · A x`.
fn add<const N: usize>(out: &mut [Lanes<N>], a: &[f64], x: &[Lanes<N>], sign: f64) {
    let rows = out.len();
    for (column, x) in a.chunks_exact(rows).zip(x) {
        for (out, factor) in out.iter_mut().zip(column) {
            let factor = sign * factor;
            for lane in 0..N {
                out[lane] += factor * x[lane];
            }
        }
    }
}

/// `Σ_i Σ_lane w_lane x_i y_i`.
fn dot<const N: usize>(x: &[Lanes<N>], y: &[Lanes<N>], weights: &Lanes<N>) -> f64 {
    let mut sums = [0.0; N];
    for (x, y) in x.iter().zip(y) {
        for lane in 0..N {
            sums[lane] += x[lane] * y[lane];
        }
    }
    sums.iter().zip(weights).map(|(sum, weight)| sum * weight).sum()
}

/// Where the predictors of some trials of one length are.
pub(super) struct Walker<const N: usize> {
    s: Vec<Lanes<N>>,
    s_next: Vec<Lanes<N>>,
    /// One after the other, as of all derivatives.
    ds: Vec<Lanes<N>>,
    ds_next: Vec<Lanes<N>>,
    e: Vec<Lanes<N>>,
    de: Vec<Lanes<N>>,
    weighted: Vec<Lanes<N>>,
    turned: Vec<Lanes<N>>,
    z: Vec<Lanes<N>>,
    d: Vec<Lanes<N>>,
    weights: Lanes<N>,
    densities: f64,
    result: Evaluation,
}

/// Trials that are gone through together.
const TOGETHER: usize = 4;

/// The likelihood of trials of one course; the information is that of the prediction errors, and traces are left to
/// [`Course::add_traces`] where covariances are those of all trials. `None` where a covariance is not positive
/// definite.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub(super) fn along(trials: &[&Trial], course: &Course<'_>, ctl: &Ctl) -> Result<Option<Evaluation>, Stopped> {
    match trials {
        [a, b, c, d] if course.step(0).is_some() => Walker::<TOGETHER>::along([a, b, c, d], course, ctl, None),
        _ => {
            let mut all = Evaluation::zero(course.count());
            for trial in trials {
                let Some(part) = Walker::<1>::along([trial], course, ctl, None)? else { return Ok(None) };
                all.add(&part);
            }
            Ok(Some(all))
        }
    }
}

/// Trials in lots that are gone through together: of one length.
pub(super) fn lots<'a>(trials: impl Iterator<Item = &'a Trial>) -> Vec<Vec<&'a Trial>> {
    let mut found: Vec<Vec<&Trial>> = Vec::new();
    for trial in trials {
        match found.last_mut() {
            Some(lot) if lot.len() < TOGETHER && lot[0].measured.ncols() == trial.measured.ncols() => lot.push(trial),
            _ => found.push(vec![trial]),
        }
    }
    found
}

impl<const N: usize> Walker<N> {
    /// The likelihood of these trials, as [`along`]. `errors`, channels × samples, takes the errors of the first one in
    /// units of their own standard deviations.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub(super) fn along(
        trials: [&Trial; N],
        course: &Course<'_>,
        ctl: &Ctl,
        mut errors: Option<&mut DMatrix<f64>>,
    ) -> Result<Option<Evaluation>, Stopped> {
        let (channels, width) = course.joint(0).h.shape();
        let count = course.count();
        let q = trials[0].disturbance.nrows();
        let zero = [0.0; N];
        let gather = |into: &mut [Lanes<N>], of: &dyn Fn(&Trial, usize) -> f64| {
            for (i, lanes) in into.iter_mut().enumerate() {
                *lanes = trials.map(|trial| of(trial, i));
            }
        };
        let mut walker = Self {
            s: vec![zero; width],
            s_next: vec![zero; width],
            ds: vec![zero; width * count],
            ds_next: vec![zero; width],
            e: vec![zero; channels],
            de: vec![zero; channels * count],
            weighted: vec![zero; channels],
            turned: vec![zero; channels],
            z: vec![zero; channels],
            d: vec![zero; q],
            weights: trials.map(|trial| trial.weight),
            densities: trials.iter().map(|trial| trial.densities).sum(),
            result: Evaluation::zero(count),
        };
        gather(&mut walker.s, &|trial, i| trial.start[i]);
        // The covariance of this trial alone, where it has one.
        let mut own: Option<(State, Scratch)> = if course.step(0).is_none() {
            let Some(state) = course.first() else { return Ok(None) };
            let scratch = Scratch::new(width, channels, &state);
            Some((state, scratch))
        } else {
            None
        };
        let between = if own.is_some() { STEPS_BETWEEN_CHECKS } else { SAMPLES_BETWEEN_CHECKS };
        for k in 0..trials[0].measured.ncols() {
            if k % between == 0 {
                ctl.check()?;
            }
            gather(&mut walker.z, &|trial, i| trial.measured[(i, k)]);
            gather(&mut walker.d, &|trial, i| trial.disturbance[(i, k)]);
            walker.miss(course, k);
            match &mut own {
                None => {
                    let Some(step) = course.step(k) else { return Ok(None) };
                    note(&mut errors, k, &walker.e, step);
                    walker.take(course, k, step);
                }
                Some((state, scratch)) => {
                    let first = |lanes: &[Lanes<N>]| lanes.iter().map(|lane| lane[0]).collect::<Vec<f64>>();
                    let s = Jet::column(&first(&walker.s), &first(&walker.ds));
                    let e = Jet::column(&first(&walker.e), &first(&walker.de));
                    let Some(grown) = course.grown_by_data(k, state, [&s, &e]) else { return Ok(None) };
                    let Some(step) = step(course.joint(k), &grown, state, course.told(k), scratch) else {
                        return Ok(None);
                    };
                    std::mem::swap(state, &mut scratch.next);
                    step.add_traces(walker.densities, &mut walker.result);
                    note(&mut errors, k, &walker.e, &step);
                    walker.take(course, k, &step);
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
    fn miss(&mut self, course: &Course<'_>, k: usize) {
        let joint = course.joint(k);
        let channels = self.e.len();
        let width = self.s.len();
        self.e.copy_from_slice(&self.z);
        add(&mut self.e, joint.h.value(), &self.s, -1.0);
        add(&mut self.e, joint.through.value(), &self.d, -1.0);
        for i in 0..course.count() {
            let de = &mut self.de[i * channels..(i + 1) * channels];
            de.fill([0.0; N]);
            add(de, joint.h.value(), &self.ds[i * width..(i + 1) * width], -1.0);
            if let Some(dh) = joint.h.slope(i) {
                add(de, dh, &self.s, -1.0);
            }
            if let Some(through) = joint.through.slope(i) {
                add(de, through, &self.d, -1.0);
            }
        }
    }

    /// Takes a sample in, and goes on to the next.
    fn take(&mut self, course: &Course<'_>, k: usize, step: &Step) {
        let joint = course.joint(k);
        let (channels, width, count) = (self.e.len(), self.s.len(), course.count());
        let constant = (2.0 * std::f64::consts::PI).ln();
        let none = [0.0; N];
        self.weighted.fill(none);
        add(&mut self.weighted, &step.inverse, &self.e, 1.0);
        let densities = self.densities * (step.log_det + step.told as f64 * constant);
        self.result.log_likelihood -= 0.5 * (densities + dot(&self.e, &self.weighted, &self.weights));
        let (gain, sigma) = (width * channels, channels * channels);
        for i in 0..count {
            let de = &self.de[i * channels..(i + 1) * channels];
            let ds = &mut self.ds[i * width..(i + 1) * width];
            self.ds_next.fill(none);
            add(&mut self.ds_next, joint.f.value(), ds, 1.0);
            if let Some(df) = joint.f.slope(i) {
                add(&mut self.ds_next, df, &self.s, 1.0);
            }
            if let Some(drive) = joint.drive.slope(i) {
                add(&mut self.ds_next, drive, &self.d, 1.0);
            }
            add(&mut self.ds_next, &step.gain_slopes[i * gain..(i + 1) * gain], &self.e, 1.0);
            add(&mut self.ds_next, &step.gain, de, 1.0);
            ds.copy_from_slice(&self.ds_next);
            self.turned.fill(none);
            add(&mut self.turned, &step.sigma_slopes[i * sigma..(i + 1) * sigma], &self.weighted, 1.0);
            let moved = 0.5 * dot(&self.weighted, &self.turned, &self.weights);
            self.result.gradient[i] += moved - dot(de, &self.weighted, &self.weights);
        }
        for i in 0..count {
            self.turned.fill(none);
            add(&mut self.turned, &step.inverse, &self.de[i * channels..(i + 1) * channels], 1.0);
            for j in 0..=i {
                self.result.information[(i, j)] +=
                    dot(&self.turned, &self.de[j * channels..(j + 1) * channels], &self.weights);
            }
        }
        self.s_next.fill(none);
        add(&mut self.s_next, joint.f.value(), &self.s, 1.0);
        add(&mut self.s_next, joint.drive.value(), &self.d, 1.0);
        add(&mut self.s_next, &step.gain, &self.e, 1.0);
        std::mem::swap(&mut self.s, &mut self.s_next);
    }
}

/// Writes an error down in units of its deviation; zero of a channel that tells nothing.
fn note<const N: usize>(errors: &mut Option<&mut DMatrix<f64>>, k: usize, e: &[Lanes<N>], step: &Step) {
    if let Some(errors) = errors {
        for ((entry, value), deviation) in errors.column_mut(k).iter_mut().zip(e).zip(&step.deviations) {
            *entry = if *deviation > 0.0 { value[0] / deviation } else { 0.0 };
        }
    }
}
