//! Studies.

use super::error::{StoreError, StoreResult};
use super::idempotency::{or_deleted, remember, replay};
use super::open::Store;
use super::records::{Created, IdempotencyKey, NewStudy, Page, Study, StudyPatch};
use super::rows::{get, parsed, time};
use crate::analysis::ids::StudyId;
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

const NOUN: &str = "study";

fn study(row: &SqliteRow) -> StoreResult<Study> {
    Ok(Study {
        id: parsed(row, "id")?,
        name: get(row, "name")?,
        description: get(row, "description")?,
        display_limit: get(row, "display_limit")?,
        version: get(row, "version")?,
        created_at: time(row, "created_at")?,
        updated_at: time(row, "updated_at")?,
    })
}

async fn fetch(connection: &mut SqliteConnection, id: &str) -> StoreResult<Study> {
    let row = sqlx::query("SELECT * FROM studies WHERE id = $1").bind(id).fetch_optional(connection).await?;
    study(&row.ok_or_else(|| StoreError::not_found(NOUN, id))?)
}

/// `NotFound` where there is no such study.
pub(super) async fn must_exist(connection: &mut SqliteConnection, id: StudyId) -> StoreResult<()> {
    fetch(connection, &id.to_string()).await.map(drop)
}

/// Why a conditional write to a row of `table` matched nothing.
pub(super) async fn missed(
    connection: &mut SqliteConnection,
    noun: &'static str,
    exists: &'static str,
    id: &str,
) -> StoreResult<StoreError> {
    let found: Option<i64> = sqlx::query_scalar(exists).bind(id).fetch_optional(connection).await?;
    Ok(match found {
        Some(_) => StoreError::Stale { noun },
        None => StoreError::not_found(noun, id),
    })
}

const EXISTS: &str = "SELECT 1 FROM studies WHERE id = $1";

impl Store {
    /// Stores a study.
    ///
    /// # Errors
    /// [`StoreError::KeyReused`], [`StoreError::Conflict`] (`idempotent_result_deleted`), the database's own.
    pub async fn create_study(&self, new: NewStudy, key: Option<&IdempotencyKey>) -> StoreResult<Created<Study>> {
        let mut tx = self.begin().await?;
        if let Some(ids) = replay(&mut tx, "studies", key).await? {
            return or_deleted(fetch(&mut tx, &ids.concat()).await).map(Created::Replayed);
        }
        let (id, now) = (Uuid::now_v7().to_string(), self.now_us());
        let row = sqlx::query(
            "INSERT INTO studies (id, name, description, display_limit, created_at, updated_at)
             VALUES ($1, $2, $3, $4, $5, $5) RETURNING *",
        )
        .bind(&id)
        .bind(&new.name)
        .bind(&new.description)
        .bind(new.display_limit)
        .bind(now)
        .fetch_one(&mut *tx)
        .await?;
        remember(&mut tx, "studies", key, &[id], now).await?;
        tx.commit().await?;
        study(&row).map(Created::New)
    }

    /// One study.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], the database's own.
    pub async fn study(&self, id: StudyId) -> StoreResult<Study> {
        fetch(&mut *self.readers().acquire().await?, &id.to_string()).await
    }

    /// A page of studies.
    ///
    /// # Errors
    /// The database's own.
    pub async fn studies(&self, page: Page) -> StoreResult<Vec<Study>> {
        let rows = sqlx::query("SELECT * FROM studies WHERE id > $1 ORDER BY id LIMIT $2")
            .bind(page.after_id())
            .bind(page.limit)
            .fetch_all(self.readers())
            .await?;
        rows.iter().map(study).collect()
    }

    /// Changes a study. A new display limit also changes (the version of) every trial that it makes divergent or no longer so.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Stale`], the database's own.
    pub async fn patch_study(&self, id: StudyId, patch: StudyPatch, if_match: Option<i64>) -> StoreResult<Study> {
        let id = id.to_string();
        let mut tx = self.begin().await?;
        let before = fetch(&mut tx, &id).await?;
        if if_match.is_some_and(|version| version != before.version) {
            return Err(StoreError::Stale { noun: NOUN });
        }
        if patch == StudyPatch::default() {
            return Ok(before);
        }
        let now = self.now_us();
        let row = sqlx::query(
            "UPDATE studies SET name = COALESCE($2, name), description = COALESCE($3, description),
                display_limit = CASE WHEN $4 THEN $5 ELSE display_limit END, version = version + 1, updated_at = $6
             WHERE id = $1 AND version = $7 RETURNING *",
        )
        .bind(&id)
        .bind(&patch.name)
        .bind(&patch.description)
        .bind(patch.display_limit.is_some())
        .bind(patch.display_limit.flatten())
        .bind(now)
        .bind(before.version)
        .fetch_optional(&mut *tx)
        .await?;
        let after = study(&row.ok_or(StoreError::Stale { noun: NOUN })?)?;
        if after.display_limit != before.display_limit {
            sqlx::query(
                "UPDATE trials SET version = version + 1, updated_at = $2 WHERE study_id = $1
                 AND ($3 IS NOT NULL AND max_abs_output > $3) <> ($4 IS NOT NULL AND max_abs_output > $4)",
            )
            .bind(&id)
            .bind(now)
            .bind(before.display_limit)
            .bind(after.display_limit)
            .execute(&mut *tx)
            .await?;
        }
        tx.commit().await?;
        Ok(after)
    }

    /// Deletes the study with its plants, subjects, trials and analyses, and overwrites what they held.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Stale`], the database's own.
    pub async fn delete_study(&self, id: StudyId, if_match: Option<i64>) -> StoreResult<()> {
        let (store, id) = (self.clone(), id.to_string());
        self.delete(async move {
            let mut tx = store.begin_erasing().await?;
            let gone = sqlx::query("DELETE FROM studies WHERE id = $1 AND ($2 IS NULL OR version = $2)")
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

impl Page {
    /// The bound for `id > …`; no id sorts before the empty text.
    pub(super) fn after_id(&self) -> String {
        self.after.map(|id| id.to_string()).unwrap_or_default()
    }
}
