//! What keeps a question from an answer, as problems.

use crate::analysis::contract::Failure;
use crate::analysis::problem::{Code, Problem};
use crate::excite::compensator::DesignError;
use crate::excite::flatness::BandError;
use crate::excite::path::PathError;
use crate::excite::sequence::SequenceError;

/// A sequence that cannot be made; `at` is where it is in the request.
pub(in crate::analysis) fn sequence(error: &SequenceError, at: &str) -> Failure {
    if let SequenceError::Stopped(stopped) = error {
        return (*stopped).into();
    }
    let location = error.field().map_or_else(|| at.to_owned(), |field| format!("{at}/{field}"));
    let mend = match error {
        SequenceError::Order { .. } => "Choose an order from 2 on: 5 gives 242 ternary chips, 9 gives 511 binary ones.",
        SequenceError::ChipBelowSample { .. } => "Lengthen chip_s, or shorten sample_time_s.",
        SequenceError::NotPrimitive { .. } | SequenceError::NoSuchPolynomial { .. } => {
            "Choose a primitive polynomial by its index from 0, or leave it out."
        }
        SequenceError::AboveNyquist { .. } => "Lower the frequency, or shorten sample_time_s.",
        SequenceError::Length { .. } => "Shorten the sequence, or lengthen sample_time_s.",
        SequenceError::FilterOrder { .. } => "Widen transition_hz, or ask for less attenuation.",
        SequenceError::Integrated => "Choose prts, or another hold.",
        SequenceError::NoLines { .. } | SequenceError::Empty { .. } => "Widen the band, or lower base_hz.",
        _ => "",
    };
    let code = if matches!(error, SequenceError::Length { .. }) { Code::Unaffordable } else { Code::Invalid };
    let problem = Problem::new(code, "unusable sequence", error.to_string()).at(location);
    if mend.is_empty() { problem.into() } else { problem.mend(mend).into() }
}

/// A band that cannot be judged.
pub(in crate::analysis) fn band(error: &BandError, at: &str) -> Problem {
    let (code, title, mend) = match error {
        BandError::Empty { .. } => {
            (Code::Invalid, "empty band", "Give the upper end of the band in Hz, or [from, to] with from < to.")
        }
        BandError::AboveNyquist { .. } => {
            (Code::Invalid, "band above the Nyquist frequency", "Lower the band, or shorten the sample time.")
        }
        BandError::TooFewLines { .. } => {
            (Code::NotIdentifiable, "too few lines in the band", "Widen the band, or choose a longer period.")
        }
    };
    Problem::new(code, title, error.to_string()).at(at).mend(mend)
}

/// A plant or a loop that carries nothing.
pub(in crate::analysis) fn path(error: &PathError) -> Problem {
    let new = |code, title: &str, at: &str| Problem::new(code, title, error.to_string()).at(at);
    match error {
        PathError::SampleTime { part, .. } => {
            new(Code::Invalid, "two sample times", &format!("/inputs/{part}/sample_time_s"))
                .mend("Give the signal and its system one sample time, or the system in continuous time (null).")
        }
        PathError::Unstable { what, .. } if *what == "plant" => {
            new(Code::Invalid, "unstable plant", "/inputs/plant").mend("Give a controller that stabilises it.")
        }
        PathError::Unstable { .. } => new(Code::Invalid, "unstable loop", "/inputs/controller")
            .mend("Lower the gain, or check the sign: the loop is y = P u, u = C (r − y)."),
        PathError::MassDamper { field, .. } => new(Code::Invalid, "unusable plant", &format!("/inputs/plant/{field}")),
        PathError::Delay { .. } => new(Code::Invalid, "unusable delay", "/inputs/plant/delay_s")
            .mend("Give a whole number of samples, a longer sample time, or the plant in continuous time."),
        PathError::ContinuousLoop => new(Code::Invalid, "a loop in continuous time", "/spec/discretisation"),
        PathError::Improper { part } => new(Code::Invalid, "improper system", &format!("/inputs/{part}")),
        PathError::Discretise(_) => new(Code::Numerical, "the plant cannot be sampled", "/inputs/plant"),
        PathError::Loop(_) => new(Code::Invalid, "unusable loop", "/inputs"),
        PathError::Simulation(_) | PathError::NoConvergence(_) | PathError::Stopped(_) => {
            new(Code::Numerical, "beyond working precision", "/inputs")
        }
    }
}

/// A way that was not gone to its end.
pub(in crate::analysis) fn carried(error: &PathError) -> Failure {
    match error {
        PathError::Stopped(stopped) => (*stopped).into(),
        error => path(error).into(),
    }
}

/// A design without an answer.
pub(in crate::analysis) fn design(error: &DesignError) -> Failure {
    match error {
        DesignError::Stopped(stopped) => (*stopped).into(),
        DesignError::NothingStable { .. } => Problem::new(Code::Invalid, "nothing stable", error.to_string())
            .at("/spec")
            .mend("Widen gain_range, or lower limits/decay_per_s.")
            .into(),
        DesignError::Impossible(_) => Problem::new(Code::Invalid, "impossible limits", error.to_string())
            .at("/spec/limits")
            .mend(
                "Raise the limits to above these bounds, scale the signal's amplitude down (force and motion fall with \
                 it), or widen the ranges.",
            )
            .into(),
        DesignError::Limits { .. } => Problem::new(Code::Invalid, "contradictory limits", error.to_string())
            .at("/spec/limits")
            .mend("Raise the limits to above what was reached, widen the ranges, or scale the signal down.")
            .into(),
        DesignError::Path(PathError::Stopped(stopped)) => (*stopped).into(),
        DesignError::Path(error) => path(error).into(),
    }
}
