//! What must be read before the result of an identification with several inputs and outputs is used.

use super::error::grouped;
use super::identify::{Identified, Plant, Settings};
use crate::identify::problem::NEAR;
use crate::identify::ssid::Finding;

/// Below this separation, or above this condition number, feedback and feedforward count as confounded.
const POOR_SEPARATION: f64 = 0.02;
const POOR_CONDITION: f64 = 1e4;

/// Below this separation they cannot be told apart at all.
const NO_SEPARATION: f64 = 1e-8;

/// Relative difference between J by least squares and J of the reported coefficients that is worth a warning.
const COST_MISMATCH: f64 = 1e-6;

/// What must be read before identified controllers are used.
pub(super) fn findings(found: &Identified, plant: &Plant, settings: &Settings) -> Vec<Finding> {
    let pool = &settings.pool;
    let mut findings = Vec::new();
    let mut say = |code: &'static str, message: String| findings.push(Finding { code, message });
    for (code, words, lines) in grouped(&found.dropped) {
        say(code, format!("left out at {lines} rad/s: {words}"));
    }
    // Two closed loops differ by a rational matrix whose numerator has at most this degree (after Zhang 2015,
    // proposition 4.3).
    let wanted = 2 * (plant.system.states() + pool.states()) + settings.feedforward_order;
    if found.lines.len() <= wanted {
        say(
            "few_lines",
            format!(
                "{} frequency lines; more than {wanted} are needed to make sure that controllers with the same \
                 response at the lines have the same closed loop (Zhang 2015, proposition 4.3)",
                found.lines.len()
            ),
        );
    }
    let is_zero = found.feedback.numerator().to_nested().iter().flatten().flatten().all(|c| *c == 0.0);
    if is_zero {
        say(
            "zero_feedback",
            "the best candidate has no feedback at all; its feedback denominator means nothing".to_owned(),
        );
    }
    let judged = &found.identifiability;
    let numbers = format!(
        "separation {} (1: unlike, 0: confounded), condition number {}",
        judged.separation.map_or_else(|| "undefined".to_owned(), |s| format!("{s:.2e}")),
        judged.condition_number.map_or_else(|| "undefined".to_owned(), |c| format!("{c:.2e}")),
    );
    let has_free = pool.rows().iter().flat_map(|row| &row.coefficients).any(|c| c.values.len() > 1);
    let poor = judged.separation.is_some_and(|s| s < POOR_SEPARATION)
        || judged.condition_number.is_none_or(|c| c > POOR_CONDITION);
    if judged.separation.is_some_and(|s| s < NO_SEPARATION) {
        say(
            "feedback_not_determined",
            format!(
                "a change of the feedback can be undone by the feedforward, so that the response is the same whatever \
                 the feedback is (Zhang 2015, example 4.1): {numbers}. Of all such feedbacks of the pool the first one \
                 is reported"
            ),
        );
    } else if poor && has_free && !is_zero {
        say(
            "feedback_poorly_determined",
            format!(
                "the response to the commands cannot tell two controllers apart but by their assumed degrees, and here \
                 it hardly does: {numbers}. Feedback and feedforward of much the same cost may differ a lot"
            ),
        );
    } else {
        say(
            "feedback_from_structure",
            format!(
                "feedback and feedforward are told apart only by their assumed degrees (Zhang 2015, example 4.1 and \
                 assumption A3.5); {numbers}. They describe the modelled loop on the known plant, which is no proof \
                 about the person"
            ),
        );
    }
    let optimum = &found.optimum;
    if optimum.near_optimal > 1 {
        say(
            "near_optimal_candidates",
            format!(
                "{}{} candidates of the pool cost at most {:.0} % more than the best one, or cannot be told from it by \
                 rounding",
                if optimum.near_optimal_is_capped { "more than " } else { "" },
                optimum.near_optimal,
                100.0 * NEAR
            ),
        );
    }
    if !optimum.fit.is_unique {
        say(
            "feedforward_not_unique",
            "with this feedback the lines do not determine every feedforward coefficient; dependent ones were set to 0"
                .to_owned(),
        );
    }
    for edge in pool.edges(&optimum.coefficients) {
        say(
            "edge_of_pool",
            format!("the best candidate lies on the edge of the pool: {edge}; a wider pool may hold a better one"),
        );
    }
    let mismatch = (found.cost_of_coefficients - optimum.fit.cost).abs();
    let scale: f64 =
        found.lines.iter().map(|(line, _)| line.weight * line.response.iter().map(|v| v.norm_sqr()).sum::<f64>()).sum();
    if mismatch > COST_MISMATCH * optimum.fit.cost && mismatch > 1e-12 * scale {
        say(
            "ill_conditioned_coefficients",
            format!(
                "the coefficients as written give the cost {:.6e} instead of {:.6e}: the feedforward is too high in \
                 order for its lines to be written in powers of 1/z",
                found.cost_of_coefficients, optimum.fit.cost
            ),
        );
    }
    findings
}
