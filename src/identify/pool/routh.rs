//! Routh's criterion on several gains at once.

/// The largest degree of a closed-loop polynomial.
pub const LARGEST_DEGREE: usize = 24;

/// Gains tested together.
const LANES: usize = 8;

/// An entry of the first column counts as positive above this share of the coefficient that it was computed from.
///
/// On the boundary of the region an entry is zero in exact arithmetic and some units in the last place in floating
/// point, of either sign. The boundary does not belong to the region, so rounding must not let it in.
pub(super) const POSITIVE: f64 = 1e-12;

/// Whether a polynomial (descending powers) has all of its roots in the open left half plane; see [`stable_gains`].
pub(super) fn stable(polynomial: &[f64]) -> bool {
    let mut found = false;
    stable_gains(polynomial, &vec![0.0; polynomial.len()], &[0.0], |_| found = true);
    found
}

/// Calls `visit` with the position of each gain g for which `base + g·step` has all of its roots in the open left half
/// plane, in order.
///
/// Both polynomials have descending powers and the same length; a vanishing leading coefficient (a root at infinity)
/// counts as outside. The sign of the whole polynomial does not matter.
pub(super) fn stable_gains(base: &[f64], step: &[f64], gains: &[f64], visit: impl FnMut(usize)) {
    // Small degrees with loops that the compiler can unroll; a closed loop of two second-order systems has degree 4.
    let arch = pulp::Arch::new();
    macro_rules! with {
        ($length:literal) => {
            arch.dispatch(
                #[inline(always)]
                || tested::<$length>($length, base, step, gains, visit),
            )
        };
    }
    match base.len() {
        1 => with!(1),
        2 => with!(2),
        3 => with!(3),
        4 => with!(4),
        5 => arch.dispatch(
            #[inline(always)]
            || quartic(base, step, gains, visit),
        ),
        6 => with!(6),
        7 => with!(7),
        8 => with!(8),
        9 => with!(9),
        length => tested::<{ LARGEST_DEGREE + 1 }>(length, base, step, gains, visit),
    }
}

/// [`stable_gains`] of polynomials of degree four, two second-order systems in a loop: the same conditions, multiplied
/// out so that no entry is divided by.
#[inline(always)]
fn quartic(base: &[f64], step: &[f64], gains: &[f64], mut visit: impl FnMut(usize)) {
    for (chunk, listed) in gains.chunks(LANES).enumerate() {
        let mut gain = [0.0; LANES];
        gain[..listed.len()].copy_from_slice(listed);
        let mut least = [f64::INFINITY; LANES];
        for lane in 0..LANES {
            let g = gain[lane];
            let sign = if base[0] + g * step[0] < 0.0 { -1.0 } else { 1.0 };
            let c: [f64; 5] = std::array::from_fn(|i| sign * (base[i] + g * step[i]));
            let limit: [f64; 5] = std::array::from_fn(|i| POSITIVE * (base[i].abs() + (g * step[i]).abs()));
            // The entries are c0, c1, d/c1, (c3 d − c1² c4)/d and c4.
            let d = c[1] * c[2] - c[0] * c[3];
            let above = [
                c[0] - limit[0],
                c[1] - limit[1],
                d - limit[2] * c[1],
                c[3] * d - c[1] * c[1] * c[4] - limit[3] * d,
                c[4] - limit[4],
            ];
            for value in above {
                least[lane] = if value < least[lane] { value } else { least[lane] };
            }
        }
        for (lane, least) in least.iter().enumerate().take(listed.len()) {
            if *least > 0.0 {
                visit(chunk * LANES + lane);
            }
        }
    }
}

/// [`stable_gains`] of polynomials with `length <= N` coefficients.
#[inline(always)]
#[allow(clippy::needless_range_loop)] // Lanes run side by side through several arrays.
fn tested<const N: usize>(length: usize, base: &[f64], step: &[f64], gains: &[f64], mut visit: impl FnMut(usize)) {
    let (base, step) = (&base[..length], &step[..length]);
    for (chunk, listed) in gains.chunks(LANES).enumerate() {
        let mut gain = [0.0; LANES];
        gain[..listed.len()].copy_from_slice(listed);
        let mut sign = [1.0; LANES];
        for lane in 0..LANES {
            sign[lane] = if base[0] + gain[lane] * step[0] < 0.0 { -1.0 } else { 1.0 };
        }
        let mut c = [[0.0; LANES]; N];
        // How far each entry of the first column is above what counts as positive.
        let mut least = [f64::INFINITY; LANES];
        for i in 0..length {
            for lane in 0..LANES {
                c[i][lane] = sign[lane] * (base[i] + gain[lane] * step[i]);
            }
        }
        check(&mut least, &c[0], base[0], step[0], &gain);
        for k in 0..length - 1 {
            check(&mut least, &c[k + 1], base[k + 1], step[k + 1], &gain);
            let mut factor = [0.0; LANES];
            for lane in 0..LANES {
                factor[lane] = c[k][lane] / c[k + 1][lane];
            }
            let mut i = k + 2;
            while i + 1 < length {
                for lane in 0..LANES {
                    c[i][lane] -= factor[lane] * c[i + 1][lane];
                }
                i += 2;
            }
        }
        for lane in 0..listed.len() {
            if least[lane] > 0.0 {
                visit(chunk * LANES + lane);
            }
        }
    }
}

/// Takes down whether entries of the first column are positive. A function, since a closure would be called.
#[inline(always)]
fn check(least: &mut [f64; LANES], entry: &[f64; LANES], base: f64, step: f64, gain: &[f64; LANES]) {
    for lane in 0..LANES {
        let limit = POSITIVE * (base.abs() + (gain[lane] * step).abs());
        let above = if entry[lane] > limit { 1.0 } else { -1.0 };
        least[lane] = if above < least[lane] { above } else { least[lane] };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::Polynomial;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    fn from_seed() -> ProptestConfig {
        ProptestConfig { rng_seed: RngSeed::Fixed(5), failure_persistence: None, ..ProptestConfig::default() }
    }

    proptest! {
        #![proptest_config(from_seed())]

        #[test]
        fn agrees_with_the_roots(coefficients in proptest::collection::vec(-3.0..6.0_f64, 1..12),
            step in -2.0..2.0_f64) {
            let added: Vec<f64> = coefficients.iter().rev().map(|c| step * c).collect();
            let gains = [0.0, 0.25, -0.25, 0.5, -0.5, 1.0, -1.0, 3.0, 0.7];
            let mut inside = [false; 9];
            stable_gains(&coefficients, &added, &gains, |i| inside[i] = true);
            for (gain, inside) in gains.iter().zip(inside) {
                let sum: Vec<f64> = coefficients.iter().zip(&added).map(|(a, b)| a + gain * b).collect();
                prop_assume!(sum[0].abs() > 1e-3);
                let roots = Polynomial::new(sum).roots().unwrap();
                let largest = roots.iter().map(|r| r.re).fold(f64::NEG_INFINITY, f64::max);
                prop_assume!(largest.abs() > 1e-6);
                prop_assert_eq!(largest < 0.0, inside);
            }
        }

        #[test]
        fn stable_polynomials_are_found(roots in proptest::collection::vec((-3.0..-0.05_f64, 0.0..4.0_f64), 1..5),
            scale in 0.1..10.0_f64) {
            // Random coefficients of high degree are hardly ever stable, so stable ones are made.
            let mut product = Polynomial::new(vec![scale]);
            for (re, im) in roots {
                product = product.mul(&Polynomial::new(vec![1.0, -2.0 * re, re * re + im * im]));
            }
            prop_assert!(stable(product.coefficients()));
            prop_assert!(stable(product.scale(-1.0).coefficients()));
            prop_assert!(!stable(product.mul(&Polynomial::new(vec![1.0, -0.05])).coefficients()));
        }
    }

    #[test]
    fn the_boundary_is_outside() {
        // s² + 1, s(s + 1), and (s + 0.1)(s² + 2) with rounded coefficients.
        for coefficients in [vec![1.0, 0.0, 1.0], vec![1.0, 1.0, 0.0], vec![1.0, 0.1, 2.0, 0.2]] {
            assert!(!stable(&coefficients), "{coefficients:?}");
        }
    }
}
