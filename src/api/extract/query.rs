//! Reading paths and queries, parameter by parameter.

use super::shortened;
use crate::analysis::{Code, Problem};
use crate::api::problem::{ApiError, ApiResult, internal};
use axum::extract::{FromRequestParts, Query, RawPathParams};
use axum::http::Uri;
use axum::http::request::Parts;
use std::str::FromStr;
use uuid::Uuid;

/// An id in the path; each route has at most one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Id<T>(pub(crate) T);

impl<T: FromStr + Send, S: Send + Sync> FromRequestParts<S> for Id<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> ApiResult<Self> {
        let params = RawPathParams::from_request_parts(parts, state)
            .await
            .map_err(|rejection| Problem::new(Code::Malformed, "unreadable path", rejection.body_text()).at("path"))?;
        let Some((name, text)) = params.iter().next() else {
            return Err(internal().into());
        };
        match parse_id(text) {
            Some(id) => Ok(Self(id)),
            None => Err(not_an_id(&format!("path parameter {name}"), text).into()),
        }
    }
}

/// An id from text: a hyphenated UUID.
pub(in crate::api) fn parse_id<T: FromStr>(text: &str) -> Option<T> {
    if text.len() != 36 || Uuid::try_parse(text).is_err() {
        return None;
    }
    text.parse().ok()
}

pub(in crate::api) fn not_an_id(location: &str, text: &str) -> Problem {
    Problem::new(Code::Malformed, "not an id", format!("'{}' is not an id", shortened(text)))
        .at(location)
        .mend("Ids are hyphenated UUIDs, such as 0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10.")
}

/// The query of a request, taken apart parameter by parameter.
#[derive(Debug)]
pub(crate) struct QueryText {
    pairs: Vec<(String, String)>,
    known: Vec<&'static str>,
}

/// What a route takes from the query.
pub(crate) trait FromQuery: Sized {
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
    pub(crate) fn pairs(uri: &Uri) -> Result<Vec<(String, String)>, Problem> {
        Query::<Vec<(String, String)>>::try_from_uri(uri)
            .map(|Query(pairs)| pairs)
            .map_err(|rejection| Problem::new(Code::Malformed, "unreadable query", rejection.body_text()).at("query"))
    }

    /// The value of a parameter, at most once.
    ///
    /// # Errors
    /// `malformed`, where it is given more than once.
    pub(crate) fn take(&mut self, name: &'static str) -> Result<Option<String>, Problem> {
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
    pub(crate) fn id<T: FromStr>(&mut self, name: &'static str) -> Result<Option<T>, Problem> {
        let Some(text) = self.take(name)? else { return Ok(None) };
        parse_id(&text).map(Some).ok_or_else(|| not_an_id(&format!("query parameter {name}"), &text))
    }

    /// An integer from `min` to `max`.
    ///
    /// # Errors
    /// `malformed`, where it is none.
    pub(crate) fn integer(&mut self, name: &'static str, min: i64, max: i64) -> Result<Option<i64>, Problem> {
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
    pub(crate) fn number(&mut self, name: &'static str) -> Result<Option<f64>, Problem> {
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
    pub(crate) fn flag(&mut self, name: &'static str) -> Result<bool, Problem> {
        match self.take(name)?.as_deref() {
            None | Some("false") => Ok(false),
            Some("true") => Ok(true),
            Some(text) => Err(Self::bad(name, text, "true or false")),
        }
    }

    /// `true` or `false`; `None` without it.
    ///
    /// # Errors
    /// `malformed`, where it is neither.
    pub(crate) fn yes_or_no(&mut self, name: &'static str) -> Result<Option<bool>, Problem> {
        self.one_of(name, "true, false", |text| text.parse().ok())
    }

    /// One of the names that `parse` knows.
    ///
    /// # Errors
    /// `malformed`, where it knows no such name.
    pub(crate) fn one_of<T>(
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
pub(crate) struct Params<T>(pub(crate) T);

impl<T: FromQuery, S: Send + Sync> FromRequestParts<S> for Params<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> ApiResult<Self> {
        let mut query = QueryText { pairs: QueryText::pairs(&parts.uri)?, known: Vec::new() };
        let params = T::from_query(&mut query)?;
        query.finish()?;
        Ok(Self(params))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
