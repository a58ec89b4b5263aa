//! What workers take from the store and tell it.

use crate::analysis::ids::AnalysisId;
use crate::analysis::{Incumbent, Request};
use crate::ctl::{Bracket, Ctl, Progress};

/// The right to write to a running analysis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// The analysis.
    pub analysis: AnalysisId,
    /// A token that only this claim has.
    pub token: String,
}

/// Work taken by a worker.
#[derive(Debug, Clone, PartialEq)]
pub struct Claim {
    /// The right to write to it.
    pub lease: Lease,
    /// The request with its defaults filled in.
    pub request: Request,
    /// Which attempt this is, from 1.
    pub attempt: u32,
}

/// How far a worker is, as it tells the store while it holds a lease.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Heartbeat {
    /// Units finished, and in all.
    pub progress: Progress,
    /// How near its search is.
    pub bracket: Option<Bracket>,
    /// The controllers with the bracket's cost; only where the search was stopped.
    pub incumbent: Option<Incumbent>,
}

impl Heartbeat {
    /// As a computation tells it.
    #[must_use]
    pub fn of(ctl: &Ctl) -> Self {
        Self { progress: ctl.progress(), bracket: ctl.bracket(), incumbent: None }
    }
}

impl From<Progress> for Heartbeat {
    fn from(progress: Progress) -> Self {
        Self { progress, ..Self::default() }
    }
}

/// What a heartbeat learned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LeaseState {
    /// Still ours.
    Held,
    /// Still ours, and somebody asked for it to be cancelled.
    CancelRequested,
    /// Not ours any more.
    Lost,
}

/// What a rescue did.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Rescued {
    /// Back in the queue.
    pub requeued: Vec<AnalysisId>,
    /// Failed, since their attempts are used up.
    pub failed: Vec<AnalysisId>,
    /// Cancelled, since that was asked for while their worker died.
    pub cancelled: Vec<AnalysisId>,
}
