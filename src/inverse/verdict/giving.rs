//! How far definite weights may give way to what the data may be, direction by direction.
//!
//! With the closed loop `A_c = A − BK` let `Q = −A_cᵀP − PA_c − KᵀRK` (`P − A_cᵀPA_c − KᵀRK` in sampled time). To first
//! order a change of K does not move Q where P and R are held; but the equality `BᵀPM = RK` (M = I, in sampled time
//! A_c) is then missed, entry by entry, and P, or P and R, must follow. The change of Q is measured in units of Q
//! itself (`Q = LLᵀ`, `L⁻¹ΔQL⁻ᵀ`), and is linear in what is missed: signs are given up for the entries of the gain,
//! not for the factors of a product.
//!
//! - **Held inputs**: R stays, and P follows by `ΔP = g fᵀ + f gᵀ` for each entry, g a row of B⁺; what that makes of Q
//!   is a sum of such products, and has a majorant ([`super::majorant`]).
//! - **Jointly**: Q and R follow together by the least change in units of both. With cheap control in sampled time R is
//!   a small difference of `R + BᵀPB` and `BᵀPB`, and P alone would have to move by more than all of R. Where that
//!   least change stays below one, every gain of the box has definite weights.

use super::majorant;
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

/// Weights and what the box makes of them.
pub(super) struct Giving<'a> {
    core: &'a Core,
    closed: DMatrix<f64>,
    pub q: DMatrix<f64>,
    root_q: DMatrix<f64>,
    root_r: DMatrix<f64>,
    /// L⁻¹.
    whiten: DMatrix<f64>,
    /// What the equality misses through A, B and the evaluation, m×n, and through K: `|R|` or `|R + BᵀPB|`.
    missing: DMatrix<f64>,
    weight: DMatrix<f64>,
    /// Majorant of how far A and B move Q where P and R are held, in units of Q.
    direct: DMatrix<f64>,
}

/// From what the equality misses, entry by entry, to the change of Q and R in their own units.
pub(super) enum Response {
    /// R is held: entry (i, j) moves Q by `±(g_i h_jᵀ + h_j g_iᵀ)`, summed over the pairs G (n×m), H (n×n).
    Held([[DMatrix<f64>; 2]; 2]),
    /// Q and R follow, without signs.
    Joint {
        /// n² × mn.
        states: DMatrix<f64>,
        /// m² × mn.
        inputs: DMatrix<f64>,
    },
}

/// The lower Cholesky factor.
fn factor(m: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    m.clone().cholesky().map(|c| c.l())
}

impl<'a> Giving<'a> {
    /// `None` where P and R prove nothing: Q or R is not definite.
    pub(super) fn new(core: &'a Core, p: &DMatrix<f64>, r: &DMatrix<f64>) -> Option<Self> {
        let Core { a, b, k, clock, rounding } = core;
        let n = core.states();
        let closed = core.closed_loop();
        let q = state_weight(a, b, k, p, r, *clock);
        let (root_q, root_r) = (factor(&q)?, factor(r)?);
        let whiten = root_q.clone().try_inverse()?;
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
            Clock::Continuous => (rounding.b.tr_mul(&abs_p), r.abs(), p.clone()),
            Clock::Sampled => {
                let pc = p * &closed;
                let through = bp.abs() * &plant + rounding.b.tr_mul(&pc.abs());
                (through, (r + &bp * b).abs(), pc.transpose())
            }
        };
        let sizes = match clock {
            Clock::Continuous => &abs_p * closed.abs() * 2.0,
            Clock::Sampled => &abs_p + closed.abs().tr_mul(&(&abs_p * closed.abs())),
        };
        // Q moves by −ΔA_cᵀP − PΔA_c (−ΔA_cᵀPA_c − A_cᵀPΔA_c) with ΔA_c = ΔA − ΔBK.
        let held = &whiten * held;
        let direct = majorant::products(&rounding.a, &held, &whiten)
            + majorant::products(&rounding.b, &held, &(&whiten * k.transpose()))
            + majorant::entries(&((sizes + abs_k.tr_mul(&(r.abs() * &abs_k))) * own).map(f64::abs), &whiten);
        let missing = residual + evaluated + through;
        Some(Self { core, closed, q, root_q, root_r, whiten, missing, weight, direct })
    }

    /// P follows and R is held.
    pub(super) fn held(&self) -> Option<Response> {
        let Self { core: Core { b, clock, .. }, closed, whiten, .. } = self;
        let n = b.nrows();
        let pseudo = b.clone().pseudo_inverse(UNIT * b.norm()).ok()?;
        let right = match clock {
            Clock::Continuous => DMatrix::identity(n, n),
            Clock::Sampled => closed.clone().try_inverse()?,
        };
        // Of the rows of M⁻¹ the part in range(B) is symmetric with R held; the rest of P takes the others.
        let rows = right.transpose();
        let g = pseudo.transpose();
        let h = &rows - b * (&pseudo * &rows) * 0.5;
        let (in_g, in_h) = (whiten * &g, whiten * &h);
        let (past_g, past_h) = (whiten * closed.tr_mul(&g), whiten * closed.tr_mul(&h));
        Some(Response::Held(match clock {
            // −A_cᵀΔP − ΔPA_c
            Clock::Continuous => [[past_g, in_h], [in_g, past_h]],
            // ΔP − A_cᵀΔPA_c
            Clock::Sampled => [[in_g, in_h], [past_g, past_h]],
        }))
    }

    /// P and R follow together; `None` for large gains, and where the equality binds Q and R in more ways than they can
    /// follow.
    pub(super) fn joint(&self) -> Option<Response> {
        let Core { b, k, clock, rounding, .. } = self.core;
        let (m, n) = k.shape();
        if m * n > ENTRIES {
            return None;
        }
        let Self { closed, root_q, root_r, missing, weight, .. } = self;
        let equation = Lyapunov::new(closed, *clock).ok()?;
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
            map.view_mut((row, 0), (1, of_q)).copy_from(&svec(&symmetric(&(root_q.tr_mul(&y) * root_q))).transpose());
            let mut of_weight = k * &y * k.transpose();
            for at in 0..m {
                of_weight[(i, at)] -= k[(at, j)];
            }
            let own = root_r.tr_mul(&symmetric(&of_weight)) * root_r;
            map.view_mut((row, of_q), (1, of_r)).copy_from(&svec(&symmetric(&own)).transpose());
        }
        // In units of what is to be taken up, so that the decomposition resolves every row of it.
        let unit = (missing + weight * &rounding.k).map(|v| v.max(f64::MIN_POSITIVE));
        let unit = DVector::from_column_slice(unit.as_slice());
        for (mut row, unit) in map.row_iter_mut().zip(unit.iter()) {
            row /= *unit;
        }
        let (u, values, v) = linalg::svd(&map).ok()?;
        let count = m * n;
        let least = *values.get(count - 1)?;
        if least.is_nan() || least <= NOISE * UNIT * (of_q + of_r) as f64 * values[0] {
            return None;
        }
        let scaled = DMatrix::from_fn(count, count, |i, j| u[(j, i)] / (values[i] * unit[j]));
        let response = v.columns(0, count) * scaled;
        let spread = |from: usize, order: usize| {
            let mut all = DMatrix::zeros(order * order, count);
            for (mut column, own) in all.column_iter_mut().zip(response.column_iter()) {
                let own = smat(own.rows(from, length(order)).clone_owned().as_slice(), order).abs();
                column.copy_from_slice(own.as_slice());
            }
            all
        };
        Some(Response::Joint { states: spread(0, n), inputs: spread(of_q, m) })
    }

    /// One over the largest change of Q in its own units for any gain of the box; R may move by half of itself.
    pub(super) fn ratio(&self, response: &Response, box_k: &DMatrix<f64>) -> f64 {
        let (m, n) = self.core.k.shape();
        let missing = &self.missing + &self.weight * box_k;
        let largest = |m: DMatrix<f64>| symmetric(&m).symmetric_eigenvalues().max();
        let square = majorant::entries(&box_k.tr_mul(&(&self.weight * box_k)), &self.whiten);
        let rest = &self.direct + square;
        match response {
            Response::Held(pairs) => {
                let of_states = pairs.iter().fold(rest, |sum, [g, h]| sum + majorant::products(&missing, g, h));
                1.0 / largest(of_states)
            }
            Response::Joint { states, inputs } => {
                let missing = DVector::from_column_slice(missing.as_slice());
                let of_states = DMatrix::from_column_slice(n, n, (states * &missing).as_slice());
                let of_inputs = DMatrix::from_column_slice(m, m, (inputs * &missing).as_slice());
                // Without signs the largest eigenvalue bounds every choice of them; with a majorant it adds up.
                (1.0 / (largest(of_states) + largest(rest))).min(INPUTS / largest(of_inputs))
            }
        }
    }
}
