//! The worker's loop: claim, rescue, drain.

use super::execute::Execute;
use super::settings::WorkerSettings;
use super::task::{Attendant, Ended};
use crate::ctl::{Ctl, StopReason};
use crate::jobs::{BadPolicy, LeasePolicy};
use crate::store::Store;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::{Id, JoinError, JoinSet};
use tokio::time::{Instant, sleep, timeout_at};
use tokio_util::sync::CancellationToken;

/// How long outcomes may take to be written once every computation has stopped or was left behind.
const WRITE_GRACE: Duration = Duration::from_secs(1);

/// The longest pause after database errors.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

/// Takes analyses from a store's queue and computes them.
pub struct Worker {
    store: Store,
    execute: Arc<dyn Execute>,
    settings: Arc<WorkerSettings>,
    policy: LeasePolicy,
}

/// What became of the work that was running when the worker was told to stop.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Drained {
    /// Finished within the time given.
    pub finished: usize,
    /// Handed back to the queue.
    pub released: usize,
    /// Did not stop, or lost its lease, or could not be written: rescued once the lease has run out.
    pub abandoned: usize,
}

/// The analyses under way.
#[derive(Default)]
struct Running {
    tasks: JoinSet<Ended>,
    controls: HashMap<Id, Arc<Ctl>>,
}

impl Running {
    fn settle(&mut self, joined: Result<(Id, Ended), JoinError>) -> Option<Ended> {
        match joined {
            Ok((id, ended)) => {
                self.controls.remove(&id);
                Some(ended)
            }
            Err(error) => {
                self.controls.remove(&error.id());
                tracing::error!(%error, "the attendant of an analysis broke off; the lease runs out and it is rescued");
                None
            }
        }
    }

    /// Waits for the tasks until `deadline`, adding to the account.
    async fn settle_until(&mut self, deadline: Instant, account: &mut Drained) {
        while let Ok(Some(joined)) = timeout_at(deadline, self.tasks.join_next_with_id()).await {
            match self.settle(joined) {
                Some(Ended::Finished) => account.finished += 1,
                Some(Ended::Released) => account.released += 1,
                Some(Ended::Lost | Ended::Unwritten) | None => account.abandoned += 1,
            }
        }
    }
}

impl Worker {
    /// A worker that has not begun.
    ///
    /// # Errors
    /// [`BadPolicy`] names the setting that cannot work.
    pub fn new(store: Store, execute: Arc<dyn Execute>, settings: WorkerSettings) -> Result<Self, BadPolicy> {
        let policy = settings.lease_policy()?;
        Ok(Self { store, execute, settings: Arc::new(settings), policy })
    }

    /// Works until `shutdown`, then drains.
    pub async fn run(&self, shutdown: CancellationToken) -> Drained {
        tracing::info!(
            worker = %self.settings.worker_name,
            concurrency = self.settings.concurrency,
            compute_threads = self.settings.compute_threads,
            "worker started"
        );
        let mut running = Running::default();
        tokio::join!(self.claim_until(&shutdown, &mut running), self.rescue_until(&shutdown));
        let drained = self.drain(running).await;
        tracing::info!(worker = %self.settings.worker_name, ?drained, "worker stopped");
        drained
    }

    async fn claim_until(&self, shutdown: &CancellationToken, running: &mut Running) {
        let work = self.store.work_arrived();
        let poll = Duration::from_secs_f64(self.settings.poll_s);
        let mut pause = poll;
        while !shutdown.is_cancelled() {
            // Registered before the queue is looked at, so that what arrives in between is not slept over.
            let arrived = work.notified();
            tokio::pin!(arrived);
            arrived.as_mut().enable();
            match self.claim_while_free(shutdown, running).await {
                Ok(()) => pause = poll,
                Err(error) => {
                    tracing::error!(%error, pause_s = pause.as_secs_f64(), "no work could be claimed; trying again");
                    tokio::select! {
                        () = shutdown.cancelled() => break,
                        () = sleep(pause) => {}
                    }
                    pause = (2 * pause).min(LONGEST_PAUSE.max(poll));
                    continue;
                }
            }
            let free = running.tasks.len() < self.settings.concurrency;
            tokio::select! {
                () = shutdown.cancelled() => {}
                Some(joined) = running.tasks.join_next_with_id() => drop(running.settle(joined)),
                () = &mut arrived, if free => {}
                () = sleep(poll), if free => {}
            }
        }
    }

    async fn claim_while_free(
        &self,
        shutdown: &CancellationToken,
        running: &mut Running,
    ) -> Result<(), crate::store::StoreError> {
        while running.tasks.len() < self.settings.concurrency && !shutdown.is_cancelled() {
            let Some(claim) = self.store.claim(&self.settings.worker_name, self.settings.lease_s).await? else { break };
            let ctl = Arc::new(Ctl::new());
            let attendant = Attendant {
                store: self.store.clone(),
                execute: Arc::clone(&self.execute),
                settings: Arc::clone(&self.settings),
                policy: self.policy,
            };
            let control = Arc::clone(&ctl);
            let task = running.tasks.spawn(async move { attendant.attend(claim, ctl).await });
            running.controls.insert(task.id(), control);
        }
        Ok(())
    }

    /// Looks several times per lease for work whose worker died, this one's former selves included.
    async fn rescue_until(&self, shutdown: &CancellationToken) {
        let period = (self.policy.lease() / 4).clamp(Duration::from_millis(20), Duration::from_secs(5));
        loop {
            match self.store.rescue(self.policy.max_attempts()).await {
                Ok(rescued) => {
                    for id in &rescued.requeued {
                        tracing::warn!(analysis = %id, "its worker died; it is back in the queue");
                    }
                    for id in &rescued.failed {
                        tracing::error!(analysis = %id, "its workers died too often; it failed");
                    }
                    for id in &rescued.cancelled {
                        tracing::info!(analysis = %id, "cancelled; its worker died meanwhile");
                    }
                }
                Err(error) => tracing::error!(%error, "dead workers' analyses could not be looked for; trying again"),
            }
            tokio::select! {
                () = shutdown.cancelled() => return,
                () = sleep(period) => {}
            }
        }
    }

    /// Lets running work finish for a while, then stops it and hands it back.
    async fn drain(&self, mut running: Running) -> Drained {
        let mut account = Drained::default();
        let patience = Duration::from_secs_f64(self.settings.drain_s);
        running.settle_until(Instant::now() + patience, &mut account).await;
        for control in running.controls.values() {
            control.stop(StopReason::Shutdown);
        }
        let grace = Duration::from_secs_f64(self.settings.stop_grace_s) + WRITE_GRACE;
        running.settle_until(Instant::now() + grace, &mut account).await;
        account.abandoned += running.tasks.len();
        account
    }
}
