//! A stable, realisable approximation of a plant's inverse dynamics.

use crate::control::{Continuous, TransferFunction};
use crate::num::Polynomial;
use crate::num::linalg::NoConvergence;
use num_complex::Complex64;

/// Zeros closer to the imaginary axis than this fraction of their magnitude have no useful mirror image.
const AXIS_MARGIN: f64 = 1e-3;

/// A plant without a stable approximate inverse of this kind.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InverseError {
    /// A zero on the imaginary axis: the plant blocks that frequency, whatever the control.
    #[error("the plant has a zero on the imaginary axis, at {re} + {im}j")]
    ZeroOnAxis {
        /// Real part of the zero.
        re: f64,
        /// Imaginary part.
        im: f64,
    },
    /// The transfer function is zero.
    #[error("the plant answers nothing")]
    ZeroPlant,
    /// The zeros could not be found.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
}

/// `F(s) = D(s) / (N⁻(s) (τs + 1)^ρ)` for a plant `N/D` of relative degree ρ, where N⁻ is N with its zeros of positive
/// real part mirrored into the left half plane.
#[derive(Debug, Clone, PartialEq)]
pub struct ApproximateInverse {
    /// F: stable, and proper (with as many zeros as poles where ρ ≥ 0).
    pub filter: TransferFunction<Continuous>,
    /// The zeros that were mirrored; none for a minimum-phase plant.
    pub mirrored: Vec<Complex64>,
    /// Delay of the smoothing `(τs + 1)^−ρ` at low frequency, s.
    pub smoothing_delay_s: f64,
}

impl ApproximateInverse {
    /// The approximate inverse of `plant`, smoothed with the time constant τ = `smoothing_s` (positive).
    ///
    /// `G F` is then 1/(τs + 1)^ρ times the all-pass `∏ (z − s)/(z̄ + s)` over the mirrored zeros z, whose gain is 1.
    ///
    /// # Errors
    /// [`InverseError`].
    pub fn new(plant: &TransferFunction<Continuous>, smoothing_s: f64) -> Result<Self, InverseError> {
        if plant.num().is_zero() {
            return Err(InverseError::ZeroPlant);
        }
        let zeros = plant.zeros()?;
        if let Some(z) = zeros.iter().find(|z| z.re.abs() <= AXIS_MARGIN * z.norm()) {
            return Err(InverseError::ZeroOnAxis { re: z.re, im: z.im });
        }
        let mirrored: Vec<Complex64> = zeros.iter().copied().filter(|z| z.re > 0.0).collect();
        // (s − z) becomes −(s + z̄), which has the same value at s = 0 up to the phase that conjugate pairs cancel.
        let num = if mirrored.is_empty() {
            plant.num().clone()
        } else {
            let reflected: Vec<Complex64> =
                zeros.iter().map(|z| if z.re > 0.0 { Complex64::new(-z.re, z.im) } else { *z }).collect();
            let sign = if mirrored.len().is_multiple_of(2) { 1.0 } else { -1.0 };
            Polynomial::from_roots(&reflected).scale(sign * plant.num().leading())
        };
        let order = usize::try_from(plant.relative_degree()).unwrap_or(0);
        let smoothing = Polynomial::new(vec![smoothing_s, 1.0]);
        let den = (0..order).fold(num, |den, _| den.mul(&smoothing));
        let filter = TransferFunction::new(plant.den().coefficients(), den.coefficients(), Continuous)
            .map_err(|_| InverseError::ZeroPlant)?;
        Ok(Self { filter, mirrored, smoothing_delay_s: order as f64 * smoothing_s })
    }

    /// The phase delay of the all-pass `∏ (z − s)/(z̄ + s)` at the angular frequency `omega_rad_s`, in seconds: what a
    /// preview must make up for there.
    #[must_use]
    pub fn all_pass_delay_s(&self, omega_rad_s: f64) -> f64 {
        let s = Complex64::new(0.0, omega_rad_s);
        // Each factor turns from 0 (or the phase that its conjugate takes back) towards −π.
        self.mirrored.iter().map(|z| -((z - s) / (z.conj() + s)).arg() / omega_rad_s).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plants::catalogue;

    #[test]
    fn plant_times_inverse_is_smoothing_times_an_all_pass() {
        for (plant, zero) in [
            (catalogue::two_mass(), None),
            (catalogue::minimum_phase(), None),
            (catalogue::integrator(), None),
            (catalogue::nonminimum_phase(), Some(2.2)),
            (catalogue::slow_nonminimum_phase(), Some(0.8)),
        ] {
            let inverse = ApproximateInverse::new(&plant, 0.1).unwrap();
            assert!(inverse.filter.poles().unwrap().iter().all(|p| p.re < 0.0));
            assert!(inverse.filter.relative_degree() >= 0);
            let order = plant.relative_degree() as i32;
            for omega in [0.1, 1.0, 3.0, 10.0] {
                let s = Complex64::new(0.0, omega);
                let all_pass = zero.map_or(Complex64::new(1.0, 0.0), |z| (z - s) / (z + s));
                let expected = all_pass / (0.1 * s + 1.0).powi(order);
                let product = plant.response(omega) * inverse.filter.response(omega);
                assert!((product - expected).norm() < 1e-12, "{omega}: {product} {expected}");
                if let Some(z) = zero {
                    let delay = 2.0 * (omega / z).atan() / omega;
                    assert!((inverse.all_pass_delay_s(omega) - delay).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn a_pair_of_nonminimum_phase_zeros_is_mirrored() {
        // Zeros 1 ± 2j.
        let plant = TransferFunction::new(&[3.0, -6.0, 15.0], &[1.0, 4.0, 6.0, 4.0], Continuous).unwrap();
        let inverse = ApproximateInverse::new(&plant, 0.05).unwrap();
        assert!(inverse.filter.poles().unwrap().iter().all(|p| p.re < 0.0));
        let smoothing = Complex64::new(1.0, 0.05 * 2.0);
        let product = plant.response(2.0) * inverse.filter.response(2.0) * smoothing;
        assert!((product.norm() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_zero_on_the_axis_is_refused() {
        let plant = TransferFunction::new(&[1.0, 0.0, 4.0], &[1.0, 2.0, 1.0], Continuous).unwrap();
        assert!(matches!(ApproximateInverse::new(&plant, 0.1), Err(InverseError::ZeroOnAxis { .. })));
    }
}
