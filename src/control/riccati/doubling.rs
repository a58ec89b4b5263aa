//! Structure-preserving doubling (Chu, Fan, Lin and Wang, Int. J. Control 77, 767–788, 2004; Chu, Fan and Lin, Linear
//! Algebra Appl. 396, 55–80, 2005).

use super::Riccati;
use crate::control::lyapunov::Clock;
use crate::num::linalg::symmetric;
use nalgebra::DMatrix;

/// Doublings at most: 2⁶⁰ steps of the fixed-point iteration.
const DOUBLINGS: usize = 60;
/// A doubling that moves P by less than this share of its norm is the last.
const CONVERGED: f64 = 1e-14;

/// An approximation of the stabilising solution; `None` where a matrix on the way is singular or numbers overflow.
///
/// `E ← E(I + GH)⁻¹E`, `G ← G + E(I + GH)⁻¹GEᵀ`, `H ← H + EᵀH(I + GH)⁻¹E`, and H tends to P. In sampled time the start
/// is (A, BR⁻¹Bᵀ, Q), in continuous time its Cayley transform.
#[must_use]
pub fn doubling(equation: &Riccati) -> Option<DMatrix<f64>> {
    let n = equation.a.nrows();
    let g = equation.input_weight();
    // P = ρP' balances the two weights; both are congruent and the iteration sees numbers of one size.
    let ratio = equation.q.norm() / g.norm();
    let rho = if ratio.is_normal() { ratio.sqrt() } else { 1.0 };
    let (g, h) = (g * rho, &equation.q / rho);
    let identity = DMatrix::<f64>::identity(n, n);
    let (mut e, mut g, mut h) = match equation.clock {
        Clock::Sampled => (equation.a.clone(), g, h),
        Clock::Continuous => cayley(&equation.a, &g, &h)?,
    };
    for _ in 0..DOUBLINGS {
        let factor = (&identity + &g * &h).lu();
        let we = factor.solve(&e)?;
        let wg = factor.solve(&g)?;
        let change = e.tr_mul(&(&h * &we));
        let next_g = symmetric(&(&g + &e * wg * e.transpose()));
        let next_e = &e * &we;
        let next_h = symmetric(&(&h + &change));
        if next_h.iter().chain(next_e.iter()).any(|v| !v.is_finite()) {
            return None;
        }
        let small = change.norm() <= CONVERGED * next_h.norm();
        (e, g, h) = (next_e, next_g, next_h);
        if small {
            return Some(h * rho);
        }
    }
    // Rounding may keep the last digits moving; H is still good enough to start from.
    Some(h * rho)
}

/// The doubling start of a continuous equation: with `A_γ = A − γI` and `W = A_γᵀ + HA_γ⁻¹G`,
/// `E = I + 2γW⁻ᵀ`, `G = 2γA_γ⁻¹GW⁻¹`, `H = 2γW⁻¹HA_γ⁻¹`.
fn cayley(a: &DMatrix<f64>, g: &DMatrix<f64>, h: &DMatrix<f64>) -> Option<(DMatrix<f64>, DMatrix<f64>, DMatrix<f64>)> {
    let n = a.nrows();
    // A shift of the size of the closed loop's fast modes; any positive one converges.
    let mut gamma = a.norm().max((g.norm() * h.norm()).sqrt()) / (n as f64).sqrt();
    if !gamma.is_normal() {
        gamma = 1.0;
    }
    for _ in 0..8 {
        let shifted = (a - DMatrix::identity(n, n) * gamma).lu();
        if let Some(inverse) = shifted.try_inverse() {
            let w = a.transpose() - DMatrix::identity(n, n) * gamma + h * &inverse * g;
            if let Some(wi) = w.try_inverse() {
                let e = DMatrix::identity(n, n) + wi.transpose() * (2.0 * gamma);
                let g0 = symmetric(&(&inverse * g * &wi * (2.0 * gamma)));
                let h0 = symmetric(&(&wi * h * &inverse * (2.0 * gamma)));
                return Some((e, g0, h0));
            }
        }
        // γ was an eigenvalue: move it.
        gamma *= 1.37;
    }
    None
}
