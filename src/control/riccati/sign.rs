//! The matrix sign function (Roberts 1971, Int. J. Control 32, 677–687, 1980; Byers, Linear Algebra Appl. 85, 267–279,
//! 1987).

use super::Riccati;
use crate::control::lyapunov::Clock;
use crate::num::linalg::symmetric;
use nalgebra::DMatrix;

/// Newton steps at most.
const STEPS: usize = 80;
/// A step that moves the matrix by less than this share of its norm is the last.
const CONVERGED: f64 = 1e-13;

/// An approximation of the stabilising solution from the stable invariant subspace of the Hamiltonian matrix; `None`
/// where the iteration breaks down or numbers overflow.
///
/// In sampled time the symplectic pencil `M − λN` with `M = [A 0; −Q I]`, `N = [I BR⁻¹Bᵀ; 0 Aᵀ]` goes to `(M + N)⁻¹(M −
/// N)`, whose eigenvalues `(λ − 1)/(λ + 1)` lie in the left half plane for |λ| < 1; A may be singular.
#[must_use]
pub fn sign_function(equation: &Riccati) -> Option<DMatrix<f64>> {
    let n = equation.a.nrows();
    let g = equation.input_weight();
    let ratio = equation.q.norm() / g.norm();
    let rho = if ratio.is_normal() { ratio.sqrt() } else { 1.0 };
    let (g, q) = (g * rho, &equation.q / rho);
    let a = &equation.a;
    let mut z = match equation.clock {
        Clock::Continuous => block(a, &-&g, &-&q, &-a.transpose()),
        Clock::Sampled => {
            let identity = DMatrix::identity(n, n);
            let sum = block(&(a + &identity), &g, &-&q, &(&identity + a.transpose()));
            let difference = block(&(a - &identity), &-&g, &-&q, &(&identity - a.transpose()));
            sum.lu().solve(&difference)?
        }
    };
    for _ in 0..STEPS {
        let lu = z.clone().lu();
        let inverse = lu.try_inverse()?;
        // Scaling by norms brings all eigenvalues towards the unit circle before quadratic convergence sets in.
        let scale = (inverse.norm() / z.norm()).sqrt();
        let scale = if scale.is_normal() { scale } else { 1.0 };
        let next = (&z * scale + inverse / scale) * 0.5;
        if next.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let moved = (&next - &z).norm() / next.norm();
        z = next;
        if moved <= CONVERGED {
            return subspace(&z, n).map(|p| p * rho);
        }
    }
    // Rounding may keep the last digits moving; the subspace is still good enough to start from.
    subspace(&z, n).map(|p| p * rho)
}

/// P from `[Z₁₂; Z₂₂ + I] P = −[Z₁₁ + I; Z₂₁]`, by least squares.
fn subspace(z: &DMatrix<f64>, n: usize) -> Option<DMatrix<f64>> {
    let identity = DMatrix::<f64>::identity(n, n);
    let mut left = DMatrix::zeros(2 * n, n);
    left.rows_mut(0, n).copy_from(&z.view((0, n), (n, n)));
    left.rows_mut(n, n).copy_from(&(z.view((n, n), (n, n)) + &identity));
    let mut right = DMatrix::zeros(2 * n, n);
    right.rows_mut(0, n).copy_from(&-(z.view((0, 0), (n, n)) + &identity));
    right.rows_mut(n, n).copy_from(&-z.view((n, 0), (n, n)));
    let qr = left.qr();
    let p = qr.r().solve_upper_triangular(&qr.q().tr_mul(&right))?;
    p.iter().all(|v| v.is_finite()).then(|| symmetric(&p))
}

fn block(a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DMatrix<f64>, d: &DMatrix<f64>) -> DMatrix<f64> {
    let n = a.nrows();
    let mut z = DMatrix::zeros(2 * n, 2 * n);
    z.view_mut((0, 0), (n, n)).copy_from(a);
    z.view_mut((0, n), (n, n)).copy_from(b);
    z.view_mut((n, 0), (n, n)).copy_from(c);
    z.view_mut((n, n), (n, n)).copy_from(d);
    z
}
