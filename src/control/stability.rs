//! Whether all roots of a polynomial are stable, without computing them.
//!
//! All tests are strict: a root on the boundary is not stable. Where a decisive quantity is a difference whose value is no
//! larger than the rounding of its terms ([`ROUNDING`] times their sum), its sign is unknown; the polynomial is then
//! held to have a root on the boundary, so the answer is "not stable". A polynomial that is called stable by these
//! functions stays so under perturbations of the size of rounding; one within about `1e-14` (relative, of its Routh or
//! Jury entries) of the boundary is refused whichever side it is on. The functions on slices do not allocate up to degree 31.

use super::time_base::TimeBase;
use crate::num::Polynomial;

/// Rounding granted to a difference of two products, relative to the sum of their magnitudes.
pub const ROUNDING: f64 = 32.0 * f64::EPSILON;

/// Coefficients that fit on the stack; longer polynomials go to the heap.
const ON_STACK: usize = 32;

/// Whether every root λ satisfies `Re λ < −margin` (continuous time) or `|z| < e^{−margin·T}` (sampled time), strictly.
///
/// `margin` is in 1/s and may be negative. The zero polynomial is not stable; a constant that is not zero is.
#[must_use]
pub fn is_stable(polynomial: &Polynomial, time: &impl TimeBase, margin: f64) -> bool {
    match time.sample_time_s() {
        None => is_hurwitz_shifted(polynomial.coefficients(), margin),
        Some(sample_time_s) => is_schur_within(polynomial.coefficients(), (-margin * sample_time_s).exp()),
    }
}

/// Whether every root of `p[0] s^n + … + p[n]` has `Re s < 0`, strictly (Routh).
///
/// Leading zeros are skipped; the zero polynomial is not Hurwitz, and a polynomial with a NaN is not either.
#[must_use]
pub fn is_hurwitz(p: &[f64]) -> bool {
    on_scratch(p, routh)
}

/// Whether every root of `p[0] s^n + … + p[n]` has `Re s < −margin`, strictly: Routh's test of `p(s − margin)`, whose
/// coefficients come from repeated synthetic division (Taylor shift).
#[must_use]
pub fn is_hurwitz_shifted(p: &[f64], margin: f64) -> bool {
    if margin == 0.0 {
        return is_hurwitz(p);
    }
    on_scratch(p, |shifted| {
        let n = shifted.len();
        for end in (1..n).rev() {
            for i in 0..end {
                shifted[i + 1] -= margin * shifted[i];
            }
        }
        routh(shifted)
    })
}

/// Whether every root of `p[0] z^n + … + p[n]` has `|z| < radius`, strictly (Schur–Cohn recursion, the table of Jury).
///
/// `radius` must be positive; with any other there is no such polynomial but a constant.
#[must_use]
pub fn is_schur_within(p: &[f64], radius: f64) -> bool {
    on_scratch(p, |scaled| {
        // p(radius·z) has its roots in the unit disc.
        let mut power = 1.0;
        for c in scaled.iter_mut().rev() {
            *c *= power;
            power *= radius;
        }
        schur_cohn(scaled)
    })
}

/// Runs a test that overwrites its coefficients on a copy without leading zeros.
fn on_scratch(p: &[f64], test: impl FnOnce(&mut [f64]) -> bool) -> bool {
    let leading = p.iter().take_while(|c| **c == 0.0).count();
    let p = &p[leading..];
    match p.len() {
        0 => false,
        1 => p[0].is_finite(),
        n if n <= ON_STACK => {
            let mut scratch = [0.0; ON_STACK];
            scratch[..n].copy_from_slice(p);
            test(&mut scratch[..n])
        }
        _ => test(&mut p.to_vec()),
    }
}

/// Routh's test, in place: two rows of the array are interleaved as the coefficients are, and each step folds the
/// upper one into the next.
fn routh(p: &mut [f64]) -> bool {
    let n = p.len();
    // Necessary, and cheap: all coefficients of one sign, none zero.
    let sign = p[0].signum();
    if !p.iter().all(|c| c * sign > 0.0) {
        return false;
    }
    for first in 0..n - 2 {
        // Rows: upper = p[first], p[first+2], …; lower = p[first+1], p[first+3], …
        let factor = p[first] / p[first + 1];
        let mut i = first + 2;
        while i < n {
            let lower = if i + 1 < n { p[i + 1] } else { 0.0 };
            let product = factor * lower;
            let entry = p[i] - product;
            if i == first + 2 && !(entry * sign > ROUNDING * (p[i].abs() + product.abs())) {
                return false;
            }
            p[i] = entry;
            i += 2;
        }
    }
    true
}

/// The Schur–Cohn recursion, in place: while the constant coefficient is smaller than the leading one, the polynomial
/// is replaced by one of a degree less with the same count of roots in the unit disc, less one.
fn schur_cohn(p: &mut [f64]) -> bool {
    let mut n = p.len();
    while n > 1 {
        let (leading, constant) = (p[0], p[n - 1]);
        // Factored, so that the difference is rounded once.
        let gap = (leading.abs() - constant.abs()) * (leading.abs() + constant.abs());
        if !(gap > ROUNDING * leading * leading) {
            return false;
        }
        let reflection = constant / leading;
        // q[i] = p[i] − reflection·p[n−1−i], computed pairwise because both ends are overwritten.
        for i in 0..n.div_ceil(2) {
            let j = n - 1 - i;
            let (low, high) = (p[i], p[j]);
            p[i] = low - reflection * high;
            p[j] = high - reflection * low;
        }
        n -= 1;
    }
    true
}
