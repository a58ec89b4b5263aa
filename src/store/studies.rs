//! Studies.

use super::error::StoreResult;
use super::lists::Filter;
use super::nouns::{Change, Make, Noun};
use super::open::Store;
use super::records::{Created, IdempotencyKey, NewStudy, Page, Study, StudyPatch};
use super::rows::{get, json, parsed, time, to_json};
use crate::analysis::ids::StudyId;
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

impl Noun for Study {
    type Id = StudyId;
    const NAME: &'static str = "study";
    const TABLE: &'static str = "studies";
    const SELECT: &'static str = "SELECT n.* FROM studies n";

    fn from_row(row: &SqliteRow) -> StoreResult<Self> {
        Ok(Self {
            id: parsed(row, "id")?,
            name: get(row, "name")?,
            description: get(row, "description")?,
            display_limit: get(row, "display_limit")?,
            reading: json(row, "reading")?,
            version: get(row, "version")?,
            created_at: time(row, "created_at")?,
            updated_at: time(row, "updated_at")?,
        })
    }

    fn id(&self) -> StudyId {
        self.id
    }

    fn version(&self) -> i64 {
        self.version
    }
}

impl Make for Study {
    type New = NewStudy;

    fn study(_: &NewStudy) -> Option<StudyId> {
        None
    }

    async fn insert(connection: &mut SqliteConnection, new: &NewStudy, now: i64) -> StoreResult<Self> {
        let row = sqlx::query(
            "INSERT INTO studies (id, name, description, display_limit, reading, created_at, updated_at)
             VALUES ($1, $2, $3, $4, $6, $5, $5) RETURNING *",
        )
        .bind(Uuid::now_v7().to_string())
        .bind(&new.name)
        .bind(&new.description)
        .bind(new.display_limit)
        .bind(now)
        .bind(to_json(&new.reading)?)
        .fetch_one(connection)
        .await?;
        Self::from_row(&row)
    }
}

impl Change for Study {
    type Patch = StudyPatch;

    async fn update(
        connection: &mut SqliteConnection,
        before: &Self,
        patch: &StudyPatch,
        now: i64,
    ) -> StoreResult<Self> {
        let row = sqlx::query(
            "UPDATE studies SET name = COALESCE($2, name), description = COALESCE($3, description),
                display_limit = CASE WHEN $4 THEN $5 ELSE display_limit END, reading = COALESCE($7, reading),
                version = version + 1, updated_at = $6
             WHERE id = $1 RETURNING *",
        )
        .bind(before.id.to_string())
        .bind(&patch.name)
        .bind(&patch.description)
        .bind(patch.display_limit.is_some())
        .bind(patch.display_limit.flatten())
        .bind(now)
        .bind(patch.reading.as_ref().map(to_json).transpose()?)
        .fetch_one(&mut *connection)
        .await?;
        let after = Self::from_row(&row)?;
        if after.display_limit != before.display_limit {
            sqlx::query(
                "UPDATE trials SET version = version + 1, updated_at = $2 WHERE study_id = $1
                 AND ($3 IS NOT NULL AND max_abs_output > $3) <> ($4 IS NOT NULL AND max_abs_output > $4)",
            )
            .bind(before.id.to_string())
            .bind(now)
            .bind(before.display_limit)
            .bind(after.display_limit)
            .execute(connection)
            .await?;
        }
        Ok(after)
    }
}

impl Store {
    /// Stores a study.
    ///
    /// # Errors
    /// [`StoreError::KeyReused`](super::StoreError::KeyReused), [`StoreError::Conflict`](super::StoreError::Conflict)
    /// (`idempotent_result_deleted`), the database's own.
    pub async fn create_study(&self, new: NewStudy, key: Option<&IdempotencyKey>) -> StoreResult<Created<Study>> {
        self.make(new, key).await
    }

    /// One study.
    ///
    /// # Errors
    /// [`StoreError::NotFound`](super::StoreError::NotFound), the database's own.
    pub async fn study(&self, id: StudyId) -> StoreResult<Study> {
        self.read(id).await
    }

    /// A page of studies.
    ///
    /// # Errors
    /// The database's own.
    pub async fn studies(&self, page: Page) -> StoreResult<Vec<Study>> {
        self.page_of(&mut *self.readers()?.acquire().await?, &Filter::default(), page).await
    }
}
