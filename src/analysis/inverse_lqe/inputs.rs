//! The plant and the gain of a filter.

use super::Plan;
use crate::analysis::contract::{Analysis as _, Inputs, Part};
use crate::analysis::inputs::library::References;
use crate::analysis::inverse::found_by::FoundBy;
use crate::analysis::inverse::half::{Half, WrittenLabels, check_feedthrough};
use crate::analysis::inverse::members::Members;
use crate::analysis::inverse::spec::InverseSpec;
use crate::analysis::inverse::written::{OtherNoise, WrittenMatrix};
use crate::analysis::problem::Problem;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

/// The plant and the gain of a filter, with n states and p outputs.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct InverseLqeInputs {
    /// A, n×n, in 1/s (in sampled time dimensionless), each entry times the unit of its row's state over that of its
    /// column's.
    pub a: WrittenMatrix,
    /// C, p×n, in units of the outputs over those of the states.
    pub c: WrittenMatrix,
    /// D, with p rows, in units of the outputs over those of the inputs; the answer does not depend on it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub d: Option<WrittenMatrix>,
    /// L, n×p, in units of the states (in continuous time per s) over those of the outputs; A − LC must be stable.
    pub l: WrittenMatrix,
    /// The sample time in seconds; null in continuous time.
    pub sample_time_s: Option<f64>,
    /// Names of the n states. Default: x1, x2, ….
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state_names: Option<Vec<String>>,
    /// Units of the n states, such as `rad/s`; noises then have units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state_units: Option<Vec<String>>,
    /// Names of the p outputs. Default: y1, y2, ….
    #[serde(skip_serializing_if = "Option::is_none")]
    pub output_names: Option<Vec<String>>,
    /// Units of the p outputs, such as `rad`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub output_units: Option<Vec<String>>,
    /// The noises of another subject or session.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compare_with: Option<OtherNoise>,
    /// The analysis that found the gains, written where the request names it. Default: none, they are the writer's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub found_by: Option<FoundBy>,
}

impl Inputs for InverseLqeInputs {
    fn references(&self) -> References {
        References { analyses: self.found_by.iter().map(|found| found.analysis).collect(), ..References::default() }
    }
}

impl Part for InverseLqeInputs {
    fn read(value: &Value, _at: &str) -> Result<Self, Problem> {
        let members = Members::new(value, Plan::KIND, &["a", "c", "l"], &["d", "output_names", "output_units"])?;
        Ok(Self {
            a: members.matrix("a")?,
            c: members.matrix("c")?,
            d: members.optional_matrix("d")?,
            l: members.matrix("l")?,
            sample_time_s: members.sample_time_s()?,
            state_names: members.texts("state_names")?,
            state_units: members.texts("state_units")?,
            output_names: members.texts("output_names")?,
            output_units: members.texts("output_units")?,
            compare_with: members.other_noise()?,
            found_by: members.found_by()?,
        })
    }
}

impl InverseLqeInputs {
    /// The question about L.
    pub(super) fn filter(&self, spec: &InverseSpec) -> Result<Half, Problem> {
        let labels = [
            WrittenLabels { of: "state", names: &self.state_names, units: &self.state_units },
            WrittenLabels { of: "output", names: &self.output_names, units: &self.output_units },
        ];
        let half = Half::filter([&self.a, &self.c, &self.l], self.sample_time_s, labels, (spec, "/spec"))?;
        check_feedthrough(self.d.as_ref(), half.gains.ports(), None)?;
        half.beside(["w", "v"], self.compare_with.as_ref().map(|other| (&other.w, &other.v)))
    }
}
