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
    /// What was given cannot be read: broken JSON, CSV or gzip.
    Malformed,
    /// It can be read, but says something that cannot be done.
    Invalid,
    /// Recorded data that no analysis could trust: jitter, gaps, NaN, unequal lengths.
    BadSignal,
    /// There is no such thing.
    NotFound,
    /// It contradicts something that is stored.
    Conflict,
    /// What was given, or what it unpacks to, is larger than the limits take.
    TooLarge,
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
    /// A defect of this program, recorded in its log.
    Internal,
}

/// What sorts of problems are told apart by: [`Code`], and whatever a layer above adds of its own.
pub trait ProblemCode: Copy {
    /// The name as it is written.
    fn name(self) -> &'static str;
}

impl ProblemCode for Code {
    fn name(self) -> &'static str {
        Self::name(self)
    }
}

impl Code {
    /// The name as it is written.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Malformed => "malformed",
            Self::Invalid => "invalid",
            Self::BadSignal => "bad_signal",
            Self::NotFound => "not_found",
            Self::Conflict => "conflict",
            Self::TooLarge => "too_large",
            Self::Unaffordable => "unaffordable",
            Self::NotIdentifiable => "not_identifiable",
            Self::Numerical => "numerical",
            Self::WorkerDied => "worker_died",
            Self::DeadlineExceeded => "deadline_exceeded",
            Self::Internal => "internal",
        }
    }
}

/// A problem, with the members of RFC 9457 that do not depend on how it is handed over.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "Problem")]
pub struct Problem<C = Code> {
    /// What sort of problem: `urn:volition:problem:` and the code.
    #[serde(rename = "type")]
    pub type_uri: String,
    /// What is wrong, in a few words.
    pub title: String,
    /// Why it is wrong, with the values at hand.
    pub detail: String,
    /// The code on its own.
    pub code: C,
    /// Where: a JSON pointer (`/spec/pool`), a column and row (`column y, row 17`).
    #[serde(rename = "where", skip_serializing_if = "Option::is_none", default)]
    pub location: Option<String>,
    /// How to mend it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub mend: Option<String>,
}

impl<C: ProblemCode> Problem<C> {
    /// A problem with its title and the reason.
    #[must_use]
    pub fn new(code: C, title: impl Into<String>, detail: impl Into<String>) -> Self {
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

impl<C> fmt::Display for Problem<C> {
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

impl<C: fmt::Debug> std::error::Error for Problem<C> {}
