//! Units of the states in which plant and gain have numbers of one size.
//!
//! Whether a gain is optimal does not depend on units, but digits do: with one state in nanometres and another in
//! radians, the weights lie twelve decades apart, and the margin in those units is zero to working precision for gains
//! that are optimal by construction.

use super::gains::Gains;
use nalgebra::{DMatrix, DVector};

/// Sweeps at most; a few are enough.
const SWEEPS: usize = 20;

/// The gains in the states `x' = D⁻¹x`, and the diagonal of D, powers of two, so that nothing is rounded: rows and
/// columns of `[A B; K 0]` become equally long (Osborne, J. ACM 7, 338–345, 1960). The units of the inputs are balanced
/// on the way, and stay as they are.
pub(super) fn balanced(gains: &Gains) -> (Gains, DVector<f64>) {
    let (n, m) = (gains.states(), gains.ports());
    let mut whole = DMatrix::zeros(n + m, n + m);
    whole.view_mut((0, 0), (n, n)).copy_from(&gains.a);
    whole.view_mut((0, n), (n, m)).copy_from(&gains.b);
    whole.view_mut((n, 0), (m, n)).copy_from(&gains.k);
    let mut factors = DVector::from_element(n + m, 1.0);
    for _ in 0..SWEEPS {
        let mut moved = false;
        for i in 0..n + m {
            let length = |entries: f64| (entries - whole[(i, i)].powi(2)).max(0.0).sqrt();
            let (row, column) = (length(whole.row(i).norm_squared()), length(whole.column(i).norm_squared()));
            if row == 0.0 || column == 0.0 {
                continue;
            }
            let step = (0.5 * (row / column).log2()).round();
            if step == 0.0 {
                continue;
            }
            let factor = step.exp2();
            let mut line = whole.row_mut(i);
            line /= factor;
            let mut line = whole.column_mut(i);
            line *= factor;
            factors[i] *= factor;
            moved = true;
        }
        if !moved {
            break;
        }
    }
    let d = factors.rows(0, n).into_owned();
    let scaled = |m: &DMatrix<f64>, row: bool, column: bool| {
        DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| {
            m[(i, j)] / if row { d[i] } else { 1.0 } * if column { d[j] } else { 1.0 }
        })
    };
    let balanced = Gains {
        a: scaled(&gains.a, true, true),
        b: scaled(&gains.b, true, false),
        k: scaled(&gains.k, false, true),
        ..gains.clone()
    };
    (balanced, d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::lyapunov::Clock;

    #[test]
    fn units_of_the_states_are_undone() {
        let a = DMatrix::from_row_slice(2, 2, &[0.3, 1.0, 2.0, -0.5]);
        let (b, k) = (DMatrix::from_row_slice(2, 1, &[0.4, 1.0]), DMatrix::from_row_slice(1, 2, &[4.0, 3.0]));
        let gains = Gains::regulator(&a, &b, &k, Clock::Continuous).unwrap();
        let (plain, d) = balanced(&gains);
        assert!(d.iter().all(|v| (0.25..=4.0).contains(v)), "{d}");
        let unit = [2f64.powi(30), 2f64.powi(-20)];
        let a = DMatrix::from_fn(2, 2, |i, j| a[(i, j)] * unit[i] / unit[j]);
        let b = DMatrix::from_fn(2, 1, |i, _| b[i] * unit[i]);
        let k = DMatrix::from_fn(1, 2, |_, j| k[j] / unit[j]);
        let (found, d) = balanced(&Gains { a, b, k, ..gains });
        // Up to a factor that all states and inputs have in common.
        assert!(((d[0] / d[1]) / (unit[0] / unit[1])).log2().abs() <= 2.0, "{d}");
        // Within a factor of four, the best that powers of two promise.
        assert!((found.a.amax() / plain.a.amax()).log2().abs() <= 2.0);
    }
}
