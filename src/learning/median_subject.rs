//! The median subject of each group and some of its trials, as figures show them (Zhang 2015, figures 5.6, 5.13 and
//! 5.19): "the subject who has the median time-averaged error".
//!
//! A subject's value is the mean of a metric over its trials that are shown (or that of its first, or last one). Of an
//! even number of subjects none is the median: the lower of the middle two is taken, and the other one named.

use super::bode::{SubjectResponses, subject_responses};
use super::curves::{CurveOptions, CurvePoint, Metric, point};
use super::groups::{Cell, cells};
use super::inputs::{PlantName, Remark, SpecChoice, SubjectInput, TrialInput};
use crate::num::stats::mean;
use crate::trial::Trial;
use crate::trust::{Level, MeanTrust, of_mean};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which of a subject's trials make its value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ValueOver {
    /// The mean over all that are shown.
    #[default]
    All,
    /// The first.
    First,
    /// The last.
    Last,
}

/// A trial that is shown of the median subject.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShownTrial {
    /// Its first one.
    First,
    /// Its last one.
    Last,
    /// The one with this number, in the last session that has one.
    Number(i64),
}

/// How the median subject is found, and what is shown of it.
#[derive(Debug, Clone, PartialEq)]
pub struct MedianChoice {
    /// The metric whose median it has.
    pub metric: Metric,
    /// Over which of its trials.
    pub over: ValueOver,
    /// Which trials are shown.
    pub trials: Vec<ShownTrial>,
    /// Frequencies of the responses, rad/s.
    pub omega_rad_s: Vec<f64>,
}

/// A subject with its value of the metric.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RankedSubject {
    /// Its id.
    pub subject: String,
    /// Its pseudonym.
    pub code: String,
    /// The metric, in its own unit.
    pub value: f64,
    /// How many trials it is of.
    pub trials: usize,
    /// How far it may be used, and how many of its trials' values are not to be used.
    #[serde(default)]
    pub trust: MeanTrust,
}

/// Signals of a recorded trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShownSignals {
    /// Time between recorded samples, in seconds.
    pub sample_time_s: f64,
    /// Which samples are shown: every so many-th.
    pub every: usize,
    /// Time from the first sample, in seconds.
    pub t: Vec<f64>,
    /// Command r, in units of y.
    pub r: Vec<f64>,
    /// Control u, in its unit.
    pub u: Vec<f64>,
    /// Output y, in its unit.
    pub y: Vec<f64>,
    /// Error r − y, in units of y.
    pub e: Vec<f64>,
}

/// A trial of the median subject.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MedianTrial {
    /// What it was asked for as.
    pub shown_as: ShownTrial,
    /// The trial with its metrics and norms.
    pub point: CurvePoint,
    /// Frequency responses of its identified controllers; null where it is not identified, or by an estimator without
    /// transfer functions.
    pub responses: Option<SubjectResponses>,
    /// Its signals; null unless asked for.
    pub signals: Option<ShownSignals>,
}

/// The median subject of a group on a plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupMedian {
    /// The group; null for subjects without one.
    pub group: Option<String>,
    /// The plant.
    pub plant: PlantName,
    /// The spec whose identifications are shown.
    pub spec: Option<SpecChoice>,
    /// All subjects that have a value, by it.
    pub ranking: Vec<RankedSubject>,
    /// The median one; null where no subject has a value.
    pub median: Option<RankedSubject>,
    /// The other of the middle two, of an even number of subjects.
    pub other_middle: Option<RankedSubject>,
    /// Its trials, in the order asked for; those that it does not have are left out, with a remark.
    pub trials: Vec<MedianTrial>,
}

/// The median subjects of a study's groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StudyMedianSubjects {
    /// The metric.
    pub metric: Metric,
    /// Which trials make a subject's value.
    pub over: ValueOver,
    /// Frequencies of the responses, rad/s.
    pub omega_rad_s: Vec<f64>,
    /// Every group on every plant.
    pub groups: Vec<GroupMedian>,
    /// What must be read before using the numbers.
    pub remarks: Vec<Remark>,
}

/// The median subjects, without signals.
#[must_use]
pub fn study_median_subjects(
    subjects: &[SubjectInput],
    choice: &MedianChoice,
    options: &CurveOptions,
) -> StudyMedianSubjects {
    let (cells, mut remarks) = cells(subjects, options);
    let groups: Vec<GroupMedian> = cells.iter().map(|cell| group_median(cell, choice, options, &mut remarks)).collect();
    remarks.extend(groups.iter().filter_map(|group| group.spec.as_ref()?.remark()));
    let MedianChoice { metric, over, omega_rad_s, .. } = choice;
    StudyMedianSubjects { metric: *metric, over: *over, omega_rad_s: omega_rad_s.clone(), groups, remarks }
}

fn group_median(cell: &Cell, choice: &MedianChoice, options: &CurveOptions, remarks: &mut Vec<Remark>) -> GroupMedian {
    let shown = |trials: &[&TrialInput]| -> Vec<usize> {
        (0..trials.len()).filter(|i| options.include_divergent || !trials[*i].divergent).collect()
    };
    let point_of = |trials: &[&TrialInput], i: usize| point(trials[i], i + 1, cell.spec.as_ref(), options.estimator);
    let mut ranking: Vec<(RankedSubject, usize)> = Vec::new();
    let mut without = Vec::new();
    for (place, (subject, trials)) in cell.subjects.iter().enumerate() {
        let mut values: Vec<(f64, Level)> = shown(trials)
            .into_iter()
            .map(|i| point_of(trials, i))
            .filter_map(|point| Some((point.value(choice.metric)?, point.level(choice.metric))))
            .collect();
        match choice.over {
            ValueOver::All => {}
            ValueOver::First => values.truncate(1),
            ValueOver::Last => values = values.split_off(values.len().saturating_sub(1)),
        }
        let (values, levels): (Vec<f64>, Vec<Level>) = values.into_iter().unzip();
        match mean(&values) {
            Some(value) => {
                let (id, code) = (subject.subject.clone(), subject.code.clone());
                let trust = of_mean(&levels);
                ranking.push((RankedSubject { subject: id, code, value, trials: values.len(), trust }, place));
            }
            None => without.push(subject.code.as_str()),
        }
    }
    let who = format!("{} on {}", cell.group.as_deref().unwrap_or("subjects without a group"), cell.plant.name);
    if !without.is_empty() {
        let message = format!("{who}: no value of the metric, and no place in the order, of {}", without.join(", "));
        remarks.push(Remark::new("subjects_without_value", message));
    }
    // Equal values by pseudonym, so that equal studies have equal medians.
    ranking.sort_by(|a, b| a.0.value.total_cmp(&b.0.value).then_with(|| a.0.code.cmp(&b.0.code)));
    let middle = ranking.len().saturating_sub(1) / 2;
    let is_even = !ranking.is_empty() && ranking.len().is_multiple_of(2);
    let other_middle = is_even.then(|| ranking[middle + 1].0.clone());
    if let Some(other) = &other_middle {
        let message = format!(
            "{who}: of {} subjects none is the median; shown is {} ({}), and {} ({}) is as near to it",
            ranking.len(),
            ranking[middle].0.code,
            ranking[middle].0.value,
            other.code,
            other.value
        );
        remarks.push(Remark::new("no_single_median", message));
    }
    let [bad, all] = ranking
        .iter()
        .fold([0, 0], |[bad, all], (subject, _)| [bad + subject.trust.do_not_use, all + subject.trust.of]);
    if bad > 0 {
        let message = format!("{who}: {bad} of the {all} values that the order is made of are not to be used");
        remarks.push(Remark::new("values_not_to_be_used", message));
    }
    let mut trials = Vec::new();
    if let Some((median, place)) = ranking.get(middle) {
        let (_, all) = &cell.subjects[*place];
        for asked in &choice.trials {
            let mut found = shown(all).into_iter();
            let i = match asked {
                ShownTrial::First => found.next(),
                ShownTrial::Last => found.next_back(),
                ShownTrial::Number(number) => found.rfind(|i| all[*i].number == *number),
            };
            let Some(i) = i else {
                let which = match asked {
                    ShownTrial::Number(number) => format!("trial {number}"),
                    ShownTrial::First | ShownTrial::Last => "trial".to_owned(),
                };
                let message = format!("{who}: {} has no {which} that is shown", median.code);
                remarks.push(Remark::new("trial_not_shown", message));
                continue;
            };
            let trial = all[i];
            let identified = cell.spec.as_ref().and_then(|spec| trial.identified_with(&spec.spec_sha256));
            let controllers = identified.and_then(|found| found.controllers.as_ref());
            let responses = controllers.map(|found| subject_responses(&median.code, found, &choice.omega_rad_s));
            trials.push(MedianTrial { shown_as: *asked, point: point_of(all, i), responses, signals: None });
        }
    }
    GroupMedian {
        group: cell.group.clone(),
        plant: cell.plant.clone(),
        spec: cell.spec.clone(),
        median: ranking.get(middle).map(|(subject, _)| subject.clone()),
        other_middle,
        trials,
        ranking: ranking.into_iter().map(|(subject, _)| subject).collect(),
    }
}

impl ShownSignals {
    /// Every so many-th sample of a trial.
    #[must_use]
    pub fn new(trial: &Trial, every: usize) -> Self {
        let thin = |x: &[f64]| -> Vec<f64> { x.iter().step_by(every).copied().collect() };
        let signals = &trial.signals;
        let step = trial.sample_time_s;
        Self {
            sample_time_s: step,
            every,
            t: (0..trial.samples()).step_by(every).map(|k| k as f64 * step).collect(),
            r: thin(&signals.command),
            u: thin(&signals.control),
            y: thin(&signals.output),
            e: thin(&trial.error()),
        }
    }
}
