//! Divergent trials and the first control, counted by people: trials of one person are not independent.

use super::counts::{Proportion, ProportionDifference, difference, proportion};
use super::mixed_logit::{MixedLogit, PersonCount, mixed_logit};
use super::permutation::{Permutation, two_groups};
use crate::learning::groups::{Cell, Count};
use crate::learning::inputs::TrialInput;
use crate::num::stats::mean;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A person's divergent trials.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PersonDivergence {
    /// The pseudonym.
    pub code: String,
    /// Divergent trials, of all trials.
    pub divergent: Count,
}

/// Whether people began a trial with the right control.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RightControl {
    /// The trial's number.
    pub number: i64,
    /// Its session.
    pub session: Option<i64>,
    /// People who did, of those of whom it can be said.
    pub people: Proportion,
    /// People who did not record this trial, or of whom it cannot be said.
    pub undetermined: Vec<String>,
}

/// The counts of a group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupCounts {
    /// Each person's divergent trials.
    pub divergent: Vec<PersonDivergence>,
    /// Mean over people of the share of their trials that is divergent; null of nobody.
    pub mean_divergent_share: Option<f64>,
    /// People with at least one divergent trial.
    pub people_with_divergent_trials: Proportion,
    /// The study's first trial.
    pub right_control_first: RightControl,
    /// The study's last trial.
    pub right_control_last: RightControl,
}

/// The counts of two groups, second less first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairCounts {
    /// The difference of the mean share of divergent trials, by permutation of people's shares.
    pub divergent: Option<Permutation>,
    /// Its p-value adjusted for all counts that are tested in this answer.
    pub divergent_p_adjusted: Option<f64>,
    /// A logistic regression with a random intercept for each person.
    pub mixed_logit: Option<MixedLogit>,
    /// Why there is none.
    pub no_mixed_logit: Option<String>,
    /// People with at least one divergent trial.
    pub people_with_divergent_trials: Option<ProportionDifference>,
    /// People who began the study's first trial with the right control.
    pub right_control_first: Option<ProportionDifference>,
    /// People who began the study's last trial with the right control.
    pub right_control_last: Option<ProportionDifference>,
}

/// Session and number of a trial.
pub(super) type TrialKey = (Option<i64>, i64);

/// The counts of a group; first controls that were judged with another threshold are not counted.
pub(super) fn group_counts(cell: &Cell, first: TrialKey, last: TrialKey, threshold: f64) -> GroupCounts {
    let divergence =
        |(subject, trials): &(&crate::learning::inputs::SubjectInput, Vec<&TrialInput>)| PersonDivergence {
            code: subject.code.clone(),
            divergent: Count { count: trials.iter().filter(|t| t.divergent).count(), of: trials.len() },
        };
    let divergent: Vec<PersonDivergence> = cell.subjects.iter().map(divergence).collect();
    let with = divergent.iter().filter(|p| p.divergent.count > 0).count();
    let right = |(session, number): TrialKey| {
        let (mut right, mut of, mut undetermined) = (0, 0, Vec::new());
        for (subject, trials) in &cell.subjects {
            let trial = trials.iter().find(|t| (t.session, t.number) == (session, number));
            let judged = trial.filter(|t| t.metrics.right_control_threshold == threshold);
            match judged.and_then(|t| t.metrics.right_control_at_start) {
                Some(is_right) => {
                    right += usize::from(is_right);
                    of += 1;
                }
                None => undetermined.push(subject.code.clone()),
            }
        }
        RightControl { number, session, people: proportion(right, of), undetermined }
    };
    GroupCounts {
        mean_divergent_share: mean(&shares(&divergent)),
        people_with_divergent_trials: proportion(with, divergent.len()),
        divergent,
        right_control_first: right(first),
        right_control_last: right(last),
    }
}

fn shares(people: &[PersonDivergence]) -> Vec<f64> {
    let of_trials = people.iter().filter(|p| p.divergent.of > 0);
    of_trials.map(|p| p.divergent.count as f64 / p.divergent.of as f64).collect()
}

pub(super) fn pair_counts(first: &GroupCounts, second: &GroupCounts, seed: u64) -> PairCounts {
    let people = |group: &GroupCounts, second: bool| -> Vec<PersonCount> {
        let one = |p: &PersonDivergence| PersonCount { count: p.divergent.count, of: p.divergent.of, second };
        group.divergent.iter().map(one).collect()
    };
    let logit = mixed_logit(&[people(first, false), people(second, true)].concat());
    let between = |part: fn(&GroupCounts) -> &Proportion| difference(part(first), part(second));
    PairCounts {
        divergent: two_groups(&shares(&first.divergent), &shares(&second.divergent), seed),
        divergent_p_adjusted: None,
        no_mixed_logit: logit.as_ref().err().map(ToString::to_string),
        mixed_logit: logit.ok(),
        people_with_divergent_trials: between(|g| &g.people_with_divergent_trials),
        right_control_first: between(|g| &g.right_control_first.people),
        right_control_last: between(|g| &g.right_control_last.people),
    }
}
