//! Files that were sent to be looked at before they are stored: bounded, and gone after a day.

use super::blocking::off_runtime;
use super::clock::span_us;
use super::error::{StoreError, StoreResult};
use super::nouns::{Make as _, Noun as _, fetch, must_exist};
use super::open::Store;
use super::records::{Created, NewSubject, NewTrial, Study, Subject, TrialRecord};
use super::rows::{get, json, parsed, parsed_opt, time, to_json};
use super::signals::Packed;
use super::trials::{keep, pack_all};
use crate::analysis::ids::{DraftId, StudyId, TrialId};
use serde_json::{Map, Value};
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use std::time::Duration;
use time::OffsetDateTime;
use uuid::Uuid;

/// How long a draft is kept.
const KEPT: Duration = Duration::from_secs(24 * 3600);

/// Drafts at most, and bytes of all their files; the oldest make room for new ones, since whoever sent them has the
/// files still.
const MOST: i64 = 50;
const MOST_BYTES: i64 = 256 << 20;

/// A file of a draft.
#[derive(Debug, Clone, PartialEq)]
pub struct DraftFile {
    /// Its name, as it came.
    pub name: String,
    /// Its bytes, as they came; empty once the trial is stored.
    pub data: Vec<u8>,
    /// What a person says of it.
    pub settings: Map<String, Value>,
    /// The trial that it became.
    pub trial: Option<TrialId>,
}

/// Files that were sent together.
#[derive(Debug, Clone, PartialEq)]
pub struct Draft {
    /// Its id.
    pub id: DraftId,
    /// The study that they are for.
    pub study: StudyId,
    /// When they came.
    pub created_at: OffsetDateTime,
    /// The files, in their order.
    pub files: Vec<DraftFile>,
}

/// A file of a draft that is stored as a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct DraftTrial {
    /// The place of the file in the draft, from 0.
    pub position: usize,
    /// The code of the person; made with this group where the study has nobody of that code.
    pub code: String,
    /// The group of a new person.
    pub group: Option<String>,
    /// The trial.
    pub new: NewTrial,
}

/// What became of a file of a draft.
#[derive(Debug, Clone, PartialEq)]
pub struct Drafted {
    /// The place of the file in the draft, from 0.
    pub position: usize,
    /// The trial that is stored.
    pub made: Created<TrialRecord>,
}

const NOUN: &str = "draft";

fn file(row: &SqliteRow) -> StoreResult<DraftFile> {
    Ok(DraftFile {
        name: get(row, "name")?,
        data: get(row, "data")?,
        settings: json(row, "settings")?,
        trial: parsed_opt(row, "trial_id")?,
    })
}

/// Deletes drafts whose time is over, and the oldest ones where there is no room for so many bytes more.
async fn make_room(connection: &mut SqliteConnection, now: i64, bytes: i64) -> StoreResult<()> {
    sqlx::query("DELETE FROM upload_drafts WHERE created_at < $1")
        .bind(now.saturating_sub(span_us(KEPT.as_secs_f64())))
        .execute(&mut *connection)
        .await?;
    loop {
        let (drafts, held): (i64, i64) = sqlx::query_as(
            "SELECT (SELECT count(*) FROM upload_drafts), (SELECT coalesce(sum(length(data)), 0) FROM upload_files)",
        )
        .fetch_one(&mut *connection)
        .await?;
        if drafts == 0 || (drafts < MOST && held.saturating_add(bytes) <= MOST_BYTES) {
            return Ok(());
        }
        sqlx::query(
            "DELETE FROM upload_drafts WHERE id = (SELECT id FROM upload_drafts ORDER BY created_at, id LIMIT 1)",
        )
        .execute(&mut *connection)
        .await?;
    }
}

/// Which file is whose.
struct Whose {
    position: usize,
    code: String,
    group: Option<String>,
}

/// The subject with this code, made where there is none.
async fn subject(connection: &mut SqliteConnection, study: StudyId, own: &Whose, now: i64) -> StoreResult<String> {
    let known: Option<String> = sqlx::query_scalar("SELECT id FROM subjects WHERE study_id = $1 AND code = $2")
        .bind(study.to_string())
        .bind(&own.code)
        .fetch_optional(&mut *connection)
        .await?;
    if let Some(id) = known {
        return Ok(id);
    }
    let new = NewSubject { code: own.code.clone(), group: own.group.clone(), attributes: Value::Object(Map::new()) };
    Ok(Subject::insert(connection, &(study, new), now).await?.id().to_string())
}

impl Store {
    /// Keeps files, by name, to be looked at.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (study), the database's own.
    pub async fn create_draft(&self, study: StudyId, files: Vec<(String, Vec<u8>)>) -> StoreResult<DraftId> {
        let store = self.clone();
        self.uninterrupted(async move {
            let bytes = files.iter().map(|(_, data)| data.len() as i64).sum();
            let mut tx = store.begin().await?;
            must_exist(&mut tx, study).await?;
            let now = store.now_us();
            make_room(&mut tx, now, bytes).await?;
            let id = DraftId(Uuid::now_v7());
            sqlx::query("INSERT INTO upload_drafts (id, study_id, created_at) VALUES ($1, $2, $3)")
                .bind(id.to_string())
                .bind(study.to_string())
                .bind(now)
                .execute(&mut *tx)
                .await?;
            for (position, (name, data)) in files.into_iter().enumerate() {
                sqlx::query("INSERT INTO upload_files (draft_id, position, name, data) VALUES ($1, $2, $3, $4)")
                    .bind(id.to_string())
                    .bind(i64::try_from(position).unwrap_or_default())
                    .bind(name)
                    .bind(data)
                    .execute(&mut *tx)
                    .await?;
            }
            tx.commit().await?;
            Ok(id)
        })
        .await
    }

    /// A draft with its files.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], also where its time is over; the database's own.
    pub async fn draft(&self, id: DraftId) -> StoreResult<Draft> {
        let mut tx = self.snapshot().await?;
        let row = sqlx::query("SELECT study_id, created_at FROM upload_drafts WHERE id = $1 AND created_at >= $2")
            .bind(id.to_string())
            .bind(self.now_us().saturating_sub(span_us(KEPT.as_secs_f64())))
            .fetch_optional(&mut *tx)
            .await?
            .ok_or_else(|| StoreError::not_found(NOUN, id))?;
        let files = sqlx::query("SELECT * FROM upload_files WHERE draft_id = $1 ORDER BY position")
            .bind(id.to_string())
            .fetch_all(&mut *tx)
            .await?;
        Ok(Draft {
            id,
            study: parsed(&row, "study_id")?,
            created_at: time(&row, "created_at")?,
            files: files.iter().map(file).collect::<StoreResult<_>>()?,
        })
    }

    /// Keeps what a person says of the files of a draft, one for each.
    ///
    /// # Errors
    /// The database's own; a draft that is gone has no files to change.
    pub async fn describe_draft(&self, id: DraftId, settings: Vec<Map<String, Value>>) -> StoreResult<()> {
        let store = self.clone();
        self.uninterrupted(async move {
            let mut tx = store.begin().await?;
            for (position, own) in settings.iter().enumerate() {
                sqlx::query("UPDATE upload_files SET settings = $3 WHERE draft_id = $1 AND position = $2")
                    .bind(id.to_string())
                    .bind(i64::try_from(position).unwrap_or_default())
                    .bind(to_json(own)?)
                    .execute(&mut *tx)
                    .await?;
            }
            Ok(tx.commit().await?)
        })
        .await
    }

    /// Stores files of a draft as trials, all of them or none, with the people that the study does not have yet. The
    /// others stay in the draft.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (draft, plant), [`StoreError::Conflict`] (`trial_number_taken`),
    /// [`StoreError::Damaged`]
    /// where a hash given is not that of the content, the database's own.
    pub async fn store_draft(&self, id: DraftId, trials: Vec<DraftTrial>) -> StoreResult<Vec<Drafted>> {
        let apart = |DraftTrial { position, code, group, new }| (Whose { position, code, group }, new);
        let (whose, new): (Vec<Whose>, Vec<NewTrial>) = trials.into_iter().map(apart).unzip();
        let packed = off_runtime(move || pack_all(new)).await?;
        let store = self.clone();
        self.uninterrupted(async move { store.write_draft(id, &whose, &packed).await }).await
    }

    async fn write_draft(
        &self,
        id: DraftId,
        whose: &[Whose],
        packed: &[(NewTrial, Vec<Packed>)],
    ) -> StoreResult<Vec<Drafted>> {
        let mut tx = self.begin().await?;
        let study: Option<String> = sqlx::query_scalar("SELECT study_id FROM upload_drafts WHERE id = $1")
            .bind(id.to_string())
            .fetch_optional(&mut *tx)
            .await?;
        let study = study.ok_or_else(|| StoreError::not_found(NOUN, id))?;
        let of: StudyId = study.parse().map_err(|_| StoreError::Damaged(format!("draft {id} names no study")))?;
        fetch::<Study>(&mut tx, &study).await?;
        let now = self.now_us();
        let mut outcome = Vec::with_capacity(packed.len());
        for (own, one) in whose.iter().zip(packed) {
            let subject = subject(&mut tx, of, own, now).await?;
            let made = keep(&mut tx, &subject, &study, one, now).await?;
            sqlx::query("UPDATE upload_files SET trial_id = $3, data = x'' WHERE draft_id = $1 AND position = $2")
                .bind(id.to_string())
                .bind(i64::try_from(own.position).unwrap_or_default())
                .bind(made.get().id.to_string())
                .execute(&mut *tx)
                .await?;
            outcome.push(Drafted { position: own.position, made });
        }
        tx.commit().await?;
        Ok(outcome)
    }

    /// Deletes a draft.
    ///
    /// # Errors
    /// The database's own.
    pub async fn discard_draft(&self, id: DraftId) -> StoreResult<()> {
        self.relieved(move |store| async move {
            let mut tx = store.begin_relief().await?;
            sqlx::query("DELETE FROM upload_drafts WHERE id = $1").bind(id.to_string()).execute(&mut *tx).await?;
            Ok(tx.commit().await?)
        })
        .await
    }

    /// Deletes drafts whose time is over.
    pub(super) async fn expire_drafts(&self) -> StoreResult<()> {
        let store = self.clone();
        self.uninterrupted(async move {
            let mut tx = store.begin_relief().await?;
            make_room(&mut tx, store.now_us(), 0).await?;
            Ok(tx.commit().await?)
        })
        .await
    }
}
