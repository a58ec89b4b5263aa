//! Inputs that tell the most: kind `input_design`.
//!
//! ```json
//! {"kind": "input_design",
//!  "inputs": {"model": {"name": "seated_balance", "initial": [0.01, 0, 0, 0]},
//!             "starts": [{"generator": {"kind": "prbs", "order": 6, "chip_s": 0.5, "amplitude": 6},
//!                         "sample_time_s": 0.1, "duration_s": 30}]},
//!  "spec": {"samples": 300, "sample_time_s": 0.1, "criterion": "t",
//!           "limits": {"input": 20, "outputs": {"lower_angle": 0.192, "upper_angle": 0.078, "torque": 60},
//!                      "differences": [{"of": ["upper_angle", "lower_angle"], "limit": 0.252}],
//!                      "autocorrelation": {"tolerance": 0.16}}}}
//! {"kind": "input_design",
//!  "inputs": {"model": {"parameters": [{"name": "k", "value": 4}, {"name": "b", "value": 1}],
//!                       "a": [[0, 1], ["-k", "-b"]], "b": [[0], [1]], "c": [[1, 0]]},
//!             "starts": [[1, 1, -1, -1, 1, -1, 1, 1, -1, 1]]},
//!  "spec": {"samples": 10, "sample_time_s": 0.5, "limits": {"input": 1}}}
//! ```
//! The method is that of [`excite::design`](crate::excite::design).

mod answer;
mod catalogue;
mod checked_spec;
mod findings;
mod inputs;
mod model;
mod model_input;
mod monte_carlo;
mod refusal;
mod result;
mod run;
mod spec;
mod starts;
mod task;
#[cfg(test)]
mod tests;

use super::contract::{Analysis, Failure, Outcome, Samples};
use super::inputs::library::Library;
use super::kind::Kind;
use super::problem::Problem;
use crate::ctl::Ctl;
use checked_spec::CheckedSpec;
pub use inputs::{InputDesignInputs, StartInput};
use model::Model;
pub use model_input::{Entry, FormulaModel, ModelInput, ModelName, ModelParameter, NamedModel};
pub use result::{
    DesignProof, InformationResult, InputDesignResult, LimitResult, MonteCarloParameter, MonteCarloResult,
    ParameterResult, SignalResult, StartResult, StartStop,
};
use serde_json::Value;
pub use spec::{AutocorrelationSpec, DifferenceLimit, InputDesignSpec, Limit, LimitsSpec, MonteCarloSpec};
use starts::Starts;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: InputDesignInputs,
    model: Box<Model>,
    starts: Starts,
    spec: Box<CheckedSpec>,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("input_design");
    const TITLE: &'static str = "Input design";
    const SUMMARY: &'static str = "The input that tells the most about the parameters of a linear model, within what a \
        person and a device can bear: from each start, steps of linear programs make Fisher's information larger until \
        none within the limits does, the limits are proven sample by sample, and simulated records check the predicted \
        standard deviations if wanted (Priess 2015, chapter 5).";
    const RESULT_VERSION: u32 = 2;
    const EXAMPLE: &'static str = include_str!("example.json");

    type Inputs = InputDesignInputs;
    type Spec = InputDesignSpec;
    type Result = InputDesignResult;

    fn check(inputs: InputDesignInputs, spec: InputDesignSpec) -> Result<Self, Problem> {
        let model = Box::new(match &inputs.model {
            ModelInput::Named(named) => catalogue::named(named)?,
            ModelInput::Formulas(formulas) => Model::of_formulas(formulas)?,
        });
        let spec = Box::new(CheckedSpec::new(spec, &model)?);
        let starts = Starts::new(&inputs.starts, &spec)?;
        Ok(Self { inputs, model, starts, spec })
    }

    fn inputs(&self) -> &InputDesignInputs {
        &self.inputs
    }

    fn spec(&self) -> &InputDesignSpec {
        &self.spec.used
    }

    fn seed(&self) -> Option<u64> {
        self.spec.used.monte_carlo.as_ref().map(|monte_carlo| monte_carlo.seed)
    }

    /// The designed input as `signal`, and the `start` that it was reached from.
    fn samples(result: &Value) -> Option<Samples> {
        Samples::named(&result["sample_time_s"], &[("signal", &result["input"]), ("start", &result["start_input"])])
    }

    /// Progress counts steps of the climbs and simulated records. Contradictory limits, and starts none of which can be
    /// used, are problems.
    fn run(&self, _library: &Library, ctl: &Ctl) -> Result<Outcome<InputDesignResult>, Failure> {
        let (result, warnings) = run::run(&self.model, &self.starts, &self.spec, ctl)?;
        Ok(Outcome::new(result, warnings))
    }
}
