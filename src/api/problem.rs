//! Everything that goes wrong leaves as `application/problem+json` (RFC 9457).
//!
//! Handlers answer with an [`ApiError`]; it travels as an extension of the response to [the fence around all routes](super::router()), which
//! knows the request's id and writes the body.

use crate::analysis::{Code, Problem};
use crate::store::StoreError;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The media type of every problem.
pub const PROBLEM_JSON: &str = "application/problem+json";

/// The HTTP status that belongs to a code.
#[must_use]
pub fn status_of(code: Code) -> StatusCode {
    match code {
        Code::Malformed => StatusCode::BAD_REQUEST,
        Code::Invalid | Code::BadSignal | Code::Unaffordable | Code::NotIdentifiable | Code::Numerical => {
            StatusCode::UNPROCESSABLE_ENTITY
        }
        Code::NotFound => StatusCode::NOT_FOUND,
        Code::Conflict => StatusCode::CONFLICT,
        Code::PreconditionFailed => StatusCode::PRECONDITION_FAILED,
        Code::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
        Code::UnsupportedMediaType => StatusCode::UNSUPPORTED_MEDIA_TYPE,
        Code::NotAcceptable => StatusCode::NOT_ACCEPTABLE,
        Code::MethodNotAllowed => StatusCode::METHOD_NOT_ALLOWED,
        Code::DeadlineExceeded => StatusCode::REQUEST_TIMEOUT,
        Code::Busy => StatusCode::SERVICE_UNAVAILABLE,
        Code::WorkerDied | Code::Internal => StatusCode::INTERNAL_SERVER_ERROR,
    }
}

/// A problem on its way out.
#[derive(Debug, Clone)]
pub struct ApiError {
    problem: Box<Problem>,
    status: StatusCode,
    headers: HeaderMap,
}

/// What handlers return.
pub type ApiResult<T> = Result<T, ApiError>;

impl ApiError {
    /// The problem itself.
    #[must_use]
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// Answers with another status than the code's own.
    #[must_use]
    pub fn with_status(mut self, status: StatusCode) -> Self {
        self.status = status;
        self
    }

    /// Adds a header.
    #[must_use]
    pub fn with_header(mut self, name: HeaderName, value: HeaderValue) -> Self {
        self.headers.insert(name, value);
        self
    }
}

impl From<Problem> for ApiError {
    fn from(problem: Problem) -> Self {
        let status = status_of(problem.code);
        let mut headers = HeaderMap::new();
        if problem.code == Code::Busy {
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static("5"));
        }
        Self { problem: Box::new(problem), status, headers }
    }
}

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        of_store(&error).into()
    }
}

/// The problem that a store error is to the outside; what only concerns the operator goes to the log.
#[must_use]
pub fn of_store(error: &StoreError) -> Problem {
    match error {
        StoreError::NotFound { noun, id } => {
            Problem::new(Code::NotFound, format!("no such {noun}"), format!("there is no {noun} {id}"))
                .mend("Check the id; it may have been deleted.")
        }
        StoreError::Conflict { rule, detail } => Problem::new(Code::Conflict, rule.replace('_', " "), detail.clone()),
        StoreError::Stale { .. } => {
            Problem::new(Code::PreconditionFailed, "changed since it was read", error.to_string())
                .at("header If-Match")
                .mend("Read it again, and repeat the request with the new ETag.")
        }
        StoreError::KeyReused => {
            Problem::new(Code::Invalid, "idempotency key used before", "the key was used for a different request")
                .at("header Idempotency-Key")
                .mend("Use a new key for each new request.")
        }
        _ => {
            tracing::error!(%error, "store failed");
            if error.is_transient() {
                return Problem::new(
                    Code::Busy,
                    "the database is busy",
                    "the database did not take the request in time",
                )
                .mend("Try again in a few seconds.");
            }
            internal()
        }
    }
}

/// A defect; the log has the rest.
#[must_use]
pub fn internal() -> Problem {
    Problem::new(
        Code::Internal,
        "the server failed",
        "something went wrong that is not the fault of the request; the server's log says what",
    )
    .mend("Report the problem's instance to whoever runs the server.")
}

/// Marks a response whose body is still to be written from a problem.
#[derive(Debug, Clone)]
pub(super) struct Unwritten(pub(super) Box<Problem>);

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let mut response = self.status.into_response();
        response.headers_mut().extend(self.headers);
        response.extensions_mut().insert(Unwritten(self.problem));
        response
    }
}

/// A problem as it is written (RFC 9457).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(example = serde_json::json!({
    "type": "urn:volition:problem:invalid", "title": "unknown kind of analysis", "status": 422,
    "detail": "there is no kind 'sisd'", "instance": "urn:uuid:0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10",
    "code": "invalid", "where": "/kind", "mend": "Use one of: frequency_response, ssid, two_stimulus, gain_fit, inverse_lqr, inverse_lqe, inverse_lqg."
}))]
pub struct HttpProblem {
    /// What sort of problem: `urn:volition:problem:` and the code.
    #[serde(rename = "type")]
    pub type_uri: String,
    /// What is wrong, in a few words.
    pub title: String,
    /// The HTTP status.
    #[schemars(range(min = 400, max = 599))]
    pub status: u16,
    /// Why it is wrong, with the values at hand.
    pub detail: String,
    /// The request's id, as in the header `X-Request-Id` and in the server's log.
    pub instance: String,
    /// The code on its own; programs branch on this.
    pub code: Code,
    /// Where: a JSON pointer into the body (`/spec/pool`), a column and row, a query parameter, a header.
    #[serde(rename = "where", skip_serializing_if = "Option::is_none", default)]
    pub location: Option<String>,
    /// How to mend it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub mend: Option<String>,
}

impl HttpProblem {
    /// The problem as answered with `status` to the request named `instance`.
    #[must_use]
    pub fn new(problem: Problem, status: StatusCode, instance: String) -> Self {
        let Problem { type_uri, title, detail, code, location, mend } = problem;
        Self { type_uri, title, status: status.as_u16(), detail, instance, code, location, mend }
    }
}

/// The problem for an error response that came from a library and not from a handler.
pub(super) fn of_status(status: StatusCode, method: &str, path: &str) -> Problem {
    match status {
        StatusCode::NOT_FOUND => Problem::new(Code::NotFound, "no such route", format!("there is nothing at {path}"))
            .mend("GET /openapi.json lists every route, /docs shows them."),
        StatusCode::METHOD_NOT_ALLOWED => {
            Problem::new(Code::MethodNotAllowed, "method not allowed", format!("{path} does not take {method}"))
                .mend("The Allow header lists the methods that it takes.")
        }
        StatusCode::PAYLOAD_TOO_LARGE => Problem::new(Code::TooLarge, "too large", "the request is too large"),
        StatusCode::UNSUPPORTED_MEDIA_TYPE => Problem::new(
            Code::UnsupportedMediaType,
            "unsupported media type",
            "the body's media type is not taken here",
        ),
        status if status.is_client_error() => Problem::new(
            Code::Malformed,
            "bad request",
            format!("the request cannot be read ({})", status.canonical_reason().unwrap_or("client error")),
        ),
        _ => internal(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn store_errors_keep_their_reason_and_hide_the_database() {
        let not_found = of_store(&StoreError::NotFound { noun: "trial", id: "7".into() });
        assert_eq!((not_found.code, not_found.detail.as_str()), (Code::NotFound, "there is no trial 7"));
        let damaged = of_store(&StoreError::Damaged("page 7 of /srv/lab.db".into()));
        assert_eq!(damaged.code, Code::Internal);
        assert!(!format!("{damaged}").contains("lab.db"));
        let stale = ApiError::from(StoreError::Stale { noun: "study" });
        assert_eq!(stale.status, StatusCode::PRECONDITION_FAILED);
    }
}
