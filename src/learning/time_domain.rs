//! Metrics of one trial in the time domain (Zhang 2015, sections 3.3, 5.4 and 5.8).
#![allow(missing_docs, unused_variables, clippy::todo, clippy::missing_errors_doc)]
use crate::control::Model;
use crate::trial::Trial;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Time-domain metrics of a trial (divergence is judged where the display limit is known).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TimeDomainMetrics {
    /// ‖e‖, the mean of |r − y| over all samples.
    pub mean_abs_error: f64,
    /// Root mean square of r − y.
    pub rms_error: f64,
    /// The largest |y|.
    pub max_abs_output: f64,
}

/// The metrics of a trial recorded on `plant`.
pub fn metrics(trial: &Trial, plant: &Model) -> TimeDomainMetrics {
    todo!()
}
