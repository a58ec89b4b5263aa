//! The trials of people as series of one metric over practice.

use super::super::curves::{Metric, point};
use super::super::groups::Cell;
use super::shape::{ErrorSource, Observation};
use crate::learning::inputs::{Identification, TrialInput};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One metric at one trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeriesPoint {
    /// The session.
    pub session: Option<i64>,
    /// The trial's number over all sessions, from 1.
    pub k: f64,
    /// The value; `None` where the trial has none.
    pub value: Option<f64>,
    /// Its standard error, where the estimator gives one.
    pub standard_error: Option<f64>,
    /// Whether |y| passed the display limit. Then the value is not used, and the trial is counted.
    pub divergent: bool,
}

/// A person's trials, in order of practice.
#[derive(Debug, Clone, PartialEq)]
pub struct PersonSeries {
    /// The pseudonym.
    pub code: String,
    /// The trials.
    pub points: Vec<SeriesPoint>,
}

impl PersonSeries {
    /// The trials that a curve is fitted to.
    pub(super) fn used(&self) -> impl DoubleEndedIterator<Item = (&SeriesPoint, f64)> {
        self.points.iter().filter(|p| !p.divergent).filter_map(|p| Some((p, p.value?)))
    }

    pub(super) fn observations(&self, errors: ErrorSource) -> Vec<Observation> {
        let variance = |p: &SeriesPoint| match (errors, p.standard_error) {
            (ErrorSource::Known, Some(error)) => error * error,
            _ => 1.0,
        };
        self.used().map(|(p, value)| Observation { k: p.k, value, variance: variance(p) }).collect()
    }

    pub(super) fn divergent(&self) -> usize {
        self.points.iter().filter(|p| p.divergent).count()
    }
}

/// Known where every value has a standard error; the second says whether some do, but not all.
pub(super) fn error_source<'a>(people: impl Iterator<Item = &'a PersonSeries>) -> (ErrorSource, bool) {
    let (mut with, mut all) = (0, 0);
    for person in people {
        for (point, _) in person.used() {
            all += 1;
            with += usize::from(point.standard_error.is_some_and(|e| e.is_finite() && e > 0.0));
        }
    }
    let known = all > 0 && with == all;
    (if known { ErrorSource::Known } else { ErrorSource::Residuals }, with > 0 && !known)
}

/// How trial numbers of sessions are counted on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SessionOffset {
    /// The session; null for trials without one, which come first.
    pub session: Option<i64>,
    /// What is added to a trial's number: the practice before this session, where numbers begin anew in each.
    pub offset: i64,
}

/// The axis of practice: all people's trials by one number k, from 1, that no missing trial moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PracticeAxis {
    /// k of the study's first trial, over all people.
    pub first: f64,
    /// k of the study's last trial.
    pub last: f64,
    /// The sessions, in order.
    pub sessions: Vec<SessionOffset>,
}

impl PracticeAxis {
    /// The axis of trials given by session and number for each person; `None` without a trial.
    ///
    /// Where the numbers of a later session go on for everybody, they are taken as they are; where they begin anew, the
    /// largest number of the sessions before is added, that of the whole study and not of the person.
    pub(super) fn new<'a>(people: impl Iterator<Item = &'a [(Option<i64>, i64)]> + Clone) -> Option<Self> {
        let mut ranges: BTreeMap<Option<i64>, (i64, i64)> = BTreeMap::new();
        for (session, number) in people.flatten() {
            let range = ranges.entry(*session).or_insert((*number, *number));
            *range = (range.0.min(*number), range.1.max(*number));
        }
        let goes_on = ranges.values().zip(ranges.values().skip(1)).all(|(before, after)| after.0 > before.1);
        let least = ranges.values().map(|r| r.0).min()?;
        // The laws count from 1.
        let mut before = (1 - least).max(0);
        let mut sessions = Vec::new();
        let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
        for (session, (low, high)) in &ranges {
            sessions.push(SessionOffset { session: *session, offset: before });
            first = first.min((low + before) as f64);
            last = last.max((high + before) as f64);
            if !goes_on {
                before += (*high).max(0);
            }
        }
        Some(Self { first, last, sessions })
    }

    /// k of a trial.
    pub(super) fn k(&self, session: Option<i64>, number: i64) -> f64 {
        let offset = self.sessions.iter().find(|s| s.session == session).map_or(0, |s| s.offset);
        (number + offset) as f64
    }
}

/// The standard error of a metric, where the identification has one.
fn standard_error(found: Option<&Identification>, metric: Metric) -> Option<f64> {
    let errors = &found?.standard_errors;
    match metric {
        Metric::NormFeedback => errors.norm_feedback,
        Metric::NormFeedforwardMinusInverse => errors.norm_feedforward_minus_inverse,
        Metric::NormFeedforwardPlantMinusOne => errors.norm_feedforward_plant_minus_one,
        Metric::MeanAbsError
        | Metric::RmsError
        | Metric::VarianceAccountedFor
        | Metric::ControlLogDimensionlessJerk => None,
    }
}

/// One metric of everybody in a cell.
pub(super) fn series(cell: &Cell, metric: Metric, axis: &PracticeAxis) -> Vec<PersonSeries> {
    let of_trial = |trial: &&TrialInput| {
        let found = cell.spec.as_ref().and_then(|spec| trial.identified_with(&spec.spec_sha256));
        let estimator = found.map(|found| found.estimator).unwrap_or_default();
        SeriesPoint {
            session: trial.session,
            k: axis.k(trial.session, trial.number),
            value: point(trial, 1, cell.spec.as_ref(), estimator).value(metric).filter(|v| v.is_finite()),
            standard_error: standard_error(found, metric),
            divergent: trial.divergent,
        }
    };
    let person = |(subject, trials): &(&crate::learning::inputs::SubjectInput, Vec<&TrialInput>)| PersonSeries {
        code: subject.code.clone(),
        points: trials.iter().map(of_trial).collect(),
    };
    cell.subjects.iter().map(person).collect()
}
