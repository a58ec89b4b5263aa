//! Few parameters in place of many: `(b₀ + b₁ s + …)/(1 + a₁ s + …) e^{−τs}` near a response at some lines.
//!
//! Least squares on `B − h A`, weighted by the denominator of the round before (Sanathanan and Koerner, *IEEE Trans.
//! Automatic Control* 8, 1963), for each delay of a list. What is smaller is not truer: the relative misfit comes with
//! it.

use crate::control::stability::is_hurwitz;
use crate::num::linalg::least_squares;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

/// Rounds of the weights.
const ROUNDS: usize = 12;

/// A rational function with a delay.
#[derive(Debug, Clone, PartialEq)]
pub struct Reduction {
    /// Numerator in descending powers of s.
    pub num: Vec<f64>,
    /// Denominator likewise.
    pub den: Vec<f64>,
    /// The delay in seconds.
    pub delay_s: f64,
    /// Root mean square of its difference from the response, over that of the response.
    pub misfit: f64,
}

/// The stable rational function nearest to a response over the delays given; `None` where none is found.
#[must_use]
pub fn reduce(
    omega_rad_s: &[f64],
    response: &[Complex64],
    [numerator, denominator]: [usize; 2],
    delays_s: &[f64],
) -> Option<Reduction> {
    let scale = omega_rad_s.iter().copied().fold(0.0, f64::max);
    if omega_rad_s.len() * 2 < numerator + denominator + 2 || scale <= 0.0 {
        return None;
    }
    delays_s
        .iter()
        .filter_map(|delay| at_delay(omega_rad_s, response, [numerator, denominator], *delay, scale))
        .min_by(|a, b| a.misfit.total_cmp(&b.misfit))
}

fn at_delay(
    omega: &[f64],
    response: &[Complex64],
    [numerator, denominator]: [usize; 2],
    delay_s: f64,
    scale: f64,
) -> Option<Reduction> {
    let s: Vec<Complex64> = omega.iter().map(|w| Complex64::new(0.0, w / scale)).collect();
    let h: Vec<Complex64> =
        response.iter().zip(omega).map(|(h, w)| h * Complex64::from_polar(1.0, w * delay_s)).collect();
    let unknowns = numerator + 1 + denominator;
    let mut x = DVector::zeros(unknowns);
    let at = |x: &DVector<f64>, s: Complex64| -> [Complex64; 2] {
        let b = (0..=numerator).map(|k| x[k] * s.powu(k as u32)).sum();
        let a =
            Complex64::from(1.0) + (1..=denominator).map(|k| x[numerator + k] * s.powu(k as u32)).sum::<Complex64>();
        [b, a]
    };
    let misfit = |x: &DVector<f64>| -> f64 {
        let missed: f64 = s
            .iter()
            .zip(&h)
            .map(|(s, h)| {
                let [b, a] = at(x, *s);
                (b / a - h).norm_sqr()
            })
            .sum();
        (missed / h.iter().map(|h| h.norm_sqr()).sum::<f64>()).sqrt()
    };
    let mut best: Option<(f64, DVector<f64>)> = None;
    for _ in 0..ROUNDS {
        let mut rows = DMatrix::zeros(2 * s.len(), unknowns);
        let mut target = DVector::zeros(2 * s.len());
        for (i, (s, h)) in s.iter().zip(&h).enumerate() {
            let weight = 1.0 / at(&x, *s)[1].norm().max(1e-6);
            for k in 0..unknowns {
                let value = if k <= numerator { s.powu(k as u32) } else { -h * s.powu((k - numerator) as u32) };
                rows[(2 * i, k)] = weight * value.re;
                rows[(2 * i + 1, k)] = weight * value.im;
            }
            target[2 * i] = weight * h.re;
            target[2 * i + 1] = weight * h.im;
        }
        x = least_squares(&rows, &target)?.0;
        let found = misfit(&x);
        let den: Vec<f64> = (0..=denominator).rev().map(|k| if k == 0 { 1.0 } else { x[numerator + k] }).collect();
        let is_stable = denominator == 0 || is_hurwitz(&den);
        if is_stable && found.is_finite() && best.as_ref().is_none_or(|(least, _)| found < *least) {
            best = Some((found, x.clone()));
        }
    }
    let (misfit, x) = best?;
    let num = (0..=numerator).rev().map(|k| x[k] / scale.powi(k as i32)).collect();
    let den =
        (0..=denominator).rev().map(|k| if k == 0 { 1.0 } else { x[numerator + k] / scale.powi(k as i32) }).collect();
    Some(Reduction { num, den, delay_s, misfit })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lag_with_a_delay_is_found_again() {
        let omega: Vec<f64> = (1..=30).map(|k| 0.1 * f64::from(k)).collect();
        let truth = |w: f64| {
            let s = Complex64::new(0.0, w);
            1.3 * (1.0 + 0.4 * s) / (1.0 + 0.9 * s) * (-0.2 * s).exp()
        };
        let response: Vec<Complex64> = omega.iter().map(|w| truth(*w)).collect();
        let delays: Vec<f64> = (8..=34).map(|k| 0.01 * f64::from(k)).collect();
        let found = reduce(&omega, &response, [1, 1], &delays).unwrap();
        assert!(found.misfit < 1e-9 && (found.delay_s - 0.2).abs() < 1e-12, "{found:?}");
        for (x, y) in found.num.iter().zip([0.52, 1.3]).chain(found.den.iter().zip([0.9, 1.0])) {
            assert!((x - y).abs() < 1e-8, "{found:?}");
        }
        // A constant cannot be it, and says so.
        assert!(reduce(&omega, &response, [0, 0], &[0.0]).unwrap().misfit > 0.3);
    }
}
