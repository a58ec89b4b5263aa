//! What must be read before using the answer.

use crate::analysis::report::Warning;
use crate::control::structural::{StructuralError, check_detectable};
use crate::inverse::fit::Fit;
use crate::inverse::lqr::Weights;
use crate::inverse::{Gains, InverseLqr, Role, UNDECIDED, Verdict};
use nalgebra::DMatrix;
use std::fmt::Display;

/// Condition numbers above this deserve a warning: weights then differ by more than measured gains tell.
const ILL_CONDITIONED: f64 = 1e8;
/// The share of starts that must agree on the best fit for it to be trusted.
const AGREEMENT: f64 = 0.3;

/// The descent met weights without a regulator.
pub(super) fn descent_broke_off(error: &impl Display) -> Warning {
    Warning::new("descent_broke_off", format!("The descent met weights without a regulator: {error}"))
}

/// Q as far as it is more than rounding: on the boundary its least eigenvalues are zero to the precision of the margin.
fn seen(gains: &Gains, verdict: Verdict, weights: &Weights) -> DMatrix<f64> {
    if verdict != Verdict::Boundary {
        return weights.q.clone();
    }
    let size = weights.q.norm().max(gains.k().tr_mul(&(&weights.r * gains.k())).norm());
    let eigen = weights.q.clone().symmetric_eigen();
    let values = eigen.eigenvalues.map(|v| if v > UNDECIDED * size { v } else { 0.0 });
    &eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose()
}

pub(super) fn warn(gains: &Gains, answer: &InverseLqr, fitted: Option<&Fit>, warnings: &mut Vec<Warning>) {
    let role = gains.role();
    let half = if role == Role::Filter { "filter" } else { "regulator" };
    if answer.verdict == Verdict::Boundary {
        warnings.push(Warning::new(
            "boundary",
            format!(
                "the {half}'s margin t* is zero to working precision: only singular weights may make this gain \
                 optimal, and a small change of the gain may make it infeasible"
            ),
        ));
    }
    if answer.verdict == Verdict::Infeasible && answer.t_star_scaled.is_none() {
        warnings.push(Warning::new(
            "structure_leaves_nothing",
            format!(
                "no weights of this structure satisfy the equalities for exactly the {half}'s gain, whatever their \
                 signs: with so few unknowns the last digit of a gain decides. Read the distance of the fit, not the \
                 verdict"
            ),
        ));
    }
    if let Some(weights) = &answer.weights
        && let Err(error) = check_detectable(gains.a(), &seen(gains, answer.verdict, weights), gains.clock())
    {
        let mode = match error {
            StructuralError::NotDetectable(mode) => mode.to_string(),
            other => other.to_string(),
        };
        let misses = if role == Role::Filter { "W does not drive" } else { "Q does not see" };
        warnings.push(Warning::new(
            "undetectable",
            format!(
                "the {half}'s {misses} the mode {mode} of the plant, which does not decay by itself: among all gains \
                 another one costs less, and this one is the best of those that stabilise"
            ),
        ));
    }
    if let Some(conditioning) = answer.conditioning {
        if !answer.best_conditioned {
            warnings.push(Warning::new(
                "not_best_conditioned",
                format!(
                    "rounding keeps the {half}'s weights of the least condition number from returning the gain; those \
                     of the largest margin are given, which do"
                ),
            ));
        }
        if conditioning.alpha > ILL_CONDITIONED {
            warnings.push(Warning::new(
                "ill_conditioned",
                format!(
                    "the best conditioned weights of the {half} have the condition number {:.2e}: the smallest of them \
                     say nothing that a measured gain could tell",
                    conditioning.alpha
                ),
            ));
        }
        if conditioning.solution_dimension > 0 {
            let which = conditioning.solution_width.map_or_else(
                || "it was not measured, and the weights given are any of it".to_owned(),
                |width| {
                    format!(
                        "those of least Frobenius norm are given, and a diagonal weight may range over \
                        {width:.2e} of its value"
                    )
                },
            );
            warnings.push(Warning::new(
                "not_unique",
                format!(
                    "the {half}'s weights of least condition number form a set of dimension {}; {which}",
                    conditioning.solution_dimension
                ),
            ));
        }
    }
    let Some(fitted) = fitted else { return };
    if let Some((best, first)) = fitted.curve.last().zip(fitted.curve.first()) {
        let agreeing = best.agreeing_starts as f64;
        if agreeing < AGREEMENT * best.starts as f64 {
            warnings.push(Warning::new(
                "local_minima",
                format!(
                    "{} of {} starts agree on the {half}'s best fit: others end in worse minima, and a better one may \
                     exist",
                    best.agreeing_starts, best.starts
                ),
            ));
        }
        if best.residual < 0.9 * first.residual && fitted.curve.len() > 1 {
            warnings.push(Warning::new(
                "condition_number_trade_off",
                format!(
                    "no weights make the {half}'s gain optimal; the squared distance falls from {:.4e} to {:.4e} as \
                     the condition number goes from {:.0e} to {:.0e}: read the whole curve",
                    first.residual, best.residual, first.condition_number, best.condition_number
                ),
            ));
        }
    }
}
