//! Trials as JSON: `{"sample_time_s"?, "t"?, "r", "u", "y", "d"?}` with arrays of equal length.
//!
//! JSON has no NaN; a `null`, a string or anything else in a number's place is named by its array and index.
//! A member that a trial does not have is refused, not ignored: it may be a misspelt one.

use super::error::{Location, ReadError, TrialError};
use super::limits::Limits;
use super::signals::{Channel, Signals, Trial};
use schemars::JsonSchema;
use serde::de::{self, DeserializeSeed, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use std::cell::RefCell;
use std::fmt;
use std::io::Read;

const A_NUMBER: &str = "a number";

/// Reads a trial from JSON text.
///
/// `sample_time_s`, where given, stands in for the member of that name, and must equal it where both are there.
///
/// # Errors
/// [`ReadError`]; bytes beyond the limit are not read, rows beyond it are not stored.
pub fn read(source: impl Read, sample_time_s: Option<f64>, limits: &Limits) -> Result<Trial, ReadError> {
    let mut text = Vec::new();
    let count = source.take(limits.max_bytes.saturating_add(1)).read_to_end(&mut text)?;
    if count as u64 > limits.max_bytes {
        return Err(ReadError::TooManyBytes { limit: limits.max_bytes });
    }
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&text);
    if text.trim_ascii().is_empty() {
        return Err(ReadError::Empty);
    }
    let mut deserializer = serde_json::Deserializer::from_slice(text);
    let document = Document::read(&mut deserializer, limits)?;
    deserializer.end().map_err(|error| ReadError::Json { message: error.to_string() })?;
    document.trial(sample_time_s)
}

/// Reads a trial from a JSON value that has been parsed already.
///
/// # Errors
/// As [`read`].
pub fn from_value(value: &serde_json::Value, limits: &Limits) -> Result<Trial, ReadError> {
    Document::read(value, limits)?.trial(None)
}

/// A trial as JSON, as its schema: equally long arrays, one number for each sample.
#[derive(Debug, Clone, JsonSchema)]
#[schemars(rename = "NewTrial", deny_unknown_fields)]
#[schemars(example = serde_json::json!({
    "sample_time_s": 0.02, "r": [0.0, 0.5, 1.0], "u": [0.0, 0.2, 0.4], "y": [0.0, 0.1, 0.3]
}))]
#[allow(dead_code, reason = "describes what the reader takes, which reads numbers one by one")]
pub(crate) struct TrialDocument {
    /// Time between samples in seconds; may be left out where there is `t`.
    #[schemars(extend("exclusiveMinimum" = 0))]
    sample_time_s: Option<f64>,
    /// Time of each sample in seconds.
    t: Option<Vec<f64>>,
    /// Command, in the unit of the output.
    r: Vec<f64>,
    /// Control, in its own unit.
    u: Vec<f64>,
    /// Output, in its own unit.
    y: Vec<f64>,
    /// Disturbance at the plant's input, in the unit of the control.
    d: Option<Vec<f64>>,
}

#[derive(Default)]
struct Document {
    sample_time_s: Option<f64>,
    columns: [Option<Vec<f64>>; 5],
}

impl Document {
    fn read<'de, D: Deserializer<'de>>(deserializer: D, limits: &Limits) -> Result<Self, ReadError>
    where
        D::Error: fmt::Display,
    {
        // serde's errors are texts; the typed one takes this side way around them.
        let found = RefCell::new(None);
        let visitor = DocumentVisitor { max_rows: limits.max_rows, found: &found };
        let read = deserializer.deserialize_any(visitor);
        read.map_err(|error| found.take().unwrap_or_else(|| ReadError::Json { message: error.to_string() }))
    }

    fn trial(self, given_s: Option<f64>) -> Result<Trial, ReadError> {
        let [time_s, command, control, output, disturbance] = self.columns;
        let missing: Vec<String> =
            [(Channel::Command, &command), (Channel::Control, &control), (Channel::Output, &output)]
                .into_iter()
                .filter(|(_, column)| column.is_none())
                .map(|(channel, _)| channel.letter().to_owned())
                .collect();
        let (Some(command), Some(control), Some(output)) = (command, control, output) else {
            return Err(ReadError::MissingArrays { missing });
        };
        if let (Some(own), Some(given)) = (self.sample_time_s, given_s)
            && own != given
        {
            let error = TrialError::SampleTimes { document_s: own, given_s: given };
            return Err(ReadError::Trial { error, location: Some(Location::Pointer("/sample_time_s".to_owned())) });
        }
        let signals = Signals { time_s, command, control, output, disturbance };
        Trial::from_signals(self.sample_time_s.or(given_s), signals).map_err(|error| {
            let location = match error.place() {
                (Some(channel), Some(sample)) => Some(Location::Pointer(format!("/{}/{sample}", channel.letter()))),
                (Some(channel), None) => Some(Location::Pointer(format!("/{}", channel.letter()))),
                (None, _) if matches!(error, TrialError::BadSampleTime(_)) => {
                    Some(Location::Pointer("/sample_time_s".to_owned()))
                }
                (None, _) => None,
            };
            ReadError::Trial { error, location }
        })
    }
}

type Found<'a> = &'a RefCell<Option<ReadError>>;

/// Leaves the typed error where [`Document::read`] finds it.
fn fail<E: de::Error>(found: Found<'_>, error: ReadError) -> E {
    let text = E::custom(&error);
    found.replace(Some(error));
    text
}

struct DocumentVisitor<'a> {
    max_rows: usize,
    found: Found<'a>,
}

impl<'de> Visitor<'de> for DocumentVisitor<'_> {
    type Value = Document;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object with the arrays r, u, y")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Document, A::Error> {
        let mut document = Document::default();
        while let Some(name) = map.next_key::<String>()? {
            if name == "sample_time_s" {
                if document.sample_time_s.is_some() {
                    return Err(fail(self.found, ReadError::DuplicateMember { name }));
                }
                let pointer = || "/sample_time_s".to_owned();
                // null says that there is none, as leaving it out does.
                document.sample_time_s =
                    map.next_value_seed(Number { pointer: &pointer, nullable: true, found: self.found })?;
                continue;
            }
            let Some(index) = Channel::ALL.iter().position(|channel| channel.letter() == name) else {
                return Err(fail(self.found, ReadError::UnknownMember { name }));
            };
            if document.columns[index].is_some() {
                return Err(fail(self.found, ReadError::DuplicateMember { name }));
            }
            let column = Column { name: &name, max_rows: self.max_rows, found: self.found };
            document.columns[index] = map.next_value_seed(column)?;
            let optional = matches!(Channel::ALL[index], Channel::Time | Channel::Disturbance);
            if document.columns[index].is_none() && !optional {
                return Err(fail(self.found, ReadError::MissingArrays { missing: vec![name] }));
            }
        }
        Ok(document)
    }
}

/// The array of a channel; null means that there is none.
struct Column<'a> {
    name: &'a str,
    max_rows: usize,
    found: Found<'a>,
}

impl Column<'_> {
    fn wrong<T, E: de::Error>(&self, found: &str) -> Result<T, E> {
        Err(fail(
            self.found,
            ReadError::WrongType {
                pointer: format!("/{}", self.name),
                found: found.to_owned(),
                expected: "an array of numbers",
            },
        ))
    }
}

impl<'de> DeserializeSeed<'de> for Column<'_> {
    type Value = Option<Vec<f64>>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Column<'_> {
    type Value = Option<Vec<f64>>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an array of numbers")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Self::Value, A::Error> {
        let mut values = Vec::new();
        loop {
            let index = values.len();
            let pointer = || format!("/{}/{index}", self.name);
            let number = Number { pointer: &pointer, nullable: false, found: self.found };
            match sequence.next_element_seed(number)? {
                None => return Ok(Some(values)),
                Some(_) if index >= self.max_rows => {
                    return Err(fail(self.found, ReadError::TooManyRows { limit: self.max_rows }));
                }
                Some(value) => values.extend(value),
            }
        }
    }

    fn visit_unit<E: de::Error>(self) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_bool<E: de::Error>(self, _: bool) -> Result<Self::Value, E> {
        self.wrong("a truth value")
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<Self::Value, E> {
        self.wrong(&format!("the number {value}"))
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Self::Value, E> {
        self.wrong(&format!("the number {value}"))
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Self::Value, E> {
        self.wrong(&format!("the number {value}"))
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Self::Value, E> {
        self.wrong(&format!("the text {:?}", super::csv::shorten(text)))
    }

    fn visit_map<A: MapAccess<'de>>(self, _: A) -> Result<Self::Value, A::Error> {
        self.wrong("an object")
    }
}

/// A number at a place that is only spelt out when it is needed.
struct Number<'a> {
    pointer: &'a dyn Fn() -> String,
    nullable: bool,
    found: Found<'a>,
}

impl Number<'_> {
    fn wrong<T, E: de::Error>(&self, found: String) -> Result<T, E> {
        Err(fail(self.found, ReadError::WrongType { pointer: (self.pointer)(), found, expected: A_NUMBER }))
    }
}

impl<'de> DeserializeSeed<'de> for Number<'_> {
    type Value = Option<f64>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        let (pointer, found) = (self.pointer, self.found);
        deserializer.deserialize_any(self).map_err(|error: D::Error| {
            // serde_json refuses 1e400 by itself; its text names line and column, this adds the array and index.
            if found.borrow().is_none() && error.to_string().contains("out of range") {
                let wrong = "a number beyond the range of a double".to_owned();
                return fail(found, ReadError::WrongType { pointer: pointer(), found: wrong, expected: A_NUMBER });
            }
            error
        })
    }
}

impl<'de> Visitor<'de> for Number<'_> {
    type Value = Option<f64>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(A_NUMBER)
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Self::Value, E> {
        Ok(Some(value))
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<Self::Value, E> {
        Ok(Some(value as f64))
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Self::Value, E> {
        Ok(Some(value as f64))
    }

    fn visit_unit<E: de::Error>(self) -> Result<Self::Value, E> {
        if self.nullable { Ok(None) } else { self.wrong("null".to_owned()) }
    }

    fn visit_bool<E: de::Error>(self, value: bool) -> Result<Self::Value, E> {
        self.wrong(value.to_string())
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Self::Value, E> {
        self.wrong(format!("the text {:?}", super::csv::shorten(text)))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Self::Value, A::Error> {
        while sequence.next_element::<IgnoredAny>()?.is_some() {}
        self.wrong("an array".to_owned())
    }

    fn visit_map<A: MapAccess<'de>>(self, _: A) -> Result<Self::Value, A::Error> {
        self.wrong("an object".to_owned())
    }
}
