//! Gains that an earlier analysis found: `{"analysis": ID}` in place of a plant and its gains.

use crate::analysis::ids::AnalysisId;
use crate::analysis::inputs::earlier::{Earlier, FromEarlier};
use crate::analysis::problem::{Code, Problem};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

/// Where a request names the analysis.
const AT: &str = "/inputs/analysis";

/// The analysis that found the gains. A server writes it; whoever uses its trials may then use this answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "InverseFoundBy")]
pub struct FoundBy {
    /// The analysis, which is stored.
    pub analysis: AnalysisId,
    /// `result_sha256` of its report.
    pub result_sha256: String,
    /// Which pair of K and L of that report these are: 0 for the estimate, k for its k-th twin.
    pub explanation: usize,
}

/// Which gains a question is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::analysis) enum Asked {
    /// K.
    Regulator,
    /// L.
    Filter,
    /// Both.
    Whole,
}

/// The question about the gains that a report found, with their covariances for the fit.
///
/// # Errors
/// A [`Problem`] where the report has no such gains, or several pairs of them and none was chosen.
pub(in crate::analysis) fn question(earlier: &Earlier<'_>, asked: Asked) -> Result<FromEarlier, Problem> {
    let report = earlier.report;
    let refused = |detail: String| Problem::new(Code::Invalid, "no gains in that report", detail).at(AT);
    match report.kind.name() {
        "gain_fit" => {}
        "lqg_fit" => {
            let detail = "lqg_fit gives the costs themselves: K and L are functions of the Q and W_p in its report";
            return Err(refused(detail.to_owned())
                .mend("Read Q and W_p there, or estimate the gains freely by gain_fit and ask about those."));
        }
        other => {
            let detail = format!("an analysis of kind {other} finds no gain of a state feedback");
            return Err(refused(detail).mend("Name an analysis of kind gain_fit, on the plant in state space."));
        }
    }
    let part = |name: &str| report.result.get(name).filter(|value| !value.is_null());
    let members = match asked {
        Asked::Regulator => part("inverse_lqr_inputs"),
        Asked::Filter | Asked::Whole => part("inverse_lqg_inputs"),
    };
    let Some(members) = members.and_then(Value::as_object) else {
        return Err(refused("that gain_fit did not estimate the filter".to_owned())
            .mend("Fit with \"estimate\": \"gain_and_filter\", or ask inverse_lqr about K alone."));
    };
    let needed: &[&str] = match asked {
        Asked::Regulator => &["a", "b", "k", "sample_time_s", "state_names", "state_units", "input_units"],
        Asked::Filter => &["a", "c", "d", "l", "sample_time_s", "state_names"],
        Asked::Whole => &["a", "b", "c", "d", "k", "l", "sample_time_s", "state_names"],
    };
    let own = needed.iter().filter_map(|name| Some(((*name).to_owned(), members.get(*name)?.clone())));
    let mut inputs: Map<String, Value> = own.collect();
    let twins = part("twins").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let explanation = chosen(earlier.explanation, twins.len())?;
    if let Some(twin) = explanation.checked_sub(1).map(|at| &twins[at]) {
        for name in ["k", "l"] {
            if let (Some(own), Some(other)) = (inputs.get_mut(name), twin.get(name)) {
                *own = other.clone();
            }
        }
    }
    let found_by =
        FoundBy { analysis: earlier.analysis, result_sha256: report.provenance.result_sha256.clone(), explanation };
    inputs.insert("found_by".to_owned(), json!(found_by));
    // Of a twin the report has no covariance.
    let of_estimate = |name: &str| part(name).filter(|_| explanation == 0).cloned();
    let covariances = match asked {
        Asked::Regulator => vec![(&[][..], of_estimate("k_covariance"))],
        Asked::Filter => vec![(&[][..], of_estimate("l_covariance"))],
        Asked::Whole => {
            vec![(&["regulator"][..], of_estimate("k_covariance")), (&["filter"][..], of_estimate("l_covariance"))]
        }
    };
    let settings = covariances.into_iter().filter_map(|(path, covariance)| {
        let path = path.iter().copied().chain(["fit", "gain_covariance"]).collect();
        Some((path, covariance?))
    });
    Ok(FromEarlier { inputs, settings: settings.collect() })
}

/// The pair of gains that was chosen: with twins none of them is taken in silence.
fn chosen(explanation: Option<usize>, twins: usize) -> Result<usize, Problem> {
    const AT: &str = "/inputs/explanation";
    let ask =
        format!("Add \"explanation\": 0 for the estimate, or 1 to {twins} for a twin, and ask about each of them.");
    match explanation {
        None if twins > 0 => {
            let detail = format!(
                "no record tells the estimate from {twins} other pairs of K and L (`twins` in that report), and each \
                 may have a cost of its own"
            );
            Err(Problem::new(Code::NotIdentifiable, "several gains explain the records", detail).at(AT).mend(ask))
        }
        None => Ok(0),
        Some(found) if found <= twins => Ok(found),
        Some(found) => {
            let detail = format!("there is no explanation {found}: that report has the estimate and {twins} twins");
            Err(Problem::new(Code::Invalid, "no such explanation", detail).at(AT).mend(ask))
        }
    }
}
