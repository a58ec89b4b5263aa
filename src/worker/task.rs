//! One analysis, from claim to outcome.

use super::compute::{ComputeError, Priority, panic_text, run_work};
use super::execute::{Execute, Work};
use super::settings::WorkerSettings;
use crate::analysis::ids::AnalysisId;
use crate::analysis::{Code, Failure, Incumbent, Library, Problem, References, Report};
use crate::ctl::{Ctl, StopReason, Stopped};
use crate::jobs::LeasePolicy;
use crate::store::{Claim, Heartbeat, Lease, LeaseState, Store, StoreError, Trouble};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, MissedTickBehavior, interval_at, sleep};

/// How often cancellation is looked for: a read of some microseconds. What is cancelled is to stop within half a
/// second.
const PEEK: Duration = Duration::from_millis(100);

/// How long to wait before the inputs are read again; longer each time.
const FETCH_PAUSE: Duration = Duration::from_millis(500);

/// How often reading the inputs is tried while the database fails in a way that may pass.
const FETCH_TRIES: u32 = 4;

/// How long an outcome is kept while it cannot be written because of the disk.
const OUTAGE: Duration = Duration::from_secs(3600);

/// What one analysis needs from its worker.
pub(super) struct Attendant {
    pub(super) store: Store,
    pub(super) execute: Arc<dyn Execute>,
    pub(super) settings: Arc<WorkerSettings>,
    pub(super) policy: LeasePolicy,
}

/// What became of the computation.
enum Outcome {
    Report(Box<Report>),
    Problem(Problem),
    Stopped(StopReason, Option<Box<Incumbent>>),
}

impl From<Failure> for Outcome {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Stopped(Stopped(reason)) => Self::Stopped(reason, None),
            Failure::Interrupted { stopped: Stopped(reason), incumbent } => Self::Stopped(reason, Some(incumbent)),
            Failure::Problem(problem) => Self::Problem(problem),
        }
    }
}

/// What became of the analysis, for the log and for the worker's account of its shutdown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ended {
    Finished,
    Released,
    Lost,
    /// The outcome could not be written; the lease runs out and the work is done again.
    Unwritten,
}

impl Attendant {
    /// Computes a claimed analysis while keeping its lease, and writes the outcome.
    pub(super) async fn attend(&self, claim: Claim, ctl: Arc<Ctl>) -> Ended {
        let lease = claim.lease.clone();
        let id = lease.analysis;
        tracing::info!(analysis = %id, attempt = claim.attempt, kind = %claim.request.kind, "analysis started");
        let outcome = {
            let computing = self.compute(claim, Arc::clone(&ctl));
            tokio::pin!(computing);
            let keeping = self.keep(&lease, &ctl);
            tokio::pin!(keeping);
            tokio::select! {
                biased;
                outcome = &mut computing => outcome,
                reason = self.unanswered(&ctl) => {
                    tracing::error!(analysis = %id, ?reason, "a computation does not stop; it is left behind");
                    Outcome::Stopped(reason, None)
                }
                // Never ends on its own.
                () = &mut keeping => Outcome::Stopped(StopReason::Withdrawn, None),
            }
        };
        let ended = self.write(&lease, outcome, &ctl).await;
        tracing::info!(analysis = %id, ?ended, "analysis ended");
        ended
    }

    /// Waits until the computation was told to stop and has not answered for as long as it is given.
    async fn unanswered(&self, ctl: &Ctl) -> StopReason {
        loop {
            sleep(PEEK).await;
            if ctl.check().is_err() {
                break;
            }
        }
        sleep(Duration::from_secs_f64(self.settings.stop_grace_s)).await;
        match ctl.check() {
            Err(Stopped(reason)) => reason,
            Ok(()) => unreachable!("nobody takes back a stop"),
        }
    }

    async fn compute(&self, claim: Claim, ctl: Arc<Ctl>) -> Outcome {
        let id = claim.lease.analysis;
        match self.computed(claim, ctl).await {
            Ok(Ok(report)) => Outcome::Report(Box::new(report)),
            Ok(Err(failure)) => failure.into(),
            Err(error) => {
                tracing::error!(analysis = %id, %error, "a computation broke off");
                let detail = match error {
                    ComputeError::Panicked(_) => format!("a defect of this program; its log names the analysis {id}"),
                    ComputeError::NoThreads(_) => "the machine gave no threads to compute on".to_owned(),
                };
                Outcome::Problem(
                    Problem::new(Code::Internal, "the computation broke off", detail).mend(
                        "Report it with the request; asking again without a change will likely end the same way.",
                    ),
                )
            }
        }
    }

    async fn computed(&self, claim: Claim, ctl: Arc<Ctl>) -> Result<Result<Report, Failure>, ComputeError> {
        let execute = Arc::clone(&self.execute);
        let request = claim.request;
        let plan = move || -> Result<(Box<dyn Work>, References), Problem> {
            let work = execute.plan(&request)?;
            let references = work.references();
            Ok((work, references))
        };
        let planned = tokio::task::spawn_blocking(move || catch_unwind(AssertUnwindSafe(plan))).await;
        let (work, references) = match planned {
            Ok(Ok(Ok(planned))) => planned,
            Ok(Ok(Err(problem))) => return Ok(Err(problem.into())),
            Ok(Err(payload)) => return Err(ComputeError::Panicked(panic_text(payload.as_ref()))),
            Err(error) => return Err(ComputeError::NoThreads(error.to_string())),
        };
        let library = match self.library(claim.lease.analysis, &references).await {
            Ok(library) => library,
            Err(problem) => return Ok(Err(problem.into())),
        };
        if let Err(stopped) = ctl.check() {
            return Ok(Err(stopped.into()));
        }
        on_own_thread(work, library, ctl, self.settings.compute_threads).await
    }

    /// The inputs. What is only passing is tried again; what stays becomes a problem.
    async fn library(&self, id: AnalysisId, references: &References) -> Result<Library, Problem> {
        let mut tried = 0;
        loop {
            let error = match self.store.library(references).await {
                Ok(library) => return Ok(library),
                Err(error) => error,
            };
            tried += 1;
            if error.is_transient() && tried < FETCH_TRIES {
                tracing::warn!(analysis = %id, %error, "the inputs could not be read; trying again");
                sleep(FETCH_PAUSE * tried).await;
                continue;
            }
            tracing::error!(analysis = %id, %error, "the inputs could not be read");
            return Err(match error {
                StoreError::NotFound { .. } => {
                    Problem::new(Code::NotFound, "an input was deleted", error.to_string()).at("/inputs")
                }
                StoreError::Damaged(_) => Problem::new(Code::Internal, "an input is damaged", error.to_string())
                    .at("/inputs")
                    .mend("Restore the database from a backup, or upload the trial again."),
                _ => Problem::new(
                    Code::Internal,
                    "the inputs could not be read",
                    format!("the database failed; the log names the analysis {id}"),
                )
                .mend("Ask for the analysis again once the database works."),
            });
        }
    }

    /// Keeps the lease, writes progress, and passes on why the computation should stop. Never returns.
    async fn keep(&self, lease: &Lease, ctl: &Ctl) {
        let begin = Instant::now();
        let heartbeat = self.policy.heartbeat();
        let peek = PEEK.min(heartbeat);
        let mut beats = interval_at(begin + heartbeat, heartbeat);
        let mut peeks = interval_at(begin + peek, peek);
        beats.set_missed_tick_behavior(MissedTickBehavior::Delay);
        peeks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let deadline = self.settings.deadline_s.map(|s| begin + Duration::from_secs_f64(s));
        loop {
            let held = tokio::select! {
                biased;
                () = passed(deadline), if ctl.check().is_ok() => {
                    ctl.stop(StopReason::Deadline);
                    continue;
                }
                _ = beats.tick() => self.store.heartbeat(lease, Heartbeat::of(ctl), self.settings.lease_s).await,
                _ = peeks.tick() => self.store.peek(lease).await,
            };
            match held {
                Ok(LeaseState::Held) => {}
                Ok(LeaseState::CancelRequested) => ctl.stop(StopReason::Cancelled),
                Ok(LeaseState::Lost) => ctl.stop(StopReason::Withdrawn),
                // The computation goes on: if the lease does run out meanwhile, the fence keeps its outcome away.
                Err(error) => {
                    tracing::warn!(analysis = %lease.analysis, %error, "no sign of life could be given; trying again");
                }
            }
        }
    }

    /// Writes the outcome, again and again while the database fails, for as long as two leases; while the disk is
    /// full or fails, when nobody can take the work over either, for an hour.
    async fn write(&self, lease: &Lease, outcome: Outcome, ctl: &Ctl) -> Ended {
        let begin = Instant::now();
        let mut pause = Duration::from_millis(50);
        loop {
            let error = match self.write_once(lease, &outcome, ctl).await {
                Ok(ended) => return ended,
                Err(error) => error,
            };
            let patience = match error.trouble() {
                Some(Trouble::Full | Trouble::Unusable) => OUTAGE.max(2 * self.policy.lease()),
                _ => 2 * self.policy.lease(),
            };
            if begin.elapsed() > patience {
                tracing::error!(analysis = %lease.analysis, %error, "the outcome could not be written; it will be \
                    computed again");
                return Ended::Unwritten;
            }
            tracing::warn!(analysis = %lease.analysis, %error, "the outcome could not be written; trying again");
            sleep(pause).await;
            pause = (2 * pause).min(Duration::from_secs(2));
        }
    }

    async fn write_once(&self, lease: &Lease, outcome: &Outcome, ctl: &Ctl) -> Result<Ended, StoreError> {
        if let Outcome::Stopped(StopReason::Cancelled | StopReason::Deadline, incumbent) = outcome {
            // How far it came stays with it.
            let last = Heartbeat { incumbent: incumbent.as_deref().cloned(), ..Heartbeat::of(ctl) };
            self.store.heartbeat(lease, last, self.settings.lease_s).await?;
        }
        let finished = |held: bool| if held { Ended::Finished } else { Ended::Lost };
        match outcome {
            Outcome::Report(report) => self.store.succeed(lease, report).await.map(finished),
            Outcome::Problem(problem) => self.store.fail(lease, problem).await.map(finished),
            Outcome::Stopped(StopReason::Cancelled, _) => self.store.confirm_cancel(lease).await.map(finished),
            Outcome::Stopped(StopReason::Deadline, _) => {
                let limit = self.settings.deadline_s.unwrap_or_default();
                let problem = Problem::new(
                    Code::DeadlineExceeded,
                    "the time given has passed",
                    format!("the analysis was not done after {limit} s, the limit of this server"),
                )
                .mend("Ask for a smaller pool, or raise the limit.");
                self.store.fail(lease, &problem).await.map(finished)
            }
            Outcome::Stopped(StopReason::Withdrawn, _) => Ok(Ended::Lost),
            Outcome::Stopped(StopReason::Shutdown, _) => {
                let released = self.store.release(lease).await?;
                Ok(if released { Ended::Released } else { Ended::Lost })
            }
        }
    }
}

/// Waits until the deadline; for ever where there is none.
async fn passed(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => tokio::time::sleep_until(deadline).await,
        None => std::future::pending().await,
    }
}

/// Computes on an operating system thread of its own, which waits for the pool.
async fn on_own_thread(
    work: Box<dyn Work>,
    library: Library,
    ctl: Arc<Ctl>,
    threads: usize,
) -> Result<Result<Report, Failure>, ComputeError> {
    let (send, receive) = tokio::sync::oneshot::channel();
    let thread = std::thread::Builder::new().name("analysis".to_owned()).spawn(move || {
        let (outcome, _timing) = run_work(work.as_ref(), &library, &ctl, threads, Priority::Background);
        // Nobody waits any more only when the process goes down; the lease then runs out.
        let _ = send.send(outcome);
    });
    match thread {
        Err(error) => Err(ComputeError::NoThreads(error.to_string())),
        Ok(_) => receive
            .await
            .unwrap_or_else(|_| Err(ComputeError::Panicked("the computation ended without an outcome".to_owned()))),
    }
}
