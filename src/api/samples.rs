//! The samples that an analysis made, for a device to play.

use super::analyses::{AnalysisPath, report_text};
use super::etag::IfNoneMatch;
use super::extract::{Id, Params, off_thread};
use super::forms::{AcceptForm, FormQuery};
use super::problem::ApiResult;
use super::sequences::{self, WaveQuery};
use super::state::AppState;
use crate::analysis::ids::AnalysisId;
use crate::analysis::{Code, Problem, Report, samples};
use crate::exchange::write::Sequence;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;

/// Downloads the samples of a report, as they are to be played: a judged excitation, a designed input or target, the
/// signals of a simulation.
///
/// CSV, MATLAB and NumPy carry every number as the same double, and the sample time. Sound has one column in single
/// precision, divided by what a sample of 1 stands for, which is said in the file and in Volition-Full-Scale.
#[utoipa::path(get, path = "/v1/analyses/{analysis}/samples", tag = "analyses", operation_id = "read_samples",
    params(AnalysisPath, FormQuery, WaveQuery, AcceptForm, IfNoneMatch),
    responses(
        (status = 200, description = "The samples, the signal first. Every number reads back as the same double.",
            content((String = "text/csv", example = "t,signal\r\n0.0,0.0\r\n"), (String = "application/x-matlab-data"),
                (String = "application/x-npz"), (String = "audio/wav"))),
        (status = 404, description = "There is no such analysis, or its result carries no samples."),
        (status = 406, description = "None of the forms is acceptable."),
        (status = 409, description = "There is no report: the analysis is not finished, failed, or was cancelled."),
        (status = 422, description = "The samples are no sound: no such column, a rate that is no whole number, or a \
            sample above full scale.")))]
pub(crate) async fn read(
    State(state): State<AppState>,
    Id(id): Id<AnalysisId>,
    Params((form, wave)): Params<(FormQuery, WaveQuery)>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let form = form.choose(&headers, sequences::FORMS)?;
    let text = report_text(&state, id).await?;
    let sequence = off_thread(move || {
        let report: Report = serde_json::from_str(&text)
            .map_err(|error| Problem::new(Code::Internal, "unreadable report", error.to_string()))?;
        let found = samples::of(&report)?;
        Ok::<_, Problem>(Sequence { sample_time_s: found.sample_time_s, columns: found.columns })
    })
    .await??;
    sequences::answer(&headers, form, &format!("samples-{id}"), sequence, wave).await
}
