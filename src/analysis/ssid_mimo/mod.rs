//! Subsystem identification with several inputs and outputs: the multivariable form of kind `ssid`.
//!
//! ```json
//! {"kind": "ssid",
//!  "inputs": {"plant": {"numerator": [[[1], [0]], [[0], [-1]]], "denominator": [[[1, 0.1], [0]], [[0], [1, -0.2]]], "sample_time_s": 1},
//!             "frequency_response": {"omega_rad_s": [0.1, 0.2], "h": [[[[1.1, 0.1], [0.9, -0.2]], [[0.3, 0], [0.8, 0.1]]],
//!                                                                   [[[1.0, 0.2], [0.9, -0.3]], [[0.2, 0], [0.7, 0.1]]]]}},
//!  "spec": {"pool": {"matrix_grid": {"feedback_numerator": [[[[0.2, 0.3]], [[1.0]]], [[[0.2]], [[0.4, 0.5]]]]}}, "feedforward_order": 1}}
//! ```
//! Asked for by its shape: matrices in `h`, a plant in one of the matrix forms, output lists, or a `matrix_grid`. Trials are recorded with one command and
//! one output, so that the data come with the request. The method is that of [`identify::mimo`](crate::identify::mimo).

mod inputs;
mod problems;
mod result;
mod spec;

use super::inputs::{Library, References};
use super::kind::{Kind, Request};
use super::plan::Failure;
use super::problem::Problem;
use super::report::{Report, Warning, sha256_json};
use crate::control::{Discrete, MultivariableSystem};
use crate::ctl::Ctl;
use crate::identify::mimo::{MimoError, Plant, Settings, check, identify};
pub use inputs::{MatrixFrequencyResponseInput, SsidMimoInputs};
pub use result::{MatrixCertificate, MatrixFit, MatrixFraction, MatrixNearOptimal, SsidMimoResult};
use serde_json::{Value, json};
use spec::CheckedSpec;
pub use spec::{MatrixGrid, MatrixPoolSpec, SsidMimoSpec};
use std::collections::BTreeMap;

/// Name and version of [`SsidMimoResult`].
const SCHEMA: &str = "volition.ssid_mimo/1";

/// Whether a request of kind `ssid` has the multivariable form.
#[must_use]
pub fn is_asked_for(request: &Request) -> bool {
    let has = |value: &Value, pointer: &str| value.pointer(pointer).is_some();
    let in_inputs = ["/plant/transfer_functions", "/plant/numerator", "/plant/denominator"]
        .into_iter()
        .chain(["/measured_outputs", "/fed_back_outputs"])
        .any(|pointer| has(&request.inputs, pointer));
    let has_matrices = request.inputs.pointer("/frequency_response/h/0/0").is_some_and(Value::is_array);
    in_inputs || has_matrices || has(&request.spec, "/pool/matrix_grid")
}

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: SsidMimoInputs,
    plant: Plant,
    /// Boxed: it is much larger than the plans of other kinds.
    spec: Box<CheckedSpec>,
}

impl Plan {
    /// Checks a request.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(request: &Request) -> Result<Self, Problem> {
        let mut inputs = SsidMimoInputs::parse(&request.inputs)?;
        let spec = Box::new(CheckedSpec::parse(&request.spec)?);
        let system = match inputs.plant.check().map_err(|error| problems::unusable_plant(&error))? {
            MultivariableSystem::Discrete(system) => system,
            MultivariableSystem::Continuous(system) => {
                let period = spec.written().sample_time_s.ok_or_else(problems::no_sample_time)?;
                let time = Discrete::new(period).map_err(|error| problems::bad_sample_time(&error))?;
                system.zero_order_hold(time).map_err(|error| problems::unusable_plant(&error))?
            }
        };
        let all = || (0..system.outputs()).collect::<Vec<usize>>();
        let measured = inputs.measured_outputs.get_or_insert_with(all).clone();
        let fed_back = inputs.fed_back_outputs.get_or_insert_with(all).clone();
        let plan = Self { inputs, plant: Plant { system, measured, fed_back }, spec };
        check(&plan.plant, &plan.inputs.frequency_response.data(), &plan.settings())
            .map_err(|error| problems::problem(&error))?;
        Ok(plan)
    }

    /// The stored things that it needs: none.
    #[must_use]
    pub fn references(&self) -> References {
        References::default()
    }

    /// The spec with its defaults filled in.
    #[must_use]
    pub fn spec(&self) -> &SsidMimoSpec {
        self.spec.written()
    }

    /// The request with its defaults filled in; parsing it again gives an equal plan.
    #[must_use]
    pub fn request(&self) -> Request {
        Request { kind: Kind::Ssid.name().to_owned(), inputs: json!(self.inputs), spec: json!(self.spec()) }
    }

    fn settings(&self) -> Settings {
        let written = self.spec();
        Settings {
            pool: self.spec.pool().clone(),
            feedforward_order: written.feedforward_order,
            weights: written.weights,
            max_candidates: written.max_candidates,
        }
    }

    /// Computes the report; progress counts listed candidates.
    ///
    /// # Errors
    /// [`Failure::Stopped`] when `ctl` says so, [`Failure::Problem`] when the inputs cannot answer the question.
    pub fn run(&self, _library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        let settings = self.settings();
        let data = self.inputs.frequency_response.data();
        let found = identify(&self.plant, &data, &settings, ctl).map_err(|error| match error {
            MimoError::Stopped(stopped) => Failure::Stopped(stopped),
            error => Failure::Problem(problems::problem(&error)),
        })?;
        let warnings = found.findings.iter().map(|f| Warning::new(f.code, f.message.clone())).collect();
        let result = SsidMimoResult::new(&found, &self.plant, settings.pool.margin());
        let result = result.map_err(|error| Failure::Problem(problems::overflow(&error)))?;
        let inputs = &self.inputs;
        let hashes = BTreeMap::from([
            ("/inputs/plant".to_owned(), sha256_json(&json!(inputs.plant))),
            ("/inputs/measured_outputs".to_owned(), sha256_json(&json!(inputs.measured_outputs))),
            ("/inputs/fed_back_outputs".to_owned(), sha256_json(&json!(inputs.fed_back_outputs))),
            ("/inputs/frequency_response".to_owned(), sha256_json(&json!(inputs.frequency_response))),
        ]);
        Ok(Report::with_schema(
            Kind::Ssid,
            SCHEMA.to_owned(),
            json!(result),
            warnings,
            json!(self.spec()),
            hashes,
            None,
        ))
    }
}

#[cfg(test)]
mod tests;
