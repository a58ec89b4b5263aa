//! Linear matrix equations: Lyapunov, Stein and Sylvester, through Schur forms (Bartels and Stewart, CACM 15, 820–826,
//! 1972).

use crate::num::linalg::{NoConvergence, symmetric};
use crate::num::schur::ComplexSchur;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// Which equation an n×n matrix A stands in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clock {
    /// Continuous time: `AᵀX + XA + Q = 0`, stable where every eigenvalue has a negative real part.
    Continuous,
    /// Sampled time: `AᵀXA − X + Q = 0`, stable where every eigenvalue lies within the unit circle.
    Sampled,
}

impl Clock {
    /// Distance of an eigenvalue to the boundary of stability, positive inside: −Re λ, or 1 − |λ|.
    #[must_use]
    pub fn margin(self, eigenvalue: Complex64) -> f64 {
        match self {
            Self::Continuous => -eigenvalue.re,
            Self::Sampled => 1.0 - eigenvalue.norm(),
        }
    }
}

/// Why a linear matrix equation has no solution.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LinearEquationError {
    /// Two eigenvalues cancel (λ + μ = 0, or λμ = 1 in sampled time): the equation is singular to working precision.
    #[error("the equation is singular: the eigenvalues {first} and {second} cancel")]
    Singular {
        /// One eigenvalue.
        first: Complex64,
        /// The other.
        second: Complex64,
    },
    /// The Schur iteration failed, or an entry is not finite.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
}

/// Relative size below which a divisor is a rounding error.
const SINGULAR: f64 = 4.0 * f64::EPSILON;

/// A Lyapunov (or Stein) operator, factorised once for many right-hand sides.
#[derive(Debug, Clone)]
pub struct Lyapunov {
    a: DMatrix<f64>,
    schur: ComplexSchur,
    clock: Clock,
}

impl Lyapunov {
    /// Factorises the operator of A, n×n.
    ///
    /// # Errors
    /// [`LinearEquationError`] where it is singular or A has no Schur form.
    pub fn new(a: &DMatrix<f64>, clock: Clock) -> Result<Self, LinearEquationError> {
        let schur = ComplexSchur::new(a)?;
        let values: Vec<Complex64> = schur.eigenvalues().collect();
        let norm = values.iter().map(|v| v.norm()).fold(0.0, f64::max);
        for (i, first) in values.iter().enumerate() {
            for second in &values[i..] {
                let singular = match clock {
                    Clock::Continuous => (first.conj() + second).norm() <= SINGULAR * norm,
                    Clock::Sampled => (first.conj() * second - 1.0).norm() <= SINGULAR,
                };
                if singular {
                    return Err(LinearEquationError::Singular { first: *first, second: *second });
                }
            }
        }
        Ok(Self { a: a.clone(), schur, clock })
    }

    /// The eigenvalues of A.
    pub fn eigenvalues(&self) -> impl Iterator<Item = Complex64> + '_ {
        self.schur.eigenvalues()
    }

    /// Whether A is stable.
    #[must_use]
    pub fn is_stable(&self) -> bool {
        self.eigenvalues().all(|v| self.clock.margin(v) > 0.0)
    }

    /// X with `AᵀX + XA + Q = 0` (`AᵀXA − X + Q = 0` in sampled time), for a symmetric Q; symmetric, with one step of
    /// iterative refinement.
    #[must_use]
    pub fn solve(&self, q: &DMatrix<f64>) -> DMatrix<f64> {
        let x = self.raw(q);
        let residual = match self.clock {
            Clock::Continuous => self.a.tr_mul(&x) + &x * &self.a + q,
            Clock::Sampled => self.a.tr_mul(&(&x * &self.a)) - &x + q,
        };
        symmetric(&(&x + self.raw(&residual)))
    }

    /// X with `AX + XAᵀ + Q = 0` (`AXAᵀ − X + Q = 0` in sampled time): the adjoint of [`Lyapunov::solve`].
    #[must_use]
    pub fn solve_adjoint(&self, q: &DMatrix<f64>) -> DMatrix<f64> {
        let x = self.raw_adjoint(q);
        let residual = match self.clock {
            Clock::Continuous => &self.a * &x + &x * self.a.transpose() + q,
            Clock::Sampled => &self.a * &x * self.a.transpose() - &x + q,
        };
        symmetric(&(&x + self.raw_adjoint(&residual)))
    }

    fn rotated(&self, q: &DMatrix<f64>) -> DMatrix<Complex64> {
        self.schur.u.adjoint() * (complex(q) * &self.schur.u)
    }

    fn back(&self, y: &DMatrix<Complex64>) -> DMatrix<f64> {
        (&self.schur.u * (y * self.schur.u.adjoint())).map(|v| v.re)
    }

    /// `TᴴY + YT = −C` (`TᴴYT − Y = −C`), column by column from the left, each from the top.
    fn raw(&self, q: &DMatrix<f64>) -> DMatrix<f64> {
        let t = &self.schur.t;
        let n = t.nrows();
        let c = self.rotated(q);
        let mut y = DMatrix::<Complex64>::zeros(n, n);
        let mut sum = vec![Complex64::new(0.0, 0.0); n];
        for j in 0..n {
            sum.fill(Complex64::new(0.0, 0.0));
            for k in 0..j {
                let factor = t[(k, j)];
                for (s, v) in sum.iter_mut().zip(y.column(k).iter()) {
                    *s += v * factor;
                }
            }
            let diagonal = t[(j, j)];
            for i in 0..n {
                let mut above = Complex64::new(0.0, 0.0);
                match self.clock {
                    Clock::Continuous => {
                        for k in 0..i {
                            above += t[(k, i)].conj() * y[(k, j)];
                        }
                        y[(i, j)] = -(c[(i, j)] + sum[i] + above) / (t[(i, i)].conj() + diagonal);
                    }
                    Clock::Sampled => {
                        // The product of Tᴴ with the columns to the left and what is known of this one.
                        for k in 0..i {
                            above += t[(k, i)].conj() * (sum[k] + y[(k, j)] * diagonal);
                        }
                        let left = t[(i, i)].conj();
                        y[(i, j)] = -(c[(i, j)] + above + left * sum[i]) / (left * diagonal - 1.0);
                    }
                }
            }
        }
        self.back(&y)
    }

    /// `TY + YTᴴ = −C` (`TYTᴴ − Y = −C`), column by column from the right, each from the bottom.
    fn raw_adjoint(&self, q: &DMatrix<f64>) -> DMatrix<f64> {
        let t = &self.schur.t;
        let n = t.nrows();
        let c = self.rotated(q);
        let mut y = DMatrix::<Complex64>::zeros(n, n);
        let mut sum = vec![Complex64::new(0.0, 0.0); n];
        for j in (0..n).rev() {
            sum.fill(Complex64::new(0.0, 0.0));
            for k in j + 1..n {
                let factor = t[(j, k)].conj();
                for (s, v) in sum.iter_mut().zip(y.column(k).iter()) {
                    *s += v * factor;
                }
            }
            let diagonal = t[(j, j)].conj();
            for i in (0..n).rev() {
                let mut below = Complex64::new(0.0, 0.0);
                match self.clock {
                    Clock::Continuous => {
                        for k in i + 1..n {
                            below += t[(i, k)] * y[(k, j)];
                        }
                        y[(i, j)] = -(c[(i, j)] + sum[i] + below) / (t[(i, i)] + diagonal);
                    }
                    Clock::Sampled => {
                        for k in i + 1..n {
                            below += t[(i, k)] * (sum[k] + y[(k, j)] * diagonal);
                        }
                        let left = t[(i, i)];
                        y[(i, j)] = -(c[(i, j)] + below + left * sum[i]) / (left * diagonal - 1.0);
                    }
                }
            }
        }
        self.back(&y)
    }
}

/// X, n×m, with `AX + XB = C` for A n×n, B m×m and C n×m.
///
/// # Errors
/// [`LinearEquationError`] where an eigenvalue of A is the negative of one of B, or a Schur form fails.
///
/// # Panics
/// If the sizes disagree, which is a mistake of the caller.
pub fn sylvester(a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DMatrix<f64>) -> Result<DMatrix<f64>, LinearEquationError> {
    assert_eq!((a.nrows(), b.nrows()), c.shape(), "sizes of a Sylvester equation");
    let (left, right) = (ComplexSchur::new(a)?, ComplexSchur::new(b)?);
    let norm = left.eigenvalues().chain(right.eigenvalues()).map(|v| v.norm()).fold(0.0, f64::max);
    for first in left.eigenvalues() {
        if let Some(second) = right.eigenvalues().find(|second| (first + second).norm() <= SINGULAR * norm) {
            return Err(LinearEquationError::Singular { first, second });
        }
    }
    let solve = |c: &DMatrix<f64>| {
        let rotated = left.u.adjoint() * (complex(c) * &right.u);
        let (n, m) = c.shape();
        let mut y = DMatrix::<Complex64>::zeros(n, m);
        for j in 0..m {
            for i in (0..n).rev() {
                let mut rest = rotated[(i, j)];
                for k in 0..j {
                    rest -= y[(i, k)] * right.t[(k, j)];
                }
                for k in i + 1..n {
                    rest -= left.t[(i, k)] * y[(k, j)];
                }
                y[(i, j)] = rest / (left.t[(i, i)] + right.t[(j, j)]);
            }
        }
        (&left.u * (y * right.u.adjoint())).map(|v| v.re)
    };
    let x = solve(c);
    let residual = c - a * &x - &x * b;
    Ok(&x + solve(&residual))
}

fn complex(m: &DMatrix<f64>) -> DMatrix<Complex64> {
    m.map(|v| Complex64::new(v, 0.0))
}
