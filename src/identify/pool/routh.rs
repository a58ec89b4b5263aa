//! Routh's criterion on several gains at once.

/// Gains tested together.
pub(super) const LANES: usize = 8;

/// The largest degree of a closed-loop polynomial.
pub const LARGEST_DEGREE: usize = 24;

/// An entry of the first column counts as positive above this share of the coefficient that it was computed from.
///
/// On the boundary of the region an entry is zero in exact arithmetic and some units in the last place in floating point,
/// of either sign. The boundary does not belong to the region, so rounding must not let it in.
const POSITIVE: f64 = 1e-12;

/// For each gain g, whether `base + g·step` has all of its roots in the open left half plane.
///
/// Both polynomials have descending powers and the same length; a vanishing leading coefficient (a root at infinity)
/// counts as outside. The sign of the whole polynomial does not matter.
pub(super) fn stable(base: &[f64], step: &[f64], gains: &[f64; LANES]) -> [bool; LANES] {
    let n = base.len() - 1;
    let mut c = [[0.0; LANES]; LARGEST_DEGREE + 1];
    let mut limit = [[0.0; LANES]; LARGEST_DEGREE + 1];
    let mut sign = [1.0; LANES];
    for lane in 0..LANES {
        sign[lane] = if base[0] + gains[lane] * step[0] < 0.0 { -1.0 } else { 1.0 };
    }
    for i in 0..=n {
        for lane in 0..LANES {
            let added = gains[lane] * step[i];
            c[i][lane] = sign[lane] * (base[i] + added);
            limit[i][lane] = POSITIVE * (base[i].abs() + added.abs());
        }
    }
    let mut inside = [true; LANES];
    for lane in 0..LANES {
        inside[lane] &= c[0][lane] > limit[0][lane];
    }
    for k in 0..n {
        for lane in 0..LANES {
            inside[lane] &= c[k + 1][lane] > limit[k + 1][lane];
        }
        let mut factor = [0.0; LANES];
        for lane in 0..LANES {
            factor[lane] = c[k][lane] / c[k + 1][lane];
        }
        let mut i = k + 2;
        while i < n {
            let (head, tail) = c.split_at_mut(i + 1);
            for lane in 0..LANES {
                head[i][lane] -= factor[lane] * tail[0][lane];
            }
            i += 2;
        }
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::Polynomial;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_the_roots(coefficients in proptest::collection::vec(-3.0..6.0_f64, 1..8), step in -2.0..2.0_f64) {
            let added: Vec<f64> = coefficients.iter().rev().map(|c| step * c).collect();
            let gains = [0.0, 0.25, -0.25, 0.5, -0.5, 1.0, -1.0, 3.0];
            let inside = stable(&coefficients, &added, &gains);
            for (gain, inside) in gains.iter().zip(inside) {
                let sum: Vec<f64> = coefficients.iter().zip(&added).map(|(a, b)| a + gain * b).collect();
                prop_assume!(sum[0].abs() > 1e-3);
                let roots = Polynomial::new(sum).roots().unwrap();
                let largest = roots.iter().map(|r| r.re).fold(f64::NEG_INFINITY, f64::max);
                prop_assume!(largest.abs() > 1e-6);
                prop_assert_eq!(largest < 0.0, inside);
            }
        }
    }

    #[test]
    fn the_boundary_is_outside() {
        // s² + 1, s(s + 1), and (s + 0.1)(s² + 2) with rounded coefficients.
        for coefficients in [vec![1.0, 0.0, 1.0], vec![1.0, 1.0, 0.0], vec![1.0, 0.1, 2.0, 0.2]] {
            let zero = vec![0.0; coefficients.len()];
            assert_eq!(stable(&coefficients, &zero, &[0.0; LANES]), [false; LANES], "{coefficients:?}");
        }
    }
}
