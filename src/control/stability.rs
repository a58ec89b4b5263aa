//! Whether all roots of a polynomial are stable, without computing them.
//!
//! All tests are strict: a root on the boundary is not stable. Every entry of the Routh or Schur–Cohn scheme carries a
//! first-order bound of its rounding error, the given coefficients themselves being taken as rounded ([`GIVEN`]). An
//! entry whose sign its bound leaves open counts as zero: such a polynomial has a root on the boundary to working
//! precision, and the answer is "not stable". So ties on decimal grids are decided the same way every time, and what is
//! called stable stays so when its coefficients are rounded. The functions on slices do not allocate up to degree 31.

use super::time_base::TimeBase;
use crate::num::Polynomial;

/// Relative error of a coefficient as given: one that was computed from decimals by a product or two.
pub(crate) const GIVEN: f64 = 4.0 * f64::EPSILON;

/// Coefficients that fit on the stack; longer polynomials go to the heap.
const ON_STACK: usize = 32;

/// Coefficients of the usual candidates, whose scratch space is quicker to clear.
const FEW: usize = 9;

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
pub(crate) fn is_hurwitz(p: &[f64]) -> bool {
    on_scratch(p, routh)
}

/// Whether every root of `p[0] s^n + … + p[n]` has `Re s < −margin`, strictly: Routh's test of `p(s − margin)`, whose
/// coefficients come from repeated synthetic division (Taylor shift).
#[must_use]
pub fn is_hurwitz_shifted(p: &[f64], margin: f64) -> bool {
    if margin == 0.0 {
        return is_hurwitz(p);
    }
    on_scratch(p, |shifted, errors| {
        let n = shifted.len();
        for end in (1..n).rev() {
            for i in 0..end {
                let product = margin * shifted[i];
                errors[i + 1] += margin.abs() * errors[i] + f64::EPSILON * (product.abs() + shifted[i + 1].abs());
                shifted[i + 1] -= product;
            }
        }
        routh(shifted, errors)
    })
}

/// Whether every root of `p[0] z^n + … + p[n]` has `|z| < radius`, strictly (Schur–Cohn recursion, the table of Jury).
///
/// Leading zeros are skipped; the zero polynomial is not stable. `radius` must be positive: with any other, only
/// constants are.
#[must_use]
pub fn is_schur_within(p: &[f64], radius: f64) -> bool {
    on_scratch(p, |scaled, errors| {
        if !radius.is_normal() || radius < 0.0 {
            return false;
        }
        // p(radius·z) has its roots in the unit disc; divided by the power at the leading end, so nothing overflows
        // early.
        if radius != 1.0 {
            let mut power = 1.0;
            for (steps, (c, e)) in scaled.iter_mut().zip(errors.iter_mut()).enumerate() {
                *c *= power;
                *e = *e * power + f64::EPSILON * (steps + 1) as f64 * c.abs();
                power /= radius;
            }
        }
        schur_cohn(scaled, errors)
    })
}

/// [`is_schur_within`] for coefficients that were computed: `errors` bounds what rounding did to each of them. A
/// polynomial that any polynomial within these bounds could turn into one with a root on or outside the circle counts,
/// to first order, as not stable.
///
/// The degree is that of the slice: a leading coefficient that its error leaves open is not stable either.
///
/// # Panics
/// If the lengths differ, which is a mistake of the caller.
#[must_use]
pub(crate) fn is_schur_within_errors(p: &[f64], errors: &[f64], radius: f64) -> bool {
    assert_eq!(p.len(), errors.len(), "an error for every coefficient");
    if p.is_empty() || !radius.is_normal() || radius < 0.0 {
        return false;
    }
    let run = |values: &mut [f64], bounds: &mut [f64]| {
        let mut power = 1.0;
        for (steps, ((v, b), (c, e))) in values.iter_mut().zip(bounds.iter_mut()).zip(p.iter().zip(errors)).enumerate()
        {
            *v = c * power;
            *b = e * power + f64::EPSILON * steps as f64 * v.abs();
            power /= radius;
        }
        // A NaN must not pass.
        let is_clear = values[0].abs() > bounds[0] && values.iter().all(|v| v.is_finite());
        is_clear && schur_cohn(values, bounds)
    };
    match p.len() {
        n if n <= FEW => run(&mut [0.0; FEW][..n], &mut [0.0; FEW][..n]),
        n if n <= ON_STACK => run(&mut [0.0; ON_STACK][..n], &mut [0.0; ON_STACK][..n]),
        n => run(&mut vec![0.0; n], &mut vec![0.0; n]),
    }
}

/// Runs a test that overwrites its coefficients and their error bounds, on copies without leading zeros.
fn on_scratch(p: &[f64], test: impl FnOnce(&mut [f64], &mut [f64]) -> bool) -> bool {
    fn run(
        p: &[f64],
        values: &mut [f64],
        errors: &mut [f64],
        test: impl FnOnce(&mut [f64], &mut [f64]) -> bool,
    ) -> bool {
        values.copy_from_slice(p);
        for (e, c) in errors.iter_mut().zip(p) {
            *e = GIVEN * c.abs();
        }
        test(values, errors)
    }
    let leading = p.iter().take_while(|c| **c == 0.0).count();
    let p = &p[leading..];
    match p.len() {
        0 => false,
        1 => p[0].is_finite(),
        n if n <= FEW => run(p, &mut [0.0; FEW][..n], &mut [0.0; FEW][..n], test),
        n if n <= ON_STACK => run(p, &mut [0.0; ON_STACK][..n], &mut [0.0; ON_STACK][..n], test),
        n => run(p, &mut vec![0.0; n], &mut vec![0.0; n], test),
    }
}

/// Routh's test, in place: two rows of the array are interleaved as the coefficients are, and each step folds the
/// upper one into the row after next. All entries of the first column must have one sign.
fn routh(p: &mut [f64], errors: &mut [f64]) -> bool {
    let n = p.len();
    let sign = p[0].signum();
    // Necessary, and cheap: all coefficients of one sign, none zero.
    if !p.iter().zip(errors.iter()).all(|(c, e)| c * sign > *e) {
        return false;
    }
    for first in 0..n - 2 {
        // Rows: upper = p[first], p[first+2], …; lower = p[first+1], p[first+3], …
        let factor = p[first] / p[first + 1];
        let factor_error = (errors[first] + factor.abs() * errors[first + 1]) / p[first + 1].abs();
        let mut i = first + 2;
        while i + 1 < n {
            let product = factor * p[i + 1];
            errors[i] += factor.abs() * errors[i + 1]
                + factor_error * p[i + 1].abs()
                + f64::EPSILON * (p[i].abs() + 2.0 * product.abs());
            p[i] -= product;
            i += 2;
        }
        // A NaN must not pass.
        let is_clear = p[first + 2] * sign > errors[first + 2];
        if !is_clear {
            return false;
        }
    }
    true
}

/// The Schur–Cohn recursion, in place: while the constant coefficient is smaller than the leading one, the polynomial
/// is replaced by one of a degree less with the same count of roots in the unit disc, less one.
fn schur_cohn(p: &mut [f64], errors: &mut [f64]) -> bool {
    let mut n = p.len();
    while n > 1 {
        let (leading, constant) = (p[0], p[n - 1]);
        // A NaN must not pass.
        let is_clear = leading.abs() - constant.abs() > errors[0] + errors[n - 1];
        if !is_clear {
            return false;
        }
        let reflection = constant / leading;
        let reflection_error = (errors[n - 1] + reflection.abs() * errors[0]) / leading.abs();
        let fold = |own: f64, own_error: f64, other: f64, other_error: f64| {
            let product = reflection * other;
            let error = own_error
                + reflection.abs() * other_error
                + reflection_error * other.abs()
                + f64::EPSILON * (own.abs() + 2.0 * product.abs());
            (own - product, error)
        };
        // q[i] = p[i] − reflection·p[n−1−i], both ends at once because both are overwritten.
        for i in 0..n.div_ceil(2) {
            let j = n - 1 - i;
            let ((low, low_error), (high, high_error)) = ((p[i], errors[i]), (p[j], errors[j]));
            (p[i], errors[i]) = fold(low, low_error, high, high_error);
            (p[j], errors[j]) = fold(high, high_error, low, low_error);
        }
        n -= 1;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_root_on_the_boundary_is_not_stable() {
        assert!(!is_hurwitz(&[1.0, 0.0, 1.0]));
        assert!(!is_hurwitz(&[1.0, 1.0, 1.0, 1.0]), "s³ + s² + s + 1 = (s² + 1)(s + 1)");
        assert!(!is_hurwitz(&[1.0, 1.0, 0.0]));
        assert!(!is_schur_within(&[1.0, -1.0], 1.0));
        assert!(!is_schur_within(&[1.0, 0.0, 1.0], 1.0));
    }

    #[test]
    fn ties_on_decimal_grids_are_ties() {
        // (s + 0.1 i)(s + 0.1 j) with the margin on the slower root, whatever way the decimals were rounded.
        for i in 1..40 {
            for j in 1..40 {
                let (a, b) = (0.1 * f64::from(i), 0.1 * f64::from(j));
                let slower = a.min(b);
                let p = [1.0, a + b, a * b];
                assert!(!is_hurwitz_shifted(&p, slower), "{i} {j}");
                assert!(is_hurwitz_shifted(&p, slower - 1e-6), "{i} {j}");
                assert!(!is_hurwitz_shifted(&p, slower + 1e-6), "{i} {j}");
            }
        }
    }

    #[test]
    fn an_oscillator_with_decimal_coefficients_is_on_the_boundary() {
        // (s + a)(s² + w²): the Routh entry is a w² − a w², in decimals that do not cancel exactly.
        for i in 1..60 {
            for j in 1..60 {
                let (a, w2) = (0.1 * f64::from(i), 0.7 * f64::from(j));
                assert!(!is_hurwitz(&[1.0, a, w2, a * w2]), "{i} {j}");
                assert!(is_hurwitz(&[1.0, a * (1.0 + 1e-9), w2, a * w2]), "{i} {j}");
            }
        }
    }

    #[test]
    fn signs_constants_and_leading_zeros() {
        assert!(is_hurwitz(&[-1.0, -3.0, -2.0]));
        assert!(is_hurwitz(&[0.0, 0.0, 1.0, 3.0]));
        assert!(is_hurwitz(&[5.0]) && is_schur_within(&[5.0], 0.5));
        assert!(!is_hurwitz(&[]) && !is_hurwitz(&[0.0]) && !is_schur_within(&[0.0, 0.0], 1.0));
        assert!(!is_hurwitz(&[1.0, f64::NAN, 1.0]) && !is_schur_within(&[1.0, f64::NAN], 1.0));
        assert!(!is_schur_within(&[1.0, 0.1], 0.0) && !is_schur_within(&[1.0, 0.1], -1.0));
        assert!(!is_hurwitz(&[1.0, f64::INFINITY, 1.0]) && !is_hurwitz(&[f64::NAN]));
    }

    #[test]
    fn the_radius_bounds_the_roots() {
        // z² − 0.81: roots ±0.9.
        assert!(is_schur_within(&[1.0, 0.0, -0.81], 0.9 + 1e-9));
        assert!(!is_schur_within(&[1.0, 0.0, -0.81], 0.9));
        assert!(!is_schur_within(&[1.0, 0.0, -0.81], 0.9 - 1e-9));
    }

    #[test]
    fn errors_of_coefficients_decide_what_is_open() {
        // (z − 0.5)(z − 0.99), its constant coefficient off by up to e.
        let p = [1.0, -1.49, 0.495];
        assert!(is_schur_within_errors(&p, &[0.0, 0.0, 1e-3], 1.0));
        assert!(!is_schur_within_errors(&p, &[0.0, 0.0, 1e-2], 1.0));
        assert!(is_schur_within_errors(&p, &[0.0; 3], 0.991) && !is_schur_within_errors(&p, &[0.0; 3], 0.989));
        assert!(!is_schur_within_errors(&[1e-17, 1.0, 0.5], &[1e-16, 0.0, 0.0], 1.0), "the degree is open");
        assert!(!is_schur_within_errors(&[], &[], 1.0) && is_schur_within_errors(&[2.0], &[0.1], 1.0));
        assert!(!is_schur_within_errors(&[1.0, f64::NAN], &[0.0; 2], 1.0));
    }

    #[test]
    fn long_polynomials_go_to_the_heap_with_the_same_answer() {
        // z^40 − 0.3: roots on a circle of radius 0.3^(1/40).
        let mut p = vec![0.0; 41];
        (p[0], p[40]) = (1.0, -0.3);
        let radius = 0.3_f64.powf(1.0 / 40.0);
        assert!(is_schur_within(&p, 1.0) && is_schur_within(&p, radius + 1e-6));
        assert!(!is_schur_within(&p, radius - 1e-6));
        let outside = Polynomial::new(p).mul(&Polynomial::new(vec![1.0, 1.1]));
        assert!(!is_schur_within(outside.coefficients(), 1.0));
    }
}
