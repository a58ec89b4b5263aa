//! The life of an analysis as server-sent events.

use super::analyses::{AnalysisPath, AnalysisView};
use super::named::Named;
use super::problem::{ApiError, ApiResult};
use crate::analysis::{Code, Problem};
use crate::store::AnalysisRecord;
use axum::http::{HeaderValue, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::Serialize;
use std::convert::Infallible;
use std::time::Duration;

/// How often the store is asked. Workers may be other processes, so nothing else could tell.
const INTERVAL: Duration = Duration::from_millis(250);

/// How long the stream may be silent before a comment keeps it open.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// An event of an analysis, as clients read it.
#[derive(Debug, JsonSchema)]
#[allow(dead_code, reason = "documents what is streamed")]
pub(crate) struct AnalysisEvent {
    /// `status`, `progress` or `problem`.
    event: String,
    /// Version of the analysis; problems have none.
    id: Option<String>,
    /// JSON: an Analysis, or a Problem.
    data: String,
}

/// Follows an analysis: an event `status` with the whole analysis at once and whenever its status changes, an event
/// `progress` whenever it got on. The stream ends when the analysis is finished. Where it was deleted meanwhile, the
/// last event is `problem`. The ids of events are versions of the analysis.
#[utoipa::path(get, path = "/v1/analyses/{analysis}/events", tag = "analyses", operation_id = "follow_analysis",
    params(AnalysisPath),
    responses((status = 200,
        description = "Events `status`, `progress`, `problem`; the data of the first two is an Analysis.",
        body = AnalysisEvent, content_type = "text/event-stream")))]
pub(crate) async fn follow(Named { state, id, .. }: Named<AnalysisView>) -> ApiResult<Response> {
    let first = state.store.analysis(id).await?;
    let stream = async_stream::stream! {
        yield Ok::<_, Infallible>(event("status", &first));
        let mut last = first;
        while !last.status.is_final() {
            tokio::select! {
                () = state.shutdown.cancelled() => break,
                () = tokio::time::sleep(INTERVAL) => {}
            }
            match state.store.analysis(id).await {
                Ok(now) => {
                    if now.status != last.status {
                        yield Ok(event("status", &now));
                    } else if now.version != last.version {
                        yield Ok(event("progress", &now));
                    }
                    last = now;
                }
                Err(error) => {
                    yield Ok(named("problem", ApiError::from(error).problem()));
                    break;
                }
            }
        }
    };
    let mut response = Sse::new(stream).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response();
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}

fn event(name: &str, record: &AnalysisRecord) -> Event {
    named(name, &AnalysisView::from(record.clone())).id(record.version.to_string())
}

fn named<T: Serialize>(name: &str, data: &T) -> Event {
    let event = Event::default().event(name);
    match event.clone().json_data(data) {
        Ok(event) => event,
        Err(error) => {
            tracing::error!(%error, "an event could not be written");
            let problem = Problem::new(Code::Internal, "the server failed", "an event could not be written");
            event.data(problem.to_string())
        }
    }
}
