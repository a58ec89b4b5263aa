//! The result about a whole controller.

use crate::analysis::inverse::filter::InverseLqeResult;
use crate::analysis::inverse::parts::{Rows, Verdict};
use crate::analysis::inverse::regulator::InverseLqrResult;
use schemars::JsonSchema;
use serde::Serialize;

/// Whether a cost and noises exist for which the controller is optimal, and which.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct InverseLqgResult {
    /// Whether weights exist for both halves: the worse of their verdicts.
    pub verdict: Verdict,
    /// Q, n×n, in units of cost over those of the states; null without weights.
    pub q: Option<Rows>,
    /// R, m×m, in units of cost over those of the inputs; null without weights.
    pub r: Option<Rows>,
    /// W, n×n, in units of a noise of the states; null where no noises exist.
    pub w: Option<Rows>,
    /// V, p×p, in units of a noise of the outputs; null where no noises exist.
    pub v: Option<Rows>,
    /// All about the gain K.
    pub regulator: InverseLqrResult,
    /// All about the gain L.
    pub filter: InverseLqeResult,
}

impl InverseLqgResult {
    pub(super) fn new(regulator: InverseLqrResult, filter: InverseLqeResult) -> Self {
        Self {
            verdict: regulator.verdict.max(filter.verdict),
            q: regulator.q.clone(),
            r: regulator.r.clone(),
            w: filter.w.clone(),
            v: filter.v.clone(),
            regulator,
            filter,
        }
    }
}
