//! Lower bounds for a cluster of feedback controllers against blocks of feedforward denominators, a block in each lane.
//!
//! # Bound
//! With the measured error `E = 1 − H`, the sensitivity `S = 1/(1 + G Gfb)` and the feedforward N/D, the residual at a
//! line is `e = E − S + (S G/D) N` (up to the sign of N), and a candidate costs `J = min_N ‖e‖²`. A cluster has the
//! centre S, and members `S/(1 + κ)` with `κ = Σ t_i v_i + ρ`; a block has the centre D, and members `D (1 + δ)`.
//! Multiplied by `(1 + κ)(1 + δ)`, a member's residual is `(E (1 + κ) − S)(1 + δ) + (S G/D) N`: **linear in κ**, with
//! the centre's columns. So for any y that is orthogonal to these,
//!
//! `J ≥ 2 Re Σ ȳ (E (1 + κ) − S)(1 + δ) − Σ |y|² |1 + κ|² |1 + δ|²`
//!
//! (weak duality, with `y · conj((1 + κ)(1 + δ))` for the member). What is quadratic in κ costs the bound no more than
//! `Σ |y|² |κ|²`, a share |κ|² of the cost itself, so clusters may be large. For each denominator of the block δ is
//! known, and the right side is affine in t but for that term; it is minimised over the box of the cluster's
//! coordinates. `2 Re δ` in `|1 + δ|²` is kept, `|δ|²` beside κ is not: with the largest `|μ| ≤ r` that the leading
//! directions leave over, `|κ|` and `|δ|` of cluster and block a line loses at most
//!
//! `|y|² (2 |δ|² (|κ| + r) + (1 + |δ|)² |κ|²)`,
//!
//! and what is left over brings `2 Re g μ` with `g = ȳ (E − y)`, and at most `2 |y| r |δ| (|E − y| + |y| (1 + |δ|))`
//! more. Of `μ = Σ t_j v_j + ρ` the faint directions v_j are minimised over their box as well, and
//! `2 Re Σ g ρ ≥ −2 R (Σ s² |g|²)^½` with the largest norm R of a member's ρ/s. First order in μ as these are, they
//! cost more than all that is of second order in κ.
//!
//! # Choice of y
//! The residual of the relaxed problem `min ‖E (1 + Σ t_i v_i) − S + (S G/D) N‖²` over N and the box of t, by a few
//! rounds of coordinate descent: where t is inside its box, y is orthogonal to that direction and the bound loses
//! nothing along it but for `|1 + κ|²`, whose linear part `Σ |y|² 2 Re v_i t_i` then joins the relaxed problem for a
//! second time. y is scaled by `α = min(1, √(limit/J))`, which is best for proving that members cost more than `limit`.
//! Any y gives a valid bound.
//!
//! # Rounding
//! The computed y is taken as it is; what matters is how far it is from orthogonal, and what the sums above lose.
//! With unit roundoff u:
//! - Its products with the columns are computed as well, to (2C + 14) u ‖y‖ in units of a column's length, with C
//!   lines. Of a member within the limit, the numerator's part of the residual is no longer than
//!   `n = (‖(|E| (1 + |κ|) + |S|)‖ + √limit (1 + |κ|)) (1 + |δ|)`, and its coefficients in those units no longer than
//!   `n √(e/det)` for a half whose Gram matrix, scaled to unit diagonal, has the determinant det (the other eigenvalues
//!   have a product below e). That matrix and its factors err by no more than (C + 16) u in an entry, so det by that
//!   times the square of its order.
//! - A sum over the lines has at most 2C + 16 roundings in its terms and after each other, and 48 more follow on the
//!   way to the bound. Nothing is lost but (4C + 80) u times the moduli that are summed:
//!   `‖y‖ (‖E − S‖ + Σ |t_m| ‖E v_m‖)` and `‖y‖² ((1 + |κ|)² + Σ |t_m v_m|)`, each with `(1 + |δ|)²`. A box is kept as
//!   its middle and half its width, rounded outwards: the products of a slope with both have the modulus that its
//!   product with the furthest end has.
//! - Where a square of the rest underflows, a line loses less than the smallest normal number of it, which is added.
//!   Everything else that may underflow is far below the terms above, since the limit is not below a millionth of the
//!   size squared.
//! - The member's own response has an error of its own, as derived in `controller_bound.rs`.

use super::block_lanes::{BlockLanes, LANES};
use super::bounds::{Bounds, LARGEST_HALF};
use super::cluster_frame::ClusterFrame;
use super::relaxed::{Bound, Relaxed, WORKED};
use crate::identify::search::simd::dispatch::dispatch_halves;
use crate::identify::search::simd::lanes::Real;
use pulp::{Simd, WithSimd};

/// Rounds of coordinate descent, at first and again. More would tighten the bound a little, fewer would loosen it.
const ROUNDS: [usize; 2] = [4, 3];

/// Bounds of a cluster with some blocks.
pub(super) fn bounds<N: Real>(
    frame: &ClusterFrame<N>,
    blocks: &BlockLanes<N>,
    limit: N,
    scratch: &mut Vec<N>,
    out: &mut Bounds<N>,
) {
    scratch.resize(WORKED * frame.lines * LANES, N::default());
    dispatch_halves!(
        frame.halves,
        in [1 1, 2 1, 2 2, 3 2, 3 3] else LARGEST_HALF,
        |halves| Bound { halves, frame, blocks, limit, scratch, out }
    );
}

impl<N: Real, const P: usize, const Q: usize, const KNOWN: bool> Bound<'_, N, P, Q, KNOWN> {
    /// All vectors of lanes, so many at a time.
    #[inline(always)]
    fn vectors<S: Simd, const W: usize>(&mut self, simd: S, worked: &mut [N::Vector<S>]) {
        let vectors = N::vectors::<S>(&self.out.cost).len();
        let used = self.blocks.filled.div_ceil(LANES / vectors);
        let mut relaxed = [Relaxed::none(simd); W];
        for first in (0..used).step_by(W) {
            let some = &mut relaxed[..W.min(used - first)];
            for (v, relaxed) in some.iter_mut().enumerate() {
                self.relax(simd, first + v, relaxed);
            }
            self.descend(simd, some, ROUNDS[0]);
            for (v, relaxed) in some.iter_mut().enumerate() {
                let lean = self.residual(simd, first + v, relaxed, worked).lean;
                for (slope, lean) in relaxed.slope.iter_mut().zip(lean) {
                    *slope = *slope - lean;
                }
            }
            self.descend(simd, some, ROUNDS[1]);
            for (v, relaxed) in some.iter().enumerate() {
                let sums = self.residual(simd, first + v, relaxed, worked);
                self.conclude(simd, first + v, relaxed, &sums, worked);
            }
        }
    }
}

impl<N: Real, const P: usize, const Q: usize, const KNOWN: bool> WithSimd for Bound<'_, N, P, Q, KNOWN> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let scratch = std::mem::take(&mut self.scratch);
        let worked = N::vectors_mut::<S>(scratch);
        if N::vectors::<S>(&self.out.cost).len() > 1 {
            self.vectors::<S, 2>(simd, worked);
        } else {
            self.vectors::<S, 1>(simd, worked);
        }
    }
}
