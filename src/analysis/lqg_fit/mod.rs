//! Costs and noises from trials: kind `lqg_fit`.
//!
//! ```json
//! {"kind": "lqg_fit",
//!  "inputs": {"plant": {"a": [[0, 1], [4, -0.3]], "b": [[0], [1]], "c": [[1, 0]]},
//!             "trial": {"sample_time_s": 0.02, "disturbance": [0.5, 0.5], "output": [0, 1e-3], "control": [0, -1]}},
//!  "spec": {"control_variance": [[0.0004]],
//!           "state_weight": [{"name": "position", "diagonal": [1, 0]}, {"name": "velocity", "diagonal": [0, 1]}]}}
//! ```
//! The method is that of [`crate::likelihood::lqg`].

mod answer;
mod assembly;
mod findings;
mod inputs;
mod refused;
mod result;
mod signals;
mod spec;
mod target;
mod terms;
#[cfg(test)]
mod tests;

use super::contract::{Analysis, Failure, Outcome};
use super::inputs::library::Library;
use super::kind::Kind;
use super::problem::{Code, Problem};
use crate::ctl::{Ctl, Phase};
use crate::likelihood::lqg::{self, FitError};
use answer::Found;
use assembly::Assembled;
pub use inputs::{LqgFitInputs, LqgFitPlant, LqgFitTrial, LqgFitTrialInput};
pub use result::{
    LqgFitCombination, LqgFitConvergence, LqgFitExplanation, LqgFitParameter, LqgFitRefusal, LqgFitResult, LqgFitRole,
    LqgFitSignal,
};
pub use spec::{
    LqgFitBelief, LqgFitControl, LqgFitControlDependentNoise, LqgFitDisturbance, LqgFitFirstGain, LqgFitHorizon,
    LqgFitInitialState, LqgFitScale, LqgFitSpec, LqgFitTarget, LqgFitTerm,
};

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: Box<LqgFitInputs>,
    spec: Box<LqgFitSpec>,
    /// What is fitted; `None` where the trials are stored ones.
    assembled: Option<Box<Assembled>>,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("lqg_fit");
    const TITLE: &'static str = "Costs and noises from trials";
    const SUMMARY: &'static str = "The costs that a person minimises, the noises that the person's filter is made for, \
        and the true noises, straight from one noisy trial or several by maximum likelihood: gain and filter are \
        functions of them. With profile intervals, all other persons who explain the same records as well, and no \
        number for what the records do not tell (Priess 2015, sections 4.3, 4.4.2 and 6.3).";
    const RESULT_VERSION: u32 = 1;
    const EXAMPLE: &'static str = include_str!("example.json");
    const TAKES_TRIALS: bool = true;

    type Inputs = LqgFitInputs;
    type Spec = LqgFitSpec;
    type Result = LqgFitResult;

    fn check(inputs: LqgFitInputs, spec: LqgFitSpec) -> Result<Self, Problem> {
        spec.check()?;
        let signals = signals::of_request(&inputs)?;
        let place = |i: usize| inputs.place(i);
        let assembled =
            signals.map(|signals| Assembled::new(&inputs, &spec, &signals, &place).map(Box::new)).transpose()?;
        Ok(Self { inputs: Box::new(inputs), spec: Box::new(spec), assembled })
    }

    fn inputs(&self) -> &LqgFitInputs {
        &self.inputs
    }

    fn spec(&self) -> &LqgFitSpec {
        &self.spec
    }

    fn seed(&self) -> Option<u64> {
        Some(self.spec.seed)
    }

    /// Progress counts draws, climbs and sides of profiles. A likelihood that is finite at no start is a problem.
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Outcome<LqgFitResult>, Failure> {
        let spec = &*self.spec;
        let fetched = match &self.assembled {
            Some(_) => None,
            None => {
                let signals = signals::of_library(&self.inputs, library)?;
                let place = |i: usize| self.inputs.place(i);
                Some(Assembled::new(&self.inputs, spec, &signals, &place)?)
            }
        };
        let assembled = match (&self.assembled, &fetched) {
            (Some(assembled), _) => assembled,
            (None, Some(fetched)) => fetched,
            (None, None) => unreachable!("the trials are in the request or in the library"),
        };
        let Assembled { design, records, time, .. } = assembled;
        let trials = lqg::Problem::new(design, records)
            .map_err(|error| Problem::new(Code::Invalid, "unusable trials", error.to_string()).at("/inputs"))?;
        let gains = {
            let _free = ctl.scope(0.1);
            ctl.enter(Phase::Preparation, 0.5);
            lqg::free_gains(design, records, *time, spec.seed, ctl)?
        };
        ctl.enter(Phase::Search, 0.1);
        let gains = gains.as_ref().map(|[k, l]| [k, l]);
        let fit = lqg::fit(&trials, gains, spec.starts, spec.seed, ctl).map_err(|error| match error {
            FitError::Stopped(stopped) => Failure::Stopped(stopped),
            FitError::NoStart { .. } => Problem::new(Code::Numerical, "no fit", error.to_string())
                .at("/inputs")
                .mend("Choose units in which signals and coefficients are of moderate size, or give starts.")
                .into(),
        })?;
        ctl.enter(Phase::Verification, 0.1);
        let hills = lqg::hills(&trials, &fit.best, &fit.bounds, ctl)?;
        let likelier =
            |x: &&lqg::Climbed, y: &&lqg::Climbed| x.evaluation.log_likelihood.total_cmp(&y.evaluation.log_likelihood);
        // A twin's hill is the answer only where it is higher by more than rounding.
        let higher =
            hills.climbs.iter().max_by(likelier).filter(|hill| {
                hill.evaluation.log_likelihood > fit.best.evaluation.log_likelihood + lqg::starts::ARRIVED
            });
        let best = higher.unwrap_or(&fit.best).clone();
        ctl.enter(Phase::Intervals, 0.3);
        let (best, known) = lqg::inference(&trials, best, &fit.bounds, spec.confidence, ctl)?;
        let explanations = lqg::explanations(&trials, &fit, &hills, &best, &known, ctl)?;
        let errors = trials.innovations(&best.theta, ctl)?.unwrap_or_default();
        let found = Found {
            spec,
            assembled,
            fit: &fit,
            hills: &hills,
            best: &best,
            known: &known,
            explanations: &explanations,
            errors: &errors,
        };
        let result = found.result();
        let warnings = findings::warnings(&result, hills.missing.as_ref());
        Ok(Outcome::new(result, warnings))
    }
}
