//! What each part of a cost contributes along a motion.

use crate::inverse::reading::Shares;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Shares of the cost, dimensionless; they sum to 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "CostShares")]
pub struct SharesResult {
    /// The share of each state, dimensionless, in the order of the states.
    pub states: Vec<f64>,
    /// The share of each input (of a filter: output), dimensionless, in their order.
    pub ports: Vec<f64>,
}

/// The shares, as they are written.
pub(in crate::analysis) fn shares(shares: Shares) -> SharesResult {
    SharesResult { states: shares.states, ports: shares.inputs }
}
