//! Symmetric matrices as vectors, with the inner product kept: `svec(A)·svec(B) = tr(AB)`.
//!
//! The upper triangle column by column, off-diagonal entries times √2: the order and the scaling of clarabel's
//! semidefinite cone.

use nalgebra::{DMatrix, DVector};
use std::f64::consts::SQRT_2;

/// Entries of the vector of an n×n matrix: n(n+1)/2.
#[must_use]
pub const fn length(n: usize) -> usize {
    n * (n + 1) / 2
}

/// The vector of a symmetric matrix, n×n; only the upper triangle is read.
#[must_use]
pub(crate) fn svec(m: &DMatrix<f64>) -> DVector<f64> {
    let n = m.nrows();
    let mut v = DVector::zeros(length(n));
    write(m.as_slice(), n, v.as_mut_slice());
    v
}

/// The same for a matrix stored by columns, into a slice.
pub(crate) fn write(columns: &[f64], n: usize, into: &mut [f64]) {
    let mut at = 0;
    for j in 0..n {
        for i in 0..j {
            into[at] = columns[i + j * n] * SQRT_2;
            at += 1;
        }
        into[at] = columns[j + j * n];
        at += 1;
    }
}

/// The symmetric matrix of a vector of length n(n+1)/2.
///
/// # Panics
/// If the vector has another length, which is a mistake of the caller.
#[must_use]
pub(crate) fn smat(v: &[f64], n: usize) -> DMatrix<f64> {
    assert_eq!(v.len(), length(n), "svec of a {n}x{n} matrix");
    let mut m = DMatrix::zeros(n, n);
    let mut at = 0;
    for j in 0..n {
        for i in 0..=j {
            let value = if i == j { v[at] } else { v[at] / SQRT_2 };
            m[(i, j)] = value;
            m[(j, i)] = value;
            at += 1;
        }
    }
    m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inner_product_is_kept_and_the_matrix_comes_back() {
        let a = DMatrix::from_row_slice(3, 3, &[1.0, 2.0, 3.0, 2.0, -4.0, 5.0, 3.0, 5.0, 6.0]);
        let b = DMatrix::from_row_slice(3, 3, &[0.5, -1.0, 2.0, -1.0, 3.0, 0.25, 2.0, 0.25, -2.0]);
        assert!((svec(&a).dot(&svec(&b)) - (&a * &b).trace()).abs() < 1e-14);
        assert!((smat(svec(&a).as_slice(), 3) - a).norm() < 1e-15);
    }
}
