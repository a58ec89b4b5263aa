//! Entity tags and the preconditions that use them (RFC 9110, section 13).

use super::extract::header_text;
use super::problem::{ApiResult, RequestCode};
use crate::analysis::Problem;
use crate::num::hexadecimal::hexadecimal;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use sha2::{Digest, Sha256};
use utoipa::IntoParams;

/// A strong entity tag, with its quotes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ETag(String);

impl ETag {
    /// The tag of these bytes.
    #[must_use]
    pub(crate) fn of_bytes(bytes: &[u8]) -> Self {
        Self(format!("\"{}\"", &hexadecimal(&Sha256::digest(bytes))[..32]))
    }

    /// The tag of something that is never changed, named by text that is safe in a header.
    #[must_use]
    pub(crate) fn of_name(name: &str) -> Self {
        Self(format!("\"{name}\""))
    }

    /// As a header value.
    ///
    /// # Panics
    /// Never: tags are made of visible ASCII.
    #[must_use]
    pub(crate) fn value(&self) -> HeaderValue {
        HeaderValue::from_str(&self.0).unwrap_or_else(|_| HeaderValue::from_static("\"\""))
    }
}

/// What stands at the end of the tag of a packed answer: the bytes are others, and so is their strong tag.
const PACKED: &str = "-gzip";

/// The tag of the same answer packed.
fn packed(tag: &str) -> Option<String> {
    Some(format!("{}{PACKED}\"", tag.strip_suffix('"').filter(|_| tag.starts_with('"'))?))
}

/// The tag of the same answer as it is.
fn unpacked(tag: &str) -> String {
    tag.strip_suffix(&format!("{PACKED}\"")).map_or_else(|| tag.to_owned(), |tag| format!("{tag}\""))
}

/// Gives packed answers a tag of their own (RFC 9110, section 8.8.3.3), and repeats it where nothing has changed since.
pub(super) async fn tag_packed(request: Request, next: Next) -> Response {
    let known = listed(request.headers(), &header::IF_NONE_MATCH).unwrap_or_default();
    let known: Vec<String> = known.into_iter().filter(|tag| unpacked(tag) != **tag).map(str::to_owned).collect();
    let mut response = next.run(request).await;
    let headers = response.headers();
    let is_packed = headers.get(header::CONTENT_ENCODING).is_some_and(|encoding| encoding == "gzip");
    let is_unchanged = response.status() == StatusCode::NOT_MODIFIED;
    let tag = headers.get(header::ETAG).and_then(|tag| tag.to_str().ok()).and_then(packed);
    if let Some(tag) = tag.filter(|tag| is_packed || is_unchanged && known.contains(tag))
        && let Ok(value) = HeaderValue::from_str(&tag)
    {
        response.headers_mut().insert(header::ETAG, value);
    }
    response
}

/// Header of a conditional read.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "documents a header that is read from the header map")]
pub(crate) struct IfNoneMatch {
    /// The ETag of an earlier answer; where nothing has changed since, the answer is 304 without a body.
    #[param(rename = "If-None-Match", required = false, nullable = false, value_type = Option<String>)]
    if_none_match: Option<String>,
}

/// Header of a conditional write.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "documents a header that is read from the header map")]
pub(crate) struct IfMatch {
    /// The ETag of the state that the change is meant for; where it has changed since, nothing is done and the answer
    /// is 412.
    #[param(rename = "If-Match", required = false, nullable = false, value_type = Option<String>)]
    if_match: Option<String>,
}

/// The tags listed in a header; `None` without that header.
fn listed<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<Vec<&'a str>> {
    let mut tags = Vec::new();
    let mut present = false;
    for value in headers.get_all(name) {
        present = true;
        tags.extend(value.to_str().unwrap_or_default().split(',').map(str::trim).filter(|tag| !tag.is_empty()));
    }
    present.then_some(tags)
}

/// Whether the client has this state already (`If-None-Match`, weak comparison).
#[must_use]
pub(crate) fn is_known(headers: &HeaderMap, tag: &ETag) -> bool {
    listed(headers, &header::IF_NONE_MATCH).is_some_and(|tags| {
        tags.iter().any(|known| *known == "*" || unpacked(known.strip_prefix("W/").unwrap_or(known)) == tag.0)
    })
}

/// Whether a change may go ahead on what `current` is at the moment; if it is conditional, the version to require.
///
/// # Errors
/// A `precondition_failed` problem when `If-Match` names another state (strong comparison).
pub(crate) fn require_match<T: Serialize>(headers: &HeaderMap, current: &T, version: i64) -> ApiResult<Option<i64>> {
    let Some(tags) = listed(headers, &header::IF_MATCH) else { return Ok(None) };
    let tag = ETag::of_bytes(&to_json(current)?);
    if tags.iter().any(|wanted| *wanted == "*" || unpacked(wanted) == tag.0) {
        return Ok(Some(version));
    }
    Err(Problem::new(
        RequestCode::PreconditionFailed,
        "changed since it was read",
        format!("its ETag is {} now, and If-Match asks for {}", tag.0, header_text(headers, &header::IF_MATCH)),
    )
    .at("header If-Match")
    .mend("Read it again, and repeat the request with the new ETag.")
    .into())
}

/// Whether a request is conditional on `If-Match` at all.
#[must_use]
pub(crate) fn is_conditional(headers: &HeaderMap) -> bool {
    headers.contains_key(header::IF_MATCH)
}

pub(super) fn to_json<T: Serialize>(value: &T) -> Result<Vec<u8>, Problem> {
    serde_json::to_vec(value).map_err(|error| {
        tracing::error!(%error, "an answer could not be written as JSON");
        super::problem::internal()
    })
}

/// A JSON answer with its ETag.
///
/// # Errors
/// `internal`, if the value cannot be written.
pub(crate) fn tagged<T: Serialize>(status: StatusCode, value: &T) -> ApiResult<Response> {
    let bytes = to_json(value)?;
    let tag = ETag::of_bytes(&bytes);
    Ok(tagged_bytes(status, "application/json", &tag, bytes))
}

/// A JSON answer to a conditional read: 304 where the client has it already.
///
/// # Errors
/// `internal`, if the value cannot be written.
pub(crate) fn conditional<T: Serialize>(headers: &HeaderMap, value: &T) -> ApiResult<Response> {
    Ok(conditional_bytes(headers, "application/json", to_json(value)?))
}

/// Bytes in answer to a conditional read: 304 where the client has them already.
#[must_use]
pub(crate) fn conditional_bytes(headers: &HeaderMap, media_type: &'static str, bytes: Vec<u8>) -> Response {
    let tag = ETag::of_bytes(&bytes);
    if is_known(headers, &tag) { not_modified(&tag) } else { tagged_bytes(StatusCode::OK, media_type, &tag, bytes) }
}

/// 304 with the tag.
#[must_use]
pub(crate) fn not_modified(tag: &ETag) -> Response {
    (StatusCode::NOT_MODIFIED, [(header::ETAG, tag.value()), (header::CACHE_CONTROL, NO_CACHE)]).into_response()
}

/// Caches must ask each time.
pub(super) const NO_CACHE: HeaderValue = HeaderValue::from_static("no-cache");

/// Bytes with their type and tag.
#[must_use]
pub(crate) fn tagged_bytes(status: StatusCode, media_type: &'static str, tag: &ETag, bytes: Vec<u8>) -> Response {
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(media_type)),
        (header::ETAG, tag.value()),
        (header::CACHE_CONTROL, NO_CACHE),
    ];
    (status, headers, bytes).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(name: HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_str(value).unwrap())])
    }

    #[test]
    fn reads_compare_weakly_and_writes_strongly() {
        let tag = ETag::of_bytes(&to_json(&7).unwrap());
        let text = tag.value().to_str().unwrap().to_owned();
        let packed = packed(&text).unwrap();
        assert_eq!((packed.len(), unpacked(&packed)), (text.len() + 5, text.clone()));
        for value in [text.clone(), format!("W/{text}"), format!("\"x\", {text}"), "*".into(), packed.clone()] {
            assert!(is_known(&headers(header::IF_NONE_MATCH, &value), &tag), "{value}");
        }
        assert!(!is_known(&headers(header::IF_NONE_MATCH, "\"x\""), &tag));
        assert_eq!(require_match(&HeaderMap::new(), &7, 3).unwrap(), None);
        assert_eq!(require_match(&headers(header::IF_MATCH, &text), &7, 3).unwrap(), Some(3));
        assert_eq!(require_match(&headers(header::IF_MATCH, "*"), &7, 3).unwrap(), Some(3));
        assert_eq!(require_match(&headers(header::IF_MATCH, &packed), &7, 3).unwrap(), Some(3));
        for value in [format!("W/{text}"), "\"x\"".into(), "nonsense".into()] {
            let error = require_match(&headers(header::IF_MATCH, &value), &7, 3).unwrap_err();
            assert_eq!(error.problem().code, RequestCode::PreconditionFailed.into(), "{value}");
        }
    }
}
