//! The plant and the gain of a regulator.

use super::Plan;
use crate::analysis::contract::{Analysis as _, Inputs, Part};
use crate::analysis::inputs::library::References;
use crate::analysis::inverse::found_by::FoundBy;
use crate::analysis::inverse::half::{Half, WrittenLabels};
use crate::analysis::inverse::members::Members;
use crate::analysis::inverse::spec::InverseSpec;
use crate::analysis::inverse::written::{OtherCost, Trajectory, WrittenMatrix};
use crate::analysis::problem::Problem;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

/// The plant and the gain of a regulator, with n states and m inputs.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct InverseLqrInputs {
    /// A, n×n, in 1/s (in sampled time dimensionless), each entry times the unit of its row's state over that of its
    /// column's.
    pub a: WrittenMatrix,
    /// B, n×m, in units of the states (in continuous time per s) over those of the inputs.
    pub b: WrittenMatrix,
    /// K of `u = −Kx`, m×n, in units of the inputs over those of the states; the loop A − BK must be stable.
    pub k: WrittenMatrix,
    /// The sample time in seconds; null in continuous time.
    pub sample_time_s: Option<f64>,
    /// Names of the n states. Default: x1, x2, ….
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state_names: Option<Vec<String>>,
    /// Units of the n states, such as `rad/s`; weights then have units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state_units: Option<Vec<String>>,
    /// Names of the m inputs. Default: u1, u2, ….
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input_names: Option<Vec<String>>,
    /// Units of the m inputs, such as `N m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input_units: Option<Vec<String>>,
    /// A recorded trajectory, along which the cost is shared out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<Trajectory>,
    /// The weights of another subject or session.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compare_with: Option<OtherCost>,
    /// The analysis that found the gains, written where the request names it. Default: none, they are the writer's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub found_by: Option<FoundBy>,
}

impl Inputs for InverseLqrInputs {
    fn references(&self) -> References {
        References { analyses: self.found_by.iter().map(|found| found.analysis).collect(), ..References::default() }
    }
}

impl Part for InverseLqrInputs {
    fn read(value: &Value, _at: &str) -> Result<Self, Problem> {
        let own = ["input_names", "input_units", "trajectory"];
        let members = Members::new(value, Plan::KIND, &["a", "b", "k"], &own)?;
        Ok(Self {
            a: members.matrix("a")?,
            b: members.matrix("b")?,
            k: members.matrix("k")?,
            sample_time_s: members.sample_time_s()?,
            state_names: members.texts("state_names")?,
            state_units: members.texts("state_units")?,
            input_names: members.texts("input_names")?,
            input_units: members.texts("input_units")?,
            trajectory: members.trajectory()?,
            compare_with: members.other_cost()?,
            found_by: members.found_by()?,
        })
    }
}

impl InverseLqrInputs {
    /// The question about K.
    pub(super) fn regulator(&self, spec: &InverseSpec) -> Result<Half, Problem> {
        let labels = [
            WrittenLabels { of: "state", names: &self.state_names, units: &self.state_units },
            WrittenLabels { of: "input", names: &self.input_names, units: &self.input_units },
        ];
        Half::regulator([&self.a, &self.b, &self.k], self.sample_time_s, labels, (spec, "/spec"))?
            .along(self.trajectory.as_ref())?
            .beside(["q", "r"], self.compare_with.as_ref().map(|other| (&other.q, &other.r)))
    }
}
