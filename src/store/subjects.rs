//! Subjects of a study.

use super::error::{StoreError, StoreResult, breaks_unique};
use super::lists::Filter;
use super::nouns::{Change, Make, Noun, must_exist, select};
use super::open::Store;
use super::records::{Created, IdempotencyKey, NewSubject, Page, Subject, SubjectPatch};
use super::rows::{get, json, parsed, time, to_json};
use crate::analysis::ids::{StudyId, SubjectId};
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

impl Noun for Subject {
    type Id = SubjectId;
    const NAME: &'static str = "subject";
    const TABLE: &'static str = "subjects";
    const SELECT: &'static str = "SELECT n.* FROM subjects n";

    fn from_row(row: &SqliteRow) -> StoreResult<Self> {
        Ok(Self {
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

    fn id(&self) -> SubjectId {
        self.id
    }

    fn version(&self) -> i64 {
        self.version
    }
}

fn code_taken(error: sqlx::Error, code: &str) -> StoreError {
    if breaks_unique(&error, &["subjects.study_id, subjects.code"]) {
        let detail = format!("the study has a subject with the code '{code}' already");
        return StoreError::Conflict { rule: "subject_code_taken", detail };
    }
    error.into()
}

impl Make for Subject {
    type New = (StudyId, NewSubject);

    fn study((study, _): &Self::New) -> Option<StudyId> {
        Some(*study)
    }

    async fn insert(connection: &mut SqliteConnection, (study, new): &Self::New, now: i64) -> StoreResult<Self> {
        let row = sqlx::query(
            "INSERT INTO subjects (id, study_id, code, group_name, attributes, created_at, updated_at)
             VALUES ($1, $2, $3, $4, $5, $6, $6) RETURNING *",
        )
        .bind(Uuid::now_v7().to_string())
        .bind(study.to_string())
        .bind(&new.code)
        .bind(&new.group)
        .bind(to_json(&new.attributes)?)
        .bind(now)
        .fetch_one(connection)
        .await
        .map_err(|error| code_taken(error, &new.code))?;
        Self::from_row(&row)
    }
}

impl Change for Subject {
    type Patch = SubjectPatch;

    // The old code, group or attributes may name a person.
    fn forgets(before: &Self, patch: &SubjectPatch) -> bool {
        patch.code.as_ref().is_some_and(|code| *code != before.code)
            || before.group.is_some() && patch.group.as_ref().is_some_and(|group| *group != before.group)
            || patch.attributes.as_ref().is_some_and(|attributes| *attributes != before.attributes)
    }

    async fn update(
        connection: &mut SqliteConnection,
        before: &Self,
        patch: &SubjectPatch,
        now: i64,
    ) -> StoreResult<Self> {
        let row = sqlx::query(
            "UPDATE subjects SET code = COALESCE($2, code),
                group_name = CASE WHEN $3 THEN $4 ELSE group_name END,
                attributes = COALESCE($5, attributes), version = version + 1, updated_at = $6
             WHERE id = $1 RETURNING *",
        )
        .bind(before.id.to_string())
        .bind(&patch.code)
        .bind(patch.group.is_some())
        .bind(patch.group.clone().flatten())
        .bind(patch.attributes.as_ref().map(to_json).transpose()?)
        .bind(now)
        .fetch_one(connection)
        .await
        .map_err(|error| code_taken(error, patch.code.as_deref().unwrap_or_default()))?;
        Self::from_row(&row)
    }
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
        self.make((study, new), key).await
    }

    /// One subject.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], the database's own.
    pub async fn subject(&self, id: SubjectId) -> StoreResult<Subject> {
        self.read(id).await
    }

    /// The subject of a study that has this code; `None` where there is none.
    ///
    /// # Errors
    /// The database's own.
    pub async fn subject_named(&self, study: StudyId, code: &str) -> StoreResult<Option<Subject>> {
        let rest = "WHERE n.study_id = $1 AND n.code = $2";
        let query = sqlx::query(select::<Subject>(rest)).bind(study.to_string()).bind(code);
        query.fetch_optional(self.readers()?).await?.as_ref().map(Subject::from_row).transpose()
    }

    /// A page of a study's subjects, of one group where `group` is given.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (study), the database's own.
    pub async fn subjects(&self, study: StudyId, group: Option<&str>, page: Page) -> StoreResult<Vec<Subject>> {
        let mut tx = self.snapshot().await?;
        must_exist(&mut tx, study).await?;
        self.page_of(&mut tx, &of_group(study, group), page).await
    }
}

/// Those of a study, of one group where one is given.
pub(super) fn of_group(study: StudyId, group: Option<&str>) -> Filter {
    Filter::default().and("n.study_id = ?", Some(study.to_string())).and("n.group_name = ?", group)
}
