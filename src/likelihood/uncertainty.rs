//! How well the data determine the parameters, and whether the search has arrived.
//!
//! Fisher's information at θ̂ is `F = Σ_k (∂e_k)ᵀ Σ⁻¹ (∂e_k)` (Priess 2015, §5.3.1); that of Σ does not mix with it.
//! Its inverse is the covariance of θ̂, enlarged by `N p/(N p − q)` for the q unknowns that Σ̂ was estimated after.

use super::estimate::Estimate;
use super::experiment::Experiment;
use super::noise::Noise;
use crate::num::distributions::student_t;
use nalgebra::DMatrix;

/// Correlations of the columns of the Jacobian with a smaller eigenvalue leave a combination of parameters
/// undetermined.
const UNDETERMINED: f64 = 1e-11;
/// A parameter this close to a bound, relative to their distance or to its size, is at it.
const AT_BOUND: f64 = 1e-9;

/// What the data say about the parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    /// Which bound holds a parameter, if any: −1 the lower, 1 the upper one.
    pub at_bound: Vec<i8>,
    /// Covariance of all parameters, zero for those at a bound; `None` where a combination is undetermined.
    pub covariance: Option<DMatrix<f64>>,
    /// Degrees of freedom of the noise: numbers measured less unknowns.
    pub degrees: f64,
    /// Ratio of the largest to the smallest eigenvalue of the information in units of each parameter's own.
    pub condition: f64,
    /// The combination of parameters that is determined worst, a unit vector in units of each parameter's own
    /// information.
    pub weakest: Vec<f64>,
    /// The projected gradient: the largest cosine between the residuals and a column of the Jacobian, of parameters
    /// that no bound holds.
    pub gradient_cosine: f64,
    /// The step that Newton's method would still take, in standard errors: the largest of all parameters; `None` where
    /// a combination is undetermined.
    pub remaining_step: Option<f64>,
    /// Whether the gradient pushes every parameter that is at a bound against it.
    pub bounds_hold: bool,
}

impl Uncertainty {
    /// At an estimate.
    #[must_use]
    pub fn new(experiment: &Experiment<'_>, estimate: &Estimate, noise: &Noise, bounds: &[[f64; 2]]) -> Self {
        let jacobian = &estimate.evaluation.jacobian;
        let residuals = &estimate.evaluation.residuals;
        let count = estimate.theta.len();
        let gradient = jacobian.tr_mul(residuals);
        let at_bound: Vec<i8> = estimate
            .theta
            .iter()
            .zip(bounds)
            .map(|(value, [lower, upper])| {
                let width = if (upper - lower).is_finite() { upper - lower } else { value.abs().max(1.0) };
                let near = |bound: f64| bound.is_finite() && (value - bound).abs() <= AT_BOUND * width;
                i8::from(near(*upper)) - i8::from(near(*lower))
            })
            .collect();
        let free: Vec<usize> = (0..count).filter(|i| at_bound[*i] == 0).collect();
        let lengths: Vec<f64> = jacobian.column_iter().map(|c| c.norm()).collect();
        let norm = residuals.norm().max(f64::MIN_POSITIVE);
        let gradient_cosine = free
            .iter()
            .filter(|i| lengths[**i] > 0.0)
            .map(|i| gradient[*i].abs() / (lengths[*i] * norm))
            .fold(0.0, f64::max);
        // At a lower bound the cost must rise with the parameter, at an upper bound fall.
        let slack = 1e-6 * norm;
        let bounds_hold = (0..count).all(|i| match at_bound[i] {
            -1 => gradient[i] >= -slack * lengths[i],
            1 => gradient[i] <= slack * lengths[i],
            _ => true,
        });
        let numbers = (experiment.samples() * experiment.outputs()) as f64;
        let unknowns = (free.len() + estimate.evaluation.nuisances) as f64;
        let degrees = (numbers - unknowns).max(1.0);
        let unit = |i: usize| if lengths[i] > 0.0 { lengths[i] } else { 1.0 };
        let correlation = DMatrix::from_fn(free.len(), free.len(), |i, j| {
            jacobian.column(free[i]).dot(&jacobian.column(free[j])) / (unit(free[i]) * unit(free[j]))
        });
        let (mut condition, mut weakest) = (1.0, vec![0.0; count]);
        let mut inverse = None;
        if !free.is_empty() {
            let eigen = correlation.symmetric_eigen();
            let largest = eigen.eigenvalues.max().max(f64::MIN_POSITIVE);
            let at = eigen.eigenvalues.imin();
            let smallest = eigen.eigenvalues[at];
            condition = if smallest > 0.0 { largest / smallest } else { f64::INFINITY };
            for (row, i) in free.iter().enumerate() {
                weakest[*i] = eigen.eigenvectors[(row, at)];
            }
            if smallest > UNDETERMINED * largest {
                let reciprocal = DMatrix::from_diagonal(&eigen.eigenvalues.map(f64::recip));
                inverse = Some(&eigen.eigenvectors * reciprocal * eigen.eigenvectors.transpose());
            }
        }
        // A known Σ was not estimated after the parameters.
        let enlarged = if matches!(noise, Noise::Known(_)) { 1.0 } else { numbers / degrees };
        let covariance = inverse.map(|inverse| {
            let mut covariance = DMatrix::zeros(count, count);
            for (i, row) in free.iter().enumerate() {
                for (j, column) in free.iter().enumerate() {
                    covariance[(*row, *column)] = enlarged * inverse[(i, j)] / (unit(*row) * unit(*column));
                }
            }
            covariance
        });
        let remaining_step = covariance.as_ref().map(|covariance| {
            let step = covariance * &gradient / enlarged;
            free.iter().map(|i| step[*i].abs() / covariance[(*i, *i)].sqrt()).fold(0.0, f64::max)
        });
        Self { at_bound, covariance, degrees, condition, weakest, gradient_cosine, remaining_step, bounds_hold }
    }

    /// Standard errors; zero for parameters at a bound.
    #[must_use]
    pub fn standard_errors(&self) -> Option<Vec<f64>> {
        Some(self.covariance.as_ref()?.diagonal().iter().map(|v| v.max(0.0).sqrt()).collect())
    }

    /// Half the width of an interval of this level, in standard errors.
    #[must_use]
    pub fn half_width(&self, level: f64) -> f64 {
        student_t(level, self.degrees)
    }
}
