//! Fits with one of the controllers held at zero, in a report.

use crate::analysis::report::Warning;
use crate::identify::held::{Held, RestrictionF};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The fit with a controller held at zero, over the same lines and the same part of the pool for the other one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RestrictedFit {
    /// The controller.
    pub held_at_zero: Held,
    /// Free coefficients of the other one.
    pub unknowns: usize,
    /// Candidates of the restricted pool; null where there is no fit.
    pub pool_size: Option<u64>,
    /// J of its best candidate, exact over the restricted pool; null where there is no fit.
    pub cost: Option<f64>,
    /// The F statistic of the restriction from the best candidates of both pools; null where there is none.
    pub f: Option<RestrictionF>,
    /// Why `f` is null.
    pub f_reason: Option<String>,
    /// J refined from that candidate; null where there is no refinement.
    pub refined_cost: Option<f64>,
    /// The F statistic from both refined fits, which are local optima; null where there is none.
    pub refined_f: Option<RestrictionF>,
    /// Why `refined_f` is null.
    pub refined_f_reason: Option<String>,
}

/// Says what the statistics of restrictions are, and what they are not.
pub(super) fn warn(fits: &[RestrictedFit], warnings: &mut Vec<Warning>) {
    let told = |fit: &RestrictedFit| {
        let f = fit.refined_f.or(fit.f)?;
        Some(format!(
            "no {}: F({}, {}) = {:.2}, p {:.1e}",
            fit.held_at_zero.name(),
            f.numerator_degrees,
            f.denominator_degrees,
            f.statistic,
            f.nominal_p_value
        ))
    };
    let told: Vec<String> = fits.iter().filter_map(told).collect();
    if !told.is_empty() {
        warnings.push(Warning::new(
            "restriction_f_is_nominal",
            format!(
                "{}. These probabilities are those of the F distribution, which such statistics do not have: poles and \
                 zeros of a controller that is zero mean nothing, leakage is no noise, and a command alone hardly \
                 tells feedback from feedforward. Compare the costs; tests whose size was measured are those of \
                 prediction_error",
                told.join("; ")
            ),
        ));
    }
}
