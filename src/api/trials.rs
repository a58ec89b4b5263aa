//! Trials without their signals.

use super::checks;
use super::cursor::List;
use super::doubts::doubts;
use super::etag::{IfMatch, IfNoneMatch};
use super::extract::{Integer, MergePatch, off_thread, present};
use super::named::{Named, View};
use super::problem::{ApiResult, internal, unless_missing};
use super::state::AppState;
use super::timestamp::Timestamp;
use super::trust::measured_of;
use super::units::UnitsBody;
use crate::analysis::ids::{PlantId, StudyId, SubjectId, TrialId};
use crate::analysis::{Code, Problem, Warning};
use crate::learning::time_domain::{self, TimeDomainMetrics};
use crate::store::{OnPlant, SignalUnits, TrialPatch, TrialRecord};
use crate::trust::{LeftOut, Trust};
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
    /// The subject's pseudonym.
    subject_code: String,
    /// The plant that it was recorded on.
    plant: PlantId,
    /// The plant's name.
    plant_name: String,
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
    /// A remark by whoever looked at it; empty where there is none.
    note: String,
    /// Why it is left out of learning curves and comparisons; null where it is not.
    excluded: Option<Exclusion>,
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

/// That a trial is left out of learning curves and comparisons, and why. Its recording and its analyses stay.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Exclusion {
    /// Why, in a sentence that stands wherever the trial is left out; 1 to 1000 characters.
    #[schemars(length(min = 1, max = 1000), example = &"The subject let go of the stick.")]
    pub(crate) reason: String,
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
            subject_code: record.subject_code,
            plant: record.plant,
            plant_name: record.plant_name,
            number: record.number,
            session: record.session,
            sample_time_s: record.sample_time_s,
            samples: record.samples,
            has_disturbance: record.has_disturbance,
            sha256: record.sha256,
            trust: measured_of(&record.metrics, LeftOut::of(record.divergent, record.excluded.as_deref())),
            metrics: TrialMetrics { time_domain: record.metrics, divergent: record.divergent },
            recording_warnings: record.warnings,
            units: record.units,
            note: record.note,
            excluded: record.excluded.map(|reason| Exclusion { reason }),
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

/// Changes to a trial; what is left out stays as it is. The recording never changes.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "TrialPatch", example = serde_json::json!({
    "note": "second attempt", "excluded": {"reason": "The subject let go of the stick."}
}))]
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
    /// A remark, at most 20000 characters; null removes it.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<String>", length(max = 20000))]
    note: Option<Option<String>>,
    /// Leaves it out of learning curves and comparisons, with the reason; null takes it in again.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<Exclusion>")]
    excluded: Option<Option<Exclusion>>,
    /// The plant that it was recorded on after all, of the same study. What was measured and doubted is found anew.
    /// Refused while analyses use the trial, since their reports were computed with the present one.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<PlantId>")]
    plant: Option<PlantId>,
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

/// Reads a trial: what it is and what was measured in the time domain.
#[utoipa::path(get, path = "/v1/trials/{trial}", tag = "trials", operation_id = "read_trial",
    params(TrialPath, IfNoneMatch), responses((status = 200, description = "The trial.", body = TrialView)))]
pub(crate) async fn read(trial: Named<TrialView>) -> ApiResult<Response> {
    trial.read().await
}

/// Changes a trial's number, session, units, note or plant, or leaves it out of curves and comparisons.
#[utoipa::path(patch, path = "/v1/trials/{trial}", tag = "trials", operation_id = "change_trial",
    params(TrialPath, IfMatch),
    request_body(content((TrialPatchBody = "application/merge-patch+json"), (TrialPatchBody = "application/json"))),
    responses((status = 200, description = "The trial as it is now.", body = TrialView),
        (status = 409, description = "Another trial of the subject has this number, or analyses used the trial on its \
            present plant.")))]
pub(crate) async fn patch(
    trial: Named<TrialView>,
    MergePatch(body): MergePatch<TrialPatchBody>,
) -> ApiResult<Response> {
    let mut patch = TrialPatch {
        number: body.number.map(|Integer(number)| in_range(number, 1, "/number")).transpose()?,
        session: match body.session {
            Some(Some(Integer(session))) => Some(Some(in_range(session, 0, "/session")?)),
            Some(None) => Some(None),
            None => None,
        },
        units: body.units.change()?,
        note: body.note.map(|note| checks::description(&note.unwrap_or_default(), "/note")).transpose()?,
        excluded: match body.excluded {
            Some(Some(Exclusion { reason })) => Some(Some(checks::reason(&reason, "/excluded/reason")?)),
            Some(None) => Some(None),
            None => None,
        },
        plant: None,
    };
    if let Some(plant) = body.plant {
        patch.plant = on_plant(&trial.state, trial.id, plant).await?;
    }
    trial.change(patch).await
}

/// What was measured and doubted of a trial, on another plant; `None` where it is on that plant already.
async fn on_plant(state: &AppState, trial: TrialId, plant: PlantId) -> ApiResult<Option<OnPlant>> {
    let record = state.store.trial(trial).await?;
    if record.plant == plant {
        return Ok(None);
    }
    let wanted = unless_missing(state.store.plant(plant).await)?.filter(|wanted| wanted.study == record.study);
    let Some(wanted) = wanted else {
        let detail = format!("the study of the trial has no plant {plant}");
        return Err(Problem::new(Code::Invalid, "no such plant", detail)
            .at("/plant")
            .mend(format!("GET /v1/studies/{}/plants lists those that there are.", record.study))
            .into());
    };
    let before = state.store.plant(record.plant).await?;
    let recording = state.store.trial_signals(trial).await?;
    let (metrics, mut warnings) = off_thread(move || {
        // What does not hang on the plant was said of the file, and stays.
        let of_before = doubts(&recording, &before.model);
        let mut kept = record.warnings;
        kept.retain(|warning| !of_before.contains(warning));
        kept.extend(doubts(&recording, &wanted.model));
        (serde_json::to_value(time_domain::metrics(&recording, &wanted.model)), kept)
    })
    .await?;
    warnings.dedup();
    let metrics = metrics.map_err(|error| {
        tracing::error!(%error, "metrics could not be written");
        internal()
    })?;
    Ok(Some(OnPlant { plant, metrics, warnings }))
}

/// Deletes a trial with its recording and the analyses that used it, and overwrites what they held.
#[utoipa::path(delete, path = "/v1/trials/{trial}", tag = "trials", operation_id = "delete_trial",
    params(TrialPath, IfMatch), responses((status = 204, description = "It is gone.")))]
pub(crate) async fn delete(trial: Named<TrialView>) -> ApiResult<Response> {
    trial.delete().await
}
