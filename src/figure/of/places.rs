//! Where trials stand on an axis that counts them.

use crate::learning::StudyLearningCurves;
use std::collections::BTreeMap;

/// Sessions with the numbers of their trials, and where each begins on the axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Places {
    /// By session: what is added to its trials' numbers.
    offsets: BTreeMap<Option<i64>, i64>,
    /// Between the sessions, each with the one that begins.
    pub(super) borders: Vec<(f64, i64)>,
    /// The greatest place of all.
    pub(super) last: f64,
    /// Whether places are other than the trials' numbers.
    pub(super) are_counted_on: bool,
}

impl Places {
    /// Of all trials of a study's curves. Where numbers begin anew in each session they are counted on.
    pub(super) fn of(curves: &StudyLearningCurves) -> Self {
        let mut sessions: BTreeMap<Option<i64>, [i64; 2]> = BTreeMap::new();
        let subjects = curves.groups.iter().flat_map(|group| &group.subjects);
        for point in subjects.flat_map(|subject| &subject.curve.points) {
            let [least, greatest] = sessions.entry(point.session).or_insert([point.number, point.number]);
            (*least, *greatest) = ((*least).min(point.number), (*greatest).max(point.number));
        }
        let all: Vec<(Option<i64>, [i64; 2])> = sessions.into_iter().collect();
        let are_counted_on = all.windows(2).any(|pair| pair[1].1[0] <= pair[0].1[1]);
        let (mut offsets, mut borders) = (BTreeMap::new(), Vec::new());
        let mut last: Option<i64> = None;
        for (session, [least, greatest]) in all {
            let offset = if are_counted_on { last.unwrap_or(0) } else { 0 };
            if let (Some(last), Some(session)) = (last, session) {
                borders.push((0.5 * (last + least + offset) as f64, session));
            }
            offsets.insert(session, offset);
            last = Some(greatest + offset);
        }
        Self { offsets, borders, last: last.unwrap_or(1) as f64, are_counted_on }
    }

    /// The place of a trial.
    pub(super) fn at(&self, session: Option<i64>, number: i64) -> f64 {
        (number + self.offsets.get(&session).copied().unwrap_or(0)) as f64
    }
}

/// `session 2, trial 3`.
pub(super) fn trial(session: Option<i64>, number: i64) -> String {
    session.map_or_else(|| format!("trial {number}"), |session| format!("session {session}, trial {number}"))
}
