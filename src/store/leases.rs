//! What workers write. Every write matches id, `running` and lease token: a worker that comes late changes nothing.

use super::analyses::{attempts, job};
use super::claims::{Claim, Heartbeat, Lease, LeaseState, Rescued};
use super::clock::span_us;
use super::error::{StoreError, StoreResult};
use super::open::Store;
use super::queue::{CLAIM, RUNNING, end_of_line};
use super::rows::{get, json_opt, json_verified, parsed, sha256, signed, to_json};
use super::watch::Running;
use crate::analysis::ids::AnalysisId;
use crate::analysis::{Code, Problem, Report};
use crate::ctl::{Bracket, Progress};
use crate::jobs::{Backoff, EtaEstimator, Event, Status};
use sqlx::sqlite::SqliteRow;
use sqlx::{Sqlite, SqliteConnection, Transaction};
use uuid::Uuid;

/// Ends a running analysis in a final state, or puts it back; `finished_at` follows from the status.
const LEAVE_RUNNING: &str = "UPDATE analyses SET
        status = $3, problem = $4, report = $5, report_sha256 = $6,
        finished_at = CASE WHEN $3 <> 'queued' THEN $7 END,
        attempts = $8, available_at = $9, wait_us = $10, place = $11,
        progress_done = CASE WHEN $3 = 'succeeded' THEN max(progress_total, 1)
            WHEN $3 = 'queued' THEN 0 ELSE progress_done END,
        progress_total = CASE WHEN $3 = 'succeeded' THEN max(progress_total, 1)
            WHEN $3 = 'queued' THEN 0 ELSE progress_total END,
        fraction = CASE $3 WHEN 'succeeded' THEN 1 WHEN 'queued' THEN 0 ELSE fraction END,
        phase = CASE WHEN $3 IN ('failed', 'cancelled') THEN phase ELSE 'computing' END,
        phase_from = CASE WHEN $3 IN ('failed', 'cancelled') THEN phase_from ELSE 0 END,
        phase_to = CASE WHEN $3 IN ('failed', 'cancelled') THEN phase_to ELSE 1 END,
        incumbent_cost = CASE WHEN $3 IN ('failed', 'cancelled') THEN incumbent_cost END,
        incumbent_index = CASE WHEN $3 IN ('failed', 'cancelled') THEN incumbent_index END,
        lower_bound = CASE WHEN $3 IN ('failed', 'cancelled') THEN lower_bound END,
        incumbent = CASE WHEN $3 IN ('failed', 'cancelled') THEN incumbent END,
        eta_s = NULL, lease_token = NULL, lease_expires_at = NULL, version = version + 1, updated_at = $7
    WHERE id = $1 AND status = 'running' AND lease_token = $2";

/// What a worker hands in.
enum Outcome<'a> {
    Nothing,
    /// Its text, and what that says.
    Report(&'a str, &'a Report),
    Problem(&'a Problem),
}

/// What the rules need to know of a running analysis: everything but its request, which can be large.
macro_rules! running_where {
    ($condition:literal) => {
        concat!(
            "SELECT id, status, attempts, cancel_requested, worker, available_at, place, lease_token, progress_done,
                progress_total, phase, phase_from, phase_to, fraction, started_at, progress_at, phase_began_at, eta_s,
                incumbent_cost, incumbent_index, lower_bound, incumbent
             FROM analyses WHERE status = 'running' AND ",
            $condition
        )
    };
}

/// A running analysis that this lease still holds.
async fn held(connection: &mut SqliteConnection, lease: &Lease) -> StoreResult<Option<SqliteRow>> {
    Ok(sqlx::query(running_where!("id = $1 AND lease_token = $2"))
        .bind(lease.analysis.to_string())
        .bind(&lease.token)
        .fetch_optional(connection)
        .await?)
}

/// Applies an event to a running analysis within a write transaction; `None` where the rules do not allow it.
async fn leave_running(
    connection: &mut SqliteConnection,
    row: &SqliteRow,
    event: Event,
    outcome: Outcome<'_>,
    now: i64,
) -> StoreResult<Option<Status>> {
    let before = job(row)?;
    let Ok(after) = before.apply(event) else { return Ok(None) };
    let id: AnalysisId = parsed(row, "id")?;
    let died = worker_died(row, id)?;
    let (report, problem) = match outcome {
        Outcome::Report(text, _) => (Some(text), None),
        Outcome::Problem(problem) => (None, Some(problem)),
        // Only a worker's death fails an analysis without anybody handing in a problem.
        Outcome::Nothing => (None, (after.status == Status::Failed).then_some(&died)),
    };
    let (available_at, wait_us, place): (i64, i64, i64) = match event {
        Event::WorkerDied { .. } => {
            let wait_us = wait_us(before.attempts, id);
            (now.saturating_add(wait_us), wait_us, last_place(connection, id).await?)
        }
        // Handed back: it keeps its place in the queue.
        _ => (get(row, "available_at")?, 0, get(row, "place")?),
    };
    let token: String = get(row, "lease_token")?;
    let changed = sqlx::query(LEAVE_RUNNING)
        .bind(id.to_string())
        .bind(token)
        .bind(after.status.name())
        .bind(problem.map(to_json).transpose()?)
        .bind(report)
        .bind(report.map(sha256))
        .bind(now)
        .bind(after.attempts)
        .bind(available_at)
        .bind(wait_us)
        .bind(place)
        .execute(connection)
        .await?;
    Ok((changed.rows_affected() == 1).then_some(after.status))
}

/// The place at the end of the line of an analysis that is under way.
async fn last_place(connection: &mut SqliteConnection, id: AnalysisId) -> StoreResult<i64> {
    let select = concat!("SELECT ", end_of_line!("a.study_id", "a.kind"), " FROM analyses a WHERE a.id = $1");
    Ok(sqlx::query_scalar(select).bind(id.to_string()).fetch_one(connection).await?)
}

fn wait_us(attempts: u32, id: AnalysisId) -> i64 {
    span_us(Backoff::default().wait(attempts, id.0.as_u128()).as_secs_f64())
}

fn worker_died(row: &SqliteRow, id: AnalysisId) -> StoreResult<Problem> {
    let (attempts, worker) = (attempts(row)?, get::<Option<String>>(row, "worker")?.unwrap_or_default());
    let why = format!(
        "the analysis {id} was started {attempts} times, and each time its worker stopped without an answer; \
         the last was '{worker}'"
    );
    Ok(Problem::new(Code::WorkerDied, "the worker that ran it died too often", why).mend(
        "Look for the reason in the log of the worker (often too little memory), then ask for the analysis again.",
    ))
}

impl Store {
    /// Takes the oldest available queued analysis, counting an attempt. One `UPDATE … RETURNING`.
    ///
    /// An analysis whose stored request is damaged fails at once, and the next one is taken.
    ///
    /// # Errors
    /// The database's own.
    pub async fn claim(&self, worker: &str, lease_s: f64) -> StoreResult<Option<Claim>> {
        loop {
            let Some((lease, row)) = self.take(worker, lease_s).await? else { return Ok(None) };
            match json_verified(&row, "request", "request_sha256") {
                Ok(request) => return Ok(Some(Claim { lease, request, attempt: attempts(&row)? })),
                Err(StoreError::Damaged(why)) => {
                    tracing::error!(analysis = %lease.analysis, %why, "a stored request is damaged");
                    let problem = Problem::new(Code::Internal, "the stored request is damaged", why)
                        .mend("Restore the database from a backup, or ask for the analysis again.");
                    self.fail(&lease, &problem).await?;
                }
                Err(error) => return Err(error),
            }
        }
    }

    async fn take(&self, worker: &str, lease_s: f64) -> StoreResult<Option<(Lease, SqliteRow)>> {
        let (store, worker) = (self.clone(), worker.to_owned());
        self.uninterrupted(async move {
            let mut tx = store.begin().await?;
            let now = store.now_us();
            let token = Uuid::new_v4().to_string();
            let row = sqlx::query(CLAIM)
                .bind(&token)
                .bind(now.saturating_add(span_us(lease_s)))
                .bind(worker)
                .bind(now)
                .bind(span_us(lease_s).max(1))
                .fetch_optional(&mut *tx)
                .await?;
            tx.commit().await?;
            let Some(row) = row else { return Ok(None) };
            let lease = Lease { analysis: parsed(&row, "id")?, token };
            store.inner().watch.begin(&lease, get(&row, "beat")?, store.passed_us());
            Ok(Some((lease, row)))
        })
        .await
    }

    /// Extends the lease and writes how far the work is; `LeaseState::Lost` when the lease is somebody else's or the
    /// row is gone.
    ///
    /// The version (ETag) changes only when what people see changes.
    ///
    /// # Errors
    /// The database's own.
    pub async fn heartbeat(
        &self,
        lease: &Lease,
        heartbeat: impl Into<Heartbeat>,
        lease_s: f64,
    ) -> StoreResult<LeaseState> {
        let (store, lease, heartbeat) = (self.clone(), lease.clone(), heartbeat.into());
        self.uninterrupted(async move { store.beat(&lease, heartbeat, lease_s).await }).await
    }

    async fn beat(&self, lease: &Lease, heartbeat: Heartbeat, lease_s: f64) -> StoreResult<LeaseState> {
        let Heartbeat { progress, bracket, incumbent } = heartbeat;
        // No pool that is searched has so many candidates; another index would be a wrong one.
        let bracket = bracket.and_then(Bracket::checked).filter(|bracket| i64::try_from(bracket.index).is_ok());
        let incumbent = incumbent.filter(|_| bracket.is_some());
        let mut tx = self.begin_relief().await?;
        let Some(row) = held(&mut tx, lease).await? else { return Ok(LeaseState::Lost) };
        let now = self.now_us();
        let progress = Progress { done: progress.done.min(progress.total), ..progress };
        let before = super::analyses::progress(&row)?;
        let time = |column| get::<Option<i64>>(&row, column).map(|time| time.unwrap_or(now));
        let mut eta = EtaEstimator::resume(time("started_at")?, time("phase_began_at")?, time("progress_at")?, before);
        eta.observe(now, progress);
        let eta_before: Option<f64> = get(&row, "eta_s")?;
        let seen_to_change = progress != before
            || eta.eta_s() != eta_before
            || bracket != super::analyses::bracket(&row)?
            || incumbent != json_opt(&row, "incumbent")?;
        sqlx::query(
            "UPDATE analyses SET lease_expires_at = $3, progress_done = $4, progress_total = $5, progress_at = $6,
                phase_began_at = $7, eta_s = $8, incumbent_cost = $10, incumbent_index = $11, lower_bound = $12,
                incumbent = $13, phase = $14, phase_from = $15, phase_to = $16, fraction = $17,
                beat = beat + 1, lease_us = $18, version = version + $9,
                updated_at = CASE WHEN $9 > 0 THEN $6 ELSE updated_at END
             WHERE id = $1 AND status = 'running' AND lease_token = $2",
        )
        .bind(lease.analysis.to_string())
        .bind(&lease.token)
        .bind(now.saturating_add(span_us(lease_s)))
        .bind(signed(progress.done))
        .bind(signed(progress.total))
        .bind(now)
        .bind(eta.phase_began_us())
        .bind(eta.eta_s())
        .bind(i64::from(seen_to_change))
        .bind(bracket.map(|bracket| bracket.incumbent))
        .bind(bracket.map(|bracket| signed(bracket.index)))
        .bind(bracket.map(|bracket| bracket.bound))
        .bind(incumbent.map(|incumbent| to_json(&incumbent)).transpose()?)
        .bind(progress.phase.name())
        .bind(progress.from)
        .bind(progress.to)
        .bind(progress.fraction)
        .bind(span_us(lease_s).max(1))
        .execute(&mut *tx)
        .await?;
        let cancel: bool = get(&row, "cancel_requested")?;
        tx.commit().await?;
        Ok(if cancel { LeaseState::CancelRequested } else { LeaseState::Held })
    }

    /// What a heartbeat would learn, without extending the lease: a read, cheap enough to ask several times a second.
    ///
    /// # Errors
    /// The database's own.
    pub async fn peek(&self, lease: &Lease) -> StoreResult<LeaseState> {
        let cancel: Option<bool> = sqlx::query_scalar(
            "SELECT cancel_requested FROM analyses WHERE id = $1 AND status = 'running' AND lease_token = $2",
        )
        .bind(lease.analysis.to_string())
        .bind(&lease.token)
        .fetch_optional(self.readers()?)
        .await?;
        Ok(match cancel {
            None => LeaseState::Lost,
            Some(true) => LeaseState::CancelRequested,
            Some(false) => LeaseState::Held,
        })
    }

    /// Finishes with a report; false when the lease was lost.
    ///
    /// # Errors
    /// The database's own.
    pub async fn succeed(&self, lease: &Lease, report: &Report) -> StoreResult<bool> {
        let (store, lease, report) = (self.clone(), lease.clone(), report.clone());
        let text = to_json(&report)?;
        self.uninterrupted(async move {
            let tx = store.begin().await?;
            finish(tx, &lease, Event::Succeed, Outcome::Report(&text, &report), store.now_us()).await
        })
        .await
    }

    /// Finishes with a problem; false when the lease was lost.
    ///
    /// # Errors
    /// The database's own.
    pub async fn fail(&self, lease: &Lease, problem: &Problem) -> StoreResult<bool> {
        let (lease, problem) = (lease.clone(), problem.clone());
        self.relieved(move |store| {
            let (lease, problem) = (lease.clone(), problem.clone());
            async move {
                let tx = store.begin_relief().await?;
                finish(tx, &lease, Event::Fail, Outcome::Problem(&problem), store.now_us()).await
            }
        })
        .await
    }

    /// Marks a running analysis cancelled; false when the lease was lost, or when nobody asked for that.
    ///
    /// # Errors
    /// The database's own.
    pub async fn confirm_cancel(&self, lease: &Lease) -> StoreResult<bool> {
        self.leave(lease, Event::ConfirmCancel).await
    }

    /// Hands the work back (shutdown) without counting the attempt. Where cancellation was asked for meanwhile, it is
    /// cancelled instead.
    ///
    /// # Errors
    /// The database's own.
    pub async fn release(&self, lease: &Lease) -> StoreResult<bool> {
        let released = self.leave(lease, Event::Release).await?;
        if released {
            self.announce_work();
        }
        Ok(released)
    }

    async fn leave(&self, lease: &Lease, event: Event) -> StoreResult<bool> {
        let lease = lease.clone();
        self.relieved(move |store| {
            let lease = lease.clone();
            async move {
                let tx = store.begin_relief().await?;
                finish(tx, &lease, event, Outcome::Nothing, store.now_us()).await
            }
        })
        .await
    }

    /// Returns analyses whose workers gave no sign of life for a lease, as this process has seen by its own clock, to
    /// the end of the queue, or fails those whose attempts are used up. To be called several times in a lease.
    ///
    /// # Errors
    /// The database's own.
    pub async fn rescue(&self, max_attempts: u32) -> StoreResult<Rescued> {
        self.scrub_if_due().await;
        // Asked by every worker every few seconds, and nearly always for nothing: do not take the write lock for that.
        let running = sqlx::query(RUNNING).fetch_all(self.readers()?).await?;
        let running = running.iter().map(|row| {
            let lease = Lease { analysis: parsed(row, "id")?, token: get(row, "lease_token")? };
            Ok(Running { lease, beat: get(row, "beat")?, lease_us: get(row, "lease_us")? })
        });
        let silent = self.inner().watch.silent(running.collect::<StoreResult<_>>()?, self.passed_us());
        if silent.is_empty() {
            return Ok(Rescued::default());
        }
        let store = self.clone();
        let outcome = self.uninterrupted(async move { store.take_back(&silent, max_attempts).await }).await;
        match &outcome {
            Ok(rescued) if rescued.requeued.is_empty() => {}
            Ok(_) => self.announce_work(),
            // Where this could not be written, nor could a sign of life.
            Err(_) => self.inner().watch.forget(),
        }
        outcome
    }

    async fn take_back(&self, silent: &[Running], max_attempts: u32) -> StoreResult<Rescued> {
        let mut rescued = Rescued::default();
        let mut tx = self.begin().await?;
        let now = self.now_us();
        for Running { lease, beat, .. } in silent {
            // Unless it gave a sign at the last moment.
            let row = sqlx::query(running_where!("id = $1 AND lease_token = $2 AND beat = $3"))
                .bind(lease.analysis.to_string())
                .bind(&lease.token)
                .bind(beat)
                .fetch_optional(&mut *tx)
                .await?;
            let Some(row) = row else { continue };
            let id = lease.analysis;
            match leave_running(&mut tx, &row, Event::WorkerDied { max_attempts }, Outcome::Nothing, now).await? {
                Some(Status::Queued) => rescued.requeued.push(id),
                Some(Status::Cancelled) => rescued.cancelled.push(id),
                Some(_) => rescued.failed.push(id),
                None => return Err(StoreError::Damaged(format!("the analysis {id} could not be rescued"))),
            }
        }
        tx.commit().await?;
        Ok(rescued)
    }
}

/// Ends what a lease holds; false when the lease was lost, or the event cannot happen.
async fn finish(
    mut tx: Transaction<'static, Sqlite>,
    lease: &Lease,
    event: Event,
    outcome: Outcome<'_>,
    now: i64,
) -> StoreResult<bool> {
    let Some(row) = held(&mut tx, lease).await? else { return Ok(false) };
    let report = if let Outcome::Report(_, report) = outcome { Some(report) } else { None };
    let left = leave_running(&mut tx, &row, event, outcome, now).await?.is_some();
    if let Some(report) = report.filter(|_| left) {
        super::trust::write(&mut tx, lease.analysis, report).await?;
    }
    tx.commit().await?;
    Ok(left)
}
