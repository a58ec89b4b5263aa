//! Reading requests; whatever is wrong with one is said with its place.

use super::problem::{ApiError, ApiResult};
use super::state::AppState;
use crate::analysis::{Code, Problem};
use axum::body::{Body, Bytes};
use axum::extract::{FromRequest, FromRequestParts, Query, RawPathParams, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Uri, header};
use futures::StreamExt;
use serde::de::DeserializeOwned;
use serde_path_to_error::Segment;
use std::str::FromStr;
use uuid::Uuid;

/// JSON above this many bytes is parsed on a blocking thread.
const SMALL_JSON: usize = 64 << 10;

/// An id in the path; each route has at most one.
#[derive(Debug, Clone, Copy)]
pub struct Id<T>(pub T);

impl<T: FromStr + Send, S: Send + Sync> FromRequestParts<S> for Id<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> ApiResult<Self> {
        let params = RawPathParams::from_request_parts(parts, state)
            .await
            .map_err(|rejection| Problem::new(Code::Malformed, "unreadable path", rejection.body_text()).at("path"))?;
        let Some((name, text)) = params.iter().next() else {
            return Err(super::problem::internal().into());
        };
        match parse_id(text) {
            Some(id) => Ok(Self(id)),
            None => Err(not_an_id(&format!("path parameter {name}"), text).into()),
        }
    }
}

/// An id from text: a hyphenated UUID.
pub(super) fn parse_id<T: FromStr>(text: &str) -> Option<T> {
    if text.len() != 36 || Uuid::try_parse(text).is_err() {
        return None;
    }
    text.parse().ok()
}

pub(super) fn not_an_id(location: &str, text: &str) -> Problem {
    Problem::new(Code::Malformed, "not an id", format!("'{}' is not an id", shortened(text)))
        .at(location)
        .mend("Ids are hyphenated UUIDs, such as 0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10.")
}

/// Text as it may be quoted in a problem.
pub(super) fn shortened(text: &str) -> String {
    match text.char_indices().nth(80) {
        None => text.to_owned(),
        Some((at, _)) => format!("{}…", &text[..at]),
    }
}

/// A header as text to quote.
pub(super) fn header_text(headers: &HeaderMap, name: &HeaderName) -> String {
    headers.get(name).map_or_else(String::new, |value| shortened(&String::from_utf8_lossy(value.as_bytes())))
}

/// The query of a request, taken apart parameter by parameter.
#[derive(Debug)]
pub struct QueryText {
    pairs: Vec<(String, String)>,
    known: Vec<&'static str>,
}

/// What a route takes from the query.
pub trait FromQuery: Sized {
    /// Takes its parameters.
    ///
    /// # Errors
    /// A problem that names the parameter.
    fn from_query(query: &mut QueryText) -> Result<Self, Problem>;
}

impl QueryText {
    /// Names and values, decoded.
    ///
    /// # Errors
    /// `malformed`, where the query is no query.
    pub fn pairs(uri: &Uri) -> Result<Vec<(String, String)>, Problem> {
        Query::<Vec<(String, String)>>::try_from_uri(uri)
            .map(|Query(pairs)| pairs)
            .map_err(|rejection| Problem::new(Code::Malformed, "unreadable query", rejection.body_text()).at("query"))
    }

    /// The value of a parameter, at most once.
    ///
    /// # Errors
    /// `malformed`, where it is given more than once.
    pub fn take(&mut self, name: &'static str) -> Result<Option<String>, Problem> {
        self.known.push(name);
        let mut values = self.pairs.extract_if(.., |(key, _)| key == name).map(|(_, value)| value);
        let value = values.next();
        if values.next().is_some() {
            return Err(Problem::new(
                Code::Malformed,
                "repeated parameter",
                format!("'{name}' is given more than once"),
            )
            .at(format!("query parameter {name}"))
            .mend("Give it once."));
        }
        Ok(value)
    }

    fn bad(name: &str, text: &str, wanted: &str) -> Problem {
        Problem::new(Code::Malformed, "bad query parameter", format!("'{}' is not {wanted}", shortened(text)))
            .at(format!("query parameter {name}"))
    }

    /// An id.
    ///
    /// # Errors
    /// `malformed`, where it is none.
    pub fn id<T: FromStr>(&mut self, name: &'static str) -> Result<Option<T>, Problem> {
        let Some(text) = self.take(name)? else { return Ok(None) };
        parse_id(&text).map(Some).ok_or_else(|| not_an_id(&format!("query parameter {name}"), &text))
    }

    /// An integer from `min` to `max`.
    ///
    /// # Errors
    /// `malformed`, where it is none.
    pub fn integer(&mut self, name: &'static str, min: i64, max: i64) -> Result<Option<i64>, Problem> {
        let Some(text) = self.take(name)? else { return Ok(None) };
        match text.parse::<i64>() {
            Ok(value) if (min..=max).contains(&value) => Ok(Some(value)),
            _ => Err(Self::bad(name, &text, &format!("an integer from {min} to {max}"))),
        }
    }

    /// A finite number.
    ///
    /// # Errors
    /// `malformed`, where it is none.
    pub fn number(&mut self, name: &'static str) -> Result<Option<f64>, Problem> {
        let Some(text) = self.take(name)? else { return Ok(None) };
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Some(value)),
            _ => Err(Self::bad(name, &text, "a finite number")),
        }
    }

    /// `true` or `false`; `false` without it.
    ///
    /// # Errors
    /// `malformed`, where it is neither.
    pub fn flag(&mut self, name: &'static str) -> Result<bool, Problem> {
        match self.take(name)?.as_deref() {
            None | Some("false") => Ok(false),
            Some("true") => Ok(true),
            Some(text) => Err(Self::bad(name, text, "true or false")),
        }
    }

    /// One of the names that `parse` knows.
    ///
    /// # Errors
    /// `malformed`, where it knows no such name.
    pub fn one_of<T>(
        &mut self,
        name: &'static str,
        known: &str,
        parse: impl Fn(&str) -> Option<T>,
    ) -> Result<Option<T>, Problem> {
        let Some(text) = self.take(name)? else { return Ok(None) };
        parse(&text).map(Some).ok_or_else(|| Self::bad(name, &text, &format!("one of {known}")))
    }

    fn finish(self) -> Result<(), Problem> {
        let Some((name, _)) = self.pairs.first() else { return Ok(()) };
        let mut known = self.known;
        known.dedup();
        let mend = if known.is_empty() {
            "This route takes no query parameters.".to_owned()
        } else {
            format!("This route takes: {}.", known.join(", "))
        };
        Err(Problem::new(
            Code::Malformed,
            "unknown query parameter",
            format!("there is no parameter '{}'", shortened(name)),
        )
        .at(format!("query parameter {}", shortened(name)))
        .mend(mend))
    }
}

impl FromQuery for () {
    fn from_query(_: &mut QueryText) -> Result<Self, Problem> {
        Ok(())
    }
}

impl<A: FromQuery, B: FromQuery> FromQuery for (A, B) {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok((A::from_query(query)?, B::from_query(query)?))
    }
}

/// The query parameters of a route; any others are refused by name.
#[derive(Debug, Clone, Copy)]
pub struct Params<T>(pub T);

impl<T: FromQuery, S: Send + Sync> FromRequestParts<S> for Params<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> ApiResult<Self> {
        let mut query = QueryText { pairs: QueryText::pairs(&parts.uri)?, known: Vec::new() };
        let params = T::from_query(&mut query)?;
        query.finish()?;
        Ok(Self(params))
    }
}

/// The media type of a body in lower case, without parameters.
pub(super) fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    Some(value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
}

pub(super) fn unsupported(headers: &HeaderMap, wanted: &str) -> Problem {
    let given = match headers.get(header::CONTENT_TYPE) {
        None => "the request has no Content-Type".to_owned(),
        Some(_) => format!("the body is '{}'", header_text(headers, &header::CONTENT_TYPE)),
    };
    Problem::new(Code::UnsupportedMediaType, "unsupported media type", given)
        .at("header Content-Type")
        .mend(format!("Send {wanted}."))
}

/// How the body is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Identity,
    Gzip,
}

/// The content encoding of a body.
pub(super) fn encoding(headers: &HeaderMap) -> Result<Encoding, Problem> {
    let text = header_text(headers, &header::CONTENT_ENCODING);
    match text.trim().to_ascii_lowercase().as_str() {
        "" | "identity" => Ok(Encoding::Identity),
        "gzip" | "x-gzip" => Ok(Encoding::Gzip),
        _ => Err(Problem::new(
            Code::UnsupportedMediaType,
            "unsupported content encoding",
            format!("the body is packed as '{text}'"),
        )
        .at("header Content-Encoding")
        .mend("Send it as it is, or packed by gzip where the route takes that.")),
    }
}

/// The whole body, as it came over the wire.
pub(super) async fn read_body(state: &AppState, headers: &HeaderMap, body: Body) -> ApiResult<Vec<u8>> {
    let limit = state.limits.max_body_bytes;
    let too_large = |size: String| {
        ApiError::from(
            Problem::new(
                Code::TooLarge,
                "body too large",
                format!("the body has {size}, and {limit} bytes are taken at most"),
            )
            .at("body")
            .mend("Pack it with gzip where the route takes that, or send it in several requests."),
        )
        .with_header(header::CONNECTION, HeaderValue::from_static("close"))
    };
    let declared = headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    if let Some(size) = declared
        && size > limit as u64
    {
        return Err(too_large(format!("{size} bytes")));
    }
    let mut bytes = Vec::with_capacity(declared.unwrap_or(0) as usize);
    let mut stream = body.into_data_stream();
    loop {
        match tokio::time::timeout(state.limits.body_stall, stream.next()).await {
            Ok(None) => return Ok(bytes),
            Ok(Some(Ok(chunk))) => {
                if bytes.len() + chunk.len() > limit {
                    return Err(too_large(format!("more than {limit} bytes")));
                }
                bytes.extend_from_slice(&chunk);
            }
            Ok(Some(Err(error))) => {
                return Err(Problem::new(
                    Code::Malformed,
                    "the body broke off",
                    format!("after {} bytes: {error}", bytes.len()),
                )
                .at("body")
                .into());
            }
            Err(_) => {
                return Err(Problem::new(
                    Code::DeadlineExceeded,
                    "the body stalled",
                    format!("nothing came for {} s after {} bytes", state.limits.body_stall.as_secs(), bytes.len()),
                )
                .at("body")
                .into());
            }
        }
    }
}

/// Runs blocking or long work away from the threads that serve requests.
pub(super) async fn off_thread<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> ApiResult<T> {
    match tokio::task::spawn_blocking(work).await {
        Ok(value) => Ok(value),
        Err(error) => {
            if error.is_panic() {
                // The fence logs it and answers.
                std::panic::resume_unwind(error.into_panic());
            }
            tracing::error!(%error, "blocking work was cancelled");
            Err(super::problem::internal().into())
        }
    }
}

/// A JSON body, with its bytes for idempotency.
#[derive(Debug, Clone)]
pub struct Json<T> {
    /// What it says.
    pub value: T,
    /// How it said it.
    pub bytes: Bytes,
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
pub struct MergePatch<T>(pub T);

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
            Code::UnsupportedMediaType,
            "unsupported content encoding",
            "this route takes no gzip",
        )
        .at("header Content-Encoding")
        .mend("Send the body as it is.")
        .into());
    }
    let bytes = Bytes::from(read_body(state, headers, body).await?);
    let value = if bytes.len() <= SMALL_JSON {
        from_json_object(&bytes)?
    } else {
        let bytes = bytes.clone();
        off_thread(move || from_json_object(&bytes)).await??
    };
    Ok(Json { value, bytes })
}

/// A JSON object as the struct `T`.
///
/// # Errors
/// `malformed` with line and column where it is not JSON; `invalid` with the pointer of the field where it says
/// something else than `T`.
pub fn from_json_object<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    // serde takes an array for a struct, field by field; nobody means that.
    if bytes.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'[') {
        from_json::<serde::de::IgnoredAny>(bytes)?;
        return Err(not_an_object("an array", "/"));
    }
    from_json(bytes)
}

fn not_an_object(found: &str, pointer: &str) -> Problem {
    Problem::new(Code::Invalid, "unexpected value", format!("there is {found}, where an object belongs")).at(pointer)
}

/// JSON as `T`.
///
/// # Errors
/// As [`from_json_object`].
pub fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err(Problem::new(Code::Malformed, "no JSON", "the body is empty").at("body"));
    }
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let pointer = pointer_of(error.path());
        of_json(error.inner(), &pointer)
    })?;
    deserializer.end().map_err(|error| of_json(&error, ""))?;
    Ok(value)
}

/// A JSON object inside a body, at `pointer`, as the struct `T`.
///
/// # Errors
/// `invalid` with the pointer of the field.
pub fn from_value<T: DeserializeOwned>(value: &serde_json::Value, pointer: &str) -> Result<T, Problem> {
    if !value.is_object() {
        return Err(not_an_object("something else", pointer));
    }
    serde_path_to_error::deserialize(value)
        .map_err(|error| of_json(error.inner(), &format!("{pointer}{}", pointer_of(error.path()))))
}

fn of_json(error: &serde_json::Error, pointer: &str) -> Problem {
    use serde_json::error::Category;
    let text = error.to_string();
    let said = text.rsplit_once(" at line ").map_or(text.as_str(), |(said, _)| said);
    match error.classify() {
        Category::Data => {
            let pointer = match field_named(said) {
                Some(field) if !pointer.ends_with(&format!("/{}", escaped(field))) => {
                    format!("{pointer}/{}", escaped(field))
                }
                _ => pointer.to_owned(),
            };
            let location = if pointer.is_empty() { "/".to_owned() } else { pointer };
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

fn escaped(segment: &str) -> String {
    segment.replace('~', "~0").replace('/', "~1")
}

fn pointer_of(path: &serde_path_to_error::Path) -> String {
    path.iter().fold(String::new(), |mut pointer, segment| {
        match segment {
            Segment::Seq { index } => pointer.push_str(&format!("/{index}")),
            Segment::Map { key } => pointer.push_str(&format!("/{}", escaped(key))),
            Segment::Enum { .. } | Segment::Unknown => {}
        }
        pointer
    })
}

/// For fields of a merge patch: a field that is there is `Some`, whatever it is (`null` too, where `T` takes that).
pub(super) fn present<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: serde::Deserializer<'de>,
    T: serde::Deserialize<'de>,
{
    T::deserialize(deserializer).map(Some)
}

/// An integer, also where it is written as `3.0`, as programs do that know only one sort of number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Integer(pub i64);

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
pub(super) fn or_default<'de, D, T>(deserializer: D) -> Result<T, D::Error>
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

    #[test]
    fn queries_are_checked_by_name() {
        let read = |text: &str| {
            let uri: Uri = format!("/x?{text}").parse().unwrap();
            let mut query = QueryText { pairs: QueryText::pairs(&uri).unwrap(), known: vec![] };
            let limit = query.integer("limit", 1, 5)?;
            query.finish()?;
            Ok::<_, Problem>(limit)
        };
        assert_eq!(read("limit=5").unwrap(), Some(5));
        assert_eq!(read("").unwrap(), None);
        for (text, place) in [
            ("limit=6", "query parameter limit"),
            ("limit=", "query parameter limit"),
            ("limit=1&limit=1", "query parameter limit"),
            ("limits=1", "query parameter limits"),
        ] {
            assert_eq!(read(text).unwrap_err().location.unwrap(), place, "{text}");
        }
    }
}
