//! Where the systems of a result stand.

use serde_json::{Map, Value};

/// Members whose systems are alternatives to the answer, and many.
const ALTERNATIVES: [&str; 3] = ["near_optimal", "equivalent", "delayed"];

/// Segments of a place that say nothing.
const SILENT: [&str; 2] = ["rational", "model"];

/// What may be a system: its place, its document, and the delay that stands beside it.
pub(super) struct Found {
    place: Vec<String>,
    pub(super) value: Value,
    /// In seconds.
    pub(super) delay_s: Option<f64>,
}

impl Found {
    /// Its name: the segments of its place that say something.
    pub(super) fn name(&self) -> String {
        let said: Vec<&str> = self.place.iter().map(String::as_str).filter(|own| !SILENT.contains(own)).collect();
        said.join("_")
    }

    /// Its place as a JSON pointer.
    pub(super) fn pointer(&self) -> String {
        self.place.iter().map(|segment| format!("/{segment}")).collect()
    }
}

/// Whether a document is written as a system: a transfer function, a matrix of them, a fraction of matrices, or state
/// space.
fn is_system(value: &Value) -> bool {
    let has_lists = |names: &[&str]| names.iter().all(|name| value.get(name).is_some_and(Value::is_array));
    has_lists(&["num", "den"])
        || has_lists(&["transfer_functions"])
        || has_lists(&["numerator", "denominator"])
        || has_lists(&["a", "b", "c", "d"])
}

/// Everything in a result that is written as a system and belongs to its answer.
pub(super) fn systems(result: &Value) -> Vec<Found> {
    let mut found = Vec::new();
    collect(result, &mut Vec::new(), &mut found);
    found
}

fn collect(value: &Value, place: &mut Vec<String>, found: &mut Vec<Found>) {
    match value {
        Value::Object(members) => {
            for (name, member) in members.iter().filter(|(name, _)| !ALTERNATIVES.contains(&name.as_str())) {
                place.push(name.clone());
                if is_system(member) {
                    let delay_s = delay_beside(members, name);
                    found.push(Found { place: place.clone(), value: member.clone(), delay_s });
                } else {
                    collect(member, place, found);
                }
                place.pop();
            }
        }
        // Long arrays are numbers.
        Value::Array(members) if members.iter().any(|member| member.is_object() || member.is_array()) => {
            for (i, member) in members.iter().enumerate() {
                place.push(i.to_string());
                if is_system(member) {
                    found.push(Found { place: place.clone(), value: member.clone(), delay_s: None });
                } else if !member.as_array().is_some_and(|own| own.iter().all(Value::is_number)) {
                    collect(member, place, found);
                }
                place.pop();
            }
        }
        _ => {}
    }
}

/// A delay stands beside the system, under its name or (of a reduction) alone.
fn delay_beside(members: &Map<String, Value>, name: &str) -> Option<f64> {
    let own = members.get(&format!("{name}_delay_s"));
    own.or(members.get("delay_s").filter(|_| name == "model")).and_then(Value::as_f64)
}
