//! Reading parts of a request, so that what is wrong is named by its place.

use super::problem::{Code, Problem};
use crate::trial::pointer;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// A problem of the spec.
pub(super) fn wrong_spec(detail: impl Into<String>, location: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "unusable spec", detail).at(location)
}

/// A problem of the inputs.
pub(super) fn wrong_inputs(detail: impl Into<String>, location: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "unusable inputs", detail).at(location)
}

/// Reads a value; what is wrong is found by following the deserialiser.
///
/// # Errors
/// A [`Problem`] with the pointer of the innermost value that cannot be read.
pub(super) fn read<T: DeserializeOwned>(value: &Value, at: &str, title: &str) -> Result<T, Problem> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let mut location = pointer::below(at, error.path());
        let text = error.inner().to_string();
        // A field that is missing or unknown is not yet on the path.
        let named = ["unknown field `", "missing field `", "duplicate field `"]
            .iter()
            .find_map(|start| text.strip_prefix(start))
            .and_then(|rest| rest.split('`').next())
            .map(|name| pointer::member("", name));
        if let Some(named) = named.filter(|named| !location.ends_with(named.as_str())) {
            location.push_str(&named);
        }
        Problem::new(Code::Invalid, title, text).at(location)
    })
}

/// Reads an object; what is wrong is found by its member.
///
/// # Errors
/// A [`Problem`] with the pointer of the first member that cannot be read.
pub(super) fn members<T: DeserializeOwned>(members: &Map<String, Value>, at: &str, title: &str) -> Result<T, Problem> {
    let wrong = |error: serde_json::Error, at: String| Problem::new(Code::Invalid, title, error.to_string()).at(at);
    // One at a time first, since the deserialiser does not say where it stopped.
    for (name, value) in members {
        let alone = Value::Object(Map::from_iter([(name.clone(), value.clone())]));
        serde_json::from_value::<T>(alone).map_err(|error| wrong(error, pointer::member(at, name)))?;
    }
    serde_json::from_value(Value::Object(members.clone())).map_err(|error| wrong(error, at.to_owned()))
}

/// Reads a `spec` all of whose members may be left out.
///
/// # Errors
/// As [`members`]; also where it is no object.
pub(super) fn spec<T: DeserializeOwned>(spec: &Value, at: &str) -> Result<T, Problem> {
    let Value::Object(written) = spec else { return Err(wrong_spec("the spec is no object", at)) };
    members(written, at, "unusable spec")
}

/// Reads a setting as a whole.
///
/// # Errors
/// A [`Problem`] at `at`.
pub(super) fn setting<T: DeserializeOwned>(value: &Value, at: &str) -> Result<T, Problem> {
    serde_json::from_value(value.clone())
        .map_err(|error| Problem::new(Code::Invalid, "unusable setting", error.to_string()).at(at))
}

/// The members of an object.
///
/// # Errors
/// A [`Problem`] where it is none.
pub(super) fn object<'a>(value: &'a Value, what: &str, at: &str) -> Result<&'a Map<String, Value>, Problem> {
    value.as_object().ok_or_else(|| wrong_inputs(format!("{what} is no object"), at))
}

/// Refuses members that nobody reads.
///
/// # Errors
/// A [`Problem`] with the pointer of the first of them.
pub(super) fn only(members: &Map<String, Value>, known: &[&str], at: &str) -> Result<(), Problem> {
    match members.keys().find(|name| !known.contains(&name.as_str())) {
        None => Ok(()),
        Some(name) => Err(wrong_inputs(format!("there is no {name:?} here"), pointer::member(at, name))
            .mend(format!("It has {}.", known.join(", ")))),
    }
}
