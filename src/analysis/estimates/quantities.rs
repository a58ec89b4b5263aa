//! Every quantity that people take from a report, with how far it may be used.

use super::answers::answers;
use crate::analysis::{Analysis as _, Report};
use crate::analysis::{gain_fit, inverse_lqe, inverse_lqg, inverse_lqr, lqg_fit};
use crate::control::Model;
use crate::learning::inputs::Estimator;
use crate::learning::trust_of_identification;
use crate::trust::{CONSTANTS, Level, Reason, Trust, not_identified, worst_of};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A quantity of a report with how far it may be used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct QuantityTrust {
    /// The place of the trial that it is about among those of the analysis, from 0.
    pub position: usize,
    /// How the controllers were estimated; null of what is no norm of controllers.
    pub estimator: Option<Estimator>,
    /// The value in its own unit; null where it has none, or is a matrix.
    pub value: Option<f64>,
    /// Its 95 % interval in the same unit; null where there is none.
    pub interval_95: Option<[f64; 2]>,
    /// How far it may be used.
    #[serde(flatten)]
    pub trust: Trust,
}

/// The quantities of a report about trials on `plant`: a pure function of both. Divergence is no part of it, since a
/// study's display limit may change.
///
/// Of a report about several trials only those quantities are told that it tells trial by trial, or that it has one of.
#[must_use]
pub fn quantities(report: &Report, plant: Option<&Model>) -> Vec<QuantityTrust> {
    let mut all = Vec::new();
    for answer in answers(report, plant) {
        // A report that cannot be read has no quantities, as a curve leaves it out.
        let Ok(found) = &answer.found else { continue };
        all.extend(trust_of_identification(found).into_iter().map(|own| QuantityTrust {
            position: answer.position,
            estimator: Some(answer.estimator),
            value: own.value,
            interval_95: own.interval_95,
            trust: own.trust,
        }));
    }
    let others = if report.kind == gain_fit::Plan::KIND {
        gains(report)
    } else if report.kind == lqg_fit::Plan::KIND {
        costs_from_trials(&report.result)
    } else {
        costs(report)
    };
    all.extend(others.into_iter().map(|(value, interval_95, trust)| QuantityTrust {
        position: 0,
        estimator: None,
        value,
        interval_95,
        trust,
    }));
    all
}

/// A value, its interval and the trust in it.
type Judged = (Option<f64>, Option<[f64; 2]>, Trust);

/// Warnings that say which parameters of a fit the data do not determine: all of them, as far as none has an interval.
const NOT_DETERMINED: [&str; 4] =
    ["not_identifiable", "starts_disagree", "parameters_not_determined", "gain_and_filter"];

fn reason(level: Level, code: &str, because: impl Into<String>) -> Reason {
    Reason { level, code: code.to_owned(), because: because.into() }
}

/// The parameters of a fit of gains.
fn gains(report: &Report) -> Vec<Judged> {
    let undetermined = report.warnings.iter().find(|warning| NOT_DETERMINED.contains(&warning.code.as_str()));
    let converged = report.result.pointer("/convergence/converged").and_then(Value::as_bool).unwrap_or(true);
    let list = report.result.get("parameters").and_then(Value::as_array).into_iter().flatten();
    let one = |parameter: &Value| {
        let name = parameter.get("name")?.as_str()?;
        let value = parameter.get("value")?.as_f64()?;
        let ends = parameter.get("interval").and_then(Value::as_array);
        let interval = ends.and_then(|ends| Some([ends.first()?.as_f64()?, ends.get(1)?.as_f64()?]));
        let mut found = Vec::new();
        match interval {
            None => match undetermined {
                Some(warning) => found.push(reason(
                    Level::DoNotUse,
                    "parameter_not_determined",
                    format!("the data do not determine it ({})", warning.code),
                )),
                None => found.push(reason(Level::Read, "no_interval", "no interval: it is held by a bound")),
            },
            Some([low, high]) => found.extend(width(value, [low, high])),
        }
        if !converged {
            found.push(reason(Level::Read, "not_converged", "the fit did not arrive"));
        }
        Some((Some(value), interval, worst_of(name, found, "ok")))
    };
    list.filter_map(one).collect()
}

/// What the width of an interval says of a value of either sign.
fn width(value: f64, [low, high]: [f64; 2]) -> Option<Reason> {
    let half = 0.5 * (high - low);
    let because = || format!("its 95 % interval runs from {low:.3} to {high:.3}");
    if half > CONSTANTS.half_width_do_not_use * value.abs() {
        Some(reason(Level::DoNotUse, "interval_too_wide", because()))
    } else {
        (half > CONSTANTS.half_width_read * value.abs()).then(|| reason(Level::Read, "interval_wide", because()))
    }
}

/// The coefficients of costs and noises that are fitted to trials.
fn costs_from_trials(result: &Value) -> Vec<Judged> {
    let converged = result.pointer("/convergence/converged").and_then(Value::as_bool).unwrap_or(true);
    let list = result.get("parameters").and_then(Value::as_array).into_iter().flatten();
    let one = |parameter: &Value| {
        let name = parameter.get("name")?.as_str()?;
        let value = parameter.get("value").and_then(Value::as_f64);
        let ends = parameter.get("interval").and_then(Value::as_array);
        let interval = ends.and_then(|ends| Some([ends.first()?.as_f64()?, ends.get(1)?.as_f64()?]));
        let Some(value) = value else {
            let why = parameter.get("refused").map_or_else(String::new, ToString::to_string);
            let because = format!("the records do not determine it {why}");
            let found = vec![reason(Level::DoNotUse, "parameter_not_determined", because.trim())];
            return Some((None, interval, worst_of(name, found, "ok")));
        };
        let mut found = Vec::new();
        match interval {
            None => found.push(reason(Level::DoNotUse, "interval_too_wide", "its interval is open")),
            Some(ends) => {
                let [low, high] = ends;
                // A coefficient is a ratio: its interval is one of its logarithm.
                if high > CONSTANTS.interval_ratio_do_not_use * CONSTANTS.interval_ratio_do_not_use * low {
                    let because = format!("its 95 % interval runs from {low:.3e} to {high:.3e}");
                    found.push(reason(Level::DoNotUse, "interval_too_wide", because));
                } else {
                    found.extend(width(value, ends).map(|own| Reason { level: Level::Read, ..own }));
                }
            }
        }
        if !converged {
            found.push(reason(Level::Read, "not_converged", "the fit did not arrive"));
        }
        Some((Some(value), interval, worst_of(name, found, "ok")))
    };
    list.filter_map(one).collect()
}

/// The matrices of an inverse problem.
fn costs(report: &Report) -> Vec<Judged> {
    let lqr = ["q", "r"].map(|name| (name, "/verdict"));
    let lqe = ["w", "v"].map(|name| (name, "/verdict"));
    let of = |name: &str| if ["q", "r"].contains(&name) { "/regulator/verdict" } else { "/filter/verdict" };
    let all: Vec<(&str, &str)> = if report.kind == inverse_lqr::Plan::KIND {
        lqr.to_vec()
    } else if report.kind == inverse_lqe::Plan::KIND {
        lqe.to_vec()
    } else if report.kind == inverse_lqg::Plan::KIND {
        ["q", "r", "w", "v"].map(|name| (name, of(name))).to_vec()
    } else {
        Vec::new()
    };
    let one = |(name, pointer): (&str, &str)| {
        let verdict = report.result.pointer(pointer)?.as_str()?;
        let found = match verdict {
            "infeasible" => vec![reason(Level::NotIdentified, "infeasible", "no cost makes the gain optimal")],
            "boundary" => {
                vec![reason(Level::Read, "boundary", "the gain lies at the boundary of those that are optimal")]
            }
            "feasible" => Vec::new(),
            other => return Some((None, None, not_identified(name, &format!("the verdict is {other}")))),
        };
        Some((None, None, worst_of(name, found, "ok")))
    };
    all.into_iter().filter_map(one).collect()
}

#[cfg(test)]
mod tests;
