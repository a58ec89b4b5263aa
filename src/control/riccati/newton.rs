//! Newton's method on the Riccati equation (Kleinman, IEEE TAC 13, 114–115, 1968; Hewer, IEEE TAC 16, 382–384, 1971).

use super::{Riccati, RiccatiError};
use crate::control::lyapunov::{LinearEquationError, Lyapunov};
use nalgebra::DMatrix;
use num_complex::Complex64;

/// Steps at most; convergence from a far start halves the distance step by step before it squares it.
const STEPS: usize = 60;
/// A step that moves P by less than this share of its norm is the last.
const CONVERGED: f64 = 1e-15;

/// Where Newton's method ended.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Newton {
    /// P, n×n.
    pub p: DMatrix<f64>,
    /// The gain of P.
    pub k: DMatrix<f64>,
    /// Eigenvalues of A − BK.
    pub poles: Vec<Complex64>,
    /// Lyapunov equations solved.
    pub steps: usize,
}

/// `(A − BK)ᵀP + P(A − BK) + Q + KᵀRK = 0`, `K ← R⁻¹BᵀP`, from a stabilising gain; in sampled time the Stein equation.
///
/// The iteration ends at rounding level: where a step no longer becomes smaller.
///
/// # Errors
/// [`RiccatiError::Unsolved`] where the gain does not stabilise, [`RiccatiError::Linear`] where a closed loop is so
/// close to the boundary of stability that its equation is singular.
pub(crate) fn newton(equation: &Riccati, stabilising: &DMatrix<f64>) -> Result<Newton, RiccatiError> {
    let not_finite = RiccatiError::Unsolved { reason: "numbers overflow", residual: f64::INFINITY };
    let mut k = stabilising.clone();
    let mut previous: Option<DMatrix<f64>> = None;
    let mut last_step = f64::INFINITY;
    for step in 1..=STEPS {
        if k.iter().any(|v| !v.is_finite()) {
            return Err(not_finite);
        }
        let closed = &equation.a - &equation.b * &k;
        let lyapunov = Lyapunov::new(&closed, equation.clock).map_err(|error| match error {
            LinearEquationError::NoConvergence(_) => not_finite.clone(),
            error => error.into(),
        })?;
        if !lyapunov.is_stable() {
            return Err(RiccatiError::Unsolved {
                reason: "the starting gain does not stabilise",
                residual: f64::INFINITY,
            });
        }
        let p = lyapunov.solve(&(&equation.q + k.tr_mul(&(&equation.r * &k))));
        if p.iter().any(|v| !v.is_finite()) {
            return Err(not_finite);
        }
        let moved = previous.as_ref().map_or(f64::INFINITY, |old| (&p - old).norm() / p.norm().max(f64::MIN_POSITIVE));
        // Quadratic convergence ends in noise: once small, a step that fails to shrink says that noise is reached.
        if moved <= CONVERGED || (moved < 1e-6 && moved >= 0.5 * last_step) || step == STEPS {
            let k = equation.gain(&p);
            let poles = crate::num::linalg::eigenvalues(&(&equation.a - &equation.b * &k))?;
            return Ok(Newton { p, k, poles, steps: step });
        }
        k = equation.gain(&p);
        last_step = moved;
        previous = Some(p);
    }
    Err(not_finite)
}
