//! A study as it is, row by row, out of one database and into another with the same ids.
//!
//! Rows are taken with every column that the table has, so that a column that is added later goes along; left out is
//! only what belongs to this database alone: leases, places in the queue, and what is computed from a report. Columns
//! of a file are held against the table's own before they stand in a statement.

use super::blocking::off_runtime;
use super::error::{StoreError, StoreResult};
use super::nouns::fetch;
use super::open::Store;
use super::records::{Study, TrialRecord};
use super::rows::{get, sha256};
use super::signals::pack;
use super::used::{PLANTS_OF, TRIALS_OF, linked};
use crate::analysis::Report;
use crate::analysis::ids::{AnalysisId, StudyId, TrialId};
use crate::trial::Trial;
use serde_json::{Map, Value};
use sqlx::sqlite::SqliteRow;
use sqlx::{AssertSqlSafe, Column as _, Row as _, Sqlite, SqliteConnection, Transaction, TypeInfo as _, ValueRef as _};

/// A row: column by column, numbers as numbers and text as text.
pub type StoredRow = Map<String, Value>;

/// A table of a study's rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StudyTable {
    /// The study itself.
    Studies,
    /// Its plants.
    Plants,
    /// Its subjects.
    Subjects,
    /// Its trials, without their signals.
    Trials,
}

impl StudyTable {
    /// All of them, each after those that it refers to.
    pub const ALL: [Self; 4] = [Self::Studies, Self::Plants, Self::Subjects, Self::Trials];

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Studies => "studies",
            Self::Plants => "plants",
            Self::Subjects => "subjects",
            Self::Trials => "trials",
        }
    }

    fn of_study(self) -> &'static str {
        if self == Self::Studies { "id" } else { "study_id" }
    }
}

/// Columns of analyses that belong to one database: who computes, who waits, what is computed from the report.
const OWN: [&str; 12] = [
    "report",
    "lease_token",
    "lease_expires_at",
    "lease_us",
    "beat",
    "worker",
    "place",
    "wait_us",
    "available_at",
    "progress_at",
    "phase_began_at",
    "trust_rule",
];

/// An analysis that came to an end.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredAnalysis {
    /// Its row, without the report.
    pub row: StoredRow,
    /// Its trials, in their order.
    pub trials: Vec<String>,
    /// Its plants, in their order.
    pub plants: Vec<String>,
    /// The report's bytes, where it succeeded.
    pub report: Option<String>,
}

impl StoredAnalysis {
    /// Its id.
    #[must_use]
    pub fn id(&self) -> &str {
        self.row.get("id").and_then(Value::as_str).unwrap_or_default()
    }
}

fn raw(row: &SqliteRow, without: &[&str]) -> StoreResult<StoredRow> {
    let mut found = Map::new();
    for (i, column) in row.columns().iter().enumerate().filter(|(_, column)| !without.contains(&column.name())) {
        let value = row.try_get_raw(i)?;
        let value = if value.is_null() {
            Value::Null
        } else {
            match value.type_info().name() {
                "INTEGER" => row.try_get::<i64, _>(i)?.into(),
                "REAL" => row.try_get::<f64, _>(i)?.into(),
                _ => row.try_get::<String, _>(i)?.into(),
            }
        };
        found.insert(column.name().to_owned(), value);
    }
    Ok(found)
}

impl Store {
    /// The rows of a study in one table, in the order in which they were made.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (study), the database's own.
    pub async fn stored_rows(&self, study: StudyId, table: StudyTable) -> StoreResult<Vec<StoredRow>> {
        let mut tx = self.snapshot().await?;
        fetch::<Study>(&mut tx, study).await?;
        let select = format!("SELECT * FROM {} WHERE {} = $1 ORDER BY id", table.name(), table.of_study());
        let rows = sqlx::query(AssertSqlSafe(select)).bind(study.to_string()).fetch_all(&mut *tx).await?;
        rows.iter().map(|row| raw(row, &[])).collect()
    }

    /// The analyses of a study that came to an end, in the order in which they were asked for, behind `after`, so many
    /// at most; each report's hash verified.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], the database's own.
    pub async fn stored_analyses(
        &self,
        study: StudyId,
        after: Option<&str>,
        limit: u32,
    ) -> StoreResult<Vec<StoredAnalysis>> {
        let mut tx = self.snapshot().await?;
        let rows = sqlx::query(
            "SELECT * FROM analyses WHERE study_id = $1 AND id > $2
                AND status IN ('succeeded', 'failed', 'cancelled') ORDER BY id LIMIT $3",
        )
        .bind(study.to_string())
        .bind(after.unwrap_or_default())
        .bind(limit)
        .fetch_all(&mut *tx)
        .await?;
        let mut found = Vec::with_capacity(rows.len());
        for row in &rows {
            let id: String = get(row, "id")?;
            found.push(StoredAnalysis {
                row: raw(row, &OWN)?,
                trials: linked(&mut tx, TRIALS_OF, &id).await?,
                plants: linked(&mut tx, PLANTS_OF, &id).await?,
                report: super::reports::verified(row)?,
            });
        }
        Ok(found)
    }

    /// Begins to take in a study: everything or, where that is not finished, nothing.
    ///
    /// # Errors
    /// The database's own.
    pub async fn take_in(&self) -> StoreResult<TakingIn> {
        Ok(TakingIn { tx: self.begin().await?, now: self.now_us() })
    }
}

/// A study that is being taken in; nobody else writes meanwhile.
pub struct TakingIn {
    tx: Transaction<'static, Sqlite>,
    now: i64,
}

fn foreign(table: &str, column: &str) -> StoreError {
    StoreError::Damaged(format!("the table {table} has no column '{column}' here: a newer program wrote it"))
}

/// Inserts a row, with `more` that the file does not have.
async fn insert(
    connection: &mut SqliteConnection,
    table: &'static str,
    row: &StoredRow,
    more: &[(&'static str, Value)],
) -> StoreResult<()> {
    let known: Vec<String> =
        sqlx::query_scalar("SELECT name FROM pragma_table_info($1)").bind(table).fetch_all(&mut *connection).await?;
    if let Some(column) = row.keys().find(|column| !known.contains(column)) {
        return Err(foreign(table, column));
    }
    let names: Vec<&str> = row.keys().map(String::as_str).chain(more.iter().map(|(name, _)| *name)).collect();
    let places: Vec<String> = (1..=names.len()).map(|i| format!("${i}")).collect();
    let text = format!("INSERT INTO {table} ({}) VALUES ({})", names.join(", "), places.join(", "));
    let mut query = sqlx::query(AssertSqlSafe(text));
    for value in row.values().chain(more.iter().map(|(_, value)| value)) {
        query = match value {
            Value::Null => query.bind(None::<String>),
            Value::String(text) => query.bind(text.clone()),
            Value::Number(number) if number.is_i64() => query.bind(number.as_i64()),
            Value::Number(number) => query.bind(number.as_f64()),
            other => return Err(StoreError::Damaged(format!("a row of {table} holds {other}"))),
        };
    }
    query.execute(connection).await?;
    Ok(())
}

impl TakingIn {
    /// Takes in a row of a table; those that it refers to before it.
    ///
    /// # Errors
    /// [`StoreError::Conflict`] (`study_there`) where the study is there already, [`StoreError::Damaged`] for a column
    /// that is not known here, the database's own.
    pub async fn row(&mut self, table: StudyTable, row: &StoredRow) -> StoreResult<()> {
        if table == StudyTable::Studies {
            let id = row.get("id").and_then(Value::as_str).unwrap_or_default();
            let there: Option<String> = sqlx::query_scalar("SELECT name FROM studies WHERE id = $1")
                .bind(id)
                .fetch_optional(&mut *self.tx)
                .await?;
            if let Some(name) = there {
                let detail = format!("the study {id} ({name:?}) is in this database already");
                return Err(StoreError::Conflict { rule: "study_there", detail });
            }
        }
        insert(&mut self.tx, table.name(), row, &[]).await
    }

    /// Takes in the recording of a trial whose row was taken in: its content must have the hash of the row.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] where it is another recording, the database's own.
    pub async fn signals(&mut self, id: TrialId, trial: Trial) -> StoreResult<()> {
        let record: TrialRecord = fetch(&mut self.tx, id).await?;
        let packed = off_runtime(move || {
            let found = crate::num::hexadecimal::hexadecimal(&trial.content_sha256());
            if found != record.sha256 {
                let why = format!("the recording of trial {id} has the hash {found}, not {}", record.sha256);
                return Err(StoreError::Damaged(why));
            }
            pack(&trial)
        })
        .await?;
        for column in packed {
            sqlx::query(
                "INSERT INTO trial_signals (trial_id, channel, codec, samples, sha256, data)
                 VALUES ($1, $2, $3, $4, $5, $6)",
            )
            .bind(id.to_string())
            .bind(&column.channel)
            .bind(&column.codec)
            .bind(column.samples)
            .bind(&column.sha256)
            .bind(&column.data)
            .execute(&mut *self.tx)
            .await?;
        }
        Ok(())
    }

    /// Takes in an analysis after everything that it refers to, and judges its report anew.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] where the report is not the one of the row, the database's own.
    pub async fn analysis(&mut self, own: &StoredAnalysis) -> StoreResult<()> {
        let id = own.id().to_owned();
        let damaged = |why: String| StoreError::Damaged(format!("analysis {id}: {why}"));
        let stored = own.row.get("report_sha256").and_then(Value::as_str);
        let found = own.report.as_deref().map(sha256);
        if stored != found.as_deref() {
            return Err(damaged(format!("its report has the hash {found:?}, not {stored:?}")));
        }
        let report: Option<Report> = match &own.report {
            Some(text) => Some(serde_json::from_str(text).map_err(|error| damaged(format!("its report: {error}")))?),
            None => None,
        };
        let more =
            [("report", own.report.clone().map_or(Value::Null, Value::String)), ("available_at", self.now.into())];
        insert(&mut self.tx, "analyses", &own.row, &more).await?;
        let tables = [("analysis_trials", "trial_id", &own.trials), ("analysis_plants", "plant_id", &own.plants)];
        for (table, column, ids) in tables {
            for (position, named) in (0_i64..).zip(ids) {
                let text = format!("INSERT INTO {table} (analysis_id, position, {column}) VALUES ($1, $2, $3)");
                sqlx::query(AssertSqlSafe(text)).bind(&id).bind(position).bind(named).execute(&mut *self.tx).await?;
            }
        }
        if let Some(report) = &report {
            let id: AnalysisId = id.parse().map_err(|_| damaged("its id is none".to_owned()))?;
            super::trust::write(&mut self.tx, id, report).await?;
        }
        Ok(())
    }

    /// Ends it: everything is there.
    ///
    /// # Errors
    /// The database's own.
    pub async fn finish(self) -> StoreResult<()> {
        Ok(self.tx.commit().await?)
    }
}
