//! Trials without their signals.

use super::cursor::{List, PageQuery, Paged};
use super::etag::{IfMatch, IfNoneMatch};
use super::extract::{Id, Integer, MergePatch, present};
use super::named::{Named, View};
use super::problem::ApiResult;
use super::subjects::SubjectPath;
use super::timestamp::Timestamp;
use super::trust::measured_of;
use super::units::UnitsBody;
use crate::analysis::ids::{PlantId, StudyId, SubjectId, TrialId};
use crate::analysis::{Code, Problem, Warning};
use crate::learning::time_domain::TimeDomainMetrics;
use crate::store::{SignalUnits, TrialPatch, TrialRecord};
use crate::trust::Trust;
use axum::response::Response;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use time::OffsetDateTime;
use utoipa::IntoParams;

/// Numbers and sessions stay exact in every JSON reader.
pub(crate) const MAX_NUMBER: i64 = 1_000_000_000;

/// A trial without its signals.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Trial")]
pub(crate) struct TrialView {
    /// Its id.
    pub(crate) id: TrialId,
    /// The study that it belongs to.
    study: StudyId,
    /// The subject whose trial it is.
    subject: SubjectId,
    /// The plant that it was recorded on.
    plant: PlantId,
    /// Its number, unique within subject and session.
    number: i64,
    /// Its session, where it has one.
    session: Option<i64>,
    /// Time between samples, in seconds.
    sample_time_s: f64,
    /// Number of samples.
    samples: u64,
    /// Whether a disturbance was recorded.
    has_disturbance: bool,
    /// SHA-256 of the recording: sample time and columns.
    sha256: String,
    /// What was measured in the time domain.
    metrics: TrialMetrics,
    /// What was found at the upload and must be read before the trial is used; repeated in every report that uses it.
    recording_warnings: Vec<Warning>,
    /// The units of its signals, where they are not those of its plant.
    units: SignalUnits,
    /// How far what was measured may be used; what was identified is at `/v1/trials/{trial}/trust`.
    trust: Vec<Trust>,
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

/// What was measured in the time domain.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct TrialMetrics {
    #[serde(flatten)]
    #[schemars(with = "TimeDomainMetrics")]
    time_domain: Value,
    /// Whether |y| passed the display limit that the study has now.
    divergent: bool,
}

/// A page of trials.
pub(crate) type TrialList = List<TrialView>;

impl View for TrialView {
    type Record = TrialRecord;
}

impl From<TrialRecord> for TrialView {
    fn from(record: TrialRecord) -> Self {
        Self {
            id: record.id,
            study: record.study,
            subject: record.subject,
            plant: record.plant,
            number: record.number,
            session: record.session,
            sample_time_s: record.sample_time_s,
            samples: record.samples,
            has_disturbance: record.has_disturbance,
            sha256: record.sha256,
            trust: measured_of(&record.metrics, record.divergent),
            metrics: TrialMetrics { time_domain: record.metrics, divergent: record.divergent },
            recording_warnings: record.warnings,
            units: record.units,
            version: record.version,
            created_at: record.created_at,
            updated_at: record.updated_at,
        }
    }
}

/// Names a trial in the path.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "documents the path")]
pub(crate) struct TrialPath {
    /// The trial.
    trial: TrialId,
}

/// Changes to a trial; what is left out stays as it is. The recording and its plant never change.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "TrialPatch", example = serde_json::json!({"number": 4}))]
pub(crate) struct TrialPatchBody {
    /// A new number.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<i64>", range(min = 1, max = 1000000000))]
    number: Option<Integer>,
    /// A new session; null takes the trial out of its session.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<i64>", range(min = 0, max = 1000000000))]
    session: Option<Option<Integer>>,
    /// Units of its signals, where they are not those of its plant.
    #[serde(default)]
    units: UnitsBody,
}

/// A number or session within its range.
pub(super) fn in_range(value: i64, min: i64, pointer: &str) -> Result<i64, Problem> {
    if (min..=MAX_NUMBER).contains(&value) {
        return Ok(value);
    }
    Err(Problem::new(Code::Invalid, "number out of range", format!("it is {value}"))
        .at(pointer)
        .mend(format!("Give an integer from {min} to {MAX_NUMBER}.")))
}

/// Lists the trials of a subject.
#[utoipa::path(get, path = "/v1/subjects/{subject}/trials", tag = "trials", operation_id = "list_trials",
    params(SubjectPath, PageQuery, IfNoneMatch),
    responses((status = 200, description = "A page of trials.", body = TrialList)))]
pub(crate) async fn list(Id(subject): Id<SubjectId>, list: Paged<()>) -> ApiResult<Response> {
    let rows = list.state.store.trials(subject, list.page()).await?;
    list.answer(rows, |trial| trial.id.0, TrialView::from)
}

/// Reads a trial: what it is and what was measured in the time domain.
#[utoipa::path(get, path = "/v1/trials/{trial}", tag = "trials", operation_id = "read_trial",
    params(TrialPath, IfNoneMatch), responses((status = 200, description = "The trial.", body = TrialView)))]
pub(crate) async fn read(trial: Named<TrialView>) -> ApiResult<Response> {
    trial.read().await
}

/// Changes a trial's number or session, or the units of its signals.
#[utoipa::path(patch, path = "/v1/trials/{trial}", tag = "trials", operation_id = "change_trial",
    params(TrialPath, IfMatch),
    request_body(content((TrialPatchBody = "application/merge-patch+json"), (TrialPatchBody = "application/json"))),
    responses((status = 200, description = "The trial as it is now.", body = TrialView),
        (status = 409, description = "Another trial of the subject has this number.")))]
pub(crate) async fn patch(
    trial: Named<TrialView>,
    MergePatch(body): MergePatch<TrialPatchBody>,
) -> ApiResult<Response> {
    let patch = TrialPatch {
        number: body.number.map(|Integer(number)| in_range(number, 1, "/number")).transpose()?,
        session: match body.session {
            Some(Some(Integer(session))) => Some(Some(in_range(session, 0, "/session")?)),
            Some(None) => Some(None),
            None => None,
        },
        units: body.units.change()?,
    };
    trial.change(patch).await
}

/// Deletes a trial with its recording and the analyses that used it, and overwrites what they held.
#[utoipa::path(delete, path = "/v1/trials/{trial}", tag = "trials", operation_id = "delete_trial",
    params(TrialPath, IfMatch), responses((status = 204, description = "It is gone.")))]
pub(crate) async fn delete(trial: Named<TrialView>) -> ApiResult<Response> {
    trial.delete().await
}
