//! Studies.

use super::checks::{self, NAME_PATTERN, TEXT_PATTERN};
use super::cursor::{List, PageQuery, Paged};
use super::etag::{IfMatch, IfNoneMatch};
use super::extract::{Json, MergePatch, Params, or_default, present};
use super::idempotency::{Idempotency, IdempotencyHeader};
use super::named::{self, Named, View};
use super::problem::ApiResult;
use super::state::AppState;
use super::timestamp::Timestamp;
use crate::analysis::ids::StudyId;
use crate::analysis::{Code, Problem};
use crate::exchange::Saved;
use crate::store::{NewStudy, Study, StudyPatch, StudyReading};
use axum::extract::State;
use axum::response::Response;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::IntoParams;

/// A study, the frame of everything else.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Study")]
pub(crate) struct StudyView {
    /// Its id.
    id: StudyId,
    /// Its name.
    name: String,
    /// What it is about.
    description: String,
    /// A trial whose |y| passes this is divergent; null where there is no limit.
    display_limit: Option<f64>,
    /// What its files do not say themselves, taken for every upload that says nothing else.
    reading: StudyReading,
    /// Counts changes, from 1.
    version: i64,
    /// When it was made, UTC.
    #[serde(with = "time::serde::rfc3339")]
    #[schemars(with = "Timestamp")]
    created_at: OffsetDateTime,
    /// When it last changed, UTC.
    #[serde(with = "time::serde::rfc3339")]
    #[schemars(with = "Timestamp")]
    updated_at: OffsetDateTime,
}

/// A page of studies.
pub(crate) type StudyList = List<StudyView>;

impl View for StudyView {
    type Record = Study;
}

impl From<Study> for StudyView {
    fn from(study: Study) -> Self {
        let Study { id, name, description, display_limit, reading, version, created_at, updated_at } = study;
        Self { id, name, description, display_limit, reading, version, created_at, updated_at }
    }
}

/// A study to be made.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "NewStudy", example = serde_json::json!({"name": "gm and gn", "display_limit": 5.0}))]
pub(crate) struct NewStudyBody {
    /// Its name: not blank, without control characters.
    #[schemars(length(min = 1, max = 200), extend("pattern" = NAME_PATTERN))]
    name: String,
    /// What it is about.
    #[serde(default, deserialize_with = "or_default")]
    #[schemars(length(max = 20000), extend("pattern" = TEXT_PATTERN))]
    description: String,
    /// A trial whose |y| passes this is divergent. Null or absent: there is no limit.
    #[serde(default)]
    #[schemars(extend("exclusiveMinimum" = 0))]
    display_limit: Option<f64>,
    /// What its files do not say themselves: said once, it is taken for every upload that says nothing else. Trials as
    /// JSON say themselves what they hold.
    #[serde(default, deserialize_with = "or_default")]
    #[schemars(example = serde_json::json!({"columns": "r:Target,u:Stick,y:Cursor"}))]
    reading: StudyReading,
}

/// Changes to a study; what is left out stays as it is.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "StudyPatch", example = serde_json::json!({"display_limit": null}))]
pub(crate) struct StudyPatchBody {
    /// A new name.
    #[serde(default, deserialize_with = "present")]
    #[schemars(length(min = 1, max = 200), extend("pattern" = NAME_PATTERN))]
    name: Option<String>,
    /// A new description.
    #[serde(default, deserialize_with = "present")]
    #[schemars(length(max = 20000), extend("pattern" = TEXT_PATTERN))]
    description: Option<String>,
    /// A new limit; null removes it. Which trials are divergent follows at once.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0))]
    display_limit: Option<Option<f64>>,
    /// What its files do not say themselves, in place of what was kept: said once, it is taken for every upload that
    /// says nothing else. Trials as JSON say themselves what they hold.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<StudyReading>", example = serde_json::json!({"columns": "r:Target,u:Stick,y:Cursor"}))]
    reading: Option<StudyReading>,
}

/// What is kept of a study's files, as the reader takes it.
///
/// # Errors
/// `invalid`, where a member cannot be read.
pub(super) fn saved_of(reading: &StudyReading) -> Result<Saved, Problem> {
    let StudyReading { columns, time_unit, sample_time_s, resample } = reading;
    Saved::parse(columns.as_deref(), time_unit.as_deref(), *sample_time_s, resample.as_deref()).map_err(
        |(member, why)| {
            Problem::new(Code::Invalid, "unreadable", why).at(format!("/reading/{member}")).mend(
                "Write it as an upload takes it, such as {\"columns\": \"r:Target,y:Cursor\", \"time_unit\": \"ms\"}.",
            )
        },
    )
}

/// Names a study in the path.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "documents the path")]
pub(crate) struct StudyPath {
    /// The study.
    study: StudyId,
}

/// Makes a study.
#[utoipa::path(post, path = "/v1/studies", tag = "studies", operation_id = "create_study",
    params(IdempotencyHeader), request_body = NewStudyBody,
    responses((status = 201, description = "The new study; Location names it.", body = StudyView)))]
pub(crate) async fn create(
    State(state): State<AppState>,
    Params(()): Params<()>,
    idempotency: Idempotency,
    body: Json<NewStudyBody>,
) -> ApiResult<Response> {
    let new = NewStudy {
        name: checks::name(&body.value.name, "/name")?,
        description: checks::description(&body.value.description, "/description")?,
        display_limit: body.value.display_limit.map(|l| checks::display_limit(l, "/display_limit")).transpose()?,
        reading: body.value.reading,
    };
    saved_of(&new.reading)?;
    let made = state.store.create_study(new, idempotency.key(&body.bytes).as_ref()).await?;
    named::made::<StudyView>(&made, "/v1/studies")
}

/// Lists studies.
#[utoipa::path(get, path = "/v1/studies", tag = "studies", operation_id = "list_studies",
    params(PageQuery, IfNoneMatch),
    responses((status = 200, description = "A page of studies; as NDJSON all of them, one a line.",
        content((StudyList = "application/json"), (StudyView = "application/x-ndjson")))))]
pub(crate) async fn list(list: Paged<()>) -> ApiResult<Response> {
    let store = list.state.store.clone();
    let rows = move |page| {
        let store = store.clone();
        async move { store.studies(page).await }
    };
    list.answer(rows, |study| study.id.0, StudyView::from).await
}

/// Reads a study.
#[utoipa::path(get, path = "/v1/studies/{study}", tag = "studies", operation_id = "read_study",
    params(StudyPath, IfNoneMatch), responses((status = 200, description = "The study.", body = StudyView)))]
pub(crate) async fn read(study: Named<StudyView>) -> ApiResult<Response> {
    study.read().await
}

/// Changes a study.
#[utoipa::path(patch, path = "/v1/studies/{study}", tag = "studies", operation_id = "change_study",
    params(StudyPath, IfMatch),
    request_body(content((StudyPatchBody = "application/merge-patch+json"), (StudyPatchBody = "application/json"))),
    responses((status = 200, description = "The study as it is now.", body = StudyView)))]
pub(crate) async fn patch(
    study: Named<StudyView>,
    MergePatch(body): MergePatch<StudyPatchBody>,
) -> ApiResult<Response> {
    let patch = StudyPatch {
        name: body.name.map(|name| checks::name(&name, "/name")).transpose()?,
        description: body.description.map(|text| checks::description(&text, "/description")).transpose()?,
        display_limit: match body.display_limit {
            Some(Some(limit)) => Some(Some(checks::display_limit(limit, "/display_limit")?)),
            other => other,
        },
        reading: body.reading,
    };
    if let Some(reading) = &patch.reading {
        saved_of(reading)?;
    }
    study.change(patch).await
}

/// Deletes a study with its plants, subjects, trials and analyses, and overwrites what they held.
#[utoipa::path(delete, path = "/v1/studies/{study}", tag = "studies", operation_id = "delete_study",
    params(StudyPath, IfMatch), responses((status = 204, description = "It is gone.")))]
pub(crate) async fn delete(study: Named<StudyView>) -> ApiResult<Response> {
    study.delete().await
}
