//! What keeps the question from an answer, as problems.

use super::structure_spec::structure_problem;
use crate::analysis::contract::Failure;
use crate::analysis::problem::{Code, Problem};
use crate::inverse::GainsError;
use crate::inverse::fit::FitError;
use crate::inverse::lqr::InverseError;

/// A question that has no answer: the matrix, its size and the reason.
/// `spec` is the pointer of the spec of the half.
pub(in crate::analysis) fn gains(error: &GainsError, spec: &str) -> Problem {
    let new = |code, title: &str| {
        Problem::new(code, title, error.to_string()).at(format!("/inputs/{}", error.matrix().to_lowercase()))
    };
    match error {
        GainsError::NotSquare { .. } => new(Code::Invalid, "A is not square"),
        GainsError::Empty { .. } => new(Code::Invalid, "empty matrix"),
        GainsError::Size { .. } => new(Code::Invalid, "sizes disagree").mend(
            "With n states, m inputs and p outputs A is n×n, B n×m, C p×n, K m×n and L n×p, each as an array of rows.",
        ),
        GainsError::TooManyStates { .. } => new(Code::Unaffordable, "too many states"),
        GainsError::Entry { .. } => {
            new(Code::Invalid, "unusable entry").mend("Choose units in which the numbers are of moderate size.")
        }
        GainsError::UnstableLoop { .. } => new(Code::Invalid, "unstable closed loop")
            .mend("Only a gain that stabilises the plant can be optimal: check its sign (u = −Kx) and the plant."),
        GainsError::MarginalLoop { .. } => new(Code::Invalid, "closed loop stable only within rounding").mend(
            "No verdict on such a loop means anything: print the gain with all its digits, or choose units in which \
             plant and gain are of similar size.",
        ),
        GainsError::Unreachable { .. } => new(Code::Invalid, "nothing to control or to observe"),
        GainsError::EndlessCost { .. } => new(Code::Invalid, "infinite cost of a set point").mend(
            "A target that lasts must be held at no cost: KV = 0 over its set point V. Give a discount, leave out the \
             states concerned, or check the part of the gain that answers them.",
        ),
        GainsError::Knowledge(_) => {
            let place = if error.to_string().contains("rounding") { "gain_rounding" } else { "discount" };
            Problem::new(Code::Invalid, "unusable spec", error.to_string()).at(format!("{spec}/{place}"))
        }
        GainsError::NoConvergence(_) => new(Code::Numerical, "no eigenvalues"),
    }
}

pub(super) fn inverse(error: &InverseError) -> Failure {
    match error {
        InverseError::Stopped(stopped) => Failure::Stopped(*stopped),
        InverseError::Structure(e) => structure_problem(e, "/spec").into(),
        InverseError::NoConvergence(_) | InverseError::Linear(_) | InverseError::NoStart => {
            Problem::new(Code::Numerical, "beyond working precision", error.to_string())
                .at("/inputs")
                .mend("Choose units in which states and inputs are of similar size.")
                .into()
        }
    }
}

pub(super) fn fit(error: &FitError) -> Failure {
    match error {
        FitError::Stopped(stopped) => Failure::Stopped(*stopped),
        FitError::Structure(e) => structure_problem(e, "/spec").into(),
        FitError::ConditionNumber(_) => {
            Problem::new(Code::Invalid, "unusable spec", error.to_string()).at("/spec/fit/condition_numbers").into()
        }
        FitError::NoStart => Problem::new(Code::Numerical, "no fit", error.to_string()).at("/inputs").into(),
    }
}
