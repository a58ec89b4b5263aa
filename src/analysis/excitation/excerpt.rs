//! Which part of a recording is a signal, and what makes a sequence.

use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::{object, read};
use crate::excite::sequence::{Chirp, FilteredNoise, Generator, Multisine, ShiftRegister};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};

/// The title of everything that is wrong with a signal.
pub(super) const TITLE: &str = "unusable signal";

/// Which part of a recording, and what was played.
#[derive(Debug, Clone, Default, PartialEq, Serialize, JsonSchema)]
pub struct Excerpt {
    /// Length of a period in seconds, a whole number of samples. Default: that of the generator, or the whole excerpt.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub period_s: Option<f64>,
    /// Where the excerpt starts, in seconds from the first sample. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_s: Option<f64>,
    /// Where it ends, in seconds from the first sample. Default: the end of the record.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_s: Option<f64>,
    /// What was played.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub generator: Option<Generator>,
}

/// A problem of the signal.
pub(super) fn wrong(detail: impl Into<String>, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, TITLE, detail).at(at)
}

/// A generator, with the pointer of the member that is wrong.
pub(super) fn generator(value: &Value, at: &str) -> Result<Generator, Problem> {
    const KINDS: &str = "Use one of: prts, prbs, multisine, chirp, filtered_noise.";
    let mut members = object(value, "a generator", at)?.clone();
    let kind = members.remove("kind").unwrap_or(Value::Null);
    let rest = Value::Object(members);
    Ok(match kind.as_str() {
        Some("prts") => Generator::Prts(read::<ShiftRegister>(&rest, at, TITLE)?),
        Some("prbs") => Generator::Prbs(read::<ShiftRegister>(&rest, at, TITLE)?),
        Some("multisine") => Generator::Multisine(read::<Multisine>(&rest, at, TITLE)?),
        Some("chirp") => Generator::Chirp(read::<Chirp>(&rest, at, TITLE)?),
        Some("filtered_noise") => Generator::FilteredNoise(read::<FilteredNoise>(&rest, at, TITLE)?),
        Some(other) => return Err(wrong(format!("there is no generator {other:?}"), format!("{at}/kind")).mend(KINDS)),
        None => return Err(wrong("the generator has no kind", format!("{at}/kind")).mend(KINDS)),
    })
}

impl Excerpt {
    /// Reads it from the members of a signal.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub(super) fn parse(written: &Map<String, Value>, at: &str) -> Result<Self, Problem> {
        let seconds = |name: &str| -> Result<Option<f64>, Problem> {
            let Some(value) = written.get(name) else { return Ok(None) };
            read(value, &format!("{at}/{name}"), TITLE)
        };
        let (period_s, start_s, end_s) = (seconds("period_s")?, seconds("start_s")?, seconds("end_s")?);
        for (name, value) in [("period_s", period_s), ("end_s", end_s)] {
            if let Some(value) = value.filter(|v| !(*v > 0.0 && v.is_finite())) {
                return Err(wrong(format!("{name} is {value}, and must be positive"), format!("{at}/{name}")));
            }
        }
        let start = start_s.unwrap_or(0.0);
        if !(start >= 0.0 && start < end_s.unwrap_or(f64::INFINITY)) {
            return Err(wrong(format!("the excerpt starts at {start} s"), format!("{at}/start_s"))
                .mend("Start at 0 s or later, and before end_s."));
        }
        let read = |value| generator(value, &format!("{at}/generator"));
        let generator = written.get("generator").map(read).transpose()?;
        Ok(Self { period_s, start_s, end_s, generator })
    }
}
