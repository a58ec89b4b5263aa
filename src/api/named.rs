//! What the routes of one stored thing have in common: conditional reads, conditional changes, deletion.

use super::etag::{self, require_match};
use super::extract::{Id, Params};
use super::idempotency::mark;
use super::problem::{ApiError, ApiResult};
use super::state::AppState;
use super::{created, no_content};
use crate::store::{Change, Created, Noun};
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use serde::Serialize;
use std::str::FromStr;

/// A stored thing as clients see it.
pub(super) trait View: Serialize + From<Self::Record> + Send {
    /// What the store keeps.
    type Record: Noun<Id: FromStr> + Clone;
}

/// The thing that the path names, with the request's headers. The route takes no query.
pub(super) struct Named<V: View> {
    pub(super) state: AppState,
    pub(super) id: <V::Record as Noun>::Id,
    pub(super) headers: HeaderMap,
}

impl<V: View> FromRequestParts<AppState> for Named<V> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &AppState) -> ApiResult<Self> {
        let Id(id) = Id::from_request_parts(parts, state).await?;
        let Params(()) = Params::from_request_parts(parts, state).await?;
        Ok(Self { state: state.clone(), id, headers: parts.headers.clone() })
    }
}

impl<V: View> Named<V> {
    /// The thing; 304 where the client has it already.
    pub(super) async fn read(self) -> ApiResult<Response> {
        etag::conditional(&self.headers, &V::from(self.state.store.read(self.id).await?))
    }

    /// The version that a change is meant for; `None` where it is meant for any.
    async fn if_match(&self) -> ApiResult<Option<i64>> {
        if !etag::is_conditional(&self.headers) {
            return Ok(None);
        }
        let record: V::Record = self.state.store.read(self.id).await?;
        let version = record.version();
        require_match(&self.headers, &V::from(record), version)
    }

    /// Changes the thing, and answers with what it is then.
    pub(super) async fn change(self, patch: <V::Record as Change>::Patch) -> ApiResult<Response>
    where
        V::Record: Change,
    {
        let if_match = self.if_match().await?;
        let changed: V::Record = self.state.store.change(self.id, patch, if_match).await?;
        etag::tagged(StatusCode::OK, &V::from(changed))
    }

    /// Deletes the thing.
    pub(super) async fn delete(self) -> ApiResult<Response> {
        let if_match = self.if_match().await?;
        self.state.store.delete::<V::Record>(self.id, if_match).await?;
        Ok(no_content())
    }
}

/// The answer to the creation of a thing that is found under its id in `folder`.
pub(super) fn made<V: View>(made: &Created<V::Record>, folder: &str) -> ApiResult<Response> {
    let record = made.clone().into_inner();
    let location = format!("{folder}/{}", record.id());
    let response = etag::tagged(StatusCode::CREATED, &V::from(record))?;
    Ok(mark(created(response, location), made))
}
