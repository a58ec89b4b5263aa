//! For whoever runs the server: health and metrics.

use super::extract::Params;
use super::problem::{ApiError, ApiResult, RequestCode, of_trouble};
use super::state::AppState;
use crate::analysis::Problem;
use crate::cache::{CacheStatistics, Origins};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::Serialize;
use std::fmt::Write as _;

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

/// Whether the server can do its work: a change in the database is safe on its disk.
#[utoipa::path(get, path = "/readyz", tag = "operations", operation_id = "readiness",
    responses((status = 200, description = "It can.", body = Health),
        (status = 503, description = "The database takes no change at the moment.")))]
pub(crate) async fn readyz(State(state): State<AppState>, Params(()): Params<()>) -> ApiResult<Json<Health>> {
    match state.store.ping().await {
        Ok(()) => Ok(Json(HEALTH)),
        Err(error) => {
            tracing::error!(%error, "store failed");
            let code = error.trouble().map_or(RequestCode::Busy, |trouble| of_trouble(trouble).code);
            let detail = match code {
                RequestCode::StorageFull => "the disk is full: the database takes no change but deletions",
                RequestCode::StorageFailed => "the disk fails or is read-only, or the database file is gone",
                _ => "the database takes no change",
            };
            // 503 whatever the reason: whoever asks wants to know whether to send requests here.
            let status = StatusCode::SERVICE_UNAVAILABLE;
            Err(ApiError::from(Problem::new(code, "not ready", detail)).with_status(status))
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
    let damaged = state.store.count_damaged().await?;
    let mut text = String::new();
    let written = (|| {
        writeln!(text, "# HELP volition_analyses Stored analyses by status.")?;
        writeln!(text, "# TYPE volition_analyses gauge")?;
        for (status, count) in analyses {
            writeln!(text, "volition_analyses{{status=\"{}\"}} {count}", status.name())?;
        }
        writeln!(text, "# HELP volition_damaged_rows Stored rows that are damaged, as far as is known.")?;
        writeln!(text, "# TYPE volition_damaged_rows gauge")?;
        writeln!(text, "volition_damaged_rows {damaged}")?;
        writeln!(text, "# HELP volition_connections_replaced_total Database connections lost to commits that failed.")?;
        writeln!(text, "# TYPE volition_connections_replaced_total counter")?;
        writeln!(text, "volition_connections_replaced_total {}", state.store.count_replaced())?;
        write_cache(&state.cache.statistics(), &mut text)?;
        state.telemetry.write(&mut text)
    })();
    if written.is_err() {
        return Err(super::problem::internal().into());
    }
    let media = HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8");
    Ok(([(header::CONTENT_TYPE, media)], text).into_response())
}
