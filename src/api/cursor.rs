//! Lists in pages by keyset: an opaque token names the last row of the page before.

use super::etag::{conditional, to_json};
use super::extract::{FromQuery, Params, QueryText};
use super::negotiate::{NDJSON, preferred};
use super::problem::{ApiError, ApiResult};
use super::state::AppState;
use crate::analysis::{Code, Problem};
use crate::num::hexadecimal::{self, hexadecimal};
use crate::store::{Page, StoreResult};
use axum::body::Body;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::{IntoResponse as _, Response};
use schemars::JsonSchema;
use serde::Serialize;
use sha2::{Digest, Sha256};
use utoipa::IntoParams;
use uuid::Uuid;

/// Rows of a page unless asked otherwise.
pub(super) const DEFAULT_LIMIT: u32 = 100;
/// Rows of a page at most.
pub(super) const MAX_LIMIT: u32 = 500;
/// Version of the token's layout.
const VERSION: u8 = 1;

/// Which page of a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct PageQuery {
    /// Rows per page; of a stream (`Accept: application/x-ndjson`) rows in all, every one where it is left out.
    #[param(value_type = Option<u32>, nullable = false, minimum = 1, maximum = 500, default = 100)]
    pub(crate) limit: Option<u32>,
    /// The `next_cursor` of the page before, unchanged and with the same filters.
    #[param(value_type = Option<String>, nullable = false, pattern = "^[0-9a-f]{42}$")]
    pub(crate) cursor: Option<Cursor>,
}

/// A place in a list: after the row with this id, of the list with this fingerprint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Cursor {
    list: [u8; 4],
    after: Uuid,
}

impl Cursor {
    fn write(self) -> String {
        let mut bytes = vec![VERSION];
        bytes.extend(self.list);
        bytes.extend(self.after.as_bytes());
        hexadecimal(&bytes)
    }

    fn read(text: &str) -> Option<Self> {
        let bytes: [u8; 21] = hexadecimal::bytes(text)?.try_into().ok()?;
        if bytes[0] != VERSION {
            return None;
        }
        Some(Self { list: bytes[1..5].try_into().ok()?, after: Uuid::from_slice(&bytes[5..]).ok()? })
    }
}

impl FromQuery for PageQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let limit = query.integer("limit", 1, i64::from(MAX_LIMIT))?.map(|limit| limit as u32);
        let cursor = match query.take("cursor")? {
            None => None,
            Some(text) => Some(Cursor::read(&text).ok_or_else(not_a_cursor)?),
        };
        Ok(Self { limit, cursor })
    }
}

fn not_a_cursor() -> Problem {
    Problem::new(
        Code::Malformed,
        "not a cursor of this list",
        "the cursor does not come from this list with these filters",
    )
    .at("query parameter cursor")
    .mend("Give the next_cursor of the page before unchanged, with the same filters; or start without a cursor.")
}

/// One page of a list.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "{T}List")]
pub(crate) struct List<T> {
    /// The rows, in the order in which they were made.
    pub(crate) items: Vec<T>,
    /// Where the next page starts; null on the last one.
    pub(crate) next_cursor: Option<String>,
}

/// A list being paged through: what it lists (path and filters, without the page), and which page.
#[derive(Debug)]
pub(crate) struct Pager {
    list: [u8; 4],
    path: String,
    others: Vec<(String, String)>,
    query: PageQuery,
}

impl Pager {
    /// The page asked for of the list at `uri`.
    ///
    /// # Errors
    /// `malformed` for the cursor of another list.
    pub(crate) fn new(uri: &Uri, query: PageQuery) -> Result<Self, Problem> {
        let others: Vec<_> =
            QueryText::pairs(uri)?.into_iter().filter(|(name, _)| name != "limit" && name != "cursor").collect();
        let mut hasher = Sha256::new();
        hasher.update(uri.path());
        let mut sorted = others.clone();
        sorted.sort();
        for (name, value) in &sorted {
            hasher.update([0]);
            hasher.update(name);
            hasher.update([0]);
            hasher.update(value);
        }
        let digest: [u8; 32] = hasher.finalize().into();
        let list = [digest[0], digest[1], digest[2], digest[3]];
        if query.cursor.is_some_and(|cursor| cursor.list != list) {
            return Err(not_a_cursor());
        }
        Ok(Self { list, path: uri.path().to_owned(), others, query })
    }

    /// What to ask the store for: one row more than the page holds, to know whether there is a next page.
    #[must_use]
    pub(crate) fn page(&self) -> Page {
        Page { after: self.query.cursor.map(|cursor| cursor.after), limit: self.limit() + 1 }
    }

    fn limit(&self) -> u32 {
        self.query.limit.unwrap_or(DEFAULT_LIMIT)
    }

    /// The answer, from the rows that the store gave for [`Pager::page`].
    ///
    /// # Errors
    /// `internal`, if a row cannot be written.
    pub(crate) fn answer<R, T: Serialize>(
        &self,
        headers: &HeaderMap,
        mut rows: Vec<R>,
        id: impl Fn(&R) -> Uuid,
        view: impl Fn(R) -> T,
    ) -> ApiResult<Response> {
        let limit = self.limit() as usize;
        let more = rows.len() > limit;
        rows.truncate(limit);
        let next_cursor = rows.last().filter(|_| more).map(|last| Cursor { list: self.list, after: id(last) }.write());
        let link = next_cursor.as_deref().map(|cursor| self.link(cursor));
        let list = List { items: rows.into_iter().map(view).collect(), next_cursor };
        let mut response = conditional(headers, &list)?;
        if let Some(value) = link.and_then(|link| HeaderValue::from_str(&link).ok()) {
            response.headers_mut().insert(header::LINK, value);
        }
        Ok(response)
    }

    fn link(&self, cursor: &str) -> String {
        let mut query = format!("limit={}&cursor={cursor}", self.limit());
        for (name, value) in &self.others {
            query.push_str(&format!("&{}={}", percent_encoded(name), percent_encoded(value)));
        }
        format!("<{}?{query}>; rel=\"next\"", self.path)
    }
}

/// A request for a page of a list, with what the list is filtered by.
pub(super) struct Paged<F> {
    pub(super) state: AppState,
    pub(super) filter: F,
    pager: Pager,
    headers: HeaderMap,
}

impl<F: FromQuery> FromRequestParts<AppState> for Paged<F> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &AppState) -> ApiResult<Self> {
        let Params((filter, page)) = Params::from_request_parts(parts, state).await?;
        let pager = Pager::new(&parts.uri, page)?;
        Ok(Self { state: state.clone(), filter, pager, headers: parts.headers.clone() })
    }
}

impl<F> Paged<F> {
    /// The answer: a page as JSON, or everything from there on as a stream of lines. `rows` gives a page's rows.
    pub(super) async fn answer<R, T, Rows>(
        &self,
        rows: impl Fn(Page) -> Rows + Send + 'static,
        id: impl Fn(&R) -> Uuid + Send + 'static,
        view: impl Fn(R) -> T + Send + 'static,
    ) -> ApiResult<Response>
    where
        R: Send + 'static,
        T: Serialize,
        Rows: Future<Output = StoreResult<Vec<R>>> + Send + 'static,
    {
        if preferred(&self.headers, &["application/json", NDJSON]) != Some(NDJSON) {
            return self.pager.answer(&self.headers, rows(self.pager.page()).await?, id, view);
        }
        let PageQuery { limit, cursor } = self.pager.query;
        let page = Page { after: cursor.map(|cursor| cursor.after), limit: limit.unwrap_or(MAX_LIMIT) };
        // The first rows come before the answer begins: what is wrong with the request is a problem with its status.
        let first = rows(page).await?;
        let lines = async_stream::stream! {
            let mut found = first;
            loop {
                let last = found.last().map(&id).filter(|_| limit.is_none() && found.len() == MAX_LIMIT as usize);
                yield as_lines(found, &view).map_err(|problem| std::io::Error::other(problem.to_string()));
                let Some(after) = last else { return };
                match rows(Page { after: Some(after), limit: MAX_LIMIT }).await {
                    Ok(next) => found = next,
                    // The connection breaks off, so that nobody takes the lines for all there are.
                    Err(error) => {
                        tracing::error!(%error, "a stream of a list broke off");
                        yield Err(std::io::Error::other(error));
                        return;
                    }
                }
            }
        };
        let headers = [
            (header::CONTENT_TYPE, HeaderValue::from_static(NDJSON)),
            (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
            (header::VARY, HeaderValue::from_static("accept")),
        ];
        Ok((headers, Body::from_stream(lines)).into_response())
    }
}

/// Each row as JSON, on a line of its own.
fn as_lines<R, T: Serialize>(rows: Vec<R>, view: &impl Fn(R) -> T) -> Result<Vec<u8>, Problem> {
    let mut lines = Vec::new();
    for row in rows {
        lines.extend(to_json(&view(row))?);
        lines.push(b'\n');
    }
    Ok(lines)
}

fn percent_encoded(text: &str) -> String {
    text.bytes().fold(String::new(), |mut out, byte| {
        if byte.is_ascii_alphanumeric() || b"-._~".contains(&byte) {
            out.push(char::from(byte));
        } else {
            out.push_str(&format!("%{byte:02X}"));
        }
        out
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cursors_survive_the_wire_and_stay_with_their_list() {
        let uri: Uri = "/v1/analyses?kind=ssid&limit=2".parse().unwrap();
        let pager = Pager::new(&uri, PageQuery { limit: Some(2), cursor: None }).unwrap();
        let cursor = Cursor { list: pager.list, after: Uuid::from_u128(7) };
        assert_eq!(Cursor::read(&cursor.write()), Some(cursor));
        let query = PageQuery { limit: Some(9), cursor: Some(cursor) };
        assert_eq!(Pager::new(&uri, query).unwrap().page(), Page { after: Some(Uuid::from_u128(7)), limit: 10 });
        for other in ["/v1/analyses?kind=frequency_response", "/v1/analyses", "/v1/studies?kind=ssid"] {
            assert_eq!(Pager::new(&other.parse().unwrap(), query).unwrap_err(), not_a_cursor(), "{other}");
        }
        let long = cursor.write();
        for bad in ["", "7", &long[1..], &long.to_uppercase().replace('0', "G"), &long.replacen("01", "02", 1)] {
            assert_eq!(Cursor::read(bad), None, "{bad}");
        }
    }

    #[test]
    fn links_repeat_the_filters() {
        let uri: Uri = "/v1/studies/1/subjects?group=g%C3%A4%26b".parse().unwrap();
        let pager = Pager::new(&uri, PageQuery { limit: Some(2), cursor: None }).unwrap();
        assert_eq!(pager.link("c"), "</v1/studies/1/subjects?limit=2&cursor=c&group=g%C3%A4%26b>; rel=\"next\"");
    }
}
