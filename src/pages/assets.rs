//! The style sheet, the script and the sign of all pages, under names that change with their content.

use super::numbers::short_hash;
use crate::analysis::{Code, Problem};
use crate::api::ApiResult;
use crate::figure::page_style;
use axum::extract::Path;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use std::sync::LazyLock;

/// A file for browsers, kept for a year since its name changes with its content.
struct Asset {
    name: String,
    media_type: &'static str,
    text: String,
}

impl Asset {
    fn new(stem: &str, ending: &str, media_type: &'static str, text: String) -> Self {
        Self { name: format!("{stem}.{}.{ending}", short_hash(&text)), media_type, text }
    }
}

static STYLE: LazyLock<Asset> = LazyLock::new(|| {
    Asset::new("page", "css", "text/css; charset=utf-8", format!("{}{}", include_str!("page.css"), page_style()))
});

static SCRIPT: LazyLock<Asset> =
    LazyLock::new(|| Asset::new("page", "js", "text/javascript; charset=utf-8", include_str!("page.js").to_owned()));

static SIGN: LazyLock<Asset> =
    LazyLock::new(|| Asset::new("sign", "svg", "image/svg+xml", include_str!("sign.svg").to_owned()));

fn address(asset: &Asset) -> String {
    format!("/a/{}", asset.name)
}

/// Where the style sheet is.
pub(super) fn style() -> String {
    address(&STYLE)
}

/// The style sheet itself, for a document that stands alone.
pub(super) fn style_text() -> &'static str {
    &STYLE.text
}

/// Where the script is.
pub(super) fn script() -> String {
    address(&SCRIPT)
}

/// Where the sign is.
pub(super) fn sign() -> String {
    address(&SIGN)
}

/// Sends one of them.
pub(super) async fn read(Path(file): Path<String>) -> ApiResult<Response> {
    let known: [&Asset; 3] = [&STYLE, &SCRIPT, &SIGN];
    let Some(asset) = known.into_iter().find(|asset| asset.name == file) else {
        let problem = Problem::new(Code::NotFound, "no such file", "there is no file of this name here");
        return Err(problem.mend("Load the page again: its files have names of their own in each version.").into());
    };
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(asset.media_type)),
        (header::CACHE_CONTROL, HeaderValue::from_static("public, max-age=31536000, immutable")),
        (header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
    ];
    Ok((headers, asset.text.as_str()).into_response())
}
