//! The covariance of the noise, which the likelihood is concentrated by.

use crate::num::linalg::symmetric;
use nalgebra::DMatrix;

/// What is known of Σ, p×p.
#[derive(Debug, Clone, PartialEq)]
pub enum Noise {
    /// Nothing: any covariance.
    Full,
    /// The outputs' noises are independent of each other.
    Diagonal,
    /// They have one variance besides.
    Scalar,
    /// Everything.
    Known(DMatrix<f64>),
}

/// A standard deviation of the noise below this share of an output's root mean square is taken for rounding.
pub(super) const FLOOR: f64 = 1e-9;

impl Noise {
    /// Σ̂ from the scatter `S = Σ_k e_k e_kᵀ` of so many samples, with the floor of rounding added.
    #[must_use]
    pub fn covariance(&self, scatter: &DMatrix<f64>, samples: usize, sizes: &[f64]) -> DMatrix<f64> {
        let p = scatter.nrows();
        let mean = scatter / samples as f64;
        let mut covariance = match self {
            Self::Full => symmetric(&mean),
            Self::Diagonal => DMatrix::from_diagonal(&mean.diagonal()),
            Self::Scalar => DMatrix::identity(p, p) * (mean.trace() / p as f64),
            Self::Known(covariance) => return covariance.clone(),
        };
        let largest = sizes.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        for (i, size) in sizes.iter().enumerate() {
            // An output that is always zero has no size of its own.
            let floor = FLOOR * size.max(1e-6 * largest);
            covariance[(i, i)] += floor * floor;
        }
        covariance
    }

    /// Twice the negative logarithm of the concentrated likelihood, without its constant: `N log det Σ̂ + N p`, with a
    /// known Σ `N log det Σ + tr(Σ⁻¹S)`.
    #[must_use]
    pub fn deviance(&self, scatter: &DMatrix<f64>, samples: usize, sizes: &[f64]) -> f64 {
        let covariance = self.covariance(scatter, samples, sizes);
        let Some(factor) = covariance.cholesky() else { return f64::INFINITY };
        let log_det = 2.0 * factor.l().diagonal().iter().map(|v| v.ln()).sum::<f64>();
        samples as f64 * log_det + factor.solve(scatter).trace()
    }

    /// `Σ̂^{−1/2}` as the inverse of its lower Cholesky factor; `None` where Σ̂ is not positive definite.
    #[must_use]
    pub fn whitening(covariance: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let p = covariance.nrows();
        covariance.clone().cholesky()?.l().solve_lower_triangular(&DMatrix::identity(p, p))
    }

    /// Whether the fit leaves nothing but rounding.
    #[must_use]
    pub fn is_rounding(scatter: &DMatrix<f64>, samples: usize, sizes: &[f64]) -> bool {
        let largest = sizes.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        sizes
            .iter()
            .enumerate()
            .all(|(i, size)| (scatter[(i, i)] / samples as f64).sqrt() <= 3.0 * FLOOR * size.max(1e-6 * largest))
    }
}
