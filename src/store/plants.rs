//! Plants of a study.

use super::error::{StoreError, StoreResult, breaks_unique};
use super::idempotency::{or_deleted, remember, replay};
use super::open::Store;
use super::records::{Created, IdempotencyKey, NewPlant, Page, Plant};
use super::rows::{get, json_verified, parsed, sha256, time, to_json};
use super::studies::{missed, must_exist};
use crate::analysis::ids::{PlantId, StudyId};
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

const NOUN: &str = "plant";
const EXISTS: &str = "SELECT 1 FROM plants WHERE id = $1";

fn plant(row: &SqliteRow) -> StoreResult<Plant> {
    Ok(Plant {
        id: parsed(row, "id")?,
        study: parsed(row, "study_id")?,
        name: get(row, "name")?,
        model: json_verified(row, "model", "model_sha256")?,
        version: get(row, "version")?,
        created_at: time(row, "created_at")?,
        updated_at: time(row, "updated_at")?,
    })
}

pub(super) async fn fetch(connection: &mut SqliteConnection, id: &str) -> StoreResult<Plant> {
    let row = sqlx::query("SELECT * FROM plants WHERE id = $1").bind(id).fetch_optional(connection).await?;
    plant(&row.ok_or_else(|| StoreError::not_found(NOUN, id))?)
}

fn name_taken(error: sqlx::Error, name: &str) -> StoreError {
    if breaks_unique(&error, &["plants.study_id, plants.name"]) {
        let detail = format!("the study has a plant named '{name}' already");
        return StoreError::Conflict { rule: "plant_name_taken", detail };
    }
    error.into()
}

impl Store {
    /// Stores a plant.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (study), [`StoreError::Conflict`] (`plant_name_taken`, `idempotent_result_deleted`),
    /// [`StoreError::KeyReused`], the database's own.
    pub async fn create_plant(
        &self,
        study: StudyId,
        new: NewPlant,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Created<Plant>> {
        let scope = format!("studies/{study}/plants");
        let mut tx = self.begin().await?;
        must_exist(&mut tx, study).await?;
        if let Some(ids) = replay(&mut tx, &scope, key).await? {
            return or_deleted(fetch(&mut tx, &ids.concat()).await).map(Created::Replayed);
        }
        let (id, now) = (Uuid::now_v7().to_string(), self.now_us());
        let model = to_json(&new.model)?;
        let row = sqlx::query(
            "INSERT INTO plants (id, study_id, name, model, model_sha256, created_at, updated_at)
             VALUES ($1, $2, $3, $4, $5, $6, $6) RETURNING *",
        )
        .bind(&id)
        .bind(study.to_string())
        .bind(&new.name)
        .bind(&model)
        .bind(sha256(&model))
        .bind(now)
        .fetch_one(&mut *tx)
        .await
        .map_err(|error| name_taken(error, &new.name))?;
        remember(&mut tx, &scope, key, &[id], now).await?;
        tx.commit().await?;
        plant(&row).map(Created::New)
    }

    /// One plant.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], the database's own.
    pub async fn plant(&self, id: PlantId) -> StoreResult<Plant> {
        fetch(&mut *self.readers().acquire().await?, &id.to_string()).await
    }

    /// A page of a study's plants.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (study), the database's own.
    pub async fn plants(&self, study: StudyId, page: Page) -> StoreResult<Vec<Plant>> {
        let mut tx = self.snapshot().await?;
        must_exist(&mut tx, study).await?;
        let rows = sqlx::query("SELECT * FROM plants WHERE study_id = $1 AND id > $2 ORDER BY id LIMIT $3")
            .bind(study.to_string())
            .bind(page.after_id())
            .bind(page.limit)
            .fetch_all(&mut *tx)
            .await?;
        rows.iter().map(plant).collect()
    }

    /// Renames a plant; its model never changes, since results were computed with it.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Stale`], [`StoreError::Conflict`] (`plant_name_taken`), the database's own.
    pub async fn rename_plant(&self, id: PlantId, name: &str, if_match: Option<i64>) -> StoreResult<Plant> {
        let id = id.to_string();
        let mut tx = self.begin().await?;
        let row = sqlx::query(
            "UPDATE plants SET name = $2, version = version + 1, updated_at = $3
             WHERE id = $1 AND ($4 IS NULL OR version = $4) RETURNING *",
        )
        .bind(&id)
        .bind(name)
        .bind(self.now_us())
        .bind(if_match)
        .fetch_optional(&mut *tx)
        .await
        .map_err(|error| name_taken(error, name))?;
        let Some(row) = row else { return Err(missed(&mut tx, NOUN, EXISTS, &id).await?) };
        tx.commit().await?;
        plant(&row)
    }

    /// Deletes a plant and the analyses that named it. Refused (`plant_in_use`) while trials were recorded on it.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Stale`], [`StoreError::Conflict`] (`plant_in_use`), the database's own.
    pub async fn delete_plant(&self, id: PlantId, if_match: Option<i64>) -> StoreResult<()> {
        let (store, id) = (self.clone(), id.to_string());
        self.delete(async move {
            let mut tx = store.begin_erasing().await?;
            let trials: i64 = sqlx::query_scalar("SELECT count(*) FROM trials WHERE plant_id = $1")
                .bind(&id)
                .fetch_one(&mut *tx)
                .await?;
            if trials > 0 {
                let detail = format!("{trials} trials were recorded on the plant {id}; delete them first");
                return Err(StoreError::Conflict { rule: "plant_in_use", detail });
            }
            let gone = sqlx::query("DELETE FROM plants WHERE id = $1 AND ($2 IS NULL OR version = $2)")
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
