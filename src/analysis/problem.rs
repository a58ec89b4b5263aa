//! What is wrong, where, why, and how to mend it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// What sort of problem it is, stable across versions; clients branch on this and never on the texts.
///
/// Written in `snake_case`, as the last part of the problem's `type`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Code {
    /// The request cannot be read: broken JSON, CSV, multipart, gzip, header, query or path.
    Malformed,
    /// The request can be read, but says something that cannot be done.
    Invalid,
    /// Recorded data that no analysis could trust: jitter, gaps, NaN, unequal lengths.
    BadSignal,
    /// There is no such thing.
    NotFound,
    /// It contradicts something that is stored.
    Conflict,
    /// The thing changed since it was read (`If-Match`).
    PreconditionFailed,
    /// The body, or what it unpacks to, is larger than the server takes.
    TooLarge,
    /// The body is of a media type or encoding that the route does not take.
    UnsupportedMediaType,
    /// None of the media types that the client accepts can be written.
    NotAcceptable,
    /// The route exists, the method does not.
    MethodNotAllowed,
    /// The computation is larger than the limits allow.
    Unaffordable,
    /// The data cannot answer the question: no power at any line, a plant pole on a line.
    NotIdentifiable,
    /// A numerical method failed on this input.
    Numerical,
    /// The worker that ran it died too often.
    WorkerDied,
    /// The time given has passed.
    DeadlineExceeded,
    /// The server takes no more work at the moment.
    Busy,
    /// A defect of this program, recorded in its log.
    Internal,
}

impl Code {
    /// The name on the wire.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Malformed => "malformed",
            Self::Invalid => "invalid",
            Self::BadSignal => "bad_signal",
            Self::NotFound => "not_found",
            Self::Conflict => "conflict",
            Self::PreconditionFailed => "precondition_failed",
            Self::TooLarge => "too_large",
            Self::UnsupportedMediaType => "unsupported_media_type",
            Self::NotAcceptable => "not_acceptable",
            Self::MethodNotAllowed => "method_not_allowed",
            Self::Unaffordable => "unaffordable",
            Self::NotIdentifiable => "not_identifiable",
            Self::Numerical => "numerical",
            Self::WorkerDied => "worker_died",
            Self::DeadlineExceeded => "deadline_exceeded",
            Self::Busy => "busy",
            Self::Internal => "internal",
        }
    }
}

/// A problem, as RFC 9457 writes it (without the HTTP status, which only the API knows).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Problem {
    /// What sort of problem: `urn:volition:problem:` and the code.
    #[serde(rename = "type")]
    pub type_uri: String,
    /// What is wrong, in a few words.
    pub title: String,
    /// Why it is wrong, with the values at hand.
    pub detail: String,
    /// The code on its own.
    pub code: Code,
    /// Where: a JSON pointer (`/spec/pool`), a column and row (`column y, row 17`), a query parameter, a header.
    #[serde(rename = "where", skip_serializing_if = "Option::is_none", default)]
    pub location: Option<String>,
    /// How to mend it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub mend: Option<String>,
}

impl Problem {
    /// A problem with its title and the reason.
    #[must_use]
    pub fn new(code: Code, title: impl Into<String>, detail: impl Into<String>) -> Self {
        Self {
            type_uri: format!("urn:volition:problem:{}", code.name()),
            title: title.into(),
            detail: detail.into(),
            code,
            location: None,
            mend: None,
        }
    }

    /// Says where it is wrong.
    #[must_use]
    pub fn at(mut self, location: impl Into<String>) -> Self {
        self.location = Some(location.into());
        self
    }

    /// Says how to mend it.
    #[must_use]
    pub fn mend(mut self, advice: impl Into<String>) -> Self {
        self.mend = Some(advice.into());
        self
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.title, self.detail)?;
        if let Some(location) = &self.location {
            write!(f, " (at {location})")?;
        }
        if let Some(mend) = &self.mend {
            write!(f, " {mend}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Problem {}
