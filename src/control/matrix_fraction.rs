//! Matrix fraction descriptions (Kailath, *Linear Systems*, 1980, chapter 6): transfer matrices as quotients of
//! polynomial matrices.

use super::polynomial_matrix::PolynomialMatrix;
use super::state_space::{StateSpace, StateSpaceError};
use super::time_base::TimeBase;
use super::transfer_function::{TransferFunction, TransferFunctionError};
use nalgebra::DMatrix;
use num_complex::Complex64;

/// Two polynomial matrices that make no fraction.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FractionError {
    /// The denominator is not square, or does not have the size that the numerator asks for.
    #[error(
        "the denominator is {rows}x{columns} and the numerator {numerator_rows}x{numerator_columns}; \
         the denominator must be {expected}x{expected}"
    )]
    Size {
        /// Rows of the denominator.
        rows: usize,
        /// Columns of the denominator.
        columns: usize,
        /// Rows of the numerator.
        numerator_rows: usize,
        /// Columns of the numerator.
        numerator_columns: usize,
        /// Rows and columns that the denominator must have.
        expected: usize,
    },
    /// The denominator is singular, or the coefficients of the highest power of each of its columns are.
    #[error(
        "the denominator is not column reduced: the coefficients of the highest power of each column make a singular \
         matrix; multiply numerator and denominator from the right by a unimodular matrix that reduces it"
    )]
    NotReduced,
    /// A column of the numerator has a higher degree than that of the denominator.
    #[error(
        "column {column} (counted from 0) is improper: numerator of degree {numerator}, denominator of degree \
         {denominator}"
    )]
    Improper {
        /// The column, from 0.
        column: usize,
        /// Degree of the numerator's column.
        numerator: usize,
        /// Degree of the denominator's column.
        denominator: usize,
    },
}

/// A proper right fraction `G(x) = N(x) D(x)⁻¹` with N p×m and D m×m, column reduced.
///
/// Common right factors of N and D are kept: their roots are modes that the outputs do not show, and must stay visible.
#[derive(Debug, Clone, PartialEq)]
pub struct RightFraction<T> {
    numerator: PolynomialMatrix,
    denominator: PolynomialMatrix,
    degrees: Vec<usize>,
    time: T,
}

impl<T: TimeBase> RightFraction<T> {
    /// From numerator and denominator.
    ///
    /// # Errors
    /// [`FractionError`] where the sizes disagree, D is not column reduced or `N D⁻¹` is not proper.
    pub fn new(numerator: PolynomialMatrix, denominator: PolynomialMatrix, time: T) -> Result<Self, FractionError> {
        let expected = numerator.columns();
        if denominator.shape() != (expected, expected) {
            return Err(FractionError::Size {
                rows: denominator.rows(),
                columns: denominator.columns(),
                numerator_rows: numerator.rows(),
                numerator_columns: expected,
                expected,
            });
        }
        let degrees: Option<Vec<usize>> = (0..expected).map(|j| denominator.column_degree(j)).collect();
        let degrees = degrees.ok_or(FractionError::NotReduced)?;
        let fraction = Self { numerator, denominator, degrees, time };
        let highest = fraction.highest(&fraction.denominator);
        let sizes: f64 = highest.column_iter().map(|c| c.norm()).product();
        // Written so that NaN fails too.
        let is_reduced = highest.determinant().abs() > 1e-12 * sizes;
        if !is_reduced {
            return Err(FractionError::NotReduced);
        }
        for (column, denominator) in fraction.degrees.iter().copied().enumerate() {
            match fraction.numerator.column_degree(column) {
                Some(numerator) if numerator > denominator => {
                    return Err(FractionError::Improper { column, numerator, denominator });
                }
                _ => {}
            }
        }
        Ok(fraction)
    }

    /// The coefficients of `x^{k_j}` in column j, k_j being the degree of the denominator's column.
    fn highest(&self, matrix: &PolynomialMatrix) -> DMatrix<f64> {
        DMatrix::from_fn(matrix.rows(), matrix.columns(), |i, j| {
            matrix.entry(i, j).coefficients().iter().rev().nth(self.degrees[j]).copied().unwrap_or(0.0)
        })
    }

    /// N, p×m.
    #[must_use]
    pub fn numerator(&self) -> &PolynomialMatrix {
        &self.numerator
    }

    /// D, m×m.
    #[must_use]
    pub fn denominator(&self) -> &PolynomialMatrix {
        &self.denominator
    }

    /// The time base.
    #[must_use]
    pub fn time(&self) -> T {
        self.time
    }

    /// The degree of det D: the sum of the column degrees.
    #[must_use]
    pub fn states(&self) -> usize {
        self.degrees.iter().sum()
    }

    /// The value at infinity, p×m.
    #[must_use]
    pub(crate) fn feedthrough(&self) -> DMatrix<f64> {
        let lead = self.highest(&self.denominator).lu();
        // Column reduced: the matrix of the highest coefficients is invertible.
        self.highest(&self.numerator)
            * lead.try_inverse().unwrap_or_else(|| DMatrix::zeros(self.degrees.len(), self.degrees.len()))
    }

    /// The value at a point of the complex plane, p×m; `None` at a root of det D.
    #[must_use]
    pub fn eval(&self, x: Complex64) -> Option<DMatrix<Complex64>> {
        // N D⁻¹ = (D⁻ᵀ Nᵀ)ᵀ, without conjugation.
        let solved = self.denominator.eval(x).transpose().lu().solve(&self.numerator.eval(x).transpose())?;
        Some(solved.transpose())
    }

    /// The controller form: with `D = D_h diag(x^{k_j}) + D_l Ψ(x)` and `N = N_h diag(x^{k_j}) + N_l Ψ(x)`, where Ψ
    /// holds `x^{k_j − 1} … 1` in its j-th column, chains of k_j delays (integrators) fed by `D_h⁻¹ (u − D_l ξ)`, and
    /// `y = N_h D_h⁻¹ u + (N_l − N_h D_h⁻¹ D_l) ξ` (Kailath, section 6.4.1).
    ///
    /// # Errors
    /// [`StateSpaceError`] where a coefficient overflows.
    pub fn to_state_space(&self) -> Result<StateSpace<T>, StateSpaceError> {
        let (inputs, states) = (self.degrees.len(), self.states());
        let first: Vec<usize> = (0..inputs).map(|j| self.degrees[..j].iter().sum()).collect();
        let lower = |matrix: &PolynomialMatrix| {
            let mut low = DMatrix::zeros(matrix.rows(), states);
            for (j, degree) in self.degrees.iter().enumerate() {
                for power in 0..*degree {
                    let column = first[j] + degree - 1 - power;
                    for i in 0..matrix.rows() {
                        low[(i, column)] =
                            matrix.entry(i, j).coefficients().iter().rev().nth(power).copied().unwrap_or(0.0);
                    }
                }
            }
            low
        };
        let identity = DMatrix::identity(inputs, inputs);
        let scale = self.highest(&self.denominator).lu().solve(&identity).unwrap_or(identity);
        let feedback = &scale * lower(&self.denominator);
        let mut a = DMatrix::zeros(states, states);
        let mut b = DMatrix::zeros(states, inputs);
        for (j, degree) in self.degrees.iter().enumerate().filter(|(_, degree)| **degree > 0) {
            for i in 1..*degree {
                a[(first[j] + i, first[j] + i - 1)] = 1.0;
            }
            a.row_mut(first[j]).copy_from(&(-feedback.row(j)));
            b.row_mut(first[j]).copy_from(&scale.row(j));
        }
        let through = self.highest(&self.numerator) * &scale;
        let c = lower(&self.numerator) - self.highest(&self.numerator) * feedback;
        StateSpace::new(a, b, c, through, self.time)
    }
}

/// A left fraction `G(x) = D(x)⁻¹ N(x)` with D m×m, not singular, and N m×l.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftFraction<T> {
    denominator: PolynomialMatrix,
    numerator: PolynomialMatrix,
    time: T,
}

impl<T: TimeBase> LeftFraction<T> {
    /// From denominator and numerator.
    ///
    /// # Errors
    /// [`FractionError::Size`] where the sizes disagree.
    pub fn new(denominator: PolynomialMatrix, numerator: PolynomialMatrix, time: T) -> Result<Self, FractionError> {
        let expected = numerator.rows();
        if denominator.shape() != (expected, expected) {
            return Err(FractionError::Size {
                rows: denominator.rows(),
                columns: denominator.columns(),
                numerator_rows: expected,
                numerator_columns: numerator.columns(),
                expected,
            });
        }
        Ok(Self { denominator, numerator, time })
    }

    /// D, m×m.
    #[must_use]
    pub fn denominator(&self) -> &PolynomialMatrix {
        &self.denominator
    }

    /// N, m×l.
    #[must_use]
    pub fn numerator(&self) -> &PolynomialMatrix {
        &self.numerator
    }

    /// The time base.
    #[must_use]
    pub fn time(&self) -> T {
        self.time
    }

    /// The value at a point of the complex plane, m×l; `None` at a root of det D.
    #[must_use]
    pub fn eval(&self, x: Complex64) -> Option<DMatrix<Complex64>> {
        self.denominator.eval(x).lu().solve(&self.numerator.eval(x))
    }

    /// The transfer matrix, row by row: `adj(D) N / det(D)`. Where D is diagonal each row keeps its own denominator;
    /// otherwise common factors are not cancelled.
    ///
    /// # Errors
    /// [`TransferFunctionError`] where D is singular or a coefficient overflows.
    pub fn transfer_functions(&self) -> Result<Vec<Vec<TransferFunction<T>>>, TransferFunctionError> {
        let (rows, columns) = self.numerator.shape();
        let is_diagonal = (0..rows).all(|i| (0..rows).all(|j| i == j || self.denominator.entry(i, j).is_zero()));
        let (numerator, determinant) = if is_diagonal {
            (self.numerator.clone(), None)
        } else {
            (self.denominator.adjugate().mul(&self.numerator), Some(self.denominator.determinant()))
        };
        (0..rows)
            .map(|i| {
                let den = determinant.as_ref().unwrap_or_else(|| self.denominator.entry(i, i));
                (0..columns)
                    .map(|j| TransferFunction::new(numerator.entry(i, j).coefficients(), den.coefficients(), self.time))
                    .collect()
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Discrete;

    fn polynomials(nested: &[&[&[f64]]]) -> PolynomialMatrix {
        let nested: Vec<Vec<Vec<f64>>> =
            nested.iter().map(|row| row.iter().map(|entry| entry.to_vec()).collect()).collect();
        PolynomialMatrix::new(&nested).unwrap()
    }

    fn second() -> Discrete {
        Discrete::new(1.0).unwrap()
    }

    #[test]
    fn the_controller_form_has_the_same_transfer_matrix_and_poles() {
        // Column degrees 2 and 1, with feedthrough and a denominator that is not monic.
        let numerator = polynomials(&[&[&[2.0, 1.0, 0.3], &[1.0]], &[&[0.5], &[0.7, -0.1]], &[&[1.0, 0.0], &[0.2]]]);
        let denominator = polynomials(&[&[&[2.0, 0.3, 0.1], &[0.5, 0.2]], &[&[0.4, 0.4], &[1.5, -0.6]]]);
        let fraction = RightFraction::new(numerator, denominator, second()).unwrap();
        assert_eq!(fraction.states(), 3);
        let model = fraction.to_state_space().unwrap();
        for x in [Complex64::new(0.0, 1.0), Complex64::new(-2.0, 0.4), Complex64::new(0.9, 0.1)] {
            let difference = fraction.eval(x).unwrap() - model.eval(x).unwrap();
            assert!(difference.iter().all(|d| d.norm() < 1e-13), "{difference}");
        }
        assert!((fraction.feedthrough() - model.d()).norm() < 1e-15);
        let determinant = fraction.denominator().determinant();
        assert_eq!(determinant.degree(), 3);
        for pole in model.poles().unwrap() {
            assert!(determinant.eval(pole).norm() < 1e-13, "{pole}");
        }
    }

    #[test]
    fn static_columns_have_no_state() {
        let fraction = RightFraction::new(
            polynomials(&[&[&[1.0], &[2.0]]]),
            polynomials(&[&[&[1.0, -0.5], &[0.0]], &[&[0.0], &[4.0]]]),
            second(),
        )
        .unwrap();
        let model = fraction.to_state_space().unwrap();
        assert_eq!((model.states(), model.d()), (1, &DMatrix::from_row_slice(1, 2, &[0.0, 0.5])));
    }

    #[test]
    fn what_is_no_fraction_is_refused() {
        let n = || polynomials(&[&[&[1.0], &[1.0, 0.0]]]);
        let wrong = RightFraction::new(n(), polynomials(&[&[&[1.0, 0.1]]]), second());
        assert!(matches!(wrong, Err(FractionError::Size { rows: 1, expected: 2, .. })), "{wrong:?}");
        let singular = polynomials(&[&[&[1.0, 0.1], &[2.0, 0.0]], &[&[2.0, 0.0], &[4.0, 1.0]]]);
        assert_eq!(RightFraction::new(n(), singular, second()), Err(FractionError::NotReduced));
        let low = polynomials(&[&[&[1.0, 0.1], &[0.0]], &[&[0.0], &[1.0]]]);
        let improper = FractionError::Improper { column: 1, numerator: 1, denominator: 0 };
        assert_eq!(RightFraction::new(n(), low, second()), Err(improper));
    }

    #[test]
    fn transfer_functions_of_a_left_fraction() {
        let numerator = polynomials(&[&[&[0.3], &[1.0]], &[&[0.2, 0.1], &[0.4]]]);
        let x = Complex64::new(0.3, 0.9);
        for denominator in [
            polynomials(&[&[&[1.0, 0.1], &[0.2]], &[&[-0.3], &[1.0, 0.5]]]),
            polynomials(&[&[&[1.0, 0.1], &[0.0]], &[&[0.0], &[1.0, 0.5]]]),
        ] {
            let fraction = LeftFraction::new(denominator, numerator.clone(), second()).unwrap();
            let value = fraction.eval(x).unwrap();
            for (i, row) in fraction.transfer_functions().unwrap().iter().enumerate() {
                for (j, entry) in row.iter().enumerate() {
                    assert!((entry.eval(x) - value[(i, j)]).norm() < 1e-14);
                }
            }
        }
    }
}
