//! What a kind of analysis is: a type that answers documents with results.
//!
//! ```text
//! request {kind, inputs, spec} ─ read ─► Inputs, Spec ─ check ─► the analysis
//!                          report ◄─ registry ─ Outcome<Result> ◄─ run ─┘
//! ```
//! A kind is one folder with a type that implements [`Analysis`], and one word in the list of the
//! [registry](super::registry), which alone makes from it the names, the dispatch, the canonical request, the hashes of
//! inputs, the report and the schemas.

use super::inputs::earlier::{Earlier, FromEarlier};
use super::inputs::library::{Library, References};
use super::kind::Kind;
use super::problem::Problem;
use super::report::{Effort, Warning};
use crate::control::Model;
use crate::ctl::{Ctl, Stopped};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// A kind of analysis. A value of the type is a checked request.
pub trait Analysis: Sized + Send + Sync + 'static {
    /// Its name in documents.
    const KIND: Kind;
    /// Its name for people, without an article: `Subsystem identification`.
    const TITLE: &'static str;
    /// One paragraph: what it answers, from what, and by which method.
    const SUMMARY: &'static str;
    /// Version of [`Self::Result`]: it changes with the meaning of a field, and with fields that go.
    const RESULT_VERSION: u32;
    /// A request of the kind as JSON: short, without stored things, and one that succeeds within seconds.
    const EXAMPLE: &'static str;

    /// Whether its inputs take `trials`, and so all trials of a subject.
    const TAKES_TRIALS: bool = false;
    /// Makes the inputs that an earlier report stands for, or says why it has none; most kinds take no report.
    const OF_EARLIER: Option<OfEarlier> = None;

    /// What it is computed from, as people write it.
    type Inputs: Inputs;
    /// How it is computed, as people write it: what is left out takes its documented default.
    type Spec: Part;
    /// What it answers.
    type Result: Serialize + JsonSchema;

    /// Checks everything that can be checked without the stored things that the inputs name.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    fn check(inputs: Self::Inputs, spec: Self::Spec) -> Result<Self, Problem>;

    /// The inputs in their canonical form: reading and checking them again gives an equal analysis.
    fn inputs(&self) -> &Self::Inputs;

    /// The spec as used, with every default filled in: reading and checking it again gives an equal analysis.
    fn spec(&self) -> &Self::Spec;

    /// The seed of the random numbers drawn; `None` where none is.
    fn seed(&self) -> Option<u64> {
        None
    }

    /// The signals that a result carries for a device to play: the signal itself, then what is compared with it. Most
    /// kinds have none.
    fn samples(_result: &Value) -> Option<Samples> {
        None
    }

    /// Computes the result. Deterministic, on the rayon pool that it is called in.
    ///
    /// # Errors
    /// [`Failure::Stopped`] or [`Failure::Interrupted`] when `ctl` says so, [`Failure::Problem`] when the inputs cannot
    /// answer the question.
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Outcome<Self::Result>, Failure>;
}

/// What makes inputs of an earlier report.
pub type OfEarlier = fn(&Earlier<'_>) -> Result<FromEarlier, Problem>;

/// Signals of a result, equally long.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// Time between samples in seconds.
    pub sample_time_s: f64,
    /// The signals by name.
    pub columns: Vec<(String, Vec<f64>)>,
}

/// A part of a request, `inputs` or `spec`, as people write it.
pub trait Part: Serialize + JsonSchema + Send + Sync + Sized {
    /// Reads it; `at` is its JSON pointer.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what cannot be read.
    fn read(value: &Value, at: &str) -> Result<Self, Problem>;
}

/// The part of a request that says what is computed from.
pub trait Inputs: Part {
    /// The stored things that are needed.
    fn references(&self) -> References {
        References::default()
    }

    /// SHA-256 of the content of each input, by its JSON pointer in the request: that of each member's JSON with sorted
    /// keys, unless the inputs name stored things.
    ///
    /// # Errors
    /// A `not_found` problem, where a stored thing is gone.
    fn sha256(&self, _library: &Library) -> Result<BTreeMap<String, String>, Problem> {
        Ok(members_sha256(self))
    }
}

/// SHA-256 of each member of an object, by its JSON pointer below `/inputs`.
pub(super) fn members_sha256(inputs: &impl Serialize) -> BTreeMap<String, String> {
    let members = serde_json::json!(inputs);
    let hash = |(name, value): (&String, &Value)| (format!("/inputs/{name}"), super::report::sha256_json(value));
    members.as_object().into_iter().flatten().map(hash).collect()
}

/// What a computation came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome<R> {
    /// The result.
    pub result: R,
    /// What must be read before using it.
    pub warnings: Vec<Warning>,
    /// What a search did, where there was one.
    pub effort: Option<Effort>,
}

impl<R> Outcome<R> {
    /// Of a computation without a search.
    pub fn new(result: R, warnings: Vec<Warning>) -> Self {
        Self { result, warnings, effort: None }
    }
}

/// Why an analysis came to no report.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Failure {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// Somebody asked it to stop, and this is the best that it had found until then.
    #[error("{stopped}")]
    Interrupted {
        /// Why it was stopped.
        stopped: Stopped,
        /// What it had found; its cost is that of [`Ctl::bracket`].
        incumbent: Box<Incumbent>,
    },
    /// It cannot be done, for a reason that the person who asked can read.
    #[error(transparent)]
    Problem(#[from] Problem),
}

/// The controllers of the best candidate that an unfinished search has found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Incumbent {
    /// Gff, the feedforward from command to control.
    pub feedforward: Model,
    /// Gfb, the feedback from error to control.
    pub feedback: Model,
}
