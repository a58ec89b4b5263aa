//! Analyses as the people who ask for them see them.

use super::error::{StoreError, StoreResult};
use super::lists::{Filter, Order, Value};
use super::nouns::{Make, Noun, fetch, must_exist};
use super::open::Store;
use super::queue::end_of_line;
use super::records::{
    AnalysisFilter, AnalysisRecord, Created, IdempotencyKey, NewAnalysis, Page, RunFilter, RunProgress,
};
use super::rows::{get, json, json_opt, json_verified, parsed, parsed_opt, sha256, time, time_opt, to_json, unsigned};
use super::used::{PLANTS_OF, TRIALS_OF, linked, used_trials};
use crate::analysis::ids::{AnalysisId, StudyId};
use crate::ctl::{Bracket, Progress};
use crate::jobs::{Event, Job, Status};
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

/// Of how many analyses a run is asked how long they took.
const LATEST: i64 = 20;

pub(super) fn status(row: &SqliteRow) -> StoreResult<Status> {
    let name: String = get(row, "status")?;
    Status::from_name(&name).ok_or_else(|| StoreError::Damaged(format!("an analysis has the status '{name}'")))
}

pub(super) fn attempts(row: &SqliteRow) -> StoreResult<u32> {
    u32::try_from(unsigned(row, "attempts")?).map_err(|error| StoreError::Damaged(format!("column attempts: {error}")))
}

/// What the rules of [`crate::jobs`] look at.
pub(super) fn job(row: &SqliteRow) -> StoreResult<Job> {
    Ok(Job { status: status(row)?, attempts: attempts(row)?, cancel_requested: get(row, "cancel_requested")? })
}

/// How near a search is; the columns are null together.
pub(super) fn bracket(row: &SqliteRow) -> StoreResult<Option<Bracket>> {
    let Some(incumbent) = get(row, "incumbent_cost")? else { return Ok(None) };
    Ok(Some(Bracket { incumbent, bound: get(row, "lower_bound")?, index: unsigned(row, "incumbent_index")? }))
}

/// How far a computation is.
pub(super) fn progress(row: &SqliteRow) -> StoreResult<Progress> {
    Ok(Progress {
        phase: parsed(row, "phase")?,
        done: unsigned(row, "progress_done")?,
        total: unsigned(row, "progress_total")?,
        from: get(row, "phase_from")?,
        to: get(row, "phase_to")?,
        fraction: get(row, "fraction")?,
    })
}

impl Noun for AnalysisRecord {
    type Id = AnalysisId;
    const NAME: &'static str = "analysis";
    const TABLE: &'static str = "analyses";
    // Everything but the report, which can be large.
    const SELECT: &'static str = concat!(
        "SELECT n.id, n.study_id, n.kind, n.request, n.request_sha256, n.spec_sha256, n.status,
            n.attempts, n.cancel_requested, n.progress_done, n.progress_total, n.phase, n.phase_from, n.phase_to,
            n.fraction, n.incumbent_cost, n.incumbent_index, n.lower_bound, n.incumbent, n.eta_s, n.problem,
            n.version, n.created_at, n.started_at, n.finished_at, n.updated_at, ",
        used_trials!(),
        " AS uses FROM analyses n"
    );

    fn from_row(row: &SqliteRow) -> StoreResult<Self> {
        Ok(Self {
            id: parsed(row, "id")?,
            study: parsed_opt(row, "study_id")?,
            uses: json(row, "uses")?,
            kind: parsed(row, "kind")?,
            request: json_verified(row, "request", "request_sha256")?,
            spec_sha256: get(row, "spec_sha256")?,
            status: status(row)?,
            attempts: attempts(row)?,
            progress: progress(row)?,
            bracket: bracket(row)?,
            incumbent: json_opt(row, "incumbent")?,
            eta_s: get(row, "eta_s")?,
            cancel_requested: get(row, "cancel_requested")?,
            problem: json_opt(row, "problem")?,
            version: get(row, "version")?,
            created_at: time(row, "created_at")?,
            started_at: time_opt(row, "started_at")?,
            finished_at: time_opt(row, "finished_at")?,
            updated_at: time(row, "updated_at")?,
        })
    }

    fn id(&self) -> AnalysisId {
        self.id
    }

    fn version(&self) -> i64 {
        self.version
    }
}

/// The stored things that an analysis rests on: those that it names, and those of the analyses that it carries on from,
/// so that it is listed with them and erased with them.
pub(super) struct RestsOn {
    pub trials: Vec<String>,
    pub plants: Vec<String>,
}

/// What an analysis rests on; the earlier ones must be there.
pub(super) async fn rests_on(connection: &mut SqliteConnection, new: &NewAnalysis) -> StoreResult<RestsOn> {
    let mut all = RestsOn {
        trials: new.trials.iter().map(ToString::to_string).collect(),
        plants: new.plants.iter().map(ToString::to_string).collect(),
    };
    for analysis in &new.analyses {
        fetch::<AnalysisRecord>(connection, *analysis).await?;
        let id = analysis.to_string();
        all.trials.extend(linked(connection, TRIALS_OF, &id).await?);
        all.plants.extend(linked(connection, PLANTS_OF, &id).await?);
    }
    Ok(all)
}

/// The study of everything that an analysis rests on; `None` where that is nothing.
async fn common_study(
    connection: &mut SqliteConnection,
    new: &NewAnalysis,
    rests_on: &RestsOn,
) -> StoreResult<Option<String>> {
    let mut common = new.study.map(|study| study.to_string());
    let named = rests_on
        .trials
        .iter()
        .map(|id| ("trial", id, "SELECT study_id FROM trials WHERE id = $1"))
        .chain(rests_on.plants.iter().map(|id| ("plant", id, "SELECT study_id FROM plants WHERE id = $1")));
    for (noun, id, query) in named {
        let found: Option<String> = sqlx::query_scalar(query).bind(id).fetch_optional(&mut *connection).await?;
        let found = found.ok_or_else(|| StoreError::not_found(noun, id))?;
        match &common {
            Some(study) if *study != found => {
                let detail =
                    format!("the {noun} {id} is of the study {found}, not of {study}; an analysis is of one study");
                return Err(StoreError::Conflict { rule: "other_study", detail });
            }
            Some(_) => {}
            None => common = Some(found),
        }
    }
    Ok(common)
}

pub(super) async fn insert(
    connection: &mut SqliteConnection,
    new: &NewAnalysis,
    now: i64,
) -> StoreResult<AnalysisRecord> {
    if let Some(study) = new.study {
        must_exist(connection, study).await?;
    }
    let rests_on = rests_on(connection, new).await?;
    let study = common_study(connection, new, &rests_on).await?;
    let id = Uuid::now_v7().to_string();
    let request = to_json(&new.request)?;
    sqlx::query(concat!(
        "INSERT INTO analyses (id, study_id, kind, request, request_sha256, spec_sha256, status, available_at,
            created_at, updated_at, place)
         VALUES ($1, $2, $3, $4, $5, $6, 'queued', $7, $7, $7, ",
        end_of_line!("$2", "$3"),
        ")"
    ))
    .bind(&id)
    .bind(&study)
    .bind(new.kind.name())
    .bind(&request)
    .bind(sha256(&request))
    .bind(&new.spec_sha256)
    .bind(now)
    .execute(&mut *connection)
    .await?;
    let RestsOn { trials, plants } = rests_on;
    link(connection, &id, trials, "INSERT INTO analysis_trials (analysis_id, position, trial_id) VALUES ($1, $2, $3)")
        .await?;
    link(connection, &id, plants, "INSERT INTO analysis_plants (analysis_id, position, plant_id) VALUES ($1, $2, $3)")
        .await?;
    fetch(connection, &id).await
}

impl Make for AnalysisRecord {
    type New = NewAnalysis;

    // Looked for with everything else that it names.
    fn study(_: &NewAnalysis) -> Option<StudyId> {
        None
    }

    async fn insert(connection: &mut SqliteConnection, new: &NewAnalysis, now: i64) -> StoreResult<Self> {
        insert(connection, new, now).await
    }
}

async fn link(
    connection: &mut SqliteConnection,
    analysis: &str,
    named: Vec<String>,
    insert: &'static str,
) -> StoreResult<()> {
    let mut seen = std::collections::BTreeSet::new();
    for (position, id) in (0_i64..).zip(named.into_iter().filter(|id| seen.insert(id.clone()))) {
        sqlx::query(insert).bind(analysis).bind(position).bind(id).execute(&mut *connection).await?;
    }
    Ok(())
}

/// Counts for every status.
fn by_status(counts: &[(String, i64)]) -> Vec<(Status, u64)> {
    let count = |status: Status| {
        counts.iter().find(|(name, _)| name == status.name()).map_or(0, |(_, count)| count.unsigned_abs())
    };
    Status::ALL.into_iter().map(|status| (status, count(status))).collect()
}

impl Store {
    /// Queues an analysis. The request is canonical (defaults filled in); its references must exist (`NotFound` else)
    /// and be of one study, which becomes the analysis's where none is given.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (study, trial, plant), [`StoreError::Conflict`] (`other_study`,
    /// `idempotent_result_deleted`), [`StoreError::KeyReused`], the database's own.
    pub async fn create_analysis(
        &self,
        new: NewAnalysis,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Created<AnalysisRecord>> {
        let made = self.make(new, key).await?;
        if matches!(made, Created::New(_)) {
            self.announce_work();
        }
        Ok(made)
    }

    /// One analysis.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], the database's own.
    pub async fn analysis(&self, id: AnalysisId) -> StoreResult<AnalysisRecord> {
        self.read(id).await
    }

    /// A page of the analyses that match a filter.
    ///
    /// # Errors
    /// The database's own.
    pub async fn analyses(&self, filter: AnalysisFilter, page: Page) -> StoreResult<Vec<AnalysisRecord>> {
        self.page_of(&mut *self.readers()?.acquire().await?, &asked_for(&filter), page).await
    }

    /// A page of the analyses that match a filter, the newest first or last.
    ///
    /// # Errors
    /// The database's own.
    pub async fn listed_analyses(
        &self,
        filter: &AnalysisFilter,
        newest_first: bool,
        page: Page,
    ) -> StoreResult<Vec<AnalysisRecord>> {
        let order = Order { descending: newest_first, ..Order::CREATED };
        self.sorted_page(&mut *self.readers()?.acquire().await?, &asked_for(filter), order, page).await
    }

    /// Cancels a queued analysis at once, flags a running one, leaves a finished one as it is.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], the database's own.
    pub async fn request_cancel(&self, id: AnalysisId) -> StoreResult<AnalysisRecord> {
        let id = id.to_string();
        self.relieved(move |store| {
            let id = id.clone();
            async move { store.write_cancel(&id).await }
        })
        .await
    }

    async fn write_cancel(&self, id: &str) -> StoreResult<AnalysisRecord> {
        let mut tx = self.begin_relief().await?;
        let row = sqlx::query("SELECT status, attempts, cancel_requested FROM analyses WHERE id = $1")
            .bind(id)
            .fetch_optional(&mut *tx)
            .await?
            .ok_or_else(|| StoreError::not_found(AnalysisRecord::NAME, id))?;
        let before = job(&row)?;
        let after = before
            .apply(Event::RequestCancel)
            .map_err(|error| StoreError::Damaged(format!("analysis {id}: {error}")))?;
        if after != before {
            sqlx::query(
                "UPDATE analyses SET status = $2, cancel_requested = $3, finished_at = CASE WHEN $4 THEN $5 END,
                    version = version + 1, updated_at = $5
                 WHERE id = $1 AND status = $6",
            )
            .bind(id)
            .bind(after.status.name())
            .bind(after.cancel_requested)
            .bind(after.status.is_final())
            .bind(self.now_us())
            .bind(before.status.name())
            .execute(&mut *tx)
            .await?;
        }
        let record = fetch(&mut tx, id).await?;
        tx.commit().await?;
        Ok(record)
    }

    /// How many analyses there are in each status, zeros included.
    ///
    /// # Errors
    /// The database's own.
    pub async fn count_by_status(&self) -> StoreResult<Vec<(Status, u64)>> {
        let counts: Vec<(String, i64)> = sqlx::query_as(COUNTS).fetch_all(self.readers()?).await?;
        Ok(by_status(&counts))
    }

    /// How far the analyses of a study are that belong to a run.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (study), the database's own.
    pub async fn run_progress(&self, study: StudyId, run: &RunFilter) -> StoreResult<RunProgress> {
        let mut connection = self.readers()?.acquire().await?;
        must_exist(&mut connection, study).await?;
        let filter = of_run(study, run);
        let rows = filter.rows(&mut connection, run_counts(&filter), &[]).await?;
        let counts = rows.iter().map(|row| Ok((get(row, "status")?, get(row, "number")?)));
        let counts: Vec<(String, i64)> = counts.collect::<StoreResult<_>>()?;
        let rows = filter.rows(&mut connection, run_latest(&filter), &[Value::Integer(LATEST)]).await?;
        let took_us = rows.iter().map(|row| get::<i64>(row, "took_us"));
        let took_us: Vec<i64> = took_us.collect::<StoreResult<_>>()?;
        let latest_s = took_us.iter().map(|us| us.max(&0).unsigned_abs() as f64 * 1e-6).collect();
        Ok(RunProgress { counts: by_status(&counts), latest_s })
    }
}

/// Counts of everything, by status.
pub(super) const COUNTS: &str = "SELECT status, count(*) FROM analyses GROUP BY status";

/// Those that match a filter. One index has the rows in order of creation and everything else that is asked for; the
/// plus signs keep the database from another, which it would leave for each row.
pub(super) fn asked_for(filter: &AnalysisFilter) -> Filter {
    let AnalysisFilter { study, trial, kind, status } = filter;
    let study = study.map(|id| id.to_string());
    let (kind, status) = (kind.map(|kind| kind.name()), status.map(Status::name));
    if let Some(trial) = trial {
        let of_trial = "n.id IN (SELECT u.analysis_id FROM analysis_trials u WHERE u.trial_id = ?)";
        return Filter::default()
            .and(of_trial, Some(trial.to_string()))
            .and("+n.study_id = ?", study)
            .and("+n.kind = ?", kind)
            .and("+n.status = ?", status);
    }
    if study.is_some() {
        return Filter::default().and("n.study_id = ?", study).and("+n.kind = ?", kind).and("+n.status = ?", status);
    }
    if status.is_some() {
        return Filter::default().and("n.status = ?", status).and("+n.kind = ?", kind);
    }
    Filter::default().and("n.kind = ?", kind)
}

/// Those of a study that belong to a run.
pub(super) fn of_run(study: StudyId, run: &RunFilter) -> Filter {
    Filter::default()
        .and("n.study_id = ?", Some(study.to_string()))
        .and("n.kind = ?", run.kind.map(|kind| kind.name()))
        .and("n.spec_sha256 = ?", run.spec_sha256.as_deref())
}

/// How many of a run there are in each status.
pub(super) fn run_counts(filter: &Filter) -> String {
    filter.of("SELECT n.status, count(*) AS number FROM analyses n", &[], "GROUP BY n.status")
}

/// How long those of a run took that succeeded latest.
pub(super) fn run_latest(filter: &Filter) -> String {
    filter.of(
        "SELECT n.finished_at - n.started_at AS took_us FROM analyses n",
        &["n.status = 'succeeded'", "n.started_at IS NOT NULL"],
        "ORDER BY n.finished_at DESC LIMIT ?",
    )
}
