//! What keeps an identification from a result, as problems.

use crate::analysis::problem::{Code, Problem};
use crate::identify::pool::PoolError;
use crate::identify::ssid::SsidError;

/// The problem of an error; [`SsidError::Stopped`] and [`SsidError::Interrupted`] are none, and for the caller to tell
/// apart.
#[must_use]
pub fn problem(error: &SsidError) -> Problem {
    let new = |code, title: &str| Problem::new(code, title, error.to_string());
    match error {
        SsidError::Stopped(_) | SsidError::Interrupted(_) => new(Code::Internal, "stopped"),
        SsidError::Pool(pool) => pool_problem(pool, error),
        SsidError::Unaffordable { size, .. } => new(Code::Unaffordable, "candidate pool too large")
            .at("/spec/pool")
            .mend(format!("Thin the pool or coarsen its grids, or raise max_candidates to {size} and take the time.")),
        SsidError::PlantDelay(_) => new(Code::Invalid, "unusable delay of the plant")
            .at("/inputs/plant/delay_s")
            .mend("Give a delay of whole samples of the controllers, or continuous controllers."),
        SsidError::UnstableWithDelay { .. } => new(Code::NotIdentifiable, "no stable candidate with the delay")
            .at("/spec/pool")
            .mend("Use a smaller range of feedback gains, or raise the stability margin."),
        SsidError::NoSampleTime => new(Code::Invalid, "no sample time")
            .at("/spec/sample_time_s")
            .mend("Give sample_time_s, or the plant in sampled time."),
        SsidError::SampleTime(_) => new(Code::Invalid, "unusable sample time").at("/spec/sample_time_s"),
        SsidError::Discretise(_) => {
            new(Code::Invalid, "plant cannot be discretised").at("/inputs").mend("Give the plant in sampled time.")
        }
        SsidError::NoVariance => new(Code::Invalid, "no variance")
            .at("/spec/weights")
            .mend("Use uniform weights, more segments, or give the variances."),
        SsidError::NoLine(_) => new(Code::NotIdentifiable, "no usable frequency line").at("/inputs"),
        SsidError::TooFewLines(_) | SsidError::Underdetermined { .. } => {
            new(Code::NotIdentifiable, "too few frequency lines")
                .at("/inputs")
                .mend("Use more lines, or lower the degrees of the controllers.")
        }
        SsidError::NoConvergence(_) => new(Code::Numerical, "no closed-loop poles"),
        SsidError::NotFinite(_) => new(Code::Numerical, "coefficients overflow"),
    }
}

fn pool_problem(pool: &PoolError, error: &SsidError) -> Problem {
    let new = |code, title: &str| Problem::new(code, title, error.to_string());
    let unusable = |location: &str| new(Code::Invalid, "pool does not fit the plant").at(location.to_owned());
    match pool {
        PoolError::Stopped(_) => new(Code::Internal, "stopped"),
        PoolError::ContinuousPoolSampledPlant { .. } => {
            unusable("/spec/pool").mend("Give the plant in continuous time, or take a sampled pool.")
        }
        PoolError::SampledPoolContinuousPlant => unusable("/spec/pool"),
        PoolError::NotStrictlyProper { .. } => unusable("/spec/feedback_numerator_degree")
            .mend("Lower the degree of the feedback numerator (assumption A2.2 of Zhang 2015)."),
        PoolError::ZeroPlant => new(Code::NotIdentifiable, "the plant is zero").at("/inputs"),
        PoolError::DegreeTooHigh { .. } => unusable("/inputs"),
        PoolError::Noncausal { part, .. } => match *part {
            "plant" => {
                unusable("/inputs").mend("A sampled plant needs a numerator of no higher degree than its denominator.")
            }
            part => unusable(&format!("/spec/{part}_numerator_degree")).mend("Lower the degree of the numerator."),
        },
        PoolError::NoDenominators(_) => unusable("/spec/feedforward_denominator_degree").mend(
            "Set it to 0, list feedforward denominators in the pool, or take a sampled pool (\"time\": \"sampled\").",
        ),
        PoolError::AboveNyquist { .. } => unusable("/spec/pool").mend("Lower the band, or use a shorter sample time."),
        PoolError::TooLarge { .. } | PoolError::Overflow => new(Code::Unaffordable, "candidate pool too large")
            .at("/spec/pool")
            .mend("Thin the pool or coarsen its grids."),
        PoolError::HiddenMode { .. } => {
            new(Code::NotIdentifiable, "the plant has a hidden unstable mode").at("/inputs").mend(
                "If the mode is no part of the object, divide numerator and denominator of the plant by the common \
                 factor; if it is, no person can hold it by what y shows, and the model of the plant is wrong.",
            )
        }
        PoolError::UnstablePlant => new(Code::NotIdentifiable, "no stable loop without feedback")
            .at("/spec/held_at_zero")
            .mend("Leave the feedback free: nobody keeps such a plant without it. Or lower the stability margin."),
        PoolError::NoConvergence(_) => new(Code::Numerical, "no plant poles").at("/inputs"),
        PoolError::NoFeedforward(_) | PoolError::NoFeedback(_) => new(Code::NotIdentifiable, "no stable candidate")
            .at("/spec/pool")
            .mend("Widen the pool, or lower its stability margin."),
    }
}
