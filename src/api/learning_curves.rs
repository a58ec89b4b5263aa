//! Learning curves of subjects and groups.

use super::etag::IfNoneMatch;
use super::extract::{FromQuery, Id, Params, QueryText, off_thread};
use super::forms::{self, AcceptForm, FormQuery};
use super::learning_inputs::{CurveQuery, gather};
use super::problem::ApiResult;
use super::state::AppState;
use super::studies::StudyPath;
use super::subjects::SubjectPath;
use crate::analysis::Problem;
use crate::analysis::ids::{StudyId, SubjectId};
use crate::exchange::tables::curves;
use crate::learning::{StudyLearningCurves, SubjectLearningCurve, study_learning_curves, subject_learning_curve};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use utoipa::IntoParams;

/// Which group.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct GroupQuery {
    /// Only subjects of this group.
    #[param(nullable = false)]
    pub(crate) group: Option<String>,
}

impl FromQuery for GroupQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self { group: query.take("group")? })
    }
}

/// The learning curve of a subject, one for each plant it worked with: error and distances from the inverse dynamics
/// over its trials.
///
/// Distances come from the newest succeeded `ssid` analysis of each trial with the chosen spec. Divergent trials are
/// named and left out unless asked for.
#[utoipa::path(get, path = "/v1/subjects/{subject}/learning-curves", tag = "learning",
    operation_id = "read_subject_learning_curves", params(SubjectPath, CurveQuery, FormQuery, AcceptForm, IfNoneMatch),
    responses((status = 200, description = "The curves; as a table with a row for each plant, trial and metric.",
            content((SubjectLearningCurve = "application/json"), (String = "text/csv"),
                (String = "application/x-ndjson"))),
        (status = 422, description = "Only prediction_error has joint estimates.")))]
pub(crate) async fn of_subject(
    State(state): State<AppState>,
    Id(id): Id<SubjectId>,
    Params((query, form)): Params<(CurveQuery, FormQuery)>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let form = form.choose(&headers, forms::DOCUMENT)?;
    let subject = state.store.subject(id).await?;
    let mut gathered = gather(&state, subject.study, Some(subject.clone()), None, &query).await?;
    let Some(input) = gathered.subjects.pop() else { return Err(super::problem::internal().into()) };
    let options = query.options();
    let mut curve = off_thread(move || subject_learning_curve(&input, &options)).await?;
    curve.remarks.append(&mut gathered.remarks);
    forms::document(&headers, form, "learning-curves", &curve, curves::of_subject)
}

/// The learning curves of a study's groups on each plant: mean and standard deviation over subjects per trial, with
/// trimmed versions, and the scatter of error against distance from the inverse dynamics.
#[utoipa::path(get, path = "/v1/studies/{study}/learning-curves", tag = "learning",
    operation_id = "read_study_learning_curves", params(StudyPath, GroupQuery, CurveQuery, FormQuery, AcceptForm,
        IfNoneMatch),
    responses((status = 200, description = "The curves; as a table with a row for each group, plant, trial number and \
            metric.",
            content((StudyLearningCurves = "application/json"), (String = "text/csv"),
                (String = "application/x-ndjson"))),
        (status = 422, description = "Only prediction_error has joint estimates.")))]
pub(crate) async fn of_study(
    State(state): State<AppState>,
    Id(id): Id<StudyId>,
    Params(params): Params<(GroupQuery, (CurveQuery, FormQuery))>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let (GroupQuery { group }, (query, form)) = params;
    let form = form.choose(&headers, forms::DOCUMENT)?;
    state.store.study(id).await?;
    let mut gathered = gather(&state, id, None, group, &query).await?;
    let (subjects, options) = (gathered.subjects, query.options());
    let mut curves = off_thread(move || study_learning_curves(&subjects, &options)).await?;
    curves.remarks.append(&mut gathered.remarks);
    forms::document(&headers, form, "learning-curves", &curves, curves::of_study)
}
