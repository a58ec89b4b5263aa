//! A signal of a trial in the request.

use crate::analysis::inputs::matrix::{dense, read_rows};
use crate::analysis::problem::Problem;
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Value, json};

/// A signal: one row of numbers per sample, or a plain list where there is one channel; in the unit of what was
/// recorded.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "GainFitSignal")]
pub enum SampledSignal {
    /// One number per sample.
    #[schemars(title = "OneChannel")]
    List(Vec<f64>),
    /// One row per sample.
    #[schemars(title = "Channels")]
    Rows(Vec<Vec<f64>>),
}

impl SampledSignal {
    /// Reads it; `name` is what errors call it.
    pub(crate) fn read(value: &Value, name: &str, at: &str) -> Result<Self, Problem> {
        match value.as_array().and_then(|rows| rows.first()) {
            Some(first) if !first.is_array() => {
                let rows: Vec<Value> = value.as_array().into_iter().flatten().map(|v| json!([v])).collect();
                read_rows(&Value::Array(rows), name, at).map(|rows| Self::List(rows.concat()))
            }
            _ => read_rows(value, name, at).map(Self::Rows),
        }
    }

    /// Samples × channels.
    pub(crate) fn matrix(&self, name: &str, at: &str) -> Result<DMatrix<f64>, Problem> {
        match self {
            Self::List(values) => Ok(DMatrix::from_column_slice(values.len(), 1, values)),
            Self::Rows(rows) => dense(rows, name, at),
        }
    }
}
