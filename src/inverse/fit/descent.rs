//! The gradient descent of Priess 2015, Table 3.1 and (3.19), for comparison.

use super::objective::Objective;
use crate::control::riccati::RiccatiError;
use crate::ctl::{Ctl, Stopped};
use nalgebra::DMatrix;

/// How far the descent goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DescentSettings {
    /// λ, the length of a step over the gradient.
    pub rate: f64,
    /// k_end, the number of steps.
    pub steps: usize,
}

/// Where the descent ended. It promises no minimum: a step that would make a weight indefinite is left out, and the run
/// may stall there.
#[derive(Debug, Clone, PartialEq)]
pub struct Descent {
    /// Q.
    pub q: DMatrix<f64>,
    /// R.
    pub r: DMatrix<f64>,
    /// Its regulator.
    pub k: DMatrix<f64>,
    /// f before each step, and after the last.
    pub values: Vec<f64>,
    /// ‖K − K_e‖_F/‖K_e‖_F before each step, and after the last.
    pub distances: Vec<f64>,
    /// Steps of Q that were left out.
    pub rejected_q: usize,
    /// Steps of R that were left out.
    pub rejected_r: usize,
}

/// Why the descent broke off.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DescentError {
    /// A pair of weights has no regulator.
    #[error(transparent)]
    Riccati(#[from] RiccatiError),
    /// Somebody asked to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

/// `θ ← θ − λ ∂f/∂θ` over the upper triangles of Q and R, where an off-diagonal entry has twice the matrix gradient.
/// The part of Q is left out where Q would not stay positive semidefinite, that of R where R would not stay positive
/// definite.
///
/// # Errors
/// [`DescentError`].
pub fn descent(
    objective: &Objective<'_>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    settings: DescentSettings,
    ctl: &Ctl,
) -> Result<Descent, DescentError> {
    let (mut q, mut r) = (q.clone(), r.clone());
    let mut at = objective.evaluate(&q, &r, None)?;
    let mut values = Vec::with_capacity(settings.steps + 1);
    let mut distances = Vec::with_capacity(settings.steps + 1);
    let wanted = &objective.gains.k;
    let distance = |k: &DMatrix<f64>| (k - wanted).norm() / wanted.norm();
    let (mut rejected_q, mut rejected_r) = (0, 0);
    let double = |g: &DMatrix<f64>| {
        DMatrix::from_fn(g.nrows(), g.ncols(), |i, j| if i == j { g[(i, j)] } else { 2.0 * g[(i, j)] })
    };
    for _ in 0..settings.steps {
        ctl.check()?;
        values.push(at.value);
        distances.push(distance(&at.k));
        let next_q = &q - double(&at.gradient_q) * settings.rate;
        let next_r = &r - double(&at.gradient_r) * settings.rate;
        if next_q.symmetric_eigenvalues().min() >= 0.0 {
            q = next_q;
        } else {
            rejected_q += 1;
        }
        if next_r.symmetric_eigenvalues().min() > 0.0 {
            r = next_r;
        } else {
            rejected_r += 1;
        }
        at = objective.evaluate(&q, &r, Some(&at.k))?;
    }
    values.push(at.value);
    distances.push(distance(&at.k));
    Ok(Descent { q, r, k: at.k, values, distances, rejected_q, rejected_r })
}
