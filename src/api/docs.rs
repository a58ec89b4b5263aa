//! The API's own description, and pages to read it.

use super::etag::{IfNoneMatch, conditional_bytes};
use super::extract::Params;
use super::problem::ApiResult;
use axum::http::HeaderMap;
use axum::response::Response;
use utoipa_swagger_ui::{Config, SwaggerUi};

/// The OpenAPI document, as `volition openapi` writes it and as it is committed at `openapi/openapi.json`.
#[must_use]
pub fn document() -> String {
    serde_json::to_string_pretty(&super::openapi()).unwrap_or_default()
}

/// This document.
#[utoipa::path(get, path = "/openapi.json", tag = "operations", operation_id = "openapi", params(IfNoneMatch),
    responses((status = 200, description = "An OpenAPI 3.1 document.", body = serde_json::Value)))]
pub(crate) async fn read(Params(()): Params<()>, headers: HeaderMap) -> ApiResult<Response> {
    Ok(conditional_bytes(&headers, "application/json", document().into_bytes()))
}

/// Pages that show the document; everything they load comes from this server.
pub(super) fn pages() -> axum::Router<super::AppState> {
    SwaggerUi::new("/docs").config(Config::new(["/openapi.json"]).use_base_layout()).into()
}
