//! A signal of a trial in the request.

use super::matrix::{dense, read_rows};
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_inputs as wrong;
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
    fn matrix(&self, name: &str, at: &str) -> Result<DMatrix<f64>, Problem> {
        match self {
            Self::List(values) => Ok(DMatrix::from_column_slice(values.len(), 1, values)),
            Self::Rows(rows) => dense(rows, name, at),
        }
    }

    /// Samples × channels, of two samples at least and of magnitudes up to a largest one.
    pub(crate) fn checked(&self, name: &str, largest: f64, at: &str) -> Result<DMatrix<f64>, Problem> {
        let found = self.matrix(name, at)?;
        if found.nrows() < 2 || found.ncols() == 0 {
            let (rows, columns) = found.shape();
            let detail = format!("the {name} has {rows} samples of {columns} numbers; 2 samples at least are needed");
            return Err(wrong(detail, at));
        }
        for i in 0..found.nrows() {
            if let Some(value) = found.row(i).iter().find(|v| v.is_nan() || v.abs() > largest) {
                let detail = format!("the {name} is {value:e} at sample {i}; magnitudes up to {largest:e} are taken");
                return Err(wrong(detail, format!("{at}/{i}")));
            }
        }
        Ok(found)
    }
}
