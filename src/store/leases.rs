//! What workers write. Every write matches id, `running` and lease token: a worker that comes late changes nothing.

use super::analyses::{attempts, job};
use super::clock::span_us;
use super::error::{StoreError, StoreResult};
use super::open::Store;
use super::records::{Claim, Heartbeat, Lease, LeaseState, Rescued};
use super::rows::{get, json_opt, json_verified, parsed, sha256, signed, to_json};
use crate::analysis::ids::AnalysisId;
use crate::analysis::{Code, Problem, Report};
use crate::ctl::{Bracket, Progress};
use crate::jobs::{Backoff, EtaEstimator, Event, Status};
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

/// Ends a running analysis in a final state, or puts it back; `finished_at` follows from the status.
const LEAVE_RUNNING: &str = "UPDATE analyses SET
        status = $3, problem = $4, report = $5, report_sha256 = $6,
        finished_at = CASE WHEN $3 <> 'queued' THEN $7 END,
        attempts = $8, available_at = $9,
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
            "SELECT id, status, attempts, cancel_requested, worker, available_at, lease_token, progress_done,
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
    let available_at: i64 = match event {
        Event::WorkerDied { .. } => now.saturating_add(wait_us(before.attempts, id)),
        // Handed back: it keeps its place in the queue.
        _ => get(row, "available_at")?,
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
        .execute(connection)
        .await?;
    Ok((changed.rows_affected() == 1).then_some(after.status))
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
        let mut tx = self.begin().await?;
        let now = self.now_us();
        let token = Uuid::new_v4().to_string();
        let row = sqlx::query(
            "UPDATE analyses SET status = 'running', attempts = attempts + 1, lease_token = $1, lease_expires_at = $2,
                worker = $3, started_at = $4, progress_done = 0, progress_total = 0, progress_at = $4,
                phase = 'computing', phase_from = 0, phase_to = 1, fraction = 0, phase_began_at = $4, eta_s = NULL,
                incumbent_cost = NULL, incumbent_index = NULL, lower_bound = NULL, incumbent = NULL, version =
                version + 1, updated_at = $4
             WHERE id = (SELECT id FROM analyses WHERE status = 'queued' AND available_at <= $4
                         ORDER BY available_at, id LIMIT 1)
               AND status = 'queued'
             RETURNING id, request, request_sha256, attempts",
        )
        .bind(&token)
        .bind(now.saturating_add(span_us(lease_s)))
        .bind(worker)
        .bind(now)
        .fetch_optional(&mut *tx)
        .await?;
        tx.commit().await?;
        row.map(|row| Ok((Lease { analysis: parsed(&row, "id")?, token }, row))).transpose()
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
        let Heartbeat { progress, bracket, incumbent } = heartbeat.into();
        // No pool that is searched has so many candidates; another index would be a wrong one.
        let bracket = bracket.and_then(Bracket::checked).filter(|bracket| i64::try_from(bracket.index).is_ok());
        let incumbent = incumbent.filter(|_| bracket.is_some());
        let mut tx = self.begin().await?;
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
                version = version + $9, updated_at = CASE WHEN $9 > 0 THEN $6 ELSE updated_at END
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
        .fetch_optional(self.readers())
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
        let text = to_json(report)?;
        self.finish(lease, Event::Succeed, Outcome::Report(&text, report)).await
    }

    /// Finishes with a problem; false when the lease was lost.
    ///
    /// # Errors
    /// The database's own.
    pub async fn fail(&self, lease: &Lease, problem: &Problem) -> StoreResult<bool> {
        self.finish(lease, Event::Fail, Outcome::Problem(problem)).await
    }

    /// Marks a running analysis cancelled; false when the lease was lost, or when nobody asked for that.
    ///
    /// # Errors
    /// The database's own.
    pub async fn confirm_cancel(&self, lease: &Lease) -> StoreResult<bool> {
        self.finish(lease, Event::ConfirmCancel, Outcome::Nothing).await
    }

    /// Hands the work back (shutdown) without counting the attempt. Where cancellation was asked for meanwhile, it is
    /// cancelled instead.
    ///
    /// # Errors
    /// The database's own.
    pub async fn release(&self, lease: &Lease) -> StoreResult<bool> {
        let released = self.finish(lease, Event::Release, Outcome::Nothing).await?;
        if released {
            self.announce_work();
        }
        Ok(released)
    }

    async fn finish(&self, lease: &Lease, event: Event, outcome: Outcome<'_>) -> StoreResult<bool> {
        let mut tx = self.begin().await?;
        let Some(row) = held(&mut tx, lease).await? else { return Ok(false) };
        let now = self.now_us();
        let report = if let Outcome::Report(_, report) = outcome { Some(report) } else { None };
        let left = leave_running(&mut tx, &row, event, outcome, now).await?.is_some();
        if let Some(report) = report.filter(|_| left) {
            super::trust::write(&mut tx, lease.analysis, report).await?;
        }
        tx.commit().await?;
        Ok(left)
    }

    /// Returns analyses whose lease ran out to the end of the queue, or fails those whose attempts are used up.
    ///
    /// # Errors
    /// The database's own.
    pub async fn rescue(&self, max_attempts: u32) -> StoreResult<Rescued> {
        self.scrub_if_due().await;
        // Asked by every worker every few seconds, and nearly always for nothing: do not take the write lock for that.
        let due: Option<i64> =
            sqlx::query_scalar("SELECT 1 FROM analyses WHERE status = 'running' AND lease_expires_at <= $1 LIMIT 1")
                .bind(self.now_us())
                .fetch_optional(self.readers())
                .await?;
        let mut rescued = Rescued::default();
        if due.is_none() {
            return Ok(rescued);
        }
        let mut tx = self.begin().await?;
        let now = self.now_us();
        let rows = sqlx::query(running_where!("lease_expires_at <= $1 ORDER BY lease_expires_at, id"))
            .bind(now)
            .fetch_all(&mut *tx)
            .await?;
        for row in &rows {
            let id: AnalysisId = parsed(row, "id")?;
            match leave_running(&mut tx, row, Event::WorkerDied { max_attempts }, Outcome::Nothing, now).await? {
                Some(Status::Queued) => rescued.requeued.push(id),
                Some(Status::Cancelled) => rescued.cancelled.push(id),
                Some(_) => rescued.failed.push(id),
                None => return Err(StoreError::Damaged(format!("the analysis {id} could not be rescued"))),
            }
        }
        tx.commit().await?;
        if !rescued.requeued.is_empty() {
            self.announce_work();
        }
        Ok(rescued)
    }
}
