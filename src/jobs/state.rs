//! Which transition is legal, and where it leads.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Where an analysis stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
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

impl Status {
    /// Every status, in the order of life.
    pub const ALL: [Self; 5] = [Self::Queued, Self::Running, Self::Succeeded, Self::Failed, Self::Cancelled];

    /// The name on the wire and in the database.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// The status with this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|status| status.name() == name)
    }

    /// Whether nothing can happen to it any more.
    #[must_use]
    pub fn is_final(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What can happen to a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// A worker takes it.
    Claim,
    /// Its worker hands in a report.
    Succeed,
    /// Its worker hands in a problem.
    Fail,
    /// A person asks for it to be cancelled.
    RequestCancel,
    /// Its worker has stopped because a person asked for that.
    ConfirmCancel,
    /// Its worker hands it back unfinished (shutdown); the attempt does not count.
    Release,
    /// Its lease ran out: the worker is dead, or cut off for so long that it counts as dead.
    WorkerDied {
        /// How many attempts a job has in all.
        max_attempts: u32,
    },
}

/// An event that cannot happen in this status.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{event:?} cannot happen to a job that is {status}")]
pub struct IllegalTransition {
    /// Where the job stands.
    pub status: Status,
    /// What was to happen.
    pub event: Event,
}

/// What the rules look at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Job {
    /// Where it stands.
    pub status: Status,
    /// How often a worker took it and did not hand it back.
    pub attempts: u32,
    /// Whether a person asked for it to be cancelled.
    pub cancel_requested: bool,
}

impl Job {
    /// A job as it enters the queue.
    #[must_use]
    pub fn new() -> Self {
        Self { status: Status::Queued, attempts: 0, cancel_requested: false }
    }

    /// The job after an event.
    ///
    /// Asking a finished job to be cancelled changes nothing and is no error: the person who asks cannot know how far
    /// it is. A cancelled job that loses its worker stays cancelled; nobody wants it run again.
    ///
    /// # Errors
    /// [`IllegalTransition`] where the event cannot happen in this status.
    pub fn apply(self, event: Event) -> Result<Self, IllegalTransition> {
        let back_to_queue = if self.cancel_requested { Status::Cancelled } else { Status::Queued };
        let next = match (self.status, event) {
            (Status::Queued, Event::Claim) => {
                Self { status: Status::Running, attempts: self.attempts.saturating_add(1), ..self }
            }
            (Status::Queued, Event::RequestCancel) => {
                Self { status: Status::Cancelled, cancel_requested: true, ..self }
            }
            (Status::Running, Event::RequestCancel) => Self { cancel_requested: true, ..self },
            (Status::Running, Event::Succeed) => Self { status: Status::Succeeded, ..self },
            (Status::Running, Event::Fail) => Self { status: Status::Failed, ..self },
            (Status::Running, Event::ConfirmCancel) if self.cancel_requested => {
                Self { status: Status::Cancelled, ..self }
            }
            (Status::Running, Event::Release) => {
                Self { status: back_to_queue, attempts: self.attempts.saturating_sub(1), ..self }
            }
            (Status::Running, Event::WorkerDied { max_attempts }) => {
                let used_up = self.attempts >= max_attempts && !self.cancel_requested;
                Self { status: if used_up { Status::Failed } else { back_to_queue }, ..self }
            }
            (status, Event::RequestCancel) if status.is_final() => self,
            (status, event) => return Err(IllegalTransition { status, event }),
        };
        Ok(next)
    }
}

impl Default for Job {
    fn default() -> Self {
        Self::new()
    }
}
