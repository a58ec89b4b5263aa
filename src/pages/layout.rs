//! The frame that all pages have in common.

use super::assets;
use super::frame::{Dress, Frame};
use crate::api::conditional_bytes;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// What a page may load and do: its own files, and nothing else.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; form-action 'self'; \
     base-uri 'none'; frame-ancestors 'none'",
);

/// The places that are named at the top of every page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// Studies and what is in them.
    Studies,
    /// The queue, and analyses.
    Queue,
    /// Recordings that are brought.
    Upload,
    /// Excitations that are designed.
    Excitation,
    /// Anything else.
    Elsewhere,
}

/// The head of a page.
pub(super) struct Head<'a> {
    /// Where in the navigation.
    pub(super) place: Place,
    /// What the page is about; its only first heading.
    pub(super) title: &'a str,
    /// What stands before it, from the outermost, each with its address.
    pub(super) crumbs: Vec<(String, String)>,
    /// What it is, in a line.
    pub(super) lead: Markup,
    /// What can be done, the most usual last.
    pub(super) actions: Markup,
    /// The same as JSON.
    pub(super) json: Option<String>,
    /// Seconds after which a browser without script loads it again.
    pub(super) again_s: Option<u32>,
}

impl<'a> Head<'a> {
    /// With a title alone.
    pub(super) fn new(place: Place, title: &'a str) -> Self {
        let (lead, actions) = (html! {}, html! {});
        Self { place, title, crumbs: Vec::new(), lead, actions, json: None, again_s: None }
    }
}

/// A whole page.
pub(super) fn page(frame: &Frame, head: &Head<'_>, body: &Markup) -> Response {
    let text = document(frame.dress, Some(frame), head, body).into_string();
    dressed(conditional_bytes(&frame.headers, "text/html; charset=utf-8", text.into_bytes()))
}

/// A page that says what went wrong, with its status.
pub(super) fn refused(
    status: StatusCode,
    dress: Dress,
    head: &Head<'_>,
    body: &Markup,
    headers: HeaderMap,
) -> Response {
    let mut response = (status, document(dress, None, head, body).into_string()).into_response();
    response.headers_mut().extend(headers);
    let html = HeaderValue::from_static("text/html; charset=utf-8");
    response.headers_mut().insert(header::CONTENT_TYPE, html);
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    dressed(response)
}

/// A document that stands alone: its style is inside, and it may load nothing at all.
pub(super) fn unframed(response: Response) -> Response {
    let mut response = dressed(response);
    let alone = HeaderValue::from_static("default-src 'none'; style-src 'unsafe-inline'");
    response.headers_mut().insert(header::CONTENT_SECURITY_POLICY, alone);
    response
}

/// With the headers that every page has.
fn dressed(mut response: Response) -> Response {
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_SECURITY_POLICY, POLICY);
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("same-origin"));
    headers.insert(header::VARY, HeaderValue::from_static("Cookie, Accept"));
    response
}

fn document(dress: Dress, frame: Option<&Frame>, head: &Head<'_>, body: &Markup) -> Markup {
    let theme = (dress != Dress::System).then(|| dress.name());
    html! {
        (DOCTYPE)
        html lang="en" data-theme=[theme] {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content=(theme.unwrap_or("light dark"));
                @if let Some(seconds) = head.again_s {
                    noscript { meta http-equiv="refresh" content=(seconds); }
                }
                title { (head.title) " · Volition" }
                link rel="stylesheet" href=(assets::style());
                link rel="icon" type="image/svg+xml" href=(assets::sign());
                @if let Some(json) = &head.json { link rel="alternate" type="application/json" href=(json); }
                script src=(assets::script()) defer {}
            }
            body {
                a.skip href="#main" { "Skip to the content" }
                (top(dress, frame, head.place))
                main #main tabindex="-1" {
                    (heading(head))
                    (body)
                }
                footer {
                    p {
                        "Volition " (env!("CARGO_PKG_VERSION")) " · " a href="/docs" { "API" }
                        @if let Some(json) = &head.json { " · " a href=(json) { "JSON of this page" } }
                        span.keys hidden {
                            " · " button type="button" data-keys="list" { "Keys" }
                            " " button type="button" data-keys="switch" aria-pressed="true" { "Keys are on" }
                        }
                    }
                }
            }
        }
    }
}

fn top(dress: Dress, frame: Option<&Frame>, place: Place) -> Markup {
    let current = |own: Place| (own == place).then_some("page");
    html! {
        header.top {
            nav aria-label="Main" {
                a.sign href="/" {
                    svg viewBox="0 0 24 24" width="22" height="22" aria-hidden="true" {
                        path d="M2 13c3-10 6-10 8-2s4 10 6 4 3-8 6-5" {}
                    }
                    "Volition"
                }
                a href="/" aria-current=[current(Place::Studies)] { "Studies" }
                a href="/queue" aria-current=[current(Place::Queue)] {
                    "Queue"
                    @if let Some(frame) = frame { " " span.count { (frame.busy) } }
                }
                a href="/upload" aria-current=[current(Place::Upload)] { "Upload" }
                a href="/excitation" aria-current=[current(Place::Excitation)] { "Excitation" }
                a href="/docs" { "API" }
            }
            @if let Some(frame) = frame {
                a.button href=(frame.with("theme", Some(dress.next().name()))) data-theme-button=(dress.name()) {
                    i { "Theme: " } span { (dress.name()) }
                }
            }
        }
    }
}

fn heading(head: &Head<'_>) -> Markup {
    html! {
        div.heading {
            div {
                @if !head.crumbs.is_empty() {
                    nav.crumbs aria-label="Where this is" {
                        @for (name, address) in &head.crumbs { a href=(address) { (name) } " / " }
                        span aria-current="page" { (head.title) }
                    }
                }
                h1 { (head.title) }
                @if !head.lead.0.is_empty() { p.lead { (head.lead) } }
            }
            @if !head.actions.0.is_empty() { div.actions { (head.actions) } }
        }
    }
}

/// A card with a heading.
pub(super) fn card(title: &str, more: &Markup, body: &Markup) -> Markup {
    html! {
        section.card {
            div.card-head { h2 { (title) } (more) }
            (body)
        }
    }
}

/// A card that says what is missing, why, and one thing to do.
pub(super) fn missing(title: &str, why: &str, todo: &Markup) -> Markup {
    card(title, &html! {}, &html! { p { (why) } p { (todo) } })
}

/// Markup that was written elsewhere in this program, with everything in it escaped.
pub(super) fn written(text: &str) -> PreEscaped<&str> {
    PreEscaped(text)
}
