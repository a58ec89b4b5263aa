//! Plants of a study.

use super::error::{StoreError, StoreResult, breaks_unique};
use super::lists::Filter;
use super::nouns::{Change, Make, Noun, must_exist, select};
use super::open::Store;
use super::records::{Created, IdempotencyKey, NewPlant, Page, Plant, PlantPatch};
use super::rows::{get, json, json_verified, parsed, sha256, time, to_json};
use crate::analysis::ids::{PlantId, StudyId};
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

impl Noun for Plant {
    type Id = PlantId;
    const NAME: &'static str = "plant";
    const TABLE: &'static str = "plants";
    const SELECT: &'static str = "SELECT n.* FROM plants n";

    fn from_row(row: &SqliteRow) -> StoreResult<Self> {
        Ok(Self {
            id: parsed(row, "id")?,
            study: parsed(row, "study_id")?,
            name: get(row, "name")?,
            model: json_verified(row, "model", "model_sha256")?,
            units: json(row, "units")?,
            version: get(row, "version")?,
            created_at: time(row, "created_at")?,
            updated_at: time(row, "updated_at")?,
        })
    }

    fn id(&self) -> PlantId {
        self.id
    }

    fn version(&self) -> i64 {
        self.version
    }

    /// Refused (`plant_in_use`) while trials were recorded on it.
    async fn may_go(connection: &mut SqliteConnection, id: &str) -> StoreResult<()> {
        let trials: i64 = sqlx::query_scalar("SELECT count(*) FROM trials WHERE plant_id = $1")
            .bind(id)
            .fetch_one(connection)
            .await?;
        if trials > 0 {
            let detail = format!("{trials} trials were recorded on the plant {id}; delete them first");
            return Err(StoreError::Conflict { rule: "plant_in_use", detail });
        }
        Ok(())
    }
}

fn name_taken(error: sqlx::Error, name: &str) -> StoreError {
    if breaks_unique(&error, &["plants.study_id, plants.name"]) {
        let detail = format!("the study has a plant named '{name}' already");
        return StoreError::Conflict { rule: "plant_name_taken", detail };
    }
    error.into()
}

impl Make for Plant {
    type New = (StudyId, NewPlant);

    fn study((study, _): &Self::New) -> Option<StudyId> {
        Some(*study)
    }

    async fn insert(connection: &mut SqliteConnection, (study, new): &Self::New, now: i64) -> StoreResult<Self> {
        let model = to_json(&new.model)?;
        let row = sqlx::query(
            "INSERT INTO plants (id, study_id, name, model, model_sha256, created_at, updated_at, units)
             VALUES ($1, $2, $3, $4, $5, $6, $6, $7) RETURNING *",
        )
        .bind(Uuid::now_v7().to_string())
        .bind(study.to_string())
        .bind(&new.name)
        .bind(&model)
        .bind(sha256(&model))
        .bind(now)
        .bind(to_json(&new.units)?)
        .fetch_one(connection)
        .await
        .map_err(|error| name_taken(error, &new.name))?;
        Self::from_row(&row)
    }
}

impl Change for Plant {
    type Patch = PlantPatch;

    async fn update(
        connection: &mut SqliteConnection,
        before: &Self,
        patch: &PlantPatch,
        now: i64,
    ) -> StoreResult<Self> {
        let row = sqlx::query(
            "UPDATE plants SET name = COALESCE($2, name), units = $4, version = version + 1, updated_at = $3
             WHERE id = $1 RETURNING *",
        )
        .bind(before.id.to_string())
        .bind(&patch.name)
        .bind(now)
        .bind(to_json(&before.units.changed(&patch.units))?)
        .fetch_one(connection)
        .await
        .map_err(|error| name_taken(error, patch.name.as_deref().unwrap_or_default()))?;
        Self::from_row(&row)
    }
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
        self.make((study, new), key).await
    }

    /// One plant.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], the database's own.
    pub async fn plant(&self, id: PlantId) -> StoreResult<Plant> {
        self.read(id).await
    }

    /// The plant of a study that has this name; `None` where there is none.
    ///
    /// # Errors
    /// The database's own.
    pub async fn plant_named(&self, study: StudyId, name: &str) -> StoreResult<Option<Plant>> {
        let rest = "WHERE n.study_id = $1 AND n.name = $2";
        let query = sqlx::query(select::<Plant>(rest)).bind(study.to_string()).bind(name);
        query.fetch_optional(self.readers()?).await?.as_ref().map(Plant::from_row).transpose()
    }

    /// A page of a study's plants.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (study), the database's own.
    pub async fn plants(&self, study: StudyId, page: Page) -> StoreResult<Vec<Plant>> {
        let mut tx = self.snapshot().await?;
        must_exist(&mut tx, study).await?;
        self.page_of(&mut tx, &of_study(study), page).await
    }
}

/// Those of a study.
pub(super) fn of_study(study: StudyId) -> Filter {
    Filter::default().and("n.study_id = ?", Some(study.to_string()))
}
