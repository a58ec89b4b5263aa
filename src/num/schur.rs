//! The complex Schur form of a real matrix.
//!
//! Neither library of the crate offers one that is both public and sure to end: `faer` keeps its Schur iteration to
//! itself, and nalgebra's never returns on some cyclic permutations.

use super::linalg::NoConvergence;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// QR sweeps allowed for one eigenvalue.
const SWEEPS: usize = 60;
/// After so many sweeps without deflation an exceptional shift breaks a cycle.
const EXCEPTIONAL: usize = 10;

/// `A = U T Uᴴ` with U unitary and T upper triangular; the eigenvalues of A are on the diagonal of T, in no particular
/// order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ComplexSchur {
    /// U, n×n, unitary.
    pub u: DMatrix<Complex64>,
    /// T, n×n, upper triangular.
    pub t: DMatrix<Complex64>,
}

impl ComplexSchur {
    /// By reduction to Hessenberg form and QR sweeps with Wilkinson's shift (Golub and Van Loan, Matrix Computations,
    /// §7.5).
    ///
    /// Backward stable: the error is a small multiple of the machine epsilon times `‖A‖`.
    ///
    /// # Errors
    /// [`NoConvergence`], also for a matrix with an entry that is not finite.
    ///
    /// # Panics
    /// If the matrix is not square, which is a mistake of the caller.
    pub(crate) fn new(a: &DMatrix<f64>) -> Result<Self, NoConvergence> {
        assert!(a.is_square(), "Schur form of a {}x{} matrix", a.nrows(), a.ncols());
        let n = a.nrows();
        let fail = NoConvergence { rows: n, columns: n };
        if a.iter().any(|x| !x.is_finite()) {
            return Err(fail);
        }
        let complex = |m: DMatrix<f64>| m.map(|x| Complex64::new(x, 0.0));
        if n < 2 {
            return Ok(Self { u: complex(DMatrix::identity(n, n)), t: complex(a.clone()) });
        }
        let (q, h) = a.clone().hessenberg().unpack();
        let mut schur = Self { u: complex(q), t: complex(h) };
        schur.iterate().then_some(schur).ok_or(fail)
    }

    /// The eigenvalues.
    pub(crate) fn eigenvalues(&self) -> impl Iterator<Item = Complex64> + '_ {
        (0..self.t.nrows()).map(|i| self.t[(i, i)])
    }

    /// Deflates eigenvalue after eigenvalue from the lower right; false where one does not come.
    fn iterate(&mut self) -> bool {
        let n = self.t.nrows();
        let norm = self.t.norm();
        let mut high = n - 1;
        let mut sweeps = 0;
        while high > 0 {
            let low = (1..=high).rev().find(|k| self.is_negligible(*k, norm)).unwrap_or(0);
            if low > 0 {
                self.t[(low, low - 1)] = Complex64::new(0.0, 0.0);
            }
            if low == high {
                high -= 1;
                sweeps = 0;
                continue;
            }
            sweeps += 1;
            if sweeps > SWEEPS {
                return false;
            }
            let shift = if sweeps % EXCEPTIONAL == 0 {
                Complex64::new(self.t[(high, high - 1)].norm(), self.t[(high, high)].norm())
            } else {
                self.wilkinson_shift(high)
            };
            self.sweep(low, high, shift);
        }
        // What is below the diagonal is negligible by the test above, or rounding of the sweeps.
        for j in 0..n {
            for i in j + 1..n {
                self.t[(i, j)] = Complex64::new(0.0, 0.0);
            }
        }
        true
    }

    fn is_negligible(&self, k: usize, norm: f64) -> bool {
        let around = self.t[(k, k)].norm() + self.t[(k - 1, k - 1)].norm();
        let scale = if around > 0.0 { around } else { norm };
        self.t[(k, k - 1)].norm() <= f64::EPSILON * scale
    }

    /// The eigenvalue of the last 2×2 block that is nearer to its last entry.
    fn wilkinson_shift(&self, high: usize) -> Complex64 {
        let (a, b) = (self.t[(high - 1, high - 1)], self.t[(high - 1, high)]);
        let (c, d) = (self.t[(high, high - 1)], self.t[(high, high)]);
        let half = (a - d) * 0.5;
        let root = (half * half + b * c).sqrt();
        // The larger of the two denominators avoids cancellation.
        let denominator = if (half + root).norm() >= (half - root).norm() { half + root } else { half - root };
        if denominator.norm() == 0.0 { d } else { d - b * c / denominator }
    }

    /// One QR step `H − σI = QR, H ← RQ + σI` on the active block, applied to all of T and U.
    fn sweep(&mut self, low: usize, high: usize, shift: Complex64) {
        let n = self.t.nrows();
        for k in low..=high {
            self.t[(k, k)] -= shift;
        }
        let mut rotations = Vec::with_capacity(high - low);
        for k in low..high {
            let (x, y) = (self.t[(k, k)], self.t[(k + 1, k)]);
            let length = x.norm().hypot(y.norm());
            let (c, s) = if length == 0.0 {
                (Complex64::new(1.0, 0.0), Complex64::new(0.0, 0.0))
            } else {
                (x / length, y / length)
            };
            for j in k..n {
                let (upper, lower) = (self.t[(k, j)], self.t[(k + 1, j)]);
                self.t[(k, j)] = c.conj() * upper + s.conj() * lower;
                self.t[(k + 1, j)] = c * lower - s * upper;
            }
            rotations.push((c, s));
        }
        for (i, (c, s)) in rotations.into_iter().enumerate() {
            let k = low + i;
            for matrix in [&mut self.t, &mut self.u] {
                let (mut left, mut right) = matrix.columns_range_pair_mut(k..=k, k + 1..=k + 1);
                for (l, r) in left.iter_mut().zip(right.iter_mut()) {
                    let (old_l, old_r) = (*l, *r);
                    *l = c * old_l + s * old_r;
                    *r = c.conj() * old_r - s.conj() * old_l;
                }
            }
        }
        for k in low..=high {
            self.t[(k, k)] += shift;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::rng;
    use rand::RngExt;

    fn check(a: &DMatrix<f64>) {
        let schur = ComplexSchur::new(a).unwrap();
        let n = a.nrows();
        let identity = DMatrix::<Complex64>::identity(n, n);
        assert!((schur.u.adjoint() * &schur.u - identity).norm() < 1e-13 * n as f64);
        let back = &schur.u * &schur.t * schur.u.adjoint();
        let error = (back - a.map(|x| Complex64::new(x, 0.0))).norm();
        assert!(error <= 1e-14 * (n as f64) * a.norm(), "error {error:e} of {a}");
        assert!((0..n).all(|j| (j + 1..n).all(|i| schur.t[(i, j)].norm() == 0.0)));
    }

    #[test]
    fn permutations_on_which_nalgebra_hangs() {
        for n in 2..9 {
            check(&DMatrix::from_fn(n, n, |i, j| if (i + 1) % n == j { 1.0 } else { 0.0 }));
        }
    }

    #[test]
    fn random_and_graded_and_defective_matrices_come_back() {
        let mut random = rng::stream(20260, "schur");
        for n in 1..=24 {
            check(&DMatrix::from_fn(n, n, |_, _| random.random_range(-1.0..1.0)));
            check(&DMatrix::from_fn(n, n, |i, j| random.random_range(-1.0..1.0) * 10f64.powi(i as i32 - j as i32)));
            check(&DMatrix::from_fn(n, n, |i, j| if i == j { 2.0 } else { f64::from(u8::from(j == i + 1)) }));
            check(&DMatrix::zeros(n, n));
        }
    }

    #[test]
    fn a_matrix_that_is_not_finite_is_refused() {
        let refused = ComplexSchur::new(&DMatrix::from_element(2, 2, f64::INFINITY)).unwrap_err();
        assert_eq!(refused, NoConvergence { rows: 2, columns: 2 });
    }
}
