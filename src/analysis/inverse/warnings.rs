//! What must be read before using the answer.

use crate::analysis::report::Warning;
use crate::control::structural::{StructuralError, check_detectable};
use crate::inverse::fit::Fit;
use crate::inverse::lqr::Weights;
use crate::inverse::{Gains, InverseLqr, Role, Verdict};
use nalgebra::DMatrix;
use std::fmt::Display;

/// Condition numbers above this deserve a warning: weights then differ by more than measured gains tell.
const ILL_CONDITIONED: f64 = 1e8;
/// On the boundary eigenvalues of Q below this share of its size are zero: singular weights come from an iteration.
const SEEN: f64 = 1e-7;
/// The share of starts that must agree on the best fit for it to be trusted.
const AGREEMENT: f64 = 0.3;

/// The start that was asked for does not exist.
pub(super) fn descent_from_identity() -> Warning {
    let message = "The descent starts from the identity: weights of a smallest cross term were not computed, or there \
                   are none.";
    Warning::new("descent_from_identity", message)
}

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
    let values = eigen.eigenvalues.map(|v| if v > SEEN * size { v } else { 0.0 });
    &eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose()
}

/// Other readings of the numbers under which the verdict would be another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Doubts {
    /// The boundary is within half a unit of the last digit of the gain.
    pub within_digits: bool,
    /// L is infeasible for a predictor, and AL is not.
    pub would_pass_as_filter: bool,
}

fn half_of(gains: &Gains) -> &'static str {
    if gains.role() == Role::Filter { "filter" } else { "regulator" }
}

/// The fit was not made.
pub(super) fn fit_left_out(gains: &Gains) -> Warning {
    let why = if gains.targets().is_some() { "the plant has targets that no input reaches" } else { "it is too large" };
    Warning::new("fit_left_out", format!("no weights were fitted to the {}'s gain: {why}", half_of(gains)))
}

/// What the plant makes of the question.
fn warn_of_plant(gains: &Gains, answer: &InverseLqr, doubts: &Doubts, warnings: &mut Vec<Warning>) {
    let half = half_of(gains);
    if answer.decision.is_uninformative {
        warnings.push(Warning::new(
            "uninformative",
            format!(
                "A is singular: every stabilising gain of this {half} that vanishes on its kernel is optimal for some \
                 weights, and the verdict says nothing about the person"
            ),
        ));
    }
    if !gains.decaying().is_empty() {
        warnings.push(Warning::new(
            "free_modes",
            format!(
                "{} modes decay by themselves and cannot be influenced: the {half}'s gain on them is free, and does \
                 not count for the verdict",
                gains.decaying().len()
            ),
        ));
    }
    if let Some(targets) = gains.targets() {
        warnings.push(Warning::new(
            "set_points",
            format!(
                "{} modes last and cannot be influenced, such as targets: the {half}'s weights are on the distances \
                 from the set points that the loop holds, which are in `unreached`",
                targets.modes.len()
            ),
        ));
    }
    if doubts.within_digits {
        let verdict = match answer.decision.verdict {
            Verdict::Feasible => "feasible",
            Verdict::Infeasible => "infeasible",
            Verdict::Boundary => "boundary",
        };
        warnings.push(Warning::new(
            "gain_digits",
            format!(
                "the {half}'s gain is {verdict} as it is written, to the last digit; within half a unit of those \
                 digits it is on the boundary. If they are rounded, say so with gain_rounding"
            ),
        ));
    }
    if doubts.would_pass_as_filter {
        warnings.push(Warning::new(
            "filter_form",
            "L is no optimal gain of a predictor, but AL is not ruled out: if L corrects the estimate before the step, \
             say so with form \"filter\""
                .to_owned(),
        ));
    }
    if answer.is_within_pattern && answer.verdict == Verdict::Feasible {
        warnings.push(Warning::new(
            "within_pattern",
            format!(
                "the {half}'s gain is feasible within the pattern, which leaves states out: for weights on all states \
                 these are singular, a boundary"
            ),
        ));
    }
}

pub(super) fn warn(
    gains: &Gains,
    answer: &InverseLqr,
    fitted: Option<&Fit>,
    doubts: &Doubts,
    warnings: &mut Vec<Warning>,
) {
    let role = gains.role();
    let half = half_of(gains);
    warn_of_plant(gains, answer, doubts, warnings);
    if answer.verdict == Verdict::Boundary {
        warnings.push(Warning::new(
            "boundary",
            format!(
                "the {half}'s gain is on the boundary within the rounding of the data: only singular weights may make \
                 it optimal, and a small change of the gain may make it infeasible"
            ),
        ));
    }
    if answer.unknowns == 0 {
        warnings.push(Warning::new(
            "structure_leaves_nothing",
            format!(
                "no weights of this structure satisfy the equalities for the {half}'s gain within its rounding, \
                 whatever their signs: with so few unknowns the last digit of a gain decides. Read the distance of the \
                 fit, not the verdict"
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
    if answer.weights.is_some() && answer.verdict == Verdict::Feasible && !answer.best_conditioned {
        let why = if answer.conditioning.is_some() {
            "rounding keeps those of the least condition number from returning the gain"
        } else {
            "the problem is too large for those of the least condition number"
        };
        warnings.push(Warning::new(
            "not_best_conditioned",
            format!("the {half}'s weights are ones that prove the verdict, not the best conditioned: {why}"),
        ));
    }
    if answer.verdict == Verdict::Feasible && answer.weights.is_none() {
        warnings.push(Warning::new(
            "weights_not_found",
            format!(
                "weights exist for the {half}'s gain, but none was found in working precision that returns it to 1e-6: \
                 choose units in which states and inputs are of similar size"
            ),
        ));
    }
    if let Some(conditioning) = answer.conditioning {
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
    if fitted.is_exhausted {
        warnings.push(Warning::new(
            "fit_ended_early",
            format!(
                "the fit of the {half} ended with the {} evaluations that it was allowed: some of its points may be \
                 improved by more",
                fitted.allowed
            ),
        ));
    }
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
