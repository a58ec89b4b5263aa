//! The learning curve of one subject: its metrics over its trials, one curve for each plant.

use super::disagreement::estimators_disagree;
use super::inputs::{Estimator, NormIntervals, PlantName, Remark, SpecChoice, SubjectInput, TrialInput, choose_spec};
use super::trend::{Trend, trend};
use super::trusted::{trust_of_point, values_not_to_be_used};
use crate::trust::{Level, Trust};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How curves are made.
#[derive(Debug, Clone, PartialEq)]
pub struct CurveOptions {
    /// Whether divergent trials are part of the curve.
    pub include_divergent: bool,
    /// How the controllers shown were estimated.
    pub estimator: Estimator,
    /// Show identifications with this spec instead of the one that covers most trials.
    pub spec_sha256: Option<String>,
    /// How many values are dropped at each end in trimmed statistics (Zhang 2015, section 5.8: one).
    pub trim: usize,
    /// How many first and last trials are averaged in trends; fewer where the curve is shorter than twice that.
    pub trend_trials: usize,
}

impl Default for CurveOptions {
    fn default() -> Self {
        Self { include_divergent: false, estimator: Estimator::default(), spec_sha256: None, trim: 1, trend_trials: 5 }
    }
}

/// A quantity that a curve shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// ‖e‖.
    MeanAbsError,
    /// Root mean square of e.
    RmsError,
    /// ‖Gfb‖.
    NormFeedback,
    /// ‖Gff − G⁻¹‖.
    NormFeedforwardMinusInverse,
    /// ‖Gff G − 1‖.
    NormFeedforwardPlantMinusOne,
    /// Share of the variance of y that the identified controllers explain in simulation.
    VarianceAccountedFor,
    /// The log dimensionless jerk of u: greater is smoother, in trials of one command and length.
    ControlLogDimensionlessJerk,
}

/// One trial of a curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CurvePoint {
    /// The trial's id.
    pub trial: String,
    /// Its number.
    pub number: i64,
    /// Its session.
    pub session: Option<i64>,
    /// Its place among all of the subject's trials on this plant, from 1, counting those left out of the curve.
    pub position: usize,
    /// Whether |y| passed the display limit.
    pub divergent: bool,
    /// Why somebody excluded it; null where nobody did. Excluded trials are shown with `include_excluded` only.
    #[serde(default)]
    pub excluded: Option<String>,
    /// ‖e‖, the mean of |r − y|.
    pub mean_abs_error: f64,
    /// Root mean square of r − y.
    pub rms_error: f64,
    /// The largest |y|.
    pub max_abs_output: f64,
    /// The log dimensionless jerk of u, without unit: greater is smoother; null where there is none.
    #[serde(default)]
    pub control_log_dimensionless_jerk: Option<f64>,
    /// Whether the first deliberate control had the right direction; null where that cannot be said.
    pub right_control_at_start: Option<bool>,
    /// The identification that the following values come from; null where the trial has none with the chosen spec.
    pub analysis: Option<String>,
    /// ‖Gfb‖.
    pub norm_feedback: Option<f64>,
    /// ‖Gff − G⁻¹‖.
    pub norm_feedforward_minus_inverse: Option<f64>,
    /// ‖Gff G − 1‖.
    pub norm_feedforward_plant_minus_one: Option<f64>,
    /// Share of the variance of y that the identified controllers explain in simulation.
    pub variance_accounted_for: Option<f64>,
    /// The 95 % intervals of the norms, or why there is none.
    pub intervals_95: NormIntervals,
    /// The cost at the argmin.
    pub cost: Option<f64>,
    /// Why norms are null, where they are.
    pub missing: Option<String>,
    /// How far each of the quantities may be used, and why no further.
    #[serde(default)]
    pub trust: Vec<Trust>,
}

/// A trial, named.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TrialName {
    /// Its id.
    pub trial: String,
    /// Its number.
    pub number: i64,
    /// Its session.
    pub session: Option<i64>,
}

/// Trends of all quantities of a curve. Descriptions of what was measured, not tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Trends {
    /// Of ‖e‖.
    pub mean_abs_error: Trend,
    /// Of the root mean square error.
    pub rms_error: Trend,
    /// Of ‖Gfb‖.
    pub norm_feedback: Trend,
    /// Of ‖Gff − G⁻¹‖.
    pub norm_feedforward_minus_inverse: Trend,
    /// Of ‖Gff G − 1‖.
    pub norm_feedforward_plant_minus_one: Trend,
    /// Of the variance accounted for.
    pub variance_accounted_for: Trend,
    /// Of the log dimensionless jerk of u, of those trials that have one.
    pub control_log_dimensionless_jerk: Trend,
}

/// The curve of a subject on one plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlantCurve {
    /// The plant.
    pub plant: PlantName,
    /// The trials shown, by session and number.
    pub points: Vec<CurvePoint>,
    /// Divergent trials on this plant that are not shown.
    pub left_out: Vec<TrialName>,
    /// How many those are.
    pub left_out_count: usize,
    /// Trials shown without identification under the chosen spec.
    pub unidentified: Vec<TrialName>,
    /// How the controllers shown were estimated.
    pub estimator: Estimator,
    /// The spec whose identifications are shown; null where no trial is identified.
    pub spec: Option<SpecChoice>,
    /// First against last trials.
    pub trends: Trends,
}

/// The learning curves of a subject, one for each plant it worked with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SubjectLearningCurve {
    /// The subject's id.
    pub subject: String,
    /// Its pseudonym.
    pub code: String,
    /// Its group.
    pub group: Option<String>,
    /// Whether divergent trials are shown.
    pub include_divergent: bool,
    /// One curve for each plant, in the order in which the subject met them: trials on different plants never share a
    /// curve.
    pub curves: Vec<PlantCurve>,
    /// What must be read before using the numbers.
    pub remarks: Vec<Remark>,
}

/// The learning curves of a subject.
#[must_use]
pub fn subject_learning_curve(input: &SubjectInput, options: &CurveOptions) -> SubjectLearningCurve {
    let mut remarks = Vec::new();
    let mut curves = Vec::new();
    for (plant, trials) in trials_by_plant(input) {
        let spec = spec_of(trials.iter().copied(), options);
        let curve = plant_curve(plant, &trials, spec, options);
        remarks.extend(curve.remarks());
        remarks.extend(estimators_disagree(&curve, &trials));
        curves.push(curve);
    }
    if curves.len() > 1 {
        remarks.push(Remark::new(
            "several_plants",
            format!("the subject worked with {} plants; each has a curve of its own", curves.len()),
        ));
    }
    SubjectLearningCurve {
        subject: input.subject.clone(),
        code: input.code.clone(),
        group: input.group.clone(),
        include_divergent: options.include_divergent,
        curves,
        remarks,
    }
}

/// The spec asked for, or else the one that covers most of the trials.
pub(super) fn spec_of<'a>(
    trials: impl Iterator<Item = &'a TrialInput> + Clone,
    options: &CurveOptions,
) -> Option<SpecChoice> {
    match &options.spec_sha256 {
        Some(spec) => Some(SpecChoice::fixed(spec, trials)),
        None => choose_spec(trials),
    }
}

/// The subject's trials on each plant, ordered by session and number; plants in the order of their first trial.
pub(super) fn trials_by_plant(input: &SubjectInput) -> Vec<(&PlantName, Vec<&TrialInput>)> {
    let mut all: Vec<&TrialInput> = input.trials.iter().collect();
    all.sort_by(|a, b| (a.session, a.number, &a.trial).cmp(&(b.session, b.number, &b.trial)));
    let mut order: Vec<&PlantName> = Vec::new();
    let mut found: BTreeMap<&str, Vec<&TrialInput>> = BTreeMap::new();
    for trial in all {
        let of_plant = found.entry(&trial.plant.id).or_default();
        if of_plant.is_empty() {
            order.push(&trial.plant);
        }
        of_plant.push(trial);
    }
    order.into_iter().map(|plant| (plant, found.remove(plant.id.as_str()).unwrap_or_default())).collect()
}

pub(super) fn plant_curve(
    plant: &PlantName,
    trials: &[&TrialInput],
    spec: Option<SpecChoice>,
    options: &CurveOptions,
) -> PlantCurve {
    let mut points = Vec::new();
    let mut left_out = Vec::new();
    for (i, trial) in trials.iter().enumerate() {
        if trial.divergent && !options.include_divergent {
            left_out.push(TrialName { trial: trial.trial.clone(), number: trial.number, session: trial.session });
        } else {
            points.push(point(trial, i + 1, spec.as_ref(), options.estimator));
        }
    }
    let unidentified = points
        .iter()
        .filter(|p| p.analysis.is_none())
        .map(|p| TrialName { trial: p.trial.clone(), number: p.number, session: p.session })
        .collect();
    let of = |metric: Metric| {
        let series: Vec<(f64, f64)> =
            points.iter().filter_map(|p| Some((p.position as f64, p.value(metric)?))).collect();
        trend(&series, options.trend_trials)
    };
    let trends = Trends {
        mean_abs_error: of(Metric::MeanAbsError),
        rms_error: of(Metric::RmsError),
        norm_feedback: of(Metric::NormFeedback),
        norm_feedforward_minus_inverse: of(Metric::NormFeedforwardMinusInverse),
        norm_feedforward_plant_minus_one: of(Metric::NormFeedforwardPlantMinusOne),
        variance_accounted_for: of(Metric::VarianceAccountedFor),
        control_log_dimensionless_jerk: of(Metric::ControlLogDimensionlessJerk),
    };
    let left_out_count = left_out.len();
    let estimator = options.estimator;
    PlantCurve { plant: plant.clone(), points, left_out, left_out_count, unidentified, estimator, spec, trends }
}

pub(super) fn point(
    trial: &TrialInput,
    position: usize,
    spec: Option<&SpecChoice>,
    estimator: Estimator,
) -> CurvePoint {
    let found = spec.and_then(|spec| trial.identified_with(&spec.spec_sha256));
    let norms = found.and_then(|i| i.metrics.as_ref());
    let name = estimator.name();
    let missing = match (found, norms) {
        (None, _) => Some(format!("this trial has no succeeded {name} analysis with the chosen spec")),
        (Some(_), None) => Some(format!("the {name} report has no norms")),
        (Some(_), Some(norms)) if !norms.undefined.is_empty() => {
            let why: Vec<_> = norms.undefined.iter().map(|u| format!("{}: {}", u.field, u.reason)).collect();
            Some(why.join("; "))
        }
        _ => None,
    };
    let intervals_95 = found.map_or_else(
        || NormIntervals { reason: Some("the trial is not identified".to_owned()), ..NormIntervals::default() },
        |found| found.intervals.clone(),
    );
    let mut point = CurvePoint {
        trial: trial.trial.clone(),
        number: trial.number,
        session: trial.session,
        position,
        divergent: trial.divergent,
        excluded: trial.excluded.clone(),
        mean_abs_error: trial.metrics.mean_abs_error,
        rms_error: trial.metrics.rms_error,
        max_abs_output: trial.metrics.max_abs_output,
        control_log_dimensionless_jerk: trial.metrics.control_log_dimensionless_jerk,
        right_control_at_start: trial.metrics.right_control_at_start,
        analysis: found.map(|i| i.analysis.clone()),
        norm_feedback: norms.and_then(|n| n.norm_feedback),
        norm_feedforward_minus_inverse: norms.and_then(|n| n.norm_feedforward_minus_inverse),
        norm_feedforward_plant_minus_one: norms.and_then(|n| n.norm_feedforward_plant_minus_one),
        variance_accounted_for: found.and_then(|i| i.variance_accounted_for),
        intervals_95,
        cost: found.and_then(|i| i.cost),
        missing,
        trust: Vec::new(),
    };
    point.trust = trust_of_point(&point, found.map(|found| &found.evidence));
    point
}

impl Metric {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::MeanAbsError,
        Self::RmsError,
        Self::NormFeedforwardPlantMinusOne,
        Self::NormFeedforwardMinusInverse,
        Self::NormFeedback,
        Self::VarianceAccountedFor,
        Self::ControlLogDimensionlessJerk,
    ];

    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::MeanAbsError => "mean_abs_error",
            Self::RmsError => "rms_error",
            Self::NormFeedback => "norm_feedback",
            Self::NormFeedforwardMinusInverse => "norm_feedforward_minus_inverse",
            Self::NormFeedforwardPlantMinusOne => "norm_feedforward_plant_minus_one",
            Self::VarianceAccountedFor => "variance_accounted_for",
            Self::ControlLogDimensionlessJerk => "control_log_dimensionless_jerk",
        }
    }
}

impl CurvePoint {
    /// How far a quantity may be used.
    #[must_use]
    pub fn level(&self, metric: Metric) -> Level {
        self.trust(metric).map_or(Level::NotIdentified, |trust| trust.level)
    }

    /// How far a quantity may be used, and why no further.
    #[must_use]
    pub fn trust(&self, metric: Metric) -> Option<&Trust> {
        self.trust.iter().find(|trust| trust.quantity == metric.name())
    }

    /// The value of a quantity, where the trial has it.
    #[must_use]
    pub fn value(&self, metric: Metric) -> Option<f64> {
        match metric {
            Metric::MeanAbsError => Some(self.mean_abs_error),
            Metric::RmsError => Some(self.rms_error),
            Metric::NormFeedback => self.norm_feedback,
            Metric::NormFeedforwardMinusInverse => self.norm_feedforward_minus_inverse,
            Metric::NormFeedforwardPlantMinusOne => self.norm_feedforward_plant_minus_one,
            // A simulation that explains nothing has no share to average: how far below 0 it is says how fast it runs
            // away.
            Metric::VarianceAccountedFor => self.variance_accounted_for.filter(|share| *share >= 0.0),
            Metric::ControlLogDimensionlessJerk => self.control_log_dimensionless_jerk,
        }
    }
}

impl PlantCurve {
    pub(super) fn remarks(&self) -> Vec<Remark> {
        let mut remarks: Vec<Remark> = self.spec.iter().filter_map(SpecChoice::remark).collect();
        let name = &self.plant.name;
        if self.left_out_count > 0 {
            let count = self.left_out_count;
            remarks.push(Remark::new("divergent_left_out", format!("{count} divergent trials on {name} are left out")));
        }
        if !self.unidentified.is_empty() {
            let (missing, all) = (self.unidentified.len(), self.points.len());
            remarks.push(Remark::new(
                "unidentified_trials",
                format!(
                    "{missing} of {all} trials on {name} have no {} analysis with the chosen spec",
                    self.estimator.name()
                ),
            ));
        }
        remarks.extend(values_not_to_be_used(name, self.points.iter()));
        remarks
    }
}
