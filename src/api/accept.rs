//! `Accept` is honoured: a route that cannot write what the client accepts refuses before it does anything.

use super::negotiate::{not_acceptable, preferred};
use super::problem::ApiError;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use std::collections::BTreeMap;
use std::sync::Arc;
use utoipa::openapi::path::Operation;
use utoipa::openapi::{OpenApi, RefOr};

/// Which media types each operation answers with when it succeeds, by method and route: as the document says.
#[derive(Debug, Clone)]
pub(super) struct Offers(Arc<BTreeMap<(Method, String), Vec<String>>>);

impl Offers {
    pub(super) fn of(document: &OpenApi) -> Self {
        let mut offers = BTreeMap::new();
        for (route, item) in &document.paths.paths {
            let operations = [
                (Method::GET, &item.get),
                (Method::POST, &item.post),
                (Method::PATCH, &item.patch),
                (Method::DELETE, &item.delete),
            ];
            for (method, operation) in operations {
                let Some(operation) = operation else { continue };
                offers.insert((method, route.clone()), media_types(operation));
            }
        }
        Self(Arc::new(offers))
    }

    fn at(&self, method: &Method, route: &str) -> Option<Vec<&str>> {
        let method = if method == Method::HEAD { Method::GET } else { method.clone() };
        let offered = self.0.get(&(method, route.to_owned()))?;
        (!offered.is_empty()).then(|| offered.iter().map(String::as_str).collect())
    }
}

/// What an operation answers with when it succeeds.
pub(super) fn media_types(operation: &Operation) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    for (status, response) in &operation.responses.responses {
        let RefOr::T(response) = response else { continue };
        if status.starts_with('2') {
            found.extend(response.content.keys().map(|media| media.split(';').next().unwrap_or_default().to_owned()));
        }
    }
    found.sort();
    found.dedup();
    found
}

/// Refuses a request whose answer the client would not accept.
pub(super) async fn honour(State(offers): State<Offers>, request: Request, next: Next) -> Response {
    if request.headers().contains_key(header::ACCEPT)
        && let Some(route) = request.extensions().get::<MatchedPath>()
        && let Some(offered) = offers.at(request.method(), route.as_str())
        && preferred(request.headers(), &offered).is_none()
    {
        return ApiError::from(not_acceptable(request.headers(), &offered)).into_response();
    }
    next.run(request).await
}
