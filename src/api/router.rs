//! Routes, layers, and the OpenAPI document that both come from.

use super::accept::{Offers, honour, media_types};
use super::cross_origin::cross_origin;
use super::etag::tag_packed;
use super::guard::guard;
use super::index::{Resource, ResourceMethod};
use super::problem::{HttpProblem, PROBLEM_JSON};
use super::state::AppState;
use super::{
    analyses, comparison, docs, events, figures, frequency_responses, index, kinds, learning_curves, median_subjects,
    models, ops, plants, samples, schema, signals, studies, study_analyses, study_table, subjects, trial_lists, trials,
    trust, upload,
};
use axum::Router;
use axum::middleware::{from_fn, from_fn_with_state};
use serde_json::Value;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{NotForContentType, Predicate as _, SizeAbove};
use utoipa::openapi::header::HeaderBuilder;
use utoipa::openapi::path::{Operation, ParameterIn, PathItem};
use utoipa::openapi::schema::{Schema, Type};
use utoipa::openapi::{ContentBuilder, ObjectBuilder, Ref, RefOr, Response};
use utoipa::{OpenApi as _, ToSchema as _};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "Volition",
        description = "Identifies the control law behind recorded human motion: trials in, subsystem identification \
            and learning curves out.\n\nConventions: JSON in snake_case with units in names; transfer functions `{num, \
            den, sample_time_s}` in descending powers; complex numbers `[re, im]`; ids are UUIDs (version 7); times \
            RFC 3339 UTC; lists in pages by cursor; every problem is `application/problem+json` with a stable `code`, \
            the place (`where`) and advice (`mend`)."
    ),
    tags(
        (name = "studies", description = "The frame of everything else."),
        (name = "plants", description = "What subjects control."),
        (name = "subjects", description = "Who controls it, by pseudonym."),
        (name = "trials", description = "Recordings: command r, control u, output y, disturbance d."),
        (name = "analyses", description = "Everything that takes longer than a request."),
        (name = "learning", description = "What trials say about learning."),
        (name = "figures", description = "Trials, reports and learning as pictures and as the numbers in them."),
        (name = "operations", description = "For whoever runs the server."),
    )
)]
struct Document;

fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(index::read))
        .routes(routes!(kinds::list))
        .routes(routes!(studies::create, studies::list))
        .routes(routes!(studies::read, studies::patch, studies::delete))
        .routes(routes!(plants::create, plants::list))
        .routes(routes!(plants::read, plants::patch, plants::delete))
        .routes(routes!(subjects::create, subjects::list))
        .routes(routes!(subjects::read, subjects::patch, subjects::delete))
        .routes(routes!(upload::upload, trial_lists::of_subject))
        .routes(routes!(trial_lists::of_study))
        .routes(routes!(trials::read, trials::patch, trials::delete))
        .routes(routes!(signals::read))
        .routes(routes!(analyses::create, analyses::list))
        .routes(routes!(study_analyses::create))
        .routes(routes!(study_analyses::progress))
        .routes(routes!(analyses::read, analyses::delete))
        .routes(routes!(analyses::report))
        .routes(routes!(samples::read))
        .routes(routes!(models::read))
        .routes(routes!(analyses::cancel))
        .routes(routes!(events::follow))
        .routes(routes!(trust::read_rule))
        .routes(routes!(trust::of_analysis))
        .routes(routes!(trust::of_trial))
        .routes(routes!(trust::of_study))
        .routes(routes!(study_table::read))
        .routes(routes!(learning_curves::of_subject))
        .routes(routes!(learning_curves::of_study))
        .routes(routes!(comparison::of_study))
        .routes(routes!(frequency_responses::of_study))
        .routes(routes!(median_subjects::of_study))
        .routes(routes!(figures::of_trial::list))
        .routes(routes!(figures::of_trial::read))
        .routes(routes!(figures::of_study::list))
        .routes(routes!(figures::of_study::read))
        .routes(routes!(figures::of_analysis::list))
        .routes(routes!(figures::of_analysis::read))
        .routes(routes!(figures::of_queue::read))
        .routes(routes!(ops::healthz))
        .routes(routes!(ops::readyz))
        .routes(routes!(ops::metrics))
        .routes(routes!(docs::read))
}

/// The whole interface, without pages.
pub fn router(state: AppState) -> Router {
    router_with(Router::new(), state)
}

/// Shorter answers are sent as they are.
const PACKED_FROM: u64 = 860;

/// The interface with other routes beside its own, behind the same guard.
pub(crate) fn router_with(beside: Router<AppState>, state: AppState) -> Router {
    let (router, document) = routes().split_for_parts();
    // Pictures are packed already, and events must not wait until a packet is full.
    let large = SizeAbove::new(PACKED_FROM)
        .and(NotForContentType::new("image/png"))
        .and(NotForContentType::const_new("text/event-stream"));
    let router = router
        .route_layer(from_fn_with_state(Offers::of(&document), honour))
        .layer(CompressionLayer::new().gzip(true).compress_when(large))
        .layer(from_fn(tag_packed))
        .merge(docs::pages())
        .merge(beside)
        .fallback(index::elsewhere);
    // With no origin named, nobody's browser is told anything.
    let router = if state.origins.is_empty() { router } else { router.layer(cross_origin(&state.origins)) };
    router.layer(from_fn_with_state(state.clone(), guard)).with_state(state)
}

/// The OpenAPI document: the operations as the routes say, the schemas as [`schema`] says.
#[must_use]
pub fn openapi() -> Value {
    let (_, mut document) = routes().split_for_parts();
    for item in document.paths.paths.values_mut() {
        item.get.iter_mut().for_each(|operation| complete(operation, false));
        let writing = [&mut item.post, &mut item.patch, &mut item.delete];
        writing.into_iter().flatten().for_each(|operation| complete(operation, true));
    }
    let mut document = serde_json::to_value(document).unwrap_or_default();
    document["components"]["schemas"] = Value::Object(schema::components());
    document
}

/// Every address with what can be done there, as the document says.
pub(super) fn resources() -> Vec<Resource> {
    let (_, document) = routes().split_for_parts();
    let of_item = |(path, item): (String, PathItem)| {
        let operations = [("GET", item.get), ("POST", item.post), ("PATCH", item.patch), ("DELETE", item.delete)];
        let methods = operations.into_iter().filter_map(|(method, operation)| {
            Some(ResourceMethod { method, does: operation?.summary.unwrap_or_default() })
        });
        Resource { path, methods: methods.collect() }
    };
    document.paths.paths.into_iter().map(of_item).collect()
}

/// Adds what all operations of a sort have in common: the problems of the layers around the handlers, and headers.
fn complete(operation: &mut Operation, writes: bool) {
    let parameters = operation.parameters.iter().flatten();
    let (mut in_path, mut if_match, mut if_none_match, mut creates) = (false, false, false, false);
    for parameter in parameters {
        let RefOr::T(parameter) = parameter else { continue };
        in_path |= parameter.parameter_in == ParameterIn::Path;
        if_match |= parameter.name == "If-Match";
        if_none_match |= parameter.name == "If-None-Match";
        creates |= parameter.name == "Idempotency-Key";
    }
    let has_body = operation.request_body.is_some();
    let writes_media = !media_types(operation).is_empty();
    let responses = &mut operation.responses.responses;
    let mut problems = vec![
        ("400", "Something in the request cannot be read: the path, the query, a header or the body."),
        ("421", "The Host or Origin header names another machine."),
        ("500", "The server failed."),
        ("503", "The server is too busy, took too long, or cannot use its database."),
    ];
    if writes {
        problems.push(("507", "The server's disk is full."));
    }
    if in_path {
        problems.push(("404", "There is no such thing."));
    }
    if creates {
        problems.push(("409", "It contradicts something that is stored."));
    }
    if if_match {
        problems.push(("412", "It changed since it was read."));
    }
    if writes_media {
        problems.push(("406", "None of the media types that the client accepts can be written."));
    }
    if has_body {
        problems.extend([
            ("408", "The body stalled."),
            ("413", "The body is too large."),
            ("415", "The body is of another media type or encoding."),
            ("422", "The body can be read, but says something that cannot be done."),
        ]);
    }
    for (status, description) in problems {
        responses.entry(status.to_owned()).or_insert_with(|| RefOr::T(Response::new(description)));
    }
    if if_none_match {
        responses
            .entry("304".to_owned())
            .or_insert_with(|| RefOr::T(Response::new("Nothing has changed since the ETag that the client has.")));
    }
    for (status, response) in responses.iter_mut() {
        let RefOr::T(response) = response else { continue };
        let header = |description: &str| {
            RefOr::T(HeaderBuilder::new().schema(Some(text())).description(Some(description)).build())
        };
        response.headers.insert("X-Request-Id".to_owned(), header("The request's id, as in the server's log."));
        match status.as_str() {
            "200" | "304" if if_none_match => {
                response.headers.insert("ETag".to_owned(), header("Names this state, for conditional requests."));
            }
            "200" if if_match => {
                response.headers.insert("ETag".to_owned(), header("Names the new state, for conditional requests."));
            }
            _ => {}
        }
        if status.starts_with(['4', '5']) {
            response.content.clear();
            let content = ContentBuilder::new().schema(Some(Ref::from_schema_name(HttpProblem::name()))).build();
            response.content.insert(PROBLEM_JSON.to_owned(), RefOr::T(content));
        }
    }
}

fn text() -> Schema {
    ObjectBuilder::new().schema_type(Type::String).into()
}
