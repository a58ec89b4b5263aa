//! State space models with checked shapes.

use super::time_base::TimeBase;
use crate::num::linalg::{self, NoConvergence};
use nalgebra::DMatrix;
use num_complex::Complex64;

/// `x⁺ = A x + B u`, `y = C x + D u`, where `x⁺` is the derivative in continuous time and the next state in sampled
/// time.
///
/// With n states, m inputs and p outputs, A is n×n, B is n×m, C is p×n and D is p×m. n may be 0 (a static gain); m and
/// p are at least 1. Every entry is finite.
#[derive(Debug, Clone, PartialEq)]
pub struct StateSpace<T> {
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    c: DMatrix<f64>,
    d: DMatrix<f64>,
    time: T,
}

/// Matrices that do not make a state space model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StateSpaceError {
    /// A matrix does not have the size that the others ask for.
    #[error(
        "{matrix} is {rows}x{columns} and must be {expected_rows}x{expected_columns} \
         ({states} states, {inputs} inputs and {outputs} outputs by the sizes of A and D)"
    )]
    Size {
        /// `A`, `B`, `C` or `D`.
        matrix: &'static str,
        /// Rows that it has.
        rows: usize,
        /// Columns that it has.
        columns: usize,
        /// Rows that it must have.
        expected_rows: usize,
        /// Columns that it must have.
        expected_columns: usize,
        /// Rows of A.
        states: usize,
        /// Columns of D.
        inputs: usize,
        /// Rows of D.
        outputs: usize,
    },
    /// D has no row or no column, so that there is no output or no input.
    #[error("D is {rows}x{columns}: a model has at least one output and one input")]
    NoPort {
        /// Rows of D.
        rows: usize,
        /// Columns of D.
        columns: usize,
    },
    /// An entry is NaN or infinite.
    #[error("{matrix} has an entry that is not finite at row {row}, column {column} (counted from 0)")]
    NotFinite {
        /// `A`, `B`, `C` or `D`.
        matrix: &'static str,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
    },
}

impl<T: TimeBase> StateSpace<T> {
    /// From its four matrices.
    ///
    /// # Errors
    /// [`StateSpaceError`] where the sizes disagree, there is no input or output, or an entry is not finite.
    pub fn new(
        a: DMatrix<f64>,
        b: DMatrix<f64>,
        c: DMatrix<f64>,
        d: DMatrix<f64>,
        time: T,
    ) -> Result<Self, StateSpaceError> {
        let (states, inputs, outputs) = (a.nrows(), d.ncols(), d.nrows());
        if inputs == 0 || outputs == 0 {
            return Err(StateSpaceError::NoPort { rows: outputs, columns: inputs });
        }
        let wanted = [
            ("A", &a, states, states),
            ("B", &b, states, inputs),
            ("C", &c, outputs, states),
            ("D", &d, outputs, inputs),
        ];
        for (matrix, value, expected_rows, expected_columns) in wanted {
            let (rows, columns) = value.shape();
            if (rows, columns) != (expected_rows, expected_columns) {
                return Err(StateSpaceError::Size {
                    matrix,
                    rows,
                    columns,
                    expected_rows,
                    expected_columns,
                    states,
                    inputs,
                    outputs,
                });
            }
            for row in 0..rows {
                if let Some(column) = (0..columns).find(|column| !value[(row, *column)].is_finite()) {
                    return Err(StateSpaceError::NotFinite { matrix, row, column });
                }
            }
        }
        Ok(Self { a, b, c, d, time })
    }

    /// The state matrix, n×n.
    #[must_use]
    pub fn a(&self) -> &DMatrix<f64> {
        &self.a
    }

    /// The input matrix, n×m.
    #[must_use]
    pub fn b(&self) -> &DMatrix<f64> {
        &self.b
    }

    /// The output matrix, p×n.
    #[must_use]
    pub fn c(&self) -> &DMatrix<f64> {
        &self.c
    }

    /// The feedthrough matrix, p×m.
    #[must_use]
    pub fn d(&self) -> &DMatrix<f64> {
        &self.d
    }

    /// The time base.
    #[must_use]
    pub fn time(&self) -> T {
        self.time
    }

    /// The number of states, n.
    #[must_use]
    pub fn states(&self) -> usize {
        self.a.nrows()
    }

    /// The number of inputs, m.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.d.ncols()
    }

    /// The number of outputs, p.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.d.nrows()
    }

    /// The eigenvalues of A.
    ///
    /// # Errors
    /// [`NoConvergence`] if the eigenvalue iteration fails.
    pub fn poles(&self) -> Result<Vec<Complex64>, NoConvergence> {
        if self.states() == 0 { Ok(Vec::new()) } else { linalg::eigenvalues(&self.a) }
    }

    /// The value `C (x I − A)⁻¹ B + D` at a point of the complex plane, p×m; `None` at an eigenvalue of A.
    #[must_use]
    pub fn eval(&self, x: Complex64) -> Option<DMatrix<Complex64>> {
        let complex = |m: &DMatrix<f64>| m.map(|v| Complex64::new(v, 0.0));
        if self.states() == 0 {
            return Some(complex(&self.d));
        }
        let resolvent = DMatrix::from_diagonal_element(self.states(), self.states(), x) - complex(&self.a);
        let states = resolvent.lu().solve(&complex(&self.b))?;
        Some(complex(&self.c) * states + complex(&self.d))
    }

    /// The frequency response at the angular frequency `omega_rad_s`, p×m; `None` where a pole lies there.
    #[must_use]
    pub fn response(&self, omega_rad_s: f64) -> Option<DMatrix<Complex64>> {
        self.eval(self.time.point(omega_rad_s))
    }

    /// The same system in states scaled by powers of two, such that rows and columns of `[A B; C 0]` are about equally
    /// large (Parlett and Reinsch, Numer. Math. 13, 293–304, 1969; here with the input and output as weights).
    ///
    /// Exact: no entry is rounded. Companion matrices need it before they are exponentiated or decomposed.
    #[must_use]
    pub fn balanced(&self) -> Self {
        self.balancing().0
    }

    /// [`StateSpace::balanced`] with the scales s of its states: the state x of this model is `s ∘ x` of the other.
    pub(crate) fn balancing(&self) -> (Self, Vec<f64>) {
        const MAX_SWEEPS: usize = 100;
        let mut balanced = self.clone();
        let n = self.states();
        let mut scales = vec![1.0; n];
        for _ in 0..MAX_SWEEPS {
            let mut changed = false;
            for (i, scale) in scales.iter_mut().enumerate() {
                let off_diagonal = |j: &usize| *j != i;
                let column: f64 = (0..n).filter(off_diagonal).map(|j| balanced.a[(j, i)].abs()).sum::<f64>()
                    + balanced.c.column(i).iter().map(|v| v.abs()).sum::<f64>();
                let row: f64 = (0..n).filter(off_diagonal).map(|j| balanced.a[(i, j)].abs()).sum::<f64>()
                    + balanced.b.row(i).iter().map(|v| v.abs()).sum::<f64>();
                if column == 0.0 || row == 0.0 {
                    continue;
                }
                // The factor that makes both equal, rounded to a power of two.
                let exponent = (0.5 * (row / column).log2()).round().clamp(-500.0, 500.0);
                let factor = exponent.exp2();
                if column * factor + row / factor >= 0.95 * (column + row) {
                    continue;
                }
                changed = true;
                balanced.a.column_mut(i).scale_mut(factor);
                balanced.c.column_mut(i).scale_mut(factor);
                balanced.a.row_mut(i).scale_mut(1.0 / factor);
                balanced.b.row_mut(i).scale_mut(1.0 / factor);
                *scale *= factor;
            }
            if !changed {
                break;
            }
        }
        (balanced, scales)
    }
}
