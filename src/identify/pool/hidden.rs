//! Modes of a plant that its output does not show or its input does not move.

use super::recipe::PoolError;
use crate::identify::time::{Region, Time};
use crate::num::Polynomial;
use num_complex::Complex64;

/// A polynomial vanishes at a root if it is below this share of `Σ |cᵢ| |x|ⁱ` there, which is what the rounding of its
/// coefficients makes of a root that is there.
const VANISHES: f64 = 1e-12;

/// Roots of the denominator that the numerator shares, on or beyond the boundary of the region, each once and of a pair
/// the one with the positive imaginary part.
///
/// `Dp Dfb + Np Nfb` vanishes at a common root of Np and Dp whatever the feedback is.
///
/// # Errors
/// [`PoolError::NoConvergence`] where the roots are not found.
pub(super) fn hidden_modes(num: &Polynomial, den: &Polynomial, region: Region) -> Result<Vec<Complex64>, PoolError> {
    let is_beyond = |root: &Complex64| match region.time {
        Time::Continuous => root.re >= -region.margin,
        Time::Sampled(time) => root.norm() >= (-region.margin * time.period_s()).exp(),
    };
    // Roots at zero are counted by the coefficients that vanish: no iteration finds them better.
    let zeros = |p: &Polynomial| p.coefficients().iter().rev().take_while(|c| **c == 0.0).count();
    let mut modes: Vec<Complex64> = Vec::new();
    let origin = Complex64::new(0.0, 0.0);
    if zeros(num) > 0 && zeros(den) > 0 && is_beyond(&origin) {
        modes.push(origin);
    }
    let without = |p: &Polynomial| {
        let c = p.coefficients();
        c[..c.len() - zeros(p)].to_vec()
    };
    let (num, den) = (without(num), without(den));
    let roots = Polynomial::new(den).roots().map_err(PoolError::NoConvergence)?;
    for root in roots.into_iter().filter(|root| root.im >= 0.0 && is_beyond(root)) {
        let known = modes.iter().any(|mode| (mode - root).norm() <= 1e-6 * root.norm());
        if !known && vanishes(&num, root) {
            modes.push(root);
        }
    }
    Ok(modes)
}

fn vanishes(descending: &[f64], x: Complex64) -> bool {
    let value = descending.iter().fold(Complex64::new(0.0, 0.0), |sum, c| sum * x + c);
    let size = descending.iter().fold(0.0, |sum, c| sum * x.norm() + c.abs());
    value.norm() <= VANISHES * size
}
