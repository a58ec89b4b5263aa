//! Subjects of a study.

use super::error::{StoreError, StoreResult, breaks_unique};
use super::idempotency::{or_deleted, remember, replay};
use super::open::Store;
use super::records::{Created, IdempotencyKey, NewSubject, Page, Subject, SubjectPatch};
use super::rows::{get, json, parsed, time, to_json};
use super::studies::{missed, must_exist};
use crate::analysis::ids::{StudyId, SubjectId};
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

const NOUN: &str = "subject";
const EXISTS: &str = "SELECT 1 FROM subjects WHERE id = $1";

fn subject(row: &SqliteRow) -> StoreResult<Subject> {
    Ok(Subject {
        id: parsed(row, "id")?,
        study: parsed(row, "study_id")?,
        code: get(row, "code")?,
        group: get(row, "group_name")?,
        attributes: json(row, "attributes")?,
        version: get(row, "version")?,
        created_at: time(row, "created_at")?,
        updated_at: time(row, "updated_at")?,
    })
}

pub(super) async fn fetch(connection: &mut SqliteConnection, id: &str) -> StoreResult<Subject> {
    let row = sqlx::query("SELECT * FROM subjects WHERE id = $1").bind(id).fetch_optional(connection).await?;
    subject(&row.ok_or_else(|| StoreError::not_found(NOUN, id))?)
}

fn code_taken(error: sqlx::Error, code: &str) -> StoreError {
    if breaks_unique(&error, &["subjects.study_id, subjects.code"]) {
        let detail = format!("the study has a subject with the code '{code}' already");
        return StoreError::Conflict { rule: "subject_code_taken", detail };
    }
    error.into()
}

impl Store {
    /// Stores a subject.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (study), [`StoreError::Conflict`] (`subject_code_taken`, `idempotent_result_deleted`),
    /// [`StoreError::KeyReused`], the database's own.
    pub async fn create_subject(
        &self,
        study: StudyId,
        new: NewSubject,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Created<Subject>> {
        let scope = format!("studies/{study}/subjects");
        let mut tx = self.begin().await?;
        must_exist(&mut tx, study).await?;
        if let Some(ids) = replay(&mut tx, &scope, key).await? {
            return or_deleted(fetch(&mut tx, &ids.concat()).await).map(Created::Replayed);
        }
        let (id, now) = (Uuid::now_v7().to_string(), self.now_us());
        let row = sqlx::query(
            "INSERT INTO subjects (id, study_id, code, group_name, attributes, created_at, updated_at)
             VALUES ($1, $2, $3, $4, $5, $6, $6) RETURNING *",
        )
        .bind(&id)
        .bind(study.to_string())
        .bind(&new.code)
        .bind(&new.group)
        .bind(to_json(&new.attributes)?)
        .bind(now)
        .fetch_one(&mut *tx)
        .await
        .map_err(|error| code_taken(error, &new.code))?;
        remember(&mut tx, &scope, key, &[id], now).await?;
        tx.commit().await?;
        subject(&row).map(Created::New)
    }

    /// One subject.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], the database's own.
    pub async fn subject(&self, id: SubjectId) -> StoreResult<Subject> {
        fetch(&mut *self.readers().acquire().await?, &id.to_string()).await
    }

    /// A page of a study's subjects, of one group where `group` is given.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (study), the database's own.
    pub async fn subjects(&self, study: StudyId, group: Option<&str>, page: Page) -> StoreResult<Vec<Subject>> {
        let mut tx = self.snapshot().await?;
        must_exist(&mut tx, study).await?;
        let rows = sqlx::query(
            "SELECT * FROM subjects WHERE study_id = $1 AND id > $2 AND ($3 IS NULL OR group_name = $3)
             ORDER BY id LIMIT $4",
        )
        .bind(study.to_string())
        .bind(page.after_id())
        .bind(group)
        .bind(page.limit)
        .fetch_all(&mut *tx)
        .await?;
        rows.iter().map(subject).collect()
    }

    /// Changes a subject.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Stale`], [`StoreError::Conflict`] (`subject_code_taken`), the database's own.
    pub async fn patch_subject(
        &self,
        id: SubjectId,
        patch: SubjectPatch,
        if_match: Option<i64>,
    ) -> StoreResult<Subject> {
        let id = id.to_string();
        // The old code or attributes may be what must be forgotten, so a patch is scrubbed like a deletion.
        let store = self.clone();
        self.delete(async move {
            let mut tx = store.begin_erasing().await?;
            let before = fetch(&mut tx, &id).await?;
            if if_match.is_some_and(|version| version != before.version) {
                return Err(StoreError::Stale { noun: NOUN });
            }
            if patch == SubjectPatch::default() {
                return Ok(before);
            }
            let row = sqlx::query(
                "UPDATE subjects SET code = COALESCE($2, code),
                    group_name = CASE WHEN $3 THEN $4 ELSE group_name END,
                    attributes = COALESCE($5, attributes), version = version + 1, updated_at = $6
                 WHERE id = $1 AND version = $7 RETURNING *",
            )
            .bind(&id)
            .bind(&patch.code)
            .bind(patch.group.is_some())
            .bind(patch.group.clone().flatten())
            .bind(patch.attributes.as_ref().map(to_json).transpose()?)
            .bind(store.now_us())
            .bind(before.version)
            .fetch_optional(&mut *tx)
            .await
            .map_err(|error| code_taken(error, patch.code.as_deref().unwrap_or_default()))?;
            let after = subject(&row.ok_or(StoreError::Stale { noun: NOUN })?)?;
            tx.commit().await?;
            Ok(after)
        })
        .await
    }

    /// Deletes a subject with its trials and the analyses that used them, and overwrites what they held.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Stale`], the database's own.
    pub async fn delete_subject(&self, id: SubjectId, if_match: Option<i64>) -> StoreResult<()> {
        let (store, id) = (self.clone(), id.to_string());
        self.delete(async move {
            let mut tx = store.begin_erasing().await?;
            let gone = sqlx::query("DELETE FROM subjects WHERE id = $1 AND ($2 IS NULL OR version = $2)")
                .bind(&id)
                .bind(if_match)
                .execute(&mut *tx)
                .await?;
            if gone.rows_affected() == 0 {
                return Err(missed(&mut tx, NOUN, EXISTS, &id).await?);
            }
            Ok(tx.commit().await?)
        })
        .await
    }
}
