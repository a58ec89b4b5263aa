//! The BLAS and LAPACK routines that clarabel's semidefinite cones call, in Rust.
//!
//! Every other provider downloads something or needs cmake or a Fortran compiler. This is the one file of the crate
//! with `unsafe` code: the routines take raw pointers by the Fortran convention (all arguments by address, matrices by
//! columns with a leading dimension), copy them into matrices, and compute with `nalgebra` and `faer`. Matrices here
//! have some tens of rows; the copies do not matter.
//!
//! Only what clarabel asks for is supported: both triangles, both transpositions, workspace queries, `jobz` N, V and S,
//! strides of 1 and more. Any other request ends with `info = −1`, which clarabel reports as a failure, or leaves the
//! output as NaN where a routine has no `info`.
#![allow(unsafe_code)]

use nalgebra::{DMatrix, DVector, RealField};
use std::ffi::{c_char, c_int};

/// A number type that faer decomposes.
trait Real: RealField + Copy {
    /// Thin singular value decomposition (U, σ, V).
    fn svd(a: &DMatrix<Self>) -> Option<(DMatrix<Self>, Vec<Self>, DMatrix<Self>)>;
    /// Eigenvalues in ascending order with their vectors, of the symmetric matrix in the lower triangle.
    fn eigen(a: &DMatrix<Self>) -> Option<(Vec<Self>, DMatrix<Self>)>;
    /// From a count.
    fn count(n: usize) -> Self;
    /// Not a number.
    const NAN: Self;
}

macro_rules! real {
    ($t:ty) => {
        impl Real for $t {
            fn svd(a: &DMatrix<Self>) -> Option<(DMatrix<Self>, Vec<Self>, DMatrix<Self>)> {
                let svd = faer::Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)]).thin_svd().ok()?;
                let back = |m: faer::MatRef<'_, $t>| DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)]);
                let s = svd.S().column_vector();
                Some((back(svd.U()), (0..s.nrows()).map(|i| s[i]).collect(), back(svd.V())))
            }
            fn eigen(a: &DMatrix<Self>) -> Option<(Vec<Self>, DMatrix<Self>)> {
                let n = a.nrows();
                let eigen = faer::Mat::from_fn(n, n, |i, j| a[(i, j)]).self_adjoint_eigen(faer::Side::Lower).ok()?;
                let (s, u) = (eigen.S().column_vector(), eigen.U());
                Some(((0..n).map(|i| s[i]).collect(), DMatrix::from_fn(n, n, |i, j| u[(i, j)])))
            }
            #[allow(clippy::cast_precision_loss)]
            fn count(n: usize) -> Self {
                n as $t
            }
            const NAN: Self = <$t>::NAN;
        }
    };
}
real!(f64);
real!(f32);

/// An option letter, in upper case.
unsafe fn letter(p: *const c_char) -> u8 {
    // SAFETY: the caller passes the address of one character.
    unsafe { (*p).cast_unsigned() }.to_ascii_uppercase()
}

/// A size; negative ones count as none.
unsafe fn size(p: *const c_int) -> usize {
    // SAFETY: the caller passes the address of one integer.
    usize::try_from(unsafe { *p }).unwrap_or(0)
}

/// The rows×columns matrix at `p`.
unsafe fn load<T: Real>(p: *const T, rows: usize, columns: usize, leading: usize) -> DMatrix<T> {
    // SAFETY: the caller owns `columns` columns of at least `rows` entries, `leading` apart.
    DMatrix::from_fn(rows, columns, |i, j| unsafe { *p.add(i + j * leading) })
}

/// The symmetric n×n matrix of which one triangle is stored at `p`.
unsafe fn load_symmetric<T: Real>(p: *const T, n: usize, leading: usize, upper: bool) -> DMatrix<T> {
    DMatrix::from_fn(n, n, |i, j| {
        let (row, column) = if (i <= j) == upper { (i, j) } else { (j, i) };
        // SAFETY: as in `load`.
        unsafe { *p.add(row + column * leading) }
    })
}

/// Writes a matrix to `p`; only one triangle where asked to.
unsafe fn store<T: Real>(m: &DMatrix<T>, p: *mut T, leading: usize, triangle: Option<bool>) {
    for j in 0..m.ncols() {
        for i in 0..m.nrows() {
            let wanted = triangle.is_none_or(|upper| if upper { i <= j } else { i >= j });
            if wanted {
                // SAFETY: as in `load`, writable.
                unsafe { *p.add(i + j * leading) = m[(i, j)] };
            }
        }
    }
}

unsafe fn load_vector<T: Real>(p: *const T, n: usize, step: usize) -> DVector<T> {
    // SAFETY: the caller owns n entries, `step` apart.
    DVector::from_fn(n, |i, _| unsafe { *p.add(i * step) })
}

/// `β·old + new`, where β = 0 ignores what was there, NaN included.
fn combine<T: Real>(beta: T, old: T, new: T) -> T {
    if beta == T::zero() { new } else { beta * old + new }
}

/// Whether the letter asks for a transpose; `None` for an unknown one.
fn transposed(option: u8) -> Option<bool> {
    match option {
        b'N' => Some(false),
        b'T' | b'C' => Some(true),
        _ => None,
    }
}

/// Writes the optimal workspace where one is asked for; true if that was all.
unsafe fn is_query<T: Real>(lwork: *const c_int, work: *mut T, n: usize) -> bool {
    // SAFETY: the caller passes the addresses of an integer and of a workspace of at least one entry.
    let query = unsafe { *lwork } == -1;
    if query {
        unsafe { *work = T::count(n.max(1)) };
    }
    query
}

#[allow(clippy::too_many_arguments)]
unsafe fn svd_into<T: Real>(
    want: u8,
    m: usize,
    n: usize,
    a: *mut T,
    lda: usize,
    s: *mut T,
    u: *mut T,
    ldu: usize,
    vt: *mut T,
    ldvt: usize,
) -> c_int {
    // SAFETY: the caller's arrays have the sizes of the LAPACK documentation.
    unsafe {
        let matrix = load(a, m, n, lda);
        if matrix.iter().any(|v| !v.is_finite()) {
            return 1;
        }
        let Some((left, values, right)) = T::svd(&matrix) else { return 1 };
        for (i, value) in values.iter().enumerate() {
            *s.add(i) = *value;
        }
        match want {
            b'S' => {
                store(&left, u, ldu, None);
                store(&right.transpose(), vt, ldvt, None);
                0
            }
            b'N' => 0,
            _ => -1,
        }
    }
}

macro_rules! routines {
    ($t:ty, $gemm:ident, $gemv:ident, $symv:ident, $syrk:ident, $syr2k:ident, $potrf:ident, $potrs:ident, $gesv:ident,
     $gesdd:ident, $gesvd:ident, $syevr:ident) => {
        /// `C ← α op(A) op(B) + β C`, op(A) m×k, op(B) k×n.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $gemm(
            transa: *const c_char, transb: *const c_char, m: *const c_int, n: *const c_int, k: *const c_int,
            alpha: *const $t, a: *const $t, lda: *const c_int, b: *const $t, ldb: *const c_int, beta: *const $t,
            c: *mut $t, ldc: *const c_int,
        ) {
            // SAFETY: called by the Fortran convention with arrays of the documented sizes.
            unsafe {
                let (m, n, k) = (size(m), size(n), size(k));
                let old = load(c, m, n, size(ldc));
                let product = match (transposed(letter(transa)), transposed(letter(transb))) {
                    (Some(ta), Some(tb)) => {
                        let a = if ta { load(a, k, m, size(lda)).transpose() } else { load(a, m, k, size(lda)) };
                        let b = if tb { load(b, n, k, size(ldb)).transpose() } else { load(b, k, n, size(ldb)) };
                        a * b * *alpha
                    }
                    _ => DMatrix::from_element(m, n, <$t as Real>::NAN),
                };
                store(&old.zip_map(&product, |o, p| combine(*beta, o, p)), c, size(ldc), None);
            }
        }

        /// `y ← α op(A) x + β y`, A m×n.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $gemv(
            trans: *const c_char, m: *const c_int, n: *const c_int, alpha: *const $t, a: *const $t, lda: *const c_int,
            x: *const $t, incx: *const c_int, beta: *const $t, y: *mut $t, incy: *const c_int,
        ) {
            // SAFETY: as above.
            unsafe {
                let a = load(a, size(m), size(n), size(lda));
                let product = match transposed(letter(trans)) {
                    Some(false) => &a * load_vector(x, a.ncols(), size(incx)) * *alpha,
                    Some(true) => a.tr_mul(&load_vector(x, a.nrows(), size(incx))) * *alpha,
                    None => DVector::from_element(size(m).min(size(n)), <$t as Real>::NAN),
                };
                for (i, value) in product.iter().enumerate() {
                    let to = y.add(i * size(incy));
                    *to = combine(*beta, *to, *value);
                }
            }
        }

        /// `y ← α A x + β y`, A symmetric n×n.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $symv(
            uplo: *const c_char, n: *const c_int, alpha: *const $t, a: *const $t, lda: *const c_int, x: *const $t,
            incx: *const c_int, beta: *const $t, y: *mut $t, incy: *const c_int,
        ) {
            // SAFETY: as above.
            unsafe {
                let n = size(n);
                let symmetric = load_symmetric(a, n, size(lda), letter(uplo) == b'U');
                let product = symmetric * load_vector(x, n, size(incx)) * *alpha;
                for (i, value) in product.iter().enumerate() {
                    let to = y.add(i * size(incy));
                    *to = combine(*beta, *to, *value);
                }
            }
        }

        /// `C ← α op(A) op(A)ᵀ + β C` on one triangle, op(A) n×k.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $syrk(
            uplo: *const c_char, trans: *const c_char, n: *const c_int, k: *const c_int, alpha: *const $t, a: *const $t,
            lda: *const c_int, beta: *const $t, c: *mut $t, ldc: *const c_int,
        ) {
            // SAFETY: as above.
            unsafe {
                let (n, k) = (size(n), size(k));
                let old = load(c, n, n, size(ldc));
                let a = match transposed(letter(trans)) {
                    Some(false) => load(a, n, k, size(lda)),
                    Some(true) => load(a, k, n, size(lda)).transpose(),
                    None => DMatrix::from_element(n, k, <$t as Real>::NAN),
                };
                let product = &a * a.transpose() * *alpha;
                let sum = old.zip_map(&product, |o, p| combine(*beta, o, p));
                store(&sum, c, size(ldc), Some(letter(uplo) == b'U'));
            }
        }

        /// `C ← α (op(A) op(B)ᵀ + op(B) op(A)ᵀ) + β C` on one triangle, op(A) and op(B) n×k.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $syr2k(
            uplo: *const c_char, trans: *const c_char, n: *const c_int, k: *const c_int, alpha: *const $t, a: *const $t,
            lda: *const c_int, b: *const $t, ldb: *const c_int, beta: *const $t, c: *mut $t, ldc: *const c_int,
        ) {
            // SAFETY: as above.
            unsafe {
                let (n, k) = (size(n), size(k));
                let old = load(c, n, n, size(ldc));
                let read = |p: *const $t, leading: usize| match transposed(letter(trans)) {
                    Some(false) => load(p, n, k, leading),
                    Some(true) => load(p, k, n, leading).transpose(),
                    None => DMatrix::from_element(n, k, <$t as Real>::NAN),
                };
                let product = read(a, size(lda)) * read(b, size(ldb)).transpose();
                let both = (&product + product.transpose()) * *alpha;
                let sum = old.zip_map(&both, |o, p| combine(*beta, o, p));
                store(&sum, c, size(ldc), Some(letter(uplo) == b'U'));
            }
        }

        /// Cholesky: `A = UᵀU` or `LLᵀ` in place; `info > 0` where A is not positive definite.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $potrf(
            uplo: *const c_char, n: *const c_int, a: *mut $t, lda: *const c_int, info: *mut c_int,
        ) {
            // SAFETY: as above.
            unsafe {
                let upper = letter(uplo) == b'U';
                let matrix = load_symmetric(a, size(n), size(lda), upper);
                *info = 1;
                if matrix.iter().all(|v| v.is_finite()) && let Some(factor) = matrix.cholesky() {
                    let l = factor.l();
                    store(&if upper { l.transpose() } else { l }, a, size(lda), Some(upper));
                    *info = 0;
                }
            }
        }

        /// Solves `A X = B` with the factor of `potrf`.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $potrs(
            uplo: *const c_char, n: *const c_int, nrhs: *const c_int, a: *const $t, lda: *const c_int, b: *mut $t,
            ldb: *const c_int, info: *mut c_int,
        ) {
            // SAFETY: as above.
            unsafe {
                let n = size(n);
                let factor = load(a, n, n, size(lda));
                let l = if letter(uplo) == b'U' { factor.transpose() } else { factor };
                let right = load(b, n, size(nrhs), size(ldb));
                let solved = l.solve_lower_triangular(&right).and_then(|y| l.tr_solve_lower_triangular(&y));
                *info = if solved.is_some() { 0 } else { -1 };
                if let Some(x) = solved {
                    store(&x, b, size(ldb), None);
                }
            }
        }

        /// Solves `A X = B` by LU; `info > 0` where A is singular. The factors and pivots are not returned.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $gesv(
            n: *const c_int, nrhs: *const c_int, a: *mut $t, lda: *const c_int, _ipiv: *mut c_int, b: *mut $t,
            ldb: *const c_int, info: *mut c_int,
        ) {
            // SAFETY: as above.
            unsafe {
                let n = size(n);
                let solved = load(a, n, n, size(lda)).lu().solve(&load(b, n, size(nrhs), size(ldb)));
                *info = if solved.is_some() { 0 } else { 1 };
                if let Some(x) = solved {
                    store(&x, b, size(ldb), None);
                }
            }
        }

        /// Singular values and thin factors.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $gesdd(
            jobz: *const c_char, m: *const c_int, n: *const c_int, a: *mut $t, lda: *const c_int, s: *mut $t,
            u: *mut $t, ldu: *const c_int, vt: *mut $t, ldvt: *const c_int, work: *mut $t, lwork: *const c_int,
            _iwork: *mut c_int, info: *mut c_int,
        ) {
            // SAFETY: as above.
            unsafe {
                *info = 0;
                if !is_query(lwork, work, size(m) + size(n)) {
                    *info = svd_into(letter(jobz), size(m), size(n), a, size(lda), s, u, size(ldu), vt, size(ldvt));
                }
            }
        }

        /// Singular values and thin factors; `jobu` and `jobvt` must agree.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $gesvd(
            jobu: *const c_char, jobvt: *const c_char, m: *const c_int, n: *const c_int, a: *mut $t, lda: *const c_int,
            s: *mut $t, u: *mut $t, ldu: *const c_int, vt: *mut $t, ldvt: *const c_int, work: *mut $t,
            lwork: *const c_int, info: *mut c_int,
        ) {
            // SAFETY: as above.
            unsafe {
                *info = if letter(jobu) == letter(jobvt) { 0 } else { -1 };
                if *info == 0 && !is_query(lwork, work, size(m) + size(n)) {
                    *info = svd_into(letter(jobu), size(m), size(n), a, size(lda), s, u, size(ldu), vt, size(ldvt));
                }
            }
        }

        /// All eigenvalues of a symmetric matrix in ascending order, with their vectors for `jobz` V.
        #[unsafe(no_mangle)]
        #[rustfmt::skip]
        unsafe extern "C" fn $syevr(
            jobz: *const c_char, range: *const c_char, uplo: *const c_char, n: *const c_int, a: *mut $t,
            lda: *const c_int, _vl: *const $t, _vu: *const $t, _il: *const c_int, _iu: *const c_int, _abstol: *const $t,
            m: *mut c_int, w: *mut $t, z: *mut $t, ldz: *const c_int, _isuppz: *mut c_int, work: *mut $t,
            lwork: *const c_int, iwork: *mut c_int, liwork: *const c_int, info: *mut c_int,
        ) {
            // SAFETY: as above.
            unsafe {
                let order = size(n);
                *info = if letter(range) == b'A' { 0 } else { -2 };
                if *info != 0 {
                    return;
                }
                if *lwork == -1 || *liwork == -1 {
                    *work = <$t as Real>::count(order.max(1));
                    *iwork = (*n).max(1);
                    return;
                }
                let matrix = load_symmetric(a, order, size(lda), letter(uplo) == b'U');
                let solved = if matrix.iter().all(|v| v.is_finite()) { <$t as Real>::eigen(&matrix) } else { None };
                let Some((values, vectors)) = solved else {
                    *info = 1;
                    return;
                };
                for (i, value) in values.iter().enumerate() {
                    *w.add(i) = *value;
                }
                *m = *n;
                if letter(jobz) == b'V' {
                    store(&vectors, z, size(ldz), None);
                }
            }
        }
    };
}

routines!(f64, dgemm_, dgemv_, dsymv_, dsyrk_, dsyr2k_, dpotrf_, dpotrs_, dgesv_, dgesdd_, dgesvd_, dsyevr_);
routines!(f32, sgemm_, sgemv_, ssymv_, ssyrk_, ssyr2k_, spotrf_, spotrs_, sgesv_, sgesdd_, sgesvd_, ssyevr_);

#[cfg(test)]
mod tests;
