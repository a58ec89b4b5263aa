//! How far the quantities of a trial may be used, and what is said of means that take in what may not.

use super::curves::{CurvePoint, Metric};
use super::inputs::{Identification, NormIntervals, Remark};
use crate::trust::{
    Estimate, Evidence, LeftOut, Level, MeanTrust, Sort, Trust, judge, measured, not_identified, of_mean,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Every quantity of a trial; `evidence` is that of the analysis shown, `None` where the trial has none.
pub(super) fn trust_of_point(point: &CurvePoint, evidence: Option<&Evidence>) -> Vec<Trust> {
    Metric::ALL.into_iter().map(|metric| trust(metric, point, evidence)).collect()
}

/// An identified quantity: everything that the rule needs to know of it.
struct Identified<'a> {
    metric: Metric,
    value: Option<f64>,
    intervals: &'a NormIntervals,
    /// Why there is no value.
    missing: Option<&'a str>,
}

impl Identified<'_> {
    fn interval(&self) -> Option<[f64; 2]> {
        match self.metric {
            Metric::NormFeedback => self.intervals.norm_feedback,
            Metric::NormFeedforwardMinusInverse => self.intervals.norm_feedforward_minus_inverse,
            Metric::NormFeedforwardPlantMinusOne => self.intervals.norm_feedforward_plant_minus_one,
            _ => None,
        }
    }

    fn judge(&self, evidence: &Evidence, trial: LeftOut<'_>) -> Trust {
        let (sort, spread) = match self.metric {
            Metric::NormFeedback => (Sort::Feedback, evidence.spread_feedback),
            Metric::NormFeedforwardPlantMinusOne => (Sort::Feedforward, evidence.spread_distance),
            Metric::VarianceAccountedFor => (Sort::Share, None),
            _ => (Sort::Feedforward, None),
        };
        let reason = if self.value.is_some() { self.intervals.reason.as_deref() } else { self.missing };
        let (quantity, value, interval) = (self.metric.name(), self.value, self.interval());
        judge(&Estimate { quantity, sort, value, interval, reason, spread }, evidence, trial)
    }
}

fn left_out(point: &CurvePoint) -> LeftOut<'_> {
    LeftOut::of(point.divergent, point.excluded.as_deref())
}

fn trust(metric: Metric, point: &CurvePoint, evidence: Option<&Evidence>) -> Trust {
    let quantity = metric.name();
    if matches!(metric, Metric::MeanAbsError | Metric::RmsError | Metric::ControlLogDimensionlessJerk) {
        return if point.value(metric).is_some() {
            measured(quantity, left_out(point))
        } else {
            not_identified(quantity, "the trial has no such measure")
        };
    }
    let missing = point.missing.as_deref();
    let Some(evidence) = evidence else { return not_identified(quantity, missing.unwrap_or("it is not identified")) };
    let value = match metric {
        // What explains less than nothing has a share too: it says that the simulation fails.
        Metric::VarianceAccountedFor => point.variance_accounted_for,
        _ => point.value(metric),
    };
    Identified { metric, value, intervals: &point.intervals_95, missing }.judge(evidence, left_out(point))
}

/// A quantity of an identification, with how far it may be used.
#[derive(Debug, Clone, PartialEq)]
pub struct TrustedQuantity {
    /// Its value in its own unit.
    pub value: Option<f64>,
    /// Its 95 % interval in the same unit.
    pub interval_95: Option<[f64; 2]>,
    /// How far it may be used.
    pub trust: Trust,
}

/// Every quantity of an identification, whatever became of the trial: divergence is judged where the limit is known.
#[must_use]
pub fn trust_of_identification(found: &Identification) -> Vec<TrustedQuantity> {
    let norms = found.metrics.as_ref();
    let undefined = |field: &str| {
        let own = norms?.undefined.iter().find(|own| own.field == field)?;
        Some(own.reason.clone())
    };
    let values = [
        (Metric::NormFeedforwardPlantMinusOne, norms.and_then(|n| n.norm_feedforward_plant_minus_one)),
        (Metric::NormFeedforwardMinusInverse, norms.and_then(|n| n.norm_feedforward_minus_inverse)),
        (Metric::NormFeedback, norms.and_then(|n| n.norm_feedback)),
        (Metric::VarianceAccountedFor, found.variance_accounted_for),
    ];
    let one = |(metric, value): (Metric, Option<f64>)| {
        let missing = undefined(metric.name());
        let own = Identified { metric, value, intervals: &found.intervals, missing: missing.as_deref() };
        let (interval_95, trust) = (own.interval(), own.judge(&found.evidence, LeftOut::default()));
        TrustedQuantity { value, interval_95, trust }
    };
    values.into_iter().map(one).collect()
}

/// A remark where means and trends take in values that are not to be used: nothing is averaged in silence.
pub(super) fn values_not_to_be_used<'a>(
    who: &str,
    points: impl Iterator<Item = &'a CurvePoint> + Clone,
) -> Option<Remark> {
    let count = |metric: Metric| {
        let with = points.clone().filter(move |point| point.value(metric).is_some());
        let bad = with.clone().filter(move |point| point.level(metric) == Level::DoNotUse).count();
        (bad > 0).then(|| format!("{bad} of {} of {}", with.count(), metric.name()))
    };
    let found: Vec<String> = Metric::ALL.into_iter().filter_map(count).collect();
    (!found.is_empty()).then(|| {
        let found = found.join(", ");
        Remark::new(
            "values_not_to_be_used",
            format!("{who}: some values are not to be used ({found}); means, trends and correlations take them in"),
        )
    })
}

/// How far a statement about a group's values of a metric may go.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub struct StatementTrust {
    /// How far the values that it is made of may be used, taken together.
    #[serde(flatten)]
    pub mean: MeanTrust,
    /// The code that most of the values that are not to be used have; null where there are none.
    pub code: Option<String>,
    /// What to do about those, in one sentence; empty where there are none.
    #[serde(rename = "do")]
    pub advice: String,
}

impl StatementTrust {
    /// Of several values.
    #[must_use]
    pub fn of<'a>(values: impl IntoIterator<Item = &'a Trust>) -> Self {
        let values: Vec<&Trust> = values.into_iter().collect();
        let levels: Vec<Level> = values.iter().map(|trust| trust.level).collect();
        let mut codes: BTreeMap<&str, (usize, &str)> = BTreeMap::new();
        for trust in values.iter().filter(|trust| trust.level == Level::DoNotUse) {
            codes.entry(&trust.code).or_insert((0, &trust.advice)).0 += 1;
        }
        let most = codes.into_iter().max_by_key(|(code, (count, _))| (*count, std::cmp::Reverse(*code)));
        let (code, advice) =
            most.map_or((None, String::new()), |(code, (_, advice))| (Some(code.to_owned()), advice.to_owned()));
        Self { mean: of_mean(&levels), code, advice }
    }

    /// The worse of two, for a statement about both.
    #[must_use]
    pub fn worse<'a>(&'a self, other: &'a Self) -> &'a Self {
        if other.mean.level > self.mean.level { other } else { self }
    }

    /// Why no statement may be made, with the way on; `None` where one may.
    #[must_use]
    pub fn refusal(&self) -> Option<String> {
        let MeanTrust { level, do_not_use, of } = self.mean;
        (level == Level::DoNotUse)
            .then(|| format!("{do_not_use} of the {of} values are not to be used. {}", self.advice).trim().to_owned())
    }

    /// What a statement that may be made says beside it: how many of its values are not to be used; else empty.
    #[must_use]
    pub fn reservation(&self) -> String {
        match self.mean {
            MeanTrust { do_not_use: 0, .. } => String::new(),
            MeanTrust { do_not_use, of, .. } => format!("; {do_not_use} of its {of} values are not to be used"),
        }
    }
}
