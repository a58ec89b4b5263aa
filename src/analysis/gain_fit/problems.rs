//! What keeps a fit from an answer, as problems.

use crate::analysis::plan::Failure;
use crate::analysis::problem::{Code, Problem};
use crate::likelihood::{ExperimentError, FitError};

pub(super) fn wrong_input(detail: impl Into<String>, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "unusable inputs", detail).at(at)
}

pub(super) fn wrong_spec(detail: impl Into<String>, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "unusable spec", detail).at(at)
}

/// Trials that do not fit the model; `at` gives the place of a trial.
pub(super) fn experiment(error: &ExperimentError, at: impl Fn(usize) -> String) -> Problem {
    let new = |code, location: String| Problem::new(code, "unusable trials", error.to_string()).at(location);
    match error {
        ExperimentError::Empty | ExperimentError::Silent => new(Code::Invalid, "/inputs/trials".to_owned()),
        ExperimentError::TooLong { .. } => new(Code::Unaffordable, "/inputs/trials".to_owned()),
        ExperimentError::TooShort { .. } => new(Code::Invalid, "/inputs/trials".to_owned())
            .mend("Record longer trials or more of them, or fit fewer parameters."),
        ExperimentError::Size { trial, signal, .. } => {
            let part = match *signal {
                "stimulus" => "input",
                "target" => "output",
                _ => "initial_state",
            };
            new(Code::Invalid, format!("{}/{part}", at(*trial)))
        }
    }
}

pub(super) fn fit(error: &FitError) -> Failure {
    match error {
        FitError::Stopped(stopped) => Failure::Stopped(*stopped),
        FitError::NoStart { .. } => Problem::new(Code::NotIdentifiable, "no stable loop", error.to_string())
            .at("/spec/bounds")
            .mend("Widen the bounds, check the signs of the plant (u = −Kx), or give a start that stabilises it.")
            .into(),
        FitError::NotFinite => Problem::new(Code::Numerical, "no fit", error.to_string())
            .at("/inputs")
            .mend("Choose units in which inputs, outputs and parameters are of moderate size.")
            .into(),
    }
}
