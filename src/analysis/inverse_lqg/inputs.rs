//! The plant and both gains of a controller.

use super::Plan;
use super::spec::InverseLqgSpec;
use crate::analysis::contract::{Analysis as _, Inputs, Part};
use crate::analysis::inputs::library::References;
use crate::analysis::inverse::found_by::FoundBy;
use crate::analysis::inverse::half::{Half, WrittenLabels, check_feedthrough};
use crate::analysis::inverse::members::Members;
use crate::analysis::inverse::written::{OtherController, Trajectory, WrittenMatrix};
use crate::analysis::problem::Problem;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

/// The plant and both gains of a controller, with n states, m inputs and p outputs.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct InverseLqgInputs {
    /// A, n×n, in 1/s (in sampled time dimensionless), each entry times the unit of its row's state over that of its
    /// column's.
    pub a: WrittenMatrix,
    /// B, n×m, in units of the states (in continuous time per s) over those of the inputs.
    pub b: WrittenMatrix,
    /// C, p×n, in units of the outputs over those of the states.
    pub c: WrittenMatrix,
    /// D, p×m, in units of the outputs over those of the inputs; the answer does not depend on it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub d: Option<WrittenMatrix>,
    /// K of `u = −Kx`, m×n, in units of the inputs over those of the states; the loop A − BK must be stable.
    pub k: WrittenMatrix,
    /// L, n×p, in units of the states (in continuous time per s) over those of the outputs; A − LC must be stable.
    pub l: WrittenMatrix,
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
    /// Names of the p outputs. Default: y1, y2, ….
    #[serde(skip_serializing_if = "Option::is_none")]
    pub output_names: Option<Vec<String>>,
    /// Units of the p outputs, such as `rad`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub output_units: Option<Vec<String>>,
    /// A recorded trajectory, along which the regulator's cost is shared out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<Trajectory>,
    /// The weights of another subject or session.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compare_with: Option<OtherController>,
    /// The analysis that found the gains, written where the request names it. Default: none, they are the writer's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub found_by: Option<FoundBy>,
}

impl Inputs for InverseLqgInputs {
    fn references(&self) -> References {
        References { analyses: self.found_by.iter().map(|found| found.analysis).collect(), ..References::default() }
    }
}

impl Part for InverseLqgInputs {
    fn read(value: &Value, _at: &str) -> Result<Self, Problem> {
        let own = ["d", "input_names", "input_units", "output_names", "output_units", "trajectory"];
        let members = Members::new(value, Plan::KIND, &["a", "b", "c", "k", "l"], &own)?;
        Ok(Self {
            a: members.matrix("a")?,
            b: members.matrix("b")?,
            c: members.matrix("c")?,
            d: members.optional_matrix("d")?,
            k: members.matrix("k")?,
            l: members.matrix("l")?,
            sample_time_s: members.sample_time_s()?,
            state_names: members.texts("state_names")?,
            state_units: members.texts("state_units")?,
            input_names: members.texts("input_names")?,
            input_units: members.texts("input_units")?,
            output_names: members.texts("output_names")?,
            output_units: members.texts("output_units")?,
            trajectory: members.trajectory()?,
            compare_with: members.other_controller()?,
            found_by: members.found_by()?,
        })
    }
}

impl InverseLqgInputs {
    /// The questions about K and about L.
    pub(super) fn halves(&self, spec: &InverseLqgSpec) -> Result<(Half, Half), Problem> {
        let states = || WrittenLabels { of: "state", names: &self.state_names, units: &self.state_units };
        let inputs = WrittenLabels { of: "input", names: &self.input_names, units: &self.input_units };
        let outputs = WrittenLabels { of: "output", names: &self.output_names, units: &self.output_units };
        let other = self.compare_with.as_ref();
        let cost = other.and_then(|other| other.q.as_ref().zip(other.r.as_ref()));
        let noise = other.and_then(|other| other.w.as_ref().zip(other.v.as_ref()));
        let of_regulator = (&spec.regulator, "/spec/regulator");
        let regulator =
            Half::regulator([&self.a, &self.b, &self.k], self.sample_time_s, [states(), inputs], of_regulator)?;
        let of_filter = (&spec.filter, "/spec/filter");
        let filter = Half::filter([&self.a, &self.c, &self.l], self.sample_time_s, [states(), outputs], of_filter)?;
        check_feedthrough(self.d.as_ref(), filter.gains.ports(), Some(regulator.gains.ports()))?;
        let regulator = regulator.along(self.trajectory.as_ref())?.beside(["q", "r"], cost)?;
        Ok((regulator, filter.beside(["w", "v"], noise)?))
    }
}
