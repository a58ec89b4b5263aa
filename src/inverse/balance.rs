//! Units of states and inputs in which plant and gain have numbers of one size.
//!
//! Whether a gain is optimal does not depend on units, but digits do: with one state in nanometres and another in
//! radians, the weights lie twelve decades apart, and with inputs in units over eight decades R does.

use nalgebra::{DMatrix, DVector};

/// Sweeps at most; a few are enough.
const SWEEPS: usize = 20;

/// Matrices in the states `x' = D⁻¹x` and the inputs `u' = E⁻¹u`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Balanced {
    /// `D⁻¹AD`, n×n.
    pub a: DMatrix<f64>,
    /// `D⁻¹BE`, n×m.
    pub b: DMatrix<f64>,
    /// `E⁻¹KD`, m×n.
    pub k: DMatrix<f64>,
    /// The diagonal of D.
    pub states: DVector<f64>,
    /// The diagonal of E.
    pub inputs: DVector<f64>,
}

/// Rows and columns of `[A B; K 0]` become equally long (Osborne, J. ACM 7, 338–345, 1960), by powers of two, so that
/// nothing is rounded.
pub(super) fn balanced(a: &DMatrix<f64>, b: &DMatrix<f64>, k: &DMatrix<f64>) -> Balanced {
    let (n, m) = b.shape();
    let mut whole = DMatrix::zeros(n + m, n + m);
    whole.view_mut((0, 0), (n, n)).copy_from(a);
    whole.view_mut((0, n), (n, m)).copy_from(b);
    whole.view_mut((n, 0), (m, n)).copy_from(k);
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
    Balanced {
        a: whole.view((0, 0), (n, n)).into_owned(),
        b: whole.view((0, n), (n, m)).into_owned(),
        k: whole.view((n, 0), (m, n)).into_owned(),
        states: factors.rows(0, n).into_owned(),
        inputs: factors.rows(n, m).into_owned(),
    }
}

impl Balanced {
    /// P or Q in the units of the plant.
    pub(super) fn state_weight(&self, weight: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(weight.nrows(), weight.ncols(), |i, j| weight[(i, j)] / (self.states[i] * self.states[j]))
    }

    /// R in the units of the plant.
    pub(super) fn input_weight(&self, weight: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(weight.nrows(), weight.ncols(), |i, j| weight[(i, j)] / (self.inputs[i] * self.inputs[j]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_states_and_inputs_are_undone() {
        let a = DMatrix::from_row_slice(2, 2, &[0.3, 1.0, 2.0, -0.5]);
        let b = DMatrix::from_row_slice(2, 2, &[0.4, 0.1, 1.0, -0.3]);
        let k = DMatrix::from_row_slice(2, 2, &[4.0, 3.0, 1.0, -2.0]);
        let plain = balanced(&a, &b, &k);
        let (unit, port) = ([2f64.powi(30), 2f64.powi(-20)], [2f64.powi(15), 2f64.powi(-12)]);
        let found = balanced(
            &DMatrix::from_fn(2, 2, |i, j| a[(i, j)] * unit[i] / unit[j]),
            &DMatrix::from_fn(2, 2, |i, j| b[(i, j)] * unit[i] / port[j]),
            &DMatrix::from_fn(2, 2, |i, j| k[(i, j)] * port[i] / unit[j]),
        );
        // Within a factor of four, the best that powers of two promise.
        for (one, other) in [(&found.a, &plain.a), (&found.b, &plain.b), (&found.k, &plain.k)] {
            assert!((one.amax() / other.amax()).log2().abs() <= 2.0);
        }
        let back = found.state_weight(&DMatrix::identity(2, 2));
        assert!((back[(0, 0)] * found.states[0].powi(2) - 1.0).abs() < 1e-15);
    }
}
