//! Excitation before a trial, and after it: kinds `excitation_quality` and `compensator_design`.
//!
//! The method is that of [`excite`](crate::excite).

pub mod compensator;
pub mod plant;
mod problems;
pub mod quality;
pub mod samples;
pub mod signal;

use super::problem::{Code, Problem};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// Reads an object, and names the member that is wrong by its JSON pointer.
pub(super) fn read<T: DeserializeOwned>(value: &Value, at: &str, title: &str) -> Result<T, Problem> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        use serde_path_to_error::Segment;
        let mut location = at.to_owned();
        for segment in error.path() {
            match segment {
                Segment::Seq { index } => location.push_str(&format!("/{index}")),
                Segment::Map { key } => location.push_str(&format!("/{}", escaped(key))),
                Segment::Enum { .. } | Segment::Unknown => {}
            }
        }
        let text = error.inner().to_string();
        // A field that is missing or unknown is not yet on the path.
        let named = ["unknown field `", "missing field `", "duplicate field `"]
            .iter()
            .find_map(|start| text.strip_prefix(start))
            .and_then(|rest| rest.split('`').next())
            .map(|name| format!("/{}", escaped(name)));
        if let Some(named) = named.filter(|named| !location.ends_with(named.as_str())) {
            location.push_str(&named);
        }
        Problem::new(Code::Invalid, title, text).at(location)
    })
}

/// A name within a JSON pointer (RFC 6901).
fn escaped(name: &str) -> String {
    name.replace('~', "~0").replace('/', "~1")
}

/// The members of an object.
fn members<'a>(value: &'a Value, what: &str, at: &str) -> Result<&'a Map<String, Value>, Problem> {
    value
        .as_object()
        .ok_or_else(|| Problem::new(Code::Invalid, "unusable inputs", format!("{what} is no object")).at(at))
}

/// Refuses members that nobody reads.
fn only(members: &Map<String, Value>, known: &[&str], at: &str) -> Result<(), Problem> {
    match members.keys().find(|name| !known.contains(&name.as_str())) {
        None => Ok(()),
        Some(name) => {
            let location = format!("{at}/{}", escaped(name));
            Err(Problem::new(Code::Invalid, "unusable inputs", format!("there is no {name:?} here"))
                .at(location)
                .mend(format!("It has {}.", known.join(", "))))
        }
    }
}
