//! Inverse optimal control of a whole controller: kind `inverse_lqg`.
//!
//! ```json
//! {"kind": "inverse_lqg", "inputs": {"a": [[0, 1], [2, 0]], "b": [[0], [1]], "c": [[1, 0]],
//!                                    "k": [[5, 4]], "l": [[4], [5]]},
//!  "spec": {"regulator": {"state_weight": "diagonal"}}}
//! ```
//! By the separation principle the two halves are two questions: those of `inverse_lqr` and `inverse_lqe`.

mod inputs;
mod result;
mod spec;

use super::contract::{Analysis, Failure, OfEarlier, Outcome};
use super::inputs::library::Library;
use super::inverse::answer::answer;
use super::inverse::found_by::{self, Asked};
use super::inverse::half::Half;
use super::inverse::spec::CheckedSpec;
use super::kind::Kind;
use super::problem::Problem;
use crate::ctl::Ctl;
pub use inputs::InverseLqgInputs;
pub use result::InverseLqgResult;
pub use spec::InverseLqgSpec;

/// A half with its checked spec.
type Question = (Half, CheckedSpec);

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: InverseLqgInputs,
    spec: InverseLqgSpec,
    regulator: Box<Question>,
    filter: Box<Question>,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("inverse_lqg");
    const TITLE: &'static str = "Inverse optimal control of a whole controller";
    const SUMMARY: &'static str = "Whether a controller of state feedback and estimator is linear-quadratic-Gaussian \
        for a cost and noises: the questions of inverse_lqr about its gain K and of inverse_lqe about its gain L, one \
        verdict on both, and the weights Q, R, W and V (Priess 2015, section 4.3).";
    const RESULT_VERSION: u32 = 2;
    const EXAMPLE: &'static str = include_str!("example.json");
    const OF_EARLIER: Option<OfEarlier> = Some(|earlier| found_by::question(earlier, Asked::Whole));

    type Inputs = InverseLqgInputs;
    type Spec = InverseLqgSpec;
    type Result = InverseLqgResult;

    fn check(inputs: InverseLqgInputs, spec: InverseLqgSpec) -> Result<Self, Problem> {
        let (regulator, filter) = inputs.halves(&spec)?;
        let for_regulator = CheckedSpec::new(spec.regulator.clone(), &regulator.gains, "/spec/regulator")?;
        let for_filter = CheckedSpec::new(spec.filter.clone(), &filter.gains, "/spec/filter")?;
        let (regulator, filter) = (Box::new((regulator, for_regulator)), Box::new((filter, for_filter)));
        Ok(Self { inputs, spec, regulator, filter })
    }

    fn inputs(&self) -> &InverseLqgInputs {
        &self.inputs
    }

    fn spec(&self) -> &InverseLqgSpec {
        &self.spec
    }

    /// That of the first half that may draw random starts.
    fn seed(&self) -> Option<u64> {
        self.regulator.1.seed().or(self.filter.1.seed())
    }

    /// Progress counts the verdict and the fit of each half.
    fn run(&self, _library: &Library, ctl: &Ctl) -> Result<Outcome<InverseLqgResult>, Failure> {
        ctl.set_total(4);
        let mut warnings = Vec::new();
        let mut half = |(half, spec): &Question| answer(half, spec, &mut warnings, ctl);
        let (regulator, filter) = (half(&self.regulator)?, half(&self.filter)?);
        Ok(Outcome::new(InverseLqgResult::new(regulator, filter.into()), warnings))
    }
}
