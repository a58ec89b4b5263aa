//! Keys that make a repeated creation harmless.

use super::problem::{ApiError, ApiResult};
use crate::analysis::{Code, Problem};
use crate::num::hexadecimal::hexadecimal;
use crate::store::{Created, IdempotencyKey};
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderName, HeaderValue};
use axum::response::Response;
use sha2::{Digest, Sha256};
use utoipa::IntoParams;

/// The request header.
pub(crate) const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");
/// The response header that says that nothing new was made.
pub(crate) const IDEMPOTENT_REPLAYED: HeaderName = HeaderName::from_static("idempotent-replayed");
/// Characters of a key at most.
const MAX_LENGTH: usize = 255;

/// Header of a creation.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "documents a header that the extractor reads")]
pub(crate) struct IdempotencyHeader {
    /// A key of the client's choosing, new for each new request: where the same request comes again with the same key
    /// (a retry after a lost answer), nothing is made twice, and the answer names what was made the first time.
    #[param(rename = "Idempotency-Key", required = false, nullable = false, value_type = Option<String>,
        min_length = 1, max_length = 255, pattern = "^[!-~]+$", example = "upload-s07-trial-12")]
    idempotency_key: Option<String>,
}

/// The idempotency key of a request, if it has one.
#[derive(Debug, Clone)]
pub(crate) struct Idempotency {
    key: Option<String>,
    /// Method and target, part of what makes requests equal.
    target: String,
}

impl Idempotency {
    /// The key with the hash of the whole request.
    #[must_use]
    pub(crate) fn key(&self, body: &[u8]) -> Option<IdempotencyKey> {
        let key = self.key.clone()?;
        let mut hasher = Sha256::new();
        hasher.update(&self.target);
        hasher.update([0]);
        hasher.update(body);
        Some(IdempotencyKey { key, request_sha256: hexadecimal(&hasher.finalize()) })
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Idempotency {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> ApiResult<Self> {
        let target = format!("{} {}", parts.method, parts.uri);
        let mut values = parts.headers.get_all(IDEMPOTENCY_KEY).iter();
        let Some(value) = values.next() else { return Ok(Self { key: None, target }) };
        let bad = |why: String| {
            Problem::new(Code::Malformed, "bad idempotency key", why)
                .at("header Idempotency-Key")
                .mend("Give one key of 1 to 255 visible ASCII characters, such as a UUID.")
        };
        if values.next().is_some() {
            return Err(bad("the header is given more than once".to_owned()).into());
        }
        let bytes = value.as_bytes();
        if bytes.is_empty() || bytes.len() > MAX_LENGTH {
            return Err(bad(format!("the key has {} characters", bytes.len())).into());
        }
        if let Some(at) = bytes.iter().position(|byte| !byte.is_ascii_graphic()) {
            return Err(bad(format!("character {} of the key is not visible ASCII", at + 1)).into());
        }
        Ok(Self { key: Some(String::from_utf8_lossy(bytes).into_owned()), target })
    }
}

/// Marks the answer where an earlier request had made the thing already.
pub(crate) fn mark<T>(mut response: Response, created: &Created<T>) -> Response {
    if matches!(created, Created::Replayed(_)) {
        response.headers_mut().insert(IDEMPOTENT_REPLAYED, HeaderValue::from_static("true"));
    }
    response
}
