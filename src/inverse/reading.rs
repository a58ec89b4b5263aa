//! What weights mean: directions, shares, and comparison up to the free scale.

use crate::control::lyapunov::{Clock, LinearEquationError, Lyapunov};
use crate::num::linalg::symmetric;
use nalgebra::{DMatrix, DVector};

/// A principal axis of a weight.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// The eigenvalue: what a unit along this axis costs.
    pub weight: f64,
    /// Its share of the trace.
    pub share: f64,
    /// The unit vector, in the states (or inputs) of the plant; its largest component is positive.
    pub direction: Vec<f64>,
}

/// The principal axes of a symmetric weight, dearest first.
#[must_use]
pub fn axes(weight: &DMatrix<f64>) -> Vec<Axis> {
    let eigen = symmetric(weight).symmetric_eigen();
    let trace = eigen.eigenvalues.sum();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|i, j| eigen.eigenvalues[*j].total_cmp(&eigen.eigenvalues[*i]));
    order
        .into_iter()
        .map(|i| {
            let v = eigen.eigenvectors.column(i);
            let sign = if v[v.iamax()] < 0.0 { -1.0 } else { 1.0 };
            Axis {
                weight: eigen.eigenvalues[i],
                share: if trace == 0.0 { 0.0 } else { eigen.eigenvalues[i] / trace },
                direction: v.iter().map(|x| x * sign).collect(),
            }
        })
        .collect()
}

/// Shares of the cost: what every state and every input contributes; they sum to 1, and a single one may be negative
/// where a weight has off-diagonal entries.
#[derive(Debug, Clone, PartialEq)]
pub struct Shares {
    /// `∫ x_i (Qx)_i` over the whole cost, for every state.
    pub states: Vec<f64>,
    /// `∫ u_i (Ru)_i` over the whole cost, for every input.
    pub inputs: Vec<f64>,
}

/// Shares of a cost where the states have the second moments X (`∫ xxᵀ`, n×n) and the inputs U (m×m), up to a common
/// factor. `None` where the cost is zero.
#[must_use]
pub fn shares(q: &DMatrix<f64>, r: &DMatrix<f64>, x: &DMatrix<f64>, u: &DMatrix<f64>) -> Option<Shares> {
    let states: Vec<f64> = (q * x).diagonal().iter().copied().collect();
    let inputs: Vec<f64> = (r * u).diagonal().iter().copied().collect();
    let total: f64 = states.iter().chain(&inputs).sum();
    let share = |values: Vec<f64>| values.into_iter().map(|v| v / total).collect();
    (total > 0.0 && total.is_finite()).then(|| Shares { states: share(states), inputs: share(inputs) })
}

/// Shares along a recorded trajectory: rows are samples, equally spaced in time. `None` where the cost along it is
/// zero.
///
/// # Panics
/// If the columns do not fit the weights, or the numbers of samples differ, which is a mistake of the caller.
#[must_use]
pub fn shares_along(
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    states: &DMatrix<f64>,
    inputs: &DMatrix<f64>,
) -> Option<Shares> {
    assert_eq!((states.ncols(), inputs.ncols()), (q.nrows(), r.nrows()), "columns of a trajectory");
    assert_eq!(states.nrows(), inputs.nrows(), "samples of a trajectory");
    shares(q, r, &states.tr_mul(states), &inputs.tr_mul(inputs))
}

/// Shares in the steady state of u = −Kx under white noise of intensity W on the states.
///
/// # Errors
/// [`LinearEquationError`] where A − BK has no Lyapunov equation.
pub fn stationary_shares(
    closed: &DMatrix<f64>,
    k: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    w: &DMatrix<f64>,
    clock: Clock,
) -> Result<Option<Shares>, LinearEquationError> {
    let x = stationary_covariance(closed, w, clock)?;
    let u = k * &x * k.transpose();
    Ok(shares(q, r, &x, &u))
}

/// The covariance of the states in the steady state of u = −Kx, or along anything else that drives A − BK: X with
/// `(A − BK)X + X(A − BK)ᵀ + W = 0` (`(A − BK)X(A − BK)ᵀ − X + W = 0`), n×n.
///
/// # Errors
/// [`LinearEquationError`] where A − BK has no Lyapunov equation.
pub fn stationary_covariance(
    closed: &DMatrix<f64>,
    w: &DMatrix<f64>,
    clock: Clock,
) -> Result<DMatrix<f64>, LinearEquationError> {
    Ok(Lyapunov::new(closed, clock)?.solve_adjoint(w))
}

/// The principal axes of `DQD` with D the sizes of the states: what is paid for motions as large as they are. Those of
/// Q itself compare a radian with a radian per second, and turn with the units.
#[must_use]
pub fn sized_axes(q: &DMatrix<f64>, sizes: &[f64]) -> Vec<Axis> {
    axes(&DMatrix::from_fn(q.nrows(), q.ncols(), |i, j| q[(i, j)] * sizes[i] * sizes[j]))
}

/// How alike two costs are, whatever their scales.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// The factor on the second cost that brings it nearest to the first (least squares).
    pub scale: f64,
    /// `⟨C₁, C₂⟩/(‖C₁‖‖C₂‖)` with `C = blkdiag(Q, R)`: 1 for equal costs.
    pub similarity: f64,
    /// The spread of the logarithms of the eigenvalues of `C₁⁻¹C₂` around their mean, as a root mean square: 0 for
    /// equal costs, whatever the units of states and inputs. `None` where a cost is singular.
    pub log_distance: Option<f64>,
    /// The factor on the second cost that brings the eigenvalues of `C₁⁻¹C₂` to a geometric mean of 1, whatever the
    /// units; `None` where a cost is singular.
    pub log_scale: Option<f64>,
    /// For every state its diagonal weight in the first cost over that in the second, brought to one scale by
    /// `log_scale`, or by `scale` where there is none; `None` where the second has no weight there.
    pub state_ratios: Vec<Option<f64>>,
    /// The same for every input.
    pub input_ratios: Vec<Option<f64>>,
}

/// Compares blkdiag(Q₁, R₁) with blkdiag(Q₂, R₂).
///
/// # Panics
/// If the sizes differ, which is a mistake of the caller.
#[must_use]
pub fn compare(first: (&DMatrix<f64>, &DMatrix<f64>), second: (&DMatrix<f64>, &DMatrix<f64>)) -> Comparison {
    let inner = |x: (&DMatrix<f64>, &DMatrix<f64>), y: (&DMatrix<f64>, &DMatrix<f64>)| x.0.dot(y.0) + x.1.dot(y.1);
    let (one, two, both) = (inner(first, first), inner(second, second), inner(first, second));
    let logs = |x: &DMatrix<f64>, y: &DMatrix<f64>| -> Option<Vec<f64>> {
        let factor = symmetric(x).cholesky()?.l();
        let half = factor.solve_lower_triangular(y)?;
        let whole = symmetric(&factor.solve_lower_triangular(&half.transpose())?);
        let values = whole.symmetric_eigenvalues();
        values.iter().all(|v| *v > 0.0).then(|| values.iter().map(|v| v.ln()).collect())
    };
    let spread = logs(first.0, second.0).zip(logs(first.1, second.1)).map(|(q, r)| {
        let all = DVector::from_vec([q, r].concat());
        let mean = all.mean();
        ((-mean).exp(), all.map(|v| (v - mean).powi(2)).mean().sqrt())
    });
    let (log_scale, log_distance) = spread.unzip();
    let scale = both / two;
    let common = log_scale.unwrap_or(scale);
    let ratios = |x: &DMatrix<f64>, y: &DMatrix<f64>| {
        let ratio = |i: usize| Some(x[(i, i)] / (common * y[(i, i)])).filter(|v: &f64| v.is_finite());
        (0..x.nrows()).map(ratio).collect()
    };
    Comparison {
        scale,
        similarity: both / (one * two).sqrt(),
        log_distance,
        log_scale,
        state_ratios: ratios(first.0, second.0),
        input_ratios: ratios(first.1, second.1),
    }
}

/// The weights on the scale on which R has the mean eigenvalue 1, and the factor that brings them there.
#[must_use]
pub fn normalised(q: &DMatrix<f64>, r: &DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>, f64) {
    let factor = r.nrows() as f64 / r.trace();
    (q * factor, r * factor, factor)
}
