//! What can be computed.

use super::etag::{self, IfNoneMatch};
use super::extract::Params;
use super::problem::ApiResult;
use crate::analysis::registry::{self, About};
use crate::analysis::{Code, Kind, Problem, Request};
use axum::http::HeaderMap;
use axum::response::Response;
use schemars::JsonSchema;
use serde::Serialize;

/// The kinds of analysis.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct KindList {
    /// They, in the order in which people meet them.
    items: Vec<KindView>,
}

/// A kind of analysis.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "KindDescription")]
pub(crate) struct KindView {
    /// Its name, as `kind` in requests and reports.
    name: Kind,
    /// Its name for people.
    title: String,
    /// What it answers, from what, and by which method.
    summary: String,
    /// Name and version of its result's form, as `schema` in reports.
    schema: String,
    /// A request that succeeds within seconds, as the schema of `links.request` has it.
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    example: Request,
    /// Where its schemas are.
    links: KindLinks,
}

/// The schemas of a kind, as JSON pointers into the OpenAPI document.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct KindLinks {
    /// Of a request.
    request: String,
    /// Of a report.
    report: String,
}

impl KindView {
    fn of(about: &About) -> Result<Self, Problem> {
        let link = |name: &str| format!("/openapi.json#/components/schemas/{}{name}", about.type_prefix());
        Ok(Self {
            name: about.kind,
            title: about.title.to_owned(),
            summary: about.summary.to_owned(),
            schema: about.result_schema(),
            example: serde_json::from_str(about.example)
                .map_err(|error| Problem::new(Code::Internal, "unreadable example", error.to_string()))?,
            links: KindLinks { request: link("Request"), report: link("Report") },
        })
    }
}

/// Lists the kinds of analysis, each with its schemas and an example that runs.
#[utoipa::path(get, path = "/v1/kinds", tag = "analyses", operation_id = "list_kinds", params(IfNoneMatch),
    responses((status = 200, description = "All of them.", body = KindList)))]
pub(crate) async fn list(Params(()): Params<()>, headers: HeaderMap) -> ApiResult<Response> {
    let items = registry::kinds().map(KindView::of).collect::<Result<_, _>>()?;
    etag::conditional(&headers, &KindList { items })
}
