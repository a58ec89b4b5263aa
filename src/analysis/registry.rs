//! The list of kinds, and everything that is the same for all of them.

use super::contract::{Analysis, Failure, Inputs as _, OfEarlier, Part as _, Samples};
use super::inputs::earlier::{Earlier, EarlierAnalysis, FromEarlier, TrialsOfSubject};
use super::inputs::library::{Library, References};
use super::kind::{Kind, Request};
use super::problem::{Code, Problem};
use super::report::{Provenance, Report, Warning};
use crate::ctl::Ctl;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value, json};
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
    prediction_error,
    gain_fit,
    lqg_fit,
    inverse_lqr,
    inverse_lqe,
    inverse_lqg,
    excitation_quality,
    compensator_design,
    input_design,
    robust_input_design,
    simulate,
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
    /// Whether its inputs take `trials`.
    pub takes_trials: bool,
    of_earlier: Option<OfEarlier>,
    samples: fn(&Value) -> Option<Samples>,
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
            takes_trials: A::TAKES_TRIALS,
            of_earlier: A::OF_EARLIER,
            samples: A::samples,
            check: |request| {
                let inputs = A::Inputs::read(&request.inputs, "/inputs")?;
                let spec = A::Spec::read(&request.spec, "/spec")?;
                Ok(Box::new(A::check(inputs, spec)?))
            },
        }
    }

    /// Name and version of its result's form.
    #[must_use]
    pub fn result_schema(&self) -> String {
        super::report::result_schema(self.kind, self.result_version)
    }

    /// Whether the spec has members that must be there.
    fn needs_spec(&self, generator: &mut SchemaGenerator) -> bool {
        let schema = (self.spec)(generator);
        let name = schema.get("$ref").and_then(Value::as_str).and_then(|path| path.rsplit('/').next());
        let spec = name.and_then(|name| generator.definitions().get(name));
        spec.and_then(|spec| spec.get("required")).and_then(Value::as_array).is_some_and(|list| !list.is_empty())
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

/// A kind by its name.
///
/// # Errors
/// A [`Problem`] where there is none.
pub fn about(name: &str) -> Result<&'static About, Problem> {
    find(name)
}

/// The inputs of a kind that an earlier report stands for.
///
/// # Errors
/// A [`Problem`] where the kind takes no report, or not this one.
pub fn of_earlier(kind: &str, earlier: &Earlier<'_>) -> Result<FromEarlier, Problem> {
    if let Some(of_earlier) = find(kind)?.of_earlier {
        return of_earlier(earlier);
    }
    let takers: Vec<&str> = kinds().filter(|k| k.of_earlier.is_some()).map(|k| k.kind.name()).collect();
    let detail = format!("{kind} takes no earlier analysis as its input");
    Err(Problem::new(Code::Invalid, "unusable inputs", detail)
        .at("/inputs/analysis")
        .mend(format!("Kinds that take one: {}.", takers.join(", "))))
}

/// The signals that a report carries for a device to play.
#[must_use]
pub fn samples(report: &Report) -> Option<Samples> {
    (find(report.kind.name()).ok()?.samples)(&report.result)
}

impl FromStr for Kind {
    type Err = Problem;

    fn from_str(text: &str) -> Result<Self, Problem> {
        find(text).map(|about| about.kind)
    }
}

impl<'de> Deserialize<'de> for Kind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Cow::<str>::deserialize(deserializer)?
            .parse()
            .map_err(|problem: Problem| serde::de::Error::custom(problem.detail))
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

/// An object with a member `kind` that tells which of the kinds it is of: one schema for each of them, and their
/// choice.
fn one_of_kinds(
    generator: &mut SchemaGenerator,
    what: &str,
    of: impl Fn(&mut SchemaGenerator, &About) -> Schema,
) -> Schema {
    let mut choices = Vec::new();
    let mut mapping = Map::new();
    for about in kinds() {
        let name = format!("{}{what}", about.type_prefix());
        let schema = of(generator, about);
        generator.definitions_mut().insert(name.clone(), schema.into());
        let path = format!("#{}/{name}", generator.settings().definitions_path);
        mapping.insert(about.kind.name().to_owned(), json!(path));
        choices.push(json!({"$ref": path}));
    }
    json_schema!({"oneOf": choices, "discriminator": {"propertyName": "kind", "mapping": mapping}})
}

/// The inputs of a kind, or what a server makes them of.
fn inputs_schema(generator: &mut SchemaGenerator, about: &About) -> Schema {
    let mut choices = vec![(about.inputs)(generator)];
    if about.takes_trials {
        choices.push(generator.subschema_for::<TrialsOfSubject>());
    }
    if about.of_earlier.is_some() {
        choices.push(generator.subschema_for::<EarlierAnalysis>());
    }
    if choices.len() == 1 { choices.remove(0) } else { json_schema!({"anyOf": choices}) }
}

impl JsonSchema for Request {
    fn schema_name() -> Cow<'static, str> {
        "Request".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        one_of_kinds(generator, "Request", |generator, about| {
            let (inputs, spec) = (inputs_schema(generator, about), (about.spec)(generator));
            let mut required = vec!["kind", "inputs"];
            if about.needs_spec(generator) {
                required.push("spec");
            }
            json_schema!({
                "type": "object",
                "description": about.summary,
                "properties": {
                    "kind": {"type": "string", "const": about.kind, "description": "The kind of analysis."},
                    "inputs": described(inputs, "What it is computed from: stored things by id, or the data itself."),
                    "spec": described(spec, "How it is computed; what is left out takes its documented default."),
                },
                "required": required,
                "additionalProperties": false,
            })
        })
    }
}

impl JsonSchema for Report {
    fn schema_name() -> Cow<'static, str> {
        "Report".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        one_of_kinds(generator, "Report", |generator, about| {
            let result = (about.result)(generator);
            let warnings = generator.subschema_for::<Vec<Warning>>();
            let provenance = generator.subschema_for::<Provenance>();
            json_schema!({
                "type": "object",
                "description": about.summary,
                "properties": {
                    "kind": {"type": "string", "const": about.kind, "description": "The kind of analysis."},
                    "schema": {
                        "type": "string",
                        "const": about.result_schema(),
                        "description": "Name and version of the result's form.",
                    },
                    "result": described(result, "What was found."),
                    "warnings": described(warnings, "What must be read before using it."),
                    "provenance": described(provenance, "Where it comes from."),
                },
                "required": ["kind", "schema", "result", "warnings", "provenance"],
                "additionalProperties": false,
            })
        })
    }
}

fn described(mut schema: Schema, text: &str) -> Schema {
    schema.insert("description".to_owned(), json!(text));
    schema
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
        // First what is doubtful about the recordings themselves: it carries whatever was computed from them.
        let mut warnings = library.warnings(&self.inputs().references());
        warnings.extend(outcome.warnings);
        let mut report =
            Report::new(A::KIND, A::RESULT_VERSION, result, warnings, json!(self.spec()), hashes, self.seed());
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
        let plan = (find(&request.kind)?.check)(request).map(Self)?;
        published::request(request);
        Ok(plan)
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

    /// Computes the report. Deterministic but for the times, which the caller adds.
    ///
    /// Runs on the rayon pool that it is called in.
    ///
    /// # Errors
    /// [`Failure::Stopped`] or [`Failure::Interrupted`] when `ctl` says so, [`Failure::Problem`] when the inputs cannot
    /// answer the question.
    pub fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        let report = self.0.run(library, ctl)?;
        ctl.finish();
        published::report(&report);
        Ok(report)
    }
}

/// The unit tests hold every request that is understood and every report against the published document.
#[cfg(test)]
use crate::published;

/// Nothing is held against the published document outside the tests.
#[cfg(not(test))]
mod published {
    use super::{Report, Request};

    pub(super) const fn request(_: &Request) {}

    pub(super) const fn report(_: &Report) {}
}

impl fmt::Debug for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Plan").field(&self.request()).finish()
    }
}
