//! The design: climbs from every start, and the best of them.

use super::checked_spec::CheckedSpec;
use super::findings::of_climbs;
use super::model::Model;
use super::monte_carlo::monte_carlo;
use super::refusal::wrong;
use super::result::{InputDesignResult, StartResult, StartStop};
use super::starts::Starts;
use super::task::{Reached, Task};
use crate::analysis::contract::Failure;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::report::Warning;
use crate::ctl::{Ctl, Phase};
use crate::excite::design::limits::autocorrelation;
use crate::excite::design::{Autocorrelation, ClimbError, Limits, Settings, Stop, climb};

/// The trust region is halved until it is this share of what it begins with.
const LEAST_RADIUS: f64 = 1.0 / 64.0;

/// Climbs from every start, and says what the best one came to.
pub(super) fn run(
    model: &Model,
    starts: &Starts,
    spec: &CheckedSpec,
    ctl: &Ctl,
) -> Result<(InputDesignResult, Vec<Warning>), Failure> {
    let task = Task::new(model, spec)?;
    let starts = starts.sampled(spec.used.samples, ctl)?;
    let records = spec.used.monte_carlo.as_ref().map_or(0, |m| 2 * m.replicates as u64);
    // A fit of a record takes about as long as two steps of a climb.
    let climbs = (starts.len() * spec.used.max_steps) as f64;
    let climbs_share = climbs / (climbs + 2.0 * records as f64);
    let mut warnings = Vec::new();
    let mut results = Vec::new();
    let mut best: Option<Reached> = None;
    for (place, start) in starts.iter().enumerate() {
        ctl.enter(Phase::Search, climbs_share / starts.len() as f64);
        ctl.set_total(spec.used.max_steps as u64);
        let (result, reached) = task.climb(place, start, ctl)?;
        results.push(result);
        if let Some(reached) = reached
            && best.as_ref().is_none_or(|best| reached.value > best.value)
        {
            best = Some(reached);
        }
    }
    let Some(best) = best else { return Err(task.nothing(&starts, &results).into()) };
    of_climbs(&task, &results, &best, &mut warnings);
    ctl.enter(Phase::Verification, 1.0);
    ctl.set_total(records);
    let monte_carlo = monte_carlo(&task, &best, &mut warnings, ctl)?;
    Ok((task.result(results, best, monte_carlo, &mut warnings)?, warnings))
}

impl Task<'_> {
    /// The limits of a climb, whose autocorrelation may be that of its start.
    fn limits_for(&self, start: &[f64]) -> Option<Limits> {
        let mut limits = self.limits.clone();
        if let Some(wanted) = &self.spec.used.limits.autocorrelation {
            let lags = wanted.lags.unwrap_or(1);
            let reference = match &wanted.reference {
                Some(reference) => reference.clone(),
                None => autocorrelation(start, lags)?,
            };
            let margin = wanted.margin.unwrap_or(0.0);
            limits.autocorrelation = Some(Autocorrelation { reference, tolerance: wanted.tolerance, margin });
        }
        Some(limits)
    }

    fn settings(&self) -> Settings {
        Settings {
            criterion: self.spec.used.criterion,
            radius: self.spec.radius,
            tolerance: self.spec.used.tolerance,
            least_radius: LEAST_RADIUS,
            max_steps: self.spec.used.max_steps,
        }
    }

    fn climb(&self, place: usize, start: &[f64], ctl: &Ctl) -> Result<(StartResult, Option<Reached>), Failure> {
        let mut result = StartResult {
            scale: 1.0,
            refused: None,
            value: None,
            reached: None,
            factor: None,
            steps: 0,
            programs: 0,
            stop: None,
        };
        if start.iter().all(|u| *u == 0.0) {
            result.refused = Some("the start is zero throughout".to_owned());
            return Ok((result, None));
        }
        let mut start = start.to_vec();
        if self.spec.used.scale_to_fit {
            match self.limits.largest_scale(&start) {
                Some(scale) if scale > 0.0 => {
                    result.scale = scale;
                    start.iter_mut().for_each(|u| *u *= scale);
                }
                _ => {
                    result.refused = Some("no scale makes it keep to the limits".to_owned());
                    return Ok((result, None));
                }
            }
        }
        let Some(limits) = self.limits_for(&start) else {
            result.refused = Some("the start is too small to have an autocorrelation".to_owned());
            return Ok((result, None));
        };
        let criterion = self.spec.used.criterion;
        match climb(&self.information, &limits, &start, &self.settings(), ctl) {
            Ok(found) => {
                let value = self.information.fisher(&found.input).value(criterion);
                result.value = self.information.fisher(&start).value(criterion);
                result.reached = value;
                result.factor = Some(found.factor).filter(|f| f.is_finite());
                (result.steps, result.programs) = (found.steps, found.programs);
                result.stop = Some(match found.stop {
                    Stop::Converged => StartStop::Converged,
                    Stop::SmallestRegion => StartStop::SmallestRegion,
                    Stop::StepLimit => StartStop::StepLimit,
                });
                let reached = value.map(|value| Reached { place, start, limits, climb: found, value });
                Ok((result, reached))
            }
            Err(ClimbError::Stopped(stopped)) => Err(stopped.into()),
            Err(error) => {
                result.refused = Some(error.to_string());
                Ok((result, None))
            }
        }
    }

    /// Why no start came to anything.
    fn nothing(&self, starts: &[Vec<f64>], results: &[StartResult]) -> Problem {
        let reasons: Vec<String> = results
            .iter()
            .enumerate()
            .filter_map(|(i, result)| Some(format!("start {i}: {}", result.refused.as_ref()?)))
            .collect();
        let undetermined = starts.iter().find_map(|start| self.information.fisher(start).undetermined()).filter(|_| {
            self.spec.used.criterion.needs_inverse() && reasons.iter().all(|r| r.contains("no information"))
        });
        if let Some(undetermined) = undetermined {
            let combination = self.combination(&undetermined.weights);
            let words: Vec<String> = combination.iter().map(|(name, w)| format!("{w:+.3} {name}")).collect();
            return Problem::new(
                Code::NotIdentifiable,
                "a combination of parameters is not determined",
                format!("no start tells anything about {} (in units of their scales)", words.join(" ")),
            )
            .at("/inputs/model")
            .mend("Free fewer parameters, measure more outputs, give other starts, or ask for t or scaled_t.");
        }
        let fits = starts.iter().find_map(|start| self.limits.largest_scale(start).filter(|scale| *scale < 1.0));
        let mut problem = wrong(format!("no start can be used: {}", reasons.join("; ")), "/inputs/starts");
        problem = match fits {
            Some(scale) if !self.spec.used.scale_to_fit => {
                problem.mend(format!("Scale the start by {scale:.6} or less, or set scale_to_fit."))
            }
            _ => problem.mend("Give a start that keeps to every limit."),
        };
        problem
    }
}
