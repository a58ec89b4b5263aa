//! Learning curves of a study: mean and standard deviation over the subjects of each group, trial by trial.

use super::correlation::{Correlation, correlation};
use super::curves::{CurveOptions, CurvePoint, Metric, PlantCurve, plant_curve, spec_of, trials_by_plant};
use super::inputs::{PlantName, Remark, SpecChoice, SubjectInput, TrialInput};
use super::trusted::values_not_to_be_used;
use crate::num::stats::{mean, standard_deviation};
use crate::trust::{Level, MeanTrust, of_mean};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Mean and spread of a sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Statistics {
    /// Values.
    pub n: usize,
    /// Arithmetic mean; null of no value.
    pub mean: Option<f64>,
    /// Sample standard deviation (`n − 1` in the denominator); null of fewer than two values.
    pub sd: Option<f64>,
    /// The same without the largest and smallest values; null where no value would remain or nothing is dropped.
    pub trimmed: Option<TrimmedStatistics>,
    /// How far the mean may be used, and how many of its values are not to be used.
    #[serde(default)]
    pub trust: MeanTrust,
}

/// Mean and spread without the extremes (Zhang 2015, section 5.8).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrimmedStatistics {
    /// Values dropped at each end.
    pub dropped_each_end: usize,
    /// Values left.
    pub n: usize,
    /// Their mean.
    pub mean: f64,
    /// Their sample standard deviation; null of fewer than two.
    pub sd: Option<f64>,
}

/// Statistics of every quantity over the same trials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricStatistics {
    /// Of ‖e‖.
    pub mean_abs_error: Statistics,
    /// Of the root mean square error.
    pub rms_error: Statistics,
    /// Of ‖Gfb‖.
    pub norm_feedback: Statistics,
    /// Of ‖Gff − G⁻¹‖.
    pub norm_feedforward_minus_inverse: Statistics,
    /// Of ‖Gff G − 1‖.
    pub norm_feedforward_plant_minus_one: Statistics,
    /// Of the variance accounted for, of those trials whose simulation explains any of it; the others are counted in
    /// `variance_not_explained`.
    pub variance_accounted_for: Statistics,
    /// Of the log dimensionless jerk of u, of those trials that have one.
    pub control_log_dimensionless_jerk: Statistics,
    /// How many simulations are worse than the mean of the signal (a negative share, which has no lower end), and of
    /// how many that can be said.
    #[serde(default)]
    pub variance_not_explained: Count,
}

/// A group at one trial number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupPoint {
    /// The session.
    pub session: Option<i64>,
    /// The trial number.
    pub number: i64,
    /// Subjects whose trial is shown.
    pub subjects: usize,
    /// Subjects whose trial is divergent and left out.
    pub left_out: usize,
    /// Mean and standard deviation of each quantity, each with its own n: not every trial is identified.
    pub metrics: MetricStatistics,
    /// How many of the shown trials began with the right control, and of how many that can be said.
    pub right_control_at_start: Count,
}

/// So many out of so many.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub struct Count {
    /// Those that are.
    pub count: usize,
    /// Those of which it can be said.
    pub of: usize,
}

/// One trial of each subject side by side.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupTable {
    /// One row for each subject that has a shown trial.
    pub rows: Vec<TableRow>,
    /// Statistics over the rows.
    pub metrics: MetricStatistics,
}

/// A subject's row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TableRow {
    /// The subject's id.
    pub subject: String,
    /// Its pseudonym.
    pub code: String,
    /// The trial.
    pub point: CurvePoint,
}

/// Error against distance from the inverse dynamics, one dot for each identified trial (Zhang 2015, figures 3.6b,
/// 5.15).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scatter {
    /// The dots.
    pub points: Vec<ScatterPoint>,
    /// ‖e‖ against ‖Gff − G⁻¹‖.
    pub error_against_minus_inverse: Correlation,
    /// ‖e‖ against ‖Gff G − 1‖.
    pub error_against_plant_minus_one: Correlation,
}

/// A dot of the scatter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScatterPoint {
    /// The subject's pseudonym.
    pub code: String,
    /// The trial's session.
    pub session: Option<i64>,
    /// The trial's number.
    pub number: i64,
    /// ‖e‖.
    pub mean_abs_error: f64,
    /// ‖Gff − G⁻¹‖.
    pub norm_feedforward_minus_inverse: Option<f64>,
    /// ‖Gff G − 1‖.
    pub norm_feedforward_plant_minus_one: Option<f64>,
    /// How far ‖Gff G − 1‖ may be used.
    #[serde(default = "not_identified")]
    pub trust: Level,
}

fn not_identified() -> Level {
    Level::NotIdentified
}

/// A subject of a group with its curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupSubject {
    /// The subject's id.
    pub subject: String,
    /// Its pseudonym.
    pub code: String,
    /// Its curve on the group's plant.
    pub curve: PlantCurve,
}

/// A group on one plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupCurve {
    /// The group; null for subjects without one.
    pub group: Option<String>,
    /// The plant.
    pub plant: PlantName,
    /// The spec whose identifications are shown.
    pub spec: Option<SpecChoice>,
    /// Its subjects, by pseudonym.
    pub subjects: Vec<GroupSubject>,
    /// Mean and standard deviation per trial number.
    pub points: Vec<GroupPoint>,
    /// The first shown trial of each subject.
    pub first_trials: GroupTable,
    /// The last shown trial of each subject.
    pub last_trials: GroupTable,
    /// Error against distance from the inverse dynamics.
    pub scatter: Scatter,
}

/// The learning curves of a study.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StudyLearningCurves {
    /// Whether divergent trials are shown.
    pub include_divergent: bool,
    /// Values dropped at each end in trimmed statistics.
    pub trim: usize,
    /// Every group on every plant it worked with, by group name; subjects without a group come first.
    pub groups: Vec<GroupCurve>,
    /// What must be read before using the numbers.
    pub remarks: Vec<Remark>,
}

/// Session and number.
type TrialKey = (Option<i64>, i64);

/// A group's subjects with their trials on one plant, and the spec to show.
pub(super) struct Cell<'a> {
    pub group: Option<String>,
    pub plant: &'a PlantName,
    pub spec: Option<SpecChoice>,
    pub subjects: Vec<(&'a SubjectInput, Vec<&'a TrialInput>)>,
}

/// The learning curves of a study's subjects.
#[must_use]
pub fn study_learning_curves(subjects: &[SubjectInput], options: &CurveOptions) -> StudyLearningCurves {
    let (cells, mut remarks) = cells(subjects, options);
    let groups: Vec<GroupCurve> = cells.into_iter().map(|cell| group_curve(cell, options)).collect();
    for group in &groups {
        remarks.extend(group.remarks());
    }
    StudyLearningCurves { include_divergent: options.include_divergent, trim: options.trim, groups, remarks }
}

/// Groups split by plant, with one spec for the whole study where it covers something of every group.
pub(super) fn cells<'a>(subjects: &'a [SubjectInput], options: &CurveOptions) -> (Vec<Cell<'a>>, Vec<Remark>) {
    let mut found: BTreeMap<(Option<String>, &PlantName), Vec<_>> = BTreeMap::new();
    for subject in subjects {
        for (plant, trials) in trials_by_plant(subject) {
            found.entry((subject.group.clone(), plant)).or_default().push((subject, trials));
        }
    }
    let common = spec_of(subjects.iter().flat_map(|s| &s.trials), options);
    let mut cells = Vec::new();
    for ((group, plant), mut subjects) in found {
        subjects.sort_by(|a, b| (&a.0.code, &a.0.subject).cmp(&(&b.0.code, &b.0.subject)));
        let trials = || subjects.iter().flat_map(|s| s.1.iter().copied());
        let spec = common.as_ref().map(|c| SpecChoice::fixed(&c.spec_sha256, trials())).filter(|c| c.trials > 0);
        let spec = spec.or_else(|| spec_of(trials(), options));
        cells.push(Cell { group, plant, spec, subjects });
    }
    let remarks = study_remarks(&cells);
    (cells, remarks)
}

fn study_remarks(cells: &[Cell]) -> Vec<Remark> {
    let mut remarks = Vec::new();
    let mut plants: BTreeMap<&Option<String>, Vec<&str>> = BTreeMap::new();
    for cell in cells {
        plants.entry(&cell.group).or_default().push(&cell.plant.name);
    }
    for (group, names) in &plants {
        if names.len() > 1 {
            remarks.push(Remark::new(
                "several_plants_in_group",
                format!("{} worked with several plants ({}), shown apart", named(group), names.join(", ")),
            ));
        }
    }
    let distinct: BTreeSet<&str> = cells.iter().map(|c| c.plant.id.as_str()).collect();
    if plants.len() > 1 && distinct.len() > 1 {
        remarks.push(Remark::new(
            "groups_differ_in_plant",
            "not all trials were recorded on the same plant: ‖Gff − G⁻¹‖ and ‖Gfb‖ have the units of each plant's \
             inverse, so between plants compare ‖Gff G − 1‖"
                .to_owned(),
        ));
    }
    let specs: BTreeSet<&str> = cells.iter().filter_map(|c| c.spec.as_ref()).map(|s| s.spec_sha256.as_str()).collect();
    if specs.len() > 1 {
        remarks.push(Remark::new(
            "specs_differ_between_groups",
            "no spec covers every group, so groups are shown with different ones: differences between them may come \
             from the method"
                .to_owned(),
        ));
    }
    remarks
}

fn named(group: &Option<String>) -> String {
    group.as_ref().map_or_else(|| "subjects without a group".to_owned(), |g| format!("group {g}"))
}

fn group_curve(cell: Cell, options: &CurveOptions) -> GroupCurve {
    let Cell { group, plant, spec, subjects } = cell;
    let subjects: Vec<GroupSubject> = subjects
        .into_iter()
        .map(|(subject, trials)| GroupSubject {
            subject: subject.subject.clone(),
            code: subject.code.clone(),
            curve: plant_curve(plant, &trials, spec.clone(), options),
        })
        .collect();
    let mut numbers: BTreeMap<TrialKey, (Vec<&CurvePoint>, usize)> = BTreeMap::new();
    for subject in &subjects {
        for point in &subject.curve.points {
            numbers.entry((point.session, point.number)).or_default().0.push(point);
        }
        for trial in &subject.curve.left_out {
            numbers.entry((trial.session, trial.number)).or_default().1 += 1;
        }
    }
    let points = numbers
        .into_iter()
        .map(|((session, number), (points, left_out))| GroupPoint {
            session,
            number,
            subjects: points.len(),
            left_out,
            metrics: metric_statistics(&points, options.trim),
            right_control_at_start: right_control(&points),
        })
        .collect();
    let table = |pick: fn(&[CurvePoint]) -> Option<&CurvePoint>| {
        let rows: Vec<TableRow> = subjects
            .iter()
            .filter_map(|s| {
                let point = pick(&s.curve.points)?.clone();
                Some(TableRow { subject: s.subject.clone(), code: s.code.clone(), point })
            })
            .collect();
        let metrics = metric_statistics(&rows.iter().map(|r| &r.point).collect::<Vec<_>>(), options.trim);
        GroupTable { rows, metrics }
    };
    let (first_trials, last_trials) = (table(|p| p.first()), table(|p| p.last()));
    let scatter = scatter(&subjects);
    GroupCurve { group, plant: plant.clone(), spec, subjects, points, first_trials, last_trials, scatter }
}

fn right_control(points: &[&CurvePoint]) -> Count {
    let known = points.iter().filter_map(|p| p.right_control_at_start);
    known.fold(Count::default(), |c, right| Count { count: c.count + usize::from(right), of: c.of + 1 })
}

fn metric_statistics(points: &[&CurvePoint], trim: usize) -> MetricStatistics {
    let of = |metric: Metric| {
        let values: Vec<f64> = points.iter().filter_map(|p| p.value(metric)).collect();
        let levels: Vec<_> = points.iter().filter(|p| p.value(metric).is_some()).map(|p| p.level(metric)).collect();
        Statistics { trust: of_mean(&levels), ..statistics(&values, trim) }
    };
    MetricStatistics {
        mean_abs_error: of(Metric::MeanAbsError),
        rms_error: of(Metric::RmsError),
        norm_feedback: of(Metric::NormFeedback),
        norm_feedforward_minus_inverse: of(Metric::NormFeedforwardMinusInverse),
        norm_feedforward_plant_minus_one: of(Metric::NormFeedforwardPlantMinusOne),
        variance_accounted_for: of(Metric::VarianceAccountedFor),
        control_log_dimensionless_jerk: of(Metric::ControlLogDimensionlessJerk),
        variance_not_explained: points
            .iter()
            .filter_map(|p| p.variance_accounted_for)
            .fold(Count::default(), |c, share| Count { count: c.count + usize::from(share < 0.0), of: c.of + 1 }),
    }
}

/// Mean and standard deviation, whole and without the `trim` largest and `trim` smallest values; nothing is known here
/// of how far the values may be used.
#[must_use]
pub fn statistics(values: &[f64], trim: usize) -> Statistics {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let kept = (trim > 0).then(|| sorted.get(trim..sorted.len().saturating_sub(trim))).flatten();
    let trimmed = kept.and_then(|kept| {
        Some(TrimmedStatistics {
            dropped_each_end: trim,
            n: kept.len(),
            mean: mean(kept)?,
            sd: standard_deviation(kept),
        })
    });
    let trust = MeanTrust::default();
    Statistics { n: values.len(), mean: mean(values), sd: standard_deviation(values), trimmed, trust }
}

fn scatter(subjects: &[GroupSubject]) -> Scatter {
    let points: Vec<ScatterPoint> = subjects
        .iter()
        .flat_map(|s| s.curve.points.iter().map(move |p| (s, p)))
        .filter(|(_, p)| p.norm_feedforward_minus_inverse.is_some() || p.norm_feedforward_plant_minus_one.is_some())
        .map(|(s, p)| ScatterPoint {
            code: s.code.clone(),
            session: p.session,
            number: p.number,
            mean_abs_error: p.mean_abs_error,
            norm_feedforward_minus_inverse: p.norm_feedforward_minus_inverse,
            norm_feedforward_plant_minus_one: p.norm_feedforward_plant_minus_one,
            trust: p.level(Metric::NormFeedforwardPlantMinusOne),
        })
        .collect();
    let against = |distance: fn(&ScatterPoint) -> Option<f64>| {
        correlation(&points.iter().filter_map(|p| Some((distance(p)?, p.mean_abs_error))).collect::<Vec<_>>())
    };
    let error_against_minus_inverse = against(|p| p.norm_feedforward_minus_inverse);
    let error_against_plant_minus_one = against(|p| p.norm_feedforward_plant_minus_one);
    Scatter { points, error_against_minus_inverse, error_against_plant_minus_one }
}

impl GroupCurve {
    fn remarks(&self) -> Vec<Remark> {
        let who = format!("{} on {}", named(&self.group), self.plant.name);
        let mut remarks: Vec<Remark> = self
            .spec
            .iter()
            .filter_map(SpecChoice::remark)
            .map(|r| Remark { message: format!("{who}: {}", r.message), ..r })
            .collect();
        let left_out: usize = self.subjects.iter().map(|s| s.curve.left_out_count).sum();
        if left_out > 0 {
            remarks.push(Remark::new("divergent_left_out", format!("{who}: {left_out} divergent trials are left out")));
        }
        let all: usize = self.subjects.iter().map(|s| s.curve.points.len()).sum();
        let missing: usize = self.subjects.iter().map(|s| s.curve.unidentified.len()).sum();
        if missing > 0 {
            remarks.push(Remark::new(
                "unidentified_trials",
                format!("{who}: {missing} of {all} trials have no ssid analysis with the chosen spec"),
            ));
        }
        let last: BTreeSet<_> = self.last_trials.rows.iter().map(|r| (r.point.session, r.point.number)).collect();
        if last.len() > 1 {
            remarks.push(Remark::new(
                "last_trials_differ",
                format!("{who}: the subjects' last trials have different numbers"),
            ));
        }
        let points = self.subjects.iter().flat_map(|s| &s.curve.points);
        remarks.extend(values_not_to_be_used(&who, points));
        remarks
    }
}
