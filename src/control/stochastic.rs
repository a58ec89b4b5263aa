//! White noise and quadratic costs over one sample (Van Loan, IEEE TAC 23, 395–404, 1978).

use super::exponential::matrix_exponential;
use super::time_base::Discrete;
use crate::num::linalg::symmetric;
use nalgebra::DMatrix;

/// Why a noise or a cost could not be sampled.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum StochasticError {
    /// A matrix does not have the size of A.
    #[error("{matrix} is {rows}x{columns} where A has {states} rows")]
    Size {
        /// The letter of the matrix.
        matrix: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
        /// Rows of A.
        states: usize,
    },
    /// The matrix exponential overflows.
    #[error("the exponential of the state matrix over {sample_time_s} s overflows")]
    Overflow {
        /// The sample time.
        sample_time_s: f64,
    },
}

/// A state that white noise drives, from sample to sample: `x⁺ = Φx + w`.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledNoise {
    /// Φ = e^{AT}, n×n.
    pub transition: DMatrix<f64>,
    /// Covariance of w: `∫₀ᵀ e^{As} W e^{Aᵀs} ds`, n×n.
    pub covariance: DMatrix<f64>,
}

/// Samples `ẋ = Ax + w` with white noise of intensity W, n×n: from `exp([−A W; 0 Aᵀ]T) = [· F; 0 Φᵀ]` the covariance is
/// ΦF.
///
/// # Errors
/// [`StochasticError`].
pub fn sample_noise(a: &DMatrix<f64>, w: &DMatrix<f64>, time: Discrete) -> Result<SampledNoise, StochasticError> {
    let n = a.nrows();
    for (matrix, value) in [("A", a), ("W", w)] {
        let (rows, columns) = value.shape();
        if (rows, columns) != (n, n) {
            return Err(StochasticError::Size { matrix, rows, columns, states: n });
        }
    }
    let period = time.period_s();
    // Over a long sample e^{−AT} overflows for a stable A: halve, then double with ΦWΦᵀ + W.
    let doublings = (a.norm() * period).log2().ceil().clamp(0.0, 60.0) as i32;
    let step = period * 0.5_f64.powi(doublings);
    let mut block = DMatrix::zeros(2 * n, 2 * n);
    block.view_mut((0, 0), (n, n)).copy_from(&(-a * step));
    block.view_mut((0, n), (n, n)).copy_from(&(symmetric(w) * step));
    block.view_mut((n, n), (n, n)).copy_from(&(a.transpose() * step));
    let overflow = StochasticError::Overflow { sample_time_s: period };
    let exponential = matrix_exponential(&block).ok_or(overflow)?;
    let mut transition = exponential.view((n, n), (n, n)).transpose();
    let mut covariance = symmetric(&(&transition * exponential.view((0, n), (n, n))));
    for _ in 0..doublings {
        covariance = symmetric(&(&transition * &covariance * transition.transpose() + &covariance));
        transition = &transition * &transition;
    }
    if transition.iter().chain(covariance.iter()).any(|v| !v.is_finite()) {
        return Err(overflow);
    }
    Ok(SampledNoise { transition, covariance })
}

/// A continuous cost under a held input, sample by sample: `Σ xᵀQx + 2xᵀSu + uᵀRu`.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledCost {
    /// Φ, n×n.
    pub transition: DMatrix<f64>,
    /// Γ, n×m.
    pub input: DMatrix<f64>,
    /// Q, n×n.
    pub q: DMatrix<f64>,
    /// S, n×m.
    pub s: DMatrix<f64>,
    /// R, m×m.
    pub r: DMatrix<f64>,
}

/// Samples `ẋ = Ax + Bu` with u held and the cost `∫ xᵀQx + uᵀRu dt`: the noise covariance of the adjoint system with
/// state `[x; u]`.
///
/// # Errors
/// [`StochasticError`].
pub fn sample_cost(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    time: Discrete,
) -> Result<SampledCost, StochasticError> {
    let (n, m) = (a.nrows(), b.ncols());
    for (matrix, value, rows, columns) in [("A", a, n, n), ("B", b, n, m), ("Q", q, n, n), ("R", r, m, m)] {
        if value.shape() != (rows, columns) {
            return Err(StochasticError::Size { matrix, rows: value.nrows(), columns: value.ncols(), states: n });
        }
    }
    let mut augmented = DMatrix::zeros(n + m, n + m);
    augmented.view_mut((0, 0), (n, n)).copy_from(a);
    augmented.view_mut((0, n), (n, m)).copy_from(b);
    let mut weight = DMatrix::zeros(n + m, n + m);
    weight.view_mut((0, 0), (n, n)).copy_from(q);
    weight.view_mut((n, n), (m, m)).copy_from(r);
    let sampled = sample_noise(&augmented.transpose(), &weight, time)?;
    let (phi, cost) = (sampled.transition.transpose(), sampled.covariance);
    Ok(SampledCost {
        transition: phi.view((0, 0), (n, n)).into_owned(),
        input: phi.view((0, n), (n, m)).into_owned(),
        q: cost.view((0, 0), (n, n)).into_owned(),
        s: cost.view((0, n), (n, m)).into_owned(),
        r: cost.view((n, n), (m, m)).into_owned(),
    })
}
