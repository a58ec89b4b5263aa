//! Controllability, stabilisability, observability and detectability, by the test of Popov, Belevitch and Hautus.
//!
//! Ranks of Krylov matrices `[B AB A²B …]` are not used: they lose all digits beyond a few states.

use super::lyapunov::Clock;
use crate::num::linalg::{self, NoConvergence};
use nalgebra::DMatrix;
use num_complex::Complex64;

/// A mode is unreachable where the least singular value of `[A − λI, B]` is below this share of its norm.
pub(crate) const RANK: f64 = 1e-12;
/// How close to the boundary of stability, as a share of the size of A, an eigenvalue counts as on it.
const BOUNDARY: f64 = 1e-12;

/// A mode of A, and how nearly the inputs or outputs miss it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mode {
    /// The eigenvalue.
    pub eigenvalue: Complex64,
    /// Least singular value of `[A − λI, B]` over its largest: 0 for a mode that is missed.
    pub distance: f64,
}

/// A structural hypothesis that fails.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum StructuralError {
    /// The inputs do not reach a mode that does not decay by itself.
    #[error("(A, B) is not stabilisable: no input reaches the mode {0}")]
    NotStabilisable(Complex64),
    /// The outputs, or the cost, do not see a mode that does not decay by itself.
    #[error("(A, C) is not detectable: no output sees the mode {0}")]
    NotDetectable(Complex64),
    /// The cost does not see a mode on the boundary of stability, so that no solution is stabilising.
    #[error("the cost does not see the mode {0} on the boundary of stability")]
    UnseenBoundaryMode(Complex64),
    /// The inputs do not reach a mode.
    #[error("(A, B) is not controllable: no input reaches the mode {0}")]
    NotControllable(Complex64),
    /// An eigenvalue iteration failed.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
}

/// The distance of every mode of A, n×n, from being missed by B, n×m.
///
/// # Errors
/// [`NoConvergence`] of an eigenvalue or singular value iteration.
pub fn reach(a: &DMatrix<f64>, b: &DMatrix<f64>) -> Result<Vec<Mode>, NoConvergence> {
    let (n, m) = (a.nrows(), b.ncols());
    if n == 0 {
        return Ok(Vec::new());
    }
    // B of the size of A: the units of the inputs do not matter.
    let (size_a, size_b) = (a.amax(), b.amax());
    let factor = if size_a > 0.0 && size_b > 0.0 { size_a / size_b } else { 1.0 };
    linalg::eigenvalues(a)?
        .into_iter()
        .map(|eigenvalue| {
            let pencil = DMatrix::from_fn(n, n + m, |i, j| {
                let value = if j < n { a[(i, j)] } else { b[(i, j - n)] * factor };
                let diagonal = if i == j { eigenvalue } else { Complex64::new(0.0, 0.0) };
                Complex64::new(value, 0.0) - diagonal
            });
            let values = linalg::complex_singular_values(&pencil)?;
            let (largest, least) = (values[0], values[n - 1]);
            Ok(Mode { eigenvalue, distance: if largest > 0.0 { least / largest } else { 0.0 } })
        })
        .collect()
}

fn missed(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    counts: impl Fn(Complex64) -> bool,
) -> Result<Option<Complex64>, NoConvergence> {
    let modes = reach(a, b)?;
    Ok(modes.into_iter().find(|mode| mode.distance <= RANK && counts(mode.eigenvalue)).map(|mode| mode.eigenvalue))
}

fn boundary(a: &DMatrix<f64>, clock: Clock) -> f64 {
    match clock {
        Clock::Continuous => BOUNDARY * a.norm(),
        Clock::Sampled => BOUNDARY,
    }
}

/// Whether inputs B reach every mode of A.
///
/// # Errors
/// [`StructuralError::NotControllable`] with the mode.
pub fn check_controllable(a: &DMatrix<f64>, b: &DMatrix<f64>) -> Result<(), StructuralError> {
    missed(a, b, |_| true)?.map_or(Ok(()), |mode| Err(StructuralError::NotControllable(mode)))
}

/// Whether inputs B reach every mode of A that does not decay by itself.
///
/// # Errors
/// [`StructuralError::NotStabilisable`] with the mode.
pub fn check_stabilisable(a: &DMatrix<f64>, b: &DMatrix<f64>, clock: Clock) -> Result<(), StructuralError> {
    let margin = boundary(a, clock);
    missed(a, b, |mode| clock.margin(mode) <= margin)?
        .map_or(Ok(()), |mode| Err(StructuralError::NotStabilisable(mode)))
}

/// Whether outputs C, p×n, see every mode of A that does not decay by itself.
///
/// # Errors
/// [`StructuralError::NotDetectable`] with the mode.
pub fn check_detectable(a: &DMatrix<f64>, c: &DMatrix<f64>, clock: Clock) -> Result<(), StructuralError> {
    let margin = boundary(a, clock);
    missed(&a.transpose(), &c.transpose(), |mode| clock.margin(mode) <= margin)?
        .map_or(Ok(()), |mode| Err(StructuralError::NotDetectable(mode)))
}

/// Whether outputs C, p×n (or a weight Q), see every mode of A on the boundary of stability.
///
/// # Errors
/// [`StructuralError::UnseenBoundaryMode`] with the mode.
pub(crate) fn check_axis_observable(a: &DMatrix<f64>, c: &DMatrix<f64>, clock: Clock) -> Result<(), StructuralError> {
    let margin = boundary(a, clock);
    missed(&a.transpose(), &c.transpose(), |mode| clock.margin(mode).abs() <= margin)?
        .map_or(Ok(()), |mode| Err(StructuralError::UnseenBoundaryMode(mode)))
}
