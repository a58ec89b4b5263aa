//! The residual of the equation of X in double-double precision.
//!
//! X of a multiplier has eigenvalues of a trillionth of its largest, and must be known to be definite all the same. A
//! residual in single doubles says where X is only up to rounding times the condition of the equation, and Cholesky's
//! factor in single doubles whether it is definite only up to n times its rounding.

use crate::control::double_double::DoubleDouble;
use crate::control::lyapunov::Clock;
use crate::inverse::reach::Core;
use crate::inverse::rounding::UNIT;
use nalgebra::DMatrix;

/// `A − BK` as it is, not as it is rounded.
pub(super) struct ExactLoop {
    high: DMatrix<f64>,
    low: DMatrix<f64>,
}

/// A matrix of sums of two doubles.
type Twofold = DMatrix<DoubleDouble>;

/// `Σ_k x_ik y_kj`.
fn product(x: &DMatrix<f64>, y: &DMatrix<f64>) -> Twofold {
    let rows = x.transpose();
    DMatrix::from_fn(x.nrows(), y.ncols(), |i, j| {
        rows.column(i)
            .iter()
            .zip(y.column(j).iter())
            .fold(DoubleDouble::default(), |sum, (x, y)| sum.add_product(*x, *y))
    })
}

fn parts(m: &Twofold) -> [DMatrix<f64>; 2] {
    [m.map(DoubleDouble::value), m.map(DoubleDouble::rest)]
}

impl ExactLoop {
    pub(super) fn new(core: &Core) -> Self {
        let bk = product(&core.b, &core.k);
        let [high, low] = parts(&core.a.zip_map(&bk, |a, bk| DoubleDouble::from(a).sub(bk)));
        Self { high, low }
    }

    /// `(A − BK)M`.
    fn times(&self, m: &DMatrix<f64>) -> Twofold {
        let rest = &self.low * m;
        product(&self.high, m).zip_map(&rest, |sum, rest| sum.add(rest.into()))
    }

    /// `M(A − BK)ᵀ`.
    fn after(&self, m: &Twofold) -> Twofold {
        let [high, low] = parts(m);
        let rest = low * self.high.transpose() + &high * self.low.transpose();
        product(&high, &self.high.transpose()).zip_map(&rest, |sum, rest| sum.add(rest.into()))
    }

    /// `A_cX + XA_cᵀ − BN − NᵀBᵀ` (`A_cXA_cᵀ − X − BNA_cᵀ − A_cNᵀBᵀ`) for a symmetric X, to the last place of a double.
    pub(super) fn residual(&self, core: &Core, n: &DMatrix<f64>, x: &DMatrix<f64>) -> DMatrix<f64> {
        let source = product(&core.b, n);
        let moved = self.times(x);
        let half = moved.zip_map(&source, DoubleDouble::sub);
        let whole = match core.clock {
            Clock::Continuous => half.zip_map(&half.transpose(), DoubleDouble::add),
            Clock::Sampled => {
                let there = self.after(&half).zip_map(&self.after(&source).transpose(), DoubleDouble::sub);
                there.zip_map(x, |sum, x| sum.sub(x.into()))
            }
        };
        whole.map(DoubleDouble::value)
    }
}

/// Whether `M + L` is positive definite whatever the rounding of its factors LDLᵀ, which is that of double-doubles.
pub(super) fn is_definite(m: &DMatrix<f64>, rest: &DMatrix<f64>) -> bool {
    let n = m.nrows();
    // The factors are those of a matrix within this of it (Rump, BIT 46, 433–452, 2006).
    let shift = 8.0 * (n + 2) as f64 * UNIT * UNIT * m.trace().abs();
    let mut left = m.zip_map(rest, |m, rest| DoubleDouble::from(m).add(rest.into()));
    for i in 0..n {
        left[(i, i)] = left[(i, i)].sub(shift.into());
    }
    for k in 0..n {
        let pivot = left[(k, k)];
        if pivot.value().is_nan() || pivot.value() <= 0.0 {
            return false;
        }
        let factors: Vec<DoubleDouble> = (k + 1..n).map(|i| left[(i, k)].over(pivot)).collect();
        for j in k + 1..n {
            let entry = left[(j, k)];
            for i in j..n {
                left[(i, j)] = left[(i, j)].sub(factors[i - k - 1].times(entry));
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::{ExactLoop, is_definite};
    use crate::control::lyapunov::{Clock, Lyapunov};
    use crate::inverse::reach::Core;
    use crate::inverse::rounding::Rounding;
    use crate::num::linalg::symmetric;
    use crate::num::rng;
    use nalgebra::DMatrix;
    use rand::RngExt;

    /// Against a solution whose residual is known by construction: whole numbers, which doubles hold exactly.
    #[test]
    fn residuals_of_whole_numbers_are_exact() {
        let mut stream = rng::stream(20_261_130, "exact residuals");
        for clock in [Clock::Continuous, Clock::Sampled] {
            let mut whole = |rows, columns, size: i32| {
                DMatrix::from_fn(rows, columns, |_, _| f64::from(stream.random_range(-size..=size)))
            };
            let (a, b, k, n) = (whole(5, 5, 9), whole(5, 2, 9), whole(2, 5, 9), whole(2, 5, 9));
            let x = whole(5, 5, 1_000_000);
            let x = &x + x.transpose();
            let core = Core { rounding: Rounding::around(&a, &b, &k, None), a, b, k, clock };
            let closed = core.closed_loop();
            let inner = &core.b * &n;
            let expected = match clock {
                Clock::Continuous => &closed * &x + &x * closed.transpose() - &inner - inner.transpose(),
                Clock::Sampled => {
                    let inner = inner * closed.transpose();
                    &closed * &x * closed.transpose() - &x - &inner - inner.transpose()
                }
            };
            assert_eq!(ExactLoop::new(&core).residual(&core, &n, &x), expected, "{clock:?}");
        }
    }

    /// Hilbert's matrix of order 12 has the least eigenvalue 1.04795e-16 (by rational arithmetic), below the unit of
    /// rounding.
    #[test]
    fn definiteness_is_seen_below_the_unit_of_rounding() {
        let hilbert = DMatrix::from_fn(12, 12, |i, j| 1.0 / (i + j + 1) as f64);
        let rest = DMatrix::from_fn(12, 12, |i, j| {
            // 1/d − fl(1/d) = (1 − d·fl(1/d))/d
            let d = (i + j + 1) as f64;
            (-d).mul_add(hilbert[(i, j)], 1.0) / d
        });
        assert!(is_definite(&hilbert, &rest));
        let lowered = |by: f64| &rest - DMatrix::identity(12, 12) * by;
        assert!(is_definite(&hilbert, &lowered(1.0479e-16)) && !is_definite(&hilbert, &lowered(1.048e-16)));
        assert!(!is_definite(&DMatrix::from_element(2, 2, f64::NAN), &DMatrix::zeros(2, 2)));
    }

    /// Two corrections by the exact residual leave the rounding of X alone, though the loop is nearly undamped.
    #[test]
    fn a_corrected_solution_is_as_good_as_its_digits() {
        let a = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, -1.0, -1e-9]);
        let (b, k) = (DMatrix::from_column_slice(2, 1, &[0.0, 1.0]), DMatrix::from_row_slice(1, 2, &[0.1, 0.0]));
        let core = Core { rounding: Rounding::around(&a, &b, &k, None), a, b, k, clock: Clock::Continuous };
        let n = DMatrix::from_row_slice(1, 2, &[-0.3, -0.7]);
        let (exact, equation) = (ExactLoop::new(&core), Lyapunov::new(&core.closed_loop(), core.clock).unwrap());
        let half = &core.b * &n;
        let mut x = equation.solve_adjoint(&-(&half + half.transpose()));
        for _ in 0..2 {
            x = symmetric(&(&x + equation.solve_adjoint(&exact.residual(&core, &n, &x))));
        }
        let left = equation.solve_adjoint(&exact.residual(&core, &n, &x));
        assert!(left.norm() <= f64::EPSILON * x.norm(), "{:e} of {:e}", left.norm(), x.norm());
    }
}
