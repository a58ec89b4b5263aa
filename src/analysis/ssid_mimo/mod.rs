//! Subsystem identification with several inputs and outputs: kind `ssid_mimo`.
//!
//! `example.json` beside this file is a request of the kind.
//!
//! Trials are recorded with one command and one output, so that the data come with the request. The method is that of
//! [`identify::mimo`](crate::identify::mimo).

mod inputs;
mod problems;
mod result;
mod spec;

use super::contract::{Analysis, Failure, Outcome};
use super::inputs::library::Library;
use super::kind::Kind;
use super::problem::Problem;
use super::report::Warning;
use crate::control::{Discrete, MultivariableSystem};
use crate::ctl::Ctl;
use crate::identify::mimo::{MimoError, Plant, Settings, check, identify};
pub use inputs::{MatrixResponses, SsidMimoInputs};
pub use result::{MatrixCertificate, MatrixFit, MatrixFraction, MatrixNearOptimal, SsidMimoResult};
use spec::CheckedSpec;
pub use spec::{MatrixGrid, MatrixPoolSpec, SsidMimoSpec};

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: SsidMimoInputs,
    plant: Plant,
    /// Boxed: it is much larger than the plans of other kinds.
    spec: Box<CheckedSpec>,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("ssid_mimo");
    const TITLE: &'static str = "Subsystem identification with several inputs and outputs";
    const SUMMARY: &'static str = "A person's feedforward and feedback with several controls, commands and outputs, in \
                                   sampled time, from matrices of frequency data: the exact optimum over a grid of \
                                   feedback matrix fractions whose loop is stable, each with the best FIR feedforward \
                                   (Zhang 2015, algorithm 4.1).";
    const RESULT_VERSION: u32 = 1;
    const EXAMPLE: &'static str = include_str!("example.json");

    type Inputs = SsidMimoInputs;
    type Spec = SsidMimoSpec;
    type Result = SsidMimoResult;

    fn check(mut inputs: SsidMimoInputs, spec: SsidMimoSpec) -> Result<Self, Problem> {
        let spec = Box::new(CheckedSpec::new(spec)?);
        let system = match inputs.plant.check().map_err(|error| problems::unusable_plant(&error))? {
            MultivariableSystem::Discrete(system) => system,
            MultivariableSystem::Continuous(system) => {
                let period = spec.used.sample_time_s.ok_or_else(problems::no_sample_time)?;
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

    fn inputs(&self) -> &SsidMimoInputs {
        &self.inputs
    }

    fn spec(&self) -> &SsidMimoSpec {
        &self.spec.used
    }

    /// Progress counts listed candidates.
    fn run(&self, _library: &Library, ctl: &Ctl) -> Result<Outcome<SsidMimoResult>, Failure> {
        let settings = self.settings();
        let data = self.inputs.frequency_response.data();
        let found = identify(&self.plant, &data, &settings, ctl).map_err(|error| match error {
            MimoError::Stopped(stopped) => Failure::Stopped(stopped),
            error => Failure::Problem(problems::problem(&error)),
        })?;
        let warnings = found.findings.iter().map(|f| Warning::new(f.code, f.message.clone())).collect();
        let result = SsidMimoResult::new(&found, &self.plant, settings.pool.margin());
        Ok(Outcome::new(result.map_err(|error| Failure::Problem(problems::overflow(&error)))?, warnings))
    }
}

impl Plan {
    fn settings(&self) -> Settings {
        Settings {
            pool: self.spec.pool.clone(),
            feedforward_order: self.spec.feedforward_order,
            weights: self.spec.weights,
            max_candidates: self.spec.max_candidates,
        }
    }
}

#[cfg(test)]
mod tests;
