//! Algebraic Riccati equations.
//!
//! Two methods that share no step, structure-preserving doubling ([`doubling()`]) and the matrix sign function
//! ([`sign_function`]), start [`newton()`], whose answer is accepted only with a stable closed loop and a small
//! residual.
#![allow(non_snake_case)]

mod doubling;
mod newton;
mod sign;

use super::lyapunov::{Clock, LinearEquationError};
use super::structural::{self, StructuralError};
use crate::num::linalg::{NoConvergence, solve_symmetric, symmetric};
pub use doubling::doubling;
use nalgebra::DMatrix;
use newton::{Newton, newton};
use num_complex::Complex64;
pub use sign::sign_function;

/// A weight is symmetric where it differs from its transpose by less than this share of its norm.
pub(crate) const SYMMETRY: f64 = 1e-10;
/// A weight is positive semidefinite where its least eigenvalue is above minus this share of its largest.
pub(crate) const SEMIDEFINITE: f64 = 1e-12;
/// Relative residual up to which a solution is accepted. Random equations end at 1e-15; this is for loops whose fast
/// poles are 1e9 times their slow ones, where A is lost in A − BK.
pub(crate) const RESIDUAL: f64 = 1e-6;

/// The equation `AᵀP + PA − PBR⁻¹BᵀP + Q = 0`, in sampled time `AᵀPA − P − AᵀPB(R + BᵀPB)⁻¹BᵀPA + Q = 0`.
///
/// With n states and m inputs A and Q are n×n, B is n×m and R is m×m; the sizes agree, Q and R are exactly symmetric, R
/// ≻ 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Riccati {
    pub(crate) a: DMatrix<f64>,
    pub(crate) b: DMatrix<f64>,
    pub(crate) q: DMatrix<f64>,
    pub(crate) r: DMatrix<f64>,
    pub(crate) clock: Clock,
}

/// The stabilising solution.
#[derive(Debug, Clone, PartialEq)]
pub struct RiccatiSolution {
    /// P, n×n, symmetric.
    pub p: DMatrix<f64>,
    /// K, m×n: `R⁻¹BᵀP`, in sampled time `(R + BᵀPB)⁻¹BᵀPA`; A − BK is stable.
    pub k: DMatrix<f64>,
    /// Eigenvalues of A − BK.
    pub poles: Vec<Complex64>,
    /// Norm of the equation's left side, over the sum of the norms of its terms.
    pub residual: f64,
}

/// Which hypothesis of the Riccati equation fails.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RiccatiError {
    /// A matrix does not have the size that the others ask for.
    #[error("{matrix} is {rows}x{columns} and must be {expected_rows}x{expected_columns}")]
    Size {
        /// The letter of the matrix.
        matrix: &'static str,
        /// Rows that it has.
        rows: usize,
        /// Columns that it has.
        columns: usize,
        /// Rows that it must have.
        expected_rows: usize,
        /// Columns that it must have.
        expected_columns: usize,
    },
    /// An entry is NaN or infinite.
    #[error("{matrix} has an entry that is not finite at row {row}, column {column} (counted from 0)")]
    NotFinite {
        /// The letter of the matrix.
        matrix: &'static str,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
    },
    /// A weight differs from its transpose.
    #[error("{matrix} is not symmetric: it differs from its transpose by {asymmetry:.1e} of its norm")]
    NotSymmetric {
        /// The letter of the matrix.
        matrix: &'static str,
        /// `‖M − Mᵀ‖/‖M‖`.
        asymmetry: f64,
    },
    /// R has an eigenvalue that is not positive.
    #[error("{matrix} is not positive definite: its least eigenvalue is {least:e}")]
    NotDefinite {
        /// The letter of the matrix.
        matrix: &'static str,
        /// Its least eigenvalue.
        least: f64,
    },
    /// Q has a negative eigenvalue.
    #[error("{matrix} is not positive semidefinite: its least eigenvalue is {least:e}")]
    NotSemidefinite {
        /// The letter of the matrix.
        matrix: &'static str,
        /// Its least eigenvalue.
        least: f64,
    },
    /// No feedback stabilises the plant, or the cost does not see a mode that does not decay.
    #[error(transparent)]
    Structure(#[from] StructuralError),
    /// No method found a stabilising solution with a small residual.
    #[error("no stabilising solution was found: {reason} (relative residual {residual:.1e})")]
    Unsolved {
        /// What failed last.
        reason: &'static str,
        /// The residual that the best attempt reached; infinite without any.
        residual: f64,
    },
    /// A Lyapunov equation of Newton's method is singular.
    #[error(transparent)]
    Linear(#[from] LinearEquationError),
    /// An eigenvalue iteration failed.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
}

fn check_size(
    matrix: &'static str,
    value: &DMatrix<f64>,
    expected_rows: usize,
    expected_columns: usize,
) -> Result<(), RiccatiError> {
    let (rows, columns) = value.shape();
    if (rows, columns) != (expected_rows, expected_columns) {
        return Err(RiccatiError::Size { matrix, rows, columns, expected_rows, expected_columns });
    }
    for row in 0..rows {
        if let Some(column) = (0..columns).find(|column| !value[(row, *column)].is_finite()) {
            return Err(RiccatiError::NotFinite { matrix, row, column });
        }
    }
    Ok(())
}

fn check_symmetric(matrix: &'static str, value: &DMatrix<f64>) -> Result<DMatrix<f64>, RiccatiError> {
    let asymmetry = (value - value.transpose()).norm() / value.norm().max(f64::MIN_POSITIVE);
    if asymmetry > SYMMETRY { Err(RiccatiError::NotSymmetric { matrix, asymmetry }) } else { Ok(symmetric(value)) }
}

/// The least and the largest eigenvalue of a symmetric matrix; zeros of an empty one.
fn extreme_eigenvalues(m: &DMatrix<f64>) -> (f64, f64) {
    if m.is_empty() {
        return (0.0, 0.0);
    }
    let values = m.symmetric_eigenvalues();
    (values.min(), values.max())
}

impl Riccati {
    /// Checks sizes, symmetry and signs: R ≻ 0, Q ⪰ 0.
    ///
    /// # Errors
    /// [`RiccatiError`] naming the matrix.
    pub fn new(
        a: &DMatrix<f64>,
        b: &DMatrix<f64>,
        q: &DMatrix<f64>,
        r: &DMatrix<f64>,
        clock: Clock,
    ) -> Result<Self, RiccatiError> {
        let riccati = Self::indefinite(a, b, q, r, clock)?;
        let (least, largest) = extreme_eigenvalues(&riccati.q);
        if least < -SEMIDEFINITE * largest.abs().max(-least) {
            return Err(RiccatiError::NotSemidefinite { matrix: "Q", least });
        }
        Ok(riccati)
    }

    /// The same, with a Q of any sign: a stabilising solution may exist all the same, and is only then returned.
    ///
    /// # Errors
    /// [`RiccatiError`] naming the matrix.
    pub(crate) fn indefinite(
        a: &DMatrix<f64>,
        b: &DMatrix<f64>,
        q: &DMatrix<f64>,
        r: &DMatrix<f64>,
        clock: Clock,
    ) -> Result<Self, RiccatiError> {
        let (n, m) = (a.nrows(), b.ncols());
        check_size("A", a, n, n)?;
        check_size("B", b, n, m)?;
        check_size("Q", q, n, n)?;
        check_size("R", r, m, m)?;
        let (q, r) = (check_symmetric("Q", q)?, check_symmetric("R", r)?);
        if r.clone().cholesky().is_none() {
            return Err(RiccatiError::NotDefinite { matrix: "R", least: extreme_eigenvalues(&r).0 });
        }
        Ok(Self { a: a.clone(), b: b.clone(), q, r, clock })
    }

    /// The stabilising solution.
    ///
    /// # Errors
    /// [`RiccatiError::Structure`] where (A, B) is not stabilisable, or Q does not see a mode on the boundary of
    /// stability (no solution is stabilising then); [`RiccatiError::Unsolved`] where rounding leaves no method a
    /// solution.
    pub fn solve(&self) -> Result<RiccatiSolution, RiccatiError> {
        let mut last = RiccatiError::Unsolved { reason: "no method converged", residual: f64::INFINITY };
        for method in [doubling, sign_function] {
            let Some(p) = method(self) else { continue };
            match self.finish(&self.gain(&p)) {
                Ok(solution) => return Ok(solution),
                Err(error) => last = error,
            }
        }
        // Say which hypothesis fails, if one does.
        structural::check_stabilisable(&self.a, &self.b, self.clock)?;
        structural::check_axis_observable(&self.a, &self.q, self.clock)?;
        Err(last)
    }

    /// The stabilising solution by Newton's method from a stabilising gain.
    ///
    /// # Errors
    /// [`RiccatiError`] where the gain does not stabilise, or the iteration ends with a large residual.
    pub fn finish(&self, stabilising: &DMatrix<f64>) -> Result<RiccatiSolution, RiccatiError> {
        let Newton { p, k, poles, .. } = newton(self, stabilising)?;
        let residual = self.relative_residual(&p);
        let stable = poles.iter().all(|pole| self.clock.margin(*pole) > 0.0);
        if !stable {
            return Err(RiccatiError::Unsolved { reason: "the closed loop is not stable", residual });
        }
        if residual.is_nan() || residual > RESIDUAL {
            return Err(RiccatiError::Unsolved { reason: "the residual stays large", residual });
        }
        Ok(RiccatiSolution { p, k, poles, residual })
    }

    /// `R⁻¹BᵀP`, in sampled time `(R + BᵀPB)⁻¹BᵀPA`.
    #[must_use]
    pub fn gain(&self, p: &DMatrix<f64>) -> DMatrix<f64> {
        let bp = self.b.tr_mul(p);
        let (weight, right) = match self.clock {
            Clock::Continuous => (self.r.clone(), bp),
            Clock::Sampled => (symmetric(&(&self.r + &bp * &self.b)), &bp * &self.a),
        };
        solve_symmetric(&weight, &right)
    }

    /// The left side of the equation, n×n.
    #[must_use]
    pub fn residual(&self, p: &DMatrix<f64>) -> DMatrix<f64> {
        self.terms(p).into_iter().fold(DMatrix::zeros(p.nrows(), p.ncols()), |sum, term| sum + term)
    }

    /// The norm of the left side over the sum of the norms of its terms; 0 for an equation of zeros.
    #[must_use]
    pub(crate) fn relative_residual(&self, p: &DMatrix<f64>) -> f64 {
        let terms = self.terms(p);
        let scale: f64 = terms.iter().map(DMatrix::norm).sum();
        if scale == 0.0 { 0.0 } else { self.residual(p).norm() / scale }
    }

    fn terms(&self, p: &DMatrix<f64>) -> [DMatrix<f64>; 4] {
        let bp = self.b.tr_mul(p);
        match self.clock {
            Clock::Continuous => {
                let pa = p * &self.a;
                [pa.transpose(), pa, -bp.tr_mul(&solve_symmetric(&self.r, &bp)), self.q.clone()]
            }
            Clock::Sampled => {
                let bpa = &bp * &self.a;
                let weight = symmetric(&(&self.r + &bp * &self.b));
                let apa = self.a.tr_mul(&(p * &self.a));
                [apa, -p, -bpa.tr_mul(&solve_symmetric(&weight, &bpa)), self.q.clone()]
            }
        }
    }

    /// `BR⁻¹Bᵀ`.
    fn input_weight(&self) -> DMatrix<f64> {
        symmetric(&(&self.b * solve_symmetric(&self.r, &self.b.transpose())))
    }
}
