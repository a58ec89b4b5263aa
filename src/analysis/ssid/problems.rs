//! What keeps an identification from a result, as problems.

use crate::analysis::problem::{Code, Problem};
use crate::analysis::trial_input::ResolvedTrial;
use crate::control::conversion::ConversionError;
use crate::control::{Model, ModelError, System};
use crate::identify::pool::PoolError;
use crate::identify::ssid::SsidError;

/// Sample times that differ by more than this share are not the same.
const SAME_SAMPLE_TIME: f64 = 1e-5;

/// The plant as a checked system.
pub(in crate::analysis) fn check_plant(plant: &Model, location: &str) -> Result<System, Problem> {
    plant.check().map_err(|error| {
        let problem = Problem::new(Code::Invalid, "unusable plant", error.to_string()).at(location.to_owned());
        if matches!(error, ModelError::Conversion(ConversionError::NotSingle { .. })) {
            problem.mend(
                "With several inputs or outputs give frequency_response with a matrix for each line and a matrix_grid as the pool; \
                 recorded trials have one of each.",
            )
        } else {
            problem
        }
    })
}

/// The plant that all trials were recorded on.
pub(in crate::analysis) fn common_plant(trials: &[ResolvedTrial]) -> Result<System, Problem> {
    let mut common: Option<(System, &str)> = None;
    for trial in trials {
        let Some(model) = trial.plant() else {
            return Err(Problem::new(Code::Invalid, "no plant", format!("{} has no plant", trial.name)).at("/inputs"));
        };
        let plant = check_plant(model, &trial.name)?;
        match &common {
            None => common = Some((plant, &trial.name)),
            Some((first, _)) if *first == plant => {}
            Some((_, name)) => {
                let detail = format!("{} and {name} were recorded on different plants", trial.name);
                return Err(Problem::new(Code::Invalid, "different plants", detail)
                    .at(trial.name.clone())
                    .mend("Identify them apart: averaging responses needs one plant."));
            }
        }
    }
    common
        .map(|(plant, _)| plant)
        .ok_or_else(|| Problem::new(Code::Invalid, "no trial", "there is no trial to identify from").at("/inputs"))
}

/// A sampled plant must have the trials' sample time.
pub(in crate::analysis) fn check_sample_times(plant: &System, trials: &[ResolvedTrial]) -> Result<(), Problem> {
    let Some(period) = plant.sample_time_s() else { return Ok(()) };
    for trial in trials {
        let own = trial.trial().sample_time_s;
        if (own - period).abs() > SAME_SAMPLE_TIME * period {
            let detail = format!("the plant is sampled every {period} s, the trial every {own} s");
            return Err(Problem::new(Code::Invalid, "different sample times", detail)
                .at(trial.name.clone())
                .mend("Give the plant at the trial's sample time, or in continuous time."));
        }
    }
    Ok(())
}

/// The problem of an error; [`SsidError::Stopped`] and [`SsidError::Interrupted`] are none, and for the caller to tell apart.
pub(in crate::analysis) fn problem(error: &SsidError) -> Problem {
    let new = |code, title: &str| Problem::new(code, title, error.to_string());
    match error {
        SsidError::Stopped(_) | SsidError::Interrupted(_) => new(Code::Internal, "stopped"),
        SsidError::Pool(pool) => pool_problem(pool, error),
        SsidError::Unaffordable { size, .. } => new(Code::Unaffordable, "candidate pool too large")
            .at("/spec/pool")
            .mend(format!("Thin the pool or coarsen its grids, or raise max_candidates to {size} and take the time.")),
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
        PoolError::NoFeedforward(_) | PoolError::NoFeedback(_) => new(Code::NotIdentifiable, "no stable candidate")
            .at("/spec/pool")
            .mend("Widen the pool, or lower its stability margin."),
    }
}
