//! What is known of the weights before they are sought: as people write it, and checked.

use crate::analysis::inputs::matrix::dense;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::wrong_spec as wrong;
use crate::inverse::{QSign, Structure, StructureError};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is known of the weight on the states: Q of a regulator, W of a filter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum StateWeight {
    /// `full` or `diagonal`.
    #[schemars(title = "Shape")]
    Name(WeightName),
    /// Entries that may differ from zero, n×n, symmetric.
    #[schemars(title = "Pattern")]
    Pattern {
        /// Rows of true and false.
        pattern: Vec<Vec<bool>>,
    },
}

/// A shape of a weight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WeightName {
    /// Any symmetric matrix.
    Full,
    /// A diagonal one.
    Diagonal,
}

/// What is known of the weight on the inputs: R of a regulator, or V, on the outputs of a filter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum PortWeight {
    /// `full` or `diagonal`.
    #[schemars(title = "Shape")]
    Name(WeightName),
    /// The weight itself, up to its scale.
    #[schemars(title = "Fixed")]
    Fixed {
        /// Rows, m×m, positive definite; in any unit, since only their ratios count.
        fixed: Vec<Vec<f64>>,
    },
    /// Entries that may differ from zero, m×m, symmetric.
    #[schemars(title = "Pattern")]
    Pattern {
        /// Rows of true and false.
        pattern: Vec<Vec<bool>>,
    },
}

fn pattern(rows: &[Vec<bool>], order: usize, at: &str) -> Result<DMatrix<bool>, Problem> {
    if rows.len() != order || rows.iter().any(|row| row.len() != order) {
        return Err(wrong(format!("the pattern has {} rows and must be {order}x{order}", rows.len()), at));
    }
    Ok(DMatrix::from_fn(order, order, |i, j| rows[i][j]))
}

/// What a spec says about the weights of n states and m ports; `at` is the pointer of the object with `state_weight`
/// and `port_weight`.
///
/// # Errors
/// A [`Problem`] with the pointer of the pattern or weight that is wrong.
pub(in crate::analysis) fn structure(
    state_weight: &StateWeight,
    port_weight: &PortWeight,
    semidefinite: bool,
    [n, m]: [usize; 2],
    at: &str,
) -> Result<Structure, Problem> {
    let diagonal = |order: usize| DMatrix::from_fn(order, order, |i, j| i == j);
    let q_sign = if semidefinite { QSign::Semidefinite } else { QSign::Definite };
    let mut structure = Structure { q_sign, ..Structure::default() };
    structure.q_pattern = match state_weight {
        StateWeight::Name(WeightName::Full) => None,
        StateWeight::Name(WeightName::Diagonal) => Some(diagonal(n)),
        StateWeight::Pattern { pattern: rows } => Some(pattern(rows, n, &format!("{at}/state_weight/pattern"))?),
    };
    match port_weight {
        PortWeight::Name(WeightName::Full) => {}
        PortWeight::Name(WeightName::Diagonal) => structure.r_pattern = Some(diagonal(m)),
        PortWeight::Pattern { pattern: rows } => {
            structure.r_pattern = Some(pattern(rows, m, &format!("{at}/port_weight/pattern"))?);
        }
        PortWeight::Fixed { fixed } => {
            structure.r = Some(dense(fixed, "the fixed weight", &format!("{at}/port_weight/fixed"))?);
        }
    }
    structure.check(n, m).map_err(|error| structure_problem(&error, at))?;
    Ok(structure)
}

/// A structure that does not fit, as a problem; `at` as in [`structure`].
pub(in crate::analysis) fn structure_problem(error: &StructureError, at: &str) -> Problem {
    let of = |matrix: &str| match matrix {
        "the pattern of Q" => "state_weight/pattern",
        "the pattern of R" => "port_weight/pattern",
        _ => "port_weight/fixed",
    };
    let place = match error {
        StructureError::Size { matrix, .. }
        | StructureError::NotSymmetric { matrix, .. }
        | StructureError::NoDiagonal { matrix, .. } => of(matrix),
        StructureError::NothingWeighed { .. } | StructureError::Targets { .. } => "state_weight/pattern",
        StructureError::NotDefinite { .. } | StructureError::Entry { .. } | StructureError::Both => "port_weight/fixed",
    };
    Problem::new(Code::Invalid, "unusable structure", error.to_string()).at(format!("{at}/{place}"))
}
