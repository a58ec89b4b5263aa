//! What every request for a page passes first.

use super::frame::{Dress, THEME, with};
use crate::analysis::{Code, Problem};
use crate::api::ApiError;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};

/// A year.
const KEPT_S: u32 = 31_536_000;

/// Takes `?theme=` off an address: the choice goes into a cookie, and the page is asked for again without it.
///
/// Posts from other sites are refused too: what a page changes is asked for by that page.
pub(super) async fn choose_theme(request: Request, next: Next) -> Response {
    if request.method() == Method::POST && !is_from_here(request.headers()) {
        let problem = Problem::new(Code::Malformed, "foreign form", "the form was sent by a page of another site")
            .at("header Sec-Fetch-Site")
            .mend("Use the button on this server's own page.");
        return ApiError::from(problem).with_status(StatusCode::FORBIDDEN).into_response();
    }
    let query = request.uri().query().unwrap_or_default();
    let chosen = query.split('&').filter_map(|pair| pair.split_once('=')).find(|(name, _)| *name == THEME);
    let Some(dress) = chosen.and_then(|(_, name)| Dress::named(name)) else { return next.run(request).await };
    if request.method() != Method::GET {
        return next.run(request).await;
    }
    let address = request.uri().path_and_query().map_or("/", |address| address.as_str());
    let target = with(address, THEME, None);
    // A path that begins with two slashes, either way, would name another server.
    let target = format!("/{}", target.trim_start_matches(['/', '\\']));
    let cookie = format!("{THEME}={}; Path=/; Max-Age={KEPT_S}; SameSite=Lax", dress.name());
    let mut response = StatusCode::SEE_OTHER.into_response();
    for (name, value) in [(header::LOCATION, target), (header::SET_COOKIE, cookie)] {
        let Ok(value) = HeaderValue::from_str(&value) else { return StatusCode::BAD_REQUEST.into_response() };
        response.headers_mut().insert(name, value);
    }
    response
}

/// Whether a browser says that a form comes from a page of this server; other programs say nothing.
fn is_from_here(headers: &HeaderMap) -> bool {
    headers.get("sec-fetch-site").is_none_or(|site| site == "same-origin" || site == "none")
}
