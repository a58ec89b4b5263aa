//! The question: a plant and a gain, checked.

use crate::control::lyapunov::Clock;
use crate::control::structural::{self, StructuralError};
use crate::num::linalg::{self, NoConvergence};
use nalgebra::DMatrix;
use num_complex::Complex64;

/// States at most.
pub const MAX_STATES: usize = 64;
/// Entries of larger magnitude would overflow in products of a few matrices.
pub const LARGEST_ENTRY: f64 = 1e60;

/// Whose letters a message uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// A, B, K.
    Regulator,
    /// A, C, L: the regulator's matrices are Aᵀ, Cᵀ, Lᵀ.
    Filter,
}

impl Role {
    pub(super) fn input(self) -> &'static str {
        if self == Self::Regulator { "B" } else { "C" }
    }

    pub(super) fn gain(self) -> &'static str {
        if self == Self::Regulator { "K" } else { "L" }
    }

    pub(super) fn product(self) -> &'static str {
        if self == Self::Regulator { "A − BK" } else { "A − LC" }
    }
}

/// A plant and a stabilising gain.
///
/// A is n×n, B is n×m and K is m×n with 1 ≤ n ≤ 64 and m ≥ 1; (A, B) is controllable and A − BK is stable. For a filter
/// these are Aᵀ, Cᵀ and Lᵀ.
#[derive(Debug, Clone, PartialEq)]
pub struct Gains {
    pub(super) a: DMatrix<f64>,
    pub(super) b: DMatrix<f64>,
    pub(super) k: DMatrix<f64>,
    pub(super) clock: Clock,
    pub(super) role: Role,
    pub(super) poles: Vec<Complex64>,
}

/// A question that has no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GainsError {
    /// A has another number of columns than of rows.
    #[error("A is {rows}x{columns} and must be square")]
    NotSquare {
        /// Rows of A.
        rows: usize,
        /// Columns of A.
        columns: usize,
    },
    /// A matrix has no rows or no columns.
    #[error("{matrix} is {rows}x{columns}: there must be at least one state and one {port}")]
    Empty {
        /// The letter.
        matrix: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
        /// `input` or `output`.
        port: &'static str,
    },
    /// A matrix does not fit the others.
    #[error(
        "{matrix} is {rows}x{columns} and must be {expected_rows}x{expected_columns} ({states} states, {ports} {port})"
    )]
    Size {
        /// The letter.
        matrix: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
        /// Rows that it must have.
        expected_rows: usize,
        /// Columns that it must have.
        expected_columns: usize,
        /// n.
        states: usize,
        /// m.
        ports: usize,
        /// `inputs` or `outputs`.
        port: &'static str,
    },
    /// Too many states.
    #[error("A is {states}x{states}; at most {MAX_STATES} states are taken")]
    TooManyStates {
        /// n.
        states: usize,
    },
    /// An entry is not finite, or so large that products overflow.
    #[error(
        "{matrix} ({rows}x{columns}) has the entry {value:e} at row {row}, column {column} (counted from 0); \
         magnitudes up to {LARGEST_ENTRY:e} are \
         taken"
    )]
    Entry {
        /// The letter.
        matrix: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The entry.
        value: f64,
    },
    /// The gain is zero.
    #[error("{matrix} ({rows}x{columns}) is zero: it would be optimal only for a cost that ignores the states")]
    ZeroGain {
        /// The letter of the gain.
        matrix: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
    },
    /// The closed loop does not decay.
    #[error("{product} ({states}x{states}) is not stable: it has the eigenvalue {pole}")]
    UnstableLoop {
        /// `A − BK` or `A − LC`.
        product: &'static str,
        /// Its rows and columns.
        states: usize,
        /// The eigenvalue that is worst.
        pole: Complex64,
    },
    /// A mode that no input reaches, or no output sees.
    #[error(
        "(A, {matrix}) with A {states}x{states} and {matrix} {rows}x{columns} is not {property}: {miss} the mode {mode}"
    )]
    Unreachable {
        /// `B` or `C`.
        matrix: &'static str,
        /// Rows and columns of A.
        states: usize,
        /// Rows of B or C.
        rows: usize,
        /// Columns of B or C.
        columns: usize,
        /// `controllable` or `observable`.
        property: &'static str,
        /// `no input reaches` or `no output sees`.
        miss: &'static str,
        /// The eigenvalue.
        mode: Complex64,
    },
    /// An eigenvalue iteration failed.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
}

impl GainsError {
    /// The letter of the matrix that it is about.
    #[must_use]
    pub fn matrix(&self) -> &'static str {
        match self {
            Self::NotSquare { .. } | Self::TooManyStates { .. } | Self::NoConvergence(_) => "A",
            Self::Empty { matrix, .. }
            | Self::Size { matrix, .. }
            | Self::Entry { matrix, .. }
            | Self::ZeroGain { matrix, .. }
            | Self::Unreachable { matrix, .. } => matrix,
            Self::UnstableLoop { product, .. } => {
                if product.contains('K') {
                    "K"
                } else {
                    "L"
                }
            }
        }
    }
}

impl Gains {
    /// A regulator u = −Kx.
    ///
    /// # Errors
    /// [`GainsError`] naming the matrix, its size and the reason.
    pub fn regulator(a: &DMatrix<f64>, b: &DMatrix<f64>, k: &DMatrix<f64>, clock: Clock) -> Result<Self, GainsError> {
        check_shapes(a, b.shape(), k.shape(), Role::Regulator)?;
        Self::checked(a.clone(), b.clone(), k.clone(), clock, Role::Regulator)
    }

    /// A filter `x̂⁺ = Ax̂ + Bu + L(y − Cx̂ − Du)`, with C p×n and L n×p; D does not matter, since the filter knows u.
    ///
    /// # Errors
    /// [`GainsError`] naming the matrix, its size and the reason.
    pub fn filter(a: &DMatrix<f64>, c: &DMatrix<f64>, l: &DMatrix<f64>, clock: Clock) -> Result<Self, GainsError> {
        let swap = |(rows, columns)| (columns, rows);
        check_shapes(a, swap(c.shape()), swap(l.shape()), Role::Filter)?;
        Self::checked(a.transpose(), c.transpose(), l.transpose(), clock, Role::Filter)
    }

    fn checked(
        a: DMatrix<f64>,
        b: DMatrix<f64>,
        k: DMatrix<f64>,
        clock: Clock,
        role: Role,
    ) -> Result<Self, GainsError> {
        // As they are written: a filter's are transposed here.
        let written =
            |(rows, columns): (usize, usize)| if role == Role::Filter { (columns, rows) } else { (rows, columns) };
        for (matrix, value) in [("A", &a), (role.input(), &b), (role.gain(), &k)] {
            let (rows, columns) = written(value.shape());
            for i in 0..value.nrows() {
                for j in 0..value.ncols() {
                    let entry = value[(i, j)];
                    if entry.is_nan() || entry.abs() > LARGEST_ENTRY {
                        let (row, column) = written((i, j));
                        return Err(GainsError::Entry { matrix, rows, columns, row, column, value: entry });
                    }
                }
            }
        }
        if k.norm() < LARGEST_ENTRY.recip() {
            let (rows, columns) = written(k.shape());
            return Err(GainsError::ZeroGain { matrix: role.gain(), rows, columns });
        }
        structural::check_controllable(&a, &b).map_err(|error| match error {
            StructuralError::NoConvergence(e) => e.into(),
            StructuralError::NotControllable(mode)
            | StructuralError::NotStabilisable(mode)
            | StructuralError::NotDetectable(mode)
            | StructuralError::UnseenBoundaryMode(mode) => {
                let (property, miss) = match role {
                    Role::Regulator => ("controllable", "no input reaches"),
                    Role::Filter => ("observable", "no output sees"),
                };
                let (rows, columns) = written(b.shape());
                GainsError::Unreachable { matrix: role.input(), states: a.nrows(), rows, columns, property, miss, mode }
            }
        })?;
        let poles = linalg::eigenvalues(&(&a - &b * &k))?;
        let worst = poles.iter().copied().min_by(|x, y| clock.margin(*x).total_cmp(&clock.margin(*y)));
        if let Some(pole) = worst.filter(|pole| clock.margin(*pole) <= 0.0) {
            return Err(GainsError::UnstableLoop { product: role.product(), states: a.nrows(), pole });
        }
        Ok(Self { a, b, k, clock, role, poles })
    }

    /// n.
    #[must_use]
    pub fn states(&self) -> usize {
        self.a.nrows()
    }

    /// m: inputs of a regulator, outputs of a filter.
    #[must_use]
    pub fn ports(&self) -> usize {
        self.b.ncols()
    }

    /// A, of a filter Aᵀ.
    #[must_use]
    pub fn a(&self) -> &DMatrix<f64> {
        &self.a
    }

    /// B, of a filter Cᵀ.
    #[must_use]
    pub fn b(&self) -> &DMatrix<f64> {
        &self.b
    }

    /// K, of a filter Lᵀ.
    #[must_use]
    pub fn k(&self) -> &DMatrix<f64> {
        &self.k
    }

    /// The time base.
    #[must_use]
    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// Whose letters messages use.
    #[must_use]
    pub fn role(&self) -> Role {
        self.role
    }

    /// Eigenvalues of the closed loop.
    #[must_use]
    pub fn poles(&self) -> &[Complex64] {
        &self.poles
    }

    /// A − BK.
    pub(super) fn closed_loop(&self) -> DMatrix<f64> {
        &self.a - &self.b * &self.k
    }
}

/// Sizes, with those of the input matrix and of the gain given as a regulator has them.
fn check_shapes(a: &DMatrix<f64>, b: (usize, usize), k: (usize, usize), role: Role) -> Result<(), GainsError> {
    let is_filter = role == Role::Filter;
    let written = |(rows, columns): (usize, usize)| if is_filter { (columns, rows) } else { (rows, columns) };
    let (rows, columns) = a.shape();
    if rows != columns {
        return Err(GainsError::NotSquare { rows, columns });
    }
    let port = if is_filter { "output" } else { "input" };
    for (matrix, shape) in [("A", (rows, columns)), (role.input(), written(b))] {
        if shape.0 == 0 || shape.1 == 0 {
            return Err(GainsError::Empty { matrix, rows: shape.0, columns: shape.1, port });
        }
    }
    if rows > MAX_STATES {
        return Err(GainsError::TooManyStates { states: rows });
    }
    let ports = b.1;
    for (matrix, found, expected) in [(role.input(), b, (rows, ports)), (role.gain(), k, (ports, rows))] {
        if found != expected {
            let ((rows_found, columns_found), (expected_rows, expected_columns)) = (written(found), written(expected));
            return Err(GainsError::Size {
                matrix,
                rows: rows_found,
                columns: columns_found,
                expected_rows,
                expected_columns,
                states: rows,
                ports,
                port: if is_filter { "outputs" } else { "inputs" },
            });
        }
    }
    Ok(())
}
