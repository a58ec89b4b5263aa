//! Inverse optimal estimation: kind `inverse_lqe`.
//!
//! ```json
//! {"kind": "inverse_lqe", "inputs": {"a": [[0, 1], [2, 0]], "c": [[1, 0]], "l": [[4], [5]]}}
//! ```
//! The method is that of [`inverse`](crate::inverse): a filter is the dual of a regulator.

mod inputs;

use super::contract::{Analysis, Failure, OfEarlier, Outcome};
use super::inputs::library::Library;
use super::inverse::answer::answer;
use super::inverse::filter::InverseLqeResult;
use super::inverse::found_by::{self, Asked};
use super::inverse::half::Half;
use super::inverse::spec::{CheckedSpec, InverseSpec};
use super::kind::Kind;
use super::problem::Problem;
use crate::ctl::Ctl;
pub use inputs::InverseLqeInputs;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: InverseLqeInputs,
    half: Half,
    spec: CheckedSpec,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("inverse_lqe");
    const TITLE: &'static str = "Inverse optimal estimation";
    const SUMMARY: &'static str = "Whether the gain of a state estimator is that of a Kalman filter for some noises of \
        states and outputs, with a certificate either way; the best conditioned noises where it is, proven by solving \
        the forward problem; and the nearest optimal gain where it is not (Priess 2015, section 4.3: the dual of \
        inverse_lqr).";
    const RESULT_VERSION: u32 = 2;
    const EXAMPLE: &'static str = include_str!("example.json");
    const OF_EARLIER: Option<OfEarlier> = Some(|earlier| found_by::question(earlier, Asked::Filter));

    type Inputs = InverseLqeInputs;
    type Spec = InverseSpec;
    type Result = InverseLqeResult;

    fn check(inputs: InverseLqeInputs, spec: InverseSpec) -> Result<Self, Problem> {
        let half = inputs.filter(&spec)?;
        let spec = CheckedSpec::new(spec, &half.gains, "/spec")?;
        Ok(Self { inputs, half, spec })
    }

    fn inputs(&self) -> &InverseLqeInputs {
        &self.inputs
    }

    fn spec(&self) -> &InverseSpec {
        &self.spec.used
    }

    fn seed(&self) -> Option<u64> {
        self.spec.seed()
    }

    /// Progress counts the verdict and the fit.
    fn run(&self, _library: &Library, ctl: &Ctl) -> Result<Outcome<InverseLqeResult>, Failure> {
        ctl.set_total(2);
        let mut warnings = Vec::new();
        let result = answer(&self.half, &self.spec, &mut warnings, ctl)?.into();
        Ok(Outcome::new(result, warnings))
    }
}
