//! How far a value may be used.
//!
//! Trust belongs to a quantity of a trial, not to the trial: a recording may tell the feedforward and not the feedback.
//! The level is the worst of the rows that apply, of those that a learning curve can know; constants stand here alone.

use crate::analysis::Report;
use crate::learning::curves::{CurvePoint, Metric};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Of less than none of the variation explained, a simulation fails; of less than this it is to be looked at.
const EXPLAINED: f64 = 0.5;

/// Half-widths of intervals over their values, and ratios of their ends, from which a value is to be read with care or
/// not to be used.
const WIDE: f64 = 0.25;
const TOO_WIDE: f64 = 1.0;
const RATIO_TOO_WIDE: f64 = 3.0;

/// Ratios of the largest to the smallest value among candidates that fit nearly as well.
const SPREAD: f64 = 1.25;
const SPREAD_TOO_WIDE: f64 = 3.0;

/// How far a value may be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigureTrust")]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// It was never identified.
    NotIdentified,
    /// Nothing speaks against it.
    Ok,
    /// Warnings are to be read first.
    Read,
    /// Not to be used.
    DoNotUse,
}

impl Level {
    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NotIdentified => "not_identified",
            Self::Ok => "ok",
            Self::Read => "read",
            Self::DoNotUse => "do_not_use",
        }
    }

    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::NotIdentified => "not identified",
            Self::Ok => "ok",
            Self::Read => "read the warnings",
            Self::DoNotUse => "do not use",
        }
    }
}

/// What a report says about the trust in its norms, beside their intervals.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evidence {
    /// The command alone does not tell the feedback from the feedforward.
    pub feedback_poorly_determined: bool,
    /// The smallest and the largest ‖Gfb‖ among candidates that fit nearly as well.
    pub spread_feedback: Option<[f64; 2]>,
    /// The same of ‖Gff G − 1‖.
    pub spread_distance: Option<[f64; 2]>,
}

impl Evidence {
    /// Of a report of any kind.
    #[must_use]
    pub fn of(report: &Report) -> Self {
        let spread = |norm: &str| {
            let ends = report.result.get("near_optimal")?.get("spread")?.get(norm)?.as_array()?;
            match ends[..] {
                [ref low, ref high] => Some([low.as_f64()?, high.as_f64()?]),
                _ => None,
            }
        };
        Self {
            feedback_poorly_determined: report.warnings.iter().any(|w| w.code == "feedback_poorly_determined"),
            spread_feedback: spread("norm_feedback"),
            spread_distance: spread("norm_feedforward_plant_minus_one"),
        }
    }
}

/// A level with the reasons for it, the gravest first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trust {
    /// The level.
    pub level: Level,
    /// Why it is no better; empty where nothing speaks against the value.
    pub because: Vec<String>,
}

/// The trust in a quantity of a trial, given what its report says.
#[must_use]
pub fn trust(metric: Metric, point: &CurvePoint, evidence: Option<&Evidence>) -> Trust {
    let mut found: Vec<(Level, String)> = Vec::new();
    if point.divergent {
        found.push((Level::DoNotUse, "the output passed the display limit".to_owned()));
    }
    let is_measured = matches!(metric, Metric::MeanAbsError | Metric::RmsError | Metric::ControlLogDimensionlessJerk);
    if !is_measured && point.value(metric).is_none() {
        let why = point.missing.clone().unwrap_or_else(|| "it has no value".to_owned());
        return Trust { level: Level::NotIdentified, because: vec![why] };
    }
    if let Some(value) = point.value(metric).filter(|_| !is_measured) {
        identified(metric, value, point, evidence, &mut found);
    }
    found.sort_by_key(|(level, _)| std::cmp::Reverse(*level));
    let level = found.first().map_or(Level::Ok, |(level, _)| *level);
    Trust { level, because: found.into_iter().map(|(_, why)| why).collect() }
}

/// What speaks against a quantity that was identified.
fn identified(
    metric: Metric,
    value: f64,
    point: &CurvePoint,
    evidence: Option<&Evidence>,
    found: &mut Vec<(Level, String)>,
) {
    match point.variance_accounted_for {
        Some(share) if share <= 0.0 => {
            found.push((Level::DoNotUse, "simulated, the controllers explain none of the output".to_owned()));
        }
        Some(share) if share < EXPLAINED => {
            found.push((Level::Read, "simulated, the controllers explain less than half of the output".to_owned()));
        }
        _ => {}
    }
    let intervals = &point.intervals_95;
    let interval = match metric {
        Metric::NormFeedback => intervals.norm_feedback,
        Metric::NormFeedforwardMinusInverse => intervals.norm_feedforward_minus_inverse,
        Metric::NormFeedforwardPlantMinusOne => intervals.norm_feedforward_plant_minus_one,
        // The share of a simulation is what it is.
        _ => return,
    };
    match interval {
        None => {
            let why = intervals.reason.as_deref().unwrap_or("nobody knows why");
            found.push((Level::Read, format!("no interval: {why}")));
        }
        Some([low, high]) => {
            let half = 0.5 * (high - low);
            if half > TOO_WIDE * value || high > RATIO_TOO_WIDE * low {
                found.push((Level::DoNotUse, "its interval is wider than itself".to_owned()));
            } else if half > WIDE * value {
                found.push((Level::Read, "its interval is wide".to_owned()));
            }
        }
    }
    let Some(evidence) = evidence else { return };
    let spread = match metric {
        Metric::NormFeedback => evidence.spread_feedback,
        Metric::NormFeedforwardPlantMinusOne => evidence.spread_distance,
        _ => None,
    };
    if let Some([low, high]) = spread {
        let words = || format!("candidates that fit nearly as well have {low:.3} to {high:.3}");
        if high > SPREAD_TOO_WIDE * low {
            found.push((Level::DoNotUse, words()));
        } else if high > SPREAD * low {
            found.push((Level::Read, words()));
        }
    }
    if evidence.feedback_poorly_determined {
        let level = if metric == Metric::NormFeedback { Level::DoNotUse } else { Level::Read };
        found.push((level, "the command alone hardly tells feedback from feedforward".to_owned()));
    }
}

/// The level of a mean over several: their worst where more than a third are that bad, else no better than to be read
/// where any of them is worse.
#[must_use]
pub fn of_mean(levels: &[Level]) -> Level {
    let worst = levels.iter().copied().max().unwrap_or(Level::NotIdentified);
    if worst <= Level::Read {
        return worst;
    }
    let count = levels.iter().filter(|level| **level == worst).count();
    if 3 * count > levels.len() { worst } else { Level::Read }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn point(changes: &Value) -> CurvePoint {
        let mut all = json!({
            "trial": "t", "number": 5, "session": null, "position": 1, "divergent": false, "mean_abs_error": 0.3,
            "rms_error": 0.4, "max_abs_output": 2.0, "right_control_at_start": null, "analysis": "a",
            "norm_feedback": 1.0, "norm_feedforward_minus_inverse": 1.0, "norm_feedforward_plant_minus_one": 0.4,
            "variance_accounted_for": 0.9, "cost": 0.1, "missing": null,
            "intervals_95": {"norm_feedback": [0.9, 1.1], "norm_feedforward_minus_inverse": null,
                "norm_feedforward_plant_minus_one": [0.1, 0.7], "reason": "none"}
        });
        for (key, value) in changes.as_object().unwrap() {
            all[key] = value.clone();
        }
        serde_json::from_value(all).unwrap()
    }

    const DISTANCE: Metric = Metric::NormFeedforwardPlantMinusOne;

    #[test]
    fn each_row_of_the_rule_has_its_level() {
        let alone = Evidence { feedback_poorly_determined: true, ..Evidence::default() };
        let spread = |ends| Evidence { spread_distance: Some(ends), ..Evidence::default() };
        let narrow = json!({"intervals_95": {"norm_feedback": null, "norm_feedforward_minus_inverse": null,
            "norm_feedforward_plant_minus_one": [0.36, 0.44], "reason": null}});
        let cases = [
            (Metric::MeanAbsError, json!({}), None, Level::Ok),
            (Metric::MeanAbsError, json!({"variance_accounted_for": -1.0}), Some(&alone), Level::Ok),
            (Metric::MeanAbsError, json!({"divergent": true}), None, Level::DoNotUse),
            (Metric::NormFeedback, json!({}), None, Level::Ok),
            (Metric::NormFeedback, json!({}), Some(&alone), Level::DoNotUse),
            (Metric::NormFeedback, json!({"variance_accounted_for": 0.0}), None, Level::DoNotUse),
            (Metric::NormFeedback, json!({"variance_accounted_for": 0.4}), None, Level::Read),
            (Metric::NormFeedback, json!({"norm_feedback": null}), None, Level::NotIdentified),
            (Metric::NormFeedforwardMinusInverse, json!({}), None, Level::Read),
            // An interval from 0.1 to 0.7 around 0.4.
            (DISTANCE, json!({}), None, Level::DoNotUse),
            (DISTANCE, narrow.clone(), None, Level::Ok),
            (DISTANCE, narrow.clone(), Some(&alone), Level::Read),
            (DISTANCE, narrow.clone(), Some(&spread([0.3, 0.37])), Level::Ok),
            (DISTANCE, narrow.clone(), Some(&spread([0.3, 0.6])), Level::Read),
            (DISTANCE, narrow, Some(&spread([0.3, 1.0])), Level::DoNotUse),
            (Metric::VarianceAccountedFor, json!({}), Some(&alone), Level::Ok),
        ];
        for (metric, changes, evidence, level) in cases {
            let found = trust(metric, &point(&changes), evidence);
            assert_eq!(found.level, level, "{metric:?} {changes} {evidence:?}: {found:?}");
            assert_eq!(found.because.is_empty(), level == Level::Ok, "{found:?}");
        }
    }

    #[test]
    fn a_mean_is_as_bad_as_more_than_a_third_of_it() {
        use Level::{DoNotUse, NotIdentified, Ok, Read};
        assert_eq!(of_mean(&[Ok, DoNotUse, Ok]), Read);
        assert_eq!(of_mean(&[Ok, DoNotUse, DoNotUse]), DoNotUse);
        assert_eq!(of_mean(&[Ok, Read, Ok]), Read);
        assert_eq!(of_mean(&[Ok, Ok]), Ok);
        assert_eq!(of_mean(&[]), NotIdentified);
    }

    #[test]
    fn evidence_comes_from_the_report() {
        let report: Report = serde_json::from_value(json!({
            "kind": "ssid", "schema": "volition.ssid/6",
            "result": {"near_optimal": {"spread": {"norm_feedback": [1.0, 2.5],
                "norm_feedforward_plant_minus_one": null}}},
            "warnings": [{"code": "feedback_poorly_determined", "message": "one response"}],
            "provenance": {"product_version": "0", "spec": {}, "spec_sha256": "", "inputs_sha256": {}, "seed": null,
                "result_sha256": "", "wall_time_s": null, "cpu_time_s": null, "effort": null}
        }))
        .unwrap();
        let expected =
            Evidence { feedback_poorly_determined: true, spread_feedback: Some([1.0, 2.5]), spread_distance: None };
        assert_eq!(Evidence::of(&report), expected);
    }
}
