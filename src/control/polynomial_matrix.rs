//! Matrices whose entries are real polynomials.

use crate::num::Polynomial;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// A polynomial matrix `P(x)`, p×m with p and m at least 1.
#[derive(Debug, Clone, PartialEq)]
pub struct PolynomialMatrix {
    rows: usize,
    columns: usize,
    /// Row by row.
    entries: Vec<Polynomial>,
}

/// Nested arrays that make no polynomial matrix.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PolynomialMatrixError {
    /// There is no row or no column.
    #[error("it has {rows} rows and {columns} columns, and needs at least one of each")]
    Empty {
        /// Rows.
        rows: usize,
        /// Columns of row 0.
        columns: usize,
    },
    /// Rows differ in length.
    #[error("it is ragged: row {row} (counted from 0) has {columns} columns, and row 0 has {expected}")]
    Ragged {
        /// The first row that differs, from 0.
        row: usize,
        /// Its number of columns.
        columns: usize,
        /// The number of columns of row 0.
        expected: usize,
    },
    /// An entry has no coefficient, or one that is not finite.
    #[error("the entry at row {row}, column {column} (counted from 0) has no coefficient, or one that is not finite")]
    Entry {
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
    },
}

impl PolynomialMatrix {
    /// From nested rows of coefficients in descending powers.
    ///
    /// # Errors
    /// [`PolynomialMatrixError`].
    pub fn new(nested: &[Vec<Vec<f64>>]) -> Result<Self, PolynomialMatrixError> {
        let columns = nested.first().map_or(0, Vec::len);
        if columns == 0 {
            return Err(PolynomialMatrixError::Empty { rows: nested.len(), columns });
        }
        let mut entries = Vec::with_capacity(nested.len() * columns);
        for (row, written) in nested.iter().enumerate() {
            if written.len() != columns {
                return Err(PolynomialMatrixError::Ragged { row, columns: written.len(), expected: columns });
            }
            for (column, coefficients) in written.iter().enumerate() {
                if coefficients.is_empty() || coefficients.iter().any(|c| !c.is_finite()) {
                    return Err(PolynomialMatrixError::Entry { row, column });
                }
                entries.push(Polynomial::new(coefficients.as_slice()));
            }
        }
        Ok(Self { rows: nested.len(), columns, entries })
    }

    /// From a function of row and column.
    ///
    /// # Panics
    /// If there is no row or no column, which is a mistake of the caller.
    #[must_use]
    pub fn from_fn(rows: usize, columns: usize, entry: impl Fn(usize, usize) -> Polynomial) -> Self {
        assert!(rows > 0 && columns > 0, "a {rows}x{columns} matrix");
        let entries = (0..rows * columns).map(|at| entry(at / columns, at % columns)).collect();
        Self { rows, columns, entries }
    }

    /// `x^degree` times the identity.
    #[must_use]
    pub fn power(size: usize, degree: usize) -> Self {
        let mut power = vec![0.0; degree + 1];
        power[0] = 1.0;
        Self::from_fn(size, size, |i, j| Polynomial::new(if i == j { power.clone() } else { vec![0.0] }))
    }

    /// The number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// An entry.
    ///
    /// # Panics
    /// If there is none at that place.
    #[must_use]
    pub fn entry(&self, row: usize, column: usize) -> &Polynomial {
        assert!(row < self.rows && column < self.columns, "entry ({row}, {column}) of {}x{}", self.rows, self.columns);
        &self.entries[row * self.columns + column]
    }

    /// The largest degree of the entries of a column; `None` where all of them are zero.
    #[must_use]
    pub(crate) fn column_degree(&self, column: usize) -> Option<usize> {
        (0..self.rows).map(|i| self.entry(i, column)).filter(|p| !p.is_zero()).map(Polynomial::degree).max()
    }

    /// The largest degree of the entries; 0 for the zero matrix.
    #[must_use]
    pub fn degree(&self) -> usize {
        self.entries.iter().map(Polynomial::degree).max().unwrap_or(0)
    }

    /// The matrix of the coefficients of one power.
    #[must_use]
    pub fn coefficient(&self, power: usize) -> DMatrix<f64> {
        DMatrix::from_fn(self.rows, self.columns, |i, j| {
            self.entry(i, j).coefficients().iter().rev().nth(power).copied().unwrap_or(0.0)
        })
    }

    /// The value at a point of the complex plane.
    #[must_use]
    pub fn eval(&self, x: Complex64) -> DMatrix<Complex64> {
        DMatrix::from_fn(self.rows, self.columns, |i, j| self.entry(i, j).eval(x))
    }

    /// The matrix of some of its rows, in the order given.
    #[must_use]
    pub fn select_rows(&self, rows: &[usize]) -> Self {
        Self::from_fn(rows.len(), self.columns, |i, j| self.entry(rows[i], j).clone())
    }

    /// The product of two matrices.
    ///
    /// # Panics
    /// If the sizes disagree, which is a mistake of the caller.
    #[must_use]
    pub fn mul(&self, other: &Self) -> Self {
        assert_eq!(self.columns, other.rows, "the product of {:?} and {:?}", self.shape(), other.shape());
        Self::from_fn(self.rows, other.columns, |i, j| {
            (0..self.columns)
                .fold(Polynomial::new(Vec::new()), |sum, k| sum.add(&self.entry(i, k).mul(other.entry(k, j))))
        })
    }

    /// The sum of two matrices.
    ///
    /// # Panics
    /// If the sizes disagree, which is a mistake of the caller.
    #[must_use]
    pub fn add(&self, other: &Self) -> Self {
        assert_eq!(self.shape(), other.shape(), "a sum");
        Self::from_fn(self.rows, self.columns, |i, j| self.entry(i, j).add(other.entry(i, j)))
    }

    /// Rows and columns.
    #[must_use]
    pub fn shape(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    /// The determinant of the submatrix of these rows and columns, by expansion along its first row.
    fn minor(&self, rows: &[usize], columns: &[usize]) -> Polynomial {
        let Some((first, others)) = rows.split_first() else { return Polynomial::new(vec![1.0]) };
        let mut sum = Polynomial::new(Vec::new());
        for (at, column) in columns.iter().enumerate() {
            let entry = self.entry(*first, *column);
            if entry.is_zero() {
                continue;
            }
            let rest: Vec<usize> = columns.iter().copied().filter(|c| c != column).collect();
            let term = entry.mul(&self.minor(others, &rest));
            sum = sum.add(&term.scale(if at % 2 == 0 { 1.0 } else { -1.0 }));
        }
        sum
    }

    /// The determinant of a square matrix. Terms that cancel on paper leave their rounding.
    ///
    /// # Panics
    /// If it is not square, which is a mistake of the caller.
    #[must_use]
    pub fn determinant(&self) -> Polynomial {
        assert_eq!(self.rows, self.columns, "a determinant");
        let all: Vec<usize> = (0..self.rows).collect();
        self.minor(&all, &all)
    }

    /// The adjugate of a square matrix: `adj(P) P = det(P) I`.
    ///
    /// # Panics
    /// If it is not square, which is a mistake of the caller.
    #[must_use]
    pub(crate) fn adjugate(&self) -> Self {
        assert_eq!(self.rows, self.columns, "an adjugate");
        let without = |skip: usize| (0..self.rows).filter(|i| *i != skip).collect::<Vec<usize>>();
        Self::from_fn(self.rows, self.rows, |i, j| {
            let sign = if (i + j) % 2 == 0 { 1.0 } else { -1.0 };
            self.minor(&without(j), &without(i)).scale(sign)
        })
    }

    /// As nested rows of coefficients in descending powers.
    #[must_use]
    pub(crate) fn to_nested(&self) -> Vec<Vec<Vec<f64>>> {
        (0..self.rows).map(|i| (0..self.columns).map(|j| self.entry(i, j).coefficients().to_vec()).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix() -> PolynomialMatrix {
        PolynomialMatrix::new(&[
            vec![vec![1.0, 0.4], vec![2.0], vec![1.0, 0.0, -1.0]],
            vec![vec![0.3], vec![1.0, -0.2], vec![0.0]],
            vec![vec![5.0, 1.0], vec![0.1, 0.1], vec![1.0, 2.0, 3.0]],
        ])
        .unwrap()
    }

    #[test]
    fn determinant_and_adjugate_agree_with_the_values() {
        let p = matrix();
        let product = p.adjugate().mul(&p);
        for x in [Complex64::new(0.3, 0.7), Complex64::new(-1.2, 0.0), Complex64::new(2.0, -1.0)] {
            let determinant = p.eval(x).determinant();
            assert!((p.determinant().eval(x) - determinant).norm() < 1e-13 * determinant.norm());
            for i in 0..3 {
                for j in 0..3 {
                    let expected = if i == j { determinant } else { Complex64::new(0.0, 0.0) };
                    assert!((product.entry(i, j).eval(x) - expected).norm() < 1e-12, "({i}, {j}) at {x}");
                }
            }
        }
    }

    #[test]
    fn degrees_and_coefficients() {
        let p = matrix();
        assert_eq!((p.degree(), p.column_degree(0), p.column_degree(1)), (2, Some(1), Some(1)));
        assert_eq!(p.coefficient(2), DMatrix::from_row_slice(3, 3, &[0., 0., 1., 0., 0., 0., 0., 0., 1.]));
        assert_eq!(PolynomialMatrix::new(&p.to_nested()).unwrap(), p);
        assert_eq!(PolynomialMatrix::power(2, 3).determinant().degree(), 6);
    }

    #[test]
    fn what_is_no_matrix_is_refused_by_its_place() {
        let one = || vec![1.0];
        for (nested, error) in [
            (vec![], PolynomialMatrixError::Empty { rows: 0, columns: 0 }),
            (vec![vec![], vec![]], PolynomialMatrixError::Empty { rows: 2, columns: 0 }),
            (vec![vec![one(), one()], vec![one()]], PolynomialMatrixError::Ragged { row: 1, columns: 1, expected: 2 }),
            (vec![vec![one(), vec![]]], PolynomialMatrixError::Entry { row: 0, column: 1 }),
            (vec![vec![vec![f64::NAN]]], PolynomialMatrixError::Entry { row: 0, column: 0 }),
        ] {
            assert_eq!(PolynomialMatrix::new(&nested), Err(error));
        }
    }
}
