//! What keeps an identification from a result, as problems.

use crate::analysis::problem::{Code, Problem};
use crate::control::multivariable::MultivariableError;
use crate::control::time_base::BadSampleTime;
use crate::control::transfer_function::TransferFunctionError;
use crate::identify::mimo::MimoError;

pub(super) fn unusable_plant(error: &MultivariableError) -> Problem {
    Problem::new(Code::Invalid, "unusable plant", error.to_string()).at("/inputs/plant")
}

pub(super) fn no_sample_time() -> Problem {
    let detail =
        "the plant is continuous and the controllers are sampled, and there is no sample time to discretise it with";
    Problem::new(Code::Invalid, "no sample time", detail)
        .at("/spec/sample_time_s")
        .mend("Give sample_time_s, or the plant in sampled time.")
}

pub(super) fn bad_sample_time(error: &BadSampleTime) -> Problem {
    Problem::new(Code::Invalid, "unusable sample time", error.to_string()).at("/spec/sample_time_s")
}

pub(super) fn overflow(error: &TransferFunctionError) -> Problem {
    Problem::new(Code::Numerical, "coefficients overflow", error.to_string())
}

/// The problem of an error; [`MimoError::Stopped`] is none, and for the caller to tell apart.
pub(super) fn problem(error: &MimoError) -> Problem {
    let new = |code, title: &str| Problem::new(code, title, error.to_string());
    match error {
        MimoError::Stopped(_) => new(Code::Internal, "stopped"),
        MimoError::Output { list, .. } | MimoError::OutputList { list, .. } => {
            new(Code::Invalid, "unusable list of outputs").at(format!("/inputs/{list}"))
        }
        MimoError::PoolSize { .. } => new(Code::Invalid, "pool does not fit the plant")
            .at("/spec/pool/matrix_grid/feedback_numerator")
            .mend("Give one row for each input of the plant and one column for each fed-back output."),
        MimoError::ResponseSize { line, .. } => new(Code::Invalid, "response does not fit the plant")
            .at(format!("/inputs/frequency_response/h/{line}"))
            .mend("Give one row for each measured output and one column for each fed-back output."),
        MimoError::FewOutputs { .. } => new(Code::NotIdentifiable, "fewer outputs than controls")
            .at("/inputs/plant")
            .mend("Measure as many outputs as there are controls, merge controls, or use more lines."),
        MimoError::TooLarge { .. } => new(Code::Unaffordable, "plant too large").at("/inputs/plant"),
        MimoError::TooManyDerivatives { .. } => new(Code::Unaffordable, "problem too large")
            .at("/inputs/frequency_response")
            .mend("Use fewer lines, or lower feedforward_order."),
        MimoError::NotStrictlyProper { .. } => new(Code::Invalid, "loop without delay")
            .at("/spec/pool/matrix_grid")
            .mend("Lower the degree of the feedback's numerator, or give it a denominator."),
        MimoError::Unaffordable { listed, .. } => new(Code::Unaffordable, "candidate pool too large")
            .at("/spec/pool")
            .mend(format!("Coarsen its axes, or raise max_candidates to {listed} and take the time.")),
        MimoError::NoVariance => {
            new(Code::Invalid, "no variance").at("/spec/weights").mend("Use uniform weights, or give the variances.")
        }
        MimoError::NoLine { .. } => new(Code::NotIdentifiable, "no usable frequency line").at("/inputs"),
        MimoError::TooFewLines(_) | MimoError::Underdetermined { .. } => {
            new(Code::NotIdentifiable, "too few frequency lines")
                .at("/inputs/frequency_response")
                .mend("Use more lines, or lower feedforward_order.")
        }
        MimoError::NoneStable { .. } => new(Code::NotIdentifiable, "no stable candidate")
            .at("/spec/pool")
            .mend("Widen the pool, or lower its stability margin."),
        MimoError::NoConvergence(_) => new(Code::Numerical, "no closed-loop poles"),
        MimoError::NotFinite(_) => new(Code::Numerical, "coefficients overflow"),
    }
}
