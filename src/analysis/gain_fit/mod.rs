//! Gains from trials: kind `gain_fit`.
//!
//! ```json
//! {"kind": "gain_fit",
//!  "inputs": {"plant": {"name": "seated_balance", "values": {"m1": 60}},
//!             "trials": [{"sample_time_s": 0.1, "input": [6, 6, -6],
//!                         "output": [[0, 0], [0.01, 0.002], [0.02, 0.003]]}]},
//!  "spec": {"delay": {"seconds": 0.0252}, "muscle_lag": {}, "free": ["k_h"], "bounds": {"k_h": [1, 100]}}}
//! {"kind": "gain_fit",
//!  "inputs": {"plant": {"a": [[0, 1], [4, 0]], "b": [[0], [1]]},
//!             "trials": [{"sample_time_s": 0.02, "input": [1], "output": [[0, 0]]}]}}
//! ```
//! The method is that of [`gain_fit`](crate::likelihood); what was found is then put the question of
//! [`inverse`](crate::inverse), with its uncertainty ([`optimality`]).

mod answer;
mod assembly;
mod findings;
mod inputs;
mod known_plant;
mod optimal_person;
mod optimality;
mod plant;
mod result;
mod signals;
mod spec;
#[cfg(test)]
mod tests;
mod trajectory;

use super::contract::{Analysis, Failure, Outcome};
use super::inputs::library::Library;
use super::kind::Kind;
use super::problem::Problem;
use crate::ctl::{Ctl, Phase};
use crate::likelihood::fit;
use crate::likelihood::uncertainty::Uncertainty;
use answer::{Found, no_fit};
use assembly::Loop;
pub use inputs::{GainFitInputs, GainFitTrial, GainFitTrialInput};
use known_plant::PlantSource;
pub use optimal_person::{FittedWeight, OptimalPersonResult, RatioNull};
pub use optimality::{NearestOptimal, OptimalityResult, OptimalityVerdict, WeightInterval};
pub use plant::{GainFitPlant, MatrixPlant, NamedPlant, PlantParameter};
pub use result::{
    BoundSide, FitConvergenceResult, FittedOutputResult, FittedParameterResult, GainFitResult,
    GainIdentifiabilityResult, InverseInputsResult, InverseLqgInputsResult, TwinResult,
};
use signals::{Signals, of_library, of_request};
pub use spec::{
    ConstraintName, DisturbanceKnowledge, GainFitSpec, GainFitWanted, InitialState, NoiseName, NoiseSpec,
    OptimalConstraint, OptimalSetting, OptimalitySpec, PerceivedNoise, PersonDelaySpec, PersonLagSpec,
};
use std::borrow::Cow;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: Box<GainFitInputs>,
    spec: Box<GainFitSpec>,
    /// The signals of the request; `None` where its trials are stored ones.
    signals: Option<Vec<Signals>>,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("gain_fit");
    const TITLE: &'static str = "Gains from trials";
    const SUMMARY: &'static str = "The gain K of a person who controls by u = −Kx, and named parameters of the plant \
        and of the person's delay and muscle, from one noisy trial or several by maximum likelihood, with intervals \
        and a test of the residuals; if wanted the gain of the person's filter too. It then says how surely the gain \
        is optimal for a quadratic cost, and for which; a person held to be optimal is fitted beside the free one, \
        with the ratio test between them (Priess 2015, sections 3.5, 5.2 and 6.3).";
    const RESULT_VERSION: u32 = 3;
    const EXAMPLE: &'static str = include_str!("example.json");
    const TAKES_TRIALS: bool = true;

    type Inputs = GainFitInputs;
    type Spec = GainFitSpec;
    type Result = GainFitResult;

    fn check(inputs: GainFitInputs, spec: GainFitSpec) -> Result<Self, Problem> {
        let signals = of_request(&inputs)?;
        spec.check()?;
        let place = |i: usize| inputs.place(i);
        match (&inputs.plant, &signals) {
            (Some(plant), Some(signals)) => {
                let source = PlantSource::Written(plant.clone());
                let assembled = Loop::new(&source, &spec, signals, &place)?;
                assembled.settings(&spec)?;
                if let Some(constraint) = &spec.constraint {
                    let [n, m, ..] = assembled.sizes;
                    optimal_person::checked(constraint, &source.state_names(n), m)?;
                }
                assembled.experiment(&spec, signals, &place)?;
            }
            (None, Some(_)) => return Err(inputs::no_plant()),
            (Some(plant), None) => {
                PlantSource::Written(plant.clone()).check(spec.free.as_deref())?;
            }
            (None, None) => {}
        }
        Ok(Self { inputs: Box::new(inputs), spec: Box::new(spec), signals })
    }

    fn inputs(&self) -> &GainFitInputs {
        &self.inputs
    }

    fn spec(&self) -> &GainFitSpec {
        &self.spec
    }

    fn seed(&self) -> Option<u64> {
        Some(self.spec.seed)
    }

    /// Progress counts climbs and draws. No start that makes the loop stable, and numbers that overflow, are problems.
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Outcome<GainFitResult>, Failure> {
        let (source, signals) = self.resolve(library)?;
        let (spec, place) = (&*self.spec, |i: usize| self.inputs.place(i));
        let assembled = Loop::new(&source, spec, &signals, &place)?;
        let settings = assembled.settings(spec)?;
        let experiment = assembled.experiment(spec, &signals, &place)?;
        let asked = spec.optimality.as_ref().map_or(0, |o| o.draws);
        let draws_share = if asked > 0 { 0.3 } else { 0.0 };
        // With a second fit the first is a part with phases of its own, and so is the second.
        let first = spec.constraint.as_ref().map(|_| ctl.scope(0.4));
        ctl.enter(Phase::Search, 0.1);
        let estimate = fit(&experiment, &settings, ctl).map_err(|error| no_fit(&error))?;
        ctl.enter(Phase::Intervals, 0.1);
        let uncertainty = Uncertainty::new(&experiment, &estimate, &settings.noise, &settings.bounds);
        let found = Found {
            spec,
            source: &source,
            assembled: &assembled,
            settings: &settings,
            experiment: &experiment,
            estimate: &estimate,
            uncertainty: &uncertainty,
        };
        drop(first);
        let optimal = match &spec.constraint {
            None => None,
            Some(constraint) => {
                let _second = ctl.scope(0.4);
                Some(optimal_person::held(&found, constraint, ctl)?)
            }
        };
        ctl.enter(Phase::Verification, if spec.constraint.is_some() { 0.2 } else { draws_share });
        let (mut result, no_twins) = found.result(ctl)?;
        result.optimal = optimal;
        let fit =
            findings::Fit { is_exact: estimate.is_exact, noise: &settings.noise, filter: assembled.filter, no_twins };
        let warnings = findings::warnings(spec, &result, &fit);
        Ok(Outcome::new(result, warnings))
    }
}

impl Plan {
    /// The plant and the signals, with stored trials fetched.
    fn resolve(&self, library: &Library) -> Result<(PlantSource, Cow<'_, [Signals]>), Problem> {
        match &self.signals {
            Some(signals) => {
                let plant = self.inputs.plant.clone().ok_or_else(inputs::no_plant)?;
                Ok((PlantSource::Written(plant), Cow::Borrowed(signals)))
            }
            None => of_library(&self.inputs, library).map(|(plant, signals)| (plant, Cow::Owned(signals))),
        }
    }
}
