//! Plants: what subjects control.

use super::checks::{self, NAME_PATTERN};
use super::cursor::{List, PageQuery, Paged};
use super::etag::{IfMatch, IfNoneMatch};
use super::extract::{Id, Json, MergePatch, Params, from_value, present};
use super::idempotency::{Idempotency, IdempotencyHeader};
use super::named::{self, Named, View};
use super::problem::ApiResult;
use super::state::AppState;
use super::studies::StudyPath;
use super::timestamp::Timestamp;
use super::units::UnitsBody;
use crate::analysis::ids::{PlantId, StudyId};
use crate::analysis::{Code, Problem};
use crate::control::Model;
use crate::store::{NewPlant, Plant, PlantPatch, SignalUnits};
use axum::extract::State;
use axum::response::Response;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use time::OffsetDateTime;
use utoipa::IntoParams;

/// A plant. Its model never changes: results were computed with it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Plant")]
pub(crate) struct PlantView {
    /// Its id.
    id: PlantId,
    /// The study that it belongs to.
    study: StudyId,
    /// Its name.
    name: String,
    /// Its model, from control to output.
    model: Model,
    /// The units of what is recorded on it.
    units: SignalUnits,
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

/// A page of plants.
pub(crate) type PlantList = List<PlantView>;

impl View for PlantView {
    type Record = Plant;
}

impl From<Plant> for PlantView {
    fn from(plant: Plant) -> Self {
        let Plant { id, study, name, model, units, version, created_at, updated_at } = plant;
        Self { id, study, name, model, units, version, created_at, updated_at }
    }
}

/// A plant to be made.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "NewPlant", example = serde_json::json!({
    "name": "gm", "model": {"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0], "sample_time_s": null}
}))]
pub(crate) struct NewPlantBody {
    /// Its name, unique within the study: not blank, without control characters.
    #[schemars(length(min = 1, max = 200), extend("pattern" = NAME_PATTERN))]
    name: String,
    /// Its model: a transfer function with coefficients in descending powers, or state space matrices.
    #[schemars(with = "Model")]
    model: Value,
    /// The units of what is recorded on it, as figures write them.
    #[serde(default)]
    units: UnitsBody,
}

/// Changes to a plant.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "PlantPatch")]
pub(crate) struct PlantPatchBody {
    /// A new name.
    #[serde(default, deserialize_with = "present")]
    #[schemars(length(min = 1, max = 200), extend("pattern" = NAME_PATTERN))]
    name: Option<String>,
    /// New units.
    #[serde(default)]
    units: UnitsBody,
}

/// Names a plant in the path.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "documents the path")]
pub(crate) struct PlantPath {
    /// The plant.
    plant: PlantId,
}

/// A model from JSON, checked.
///
/// # Errors
/// `invalid` with the pointer of the field, for a value that is no model and for a model that is no system.
pub(crate) fn model(value: &Value, pointer: &str) -> Result<Model, Problem> {
    let Some(object) = value.as_object() else {
        return Err(Problem::new(Code::Invalid, "no model", "the model is not an object").at(pointer).mend(FORMS));
    };
    let is_transfer_function = ["num", "den"].iter().any(|key| object.contains_key(*key));
    let is_state_space = ["a", "b", "c", "d"].iter().any(|key| object.contains_key(*key));
    let model = match (is_transfer_function, is_state_space) {
        (true, false) => from_value(value, pointer).map(Model::TransferFunction),
        (false, true) => from_value(value, pointer).map(Model::StateSpace),
        (true, true) => {
            Err(Problem::new(Code::Invalid, "no model", "it is a transfer function and a state space model at once")
                .at(pointer))
        }
        (false, false) => {
            Err(Problem::new(Code::Invalid, "no model", "it has neither num and den nor a, b, c, d").at(pointer))
        }
    }
    .map_err(|problem| problem.mend(FORMS))?;
    model
        .shape()
        .map_err(|error| Problem::new(Code::Invalid, "no usable model", error.to_string()).at(pointer).mend(FORMS))?;
    Ok(model)
}

const FORMS: &str = "Give {\"num\", \"den\", \"sample_time_s\"} in descending powers, or row-major \
                     {\"a\", \"b\", \"c\", \"d\", \"sample_time_s\"}; sample_time_s is null in continuous time.";

/// Adds a plant to a study.
#[utoipa::path(post, path = "/v1/studies/{study}/plants", tag = "plants", operation_id = "create_plant",
    params(StudyPath, IdempotencyHeader), request_body = NewPlantBody,
    responses((status = 201, description = "The new plant; Location names it.", body = PlantView)))]
pub(crate) async fn create(
    State(state): State<AppState>,
    Id(study): Id<StudyId>,
    Params(()): Params<()>,
    idempotency: Idempotency,
    body: Json<NewPlantBody>,
) -> ApiResult<Response> {
    let new = NewPlant {
        name: checks::name(&body.value.name, "/name")?,
        model: model(&body.value.model, "/model")?,
        units: body.value.units.new_units()?,
    };
    let made = state.store.create_plant(study, new, idempotency.key(&body.bytes).as_ref()).await?;
    named::made::<PlantView>(&made, "/v1/plants")
}

/// Lists the plants of a study.
#[utoipa::path(get, path = "/v1/studies/{study}/plants", tag = "plants", operation_id = "list_plants",
    params(StudyPath, PageQuery, IfNoneMatch),
    responses((status = 200, description = "A page of plants; as NDJSON all of them, one a line.",
        content((PlantList = "application/json"), (PlantView = "application/x-ndjson")))))]
pub(crate) async fn list(Id(study): Id<StudyId>, list: Paged<()>) -> ApiResult<Response> {
    let store = list.state.store.clone();
    let rows = move |page| {
        let store = store.clone();
        async move { store.plants(study, page).await }
    };
    list.answer(rows, |plant| plant.id.0, PlantView::from).await
}

/// Reads a plant.
#[utoipa::path(get, path = "/v1/plants/{plant}", tag = "plants", operation_id = "read_plant",
    params(PlantPath, IfNoneMatch), responses((status = 200, description = "The plant.", body = PlantView)))]
pub(crate) async fn read(plant: Named<PlantView>) -> ApiResult<Response> {
    plant.read().await
}

/// Renames a plant, or changes the units of its signals. Its model cannot be changed; add another plant instead.
#[utoipa::path(patch, path = "/v1/plants/{plant}", tag = "plants", operation_id = "change_plant",
    params(PlantPath, IfMatch),
    request_body(content((PlantPatchBody = "application/merge-patch+json"), (PlantPatchBody = "application/json"))),
    responses((status = 200, description = "The plant as it is now.", body = PlantView),
        (status = 409, description = "Another plant of the study has this name.")))]
pub(crate) async fn patch(
    plant: Named<PlantView>,
    MergePatch(body): MergePatch<PlantPatchBody>,
) -> ApiResult<Response> {
    let patch = PlantPatch {
        name: body.name.map(|name| checks::name(&name, "/name")).transpose()?,
        units: body.units.change()?,
    };
    plant.change(patch).await
}

/// Deletes a plant; refused while trials were recorded on it.
#[utoipa::path(delete, path = "/v1/plants/{plant}", tag = "plants", operation_id = "delete_plant",
    params(PlantPath, IfMatch), responses((status = 204, description = "It is gone."),
        (status = 409, description = "Trials were recorded on it.")))]
pub(crate) async fn delete(plant: Named<PlantView>) -> ApiResult<Response> {
    plant.delete().await
}
