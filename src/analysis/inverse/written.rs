//! Matrices and weights of an inverse problem as people write them.

use crate::analysis::inputs::matrix::read_rows;
use crate::analysis::problem::Problem;
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Number, Value};

/// A matrix of a request, an array of rows of equal length.
///
/// Numbers stay as they are written (`1` is not `1.0`), so that the content's hash is that of the request.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(transparent)]
pub struct WrittenMatrix(#[schemars(with = "Vec<Vec<f64>>")] Vec<Vec<Number>>);

impl WrittenMatrix {
    /// Reads it; `letter` is its name in messages.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of the row or entry that is wrong.
    pub(in crate::analysis) fn read(value: &Value, letter: &str, at: &str) -> Result<Self, Problem> {
        read_rows(value, letter, at)?;
        let row = |row: &Value| row.as_array().into_iter().flatten().filter_map(|v| v.as_number().cloned()).collect();
        Ok(Self(value.as_array().into_iter().flatten().map(row).collect()))
    }

    /// As algorithms take it.
    #[must_use]
    pub fn dense(&self) -> DMatrix<f64> {
        let columns = self.0.first().map_or(0, Vec::len);
        let entries = self.0.iter().flatten().map(|number| number.as_f64().unwrap_or(f64::NAN));
        DMatrix::from_row_iterator(self.0.len(), columns, entries)
    }
}

/// A recorded trajectory, along which the cost is shared out: rows are samples, equally spaced in time.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields, rename = "InverseTrajectory")]
pub struct Trajectory {
    /// States, one row of n numbers per sample, each in the unit of its state.
    pub x: WrittenMatrix,
    /// Inputs, one row of m numbers per sample, each in the unit of its input.
    pub u: WrittenMatrix,
}

/// The weights of another regulator, to compare with up to the free scale.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct OtherCost {
    /// Q, n×n, symmetric, positive semidefinite; in units of a cost over those of the states.
    pub q: WrittenMatrix,
    /// R, m×m, symmetric, positive definite; in units of the same cost over those of the inputs.
    pub r: WrittenMatrix,
}

/// The weights of another filter, to compare with up to the free scale.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct OtherNoise {
    /// W, n×n, symmetric, positive semidefinite; in units of a noise of the states.
    pub w: WrittenMatrix,
    /// V, p×p, symmetric, positive definite; in units of a noise of the outputs.
    pub v: WrittenMatrix,
}

/// The weights of another controller, to compare with up to the free scales: q and r, or w and v, or all four.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct OtherController {
    /// Q, n×n, symmetric, positive semidefinite; in units of a cost over those of the states.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub q: Option<WrittenMatrix>,
    /// R, m×m, symmetric, positive definite; in units of the same cost over those of the inputs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub r: Option<WrittenMatrix>,
    /// W, n×n, symmetric, positive semidefinite; in units of a noise of the states.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub w: Option<WrittenMatrix>,
    /// V, p×p, symmetric, positive definite; in units of a noise of the outputs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub v: Option<WrittenMatrix>,
}
