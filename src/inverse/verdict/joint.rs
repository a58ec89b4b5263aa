//! A certificate for all gains of the box at once: Q and R give way together.
//!
//! With the closed loop `A_c = A − BK` let `Q = −A_cᵀP − PA_c − KᵀRK` (`P − A_cᵀPA_c − KᵀRK` in sampled time), so that
//! P follows from Q and R, and the equality `BᵀPM = RK` (M = I, in sampled time A_c) is a linear one in Q and R alone.
//! What a change of the data makes it miss is taken up by the least change of Q and R, measured in units of Q and R
//! themselves (`Q = LLᵀ`, `L⁻¹ΔQL⁻ᵀ`). Where that least change stays below one for the whole box, every gain of the box
//! has definite weights.
//!
//! The forms of [`PrimalTest`](super::certificate::PrimalTest) keep R and let P alone give way. With cheap control in
//! sampled time R is a small difference of `R + BᵀPB` and `BᵀPB`, and P would have to move by more than the whole of R;
//! here both move by little.

use crate::control::lyapunov::{Clock, Lyapunov};
use crate::convex::svec::{length, smat, svec};
use crate::inverse::reach::Core;
use crate::inverse::rounding::UNIT;
use crate::inverse::space::state_weight;
use crate::num::linalg::{self, symmetric};
use nalgebra::{DMatrix, DVector};

/// Entries of the gain up to which the equality is decomposed.
const ENTRIES: usize = 160;
/// Units of rounding, times the number of unknowns, below which a singular value of the equality is taken for zero.
const NOISE: f64 = 16.0;
/// Share of R by which it may move.
const INPUTS: f64 = 0.5;

/// What the least change of Q and R for a box is made of.
pub(super) struct Joint<'a> {
    core: &'a Core,
    /// Q, and the inverse of its Cholesky factor, entry by entry without signs.
    pub q: DMatrix<f64>,
    whiten: DMatrix<f64>,
    /// From what the equality misses, column by column, to the change of Q and R in their own units.
    response: DMatrix<f64>,
    /// What the equality misses through A, B and the evaluation, m×n, and through K: `|R|` or `|R + BᵀPB|`.
    missing: DMatrix<f64>,
    weight: DMatrix<f64>,
    /// How far A and B move Q where P and R are held.
    direct: DMatrix<f64>,
}

/// The lower Cholesky factor.
fn factor(m: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    m.clone().cholesky().map(|c| c.l())
}

impl<'a> Joint<'a> {
    /// `None` where P and R prove nothing: Q or R is not definite, or the equality binds Q and R in more ways than they
    /// can follow.
    pub(super) fn new(core: &'a Core, p: &DMatrix<f64>, r: &DMatrix<f64>) -> Option<Self> {
        let Core { a, b, k, clock, rounding } = core;
        let (m, n) = k.shape();
        if m * n > ENTRIES {
            return None;
        }
        let closed = core.closed_loop();
        let q = state_weight(a, b, k, p, r, *clock);
        let (root_q, root_r) = (factor(&q)?, factor(r)?);
        let whiten = root_q.clone().try_inverse()?.abs();
        let (bp, abs_p, abs_k) = (b.tr_mul(p), p.abs(), k.abs());
        let shifted = |m: &DMatrix<f64>| match clock {
            Clock::Continuous => m.clone(),
            Clock::Sampled => m * &closed,
        };
        let residual = (shifted(&bp) - r * k).abs();
        let own = UNIT * 4.0 * n as f64;
        let products = b.abs().tr_mul(&abs_p);
        let products = if *clock == Clock::Sampled { products * closed.abs() } else { products };
        let evaluated = (products + r.abs() * &abs_k) * own;
        let plant = &rounding.a + &rounding.b * &abs_k;
        let (through, weight, held) = match clock {
            Clock::Continuous => (rounding.b.tr_mul(&abs_p), r.abs(), &abs_p * &plant),
            Clock::Sampled => {
                let pc = p * &closed;
                let through = bp.abs() * &plant + rounding.b.tr_mul(&pc.abs());
                (through, (r + &bp * b).abs(), pc.abs().tr_mul(&plant))
            }
        };
        let sizes = match clock {
            Clock::Continuous => &abs_p * closed.abs() * 2.0,
            Clock::Sampled => &abs_p + closed.abs().tr_mul(&(&abs_p * closed.abs())),
        };
        let direct = &held + held.transpose() + (sizes + abs_k.tr_mul(&(r.abs() * &abs_k))) * own;
        let equation = Lyapunov::new(&closed, *clock).ok()?;
        let (of_q, of_r) = (length(n), length(m));
        let mut map = DMatrix::zeros(m * n, of_q + of_r);
        let right = match clock {
            Clock::Continuous => DMatrix::identity(n, n),
            Clock::Sampled => closed.clone(),
        };
        for (row, (i, j)) in (0..n).flat_map(|j| (0..m).map(move |i| (i, j))).enumerate() {
            // Entry (i, j) of BᵀΔPM is ⟨G, ΔP⟩, and ΔP solves the equation of the loop: the adjoint solves it for G.
            let entry = b.column(i) * right.column(j).transpose();
            let y = equation.solve_adjoint(&symmetric(&entry));
            map.view_mut((row, 0), (1, of_q)).copy_from(&svec(&symmetric(&(root_q.tr_mul(&y) * &root_q))).transpose());
            let mut of_weight = k * &y * k.transpose();
            for at in 0..m {
                of_weight[(i, at)] -= k[(at, j)];
            }
            let own = root_r.tr_mul(&symmetric(&of_weight)) * &root_r;
            map.view_mut((row, of_q), (1, of_r)).copy_from(&svec(&symmetric(&own)).transpose());
        }
        let missing = residual + evaluated + through;
        // In units of what is to be taken up, so that the decomposition resolves every row of it.
        let unit = (&missing + &weight * &rounding.k).map(|v| v.max(f64::MIN_POSITIVE));
        let unit = DVector::from_column_slice(unit.as_slice());
        for (mut row, unit) in map.row_iter_mut().zip(unit.iter()) {
            row /= *unit;
        }
        let (u, values, v) = linalg::svd(&map).ok()?;
        let count = m * n;
        let least = *values.get(count - 1)?;
        if !(least > NOISE * UNIT * (of_q + of_r) as f64 * values[0]) {
            return None;
        }
        let scaled = DMatrix::from_fn(count, count, |i, j| u[(j, i)] / (values[i] * unit[j]));
        let response = v.columns(0, count) * scaled;
        Some(Self { core, q, whiten, response, missing, weight, direct })
    }

    /// One over the largest change of Q in its own units for any gain of the box; R may move by half of itself.
    pub(super) fn ratio(&self, box_k: &DMatrix<f64>) -> f64 {
        let (m, n) = self.core.k.shape();
        let missing = &self.missing + &self.weight * box_k;
        let change = self.response.abs() * DVector::from_column_slice(missing.as_slice());
        let largest = |m: &DMatrix<f64>| m.symmetric_eigenvalues().max();
        let of_q = length(n);
        let states = smat(change.rows(0, of_q).clone_owned().as_slice(), n);
        let inputs = smat(change.rows(of_q, length(m)).clone_owned().as_slice(), m);
        // To first order a change of K does not move Q where P and R are held: what is left is its square.
        let direct = &self.direct + box_k.tr_mul(&(&self.weight * box_k));
        let states = states + &self.whiten * direct * self.whiten.transpose();
        (1.0 / largest(&states)).min(INPUTS / largest(&inputs))
    }
}
