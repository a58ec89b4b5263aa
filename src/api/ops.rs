//! For whoever runs the server: health and metrics.

use super::extract::Params;
use super::problem::{ApiResult, RequestCode};
use super::state::AppState;
use crate::analysis::Problem;
use crate::cache::{CacheStatistics, Origins};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Upper bounds of the latency histogram, in seconds.
const BUCKETS_S: [f64; 8] = [0.001, 0.005, 0.025, 0.1, 0.5, 2.5, 10.0, 60.0];

/// Counts of answered requests.
#[derive(Debug, Default)]
pub(super) struct HttpTelemetry {
    /// By method, route template and status.
    series: Mutex<BTreeMap<(String, String, u16), Series>>,
}

#[derive(Debug, Default, Clone, Copy)]
struct Series {
    count: u64,
    seconds: f64,
    /// Requests within each bound.
    within: [u64; BUCKETS_S.len()],
}

impl HttpTelemetry {
    pub(super) fn observe(&self, method: &str, route: &str, status: u16, elapsed: Duration) {
        const KNOWN: [&str; 7] = ["GET", "HEAD", "POST", "PATCH", "PUT", "DELETE", "OPTIONS"];
        // Methods are the client's choice; unknown ones share a series, or they could fill the memory.
        let method = if KNOWN.contains(&method) { method } else { "other" };
        let seconds = elapsed.as_secs_f64();
        let mut series = self.series.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = series.entry((method.to_owned(), route.to_owned(), status)).or_default();
        entry.count += 1;
        entry.seconds += seconds;
        for (within, bound) in entry.within.iter_mut().zip(BUCKETS_S) {
            *within += u64::from(seconds <= bound);
        }
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let series = self.series.lock().unwrap_or_else(PoisonError::into_inner).clone();
        writeln!(
            out,
            "# HELP volition_http_request_duration_seconds Time from a request's head to its answer's head."
        )?;
        writeln!(out, "# TYPE volition_http_request_duration_seconds histogram")?;
        for ((method, route, status), series) in series {
            let labels = format!("method=\"{method}\",route=\"{route}\",status=\"{status}\"");
            for (within, bound) in series.within.iter().zip(BUCKETS_S) {
                writeln!(out, "volition_http_request_duration_seconds_bucket{{{labels},le=\"{bound}\"}} {within}")?;
            }
            let Series { count, seconds, .. } = series;
            writeln!(out, "volition_http_request_duration_seconds_bucket{{{labels},le=\"+Inf\"}} {count}")?;
            writeln!(out, "volition_http_request_duration_seconds_sum{{{labels}}} {seconds}")?;
            writeln!(out, "volition_http_request_duration_seconds_count{{{labels}}} {count}")?;
        }
        Ok(())
    }
}

/// That the server lives.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Health {
    /// `ok`.
    #[schemars(example = &"ok")]
    status: &'static str,
    /// Version of the program.
    #[schemars(example = &"0.1.0")]
    version: &'static str,
}

const HEALTH: Health = Health { status: "ok", version: env!("CARGO_PKG_VERSION") };

/// Whether the process answers.
#[utoipa::path(get, path = "/healthz", tag = "operations", operation_id = "health",
    responses((status = 200, description = "It does.", body = Health)))]
pub(crate) async fn healthz(Params(()): Params<()>) -> Json<Health> {
    Json(HEALTH)
}

/// Whether the server can do its work: the database answers.
#[utoipa::path(get, path = "/readyz", tag = "operations", operation_id = "readiness",
    responses((status = 200, description = "It can.", body = Health),
        (status = 503, description = "The database does not answer.")))]
pub(crate) async fn readyz(State(state): State<AppState>, Params(()): Params<()>) -> ApiResult<Json<Health>> {
    match state.store.ping().await {
        Ok(()) => Ok(Json(HEALTH)),
        Err(error) => {
            tracing::error!(%error, "store failed");
            Err(Problem::new(RequestCode::Busy, "not ready", "the database does not answer").into())
        }
    }
}

/// How often the worker of this process found what trials share.
fn write_cache(cache: &CacheStatistics, out: &mut String) -> std::fmt::Result {
    const NAME: &str = "volition_shared_total";
    writeln!(
        out,
        "# HELP {NAME} Pools and their trees that analyses of this process needed, by where they came from."
    )?;
    writeln!(out, "# TYPE {NAME} counter")?;
    for (what, origins) in [("pool", cache.pools), ("trees", cache.trees)] {
        let Origins { memory, store, made } = origins;
        for (from, count) in [("memory", memory), ("cache", store), ("made", made)] {
            writeln!(out, "{NAME}{{what=\"{what}\",from=\"{from}\"}} {count}")?;
        }
    }
    Ok(())
}

/// Request counts, latencies, the queue and the cache, in the Prometheus text format.
#[utoipa::path(get, path = "/metrics", tag = "operations", operation_id = "metrics",
    responses((status = 200, description = "Counters and gauges.", body = String, content_type = "text/plain")))]
pub(crate) async fn metrics(State(state): State<AppState>, Params(()): Params<()>) -> ApiResult<Response> {
    let analyses = state.store.count_by_status().await?;
    let mut text = String::new();
    let written = (|| {
        writeln!(text, "# HELP volition_analyses Stored analyses by status.")?;
        writeln!(text, "# TYPE volition_analyses gauge")?;
        for (status, count) in analyses {
            writeln!(text, "volition_analyses{{status=\"{}\"}} {count}", status.name())?;
        }
        write_cache(&state.cache.statistics(), &mut text)?;
        state.telemetry.write(&mut text)
    })();
    if written.is_err() {
        return Err(super::problem::internal().into());
    }
    let media = HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8");
    Ok(([(header::CONTENT_TYPE, media)], text).into_response())
}
