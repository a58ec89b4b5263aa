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
    basis: Basis,
    clock: Clock,
}

/// The unitary U of the Schur form in real and imaginary parts: products of real matrices are many times as fast as
/// those of complex ones here.
#[derive(Debug, Clone)]
struct Basis {
    re: DMatrix<f64>,
    im: DMatrix<f64>,
    re_transposed: DMatrix<f64>,
    im_transposed: DMatrix<f64>,
}

impl Basis {
    fn new(u: &DMatrix<Complex64>) -> Self {
        let (re, im) = (u.map(|v| v.re), u.map(|v| v.im));
        Self { re_transposed: re.transpose(), im_transposed: im.transpose(), re, im }
    }

    /// `UᴴQU`.
    fn rotated(&self, q: &DMatrix<f64>) -> DMatrix<Complex64> {
        let (re, im) = (q * &self.re, q * &self.im);
        let real = &self.re_transposed * &re + &self.im_transposed * &im;
        let imaginary = &self.re_transposed * im - &self.im_transposed * re;
        real.zip_map(&imaginary, Complex64::new)
    }

    /// `Re UYUᴴ`.
    fn back(&self, y: &DMatrix<Complex64>) -> DMatrix<f64> {
        let (re, im) = (y.map(|v| v.re), y.map(|v| v.im));
        let real = &self.re * &re - &self.im * &im;
        let imaginary = &self.re * im + &self.im * re;
        real * &self.re_transposed + imaginary * &self.im_transposed
    }
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
        Ok(Self { a: a.clone(), basis: Basis::new(&schur.u), schur, clock })
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
            Clock::Continuous => self.a.transpose() * &x + &x * &self.a + q,
            Clock::Sampled => self.a.transpose() * (&x * &self.a) - &x + q,
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

    /// `TᴴY + YT = −C` (`TᴴYT − Y = −C`), column by column from the left, each from the top.
    fn raw(&self, q: &DMatrix<f64>) -> DMatrix<f64> {
        let t = &self.schur.t;
        let n = t.nrows();
        let c = self.basis.rotated(q);
        let mut y = DMatrix::<Complex64>::zeros(n, n);
        let (mut sum, mut column) = (vec![ZERO; n], vec![ZERO; n]);
        for j in 0..n {
            sum.fill(ZERO);
            for k in 0..j {
                add_scaled(&mut sum, &y.as_slice()[k * n..(k + 1) * n], t[(k, j)]);
            }
            let diagonal = t[(j, j)];
            column.fill(ZERO);
            for i in 0..n {
                let of_t = &t.as_slice()[i * n..i * n + i];
                let left = t[(i, i)].conj();
                column[i] = match self.clock {
                    Clock::Continuous => {
                        let above = conjugate_dot(of_t, &column[..i]);
                        -(c[(i, j)] + sum[i] + above) / (left + diagonal)
                    }
                    Clock::Sampled => {
                        // The product of Tᴴ with the columns to the left and what is known of this one.
                        let above = conjugate_dot(of_t, &sum[..i]) + conjugate_dot(of_t, &column[..i]) * diagonal;
                        -(c[(i, j)] + above + left * sum[i]) / (left * diagonal - 1.0)
                    }
                };
            }
            y.as_mut_slice()[j * n..(j + 1) * n].copy_from_slice(&column);
        }
        self.basis.back(&y)
    }

    /// `TY + YTᴴ = −C` (`TYTᴴ − Y = −C`), column by column from the right, each from the bottom.
    fn raw_adjoint(&self, q: &DMatrix<f64>) -> DMatrix<f64> {
        let t = &self.schur.t;
        let n = t.nrows();
        let c = self.basis.rotated(q);
        let mut y = DMatrix::<Complex64>::zeros(n, n);
        let mut sum = vec![ZERO; n];
        for j in (0..n).rev() {
            sum.fill(ZERO);
            for k in j + 1..n {
                add_scaled(&mut sum, &y.as_slice()[k * n..(k + 1) * n], t[(j, k)].conj());
            }
            let diagonal = t[(j, j)].conj();
            let right: Vec<Complex64> = (0..n).map(|i| c[(i, j)]).collect();
            let column = match self.clock {
                Clock::Continuous => {
                    let right = right.iter().zip(&sum).map(|(c, s)| -(c + s)).collect();
                    upper(t, right, |t_ii| t_ii + diagonal, ONE)
                }
                Clock::Sampled => {
                    let mut right: Vec<Complex64> = right.iter().map(|c| -c).collect();
                    for (k, s) in sum.iter().enumerate() {
                        add_scaled(&mut right[..=k], &t.as_slice()[k * n..=k * n + k], -*s);
                    }
                    upper(t, right, |t_ii| t_ii * diagonal - 1.0, diagonal)
                }
            };
            y.as_mut_slice()[j * n..(j + 1) * n].copy_from_slice(&column);
        }
        self.basis.back(&y)
    }
}

const ZERO: Complex64 = Complex64::new(0.0, 0.0);
const ONE: Complex64 = Complex64::new(1.0, 0.0);

/// `sum += x·factor`.
fn add_scaled(sum: &mut [Complex64], x: &[Complex64], factor: Complex64) {
    for (s, v) in sum.iter_mut().zip(x) {
        *s += v * factor;
    }
}

/// `Σ x̄_i y_i`.
fn conjugate_dot(x: &[Complex64], y: &[Complex64]) -> Complex64 {
    x.iter().zip(y).map(|(x, y)| x.conj() * y).sum()
}

/// y with `d(t_ii)·y_i + factor·Σ_{k>i} t_ik y_k = right_i`, T upper triangular: from the bottom, column by column of
/// T.
fn upper(
    t: &DMatrix<Complex64>,
    mut right: Vec<Complex64>,
    divisor: impl Fn(Complex64) -> Complex64,
    factor: Complex64,
) -> Vec<Complex64> {
    let n = t.nrows();
    for k in (0..n).rev() {
        right[k] /= divisor(t[(k, k)]);
        let value = right[k] * -factor;
        add_scaled(&mut right[..k], &t.as_slice()[k * n..k * n + k], value);
    }
    right
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
