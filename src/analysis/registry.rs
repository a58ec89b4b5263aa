//! The list of kinds, and everything that is the same for all of them.

use super::contract::{Analysis, Failure, Inputs as _, Part as _};
use super::inputs::{Library, References};
use super::kind::{Kind, Request};
use super::problem::{Code, Problem};
use super::report::{Report, sha256_json};
use crate::ctl::Ctl;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

/// Registers kinds: each word is a folder whose `Plan` implements [`Analysis`].
macro_rules! kinds {
    ($($kind:ident),* $(,)?) => {
        /// Every kind, in the order in which people meet them.
        static KINDS: &[About] = &[$(About::of::<super::$kind::Plan>()),*];
    };
}

kinds! {
    frequency_response,
    ssid,
    ssid_mimo,
    two_stimulus,
    gain_fit,
    inverse_lqr,
    inverse_lqe,
    inverse_lqg,
    excitation_quality,
    compensator_design,
    input_design,
    robust_input_design,
}

/// A kind, for whoever lists, documents or dispatches them.
pub struct About {
    /// Its name in documents.
    pub kind: Kind,
    /// Its name for people.
    pub title: &'static str,
    /// One paragraph: what it answers, from what, by which method.
    pub summary: &'static str,
    /// Version of its result.
    pub result_version: u32,
    /// A request that succeeds within seconds, as JSON.
    pub example: &'static str,
    /// The names of its types in schemas, from the kind's: `Ssid` for `ssid`.
    pub inputs: fn(&mut SchemaGenerator) -> Schema,
    /// The schema of its spec.
    pub spec: fn(&mut SchemaGenerator) -> Schema,
    /// The schema of its result.
    pub result: fn(&mut SchemaGenerator) -> Schema,
    check: fn(&Request) -> Result<Box<dyn Checked>, Problem>,
}

impl About {
    const fn of<A: Analysis>() -> Self {
        Self {
            kind: A::KIND,
            title: A::TITLE,
            summary: A::SUMMARY,
            result_version: A::RESULT_VERSION,
            example: A::EXAMPLE,
            inputs: |generator| generator.subschema_for::<A::Inputs>(),
            spec: |generator| generator.subschema_for::<A::Spec>(),
            result: |generator| generator.subschema_for::<A::Result>(),
            check: |request| {
                let inputs = A::Inputs::read(&request.inputs, "/inputs")?;
                let spec = A::Spec::read(&request.spec, "/spec")?;
                Ok(Box::new(A::check(inputs, spec)?))
            },
        }
    }

    /// The kind's name in the names of types: `FrequencyResponse` for `frequency_response`.
    #[must_use]
    pub fn type_prefix(&self) -> String {
        let capitalised = |word: &str| word[..1].to_uppercase() + &word[1..];
        self.kind.name().split('_').map(capitalised).collect()
    }
}

/// Every kind, in the order in which people meet them.
pub fn kinds() -> impl ExactSizeIterator<Item = &'static About> + Clone {
    KINDS.iter()
}

/// The names of all kinds, for messages.
#[must_use]
pub fn names() -> String {
    kinds().map(|about| about.kind.name()).collect::<Vec<_>>().join(", ")
}

fn find(name: &str) -> Result<&'static About, Problem> {
    kinds().find(|about| about.kind.name() == name).ok_or_else(|| {
        Problem::new(Code::Invalid, "unknown kind of analysis", format!("there is no kind '{name}'"))
            .at("/kind")
            .mend(format!("Use one of: {}.", names()))
    })
}

impl FromStr for Kind {
    type Err = Problem;

    fn from_str(text: &str) -> Result<Self, Problem> {
        find(text).map(|about| about.kind)
    }
}

impl<'de> Deserialize<'de> for Kind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Cow::<str>::deserialize(deserializer)?.parse().map_err(|problem: Problem| serde::de::Error::custom(problem.detail))
    }
}

impl JsonSchema for Kind {
    fn schema_name() -> Cow<'static, str> {
        "Kind".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let names: Vec<&str> = kinds().map(|about| about.kind.name()).collect();
        json_schema!({"type": "string", "enum": names, "description": "What is computed."})
    }
}

/// An [`Analysis`] of any kind.
trait Checked: Send + Sync {
    fn kind(&self) -> Kind;
    fn references(&self) -> References;
    fn request(&self) -> Request;
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure>;
}

impl<A: Analysis> Checked for A {
    fn kind(&self) -> Kind {
        A::KIND
    }

    fn references(&self) -> References {
        self.inputs().references()
    }

    fn request(&self) -> Request {
        Request { kind: A::KIND.name().to_owned(), inputs: json!(self.inputs()), spec: json!(self.spec()) }
    }

    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        let hashes = self.inputs().sha256(library)?;
        let outcome = A::run(self, library, ctl)?;
        let result: Value = json!(outcome.result);
        let mut report =
            Report::new(A::KIND, A::RESULT_VERSION, result, outcome.warnings, json!(self.spec()), hashes, self.seed());
        report.provenance.effort = outcome.effort;
        Ok(report)
    }
}

/// A checked request of any kind: everything that can be checked without its inputs has been.
pub struct Plan(Box<dyn Checked>);

impl Plan {
    /// Checks a request.
    ///
    /// # Errors
    /// A [`Problem`] that names the field by its JSON pointer.
    pub fn parse(request: &Request) -> Result<Self, Problem> {
        (find(&request.kind)?.check)(request).map(Self)
    }

    /// The kind.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.0.kind()
    }

    /// The stored things that it needs.
    #[must_use]
    pub fn references(&self) -> References {
        self.0.references()
    }

    /// The request with every default filled in; parsing it again gives an equal one.
    #[must_use]
    pub fn request(&self) -> Request {
        self.0.request()
    }

    /// SHA-256 of the spec with every default filled in: requests with equal hashes are computed in the same way.
    #[must_use]
    pub fn spec_sha256(&self) -> String {
        sha256_json(&self.request().spec)
    }

    /// Computes the report. Deterministic but for the times, which the caller adds.
    ///
    /// Runs on the rayon pool that it is called in.
    ///
    /// # Errors
    /// [`Failure::Stopped`] or [`Failure::Interrupted`] when `ctl` says so, [`Failure::Problem`] when the inputs cannot answer the question.
    pub fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        self.0.run(library, ctl)
    }
}

impl fmt::Debug for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Plan").field(&self.request()).finish()
    }
}
