//! Inputs that tell the most: kind `input_design`.
//!
//! ```json
//! {"kind": "input_design",
//!  "inputs": {"model": {"name": "seated_balance", "initial": [0.01, 0, 0, 0]},
//!             "starts": [{"generator": {"kind": "prbs", "order": 6, "chip_s": 0.5, "amplitude": 6}, "sample_time_s": 0.1, "duration_s": 30}]},
//!  "spec": {"samples": 300, "sample_time_s": 0.1, "criterion": "t",
//!           "limits": {"input": 20, "outputs": {"lower_angle": 0.192, "upper_angle": 0.078, "torque": 60},
//!                      "differences": [{"of": ["upper_angle", "lower_angle"], "limit": 0.252}], "autocorrelation": {"tolerance": 0.16}}}}
//! {"kind": "input_design",
//!  "inputs": {"model": {"parameters": [{"name": "k", "value": 4}, {"name": "b", "value": 1}],
//!                       "a": [[0, 1], ["-k", "-b"]], "b": [[0], [1]], "c": [[1, 0]]},
//!             "starts": [[1, 1, -1, -1, 1, -1, 1, 1, -1, 1]]},
//!  "spec": {"samples": 10, "sample_time_s": 0.5, "limits": {"input": 1}}}
//! ```
//! The method is that of [`excite::design`](crate::excite::design).

mod catalogue;
mod findings;
mod model;
mod monte_carlo;
mod result;
mod run;
mod spec;
mod starts;

use super::inputs::{Library, References};
use super::kind::{Kind, Request};
use super::plan::Failure;
use super::problem::{Code, Problem};
use super::report::{Report, sha256_json};
use crate::ctl::Ctl;
use model::Model;
pub use model::{Entry, FormulaModel, ModelInput, ModelName, ModelParameter, NamedModel};
pub use result::{
    DesignProof, InformationResult, InputDesignResult, LimitResult, MonteCarloParameter, MonteCarloResult,
    ParameterResult, SignalResult, StartResult,
};
use serde_json::{Value, json};
use spec::CheckedSpec;
pub use spec::{AutocorrelationSpec, DifferenceLimit, InputDesignSpec, Limit, LimitsSpec, MonteCarloSpec};
use starts::Starts;
pub use starts::{InputDesignInputs, StartInput};
use std::collections::BTreeMap;

/// Version of [`InputDesignResult`].
const RESULT_VERSION: u32 = 1;

fn wrong(detail: impl Into<String>, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "impossible design", detail).at(at)
}

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    written: ModelInput,
    model: Box<Model>,
    starts: Starts,
    spec: Box<CheckedSpec>,
}

impl Plan {
    /// Checks a request.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(request: &Request) -> Result<Self, Problem> {
        let members = request.inputs.as_object().ok_or_else(|| wrong("the inputs are no object", "/inputs"))?;
        for name in members.keys() {
            if !matches!(name.as_str(), "model" | "starts") {
                return Err(wrong(format!("input_design takes no input {name:?}"), "/inputs")
                    .mend("It takes model and starts."));
            }
        }
        let value = members.get("model").ok_or_else(|| {
            wrong("there is no model", "/inputs").mend("Give a model of the catalogue by name, or matrices.")
        })?;
        let (written, model) = Model::parse(value)?;
        let spec = CheckedSpec::parse(&request.spec, &model)?;
        let starts = Starts::parse(members.get("starts"), &spec)?;
        Ok(Self { written, model: Box::new(model), starts, spec: Box::new(spec) })
    }

    /// None: the model comes with the request.
    #[must_use]
    pub fn references(&self) -> References {
        References::default()
    }

    /// The request with its defaults filled in; parsing it again gives an equal plan.
    #[must_use]
    pub fn request(&self) -> Request {
        let inputs = json!({"model": self.written, "starts": self.starts.written()});
        Request { kind: Kind::InputDesign.name().to_owned(), inputs, spec: json!(self.spec.written) }
    }

    /// Computes the report; progress counts steps of the climbs and simulated records.
    ///
    /// # Errors
    /// [`Failure::Stopped`] when `ctl` says so, [`Failure::Problem`] for contradictory limits, or starts none of which can be used.
    pub fn run(&self, _library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        let (result, warnings) = run::run(&self.model, &self.starts, &self.spec, ctl)?;
        let inputs = self.request().inputs;
        let hash = |name: &str| (format!("/inputs/{name}"), sha256_json(&inputs[name]));
        let hashes: BTreeMap<String, String> = BTreeMap::from([hash("model"), hash("starts")]);
        let seed = self.spec.written.monte_carlo.as_ref().map(|monte_carlo| monte_carlo.seed);
        let spec: Value = json!(self.spec.written);
        Ok(Report::new(Kind::InputDesign, RESULT_VERSION, json!(result), warnings, spec, hashes, seed))
    }
}

#[cfg(test)]
mod tests;
