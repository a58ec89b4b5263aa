//! How the two questions are put.

use crate::analysis::contract::Part;
use crate::analysis::inverse::spec::{InverseSpec, read};
use crate::analysis::problem::Problem;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// How the two questions are put.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InverseLqgSpec {
    /// For K.
    pub regulator: InverseSpec,
    /// For L.
    pub filter: InverseSpec,
}

impl Part for InverseLqgSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        read(value, at, "Give regulator and filter, each with the spec of its half.")
    }
}
