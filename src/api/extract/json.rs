//! Reading JSON, with the pointer of whatever is wrong in it.

use super::body::{Encoding, encoding, media_type, read_body, unsupported};
use super::off_thread;
use super::weight::in_memory;
use crate::analysis::{Code, Problem};
use crate::api::problem::{ApiError, ApiResult, RequestCode, internal};
use crate::api::state::{AppState, ROOM_UNIT};
use crate::trial::pointer;
use axum::body::{Body, Bytes};
use axum::extract::{FromRequest, Request};
use axum::http::{HeaderMap, header};
use serde::de::DeserializeOwned;
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// JSON above this many bytes is parsed on a blocking thread.
const SMALL_JSON: usize = 64 << 10;

/// A JSON body, with its bytes for idempotency.
#[derive(Debug, Clone)]
pub(crate) struct Json<T> {
    /// What it says.
    pub(crate) value: T,
    /// How it said it.
    pub(crate) bytes: Bytes,
    /// The memory that it takes, lent until the request is answered.
    _room: Vec<Arc<OwnedSemaphorePermit>>,
}

impl<T: DeserializeOwned + Send + 'static> FromRequest<AppState> for Json<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &AppState) -> ApiResult<Self> {
        let (parts, body) = request.into_parts();
        read_json(state, &parts.headers, body, "application/json").await
    }
}

/// A JSON merge patch (RFC 7396) on known fields.
#[derive(Debug, Clone)]
pub(crate) struct MergePatch<T>(pub(crate) T);

impl<T: DeserializeOwned + Send + 'static> FromRequest<AppState> for MergePatch<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &AppState) -> ApiResult<Self> {
        let (parts, body) = request.into_parts();
        let json = read_json(state, &parts.headers, body, "application/merge-patch+json").await?;
        Ok(Self(json.value))
    }
}

async fn read_json<T: DeserializeOwned + Send + 'static>(
    state: &AppState,
    headers: &HeaderMap,
    body: Body,
    also: &str,
) -> ApiResult<Json<T>> {
    match media_type(headers) {
        Some(media) if media == "application/json" || media == also => {}
        _ => return Err(unsupported(headers, also).into()),
    }
    if encoding(headers)? != Encoding::Identity {
        return Err(Problem::new(
            RequestCode::UnsupportedMediaType,
            "unsupported content encoding",
            "this route takes no gzip",
        )
        .at("header Content-Encoding")
        .mend("Send the body as it is.")
        .into());
    }
    let declared = headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    let mut room = Vec::new();
    // Before anything of it is held. Who does not say how much it will be is lent the most that is taken.
    let most = state.limits.max_body_bytes as u64;
    match declared {
        Some(size) if size <= SMALL_JSON as u64 || size > most => {}
        size => room.push(lend(&state.json_bodies, size.unwrap_or(most)).await?),
    }
    let bytes = Bytes::from(read_body(state, headers, body).await?);
    if bytes.len() <= SMALL_JSON {
        return Ok(Json { value: from_json_object(&bytes)?, bytes, _room: Vec::new() });
    }
    let looked_at = bytes.clone();
    let takes = off_thread(move || in_memory(&looked_at)).await?;
    let limit = state.limits.max_json_memory_bytes;
    if takes > limit {
        let detail = format!(
            "the JSON takes about {} MiB of memory once it is read, and {} MiB are taken at most",
            takes >> 20,
            limit >> 20
        );
        return Err(Problem::new(Code::TooLarge, "body too large", detail)
            .at("body")
            .mend("Send fewer or shorter lists; upload recordings as trials and name them by id.")
            .into());
    }
    room.push(lend(&state.json_memory, takes).await?);
    let parsed = bytes.clone();
    let value = off_thread(move || from_json_object(&parsed)).await??;
    Ok(Json { value, bytes, _room: room })
}

/// Waits until so many bytes are free, and takes them.
async fn lend(room: &Arc<Semaphore>, bytes: u64) -> ApiResult<Arc<OwnedSemaphorePermit>> {
    let units = u32::try_from(bytes.div_ceil(ROOM_UNIT)).unwrap_or(u32::MAX);
    let permit = Arc::clone(room).acquire_many_owned(units).await.map_err(|_| internal())?;
    Ok(Arc::new(permit))
}

/// A JSON object as the struct `T`.
///
/// # Errors
/// `malformed` with line and column where it is not JSON; `invalid` with the pointer of the field where it says
/// something else than `T`.
pub(crate) fn from_json_object<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    // serde takes an array for a struct, field by field; nobody means that.
    if bytes.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'[') {
        from_json::<serde::de::IgnoredAny>(bytes)?;
        return Err(not_an_object("an array", "/"));
    }
    from_json(bytes)
}

fn not_an_object(found: &str, at: &str) -> Problem {
    Problem::new(Code::Invalid, "unexpected value", format!("there is {found}, where an object belongs")).at(at)
}

/// JSON as `T`.
///
/// # Errors
/// As [`from_json_object`].
pub(crate) fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err(Problem::new(Code::Malformed, "no JSON", "the body is empty").at("body"));
    }
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let place = pointer::below("", error.path());
        of_json(error.inner(), &place)
    })?;
    deserializer.end().map_err(|error| of_json(&error, ""))?;
    Ok(value)
}

/// A JSON object inside a body, at the pointer `at`, as the struct `T`.
///
/// # Errors
/// `invalid` with the pointer of the field.
pub(crate) fn from_value<T: DeserializeOwned>(value: &serde_json::Value, at: &str) -> Result<T, Problem> {
    if !value.is_object() {
        return Err(not_an_object("something else", at));
    }
    serde_path_to_error::deserialize(value).map_err(|error| of_json(error.inner(), &pointer::below(at, error.path())))
}

fn of_json(error: &serde_json::Error, at: &str) -> Problem {
    use serde_json::error::Category;
    let text = error.to_string();
    let said = text.rsplit_once(" at line ").map_or(text.as_str(), |(said, _)| said);
    match error.classify() {
        Category::Data => {
            let place = match field_named(said) {
                Some(field) if !at.ends_with(&pointer::member("", field)) => pointer::member(at, field),
                _ => at.to_owned(),
            };
            let location = if place.is_empty() { "/".to_owned() } else { place };
            Problem::new(Code::Invalid, "unexpected value", said.to_owned()).at(location)
        }
        Category::Syntax | Category::Eof | Category::Io => {
            let problem = Problem::new(Code::Malformed, "not JSON", said.to_owned()).at(format!(
                "body, line {}, column {}",
                error.line(),
                error.column()
            ));
            if said.contains("out of range") || said.contains("expected value") {
                problem.mend("Numbers must be finite and fit a 64-bit float; JSON has no NaN or Infinity.")
            } else {
                problem
            }
        }
    }
}

/// The field that serde's message is about.
fn field_named(said: &str) -> Option<&str> {
    let rest = ["unknown field `", "missing field `", "duplicate field `"].iter().find_map(|p| said.strip_prefix(p))?;
    rest.split('`').next()
}

/// For fields of a merge patch: a field that is there is `Some`, whatever it is (`null` too, where `T` takes that).
pub(in crate::api) fn present<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: serde::Deserializer<'de>,
    T: serde::Deserialize<'de>,
{
    T::deserialize(deserializer).map(Some)
}

/// An integer, also where it is written as `3.0`, as programs do that know only one sort of number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Integer(pub i64);

impl<'de> serde::Deserialize<'de> for Integer {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;

        impl serde::de::Visitor<'_> for Visitor {
            type Value = Integer;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("an integer")
            }

            fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<Integer, E> {
                Ok(Integer(value))
            }

            fn visit_u64<E: serde::de::Error>(self, value: u64) -> Result<Integer, E> {
                i64::try_from(value).map(Integer).map_err(|_| E::custom(format!("{value} is too large an integer")))
            }

            fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<Integer, E> {
                // Beyond 2^53 a double does not say which integer is meant.
                if value.fract() == 0.0 && value.abs() <= 9_007_199_254_740_992.0 {
                    return Ok(Integer(value as i64));
                }
                Err(E::invalid_value(serde::de::Unexpected::Float(value), &self))
            }
        }

        deserializer.deserialize_any(Visitor)
    }
}

/// For fields that may be left out but not be null.
pub(in crate::api) fn or_default<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: serde::Deserializer<'de>,
    T: serde::Deserialize<'de>,
{
    T::deserialize(deserializer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Sample {
        a: Vec<f64>,
        #[serde(default, deserialize_with = "present")]
        b: Option<Option<f64>>,
        #[serde(default, deserialize_with = "present")]
        c: Option<f64>,
    }

    fn problem(text: &str) -> (Code, String) {
        let problem = from_json::<Sample>(text.as_bytes()).unwrap_err();
        (problem.code, problem.location.unwrap())
    }

    #[test]
    fn json_problems_say_where() {
        assert_eq!(problem(r#"{"a":[1,2,"x"]}"#), (Code::Invalid, "/a/2".into()));
        assert_eq!(problem(r#"{"a":[],"x/y":1}"#), (Code::Invalid, "/x~1y".into()));
        assert_eq!(problem("{}"), (Code::Invalid, "/a".into()));
        assert_eq!(problem(r#"{"a":[],"a":[]}"#), (Code::Invalid, "/a".into()));
        assert_eq!(problem(r#"{"a":[],"c":null}"#), (Code::Invalid, "/c".into()));
        let of_object = |text: &str| from_json_object::<Sample>(text.as_bytes()).unwrap_err();
        assert_eq!(of_object("[]").location.unwrap(), "/");
        assert_eq!(of_object(" [[], null, 1]").code, Code::Invalid);
        assert_eq!(of_object("[[]").code, Code::Malformed);
        assert_eq!(problem(r#"{"a":[1,NaN]}"#), (Code::Malformed, "body, line 1, column 9".into()));
        assert_eq!(problem(r#"{"a":[1e999]}"#).0, Code::Malformed);
        assert_eq!(problem(r#"{"a":[1"#).0, Code::Malformed);
        assert_eq!(problem(r#"{"a":[]} {}"#).0, Code::Malformed);
        assert_eq!(problem("  "), (Code::Malformed, "body".into()));
        assert_eq!(from_json::<Sample>(br#"{"a":[],"b":null}"#).unwrap(), Sample { a: vec![], b: Some(None), c: None });
    }

    #[test]
    fn integers_may_be_written_as_floats() {
        for (text, value) in [("3", 3), ("3.0", 3), ("-0.0", 0), ("1e3", 1000)] {
            assert_eq!(from_json::<Integer>(text.as_bytes()).unwrap(), Integer(value), "{text}");
        }
        for text in ["3.5", "1e300", "18446744073709551615", "\"3\"", "null", "true"] {
            assert_eq!(from_json::<Integer>(text.as_bytes()).unwrap_err().code, Code::Invalid, "{text}");
        }
    }
}
