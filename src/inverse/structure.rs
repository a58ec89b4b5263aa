//! What is known of the weights beforehand.

use super::gains::LARGEST_ENTRY;
use crate::num::linalg::symmetric;
use nalgebra::DMatrix;

/// Which sign Q must have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum QSign {
    /// Q ≻ 0, as Priess 2015, eq. (3.12), asks for.
    #[default]
    Definite,
    /// Q ⪰ 0, enough for a regulator where (A, Q) is detectable.
    Semidefinite,
}

/// Restrictions on the weights; none by default.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Structure {
    /// Entries of Q that may differ from zero, n×n and symmetric; all where there is none. A semidefinite Q may leave
    /// out states altogether.
    pub q_pattern: Option<DMatrix<bool>>,
    /// Entries of R that may differ from zero, m×m and symmetric.
    pub r_pattern: Option<DMatrix<bool>>,
    /// R up to its scale, m×m and positive definite.
    pub r: Option<DMatrix<f64>>,
    /// Which sign Q must have.
    pub q_sign: QSign,
}

/// A structure that fits no weights.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StructureError {
    /// A pattern or weight has the wrong size.
    #[error("{matrix} is {rows}x{columns} and must be {expected}x{expected}")]
    Size {
        /// `the pattern of Q`, `the pattern of R` or `the fixed R`.
        matrix: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
        /// Rows and columns that it must have.
        expected: usize,
    },
    /// A pattern or weight differs from its transpose.
    #[error("{matrix} is not symmetric at row {row}, column {column} (counted from 0)")]
    NotSymmetric {
        /// Which.
        matrix: &'static str,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
    },
    /// A pattern forbids a diagonal entry, which a definite matrix needs.
    #[error("{matrix} forbids the diagonal entry {index} (counted from 0), which a definite weight needs")]
    NoDiagonal {
        /// Which.
        matrix: &'static str,
        /// Row and column, from 0.
        index: usize,
    },
    /// The fixed R is not positive definite.
    #[error("the fixed R ({order}x{order}) is not positive definite: its least eigenvalue is {least:e}")]
    NotDefinite {
        /// Its rows and columns.
        order: usize,
        /// Its least eigenvalue.
        least: f64,
    },
    /// The fixed R has an entry that is not finite, or so large that products overflow.
    #[error(
        "the fixed R ({order}x{order}) has the entry {value:e} at row {row}, column {column} (counted from 0); \
         magnitudes up to {LARGEST_ENTRY:e} are taken"
    )]
    Entry {
        /// Its rows and columns.
        order: usize,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The entry.
        value: f64,
    },
    /// The pattern of Q leaves out every state.
    #[error("the pattern of Q ({order}x{order}) forbids every diagonal entry: no state would be weighed")]
    NothingWeighed {
        /// Its rows and columns.
        order: usize,
    },
    /// A pattern of Q beside set points that no input reaches.
    #[error(
        "the pattern of Q ({order}x{order}) cannot be kept: the plant has targets that no input reaches, and Q weighs \
         the distances of the other states from their set points"
    )]
    Targets {
        /// Its rows and columns.
        order: usize,
    },
    /// Both a fixed R and a pattern of R.
    #[error("the fixed R and a pattern of R are given together")]
    Both,
}

impl Structure {
    /// A diagonal Q, with any R.
    #[must_use]
    pub fn diagonal_q(n: usize) -> Self {
        Self { q_pattern: Some(DMatrix::from_fn(n, n, |i, j| i == j)), ..Self::default() }
    }

    /// The states that Q may weigh, where its pattern forbids the others their diagonal entry, and so their rows and
    /// columns.
    pub(super) fn support(&self) -> Option<Vec<usize>> {
        let pattern = self.q_pattern.as_ref()?;
        let kept: Vec<usize> = (0..pattern.nrows()).filter(|i| pattern[(*i, *i)]).collect();
        (kept.len() < pattern.nrows()).then_some(kept)
    }

    /// The fixed R with entries up to 1: only its shape is given, and its square must not overflow.
    fn fixed(&self) -> Option<DMatrix<f64>> {
        self.r.as_ref().map(|r| symmetric(&(r / r.amax().max(f64::MIN_POSITIVE))))
    }

    /// Whether an entry of Q may differ from zero: of a state that is not weighed none may, since Q is semidefinite.
    pub(super) fn allows(&self, i: usize, j: usize) -> bool {
        self.q_pattern.as_ref().is_none_or(|p| p[(i, j)] && p[(i, i)] && p[(j, j)])
    }

    /// Whether an entry of R may differ from zero.
    pub(super) fn allows_input(&self, i: usize, j: usize) -> bool {
        self.r_pattern.as_ref().is_none_or(|p| p[(i, j)])
    }

    /// Whether nothing is restricted but the sign.
    #[must_use]
    pub fn is_free(&self) -> bool {
        self.q_pattern.is_none() && self.r_pattern.is_none() && self.r.is_none()
    }

    /// Checks sizes and symmetry for n states and m ports.
    ///
    /// # Errors
    /// [`StructureError`].
    pub fn check(&self, n: usize, m: usize) -> Result<(), StructureError> {
        let size = |matrix, (rows, columns): (usize, usize), expected| {
            if (rows, columns) == (expected, expected) {
                Ok(())
            } else {
                Err(StructureError::Size { matrix, rows, columns, expected })
            }
        };
        for (matrix, pattern, order) in
            [("the pattern of Q", &self.q_pattern, n), ("the pattern of R", &self.r_pattern, m)]
        {
            let Some(pattern) = pattern else { continue };
            size(matrix, pattern.shape(), order)?;
            for row in 0..order {
                if !pattern[(row, row)] && (matrix == "the pattern of R" || self.q_sign == QSign::Definite) {
                    return Err(StructureError::NoDiagonal { matrix, index: row });
                }
                if let Some(column) = (0..row).find(|column| pattern[(row, *column)] != pattern[(*column, row)]) {
                    return Err(StructureError::NotSymmetric { matrix, row, column });
                }
            }
        }
        if self.support().is_some_and(|kept| kept.is_empty()) {
            return Err(StructureError::NothingWeighed { order: n });
        }
        if let Some(r) = &self.r {
            if self.r_pattern.is_some() {
                return Err(StructureError::Both);
            }
            size("the fixed R", r.shape(), m)?;
            let largest = r.amax();
            for row in 0..m {
                if let Some(column) = (0..m).find(|c| r[(row, *c)].is_nan() || r[(row, *c)].abs() > LARGEST_ENTRY) {
                    return Err(StructureError::Entry { order: m, row, column, value: r[(row, column)] });
                }
                let same = |column: &usize| (r[(row, *column)] - r[(*column, row)]).abs() <= 1e-10 * largest;
                if let Some(column) = (0..=row).find(|column| !same(column)) {
                    return Err(StructureError::NotSymmetric { matrix: "the fixed R", row, column });
                }
            }
            if self.fixed().is_none_or(|r| r.cholesky().is_none()) {
                return Err(StructureError::NotDefinite {
                    order: m,
                    least: symmetric(r).symmetric_eigenvalues().min(),
                });
            }
        }
        Ok(())
    }

    /// The number of unknowns of the structured (Q, R).
    pub(super) fn unknowns(&self, n: usize, m: usize) -> usize {
        let pairs = |order: usize, allows: &dyn Fn(usize, usize) -> bool| {
            (0..order).map(|j| (0..=j).filter(|i| allows(*i, j)).count()).sum::<usize>()
        };
        let r = match (&self.r, &self.r_pattern) {
            (Some(_), _) => 1,
            (None, _) => pairs(m, &|i, j| self.allows_input(i, j)),
        };
        pairs(n, &|i, j| self.allows(i, j)) + r
    }

    /// A basis of the structured (Q, R), as pairs of symmetric matrices.
    pub(super) fn directions(&self, n: usize, m: usize) -> Vec<(DMatrix<f64>, DMatrix<f64>)> {
        let mut all = Vec::new();
        let unit = |order: usize, i: usize, j: usize| {
            let mut e = DMatrix::zeros(order, order);
            e[(i, j)] = 1.0;
            e[(j, i)] = 1.0;
            e
        };
        for j in 0..n {
            for i in 0..=j {
                if self.allows(i, j) {
                    all.push((unit(n, i, j), DMatrix::zeros(m, m)));
                }
            }
        }
        if let Some(r) = self.fixed() {
            all.push((DMatrix::zeros(n, n), r));
            return all;
        }
        for j in 0..m {
            for i in 0..=j {
                if self.allows_input(i, j) {
                    all.push((DMatrix::zeros(n, n), unit(m, i, j)));
                }
            }
        }
        all
    }

    /// Weights with what the structure forbids set to zero exactly.
    pub(super) fn impose(&self, q: &mut DMatrix<f64>, r: &mut DMatrix<f64>) {
        for j in 0..q.ncols() {
            for i in (0..q.nrows()).filter(|i| !self.allows(*i, j)) {
                q[(i, j)] = 0.0;
            }
        }
        if let Some(pattern) = &self.r_pattern {
            r.zip_apply(pattern, |value, allowed| {
                if !allowed {
                    *value = 0.0;
                }
            });
        }
        if let Some(fixed) = self.fixed() {
            let scale = r.dot(&fixed) / fixed.norm_squared();
            *r = fixed * scale;
        }
    }
}
