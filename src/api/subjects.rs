//! Subjects, by pseudonym.

use super::checks::{self, NAME_PATTERN};
use super::cursor::{List, PageQuery, Paged};
use super::etag::{IfMatch, IfNoneMatch};
use super::extract::{FromQuery, Id, Json, MergePatch, Params, QueryText, or_default, present};
use super::idempotency::{Idempotency, IdempotencyHeader};
use super::named::{self, Named, View};
use super::problem::ApiResult;
use super::state::AppState;
use super::studies::StudyPath;
use super::timestamp::Timestamp;
use crate::analysis::Problem;
use crate::analysis::ids::{StudyId, SubjectId};
use crate::store::{NewSubject, Subject, SubjectPatch};
use axum::extract::State;
use axum::response::Response;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use time::OffsetDateTime;
use utoipa::IntoParams;

/// A subject.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Subject")]
pub(crate) struct SubjectView {
    /// Its id.
    id: SubjectId,
    /// The study that it belongs to.
    study: StudyId,
    /// Pseudonym, unique within the study.
    code: String,
    /// Group, where the subject is in one.
    group: Option<String>,
    /// Free attributes.
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    attributes: Value,
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

/// A page of subjects.
pub(crate) type SubjectList = List<SubjectView>;

impl View for SubjectView {
    type Record = Subject;
}

impl From<Subject> for SubjectView {
    fn from(subject: Subject) -> Self {
        let Subject { id, study, code, group, attributes, version, created_at, updated_at } = subject;
        Self { id, study, code, group, attributes, version, created_at, updated_at }
    }
}

/// A subject to be made.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "NewSubject", example = serde_json::json!({
    "code": "s07", "group": "gm", "attributes": {"handedness": "right"}
}))]
pub(crate) struct NewSubjectBody {
    /// Pseudonym, unique within the study: not blank, without control characters. No names of people.
    #[schemars(length(min = 1, max = 200), extend("pattern" = NAME_PATTERN))]
    code: String,
    /// Group.
    #[serde(default)]
    #[schemars(length(min = 1, max = 200), extend("pattern" = NAME_PATTERN))]
    group: Option<String>,
    /// Free attributes, at most 64 KiB.
    #[serde(default = "empty", deserialize_with = "or_default")]
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    attributes: Value,
}

fn empty() -> Value {
    Value::Object(serde_json::Map::new())
}

/// Changes to a subject; what is left out stays as it is.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "SubjectPatch", example = serde_json::json!({"group": "gn"}))]
pub(crate) struct SubjectPatchBody {
    /// A new pseudonym.
    #[serde(default, deserialize_with = "present")]
    #[schemars(length(min = 1, max = 200), extend("pattern" = NAME_PATTERN))]
    code: Option<String>,
    /// A new group; null takes the subject out of its group.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<String>", length(min = 1, max = 200), extend("pattern" = NAME_PATTERN))]
    group: Option<Option<String>>,
    /// New attributes, in place of all the old ones; null removes them.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<serde_json::Map<String, serde_json::Value>>")]
    attributes: Option<Value>,
}

/// Names a subject in the path.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "documents the path")]
pub(crate) struct SubjectPath {
    /// The subject.
    subject: SubjectId,
}

/// Which subjects.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct SubjectQuery {
    /// Only those of this group.
    #[param(nullable = false)]
    group: Option<String>,
}

impl FromQuery for SubjectQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self { group: query.take("group")? })
    }
}

/// Adds a subject to a study.
#[utoipa::path(post, path = "/v1/studies/{study}/subjects", tag = "subjects", operation_id = "create_subject",
    params(StudyPath, IdempotencyHeader), request_body = NewSubjectBody,
    responses((status = 201, description = "The new subject; Location names it.", body = SubjectView)))]
pub(crate) async fn create(
    State(state): State<AppState>,
    Id(study): Id<StudyId>,
    Params(()): Params<()>,
    idempotency: Idempotency,
    body: Json<NewSubjectBody>,
) -> ApiResult<Response> {
    let NewSubjectBody { code, group, attributes } = body.value;
    let new = NewSubject {
        code: checks::name(&code, "/code")?,
        group: group.map(|group| checks::name(&group, "/group")).transpose()?,
        attributes: checks::attributes(attributes, "/attributes")?,
    };
    let made = state.store.create_subject(study, new, idempotency.key(&body.bytes).as_ref()).await?;
    named::made::<SubjectView>(&made, "/v1/subjects")
}

/// Lists the subjects of a study.
#[utoipa::path(get, path = "/v1/studies/{study}/subjects", tag = "subjects", operation_id = "list_subjects",
    params(StudyPath, SubjectQuery, PageQuery, IfNoneMatch),
    responses((status = 200, description = "A page of subjects; as NDJSON all of them, one a line.",
        content((SubjectList = "application/json"), (SubjectView = "application/x-ndjson")))))]
pub(crate) async fn list(Id(study): Id<StudyId>, list: Paged<SubjectQuery>) -> ApiResult<Response> {
    let (store, group) = (list.state.store.clone(), list.filter.group.clone());
    let rows = move |page| {
        let (store, group) = (store.clone(), group.clone());
        async move { store.subjects(study, group.as_deref(), page).await }
    };
    list.answer(rows, |subject| subject.id.0, SubjectView::from).await
}

/// Reads a subject.
#[utoipa::path(get, path = "/v1/subjects/{subject}", tag = "subjects", operation_id = "read_subject",
    params(SubjectPath, IfNoneMatch), responses((status = 200, description = "The subject.", body = SubjectView)))]
pub(crate) async fn read(subject: Named<SubjectView>) -> ApiResult<Response> {
    subject.read().await
}

/// Changes a subject.
#[utoipa::path(patch, path = "/v1/subjects/{subject}", tag = "subjects", operation_id = "change_subject",
    params(SubjectPath, IfMatch),
    request_body(content((SubjectPatchBody = "application/merge-patch+json"), (SubjectPatchBody = "application/json"))),
    responses((status = 200, description = "The subject as it is now.", body = SubjectView),
        (status = 409, description = "Another subject of the study has this code.")))]
pub(crate) async fn patch(
    subject: Named<SubjectView>,
    MergePatch(body): MergePatch<SubjectPatchBody>,
) -> ApiResult<Response> {
    let patch = SubjectPatch {
        code: body.code.map(|code| checks::name(&code, "/code")).transpose()?,
        group: match body.group {
            Some(Some(group)) => Some(Some(checks::name(&group, "/group")?)),
            other => other,
        },
        attributes: match body.attributes {
            Some(Value::Null) => Some(empty()),
            Some(value) => Some(checks::attributes(value, "/attributes")?),
            None => None,
        },
    };
    subject.change(patch).await
}

/// Deletes a subject with its trials and their analyses, and overwrites what they held.
#[utoipa::path(delete, path = "/v1/subjects/{subject}", tag = "subjects", operation_id = "delete_subject",
    params(SubjectPath, IfMatch), responses((status = 204, description = "It is gone.")))]
pub(crate) async fn delete(subject: Named<SubjectView>) -> ApiResult<Response> {
    subject.delete().await
}
