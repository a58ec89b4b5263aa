//! What is doubtful about a recording on its plant, as it is kept with the trial.

use crate::analysis::Warning;
use crate::control::Model;
use crate::learning::recording;
use crate::trial::Trial;

/// A warning for each doubt.
pub(super) fn doubts(trial: &Trial, plant: &Model) -> Vec<Warning> {
    recording::doubts(trial, Some(plant)).into_iter().map(|doubt| Warning::new(doubt.code, doubt.message)).collect()
}
