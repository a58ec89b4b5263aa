//! What keeps the question from an answer, as problems.

use crate::analysis::plan::Failure;
use crate::analysis::problem::{Code, Problem};
use crate::inverse::fit::FitError;
use crate::inverse::lqr::InverseError;
use crate::inverse::{GainsError, StructureError};

/// A question that has no answer: the matrix, its size and the reason.
pub(super) fn gains(error: &GainsError) -> Problem {
    let at = |letter: &str| format!("/inputs/{}", letter.to_lowercase());
    let new = |code, title: &str, letter: &str| Problem::new(code, title, error.to_string()).at(at(letter));
    match error {
        GainsError::NotSquare { .. } => new(Code::Invalid, "A is not square", "a"),
        GainsError::Empty { matrix, .. } => new(Code::Invalid, "empty matrix", matrix),
        GainsError::Size { matrix, .. } => new(Code::Invalid, "sizes disagree", matrix).mend(
            "With n states, m inputs and p outputs A is n×n, B n×m, C p×n, K m×n and L n×p, each as an array of rows.",
        ),
        GainsError::TooManyStates { .. } => new(Code::Unaffordable, "too many states", "a"),
        GainsError::Entry { matrix, .. } => {
            new(Code::Invalid, "unusable entry", matrix).mend("Choose units in which the numbers are of moderate size.")
        }
        GainsError::ZeroGain { matrix, .. } => new(Code::Invalid, "zero gain", matrix),
        GainsError::UnstableLoop { product, .. } => {
            new(Code::Invalid, "unstable closed loop", if product.contains('K') { "k" } else { "l" })
                .mend("Only a gain that stabilises the plant can be optimal: check its sign (u = −Kx) and the plant.")
        }
        GainsError::Unreachable { matrix, .. } => {
            new(Code::Invalid, "uncontrollable or unobservable mode", matrix).mend("Leave out the states concerned.")
        }
        GainsError::NoConvergence(_) => new(Code::Numerical, "no eigenvalues", "a"),
    }
}

/// A structure that does not fit.
pub(super) fn structure(error: &StructureError, at: &str) -> Problem {
    let of = |matrix: &str| match matrix {
        "the pattern of Q" => "state_weight/pattern",
        "the pattern of R" => "port_weight/pattern",
        _ => "port_weight/fixed",
    };
    let place = match error {
        StructureError::Size { matrix, .. }
        | StructureError::NotSymmetric { matrix, .. }
        | StructureError::NoDiagonal { matrix, .. } => of(matrix),
        StructureError::NothingWeighed { .. } => "state_weight/pattern",
        StructureError::NotDefinite { .. } | StructureError::Entry { .. } | StructureError::Both => "port_weight/fixed",
    };
    Problem::new(Code::Invalid, "unusable structure", error.to_string()).at(format!("{at}/{place}"))
}

pub(super) fn inverse(error: &InverseError) -> Failure {
    match error {
        InverseError::Stopped(stopped) => Failure::Stopped(*stopped),
        InverseError::Structure(e) => structure(e, "/spec").into(),
        InverseError::NoConvergence(_)
        | InverseError::Unproven { .. }
        | InverseError::Undecided { .. }
        | InverseError::NoStart => Problem::new(Code::Numerical, "beyond working precision", error.to_string())
            .at("/inputs")
            .mend("Choose units in which states and inputs are of similar size.")
            .into(),
    }
}

pub(super) fn fit(error: &FitError) -> Failure {
    match error {
        FitError::Stopped(stopped) => Failure::Stopped(*stopped),
        FitError::Structure(e) => structure(e, "/spec").into(),
        FitError::ConditionNumber(_) => {
            Problem::new(Code::Invalid, "unusable spec", error.to_string()).at("/spec/fit/condition_numbers").into()
        }
        FitError::NoStart => Problem::new(Code::Numerical, "no fit", error.to_string()).at("/inputs").into(),
    }
}
