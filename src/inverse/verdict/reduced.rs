//! The inequality `Q ⪰ 0` for a given R, in the least number of unknowns.
//!
//! In states with `B = [B₁; 0]` the equality `BᵀP = RK` fixes the first m rows of P, and Q is affine in the block Y
//! that is left: `Q = M₀(R) − HᵀYE − EᵀYH` with `E = [0 I]` and `H` the lower rows of A. In sampled time
//! `Q = M₀(R) + EᵀYE − HᵀYH`, which takes the same form in coordinates where `E + H = [0 I]`: that is Cayley's
//! transform `2s = (z − 1)/(z + 1)`. With `Φ = M₁₁`, `C = M₁₂`, `D = M₂₂` and `H = [A₂₁ A₂₂]` weights exist for R if
//! and only if `FᵀY + YF + YGY − D + CᵀΦ⁻¹C ⪯ 0` has a solution, where `F = A₂₂ − A₂₁Φ⁻¹C` and `G = A₂₁Φ⁻¹A₂₁ᵀ`; that
//! is where the frequency inequality `φ(s)ᴴ M₀ φ(s) ⪰ 0` with `φ(s) = [I; (s − A₂₂)⁻¹A₂₁]` holds on the whole axis.

use crate::control::lyapunov::Clock;
use crate::control::riccati::Riccati;
use crate::inverse::reach::Core;
use crate::num::linalg::{self, symmetric};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

/// Beyond this condition number of B₁, or in sampled time of A − BK, the reduction loses what it is about.
const SINGULAR: f64 = 1e12;

/// Corrections of P.
const CORRECTIONS: usize = 2;

/// What does not depend on R.
#[derive(Debug, Clone)]
pub(super) struct Reduced {
    pub ports: usize,
    /// H, (n − m)×n.
    h: DMatrix<f64>,
    /// Coordinates: `Q_there = TᵀQT`, n×n.
    pub coordinates: DMatrix<f64>,
    /// The lower rows of `Uᵀ`, so that P = P₀ + EᵀYE in the states of the core, (n − m)×n.
    embed: DMatrix<f64>,
    /// U, B₁⁻ᵀ and `K M⁻¹`, with M = I or A − BK.
    frame: DMatrix<f64>,
    inverse: DMatrix<f64>,
    gain: DMatrix<f64>,
    a: DMatrix<f64>,
    k: DMatrix<f64>,
    b: DMatrix<f64>,
    closed: DMatrix<f64>,
    clock: Clock,
    /// `W = TᵀT`, or with the weights of the states between.
    pub unit: DMatrix<f64>,
}

impl Reduced {
    /// `None` where B has dependent columns, or A − BK is singular in sampled time.
    pub(super) fn new(core: &Core) -> Option<Self> {
        let (n, m) = (core.states(), core.ports());
        if m > n {
            return None;
        }
        let (_, sigma, frame) = linalg::svd(&core.b.transpose()).ok()?;
        if sigma[m - 1] <= 0.0 || sigma[0] / sigma[m - 1] > SINGULAR {
            return None;
        }
        let upper = (frame.transpose() * &core.b).rows(0, m).into_owned();
        let inverse = upper.transpose().try_inverse()?;
        let closed = core.closed_loop();
        let gain = match core.clock {
            Clock::Continuous => core.k.clone(),
            Clock::Sampled => {
                let values = linalg::singular_values(&closed).ok()?;
                if values[n - 1] <= 0.0 || values[0] / values[n - 1] > SINGULAR {
                    return None;
                }
                closed.transpose().lu().solve(&core.k.transpose())?.transpose()
            }
        };
        let embed = frame.columns(m, n - m).transpose();
        let lower = &embed * &core.a * &frame;
        let (h, coordinates) = match core.clock {
            Clock::Continuous => (lower, frame.clone()),
            Clock::Sampled => {
                let mut identity = DMatrix::zeros(n - m, n);
                identity.view_mut((0, m), (n - m, n - m)).fill_with_identity();
                let (sum, difference) = (&identity + &lower, &identity - &lower);
                let turn = if n == m { DMatrix::identity(n, n) } else { cayley(&sum, n, m)? };
                ((difference * &turn) * -0.5, &frame * turn)
            }
        };
        let unit = coordinates.tr_mul(&coordinates);
        let (a, b, k, clock) = (core.a.clone(), core.b.clone(), core.k.clone(), core.clock);
        Some(Self { ports: m, h, coordinates, embed, frame, inverse, gain, a, k, b, closed, clock, unit })
    }

    /// `K`, in sampled time `K(A − BK)⁻¹`: `BᵀP = R·` this.
    pub(super) fn gain(&self) -> &DMatrix<f64> {
        &self.gain
    }

    /// The same with margins `Q ⪰ t·diag(d)`, d scaled to a mean of 1.
    pub(super) fn weighed(&self, d: &DVector<f64>) -> Self {
        let unit = self.coordinates.tr_mul(&(DMatrix::from_diagonal(&(d / d.mean())) * &self.coordinates));
        Self { unit: symmetric(&unit), ..self.clone() }
    }

    /// The part of P that R fixes, with Y = 0, in the states of the core.
    pub(super) fn fixed(&self, r: &DMatrix<f64>) -> DMatrix<f64> {
        self.embedded(&(r * &self.gain))
    }

    /// The least P with `BᵀP` these rows, m×n, as far as those allow a symmetric one.
    fn embedded(&self, rows: &DMatrix<f64>) -> DMatrix<f64> {
        let (n, m) = (self.frame.nrows(), self.ports);
        let rows = &self.inverse * rows * &self.frame;
        let mut p = DMatrix::zeros(n, n);
        p.view_mut((0, 0), (m, m)).copy_from(&symmetric(&rows.columns(0, m).into_owned()));
        p.view_mut((0, m), (m, n - m)).copy_from(&rows.columns(m, n - m));
        p.view_mut((m, 0), (n - m, m)).copy_from(&rows.columns(m, n - m).transpose());
        symmetric(&(&self.frame * p * self.frame.transpose()))
    }

    /// P with what it misses of `BᵀPM = RK` added: rounding in P counts, where it comes back through small singular
    /// values of B and M.
    fn corrected(&self, mut p: DMatrix<f64>, r: &DMatrix<f64>) -> DMatrix<f64> {
        for _ in 0..CORRECTIONS {
            let bp = self.b.tr_mul(&p);
            let rows = match self.clock {
                Clock::Continuous => r * &self.k - bp,
                Clock::Sampled => {
                    let missing = r * &self.k - bp * &self.closed;
                    let Some(solved) = self.closed.transpose().lu().solve(&missing.transpose()) else { break };
                    solved.transpose()
                }
            };
            p += self.embedded(&rows);
        }
        symmetric(&p)
    }

    /// `Q` of P and R by the closed loop, in the states of the core.
    pub(super) fn weight(&self, p: &DMatrix<f64>, r: &DMatrix<f64>) -> DMatrix<f64> {
        crate::inverse::space::state_weight(&self.a, &self.b, &self.k, p, r, self.clock)
    }

    /// M₀(R).
    pub(super) fn constant(&self, r: &DMatrix<f64>) -> DMatrix<f64> {
        let q = self.weight(&self.fixed(r), r);
        symmetric(&self.coordinates.tr_mul(&(q * &self.coordinates)))
    }

    /// φ at `s = jω` with orthonormal columns in the metric W, n×m; ω may be infinite.
    pub(super) fn direction(&self, omega: f64) -> Option<DMatrix<Complex64>> {
        let (n, m) = (self.frame.nrows(), self.ports);
        let complex = |v: f64| Complex64::new(v, 0.0);
        let phi = if omega.is_finite() && n > m {
            // The kernel of [A₂₁, A₂₂ − s]: what is left of all coordinates beside its rows. Solving for the lower part
            // would lose all but one column near a pole of A₂₂.
            let size = 1.0 + omega;
            let mut all = DMatrix::<Complex64>::zeros(n, 2 * n - m);
            for i in 0..n - m {
                for j in 0..n {
                    all[(j, i)] = complex(self.h[(i, j)] / size);
                }
                // The conjugate of −jω.
                all[(m + i, i)] += Complex64::new(0.0, omega / size);
            }
            all.view_mut((0, n - m), (n, n)).fill_with_identity();
            all.qr().q().columns(n - m, m).into_owned()
        } else {
            let mut phi = DMatrix::<Complex64>::zeros(n, m);
            phi.view_mut((0, 0), (m, m)).fill_with_identity();
            phi
        };
        if phi.iter().any(|v| !(v.re.is_finite() && v.im.is_finite())) {
            return None;
        }
        let gram = phi.adjoint() * self.unit.map(complex) * &phi;
        let gram = (&gram + gram.adjoint()) * complex(0.5);
        let factor = gram.cholesky()?.l();
        let turned = factor.solve_lower_triangular(&phi.adjoint())?;
        Some(turned.adjoint())
    }

    /// F, `A₂₁`, D − CᵀΦ⁻¹C and Φ of M₀; `None` where Φ is not definite.
    fn riccati(&self, m0: &DMatrix<f64>) -> Option<[DMatrix<f64>; 4]> {
        let (n, m) = (self.frame.nrows(), self.ports);
        let phi = symmetric(&m0.view((0, 0), (m, m)).into_owned());
        let factor = phi.clone().cholesky()?;
        let c = m0.view((0, m), (m, n - m)).into_owned();
        let solved = factor.solve(&c);
        let d = symmetric(&(m0.view((m, m), (n - m, n - m)) - c.tr_mul(&solved)));
        let a21 = self.h.columns(0, m).into_owned();
        let f = self.h.columns(m, n - m) - &a21 * solved;
        Some([f, a21, d, phi])
    }

    /// Frequencies between and at which `φᴴM₀φ` may lose its sign: imaginary parts of the eigenvalues of the
    /// Hamiltonian matrix that are on the axis to rounding, or near it.
    pub(super) fn crossings(&self, m0: &DMatrix<f64>) -> Option<Vec<f64>> {
        let (n, m) = (self.frame.nrows(), self.ports);
        if n == m {
            return Some(Vec::new());
        }
        let [f, a21, d, phi] = self.riccati(m0)?;
        let g = symmetric(&(&a21 * phi.cholesky()?.solve(&a21.transpose())));
        let size = n - m;
        // Y in units in which G and D are of one size.
        let ratio = d.norm() / g.norm();
        let rho = if ratio.is_normal() { ratio.sqrt() } else { 1.0 };
        let mut whole = DMatrix::zeros(2 * size, 2 * size);
        whole.view_mut((0, 0), (size, size)).copy_from(&f);
        whole.view_mut((0, size), (size, size)).copy_from(&(g * rho));
        whole.view_mut((size, 0), (size, size)).copy_from(&(d / rho));
        whole.view_mut((size, size), (size, size)).copy_from(&-f.transpose());
        let values = linalg::eigenvalues(&whole).ok()?;
        let mut found: Vec<f64> = values.iter().map(|v| v.im.abs()).collect();
        found.sort_by(f64::total_cmp);
        found.dedup_by(|x, y| (*x - *y).abs() <= 1e-12 * y.abs());
        Some(found)
    }

    /// P with `Q ⪰ t·unit` where M₀ is given less `t·unit`; `None` where no solution is found.
    pub(super) fn solve(&self, m0: &DMatrix<f64>, r: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let (n, m) = (self.frame.nrows(), self.ports);
        let fixed = self.fixed(r);
        if n == m {
            return Some(self.corrected(fixed, r));
        }
        let [f, a21, d, phi] = self.riccati(m0)?;
        let y = -Riccati::indefinite(&f, &a21, &d, &phi, Clock::Continuous).ok()?.solve().ok()?.p;
        Some(self.corrected(fixed + self.embed.tr_mul(&(y * &self.embed)), r))
    }

    /// `s = jω` as a point of the plant's own axis: jω, or on the unit circle.
    pub(super) fn point(&self, omega: f64) -> Complex64 {
        match self.clock {
            Clock::Continuous => Complex64::new(0.0, omega),
            Clock::Sampled if omega.is_infinite() => Complex64::new(-1.0, 0.0),
            Clock::Sampled => {
                let s = Complex64::new(0.0, 2.0 * omega);
                (s + 1.0) / (Complex64::new(1.0, 0.0) - s)
            }
        }
    }

    /// The same as a frequency: rad per unit of time, in sampled time per sample.
    pub(super) fn frequency(&self, omega: f64) -> f64 {
        match self.clock {
            Clock::Continuous => omega,
            Clock::Sampled => 2.0 * (2.0 * omega).atan(),
        }
    }

    /// Eigenvalues of A₂₂.
    pub(super) fn eigenvalues(&self) -> Result<Vec<Complex64>, linalg::NoConvergence> {
        let (n, m) = (self.frame.nrows(), self.ports);
        if n == m { Ok(Vec::new()) } else { linalg::eigenvalues(&self.h.columns(m, n - m).into_owned()) }
    }

    pub(super) fn clock(&self) -> Clock {
        self.clock
    }

    pub(super) fn closed_loop(&self) -> &DMatrix<f64> {
        &self.closed
    }
}

/// `W` with `SW = [0 I]`, for S of full row rank: its null space, and its right inverse.
fn cayley(sum: &DMatrix<f64>, n: usize, m: usize) -> Option<DMatrix<f64>> {
    let (u, values, v) = linalg::svd(sum).ok()?;
    let rank = n - m;
    if values[rank - 1] <= 0.0 || values[0] / values[rank - 1] > SINGULAR {
        return None;
    }
    let mut turn = DMatrix::zeros(n, n);
    turn.columns_mut(0, m).copy_from(&v.columns(rank, m));
    let scaled = DMatrix::from_fn(rank, rank, |i, j| u[(j, i)] / values[i]);
    turn.columns_mut(m, rank).copy_from(&(v.columns(0, rank) * scaled));
    Some(turn)
}
