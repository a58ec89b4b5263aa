//! The samples that an analysis made, as a table.

use super::analyses::{AnalysisPath, AnalysisView, report_text};
use super::etag::{self, IfNoneMatch};
use super::extract::off_thread;
use super::named::Named;
use super::problem::ApiResult;
use crate::analysis::{Code, Problem, Report, samples};
use axum::response::Response;

/// Downloads the samples of a report as CSV, as they are to be played: a judged excitation, a designed input or target.
#[utoipa::path(get, path = "/v1/analyses/{analysis}/samples", tag = "analyses", operation_id = "read_samples",
    params(AnalysisPath, IfNoneMatch),
    responses(
        (status = 200, description = "The samples, the signal first. Every number reads back as the same double.",
            content((String = "text/csv", example = "t,signal\r\n0.0,0.0\r\n"))),
        (status = 404, description = "There is no such analysis, or its result carries no samples."),
        (status = 409, description = "There is no report: the analysis is not finished, failed, or was cancelled.")))]
pub(crate) async fn read(analysis: Named<AnalysisView>) -> ApiResult<Response> {
    let text = report_text(&analysis.state, analysis.id).await?;
    let written = off_thread(move || {
        let report: Report = serde_json::from_str(&text)
            .map_err(|error| Problem::new(Code::Internal, "unreadable report", error.to_string()))?;
        samples::csv(&report)
    })
    .await?;
    Ok(etag::conditional_bytes(&analysis.headers, "text/csv; charset=utf-8; header=present", written?.into_bytes()))
}
