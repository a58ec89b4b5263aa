//! The life of an analysis as a job: status, transitions, leases, attempts. Pure: no clock, no storage.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Where an analysis stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Waiting for a worker.
    Queued,
    /// Held by a worker under a lease.
    Running,
    /// Finished, with a report.
    Succeeded,
    /// Finished, with a problem.
    Failed,
    /// Stopped by a person.
    Cancelled,
}
