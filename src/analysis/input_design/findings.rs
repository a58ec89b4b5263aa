//! What a scientist must read of a design.

use super::result::StartResult;
use super::task::{Reached, Task};
use crate::analysis::report::Warning;
use crate::excite::design::{Criterion, Stop, factor};

/// A predicted standard deviation above this share of the parameter makes first-order predictions doubtful.
const LARGE_DEVIATION: f64 = 0.3;
/// A parameter with more than this share of the trace decides a T-optimal design alone.
const LARGE_SHARE: f64 = 0.5;

/// What a scientist must read of the climbs.
pub(super) fn of_climbs(task: &Task<'_>, results: &[StartResult], best: &Reached, warnings: &mut Vec<Warning>) {
    let spec = &task.spec.used;
    if spec.noise_covariance.is_none() {
        warnings.push(Warning::new(
            "noise_assumed",
            "no noise_covariance is given: noise of variance 1 in the units of the outputs is assumed, and standard \
             deviations scale with the noise's",
        ));
    }
    for (i, result) in results.iter().enumerate() {
        if let Some(reason) = &result.refused {
            warnings.push(Warning::new("start_refused", format!("start {i} was not used: {reason}")));
        }
    }
    let used: Vec<f64> = results.iter().filter_map(|result| result.reached).collect();
    let parameters = task.information.parameters();
    let worst = used.iter().copied().fold(f64::INFINITY, f64::min);
    if used.len() < 2 {
        warnings.push(Warning::new(
            "one_start",
            "the design is a local optimum reached from one start; others may lead further",
        ));
    } else {
        let spread = factor(spec.criterion, best.value, worst, parameters);
        if spread > 1.02 {
            warnings.push(Warning::new(
                "starts_disagree",
                format!("the climbs end at different local optima; the best is {spread:.3} times as good as the worst"),
            ));
        }
    }
    if best.climb.stop == Stop::StepLimit {
        warnings
            .push(Warning::new("not_converged", format!("the best climb was stopped after {} steps", spec.max_steps)));
    }
    if best.climb.stop == Stop::SmallestRegion {
        warnings.push(Warning::new(
            "held_back",
            format!(
                "the best climb ended in its smallest trust region, where a step of the whole region might still gain \
                 {:.2} % to first order: the limit on the autocorrelation, or the criterion's curvature, holds it back",
                100.0 * best.climb.left
            ),
        ));
    }
    let fisher = task.information.fisher(&best.climb.input);
    let matrix = fisher.matrix();
    if spec.criterion == Criterion::T && parameters > 1 {
        let names = task.model.names();
        if let Some((name, share)) = names
            .iter()
            .enumerate()
            .map(|(i, name)| (name, matrix[(i, i)] / matrix.trace()))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|(_, share)| *share > LARGE_SHARE)
        {
            warnings.push(Warning::new(
                "trace_dominated",
                format!(
                    "{:.0} % of the trace is {name}'s, by its units: the design serves that parameter above all; \
                     scaled_t, d and a do not depend on units in this way",
                    100.0 * share
                ),
            ));
        }
    }
    if let Some(deviations) = fisher.deviations().filter(|_| spec.noise_covariance.is_some()) {
        let large: Vec<String> = task
            .model
            .names()
            .into_iter()
            .zip(deviations.iter().zip(&task.theta))
            .filter(|(_, (deviation, value))| **deviation > LARGE_DEVIATION * value.abs())
            .map(|(name, _)| name)
            .collect();
        if !large.is_empty() {
            warnings.push(Warning::new(
                "large_deviation",
                format!(
                    "even with the best input {} will be known to no better than 30 %: there the prediction is rough",
                    large.join(", ")
                ),
            ));
        }
    }
}
