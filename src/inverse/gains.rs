//! The question: a plant and a gain, checked.

use super::reach::{Reach, ReachError, Targets};
use crate::control::lyapunov::Clock;
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
/// A is n×n, B is n×m and K is m×n with 1 ≤ n ≤ 64 and m ≥ 1; the inputs reach a state at least, and A − BK is stable
/// by more than rounding, but for set points that no input reaches and that cost nothing to hold. For a filter these
/// are Aᵀ, Cᵀ and Lᵀ.
#[derive(Debug, Clone, PartialEq)]
pub struct Gains {
    pub(super) a: DMatrix<f64>,
    pub(super) b: DMatrix<f64>,
    pub(super) k: DMatrix<f64>,
    pub(super) clock: Clock,
    pub(super) role: Role,
    pub(super) poles: Vec<Complex64>,
    pub(super) reach: Reach,
}

/// What is known of the gain beside its entries.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Knowledge {
    /// Half a unit of the last digit of each entry, absolute and not negative, in the shape of the gain as it is
    /// written (n×p of a filter); none where the entries are as exact as their doubles.
    pub gain_rounding: Option<DMatrix<f64>>,
    /// A discount of the cost: the factor γ < 1 of each sample, or in continuous time the rate ρ > 0 of `e^(−ρt)`, per
    /// unit of time. The question is then that of √γ A and √γ B, or of A − ρI/2.
    pub discount: Option<f64>,
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
         magnitudes up to {LARGEST_ENTRY:e} are taken"
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
    /// The closed loop is stable only within the rounding of its data.
    #[error(
        "{product} ({states}x{states}) is stable only within rounding: its eigenvalue {pole} may move by {shift:.1e}"
    )]
    MarginalLoop {
        /// `A − BK` or `A − LC`.
        product: &'static str,
        /// Its rows and columns.
        states: usize,
        /// The eigenvalue.
        pole: Complex64,
        /// How far the rounding of the data may move it, to first order.
        shift: f64,
    },
    /// No input reaches any state, or no output sees one.
    #[error("{matrix} is {rows}x{columns} and zero: {miss}")]
    Unreachable {
        /// `B` or `C`.
        matrix: &'static str,
        /// Rows of B or C.
        rows: usize,
        /// Columns of B or C.
        columns: usize,
        /// `no input reaches a state` or `no output sees one`.
        miss: &'static str,
    },
    /// A mode that no input reaches (no output sees) does not decay, and holding against it costs for ever.
    #[error(
        "{miss} the mode {mode}, which does not decay, and {matrix} answers it with {cost:.1e} in the steady state: \
         the cost is infinite"
    )]
    EndlessCost {
        /// The letter of the gain.
        matrix: &'static str,
        /// `no input reaches` or `no output sees`.
        miss: &'static str,
        /// The mode.
        mode: Complex64,
        /// ‖KV‖ over the set points V, in balanced units.
        cost: f64,
    },
    /// What is known beside the gain does not fit.
    #[error("{0}")]
    Knowledge(&'static str),
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
            | Self::EndlessCost { matrix, .. }
            | Self::Unreachable { matrix, .. } => matrix,
            Self::Knowledge(_) => "K",
            Self::UnstableLoop { product, .. } | Self::MarginalLoop { product, .. } => {
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
        Self::regulator_with(a, b, k, clock, &Knowledge::default())
    }

    /// The same with what is known beside the gain.
    ///
    /// # Errors
    /// [`GainsError`] naming the matrix, its size and the reason.
    pub fn regulator_with(
        a: &DMatrix<f64>,
        b: &DMatrix<f64>,
        k: &DMatrix<f64>,
        clock: Clock,
        knowledge: &Knowledge,
    ) -> Result<Self, GainsError> {
        check_shapes(a, b.shape(), k.shape(), Role::Regulator)?;
        Self::checked(a.clone(), b.clone(), k.clone(), clock, Role::Regulator, knowledge)
    }

    /// A filter `x̂⁺ = Ax̂ + Bu + L(y − Cx̂ − Du)`, with C p×n and L n×p; D does not matter, since the filter knows u.
    ///
    /// # Errors
    /// [`GainsError`] naming the matrix, its size and the reason.
    pub fn filter(a: &DMatrix<f64>, c: &DMatrix<f64>, l: &DMatrix<f64>, clock: Clock) -> Result<Self, GainsError> {
        Self::filter_with(a, c, l, clock, &Knowledge::default())
    }

    /// The same with what is known beside the gain.
    ///
    /// # Errors
    /// [`GainsError`] naming the matrix, its size and the reason.
    pub fn filter_with(
        a: &DMatrix<f64>,
        c: &DMatrix<f64>,
        l: &DMatrix<f64>,
        clock: Clock,
        knowledge: &Knowledge,
    ) -> Result<Self, GainsError> {
        let swap = |(rows, columns)| (columns, rows);
        check_shapes(a, swap(c.shape()), swap(l.shape()), Role::Filter)?;
        let dual = Knowledge { gain_rounding: knowledge.gain_rounding.as_ref().map(DMatrix::transpose), ..*knowledge };
        Self::checked(a.transpose(), c.transpose(), l.transpose(), clock, Role::Filter, &dual)
    }

    fn checked(
        a: DMatrix<f64>,
        b: DMatrix<f64>,
        k: DMatrix<f64>,
        clock: Clock,
        role: Role,
        knowledge: &Knowledge,
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
        if let Some(rounding) = &knowledge.gain_rounding
            && (rounding.shape() != k.shape() || rounding.iter().any(|v| !(v.is_finite() && *v >= 0.0)))
        {
            return Err(GainsError::Knowledge("the rounding of the gain must have its shape, with numbers from 0 on"));
        }
        let (a, b) = match (knowledge.discount, clock) {
            (None, _) => (a, b),
            (Some(gamma), Clock::Sampled) if gamma > 0.0 && gamma < 1.0 => (a * gamma.sqrt(), b * gamma.sqrt()),
            (Some(rate), Clock::Continuous) if rate > 0.0 && rate <= LARGEST_ENTRY => {
                let n = a.nrows();
                (a - DMatrix::identity(n, n) * (0.5 * rate), b)
            }
            (Some(_), Clock::Sampled) => {
                return Err(GainsError::Knowledge("the discount of a sample must lie between 0 and 1"));
            }
            (Some(_), Clock::Continuous) => {
                return Err(GainsError::Knowledge("the rate of the discount must be positive"));
            }
        };
        let (miss_any, miss) = match role {
            Role::Regulator => ("no input reaches a state", "no input reaches"),
            Role::Filter => ("no output sees a state", "no output sees"),
        };
        let (states, product) = (a.nrows(), role.product());
        let reach = Reach::new(&a, &b, &k, clock, knowledge.gain_rounding.as_ref()).map_err(|error| match error {
            ReachError::NoConvergence(error) => error.into(),
            ReachError::Nothing => {
                let (rows, columns) = written(b.shape());
                GainsError::Unreachable { matrix: role.input(), rows, columns, miss: miss_any }
            }
            ReachError::Unstable(pole) => GainsError::UnstableLoop { product, states, pole },
            ReachError::Marginal { pole, shift } => GainsError::MarginalLoop { product, states, pole, shift },
            ReachError::EndlessCost { mode, cost } => GainsError::EndlessCost { matrix: role.gain(), miss, mode, cost },
        })?;
        let poles = linalg::eigenvalues(&(&a - &b * &k))?;
        Ok(Self { a, b, k, clock, role, poles, reach })
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

    /// Targets or references in the state that no input reaches, where there are any.
    #[must_use]
    pub fn targets(&self) -> Option<&Targets> {
        self.reach.targets.as_ref()
    }

    /// Modes that no input reaches (no output sees) and that decay by themselves: their part of the gain is free.
    #[must_use]
    pub fn decaying(&self) -> &[Complex64] {
        &self.reach.decaying
    }

    /// The bounds of the gain's entries within which the verdict holds, m×n; `None` where inputs do not reach every
    /// state.
    #[must_use]
    pub fn rounding(&self) -> Option<DMatrix<f64>> {
        self.reach.gain_box()
    }

    /// The question about the errors from the set points.
    pub(super) fn errors(&self, targets: &Targets) -> Self {
        let [a, b, k] = targets.errors.clone();
        let reach = self.reach.without_targets();
        Self { a, b, k, reach, ..self.clone() }
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
