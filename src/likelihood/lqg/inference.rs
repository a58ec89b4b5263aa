//! How well the parameters are known: standard errors, profiles of the likelihood, and what is refused.
//!
//! The observed information is the difference quotient of exact gradients, and its inverse the covariance of the
//! logarithms. Where outputs alone are recorded the likelihood is far from a parabola: intervals are those of the
//! likelihood ratio, `2(log p(θ̂) − max_{θ_i = t} log p) ≤ χ²₁`, with all other parameters climbed anew at every t.

use super::climb::{Climbed, climb};
use super::recursion::Problem;
use crate::ctl::{Ctl, Stopped};
use crate::num::distributions::chi_square_quantile;
use crate::num::linalg::symmetric;
use nalgebra::DMatrix;

/// A logarithm with a larger standard error is refused: the parameter is not known to a factor of four.
pub const LARGEST_ERROR: f64 = 0.7;
/// A logarithm with a larger one has no profile: its interval would be refused as well.
const PROFILED: f64 = 2.0;
/// An interval that is not closed at this distance in the logarithm, a factor of ten thousand, is open.
const FAR: f64 = 9.210_340_371_976_184;
/// The step of the difference quotients of gradients, in the logarithm.
const DIFFERENCE: f64 = 1e-3;
/// How near the root of the likelihood ratio must come to its quantile.
const CLOSE: f64 = 0.005;
/// Points of one side of a profile at most.
const POINTS: usize = 25;
/// A point of a profile that is likelier than the answer by more is a better answer.
const BETTER: f64 = 1e-3;
/// Better answers that are taken at most.
const RESTARTS: usize = 4;
/// Added to the diagonal of a singular information, relative to it: its null directions get errors that are refused.
const RIDGE: f64 = 1e-10;

/// Why no number is given for a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Refusal {
    /// The standard error of its logarithm is too large.
    StandardError(f64),
    /// Its interval is open: below, above.
    Open([bool; 2]),
    /// Its interval is wider than that of the largest standard error that is taken: the half of it, in quantiles.
    Wide(f64),
    /// It ran to a bound, a factor of a hundred million from its start.
    AtBound,
}

/// What is known of the parameters; all of logarithms.
#[derive(Debug, Clone, PartialEq)]
pub struct Inference {
    /// The covariance, zero for those at a bound.
    pub covariance: DMatrix<f64>,
    /// The information that it is the inverse of.
    pub information: DMatrix<f64>,
    /// Whether the observed information is positive definite; otherwise `information` is the expected one.
    pub is_observed: bool,
    /// Standard errors; none at a bound.
    pub standard_errors: Vec<Option<f64>>,
    /// Ends of the profile intervals; none where an end is open, or was not looked for.
    pub intervals: Vec<[Option<f64>; 2]>,
    /// Why a parameter is refused, if it is.
    pub refusals: Vec<Option<Refusal>>,
    /// The largest step of Newton's method that is left, in standard errors.
    pub remaining_step: f64,
    /// Evaluations with derivatives.
    pub evaluations: usize,
}

/// The outcome of a side of a profile.
enum Side {
    Closed(f64),
    Open,
    Better(Box<Climbed>),
}

/// What is known at the best climb, for intervals of this level; with the answer, which a profile may have bettered.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub fn inference(
    problem: &Problem<'_>,
    best: Climbed,
    bounds: &[[f64; 2]],
    level: f64,
    ctl: &Ctl,
) -> Result<(Climbed, Inference), Stopped> {
    let mut best = best;
    let mut restarts = 0;
    loop {
        let known = local(problem, &best, ctl)?;
        let mut found = known.clone();
        ctl.set_total(2 * best.theta.len() as u64);
        match profiles(problem, &best, &mut found, bounds, level, ctl)? {
            Some(better) if restarts < RESTARTS => {
                restarts += 1;
                best = *better;
            }
            _ => return Ok((best, found)),
        }
    }
}

/// Information, covariance and errors, without profiles.
pub(super) fn local(problem: &Problem<'_>, best: &Climbed, ctl: &Ctl) -> Result<Inference, Stopped> {
    let count = best.theta.len();
    let free: Vec<usize> = (0..count).filter(|i| best.at_bound[*i] == 0).collect();
    let part = |m: &DMatrix<f64>| DMatrix::from_fn(free.len(), free.len(), |i, j| m[(free[i], free[j])]);
    let expected = part(&best.evaluation.information);
    let mut observed = Some(DMatrix::zeros(free.len(), free.len()));
    let mut evaluations = 0;
    for (column, i) in free.iter().enumerate() {
        let mut gradient = |sign: f64| -> Result<_, Stopped> {
            let mut moved = best.theta.clone();
            moved[*i] += sign * DIFFERENCE;
            evaluations += 1;
            Ok(problem.evaluate(&moved, true, ctl)?.map(|found| found.gradient))
        };
        let (up, down) = (gradient(1.0)?, gradient(-1.0)?);
        observed = match (observed, up, down) {
            (Some(mut observed), Some(up), Some(down)) => {
                for (row, j) in free.iter().enumerate() {
                    observed[(row, column)] = (down[*j] - up[*j]) / (2.0 * DIFFERENCE);
                }
                Some(observed)
            }
            _ => None,
        };
    }
    let observed = observed.map(|m| symmetric(&m)).filter(is_definite);
    let is_observed = observed.is_some();
    let chosen = observed.unwrap_or_else(|| {
        let mut expected = symmetric(&expected);
        for i in 0..free.len() {
            expected[(i, i)] += RIDGE * expected[(i, i)].max(f64::MIN_POSITIVE.sqrt());
        }
        expected
    });
    let inverse = chosen.clone().cholesky().map_or_else(
        || DMatrix::from_diagonal(&chosen.diagonal().map(|v| 1.0 / (RIDGE * v.max(f64::MIN_POSITIVE.sqrt())))),
        |factor| factor.inverse(),
    );
    let (mut information, mut covariance) = (DMatrix::zeros(count, count), DMatrix::zeros(count, count));
    for (row, i) in free.iter().enumerate() {
        for (column, j) in free.iter().enumerate() {
            information[(*i, *j)] = chosen[(row, column)];
            covariance[(*i, *j)] = inverse[(row, column)];
        }
    }
    let standard_errors: Vec<Option<f64>> =
        (0..count).map(|i| (best.at_bound[i] == 0).then(|| covariance[(i, i)].max(0.0).sqrt())).collect();
    let step = &covariance * &best.evaluation.gradient;
    let remaining_step =
        free.iter().map(|i| step[*i].abs() / covariance[(*i, *i)].sqrt().max(f64::MIN_POSITIVE)).fold(0.0, f64::max);
    Ok(Inference {
        covariance,
        information,
        is_observed,
        standard_errors,
        intervals: vec![[None; 2]; count],
        refusals: vec![None; count],
        remaining_step,
        evaluations,
    })
}

/// Whether a symmetric matrix is positive definite by more than rounding, in units of its own diagonal.
fn is_definite(m: &DMatrix<f64>) -> bool {
    let diagonal = m.diagonal();
    if diagonal.iter().any(|v| *v <= 0.0 || !v.is_finite()) {
        return false;
    }
    let scaled = DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)] / (diagonal[i] * diagonal[j]).sqrt());
    scaled.is_empty() || scaled.symmetric_eigenvalues().min() > RIDGE
}

/// Fills intervals and refusals in; a better answer where a profile found one.
fn profiles(
    problem: &Problem<'_>,
    best: &Climbed,
    known: &mut Inference,
    bounds: &[[f64; 2]],
    level: f64,
    ctl: &Ctl,
) -> Result<Option<Box<Climbed>>, Stopped> {
    let quantile = chi_square_quantile(level, 1.0).sqrt();
    for i in 0..best.theta.len() {
        let Some(error) = known.standard_errors[i] else {
            known.refusals[i] = Some(Refusal::AtBound);
            ctl.advance(2);
            continue;
        };
        let mut open = [false; 2];
        if error <= PROFILED {
            for (end, sign) in [-1.0, 1.0].into_iter().enumerate() {
                match side(problem, best, known, i, sign, quantile, bounds, ctl)? {
                    Side::Closed(value) => known.intervals[i][end] = Some(value),
                    Side::Open => open[end] = true,
                    Side::Better(better) => return Ok(Some(better)),
                }
                ctl.advance(1);
            }
        } else {
            ctl.advance(2);
        }
        // A standard error takes a parameter at a bound for known, and the likelihood for a parabola.
        let half = match known.intervals[i] {
            [Some(low), Some(high)] => 0.5 * (high - low) / quantile,
            _ => 0.0,
        };
        known.refusals[i] = if error > LARGEST_ERROR {
            Some(Refusal::StandardError(error))
        } else if open != [false; 2] {
            Some(Refusal::Open(open))
        } else if half > LARGEST_ERROR {
            Some(Refusal::Wide(half))
        } else {
            None
        };
    }
    Ok(None)
}

/// Where the profile of a parameter falls by the quantile on one side.
#[allow(clippy::too_many_arguments)]
fn side(
    problem: &Problem<'_>,
    best: &Climbed,
    known: &mut Inference,
    i: usize,
    sign: f64,
    quantile: f64,
    bounds: &[[f64; 2]],
    ctl: &Ctl,
) -> Result<Side, Stopped> {
    let count = best.theta.len();
    let top = best.evaluation.log_likelihood;
    let free: Vec<bool> = (0..count).map(|j| j != i).collect();
    let mut bounds = bounds.to_vec();
    bounds[i] = [f64::NEG_INFINITY, f64::INFINITY];
    let direction: Vec<f64> =
        (0..count).map(|j| known.covariance[(j, i)] / known.covariance[(i, i)].max(f64::MIN_POSITIVE)).collect();
    let error = known.standard_errors[i].unwrap_or(1.0);
    // Points of the root of the likelihood ratio, with where the others were: inside and outside of the interval.
    let mut inside = (0.0, 0.0, best.theta.clone());
    let mut outside: Option<(f64, f64)> = None;
    let mut t = (quantile * error).min(FAR);
    for point in 0..POINTS {
        let mut start = inside.2.clone();
        for (j, value) in start.iter_mut().enumerate() {
            *value += sign * (t - inside.0) * direction[j];
        }
        start[i] = best.theta[i] + sign * t;
        let Some(found) = climb(problem, &start, &free, &bounds, ctl)? else { return Ok(Side::Open) };
        known.evaluations += found.evaluations;
        let drop = top - found.evaluation.log_likelihood;
        if drop < -BETTER {
            let all = vec![true; count];
            let better = climb(problem, &found.theta, &all, &bounds, ctl)?;
            let better = better.filter(|better| better.evaluation.log_likelihood > top + BETTER);
            return Ok(better.map_or(Side::Open, |better| Side::Better(Box::new(better))));
        }
        let root = (2.0 * drop.max(0.0)).sqrt();
        if (root - quantile).abs() <= CLOSE {
            return Ok(Side::Closed(best.theta[i] + sign * t));
        }
        if root < quantile {
            if t >= FAR {
                return Ok(Side::Open);
            }
            inside = (t, root, found.theta);
        } else {
            outside = Some((t, root));
        }
        t = match outside {
            // The root is nearly linear; every third time the middle, where it is not.
            Some((far, beyond)) if point % 3 != 2 => {
                inside.0 + (far - inside.0) * (quantile - inside.1) / (beyond - inside.1)
            }
            Some((far, _)) => 0.5 * (inside.0 + far),
            None => (t * (quantile / root.max(f64::MIN_POSITIVE)).clamp(1.1, 3.0)).min(FAR),
        };
    }
    // The outer of both, so that the interval holds no less than it says.
    Ok(outside.map_or(Side::Open, |(far, _)| Side::Closed(best.theta[i] + sign * far)))
}

impl Inference {
    /// The standard error of a combination `Σ v_i θ_i`.
    #[must_use]
    pub fn error_of(&self, combination: &[f64]) -> f64 {
        let v = nalgebra::DVector::from_column_slice(combination);
        v.dot(&(&self.covariance * &v)).max(0.0).sqrt()
    }

    /// `½ΔᵀIΔ`: by how much the log likelihood would fall from θ̂ to θ̂ + Δ, if it were a parabola.
    #[must_use]
    pub fn parabola(&self, difference: &[f64]) -> f64 {
        let v = nalgebra::DVector::from_column_slice(difference);
        0.5 * v.dot(&(&self.information * &v))
    }
}
