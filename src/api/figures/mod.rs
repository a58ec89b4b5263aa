//! Figures of stored things, drawn on the server.

pub(crate) mod of_analysis;
pub(super) mod of_queue;
pub(crate) mod of_study;
pub(crate) mod of_trial;
mod query;

pub(super) use query::FigureQuery;

use super::etag::{ETag, NO_CACHE, is_known, not_modified};
use super::extract::{off_thread, shortened};
use super::problem::{ApiError, ApiResult, internal};
use super::state::AppState;
use crate::analysis::{Code, Problem};
use crate::figure::{Figure, RENDERER, Theme, ViewError, png, svg, table};
use axum::extract::{FromRequestParts, RawPathParams};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use query::Format;
use schemars::JsonSchema;
use serde::Serialize;
use std::sync::Arc;

/// The figures that a thing offers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct FigureList {
    /// Each by its name.
    figures: Vec<FigureEntry>,
}

/// A figure that is offered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct FigureEntry {
    /// Its name.
    name: String,
    /// What it shows.
    title: String,
    /// Where it is found.
    link: String,
}

impl FigureList {
    /// The figures of a thing at an address.
    fn new(address: &str, offered: &[Offered]) -> Self {
        let entry = |one: &Offered| FigureEntry {
            name: one.name.to_owned(),
            title: one.title.to_owned(),
            link: format!("{address}/figures/{}", one.name),
        };
        Self { figures: offered.iter().map(entry).collect() }
    }
}

/// A figure by its name, with what it shows.
#[derive(Debug, Clone, Copy)]
struct Offered {
    name: &'static str,
    title: &'static str,
}

/// The name of a figure in the path.
pub(crate) struct FigureName(String);

impl<S: Send + Sync> FromRequestParts<S> for FigureName {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> ApiResult<Self> {
        let params = RawPathParams::from_request_parts(parts, state)
            .await
            .map_err(|rejection| Problem::new(Code::Malformed, "unreadable path", rejection.body_text()).at("path"))?;
        let name = params.iter().find(|(key, _)| *key == "name").map(|(_, value)| Self(value.to_owned()));
        name.ok_or_else(|| internal().into())
    }
}

impl FigureName {
    /// The figure of this name among those that are offered.
    fn among(&self, offered: &[Offered]) -> Result<&'static str, Problem> {
        offered.iter().map(|one| one.name).find(|name| *name == self.0).ok_or_else(|| {
            let names: Vec<&str> = offered.iter().map(|one| one.name).collect();
            let mend = if names.is_empty() {
                "There is no figure of it.".to_owned()
            } else {
                format!("Its figures are: {}.", names.join(", "))
            };
            Problem::new(Code::NotFound, "no such figure", format!("there is no figure '{}' of it", shortened(&self.0)))
                .at("path parameter name")
                .mend(mend)
        })
    }
}

/// The tag of a drawing: what it is made from, how it is drawn, and by which renderer.
fn tag(query: &FigureQuery, made_from: &[&str]) -> ETag {
    let key = format!("{} {RENDERER} {query:?} {}", env!("CARGO_PKG_VERSION"), made_from.join(" "));
    ETag::of_bytes(key.as_bytes())
}

/// The answer to a client that has the drawing already.
fn unchanged(headers: &HeaderMap, tag: &ETag) -> Option<Response> {
    is_known(headers, tag).then(|| not_modified(tag))
}

/// Does work that draws, off the threads that serve requests; few at once.
pub(crate) async fn drawing<T: Send + 'static>(
    state: &AppState,
    work: impl FnOnce() -> T + Send + 'static,
) -> ApiResult<T> {
    let Ok(permit) = Arc::clone(&state.figures).acquire_owned().await else { return Err(internal().into()) };
    off_thread(move || {
        // Held until the drawing is done, also where the client went away meanwhile.
        let _permit = permit;
        work()
    })
    .await
}

/// Answers with a figure, which is made and drawn off the threads that serve requests; few at once. Its tag, unless it
/// is known, is that of its numbers.
async fn answer(
    state: &AppState,
    headers: &HeaderMap,
    query: FigureQuery,
    tag: Option<ETag>,
    figure: impl FnOnce() -> Result<Figure, Problem> + Send + 'static,
) -> ApiResult<Response> {
    query.check()?;
    let known = headers.clone();
    let drawn = drawing(state, move || {
        let figure = figure()?;
        let tag = match tag {
            Some(tag) => tag,
            None => self::tag(&query, &[&super::etag::to_json(&figure).map(|json| sha256(&json))?]),
        };
        if is_known(&known, &tag) {
            return Ok((tag, None));
        }
        let name = figure.name.clone();
        draw(&figure, &query).map(|bytes| (tag, Some((name, bytes))))
    })
    .await?;
    let (tag, drawn) = drawn.map_err(ApiError::from)?;
    let Some((name, bytes)) = drawn else { return Ok(not_modified(&tag)) };
    let place = format!("inline; filename=\"{name}.{}\"", query.format.name());
    let response_headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(query.format.media_type())),
        (header::ETAG, tag.value()),
        (header::CACHE_CONTROL, NO_CACHE),
        (header::CONTENT_DISPOSITION, HeaderValue::from_str(&place).unwrap_or(HeaderValue::from_static("inline"))),
    ];
    Ok((response_headers, bytes).into_response())
}

fn sha256(bytes: &[u8]) -> String {
    use sha2::{Digest as _, Sha256};
    crate::num::hexadecimal::hexadecimal(&Sha256::digest(bytes))
}

/// A figure in the form that was asked for.
fn draw(figure: &Figure, query: &FigureQuery) -> Result<Vec<u8>, Problem> {
    let drawing = query.drawing();
    let seen = figure.drawn(&drawing).map_err(|error| {
        let place = if matches!(error, ViewError::Empty { .. }) { "to" } else { "from" };
        Problem::new(Code::Invalid, "nothing in view", error.to_string())
            .at(format!("query parameter {place}"))
            .mend("Give from and to within the figure's x axis, from below to.")
    })?;
    match query.format {
        Format::Svg => Ok(svg::write(&seen, &drawing).into_bytes()),
        Format::Csv => Ok(table::csv(&seen).into_bytes()),
        Format::Json => super::etag::to_json(&seen),
        Format::Png => png::write(&seen, &drawing).map_err(|error| {
            tracing::error!(%error, figure = seen.name, "a figure could not be drawn");
            internal()
        }),
    }
}

/// Refuses a theme without colours where they are needed.
fn needs_colours(query: &FigureQuery) -> Result<(), Problem> {
    if query.format == Format::Png && query.theme == Theme::Page {
        return Err(Problem::new(Code::Invalid, "no colours", png::PngError::NoColours.to_string())
            .at("query parameter theme")
            .mend("Use light, dark or paper."));
    }
    Ok(())
}
