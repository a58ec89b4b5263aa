//! How far data may be from what their doubles say: the box within which verdicts are made.

use nalgebra::DMatrix;

/// The unit of rounding, 2⁻⁵³.
pub(super) const UNIT: f64 = 0.5 * f64::EPSILON;
/// Units of rounding of an entry of A or B.
pub(super) const PLANT: f64 = 32.0;
/// Units of rounding of an entry of K, which comes out of a Riccati equation or an Ackermann formula.
const GAIN: f64 = 64.0;

/// Bounds of the entries of ΔA, ΔB and ΔK: not negative, in balanced units.
///
/// `|ΔA| ≤ 32u·max(|A|, ‖A‖/n)` where A is not zero, ΔB alike, and
/// `|ΔK| ≤ 64u (|K| + ‖K‖/n + ‖A_·i‖/‖B‖ + ‖A‖/(n‖B‖))` (Frobenius norms). A zero of A or B is a fact of the model.
/// The last two terms are what a gain that is small for its plant comes from: a difference of numbers of the size
/// ‖A‖/‖B‖.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rounding {
    pub a: DMatrix<f64>,
    pub b: DMatrix<f64>,
    pub k: DMatrix<f64>,
}

impl Rounding {
    /// The box around matrices in balanced units; `gain` replaces the bounds of K's entries where their rounding is
    /// known.
    pub(super) fn around(a: &DMatrix<f64>, b: &DMatrix<f64>, k: &DMatrix<f64>, gain: Option<&DMatrix<f64>>) -> Self {
        let n = a.nrows() as f64;
        let plant = |m: &DMatrix<f64>| {
            let floor = m.norm() / n;
            m.map(|v| if v == 0.0 { 0.0 } else { PLANT * UNIT * v.abs().max(floor) })
        };
        let (size_a, size_b, size_k) = (a.norm(), b.norm(), k.norm());
        let k = gain.cloned().unwrap_or_else(|| {
            DMatrix::from_fn(k.nrows(), k.ncols(), |i, j| {
                let plant = if size_b > 0.0 { (a.column(j).norm() + size_a / n) / size_b } else { 0.0 };
                GAIN * UNIT * (k[(i, j)].abs() + size_k / n + plant)
            })
        });
        Self { a: plant(a), b: plant(b), k }
    }
}

/// Whether A − BK (balanced) is stable whatever its rounding, to first order in every eigenvalue or by a Lyapunov
/// function.
pub(super) mod stability {
    use super::{PLANT, UNIT};
    use crate::control::lyapunov::{Clock, Lyapunov};
    use crate::num::linalg::NoConvergence;
    use crate::num::schur::ComplexSchur;
    use nalgebra::{DMatrix, DVector};
    use num_complex::Complex64;

    /// Of an eigenvalue: where it is, and how far rounding may move it.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub(in crate::inverse) struct Pole {
        pub value: Complex64,
        pub shift: f64,
    }

    /// The eigenvalues with `Σ |y_i| Δ_ij |x_j|/|yᴴx|`, Δ the entrywise bound of the change and x, y the eigenvectors;
    /// infinite for an eigenvalue that is not simple.
    pub(in crate::inverse) fn poles(m: &DMatrix<f64>, change: &DMatrix<f64>) -> Result<Vec<Pole>, NoConvergence> {
        let n = m.nrows();
        let schur = ComplexSchur::new(m)?;
        let (u, t) = (&schur.u, &schur.t);
        let least = UNIT * t.norm();
        let zero = Complex64::new(0.0, 0.0);
        let poles = (0..n).map(|i| {
            let value = t[(i, i)];
            let (mut right, mut left) = (DVector::from_element(n, zero), DVector::from_element(n, zero));
            (right[i], left[i]) = (Complex64::new(1.0, 0.0), Complex64::new(1.0, 0.0));
            let apart = |j: usize| {
                let gap = value - t[(j, j)];
                if gap.norm() > least { gap } else { Complex64::new(least.max(f64::MIN_POSITIVE), 0.0) }
            };
            for j in (0..i).rev() {
                let sum: Complex64 = (j + 1..=i).map(|k| t[(j, k)] * right[k]).sum();
                right[j] = sum / apart(j);
            }
            for j in i + 1..n {
                let sum: Complex64 = (i..j).map(|k| t[(k, j)].conj() * left[k]).sum();
                left[j] = sum / apart(j).conj();
            }
            // The triangular forms make yᴴx = 1.
            let (x, y) = ((u * right).map(|v| v.norm()), (u * left).map(|v| v.norm()));
            let shift = y.dot(&(change * x));
            Pole { value, shift: if shift.is_finite() { shift } else { f64::INFINITY } }
        });
        Ok(poles.collect())
    }

    /// The entrywise bound for A − BK as it is computed.
    pub(in crate::inverse) fn change(a: &DMatrix<f64>, b: &DMatrix<f64>, k: &DMatrix<f64>) -> DMatrix<f64> {
        let closed = a - b * k;
        let floor = closed.norm() / closed.nrows() as f64;
        (a.abs() + b.abs() * k.abs()).map(|v| PLANT * UNIT * (v + floor))
    }

    /// Whether X ≻ 0 of `MᵀX + XM + I = 0` (`MᵀXM − X + I = 0`) outlives every change of that size.
    pub(in crate::inverse) fn is_robust(m: &DMatrix<f64>, change: &DMatrix<f64>, clock: Clock) -> bool {
        let n = m.nrows();
        let Ok(equation) = Lyapunov::new(m, clock) else { return false };
        if !equation.is_stable() {
            return false;
        }
        let x = equation.solve(&DMatrix::identity(n, n));
        let (low, high) = (x.symmetric_eigenvalues().min(), x.norm());
        let eta = change.norm();
        let moved = match clock {
            Clock::Continuous => 2.0 * eta * high,
            Clock::Sampled => (2.0 * m.norm() + eta) * eta * high,
        };
        low > 0.0 && moved < 1.0
    }
}
