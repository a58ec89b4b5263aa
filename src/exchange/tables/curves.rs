//! Learning curves as tables.

use super::{Record, Table, word};
use crate::learning::curves::Metric;
use crate::learning::{StudyLearningCurves, SubjectLearningCurve};

/// The columns of a subject's curve.
const OF_SUBJECT: &[&str] = &[
    "subject",
    "group",
    "plant",
    "session",
    "number",
    "position",
    "trial",
    "divergent",
    "metric",
    "value",
    "low",
    "high",
    "trust",
    "trust_code",
    "analysis",
    "missing",
];

/// The columns of a study's curves.
const OF_STUDY: &[&str] = &[
    "group",
    "plant",
    "session",
    "number",
    "metric",
    "n",
    "mean",
    "sd",
    "trimmed_n",
    "trimmed_mean",
    "trimmed_sd",
    "subjects",
    "left_out",
    "trust",
    "do_not_use",
];

/// A subject's learning curve: a row for each plant, trial and metric, with value, interval and trust.
#[must_use]
pub fn of_subject(curve: &SubjectLearningCurve) -> Table {
    let mut rows = Vec::new();
    for own in &curve.curves {
        for point in &own.points {
            for metric in Metric::ALL {
                let name = metric.name();
                let intervals = &point.intervals_95;
                let interval = match metric {
                    Metric::NormFeedback => intervals.norm_feedback,
                    Metric::NormFeedforwardMinusInverse => intervals.norm_feedforward_minus_inverse,
                    Metric::NormFeedforwardPlantMinusOne => intervals.norm_feedforward_plant_minus_one,
                    _ => None,
                };
                let trust = point.trust(metric);
                rows.push(
                    Record::default()
                        .with("subject", curve.code.as_str())
                        .with("group", curve.group.clone())
                        .with("plant", own.plant.name.as_str())
                        .with("session", point.session)
                        .with("number", point.number)
                        .with("position", point.position)
                        .with("trial", point.trial.as_str())
                        .with("divergent", point.divergent)
                        .with("metric", name)
                        .with("value", point.value(metric))
                        .with("low", interval.map(|ends| ends[0]))
                        .with("high", interval.map(|ends| ends[1]))
                        .with("trust", point.level(metric).name())
                        .with("trust_code", trust.map(|own| own.code.clone()))
                        .with("analysis", point.analysis.clone())
                        .with("missing", point.missing.clone()),
                );
            }
        }
    }
    rows.into_iter().collect::<Table>().beginning_with(OF_SUBJECT)
}

/// The learning curves of a study's groups: a row for each group, plant, trial number and metric, with mean and
/// standard deviation over subjects.
#[must_use]
pub fn of_study(curves: &StudyLearningCurves) -> Table {
    let mut rows = Vec::new();
    for group in &curves.groups {
        for point in &group.points {
            let all = [
                (Metric::MeanAbsError, &point.metrics.mean_abs_error),
                (Metric::RmsError, &point.metrics.rms_error),
                (Metric::NormFeedback, &point.metrics.norm_feedback),
                (Metric::NormFeedforwardMinusInverse, &point.metrics.norm_feedforward_minus_inverse),
                (Metric::NormFeedforwardPlantMinusOne, &point.metrics.norm_feedforward_plant_minus_one),
                (Metric::VarianceAccountedFor, &point.metrics.variance_accounted_for),
                (Metric::ControlLogDimensionlessJerk, &point.metrics.control_log_dimensionless_jerk),
            ];
            for (metric, statistics) in all {
                let trimmed = statistics.trimmed.as_ref();
                rows.push(
                    Record::default()
                        .with("group", group.group.clone())
                        .with("plant", group.plant.name.as_str())
                        .with("session", point.session)
                        .with("number", point.number)
                        .with("metric", metric.name())
                        .with("n", statistics.n)
                        .with("mean", statistics.mean)
                        .with("sd", statistics.sd)
                        .with("trimmed_n", trimmed.map(|own| own.n))
                        .with("trimmed_mean", trimmed.map(|own| own.mean))
                        .with("trimmed_sd", trimmed.and_then(|own| own.sd))
                        .with("subjects", point.subjects)
                        .with("left_out", point.left_out)
                        .with("trust", word(&statistics.trust.level))
                        .with("do_not_use", statistics.trust.do_not_use),
                );
            }
        }
    }
    rows.into_iter().collect::<Table>().beginning_with(OF_STUDY)
}
