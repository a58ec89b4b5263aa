//! Everything that goes wrong leaves as `application/problem+json` (RFC 9457).
//!
//! Handlers answer with an [`ApiError`]; it travels as an extension of the response to [the guard around all
//! routes](super::guard), which knows the request's id and writes the body.

use crate::analysis::problem::ProblemCode;
use crate::analysis::{Code, Problem};
use crate::store::{StoreError, StoreResult, Trouble};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The media type of every problem.
pub(crate) const PROBLEM_JSON: &str = "application/problem+json";

/// What can go wrong with a request itself, whatever it asks for.
///
/// Written in `snake_case`, as the last part of the problem's `type`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RequestCode {
    /// The thing changed since it was read (`If-Match`).
    PreconditionFailed,
    /// The body is of a media type or encoding that the route does not take.
    UnsupportedMediaType,
    /// None of the media types that the client accepts can be written.
    NotAcceptable,
    /// The route exists, the method does not.
    MethodNotAllowed,
    /// The server takes no more work at the moment.
    Busy,
    /// The server's disk is full: nothing of the request was kept.
    StorageFull,
    /// The database cannot be used at the moment: the disk fails or is read-only, or the file is gone.
    StorageFailed,
}

impl ProblemCode for RequestCode {
    fn name(self) -> &'static str {
        match self {
            Self::PreconditionFailed => "precondition_failed",
            Self::UnsupportedMediaType => "unsupported_media_type",
            Self::NotAcceptable => "not_acceptable",
            Self::MethodNotAllowed => "method_not_allowed",
            Self::Busy => "busy",
            Self::StorageFull => "storage_full",
            Self::StorageFailed => "storage_failed",
        }
    }
}

/// What sort of problem an answer is about, stable across versions; clients branch on this and never on the texts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum HttpCode {
    /// With what the request asks for, or with the data in it: also whatever of it cannot be read (header, query, path
    /// and form too), and a body that is too large.
    Analysis(Code),
    /// With the request itself.
    Request(RequestCode),
}

impl ProblemCode for HttpCode {
    fn name(self) -> &'static str {
        match self {
            Self::Analysis(code) => code.name(),
            Self::Request(code) => code.name(),
        }
    }
}

impl From<Code> for HttpCode {
    fn from(code: Code) -> Self {
        Self::Analysis(code)
    }
}

impl From<RequestCode> for HttpCode {
    fn from(code: RequestCode) -> Self {
        Self::Request(code)
    }
}

/// The HTTP status that belongs to a code.
#[must_use]
pub(crate) fn status_of(code: HttpCode) -> StatusCode {
    match code {
        HttpCode::Analysis(code) => match code {
            Code::Malformed => StatusCode::BAD_REQUEST,
            Code::Invalid | Code::BadSignal | Code::Unaffordable | Code::NotIdentifiable | Code::Numerical => {
                StatusCode::UNPROCESSABLE_ENTITY
            }
            Code::NotFound => StatusCode::NOT_FOUND,
            Code::Conflict => StatusCode::CONFLICT,
            Code::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
            Code::DeadlineExceeded => StatusCode::REQUEST_TIMEOUT,
            Code::WorkerDied | Code::Internal => StatusCode::INTERNAL_SERVER_ERROR,
        },
        HttpCode::Request(code) => match code {
            RequestCode::PreconditionFailed => StatusCode::PRECONDITION_FAILED,
            RequestCode::UnsupportedMediaType => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            RequestCode::NotAcceptable => StatusCode::NOT_ACCEPTABLE,
            RequestCode::MethodNotAllowed => StatusCode::METHOD_NOT_ALLOWED,
            RequestCode::Busy | RequestCode::StorageFailed => StatusCode::SERVICE_UNAVAILABLE,
            RequestCode::StorageFull => StatusCode::INSUFFICIENT_STORAGE,
        },
    }
}

/// A problem on its way out.
#[derive(Debug, Clone)]
pub(crate) struct ApiError {
    problem: Box<Problem<HttpCode>>,
    status: StatusCode,
    headers: HeaderMap,
}

/// What handlers return.
pub(crate) type ApiResult<T> = Result<T, ApiError>;

impl ApiError {
    /// The problem itself.
    #[must_use]
    pub(crate) fn problem(&self) -> &Problem<HttpCode> {
        &self.problem
    }

    pub(super) fn into_problem(self) -> Problem<HttpCode> {
        *self.problem
    }

    /// Answers with another status than the code's own.
    #[must_use]
    pub(crate) fn with_status(mut self, status: StatusCode) -> Self {
        self.status = status;
        self
    }

    /// Adds a header.
    #[must_use]
    pub(crate) fn with_header(mut self, name: HeaderName, value: HeaderValue) -> Self {
        self.headers.insert(name, value);
        self
    }
}

impl<C: Into<HttpCode>> From<Problem<C>> for ApiError {
    fn from(problem: Problem<C>) -> Self {
        let Problem { type_uri, title, detail, code, location, mend } = problem;
        let code = code.into();
        let mut headers = HeaderMap::new();
        if code == HttpCode::from(RequestCode::Busy) {
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static("5"));
        }
        let problem = Box::new(Problem { type_uri, title, detail, code, location, mend });
        Self { problem, status: status_of(code), headers }
    }
}

/// What only concerns the operator goes to the log.
impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        match &error {
            StoreError::NotFound { noun, id } => {
                Problem::new(Code::NotFound, format!("no such {noun}"), format!("there is no {noun} {id}"))
                    .mend("Check the id; it may have been deleted.")
                    .into()
            }
            StoreError::Conflict { rule, detail } => {
                let problem = Problem::new(Code::Conflict, rule.replace('_', " "), detail.clone());
                match *rule {
                    "trial_in_use" => problem.at("/plant").mend(
                        "GET /v1/analyses?trial=ID lists them. DELETE each, repeat the change, and ask for them anew; \
                         or leave the trial as it is.",
                    ),
                    "cursor_gone" => problem.at("query parameter cursor").mend("Start without a cursor."),
                    _ => problem,
                }
                .into()
            }
            StoreError::Stale { .. } => {
                Problem::new(RequestCode::PreconditionFailed, "changed since it was read", error.to_string())
                    .at("header If-Match")
                    .mend("Read it again, and repeat the request with the new ETag.")
                    .into()
            }
            StoreError::KeyReused => {
                Problem::new(Code::Invalid, "idempotency key used before", "the key was used for a different request")
                    .at("header Idempotency-Key")
                    .mend("Use a new key for each new request.")
                    .into()
            }
            _ => {
                tracing::error!(%error, "store failed");
                match error.trouble() {
                    Some(trouble) => of_trouble(trouble).into(),
                    None => internal().into(),
                }
            }
        }
    }
}

/// What is wrong with the database for the time being.
pub(super) fn of_trouble(trouble: Trouble) -> Problem<RequestCode> {
    match trouble {
        Trouble::Busy => {
            let detail = "the database did not take the request in time";
            Problem::new(RequestCode::Busy, "the database is busy", detail).mend("Try again in a few seconds.")
        }
        Trouble::Full => {
            let detail = "the server's disk is full, and nothing of the request was kept";
            Problem::new(RequestCode::StorageFull, "the disk is full", detail).mend(
                "Ask whoever runs the server for room, then repeat the request. Reading, cancelling and deleting still \
                 work.",
            )
        }
        Trouble::Unusable => {
            let detail = "the server cannot use its database: the disk fails or is read-only, or the file is gone";
            Problem::new(RequestCode::StorageFailed, "the database cannot be used", detail)
                .mend("Ask whoever runs the server to look at its log, then repeat the request.")
        }
    }
}

/// What the store found; `None` where there is no such thing.
pub(super) fn unless_missing<T>(found: StoreResult<T>) -> ApiResult<Option<T>> {
    match found {
        Ok(found) => Ok(Some(found)),
        Err(StoreError::NotFound { .. }) => Ok(None),
        Err(other) => Err(other.into()),
    }
}

/// A defect; the log has the rest.
#[must_use]
pub(crate) fn internal() -> Problem {
    Problem::new(
        Code::Internal,
        "the server failed",
        "something went wrong that is not the fault of the request; the server's log says what",
    )
    .mend("Report the problem's instance to whoever runs the server.")
}

/// Marks a response whose body is still to be written from a problem.
#[derive(Debug, Clone)]
pub(super) struct Unwritten(pub(super) Box<Problem<HttpCode>>);

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
    "code": "invalid", "where": "/kind",
    "mend": "Use one of: frequency_response, ssid, two_stimulus, gain_fit, inverse_lqr, inverse_lqe, inverse_lqg."
}))]
pub(crate) struct HttpProblem {
    /// What sort of problem: `urn:volition:problem:` and the code.
    #[serde(rename = "type")]
    pub(crate) type_uri: String,
    /// What is wrong, in a few words.
    pub(crate) title: String,
    /// The HTTP status.
    #[schemars(range(min = 400, max = 599))]
    pub(crate) status: u16,
    /// Why it is wrong, with the values at hand.
    pub(crate) detail: String,
    /// The request's id, as in the header `X-Request-Id` and in the server's log.
    pub(crate) instance: String,
    /// The code on its own; programs branch on this.
    pub(crate) code: HttpCode,
    /// Where: a JSON pointer into the body (`/spec/pool`), a column and row, a query parameter, a header.
    #[serde(rename = "where", skip_serializing_if = "Option::is_none", default)]
    pub(crate) location: Option<String>,
    /// How to mend it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub(crate) mend: Option<String>,
}

impl HttpProblem {
    /// The problem as answered with `status` to the request named `instance`.
    #[must_use]
    pub(crate) fn new(problem: Problem<HttpCode>, status: StatusCode, instance: String) -> Self {
        let Problem { type_uri, title, detail, code, location, mend } = problem;
        Self { type_uri, title, status: status.as_u16(), detail, instance, code, location, mend }
    }
}

/// The problem for an error response that came from a library and not from a handler.
pub(super) fn of_status(status: StatusCode, method: &str, path: &str) -> ApiError {
    match status {
        StatusCode::NOT_FOUND => Problem::new(Code::NotFound, "no such route", format!("there is nothing at {path}"))
            .mend("GET /openapi.json lists every route, /docs shows them.")
            .into(),
        StatusCode::METHOD_NOT_ALLOWED => {
            let detail = format!("{path} does not take {method}");
            Problem::new(RequestCode::MethodNotAllowed, "method not allowed", detail)
                .mend("The Allow header lists the methods that it takes.")
                .into()
        }
        StatusCode::PAYLOAD_TOO_LARGE => Problem::new(Code::TooLarge, "too large", "the request is too large").into(),
        StatusCode::UNSUPPORTED_MEDIA_TYPE => {
            let detail = "the body's media type is not taken here";
            Problem::new(RequestCode::UnsupportedMediaType, "unsupported media type", detail).into()
        }
        status if status.is_client_error() => {
            let reason = status.canonical_reason().unwrap_or("client error");
            Problem::new(Code::Malformed, "bad request", format!("the request cannot be read ({reason})")).into()
        }
        _ => internal().into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn store_errors_keep_their_reason_and_hide_the_database() {
        let not_found = ApiError::from(StoreError::NotFound { noun: "trial", id: "7".into() }).problem;
        assert_eq!((not_found.code, not_found.detail.as_str()), (Code::NotFound.into(), "there is no trial 7"));
        let damaged = ApiError::from(StoreError::Damaged("page 7 of /srv/lab.db".into())).problem;
        assert_eq!(damaged.code, Code::Internal.into());
        assert!(!format!("{damaged}").contains("lab.db"));
        let stale = ApiError::from(StoreError::Stale { noun: "study" });
        assert_eq!(stale.status, StatusCode::PRECONDITION_FAILED);
        let full = ApiError::from(StoreError::Full("no room in /srv/lab.db".into()));
        assert_eq!((full.status.as_u16(), full.problem.code), (507, RequestCode::StorageFull.into()));
        assert!(!format!("{}", full.problem).contains("lab.db"));
        let moved = ApiError::from(StoreError::Moved { path: "/srv/lab.db".into(), what: "is gone" });
        assert_eq!((moved.status.as_u16(), moved.problem.code), (503, RequestCode::StorageFailed.into()));
        assert!(!format!("{}", moved.problem).contains("lab.db"));
    }

    #[test]
    fn every_code_is_read_back_as_it_was_written() {
        for (code, name) in [
            (HttpCode::from(Code::TooLarge), "too_large"),
            (RequestCode::PreconditionFailed.into(), "precondition_failed"),
            (RequestCode::UnsupportedMediaType.into(), "unsupported_media_type"),
            (RequestCode::NotAcceptable.into(), "not_acceptable"),
            (RequestCode::MethodNotAllowed.into(), "method_not_allowed"),
            (RequestCode::Busy.into(), "busy"),
            (RequestCode::StorageFull.into(), "storage_full"),
            (RequestCode::StorageFailed.into(), "storage_failed"),
        ] {
            assert_eq!(code.name(), name);
            assert_eq!(serde_json::to_value(code).unwrap(), name);
            assert_eq!(serde_json::from_value::<HttpCode>(name.into()).unwrap(), code);
        }
    }
}
