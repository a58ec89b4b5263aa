//! The curve of one person: a law with three parameters, fitted by weighted least squares.
//!
//! For a given shape parameter (a rate or an exponent) the other two are a linear problem with a closed form, so that
//! only one dimension is searched: on a grid of its logarithm first, since noisy people have several minima, and then
//! the root of the derivative (variable projection: Golub & Pereyra 1973).

use crate::num::distributions::student_t;
use crate::num::roots::root;
use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Values of the shape parameter that are tried before the refinement, equally spaced on the log scale.
const GRID: usize = 400;
/// A shape parameter this near to its bound, relatively, is at it.
const AT_BOUND: f64 = 1e-6;
/// Known errors that explain less than one over this of the residuals are too small.
const TOO_SMALL: f64 = 2.0;

/// The form of a learning curve over the trial number k = 1, 2, …
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "CurveLaw")]
pub enum Law {
    /// `c + a exp(−(k − 1)/τ)`, τ from 0.5 to 200 trials.
    Exponential,
    /// `c + a k^(−b)`, b from 0.05 to 3.
    Power,
}

impl Law {
    /// Least and largest shape parameter.
    #[must_use]
    pub fn bounds(self) -> (f64, f64) {
        match self {
            Self::Exponential => (0.5, 200.0),
            Self::Power => (0.05, 3.0),
        }
    }

    /// What the amplitude is multiplied with.
    pub(super) fn basis(self, k: f64, shape: f64) -> f64 {
        match self {
            Self::Exponential => (-(k - 1.0) / shape).exp(),
            Self::Power => k.powf(-shape),
        }
    }

    /// Its derivative with respect to the shape parameter.
    fn slope(self, k: f64, shape: f64) -> f64 {
        match self {
            Self::Exponential => self.basis(k, shape) * (k - 1.0) / (shape * shape),
            Self::Power => -k.ln() * self.basis(k, shape),
        }
    }
}

/// A value at a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// The trial's number, from 1.
    pub k: f64,
    /// The value.
    pub value: f64,
    /// The variance of its error: known, or 1 for all where it is to be taken from the residuals.
    pub variance: f64,
}

/// Where the errors of a curve's parameters come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ErrorSource {
    /// Each value's own standard error.
    Known,
    /// The scatter around the curve, taken as equal for all trials of the person.
    Residuals,
}

/// Which bound the shape parameter is at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "ShapeBound")]
pub enum Bound {
    /// The least value.
    Lower,
    /// The largest value.
    Upper,
}

/// A value with its standard error, both in the unit of the metric.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "CurveValue")]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard error.
    pub standard_error: f64,
}

/// The fitted curve of a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PersonFit {
    /// The form.
    pub law: Law,
    /// Trials that the curve is fitted to.
    pub n: usize,
    /// The value approached, c.
    pub asymptote: Estimate,
    /// The distance from it at trial 1, a.
    pub amplitude: Estimate,
    /// τ in trials, or the exponent b.
    pub shape: f64,
    /// The standard error of `shape`; null at a bound.
    pub shape_standard_error: Option<f64>,
    /// The bound that `shape` is at, where it is: then only two parameters were free, and the curve is hardly more than
    /// a step or a line.
    pub at_bound: Option<Bound>,
    /// The 95 % profile interval of `shape`; null on a side where it is open within the bounds.
    #[schemars(with = "Vec<Option<f64>>")]
    pub shape_interval95: [Option<f64>; 2],
    /// Weighted residual sum of squares.
    pub weighted_rss: f64,
    /// It over its degrees of freedom, `weighted_rss/(n − p)`: near 1 where errors are known and right; the variance of
    /// the scatter where they are not known. Null without degrees of freedom.
    pub residual_scale: Option<f64>,
    /// The standard errors are multiplied with the root of this: `residual_scale` where errors come from residuals or
    /// known ones explain less than half of them, 1 otherwise.
    pub variance_factor: f64,
    /// The curve at the study's first trial.
    pub first: Estimate,
    /// The curve at the study's last trial.
    pub last: Estimate,
    /// Last minus first, with the covariance between them.
    pub change: Estimate,
}

/// Why a person has no curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoFit {
    /// Too few trials.
    #[error("{found} trials with a value, and {needed} are needed")]
    TooFew {
        /// Trials with a value at different numbers.
        found: usize,
        /// Trials needed.
        needed: usize,
    },
    /// The parameters do not determine each other, as with values that all lie on a line through one point.
    #[error("the trials do not determine the curve")]
    Undetermined,
    /// The residuals vanish, so that they say nothing of errors.
    #[error("all values lie on one curve to rounding, so that their scatter gives no standard error")]
    NoScatter,
}

/// Weighted sums for one shape parameter.
struct Linear {
    asymptote: f64,
    amplitude: f64,
    rss: f64,
}

struct Problem<'a> {
    law: Law,
    points: &'a [Observation],
}

impl Problem<'_> {
    /// The best asymptote and amplitude for a shape parameter, from centred sums.
    fn linear(&self, shape: f64) -> Linear {
        let (mut w, mut x_mean, mut y_mean) = (0.0, 0.0, 0.0);
        for p in self.points {
            let weight = 1.0 / p.variance;
            w += weight;
            x_mean += weight * self.law.basis(p.k, shape);
            y_mean += weight * p.value;
        }
        (x_mean, y_mean) = (x_mean / w, y_mean / w);
        let (mut xx, mut xy) = (0.0, 0.0);
        for p in self.points {
            let x = self.law.basis(p.k, shape) - x_mean;
            xx += x * x / p.variance;
            xy += x * (p.value - y_mean) / p.variance;
        }
        let amplitude = if xx > 0.0 { xy / xx } else { 0.0 };
        let asymptote = y_mean - amplitude * x_mean;
        let residual = |p: &Observation| p.value - asymptote - amplitude * self.law.basis(p.k, shape);
        let rss = self.points.iter().map(|p| residual(p).powi(2) / p.variance).sum();
        Linear { asymptote, amplitude, rss }
    }

    /// Minus half of the derivative of the residual sum with respect to the shape parameter.
    fn descent(&self, shape: f64) -> f64 {
        let Linear { asymptote, amplitude, .. } = self.linear(shape);
        let term = |p: &Observation| {
            let residual = p.value - asymptote - amplitude * self.law.basis(p.k, shape);
            residual * amplitude * self.law.slope(p.k, shape) / p.variance
        };
        self.points.iter().map(term).sum()
    }
}

fn grid(law: Law) -> Vec<f64> {
    let (low, high) = law.bounds();
    let (low, high) = (low.ln(), high.ln());
    (0..GRID).map(|i| low + (high - low) * i as f64 / (GRID - 1) as f64).collect()
}

/// The shape parameter that minimises `rss`, given by its logarithm, and the bound that it is at.
///
/// `descent` has the sign of −d rss/d shape.
pub(super) fn best_shape(
    law: Law,
    rss: impl Fn(f64) -> f64,
    descent: impl Fn(f64) -> f64,
) -> (f64, Option<Bound>, Vec<(f64, f64)>) {
    let profile: Vec<(f64, f64)> = grid(law).into_iter().map(|x| (x, rss(x.exp()))).collect();
    let least = (0..GRID).min_by(|a, b| profile[*a].1.total_cmp(&profile[*b].1)).unwrap_or(0);
    let (from, to) = (profile[least.saturating_sub(1)].0, profile[(least + 1).min(GRID - 1)].0);
    let (low, high) = law.bounds();
    let inside = root(|x| descent(x.exp()), from, to).map(f64::exp);
    let (shape, bound) = match inside {
        Some(shape) if shape < low * (1.0 + AT_BOUND) => (low, Some(Bound::Lower)),
        Some(shape) if shape > high * (1.0 - AT_BOUND) => (high, Some(Bound::Upper)),
        Some(shape) => (shape, None),
        None if least == 0 => (low, Some(Bound::Lower)),
        None if least == GRID - 1 => (high, Some(Bound::Upper)),
        None => (profile[least].0.exp(), None),
    };
    (shape, bound, profile)
}

/// Where `profile` (log shape, residual sum) first and last crosses `threshold`; `None` on a side where it never does.
pub(super) fn crossings(profile: &[(f64, f64)], rss: impl Fn(f64) -> f64, threshold: f64) -> [Option<f64>; 2] {
    let inside = |point: &(f64, f64)| point.1 <= threshold;
    let excess = |x: f64| rss(x.exp()) - threshold;
    let (Some(first), Some(last)) = (profile.iter().position(inside), profile.iter().rposition(inside)) else {
        return [None, None];
    };
    let low = first.checked_sub(1).and_then(|before| root(excess, profile[before].0, profile[first].0));
    let high = profile.get(last + 1).and_then(|after| root(excess, profile[last].0, after.0));
    [low.map(f64::exp), high.map(f64::exp)]
}

/// Fits a law to a person's trials, and evaluates it at the study's `first` and `last` trial.
///
/// `Σ (y_k − c − a f(k; shape))²/v_k` is minimised. The covariance of the parameters is `(JᵀWJ)⁻¹`, the errors of the
/// curve follow by the delta method. At a bound the shape parameter counts as known. The profile interval of the shape
/// holds those whose residual sum exceeds the least by no more than 3.84 (known errors) or `s² t²(n − p)` (residuals).
///
/// # Errors
/// [`NoFit`].
pub fn fit(law: Law, points: &[Observation], errors: ErrorSource, first: f64, last: f64) -> Result<PersonFit, NoFit> {
    let mut numbers: Vec<f64> = points.iter().map(|p| p.k).collect();
    numbers.sort_by(f64::total_cmp);
    numbers.dedup();
    // With errors from residuals one degree of freedom must be left.
    let needed = if errors == ErrorSource::Known { 3 } else { 4 };
    if numbers.len() < needed {
        return Err(NoFit::TooFew { found: numbers.len(), needed });
    }
    let problem = Problem { law, points };
    let rss = |shape: f64| problem.linear(shape).rss;
    let (shape, at_bound, profile) = best_shape(law, rss, |shape| problem.descent(shape));
    let Linear { asymptote, amplitude, rss: weighted_rss } = problem.linear(shape);
    let free = if at_bound.is_some() { 2 } else { 3 };
    let gradient = |k: f64| {
        let slope = if at_bound.is_some() { 0.0 } else { amplitude * law.slope(k, shape) };
        Vector3::new(1.0, law.basis(k, shape), slope)
    };
    let covariance = covariance(points, gradient, free).ok_or(NoFit::Undetermined)?;
    let degrees = points.len() - free;
    let residual_scale = (degrees > 0).then(|| weighted_rss / degrees as f64);
    let (variance_factor, allowed) = match (errors, residual_scale) {
        (ErrorSource::Known, scale) => {
            (scale.filter(|s| *s > TOO_SMALL).unwrap_or(1.0), student_t(0.95, f64::INFINITY))
        }
        (ErrorSource::Residuals, Some(scale)) => (scale, student_t(0.95, degrees as f64)),
        (ErrorSource::Residuals, None) => return Err(NoFit::TooFew { found: points.len(), needed }),
    };
    let size = points.iter().map(|p| p.value * p.value / p.variance).sum::<f64>();
    if errors == ErrorSource::Residuals && weighted_rss <= 1e-26 * size {
        return Err(NoFit::NoScatter);
    }
    let value = |k: f64| asymptote + amplitude * law.basis(k, shape);
    let estimate = |value: f64, along: Vector3<f64>| Estimate {
        value,
        standard_error: (variance_factor * along.dot(&(covariance * along)).max(0.0)).sqrt(),
    };
    let (at_first, at_last) = (gradient(first), gradient(last));
    // Known errors that are too small widen the profile as they widen everything else.
    let threshold = weighted_rss + variance_factor * allowed * allowed;
    let fit = PersonFit {
        law,
        n: points.len(),
        asymptote: estimate(asymptote, Vector3::x()),
        amplitude: estimate(amplitude, Vector3::y()),
        shape,
        shape_standard_error: at_bound.is_none().then(|| estimate(shape, Vector3::z()).standard_error),
        at_bound,
        shape_interval95: crossings(&profile, rss, threshold),
        weighted_rss,
        residual_scale,
        variance_factor,
        first: estimate(value(first), at_first),
        last: estimate(value(last), at_last),
        change: estimate(value(last) - value(first), at_last - at_first),
    };
    let all = [fit.asymptote, fit.amplitude, fit.first, fit.last, fit.change];
    let is_finite = |e: &Estimate| e.value.is_finite() && e.standard_error.is_finite();
    if all.iter().all(is_finite) { Ok(fit) } else { Err(NoFit::Undetermined) }
}

/// `(JᵀWJ)⁻¹` of the first `free` parameters; the others have none.
fn covariance(points: &[Observation], gradient: impl Fn(f64) -> Vector3<f64>, free: usize) -> Option<Matrix3<f64>> {
    let mut information = Matrix3::zeros();
    for p in points {
        let g = gradient(p.k);
        information += g * g.transpose() / p.variance;
    }
    if free == 2 {
        information[(2, 2)] = 1.0;
    }
    // Columns of unit length, so that units do not decide what is singular.
    let scale = information.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
    let scaled = Matrix3::from_fn(|i, j| information[(i, j)] * scale[i] * scale[j]);
    let inverse = scaled.cholesky()?.inverse();
    let mut covariance = Matrix3::from_fn(|i, j| inverse[(i, j)] * scale[i] * scale[j]);
    if free == 2 {
        covariance[(2, 2)] = 0.0;
    }
    covariance.iter().all(|c| c.is_finite()).then_some(covariance)
}

/// A shape parameter that all people share, each with asymptote and amplitude of their own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SharedShape {
    /// The law.
    pub law: Law,
    /// τ in trials, or the exponent b.
    pub shape: f64,
    /// The bound that it is at, where it is.
    pub at_bound: Option<Bound>,
    /// The 95 % profile interval; null on a side where it is open within the bounds.
    #[schemars(with = "Vec<Option<f64>>")]
    pub interval95: [Option<f64>; 2],
}

/// The shape parameter that minimises the sum of squares over all people; `None` without a degree of freedom.
#[must_use]
pub fn shared_shape(law: Law, people: &[Vec<Observation>]) -> Option<SharedShape> {
    let problems: Vec<Problem> = people.iter().map(|points| Problem { law, points }).collect();
    let trials: usize = people.iter().map(Vec::len).sum();
    let degrees = trials.checked_sub(2 * people.len() + 1).filter(|d| *d > 0)? as f64;
    let rss = |shape: f64| problems.iter().map(|p| p.linear(shape).rss).sum::<f64>();
    let descent = |shape: f64| problems.iter().map(|p| p.descent(shape)).sum::<f64>();
    let (shape, at_bound, profile) = best_shape(law, rss, descent);
    let least = rss(shape);
    let threshold = least * (1.0 + student_t(0.95, degrees).powi(2) / degrees);
    Some(SharedShape { law, shape, at_bound, interval95: crossings(&profile, rss, threshold) })
}
