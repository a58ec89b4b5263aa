//! The Padé approximation of a pure delay.

use nalgebra::DMatrix;

/// The Padé approximation of order q of `e^{−p}`, `p = τs`, as `ξ' = a ξ + b e`, `output = c ξ + d e`: a, b, c and d.
///
/// With `coth(p/2) = 2/p + 1/(6/p + 1/(10/p + …))` cut after q terms, `(coth − 1)/(coth + 1)` is the diagonal Padé
/// approximant. Its terms are the elements of a lossless ladder, whose states scaled to their energies give entries of
/// like size at any order; a companion form of order 5 has entries of 30240 beside 1.
#[must_use]
pub(crate) fn pade(order: usize) -> (DMatrix<f64>, Vec<f64>, Vec<f64>, f64) {
    let size = |k: usize| 2.0 * (2 * k + 1) as f64;
    let root = |k: usize| size(k).sqrt();
    // Elements 0, 2, 4, .. integrate currents i, elements 1, 3, .. voltages v: the voltage behind element k is the sum
    // of the even states from k on, the current is the input e less the voltage at the front and the odd states before
    // k. So it is where the last element is a current, that is for odd orders; for even ones the voltages end the
    // ladder, and both change places.
    let is_driven = |k: usize| k % 2 != order % 2;
    let through = if order.is_multiple_of(2) { 1.0 } else { -1.0 };
    let mut a = DMatrix::zeros(order, order);
    let mut b = vec![0.0; order];
    let mut c = vec![0.0; order];
    for k in 0..order {
        let scale = size(k) / root(k);
        if is_driven(k) {
            b[k] = scale;
            c[k] = -2.0 * through * root(k);
            for j in 0..order {
                if is_driven(j) || j < k {
                    a[(k, j)] = -scale * root(j);
                }
            }
        } else {
            for j in (k + 1..order).step_by(2) {
                a[(k, j)] = scale * root(j);
            }
        }
    }
    (a, b, c, through)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Continuous, StateSpace};
    use num_complex::Complex64;

    /// Priess 2015, §5.2: the coefficients of the approximant of order 5.
    #[test]
    fn the_ladder_is_the_printed_approximant() {
        let (a, b, c, d) = pade(5);
        let model = StateSpace::new(
            a,
            DMatrix::from_column_slice(5, 1, &b),
            DMatrix::from_row_slice(1, 5, &c),
            DMatrix::from_element(1, 1, d),
            Continuous,
        )
        .unwrap();
        let printed = [30240.0, 15120.0, 3360.0, 420.0, 30.0, 1.0];
        for p in
            [Complex64::new(0.3, 0.0), Complex64::new(0.0, 2.0), Complex64::new(1.5, -7.0), Complex64::new(0.0, 40.0)]
        {
            let sum = |sign: f64| printed.iter().rev().fold(Complex64::new(0.0, 0.0), |sum, c| sum * p * sign + c);
            let expected = sum(-1.0) / sum(1.0);
            let found = model.eval(p).unwrap()[(0, 0)];
            assert!((found - expected).norm() < 1e-13 * expected.norm().max(1.0), "{p}: {found} {expected}");
        }
    }

    #[test]
    fn every_order_delays() {
        for order in 1..=8 {
            let (a, b, c, d) = pade(order);
            let model = StateSpace::new(
                a,
                DMatrix::from_column_slice(order, 1, &b),
                DMatrix::from_row_slice(1, order, &c),
                DMatrix::from_element(1, 1, d),
                Continuous,
            )
            .unwrap();
            let p = Complex64::new(0.0, 0.2 * order as f64);
            let found = model.eval(p).unwrap()[(0, 0)];
            assert!((found.norm() - 1.0).abs() < 1e-13, "an all-pass");
            assert!((found - (-p).exp()).norm() < 1e-3, "{order}: {found}");
        }
    }
}
