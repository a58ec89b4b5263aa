//! Certificates for several inputs, which alone decide. Whatever found them is not believed.
//!
//! **Primal.** For symmetric P and R ≻ 0 the gain `K' = R⁻¹BᵀP` (`(R + BᵀPB)⁻¹BᵀPA`) is optimal for
//! `Q' = K'ᵀRK' − AᵀP − PA` (`P − AᵀPA + K'ᵀ(R + BᵀPB)K'`). Where K' lies within the rounding of K and Q' ≻ 0 by more
//! than the rounding of the data moves it, weights exist.
//!
//! **Dual.** For any N (m×n) let X solve `A_cX + XA_cᵀ = BN + NᵀBᵀ` (`X = A_cXA_cᵀ − BNA_cᵀ − A_cNᵀBᵀ`), A_c = A − BK,
//! and `T = KXKᵀ + NKᵀ + KNᵀ`. Then `⟨X, Q⟩ = −⟨R, T⟩` for all weights that satisfy the equalities. Where X ≻ 0 and
//! `ρ tr T + m(1 − ρ)λ_min(T) > 0`, no Q ⪰ 0 goes with any `R ⪰ ρI` of trace m.

use crate::control::lyapunov::{Clock, Lyapunov};
use crate::convex::svec;
use crate::inverse::reach::Core;
use crate::inverse::rounding::UNIT;
use crate::inverse::space::state_weight;
use crate::num::linalg::{self, solve_symmetric, symmetric};
use nalgebra::{Cholesky, DMatrix, DVector};
use std::f64::consts::SQRT_2;

/// R counts as definite where its least eigenvalue is above this share of its mean (in balanced inputs).
pub(super) const FLOOR: f64 = 1e-6;
/// How much a margin must exceed what rounding moves.
pub(super) const CLEAR: f64 = 1.0;

/// Weights that prove "feasible", in the units of the core.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Primal {
    pub p: DMatrix<f64>,
    pub r: DMatrix<f64>,
    pub q: DMatrix<f64>,
    /// How many times its rounding the least eigenvalue of Q is, scaled to a unit diagonal.
    pub ratio: f64,
}

/// What is needed of the data to bound ΔQ.
pub(super) struct PrimalTest<'a> {
    core: &'a Core,
    /// |B⁺|ᵀ, n×m.
    pseudo: DMatrix<f64>,
    /// |A⁻¹| or |A_c⁻¹| in sampled time, whichever is smaller.
    inverse: Option<DMatrix<f64>>,
}

fn definite(m: &DMatrix<f64>) -> Option<Cholesky<f64, nalgebra::Dyn>> {
    m.clone().cholesky()
}

impl<'a> PrimalTest<'a> {
    pub(super) fn new(core: &'a Core) -> Option<Self> {
        let pseudo = core.b.clone().pseudo_inverse(UNIT * core.b.norm()).ok()?.transpose().abs();
        let inverse = match core.clock {
            Clock::Continuous => None,
            Clock::Sampled => {
                let closed = core.closed_loop().try_inverse();
                let open = core.a.clone().try_inverse();
                let smaller = match (closed, open) {
                    (Some(x), Some(y)) => Some(if x.norm() < y.norm() { x } else { y }),
                    (x, y) => x.or(y),
                };
                Some(smaller?.abs())
            }
        };
        Some(Self { core, pseudo, inverse })
    }

    /// How far R is from one that `RM = MᵀR` holds for exactly, with `M = KB` (`K(A − BK)⁻¹B`): the symmetric matrices go
    /// onto the antisymmetric ones under `R ↦ RM − MᵀR` where M has distinct eigenvalues.
    fn asymmetry(&self, r: &DMatrix<f64>) -> Option<f64> {
        let Core { b, k, clock, .. } = self.core;
        let m = r.nrows();
        if m == 1 {
            return Some(0.0);
        }
        let product = match clock {
            Clock::Continuous => k * b,
            Clock::Sampled => k * self.core.closed_loop().lu().solve(b)?,
        };
        let map = asymmetry_map(&product);
        let values = linalg::singular_values(&map).ok()?;
        let half = r * &product;
        let rounded = 4.0 * (b.nrows() as f64) * UNIT * r.norm() * k.norm() * b.norm();
        let found =
            (&half - half.transpose()).norm() + if *clock == Clock::Continuous { rounded } else { 4.0 * rounded };
        let least = *values.last()?;
        (least > 0.0).then(|| found / least)
    }

    /// The certificate of P and R; `None` where they prove nothing.
    pub(super) fn check(&self, p: &DMatrix<f64>, r: &DMatrix<f64>) -> Option<Primal> {
        self.check_within(p, r, &self.core.rounding.k).filter(|found| found.ratio > CLEAR)
    }

    /// The same with another box of K; the ratio may be below 1.
    pub(super) fn check_within(&self, p: &DMatrix<f64>, r: &DMatrix<f64>, box_k: &DMatrix<f64>) -> Option<Primal> {
        let Core { a, b, k, clock, rounding } = self.core;
        let values = r.symmetric_eigenvalues();
        if values.min() < FLOOR * values.mean() {
            return None;
        }
        let bp = b.tr_mul(p);
        let (weight, right) = match clock {
            Clock::Continuous => (r.clone(), bp),
            Clock::Sampled => (symmetric(&(r + &bp * b)), &bp * a),
        };
        definite(&weight)?;
        let k_there = solve_symmetric(&weight, &right);
        let is_near = (&k_there - k).iter().zip(rounding.k.iter()).all(|(d, bound)| d.abs() <= *bound);
        // Otherwise K itself, with R moved so that P exists exactly, and P with it.
        let (gain, moved_r, missing) = if is_near {
            (k_there, 0.0, DMatrix::zeros(k.nrows(), k.ncols()))
        } else {
            (k.clone(), self.asymmetry(r)?, (&right - &weight * k).abs())
        };
        if moved_r > 0.1 * values.min() || gain.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let q = state_weight(a, b, &gain, p, r, *clock);
        let (abs_p, abs_k, abs_w) = (p.abs(), k.abs(), weight.abs());
        let in_r = DMatrix::from_element(r.nrows(), r.nrows(), moved_r);
        let missing = missing + &in_r * &abs_k;
        let moved = match clock {
            Clock::Continuous => {
                let e = &abs_w * box_k + rounding.b.tr_mul(&abs_p) + missing;
                let dp = &self.pseudo * e;
                let dp = &dp + dp.transpose();
                let gain = box_k.tr_mul(&(&abs_w * &abs_k));
                let plant = rounding.a.tr_mul(&abs_p) + a.abs().tr_mul(&dp);
                &gain + gain.transpose() + &plant + plant.transpose()
            }
            Clock::Sampled => {
                let abs_a = a.abs();
                let abs_b = b.abs();
                let bpa = abs_b.tr_mul(&(&abs_p * &rounding.a)) + rounding.b.tr_mul(&(&abs_p * &abs_a));
                let e = (&abs_w * box_k + bpa + missing) * self.inverse.as_ref()?;
                let dp = &self.pseudo * e;
                let dp = &dp + dp.transpose();
                let gain = box_k.tr_mul(&(&abs_w * &abs_k));
                let plant = rounding.a.tr_mul(&(&abs_p * &abs_a));
                let through_b = abs_b.transpose() * &dp * &abs_b + {
                    let one = rounding.b.tr_mul(&(&abs_p * &abs_b));
                    &one + one.transpose()
                };
                let closed = (a - b * k).abs();
                &gain
                    + gain.transpose()
                    + &plant
                    + plant.transpose()
                    + &dp
                    + closed.tr_mul(&(&dp * &closed))
                    + abs_k.tr_mul(&(through_b * &abs_k))
            }
        };
        let moved = moved + abs_k.tr_mul(&(in_r * &abs_k));
        let d = q.diagonal();
        if d.iter().any(|v| v.is_nan() || *v <= 0.0) {
            return Some(Primal { p: p.clone(), r: r.clone(), q, ratio: 0.0 });
        }
        let scaled = |m: &DMatrix<f64>| DMatrix::from_fn(d.len(), d.len(), |i, j| m[(i, j)] / (d[i] * d[j]).sqrt());
        let least = scaled(&q).symmetric_eigenvalues().min();
        let bound = scaled(&moved).norm();
        Some(Primal { p: p.clone(), r: r.clone(), q, ratio: least / bound })
    }
}

/// The matrix of `R ↦ RM − MᵀR` from the coordinates of symmetric matrices (√2 off the diagonal) to those of
/// antisymmetric ones.
pub(super) fn asymmetry_map(product: &DMatrix<f64>) -> DMatrix<f64> {
    let m = product.nrows();
    let mut map = DMatrix::zeros(m * (m - 1) / 2, svec::length(m));
    for at in 0..svec::length(m) {
        let mut unit = vec![0.0; svec::length(m)];
        unit[at] = 1.0;
        let half = svec::smat(&unit, m) * product;
        let mut row = 0;
        for j in 0..m {
            for i in 0..j {
                map[(row, at)] = SQRT_2 * (half[(i, j)] - half[(j, i)]);
                row += 1;
            }
        }
    }
    map
}

/// A multiplier that proves "infeasible", in the units of the core.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Dual {
    /// N, m×n.
    pub n: DMatrix<f64>,
    /// `ρ tr T + m(1 − ρ)λ_min(T)` over what rounding moves it.
    pub ratio: f64,
    /// The relative change of K up to which it holds.
    pub change: Option<f64>,
}

/// A multiplier with what its test needs.
pub(super) struct Prepared {
    pub n: DMatrix<f64>,
    x: DMatrix<f64>,
    size_x: f64,
    size_n: f64,
    residual: f64,
    /// `ρ tr T + m(1 − ρ)λ_min(T)`.
    margin: f64,
}

/// What a dual test needs of the loop.
pub(super) struct DualTest<'a> {
    core: &'a Core,
    closed: DMatrix<f64>,
    lyapunov: Lyapunov,
    /// H of `A_cH + HA_cᵀ + I = 0` (`H = A_cHA_cᵀ + I`).
    unit: DMatrix<f64>,
    /// `‖KHKᵀ‖`.
    unit_gain: f64,
}

impl<'a> DualTest<'a> {
    pub(super) fn new(core: &'a Core) -> Option<Self> {
        let closed = core.closed_loop();
        let lyapunov = Lyapunov::new(&closed, core.clock).ok()?;
        let n = core.states();
        let unit = lyapunov.solve_adjoint(&DMatrix::identity(n, n));
        let unit_gain = symmetric(&(&core.k * &unit * core.k.transpose())).symmetric_eigenvalues().amax();
        Some(Self { core, closed, lyapunov, unit, unit_gain })
    }

    /// The right side of the equation of X.
    fn source(&self, n: &DMatrix<f64>) -> DMatrix<f64> {
        let half = match self.core.clock {
            Clock::Continuous => &self.core.b * n,
            Clock::Sampled => &self.core.b * n * self.closed.transpose(),
        };
        -(&half + half.transpose())
    }

    /// X of a multiplier.
    pub(super) fn states(&self, n: &DMatrix<f64>) -> DMatrix<f64> {
        self.lyapunov.solve_adjoint(&self.source(n))
    }

    /// T of a multiplier with its X.
    pub(super) fn inputs(&self, n: &DMatrix<f64>, x: &DMatrix<f64>) -> DMatrix<f64> {
        let k = &self.core.k;
        let half = n * k.transpose();
        symmetric(&(k * x * k.transpose() + &half + half.transpose()))
    }

    /// X and T of a multiplier, and the residual of its equation.
    pub(super) fn prepared(&self, n: &DMatrix<f64>) -> Prepared {
        let Core { b, clock, .. } = self.core;
        let x = self.states(n);
        let (size, size_x, size_n) = (self.closed.norm(), x.norm(), n.norm());
        let order = x.nrows() as f64;
        let (left, sizes) = match clock {
            Clock::Continuous => {
                let product = &self.closed * &x;
                (&product + product.transpose() + self.source(n), size * size_x + b.norm() * size_n)
            }
            Clock::Sampled => {
                let moved = &self.closed * &x * self.closed.transpose();
                (moved - &x + self.source(n), size * size * size_x + size_x + b.norm() * size_n * size)
            }
        };
        let t = self.inputs(n, &x);
        let margin = {
            let m = t.nrows() as f64;
            FLOOR * t.trace() + m * (1.0 - FLOOR) * t.symmetric_eigenvalues().min()
        };
        Prepared { size_x, size_n, residual: left.norm() + order * UNIT * 4.0 * sizes, margin, x, n: n.clone() }
    }

    /// The margin of a multiplier over its rounding, with a box of K; `None` where X is not definite for all of it.
    pub(super) fn ratio(&self, of: &Prepared, box_k: &DMatrix<f64>) -> Option<f64> {
        let Core { a, b, k, clock, rounding } = self.core;
        let (m, order) = (k.nrows() as f64, a.nrows() as f64);
        let Prepared { size_x, size_n, residual, margin, x, .. } = of;
        let closed_change = (&rounding.a + b.abs() * box_k + &rounding.b * k.abs()).norm();
        let (size_k, change_b, size) = (k.norm(), rounding.b.norm(), self.closed.norm());
        // What X solves with a residual, for every plant and gain of the box: |ΔX| ⪯ e·H, to first order in H.
        let (change, own) = match clock {
            Clock::Continuous => (2.0 * (change_b * size_n + closed_change * size_x), 1.0),
            Clock::Sampled => {
                let loop_ = (2.0 * size + closed_change) * closed_change * size_x;
                (loop_ + 2.0 * size_n * (change_b * size + b.norm() * closed_change), size)
            }
        };
        let drift = 2.0 * closed_change * self.unit.norm() * own;
        if drift >= 0.5 {
            return None;
        }
        let e = (residual + change) / (1.0 - drift);
        // X ≻ eH, by Cholesky of the difference, whose own rounding is in the residual.
        definite(&(x - &self.unit * (e * (1.0 + 4.0 * order * UNIT))))?;
        let change_k = box_k.norm();
        let inputs = e * self.unit_gain
            + change_k * (2.0 * size_k + change_k) * size_x
            + 2.0 * change_k * size_n
            + 8.0 * order * UNIT * (size_k * size_k * size_x + 2.0 * size_n * size_k);
        // A change of T by a matrix of norm d moves both parts by m·d together at most.
        Some(margin / (m * inputs))
    }

    /// N with an antisymmetric Ω more, which leaves X as it is, so that T comes as near as possible to a wanted one.
    pub(super) fn turned(&self, n: &DMatrix<f64>, wanted: &DMatrix<f64>) -> DMatrix<f64> {
        let m = self.core.ports();
        let shift = match self.core.clock {
            Clock::Continuous => self.core.b.transpose(),
            Clock::Sampled => {
                let Some(solved) = self.closed.clone().lu().solve(&self.core.b) else { return n.clone() };
                solved.transpose()
            }
        };
        let product = &shift * self.core.k.transpose();
        let x = self.states(n);
        let missing = wanted - self.inputs(n, &x);
        let pairs: Vec<(usize, usize)> = (0..m).flat_map(|j| (0..j).map(move |i| (i, j))).collect();
        if pairs.is_empty() {
            return n.clone();
        }
        let image = |&(i, j): &(usize, usize)| {
            let mut omega = DMatrix::<f64>::zeros(m, m);
            omega[(i, j)] = 1.0;
            omega[(j, i)] = -1.0;
            let half = omega * &product;
            (&half + half.transpose()).as_slice().to_vec()
        };
        let columns: Vec<f64> = pairs.iter().flat_map(image).collect();
        let matrix = DMatrix::from_vec(m * m, pairs.len(), columns);
        let Ok((u, values, v)) = linalg::svd(&matrix) else { return n.clone() };
        let right = u.tr_mul(&DVector::from_column_slice(missing.as_slice()));
        let mut omega = DMatrix::<f64>::zeros(m, m);
        for (at, value) in values.iter().enumerate().filter(|(_, v)| **v > 1e-14 * values[0].max(f64::MIN_POSITIVE)) {
            for (row, (i, j)) in pairs.iter().enumerate() {
                let entry = v[(row, at)] * right[at] / value;
                omega[(*i, *j)] += entry;
                omega[(*j, *i)] -= entry;
            }
        }
        n + omega * shift
    }
}
