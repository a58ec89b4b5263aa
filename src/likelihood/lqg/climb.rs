//! The climb to a maximum of the likelihood: Fisher's scoring, damped.
//!
//! Each step solves `(I + λ diag I) p = g` for the information I and the gradient g of the log likelihood, among the
//! parameters that neither the caller nor a bound holds; λ falls where a step climbs and rises where it does not. The
//! steps are in logarithms, so no unit matters. What the information leaves out of the curvature is learned from the
//! gradients along the way, by updates of rank one (Nocedal and Wright 2006, eq. (6.24)).

use super::recursion::{Evaluation, Problem};
use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};

/// Steps of one climb at most.
const STEPS: usize = 150;
/// A step changes no logarithm by more.
const LARGEST_STEP: f64 = 1.5;
/// The climb has arrived where a step promises less log likelihood.
const FLAT: f64 = 1e-8;
/// An update is skipped where its divisor is below this share of its size.
const UPDATED: f64 = 1e-8;
/// The first damping, the largest before the climb gives up, and the least.
const DAMPING: [f64; 3] = [1e-3, 1e8, 1e-9];
/// A share of the largest diagonal entry of the information below which a parameter's own is rounding.
const SILENT: f64 = 1e-14;

/// Where a climb ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Climbed {
    /// θ.
    pub theta: Vec<f64>,
    /// The likelihood there, with gradient and information.
    pub evaluation: Evaluation,
    /// Whether the gradient is flat there, as far as no bound holds it.
    pub is_converged: bool,
    /// Which parameters are at a bound: −1 the lower, 1 the upper one.
    pub at_bound: Vec<i8>,
    /// Evaluations with derivatives.
    pub evaluations: usize,
}

/// Climbs from a start within the bounds, with the parameters that are `free`; `None` where the start is of no use.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub fn climb(
    problem: &Problem<'_>,
    start: &[f64],
    free: &[bool],
    bounds: &[[f64; 2]],
    ctl: &Ctl,
) -> Result<Option<Climbed>, Stopped> {
    let mut theta: Vec<f64> = start.iter().zip(bounds).map(|(v, [low, high])| v.clamp(*low, *high)).collect();
    let Some(mut here) = problem.evaluate(&theta, true, ctl)? else { return Ok(None) };
    let mut evaluations = 1;
    let [mut damping, most, least] = DAMPING;
    let mut is_converged = false;
    let mut settled = 0;
    let mut learned = DMatrix::zeros(theta.len(), theta.len());
    for _ in 0..STEPS {
        let side = sides(&theta, bounds);
        let active: Vec<usize> =
            (0..theta.len()).filter(|i| free[*i] && f64::from(side[*i]) * here.gradient[*i] <= 0.0).collect();
        // With what was learned where that is definite, without it otherwise.
        let curved = &here.information + &learned;
        let full = newton(&here, &curved, &active, least);
        let curvature = if full.is_some() { &curved } else { &here.information };
        let full = full.or_else(|| newton(&here, &here.information, &active, least));
        // What an undamped step would still bring.
        let promise = full.map_or(f64::INFINITY, |full| {
            0.5 * active.iter().zip(&full).map(|(i, p)| here.gradient[*i] * p).sum::<f64>()
        });
        if promise <= FLAT {
            is_converged = true;
            break;
        }
        let Some(step) = newton(&here, curvature, &active, damping) else { break };
        let largest = step.iter().fold(0.0_f64, |most, p| most.max(p.abs()));
        let shortened = (LARGEST_STEP / largest).min(1.0);
        let mut next = theta.clone();
        for (i, p) in active.iter().zip(&step) {
            next[*i] = (next[*i] + shortened * p).clamp(bounds[*i][0], bounds[*i][1]);
        }
        let moved = problem.evaluate(&next, true, ctl)?;
        evaluations += 1;
        match moved {
            Some(there) if there.log_likelihood >= here.log_likelihood => {
                let gained = there.log_likelihood - here.log_likelihood;
                // Where steps bring no more than rounding the promise is rounding too.
                settled = if gained <= 1e-12 * (1.0 + here.log_likelihood.abs()) { settled + 1 } else { 0 };
                learn(&mut learned, &theta, &next, &here, &there);
                (theta, here) = (next, there);
                damping = (0.2 * damping).max(least);
                if settled >= 3 {
                    is_converged = promise <= 1e3 * FLAT;
                    break;
                }
            }
            _ => {
                damping *= 5.0;
                learned.fill(0.0);
                if damping > most {
                    is_converged = promise <= 1e3 * FLAT;
                    break;
                }
            }
        }
    }
    let at_bound = sides(&theta, bounds);
    Ok(Some(Climbed { theta, evaluation: here, is_converged, at_bound, evaluations }))
}

/// Which bound each parameter is at: −1 the lower, 1 the upper one, 0 none.
fn sides(theta: &[f64], bounds: &[[f64; 2]]) -> Vec<i8> {
    let side = |(v, [low, high]): (&f64, &[f64; 2])| i8::from(v >= high) - i8::from(v <= low);
    theta.iter().zip(bounds).map(side).collect()
}

/// The damped step of the active parameters; `None` where the curvature is not positive definite.
fn newton(here: &Evaluation, curvature: &DMatrix<f64>, active: &[usize], damping: f64) -> Option<Vec<f64>> {
    let count = active.len();
    let largest = active.iter().map(|i| here.information[(*i, *i)]).fold(f64::MIN_POSITIVE, f64::max);
    let mut matrix = DMatrix::from_fn(count, count, |i, j| curvature[(active[i], active[j])]);
    for (i, at) in active.iter().enumerate() {
        matrix[(i, i)] += damping * here.information[(*at, *at)] + SILENT * largest;
    }
    let gradient = DVector::from_iterator(count, active.iter().map(|i| here.gradient[*i]));
    Some(matrix.cholesky()?.solve(&gradient).iter().copied().collect())
}

/// What the curvature along a step has beside the information there.
fn learn(learned: &mut DMatrix<f64>, from: &[f64], to: &[f64], before: &Evaluation, after: &Evaluation) {
    let step = DVector::from_iterator(from.len(), to.iter().zip(from).map(|(x, y)| x - y));
    let missed = (&before.gradient - &after.gradient) - (&after.information + &*learned) * &step;
    let divisor = missed.dot(&step);
    if divisor.abs() > UPDATED * missed.norm() * step.norm() {
        *learned += &missed * missed.transpose() / divisor;
    }
}
