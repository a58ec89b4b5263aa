//! What a scientist must read beside a fit.

use super::result::{LqgFitParameter, LqgFitRefusal, LqgFitResult};
use crate::analysis::report::Warning;
use crate::likelihood::lqg::NoTwins;

/// Whiteness is doubted below this probability.
const DOUBTFUL: f64 = 1e-3;

fn refused<'a>(result: &'a LqgFitResult, why: &'a [LqgFitRefusal]) -> impl Iterator<Item = &'a LqgFitParameter> {
    result.parameters.iter().filter(move |p| p.refused.is_some_and(|refusal| why.contains(&refusal)))
}

/// What must be read before using the result.
pub(super) fn warnings(result: &LqgFitResult, no_twins: Option<&NoTwins>) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let mut warn = |code: &str, message: String| warnings.push(Warning::new(code, message));
    let convergence = &result.convergence;
    if !convergence.converged {
        warn(
            "not_converged",
            format!(
                "The search stopped before the likelihood was flat: Newton's method would still move by {:.2e} \
                 standard errors.",
                convergence.remaining_step
            ),
        );
    }
    if convergence.arrived < convergence.starts {
        let spread = convergence.log_likelihoods.iter().copied().fold(f64::INFINITY, f64::min);
        warn(
            "starts_disagree",
            format!(
                "Only {} of {} starts came to this likelihood, the others ended up to {:.1} below in its logarithm; a \
                 better one may exist. Try more starts.",
                convergence.arrived,
                convergence.starts,
                (result.log_likelihood - spread).max(0.0)
            ),
        );
    }
    if !convergence.information_is_observed {
        warn(
            "information_not_positive",
            "The likelihood does not fall in every direction from the answer: standard errors are those of the \
             expected information, and too small where it is flat. Read the intervals."
                .to_owned(),
        );
    }
    if result.explanations.len() > 1 {
        let lowest = result.explanations.iter().map(|e| e.log_likelihood).fold(f64::INFINITY, f64::min);
        warn(
            "explanations_not_told_apart",
            format!(
                "{} persons with other costs and other beliefs explain the records within {:.2} in log likelihood. \
                 None of them is the answer alone: read `explanations`. Only a person who is told the disturbance, or \
                 whose filter is known, tells them apart.",
                result.explanations.len(),
                result.log_likelihood - lowest
            ),
        );
    }
    if let Some(error) = no_twins {
        warn(
            "twins_not_looked_for",
            format!("Other pairs of K and L may make the same controller, and were not looked for: {error}."),
        );
    }
    let unknown = [
        LqgFitRefusal::StandardError,
        LqgFitRefusal::OpenInterval,
        LqgFitRefusal::WideInterval,
        LqgFitRefusal::AtBound,
    ];
    let names: Vec<String> = refused(result, &unknown)
        .map(|p| match (p.refused, p.log_standard_error) {
            (Some(LqgFitRefusal::StandardError), Some(error)) => {
                format!("{} (standard error of the logarithm {error:.2})", p.name)
            }
            (Some(LqgFitRefusal::OpenInterval), _) => format!("{} (interval open on a side)", p.name),
            (Some(LqgFitRefusal::WideInterval), _) => format!("{} (interval too wide)", p.name),
            _ => format!("{} (ran to a bound)", p.name),
        })
        .collect();
    if !names.is_empty() {
        let combinations: Vec<&str> = result.combinations.iter().map(|c| c.name.as_str()).collect();
        let known = if combinations.is_empty() {
            "No combination of them is known either.".to_owned()
        } else {
            format!("Known are {}: read `combinations`.", combinations.join(", "))
        };
        warn(
            "parameters_refused",
            format!("The records do not determine {}; no number is given for them. {known}", names.join(", ")),
        );
    }
    for signal in result.signals.iter().filter(|s| s.whiteness_p < DOUBTFUL) {
        warn(
            "coloured_residuals",
            format!(
                "The prediction errors of {} are no white noise (neighbours correlate by {:.2}): something else moves \
                 the person, and the intervals are too narrow.",
                signal.signal, signal.lag_one_correlation
            ),
        );
    }
    warnings
}
