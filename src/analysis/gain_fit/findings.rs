//! What a scientist must read beside a fit.

use super::assembly::Filter;
use super::result::{BoundSide, GainFitResult};
use super::spec::GainFitSpec;
use crate::analysis::report::Warning;
use crate::control::twins::TwinsError;
use crate::likelihood::{Noise, Predicted};

/// A condition number of the information above this deserves a warning.
const NEARLY_SINGULAR: f64 = 1e6;
/// Whiteness is doubted below this probability.
const DOUBTFUL: f64 = 1e-3;

/// What else is known of a fit.
pub(super) struct Fit<'a> {
    /// Whether the model explains the predicted signals down to rounding.
    pub is_exact: bool,
    pub noise: &'a Noise,
    pub filter: Option<Filter>,
    /// Why the twins of the gains were not found.
    pub no_twins: Option<TwinsError>,
}

/// What must be read before using the result.
pub(super) fn warnings(spec: &GainFitSpec, result: &GainFitResult, fit: &Fit<'_>) -> Vec<Warning> {
    let Fit { is_exact, noise, filter, no_twins } = fit;
    let mut warnings = Vec::new();
    let mut warn = |code: &str, message: String| warnings.push(Warning::new(code, message));
    let convergence = &result.convergence;
    if !convergence.converged {
        let step = convergence.remaining_step.map_or_else(
            || format!("the gradient's cosine is {:.1e}", convergence.gradient_cosine),
            |step| format!("Newton's method would still move by {step:.2e} standard errors"),
        );
        warn("not_converged", format!("The search stopped before the likelihood was flat: {step}."));
    }
    if convergence.climbs > 1 && convergence.agreeing == 1 {
        warn(
            "starts_disagree",
            format!(
                "Only one of {} starts came to this likelihood; a better one may exist. Try more draws and climbs.",
                convergence.climbs
            ),
        );
    }
    if *is_exact {
        warn("no_noise", "The model explains the outputs down to rounding; standard errors mean little.".to_owned());
    }
    let known = &result.identifiability;
    if !known.identifiable {
        warn(
            "not_identifiable",
            format!(
                "The data do not determine all parameters: {} may take any value. No intervals are given. Hold a \
                 parameter of it, or excite more.",
                known.weakest_combination
            ),
        );
    } else if let Some(condition) = known.condition_number.filter(|c| *c > NEARLY_SINGULAR) {
        warn(
            "ill_determined",
            format!(
                "The combination {} is hardly determined (condition number of the information {condition:.1e}).",
                known.weakest_combination
            ),
        );
    }
    for (parameter, side) in result.parameters.iter().filter_map(|p| Some((p, p.at_bound?))) {
        let side = match side {
            BoundSide::Lower => "lower",
            BoundSide::Upper => "upper",
        };
        warn(
            "at_bound",
            format!(
                "{} is at its {side} bound, {}; the other intervals take it for known.",
                parameter.name, parameter.value
            ),
        );
    }
    if !*is_exact {
        for output in result.outputs.iter().filter(|o| o.whiteness_p < DOUBTFUL) {
            warn(
                "coloured_residuals",
                format!(
                    "The residuals of {} are no white noise (neighbours correlate by {:.2}): something else moves the \
                     person, and the intervals are too narrow.",
                    output.signal, output.lag_one_correlation
                ),
            );
        }
    }
    match filter {
        None => {}
        Some(Filter { predicted: Predicted::Control, .. }) => {
            twins(result, no_twins.as_ref(), &mut warn);
        }
        Some(Filter { predicted, .. }) => {
            let condition = known.condition_number.map_or("infinite".to_owned(), |c| format!("{c:.1e}"));
            let mend = match predicted {
                Predicted::Output => "Record the control, or disturb the loop in several places, to separate them.",
                _ => "Take {\"perceived_noise\": \"free\"} to find them from the control without this assumption.",
            };
            warn(
                "gain_and_filter",
                format!(
                    "K and L are hard to tell apart from outputs (Priess 2015, section 6.3): they are those of a \
                     person whose filter suits the true noise, as the spec assumes, and the condition number of the \
                     information is {condition}. {mend}"
                ),
            );
            if !matches!(noise, Noise::Known(_)) && result.outputs.iter().any(|o| o.whiteness_p < DOUBTFUL) {
                warn(
                    "filter_does_not_suit",
                    "The innovations are not white: the person's filter does not suit the noise, or the model is \
                     wrong, and K and L may be wrong by factors. Take {\"perceived_noise\": \"free\"}."
                        .to_owned(),
                );
            }
        }
    }
    let Some(optimality) = &result.optimality else { return warnings };
    if spec.delay.is_some() || spec.muscle_lag.is_some() {
        warn(
            "optimality_of_the_plant_alone",
            "The cost is that of the plant without the person's delay and lag, as in Priess 2015, section 3.5."
                .to_owned(),
        );
    }
    if optimality.unknowns.is_some_and(|unknowns| unknowns > 1) {
        warn(
            "cost_not_unique",
            format!(
                "The gain leaves {} directions of the weights open; the best conditioned ones are given, and their \
                 intervals are those of this choice. Ask for a structure, such as a diagonal state weight, to narrow \
                 it.",
                optimality.unknowns.map_or(0, |u| u - 1)
            ),
        );
    }
    if optimality.unknowns == Some(0) {
        warn(
            "structure_leaves_nothing",
            "The structure leaves fewer unknowns than the gain has entries to explain: gains with such a cost have \
             probability zero whatever the data, and the probability says nothing. Read the p-value of the nearest \
             optimal gain."
                .to_owned(),
        );
    } else if let Some([low, high]) = optimality.probability_interval.filter(|[_, high]| *high < 0.05) {
        warn(
            "hardly_optimal",
            format!("The gains are optimal for a cost with a probability of {low:.3} to {high:.3} only."),
        );
    }
    warnings
}

/// Pairs of gains that the records cannot tell apart.
fn twins(result: &GainFitResult, missing: Option<&TwinsError>, warn: &mut impl FnMut(&str, String)) {
    let until = "Only a person who is told the input, or whose filter is known, tells them apart.";
    if let Some(error) = missing {
        warn(
            "twins_not_looked_for",
            format!("Other pairs of K and L may make the same controller, and were not looked for: {error}. {until}"),
        );
    }
    let Some(others) = result.twins.as_ref().filter(|twins| !twins.is_empty()) else { return };
    let size = |k: &[Vec<f64>]| k.iter().flatten().map(|v| v * v).sum::<f64>().sqrt();
    let sizes = others.iter().map(|twin| size(&twin.k)).chain([size(&result.k)]);
    let (low, high) = sizes.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
    warn(
        "twins",
        format!(
            "Other pairs of K and L make exactly the same controller: {}, with the one given. The norms of their gains \
             go from {low:.4} to {high:.4}. None of them is the answer alone: read `twins`. {until}",
            others.len() + 1
        ),
    );
}
