//! Inverse optimal control of a regulator: kind `inverse_lqr`.
//!
//! ```json
//! {"kind": "inverse_lqr", "inputs": {"a": [[0, 1], [2, 0]], "b": [[0], [1]], "k": [[5, 4]], "sample_time_s": null}}
//! ```
//! The method is that of [`inverse`](crate::inverse). An infeasible verdict is a result: it comes with its certificate,
//! and with the weights whose gain comes nearest.

mod inputs;

use super::contract::{Analysis, Failure, OfEarlier, Outcome};
use super::inputs::library::Library;
use super::inverse::answer::answer;
use super::inverse::found_by::{self, Asked};
use super::inverse::half::Half;
use super::inverse::regulator::InverseLqrResult;
use super::inverse::spec::{CheckedSpec, InverseSpec};
use super::kind::Kind;
use super::problem::Problem;
use crate::ctl::Ctl;
pub use inputs::InverseLqrInputs;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: InverseLqrInputs,
    half: Half,
    spec: CheckedSpec,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("inverse_lqr");
    const TITLE: &'static str = "Inverse optimal control of a regulator";
    const SUMMARY: &'static str = "Whether a state feedback gain is optimal for a quadratic cost of states and inputs, \
        with a certificate either way; the best conditioned weights where it is, proven by solving the forward \
        problem; and the nearest optimal gain where it is not (Priess 2015, section 3.2).";
    const RESULT_VERSION: u32 = 2;
    const EXAMPLE: &'static str = include_str!("example.json");
    const OF_EARLIER: Option<OfEarlier> = Some(|earlier| found_by::question(earlier, Asked::Regulator));

    type Inputs = InverseLqrInputs;
    type Spec = InverseSpec;
    type Result = InverseLqrResult;

    fn check(inputs: InverseLqrInputs, spec: InverseSpec) -> Result<Self, Problem> {
        let half = inputs.regulator(&spec)?;
        let spec = CheckedSpec::new(spec, &half.gains, "/spec")?;
        Ok(Self { inputs, half, spec })
    }

    fn inputs(&self) -> &InverseLqrInputs {
        &self.inputs
    }

    fn spec(&self) -> &InverseSpec {
        &self.spec.used
    }

    fn seed(&self) -> Option<u64> {
        self.spec.seed()
    }

    /// Progress counts the verdict and the fit.
    fn run(&self, _library: &Library, ctl: &Ctl) -> Result<Outcome<InverseLqrResult>, Failure> {
        ctl.set_total(2);
        let mut warnings = Vec::new();
        let result = answer(&self.half, &self.spec, &mut warnings, ctl)?;
        Ok(Outcome::new(result, warnings))
    }
}
