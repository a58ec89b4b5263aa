//! Shares of the variation of trials that a model accounts for.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Shares of the recorded variation that a simulation from the stimuli accounts for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrialShare {
    /// The trial, by its place in the request.
    pub trial: String,
    /// Of the control.
    pub u: Option<f64>,
    /// Of the output.
    pub y: Option<f64>,
}

/// Means over trials, and each of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Shares {
    /// Of the control; null where a trial has none.
    pub u: Option<f64>,
    /// Of the output.
    pub y: Option<f64>,
    /// Trial by trial.
    pub trials: Vec<TrialShare>,
}

impl Shares {
    pub(super) fn new(trials: Vec<TrialShare>) -> Self {
        let mean = |values: Vec<Option<f64>>| {
            let values: Option<Vec<f64>> = values.into_iter().collect();
            crate::num::stats::mean(&values?)
        };
        Self { u: mean(trials.iter().map(|t| t.u).collect()), y: mean(trials.iter().map(|t| t.y).collect()), trials }
    }
}
