//! What went wrong, as a page where a page was asked for.

use super::frame::{Dress, is_interface};
use super::layout::{Head, Place, refused};
use crate::api::{HttpProblem, PROBLEM_JSON};
use axum::body::to_bytes;
use axum::extract::Request;
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;
use maud::{Markup, html};

/// A problem is never larger.
const MOST_BYTES: usize = 1 << 20;

/// Turns problems into pages for browsers, everywhere but in the interface.
pub(super) async fn as_pages(request: Request, next: Next) -> Response {
    let is_page = !is_interface(request.uri().path()) && wants_html(request.headers());
    let dress = Dress::of(request.headers());
    let response = next.run(request).await;
    let is_problem = response.headers().get(header::CONTENT_TYPE).is_some_and(|media| media == PROBLEM_JSON);
    if !(is_page && is_problem) {
        return response;
    }
    let (parts, body) = response.into_parts();
    let bytes = to_bytes(body, MOST_BYTES).await.unwrap_or_default();
    match serde_json::from_slice::<HttpProblem>(&bytes) {
        Ok(problem) => write(&problem, parts.status, dress, kept(&parts.headers)),
        Err(_) => Response::from_parts(parts, bytes.into()),
    }
}

/// The headers that stay as they are.
fn kept(headers: &HeaderMap) -> HeaderMap {
    let own = [header::RETRY_AFTER, header::ALLOW, header::HeaderName::from_static("x-request-id")];
    own.into_iter().filter_map(|name| Some((name.clone(), headers.get(&name)?.clone()))).collect()
}

fn wants_html(headers: &HeaderMap) -> bool {
    let accepted = headers.get_all(header::ACCEPT).into_iter().filter_map(|value| value.to_str().ok());
    accepted.flat_map(|value| value.split(',')).any(|range| range.trim().starts_with("text/html"))
}

fn write(problem: &HttpProblem, status: StatusCode, dress: Dress, headers: HeaderMap) -> Response {
    let mut letters = problem.title.chars();
    let title: String = letters.next().into_iter().flat_map(char::to_uppercase).chain(letters).collect();
    let head = Head::new(Place::Elsewhere, &title);
    let body = html! {
        section.card.problem {
            (parts(&problem.detail, problem.location.as_deref(), problem.mend.as_deref()))
            p.muted {
                "Status " (status.as_u16())
                @if !problem.instance.is_empty() { " · this request is in the server's log as " code
                    { (problem.instance) } }
            }
            p { a.button href="/" { "To the studies" } }
        }
    };
    refused(status, dress, &head, &body, headers)
}

/// Detail, place and advice of a problem, in this order.
pub(super) fn parts(detail: &str, place: Option<&str>, mend: Option<&str>) -> Markup {
    html! {
        p { (detail) }
        @if let Some(place) = place { p { b { "Where: " } code { (place) } } }
        @if let Some(mend) = mend { p { b { "What to do: " } (mend) } }
    }
}
