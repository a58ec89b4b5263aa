//! What a report found, as other programs compute with it.

use super::analyses::{AnalysisPath, report_text};
use super::etag::IfNoneMatch;
use super::extract::{Id, Params, off_thread};
use super::forms::{self, AcceptForm, Form, FormQuery};
use super::problem::ApiResult;
use super::state::AppState;
use crate::analysis::ids::AnalysisId;
use crate::analysis::{Code, Problem, Report};
use crate::exchange::models::{self, ModelExport};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;

/// The models and matrices of a report, for python-control, MATLAB and others: coefficients in descending powers, the
/// time base said beside them, delays apart, and the response at a few frequencies to compare with. Estimated
/// parameters come with their standard errors, intervals and, where the report has it, their covariance.
///
/// As MATLAB file: a struct for each model, a variable for each matrix.
#[utoipa::path(get, path = "/v1/analyses/{analysis}/model", tag = "analyses", operation_id = "read_model",
    params(AnalysisPath, FormQuery, AcceptForm, IfNoneMatch),
    responses(
        (status = 200, description = "The models.",
            content((ModelExport = "application/json"), (String = "application/x-matlab-data"))),
        (status = 404, description = "There is no such analysis, or its result has no models."),
        (status = 406, description = "Neither application/json nor application/x-matlab-data is acceptable."),
        (status = 409, description = "There is no report: the analysis is not finished, failed, or was cancelled.")))]
pub(crate) async fn read(
    State(state): State<AppState>,
    Id(id): Id<AnalysisId>,
    Params(form): Params<FormQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let form = form.choose(&headers, &[Form::Json, Form::Mat])?;
    let text = report_text(&state, id).await?;
    let written = off_thread(move || {
        let report: Report = serde_json::from_str(&text)
            .map_err(|error| Problem::new(Code::Internal, "unreadable report", error.to_string()))?;
        let export = models::export(&report)?;
        match form {
            Form::Mat => Ok(models::mat(&export)),
            _ => super::etag::to_json(&export),
        }
    })
    .await?;
    Ok(forms::file(&headers, form, &format!("model-{id}"), written?))
}
