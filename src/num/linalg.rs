//! Small dense linear algebra: decompositions come from `faer`, values travel as `nalgebra` matrices.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

/// An eigenvalue or singular value iteration did not converge, or its matrix has an entry that is not finite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the iteration on a {rows}x{columns} matrix did not converge")]
pub struct NoConvergence {
    /// Rows of the matrix.
    pub rows: usize,
    /// Columns of the matrix.
    pub columns: usize,
}

fn to_faer(a: &DMatrix<f64>) -> faer::Mat<f64> {
    faer::Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)])
}

/// The eigenvalues of a real square matrix, in no particular order.
///
/// # Errors
/// [`NoConvergence`], also for a matrix with an entry that is not finite.
///
/// # Panics
/// If the matrix is not square, which is a mistake of the caller.
pub fn eigenvalues(a: &DMatrix<f64>) -> Result<Vec<Complex64>, NoConvergence> {
    assert!(a.is_square(), "eigenvalues of a {}x{} matrix", a.nrows(), a.ncols());
    let fail = NoConvergence { rows: a.nrows(), columns: a.ncols() };
    if a.iter().any(|x| !x.is_finite()) {
        return Err(fail);
    }
    let values = to_faer(a).eigenvalues().map_err(|_| fail)?;
    Ok(values.into_iter().map(|v| Complex64::new(v.re, v.im)).collect())
}

/// The singular values of a real matrix, largest first.
///
/// # Errors
/// [`NoConvergence`], also for a matrix with an entry that is not finite.
pub(crate) fn singular_values(a: &DMatrix<f64>) -> Result<Vec<f64>, NoConvergence> {
    let fail = NoConvergence { rows: a.nrows(), columns: a.ncols() };
    if a.iter().any(|x| !x.is_finite()) {
        return Err(fail);
    }
    to_faer(a).singular_values().map_err(|_| fail)
}

/// The singular values of a complex matrix, largest first.
///
/// # Errors
/// [`NoConvergence`], also for a matrix with an entry that is not finite.
pub(crate) fn complex_singular_values(a: &DMatrix<Complex64>) -> Result<Vec<f64>, NoConvergence> {
    let fail = NoConvergence { rows: a.nrows(), columns: a.ncols() };
    if a.iter().any(|x| !(x.re.is_finite() && x.im.is_finite())) {
        return Err(fail);
    }
    let copy = faer::Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)]);
    copy.singular_values().map_err(|_| fail)
}

/// Left singular vectors (rows × min), singular values (largest first) and right singular vectors (columns × columns).
pub(crate) type SingularValueDecomposition = (DMatrix<f64>, Vec<f64>, DMatrix<f64>);

/// The singular value decomposition `A = U diag(σ) Vᵀ`; V is square, its last columns span the null space of a wide or
/// deficient A.
///
/// # Errors
/// [`NoConvergence`], also for a matrix with an entry that is not finite.
pub(crate) fn svd(a: &DMatrix<f64>) -> Result<SingularValueDecomposition, NoConvergence> {
    let fail = NoConvergence { rows: a.nrows(), columns: a.ncols() };
    if a.iter().any(|x| !x.is_finite()) {
        return Err(fail);
    }
    let decomposed = to_faer(a).svd().map_err(|_| fail)?;
    let least = a.nrows().min(a.ncols());
    let (u, v) = (decomposed.U(), decomposed.V());
    let sigma = (0..least).map(|i| decomposed.S()[i]).collect();
    Ok((
        DMatrix::from_fn(a.nrows(), least, |i, j| u[(i, j)]),
        sigma,
        DMatrix::from_fn(a.ncols(), a.ncols(), |i, j| v[(i, j)]),
    ))
}

/// The symmetric part `(M + Mᵀ)/2` of a square matrix.
#[must_use]
pub(crate) fn symmetric(m: &DMatrix<f64>) -> DMatrix<f64> {
    (m + m.transpose()) * 0.5
}

/// `M⁻¹X` for a symmetric M: by Cholesky where it is definite, by LU otherwise; NaN where it is singular.
#[must_use]
pub(crate) fn solve_symmetric(m: &DMatrix<f64>, x: &DMatrix<f64>) -> DMatrix<f64> {
    if let Some(factor) = m.clone().cholesky() {
        return factor.solve(x);
    }
    m.clone().lu().solve(x).unwrap_or_else(|| DMatrix::from_element(x.nrows(), x.ncols(), f64::NAN))
}

/// The minimiser of `‖A x − b‖₂` by Householder QR, with the squared residual.
///
/// `None` where the columns of `A` are linearly dependent to working precision
/// (a diagonal entry of R below `1e-13` times the largest one).
#[must_use]
pub fn least_squares(a: &DMatrix<f64>, b: &DVector<f64>) -> Option<(DVector<f64>, f64)> {
    let qr = a.clone().qr();
    let r = qr.r();
    let diagonal: Vec<f64> = (0..r.ncols().min(r.nrows())).map(|i| r[(i, i)].abs()).collect();
    let largest = diagonal.iter().copied().fold(0.0, f64::max);
    if a.nrows() < a.ncols() || diagonal.iter().any(|d| *d <= 1e-13 * largest) {
        return None;
    }
    let x = r.solve_upper_triangular(&(qr.q().transpose() * b))?;
    let residual = (a * &x - b).norm_squared();
    Some((x, residual))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvalues_of_a_cyclic_permutation_are_the_roots_of_one() {
        // nalgebra's own Schur iteration never returns on this matrix.
        let a = DMatrix::from_fn(4, 4, |i, j| if (i + 1) % 4 == j { 1.0 } else { 0.0 });
        let values = eigenvalues(&a).unwrap();
        assert_eq!(values.len(), 4);
        assert!(values.iter().all(|v| (v.powi(4) - 1.0).norm() < 1e-12), "{values:?}");
    }

    #[test]
    fn a_matrix_that_is_not_finite_is_refused() {
        let a = DMatrix::from_element(2, 2, f64::NAN);
        assert_eq!(eigenvalues(&a), Err(NoConvergence { rows: 2, columns: 2 }));
    }

    #[test]
    fn singular_vectors_rebuild_the_matrix_and_span_its_null_space() {
        for (rows, columns) in [(5, 3), (3, 5)] {
            let a = DMatrix::from_fn(rows, columns, |i, j| ((i * 7 + j * j * 3) as f64).sin());
            let (u, sigma, v) = svd(&a).unwrap();
            let rebuilt = &u * DMatrix::from_diagonal(&DVector::from_vec(sigma.clone())) * v.columns(0, 3).transpose();
            assert!(
                (rebuilt - &a).norm() < 1e-13 && (v.tr_mul(&v) - DMatrix::identity(columns, columns)).norm() < 1e-13
            );
            assert!((&a * v.columns(3, columns - 3)).norm() < 1e-13);
            assert_eq!(sigma.len(), 3);
        }
    }

    #[test]
    fn least_squares_of_a_line() {
        let a = DMatrix::from_row_slice(3, 2, &[1.0, 0.0, 1.0, 1.0, 1.0, 2.0]);
        let (x, residual) = least_squares(&a, &DVector::from_vec(vec![1.0, 3.0, 5.0])).unwrap();
        assert!((x[0] - 1.0).abs() < 1e-14 && (x[1] - 2.0).abs() < 1e-14 && residual < 1e-28);
    }

    #[test]
    fn dependent_columns_are_recognised() {
        let a = DMatrix::from_row_slice(3, 2, &[1.0, 2.0, 1.0, 2.0, 1.0, 2.0]);
        assert!(least_squares(&a, &DVector::from_vec(vec![1.0, 3.0, 5.0])).is_none());
    }
}
