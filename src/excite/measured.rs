//! A plant from its measured frequency response.
//!
//! `P(s) = e^{−τs} B(s)/(s^q A(s))` with the delay τ and the integrators q given, and B and A fitted: the iteration of
//! Sanathanan and Koerner (IEEE Trans. Automatic Control 8, 1963) minimises `Σ |B(jω) − H' A(jω)|²/(|A₋(jω)|² |H'|²)`
//! with `H' = H e^{jωτ} (jω)^q` and A₋ of the round before, so that relative errors count alike at every line.

use crate::control::{Continuous, TransferFunction, stability};
use crate::num::Complex64;
use crate::num::linalg::least_squares;
use nalgebra::{DMatrix, DVector};

/// Rounds of the iteration.
const ROUNDS: usize = 40;
/// A change of the coefficients below this ends it.
const SETTLED: f64 = 1e-12;

/// A measured response, and what is asked of its model.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured<'a> {
    /// Angular frequencies, rad/s, increasing.
    pub omega_rad_s: &'a [f64],
    /// The response there.
    pub response: &'a [Complex64],
    /// Poles in all, integrators included.
    pub poles: usize,
    /// Zeros, fewer than poles.
    pub zeros: usize,
    /// Poles at the origin, at most as many as poles.
    pub integrators: usize,
    /// τ, s.
    pub delay_s: f64,
}

/// The model.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedPlant {
    /// Without the delay.
    pub plant: TransferFunction<Continuous>,
    /// `|H − P|/|P|` at every line.
    pub misfit: Vec<f64>,
}

/// Why there is no model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum MeasuredError {
    /// The lines do not determine so many coefficients.
    #[error("{lines} lines do not determine the {unknowns} coefficients of the model")]
    Undetermined {
        /// Lines.
        lines: usize,
        /// Coefficients.
        unknowns: usize,
    },
    /// A pole in the right half plane.
    #[error(
        "the model that fits best has a pole in the right half plane, which the data of a stable plant do not ask for"
    )]
    Unstable,
}

/// Fits the model.
///
/// # Errors
/// [`MeasuredError`].
///
/// # Panics
/// If frequencies and responses differ in number, which is a mistake of the caller.
pub fn fit(measured: &Measured<'_>) -> Result<FittedPlant, MeasuredError> {
    let (omegas, response) = (measured.omega_rad_s, measured.response);
    assert_eq!(omegas.len(), response.len(), "a response at every frequency");
    let own = measured.poles.saturating_sub(measured.integrators);
    let unknowns = own + measured.zeros + 1;
    let undetermined = MeasuredError::Undetermined { lines: omegas.len(), unknowns };
    if 2 * omegas.len() < unknowns + 2 {
        return Err(undetermined);
    }
    // In units of the middle frequency, so that powers stay of one size.
    let unit = (omegas.iter().map(|w| w.ln()).sum::<f64>() / omegas.len() as f64).exp();
    let points: Vec<Complex64> = omegas.iter().map(|w| Complex64::new(0.0, w / unit)).collect();
    let wanted: Vec<Complex64> = points
        .iter()
        .zip(omegas.iter().zip(response))
        .map(|(s, (w, h))| h * Complex64::from_polar(1.0, w * measured.delay_s) * s.powu(measured.integrators as u32))
        .collect();
    let mut before = vec![Complex64::new(1.0, 0.0); omegas.len()];
    let mut found = DVector::zeros(unknowns);
    for _ in 0..ROUNDS {
        let mut matrix = DMatrix::zeros(2 * omegas.len(), unknowns);
        let mut right = DVector::zeros(2 * omegas.len());
        for (i, ((s, h), a)) in points.iter().zip(&wanted).zip(&before).enumerate() {
            let weight = (a.norm() * h.norm()).max(f64::MIN_POSITIVE).recip();
            let mut put = |j: usize, value: Complex64| {
                matrix[(2 * i, j)] = weight * value.re;
                matrix[(2 * i + 1, j)] = weight * value.im;
            };
            for j in 0..own {
                put(j, -h * s.powu(j as u32));
            }
            for j in 0..=measured.zeros {
                put(own + j, s.powu(j as u32));
            }
            let leading = h * s.powu(own as u32) * weight;
            (right[2 * i], right[2 * i + 1]) = (leading.re, leading.im);
        }
        let Some((next, _)) = least_squares(&matrix, &right) else { return Err(undetermined) };
        let change = (&next - &found).norm();
        let size = next.norm();
        found = next;
        let below =
            |s: &Complex64| (0..own).map(|j| found[j] * s.powu(j as u32)).sum::<Complex64>() + s.powu(own as u32);
        before = points.iter().map(below).collect();
        if change <= SETTLED * size {
            break;
        }
    }
    // Back from s/ω₀ to s, descending.
    let descending = |of: &dyn Fn(usize) -> f64, degree: usize| -> Vec<f64> {
        (0..=degree).rev().map(|j| of(j) * unit.powi(-(j as i32))).collect()
    };
    let mut den = descending(&|j| if j == own { 1.0 } else { found[j] }, own);
    if !stability::is_stable(&crate::num::Polynomial::new(den.clone()), &Continuous, 0.0) {
        return Err(MeasuredError::Unstable);
    }
    let scale = unit.powi(-(measured.integrators as i32));
    den.iter_mut().for_each(|c| *c *= scale);
    den.extend(vec![0.0; measured.integrators]);
    let num = descending(&|j| found[own + j], measured.zeros);
    let plant = TransferFunction::new(&num, &den, Continuous).map_err(|_| undetermined)?;
    let misfit = omegas
        .iter()
        .zip(response)
        .map(|(w, h)| {
            let model = plant.response(*w) * Complex64::from_polar(1.0, -w * measured.delay_s);
            ((h - model) / model).norm()
        })
        .collect();
    Ok(FittedPlant { plant, misfit })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plant_is_found_from_its_response() {
        // 3 (s + 40)/(s (2 s² + 6 s + 800)) with a delay, and a linear drive.
        let drive = TransferFunction::new(&[1.0], &[10.0, 50.0, 0.0], Continuous).unwrap();
        let resonant = TransferFunction::new(&[3.0, 120.0], &[2.0, 6.0, 800.0, 0.0], Continuous).unwrap();
        for (plant, poles, zeros, delay_s) in [(drive, 2, 0, 0.0), (resonant, 3, 1, 0.012)] {
            let omegas: Vec<f64> = (1..60).map(|k| 0.9 * f64::from(k)).collect();
            let response: Vec<Complex64> =
                omegas.iter().map(|w| plant.response(*w) * Complex64::from_polar(1.0, -w * delay_s)).collect();
            let measured =
                Measured { omega_rad_s: &omegas, response: &response, poles, zeros, integrators: 1, delay_s };
            let found = fit(&measured).unwrap();
            assert!(found.misfit.iter().all(|m| *m < 1e-9), "{:?}", found.misfit);
            for w in [0.3, 20.0, 90.0] {
                assert!((found.plant.response(w) / plant.response(w) - 1.0).norm() < 1e-7, "{w}");
            }
            let few = Measured { omega_rad_s: &omegas[..1], response: &response[..1], ..measured };
            assert!(matches!(fit(&few), Err(MeasuredError::Undetermined { lines: 1, .. })));
        }
    }
}
