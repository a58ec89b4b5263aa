//! What must be read before the result of a subsystem identification is used.

use super::held::Held;
use super::pool::{Pool, Position, Recipe};
use super::problem::{NEAR, Unusable};
use super::ssid::{Finding, Identified};

/// Below this separation, or above this condition number, feedback and feedforward count as confounded.
const POOR_SEPARATION: f64 = 0.02;
const POOR_CONDITION: f64 = 1e4;

/// Relative difference between J by least squares and J of the reported coefficients that is worth a warning.
const COST_MISMATCH: f64 = 1e-6;

/// What must be read before identified controllers are used.
pub(super) fn findings(found: &Identified, recipe: &Recipe, pool: &Pool, position: Position) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut say = |code: &'static str, message: String| findings.push(Finding { code, message });
    for (why, code, words) in [
        (
            Unusable::PlantPole,
            "line_on_plant_pole",
            "a plant pole lies there, and the response tells nothing about the feedforward relative to the plant",
        ),
        (Unusable::PlantZero, "line_on_plant_zero", "the plant transmits nothing there, whatever the person does"),
        (Unusable::NoResponse, "line_without_response", "there is no finite response"),
        (Unusable::NoWeight, "line_without_weight", "its variance gives no positive weight"),
        (Unusable::AboveNyquist, "line_above_nyquist", "it lies above the Nyquist frequency"),
    ] {
        let lines: Vec<String> = found
            .dropped
            .iter()
            .filter(|dropped| dropped.why == why)
            .map(|dropped| format!("{:.4}", dropped.omega_rad_s / std::f64::consts::TAU))
            .collect();
        if !lines.is_empty() {
            say(code, format!("left out at {} Hz: {words}", lines.join(", ")));
        }
    }

    if found.plant_delay_s > 0.0 {
        say(
            "plant_delay",
            format!(
                "the plant's delay of {} s is in the loop: candidates are members of the pool that are stable with and \
                 without it, and a loop with a delay has no finite list of poles",
                found.plant_delay_s
            ),
        );
    }
    let structure = recipe.structure();
    let (np, dp) = (found.plant.num().degree(), found.plant.den().degree());
    // Degrees of Nff Dfb and Nfb Dff; one that is held at zero has none.
    let degree = |numerator: usize, denominator: usize, held: Held| {
        if structure.held == Some(held) { 0 } else { numerator + denominator }
    };
    let wanted = dp
        + structure.feedforward_denominator
        + structure.feedback_denominator
        + np
        + degree(structure.feedforward_numerator, structure.feedback_denominator, Held::Feedforward).max(degree(
            structure.feedback_numerator,
            structure.feedforward_denominator,
            Held::Feedback,
        ));
    if found.lines.len() <= wanted {
        say(
            "few_lines",
            format!(
                "{} frequency lines; more than {wanted} are needed to make sure that no other controllers of these \
                 degrees have the same closed loop (Zhang 2015, assumption A2.3)",
                found.lines.len()
            ),
        );
    }
    if let Some(held) = structure.held {
        let (left, loop_) = match held {
            Held::Feedback => ("feedforward", "u = Gff r"),
            Held::Feedforward => ("feedback", "u = Gfb (r − y)"),
        };
        say(
            "controller_held_at_zero",
            format!(
                "the {} is held at zero by the spec, and the {left} takes all of the response ({loop_}): its \
                 estimate is that of the hypothesis, and says nothing of whether it holds",
                held.name()
            ),
        );
    }
    let is_free = structure.held.is_none();
    if structure.held != Some(Held::Feedback) && position.feedback.gain == 0.0 {
        say(
            "zero_feedback",
            "the best candidate has no feedback at all; its feedback denominator means nothing".to_owned(),
        );
    }
    let judged = &found.identifiability;
    let poor = judged.separation.is_some_and(|s| s < POOR_SEPARATION)
        || judged.condition_number.is_none_or(|c| c > POOR_CONDITION);
    let numbers = format!(
        "separation {} (1: unlike, 0: confounded), condition number {}",
        judged.separation.map_or_else(|| "undefined".to_owned(), |s| format!("{s:.2e}")),
        judged.condition_number.map_or_else(|| "undefined".to_owned(), |c| format!("{c:.2e}")),
    );
    if is_free && poor && position.feedback.gain != 0.0 {
        say(
            "feedback_poorly_determined",
            format!(
                "one response cannot tell two controllers apart but by their assumed degrees, and here it hardly does: \
                 {numbers}. Feedback and feedforward of much the same cost may differ a lot; a second stimulus at the \
                 plant's input would separate them"
            ),
        );
    } else if is_free {
        say(
            "feedback_from_structure",
            format!(
                "feedback and feedforward are told apart only by their assumed degrees (Zhang 2015, example 2.1); \
                 {numbers}. They describe the modelled loop on the known plant, which is no proof about the person"
            ),
        );
    }
    let near = found.optimum.near_optimal;
    if near > 1 {
        say(
            "near_optimal_candidates",
            format!(
                "{near} candidates of the pool cost at most {:.0} % more than the best one, or cannot be told from it \
                 by rounding",
                100.0 * NEAR
            ),
        );
    }
    for edge in recipe.edges(pool, position) {
        say(
            "edge_of_pool",
            format!("the best candidate lies on the edge of the pool: {edge}; a wider pool may hold a better one"),
        );
    }
    let mismatch = (found.cost_of_coefficients - found.optimum.cost).abs();
    let scale: f64 = found.lines.iter().map(|(line, _)| line.weight * line.response.norm_sqr()).sum();
    if mismatch > COST_MISMATCH * found.optimum.cost && mismatch > 1e-12 * scale {
        say(
            "ill_conditioned_coefficients",
            format!(
                "the coefficients as written give the cost {:.6e} instead of {:.6e}: the feedforward numerator is too \
                 high in degree for its lines to be written in powers of the variable",
                found.cost_of_coefficients, found.optimum.cost
            ),
        );
    }
    findings
}
