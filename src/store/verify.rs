//! Looking a whole database over: its pages, its references, and every hash in it.

use super::blocking::off_runtime;
use super::error::{StoreError, StoreResult, primary_code};
use super::library::columns;
use super::migrate::{APPLICATION_ID, newest_step, step};
use super::nouns::Noun;
use super::open::Store;
use super::records::{AnalysisRecord, Plant, Study, Subject, TrialRecord};
use super::reports::verified;
use super::signals::unpack;
use sqlx::sqlite::{SqliteConnectOptions, SqliteRow};
use sqlx::{AssertSqlSafe, Connection as _, Row as _, SqliteConnection};
use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;
use std::time::Duration;

/// Rows read at once.
const AT_ONCE: i64 = 100;

/// Reports and recordings are large.
const LARGE_AT_ONCE: i64 = 4;

/// A row that is damaged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What it is: `study`, `plant`, `subject`, `trial`, `analysis`.
    pub noun: &'static str,
    /// Its id.
    pub id: String,
    /// What is wrong with it.
    pub why: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { noun, id, why } = self;
        write!(f, "{noun} {id}: {why}")
    }
}

/// What was found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Verified {
    /// The last step of the schema.
    pub step: i64,
    /// Rows of each sort.
    pub rows: BTreeMap<String, u64>,
    /// What is wrong with the pages of the file.
    pub pages: Vec<String>,
    /// Rows that refer to none.
    pub references: Vec<String>,
    /// Rows that are damaged.
    pub findings: Vec<Finding>,
}

impl Verified {
    /// Whether everything is in order.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.pages.is_empty() && self.references.is_empty() && self.findings.is_empty()
    }
}

/// Looks a database file over, without changing it: the integrity of its pages, its references, and every row with
/// every hash: models, metrics, requests, reports and what is kept of them, each column of each recording and the
/// recording as a whole.
///
/// # Errors
/// [`StoreError::CannotOpen`] where it is no database of this program, or of another step of its schema.
pub async fn verify_file(file: &Path) -> StoreResult<Verified> {
    let cannot = |reason: String| StoreError::CannotOpen { path: file.display().to_string(), reason };
    let options = SqliteConnectOptions::new().filename(file).read_only(true).busy_timeout(Duration::from_secs(10));
    let explained = |error: StoreError| super::migrate::explain(file, error);
    let mut connection =
        SqliteConnection::connect_with(&options).await.map_err(|error| explained(StoreError::from(error)))?;
    let application: i64 = sqlx::query_scalar("PRAGMA application_id")
        .fetch_one(&mut connection)
        .await
        .map_err(|e| explained(e.into()))?;
    if application != APPLICATION_ID {
        return Err(cannot("it is not a database of this program".to_owned()));
    }
    let step = step(&mut connection).await.map_err(explained)?;
    if step != newest_step() {
        return Err(cannot(format!(
            "its schema has step {step}, and this program looks over step {}; let it bring a copy up to date first",
            newest_step()
        )));
    }
    let mut verified = Verified { step, ..Verified::default() };
    // Pages that are damaged may end any of these; the others may still say something.
    let looked = verified.look_at_pages(&mut connection).await;
    verified.unless_broken(looked)?;
    let looked = verified.look::<Study>(&mut connection).await;
    verified.unless_broken(looked)?;
    let looked = verified.look::<Plant>(&mut connection).await;
    verified.unless_broken(looked)?;
    let looked = verified.look::<Subject>(&mut connection).await;
    verified.unless_broken(looked)?;
    let looked = verified.look::<TrialRecord>(&mut connection).await;
    verified.unless_broken(looked)?;
    let looked = verified.look::<AnalysisRecord>(&mut connection).await;
    verified.unless_broken(looked)?;
    let looked = verified.look_at_recordings(&mut connection).await;
    verified.unless_broken(looked)?;
    let looked = verified.look_at_reports(&mut connection).await;
    verified.unless_broken(looked)?;
    let looked = verified.look_at_estimates(&mut connection).await;
    verified.unless_broken(looked)?;
    connection.close().await?;
    Ok(verified)
}

impl Verified {
    fn note(&mut self, noun: &'static str, id: &str, why: String) {
        // One line for a row; the first is what was looked at first.
        if !self.findings.iter().any(|finding| finding.noun == noun && finding.id == id) {
            self.findings.push(Finding { noun, id: id.to_owned(), why });
        }
    }

    /// Keeps what is wrong with a row; a database that fails is another matter.
    fn take(&mut self, noun: &'static str, id: &str, outcome: StoreResult<()>) -> StoreResult<()> {
        match outcome {
            Err(StoreError::Damaged(why)) => {
                self.note(noun, id, why);
                Ok(())
            }
            other => other,
        }
    }

    /// Keeps what is wrong with the pages of the file.
    fn unless_broken(&mut self, outcome: StoreResult<()>) -> StoreResult<()> {
        match outcome {
            Err(StoreError::Database(sqlx::Error::Database(error)))
                if matches!(primary_code(error.as_ref()), Some(11 | 26)) =>
            {
                self.pages.push(error.to_string());
                Ok(())
            }
            other => other,
        }
    }

    async fn look_at_pages(&mut self, connection: &mut SqliteConnection) -> StoreResult<()> {
        let pages: Vec<String> = sqlx::query_scalar("PRAGMA integrity_check").fetch_all(&mut *connection).await?;
        self.pages.extend(pages.into_iter().filter(|line| line != "ok"));
        for row in sqlx::query("PRAGMA foreign_key_check").fetch_all(connection).await? {
            let (table, parent): (String, String) = (row.try_get(0)?, row.try_get(2)?);
            let rowid: Option<i64> = row.try_get(1)?;
            self.references.push(format!("row {} of {table} refers to none of {parent}", rowid.unwrap_or_default()));
        }
        Ok(())
    }

    async fn look<N: Noun>(&mut self, connection: &mut SqliteConnection) -> StoreResult<()> {
        let sql = format!("{} WHERE n.id > $1 ORDER BY n.id LIMIT $2", N::SELECT);
        let mut after = String::new();
        let mut many = 0;
        loop {
            let query = sqlx::query(AssertSqlSafe(sql.clone())).bind(&after).bind(AT_ONCE);
            let rows = query.fetch_all(&mut *connection).await?;
            for row in &rows {
                after = row.try_get("id")?;
                self.take(N::NAME, &after, N::from_row(row).map(drop))?;
            }
            many += rows.len() as u64;
            if (rows.len() as i64) < AT_ONCE {
                self.rows.insert(N::TABLE.to_owned(), many);
                return Ok(());
            }
        }
    }

    async fn look_at_recordings(&mut self, connection: &mut SqliteConnection) -> StoreResult<()> {
        let mut after = String::new();
        loop {
            let rows =
                sqlx::query("SELECT id, sample_time_s, samples, sha256 FROM trials WHERE id > $1 ORDER BY id LIMIT $2")
                    .bind(&after)
                    .bind(LARGE_AT_ONCE)
                    .fetch_all(&mut *connection)
                    .await?;
            for row in &rows {
                after = row.try_get("id")?;
                let outcome = recording(connection, &after, row).await;
                self.take(TrialRecord::NAME, &after, outcome)?;
            }
            if (rows.len() as i64) < LARGE_AT_ONCE {
                return Ok(());
            }
        }
    }

    async fn look_at_reports(&mut self, connection: &mut SqliteConnection) -> StoreResult<()> {
        let mut after = String::new();
        loop {
            let rows = sqlx::query(
                "SELECT id, report, report_sha256 FROM analyses
                 WHERE status = 'succeeded' AND id > $1 ORDER BY id LIMIT $2",
            )
            .bind(&after)
            .bind(LARGE_AT_ONCE)
            .fetch_all(&mut *connection)
            .await?;
            for row in &rows {
                after = row.try_get("id")?;
                self.take(AnalysisRecord::NAME, &after, verified(row).map(drop))?;
            }
            if (rows.len() as i64) < LARGE_AT_ONCE {
                return Ok(());
            }
        }
    }
}

impl Verified {
    /// What is kept of reports beside them.
    async fn look_at_estimates(&mut self, connection: &mut SqliteConnection) -> StoreResult<()> {
        let mut after = String::new();
        loop {
            // All rows of so many analyses: pages end between two.
            let rows = sqlx::query(
                "SELECT analysis_id AS id, estimate, sha256 FROM analysis_estimates WHERE analysis_id IN
                    (SELECT DISTINCT analysis_id FROM analysis_estimates WHERE analysis_id > $1
                     ORDER BY analysis_id LIMIT $2)
                 ORDER BY analysis_id",
            )
            .bind(&after)
            .bind(AT_ONCE)
            .fetch_all(&mut *connection)
            .await?;
            let Some(last) = rows.last() else { return Ok(()) };
            for row in &rows {
                let id: String = row.try_get("id")?;
                self.take(AnalysisRecord::NAME, &id, super::estimates::verified(row).map(drop))?;
            }
            after = last.try_get("id")?;
        }
    }
}

async fn recording(connection: &mut SqliteConnection, id: &str, row: &SqliteRow) -> StoreResult<()> {
    let (id, sample_time_s, sha256) = (id.to_owned(), row.try_get("sample_time_s")?, row.try_get("sha256")?);
    let (samples, sha256): (i64, String) = (row.try_get("samples")?, sha256);
    let columns = columns(connection, &id).await?;
    off_runtime(move || {
        let trial = unpack(&id, sample_time_s, &sha256, &columns)?;
        if trial.samples() as u64 == samples.unsigned_abs() {
            return Ok(());
        }
        Err(StoreError::Damaged(format!("trial {id}: it has {} samples, not {samples}", trial.samples())))
    })
    .await
}

impl Store {
    /// Keeps the list of damaged rows that a verification of this database made; an earlier list goes.
    ///
    /// # Errors
    /// The database's own.
    pub async fn quarantine(&self, findings: &[Finding]) -> StoreResult<()> {
        let (store, findings) = (self.clone(), findings.to_vec());
        self.uninterrupted(async move {
            let mut tx = store.begin_relief().await?;
            sqlx::query("DELETE FROM quarantine").execute(&mut *tx).await?;
            for Finding { noun, id, why } in &findings {
                sqlx::query("INSERT INTO quarantine (noun, row_id, why, found_at) VALUES ($1, $2, $3, $4)")
                    .bind(noun)
                    .bind(id)
                    .bind(why)
                    .bind(store.now_us())
                    .execute(&mut *tx)
                    .await?;
            }
            Ok(tx.commit().await?)
        })
        .await
    }
}
