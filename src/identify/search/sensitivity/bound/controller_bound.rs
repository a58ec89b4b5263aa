//! Eight single controllers at once against a block of feedforward denominators: a cost where the block holds one
//! denominator, a lower bound for each denominator otherwise.
//!
//! # Bound
//! As derived in `kernel.rs`, with κ = 0: `J ≥ 2 Re Σ ȳ (E − S)(1 + δ) − Σ |y|² |1 + δ|²` for each denominator
//! `D (1 + δ)` of the block, where y is the residual with its centre D, scaled by `α = min(1, √(limit/J))`.
//!
//! # Rounding
//! As in the kernel for factored candidates: the computed y is orthogonal to the columns only up to γ √C times their
//! norms, and with a positive definite Gram matrix of unit diagonal and order n the bound can lose
//! `32 γ C (1 + √(e p/det_p) + √(e q/det_q))` for halves of p and q coefficients, where `C = 2 Σ w (|E|² + σ²|S|²)` and
//! σ is the cancellation in 1 + L.

use super::bounds::LARGEST_HALF;
use super::controller_lanes::{ControllerLanes, field};
use crate::identify::search::sensitivity::build::denominators::{Block, Denominators, FREE};
use crate::identify::search::sensitivity::build::size::CONTROLLER_LANES as LANES;
use crate::identify::search::simd::dispatch::{Halves, dispatch_halves};
use crate::identify::search::simd::lanes::Packed;
use crate::identify::search::simd::ldl::Half;
use pulp::{Simd, WithSimd};

/// What is known about each of the controllers together with a block.
#[derive(Debug, Clone, Default)]
pub(super) struct ControllerBounds {
    /// Cost with the block's centre.
    pub cost: [f64; LANES],
    /// Nothing in the block costs less, rounding included; −∞ or NaN where nothing is known.
    pub bound: [f64; LANES],
    /// Per lane, a bit for each denominator that may cost no more than the limit.
    pub alive: [u64; LANES],
}

/// Bounds of the controllers with those denominators of a block that are in `mask`.
pub(super) fn bounds(
    controllers: &ControllerLanes,
    denominators: &Denominators,
    block: &Block,
    mask: u64,
    limit: f64,
    scratch: &mut Vec<f64>,
    out: &mut ControllerBounds,
) {
    scratch.resize(2 * block.rows.len() * LANES, 0.0);
    dispatch_halves!(
        denominators.halves,
        in [1 0, 1 1, 2 1, 2 2, 3 2, 3 3, 4 3, 4 4] else LARGEST_HALF,
        |halves| Bound { halves, controllers, denominators, block, mask, limit, scratch, out }
    );
}

struct Bound<'a, const P: usize, const Q: usize, const KNOWN: bool> {
    halves: Halves<P, Q, KNOWN>,
    controllers: &'a ControllerLanes,
    denominators: &'a Denominators,
    block: &'a Block,
    mask: u64,
    limit: f64,
    scratch: &'a mut [f64],
    out: &'a mut ControllerBounds,
}

impl<const P: usize, const Q: usize, const KNOWN: bool> WithSimd for Bound<'_, P, Q, KNOWN> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::needless_range_loop, clippy::too_many_lines)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { halves, controllers, denominators, block, mask, limit, scratch, out } = self;
        let (p, q) = halves.sizes(denominators.halves);
        let width = (p * (p + 1) + q * (q + 1)) / 2;
        let vectors = S::as_simd_f64s(&controllers.slack).0.len();
        macro_rules! number {
            ($x:expr) => {
                Packed::<S, f64>::of(simd, $x)
            };
        }
        let (zero, one) = (number!(0.0), number!(1.0));
        let (residual, _) = S::as_mut_simd_f64s(scratch);
        let (fields, _) = S::as_simd_f64s(&controllers.fields);
        for v in 0..vectors {
            macro_rules! at {
                ($line:expr, $field:expr) => {
                    Packed::<S, f64>::new(simd, fields[(field::COUNT * $line + $field) * vectors + v])
                };
            }
            let (mut even, mut odd) = (Half::<_, P>::new(zero), Half::<_, Q>::new(zero));
            let (mut even_n, mut odd_n) = ([zero; P], [zero; Q]);
            for (k, d) in block.rows.iter().enumerate() {
                let products = &block.products[k * width..(k + 1) * width];
                let functions = &denominators.functions[k * (p + q)..(k + 1) * (p + q)];
                let (s_re, s_im) = (at!(k, field::SG_RE), at!(k, field::SG_IM));
                let (i_re, i_im) = (number!(d.inverse.re), number!(d.inverse.im));
                let (c_re, c_im) = (s_im.times_from(i_im, s_re * i_re), s_im.times_plus(i_re, s_re * i_im));
                let weight = s_re.times_plus(s_re, s_im * s_im);
                let mut n = 0;
                for i in 0..p {
                    for j in 0..=i {
                        even.gram[i][j] = weight.times_plus(number!(products[n]), even.gram[i][j]);
                        n += 1;
                    }
                }
                for i in 0..q {
                    for j in 0..=i {
                        odd.gram[i][j] = weight.times_plus(number!(products[n]), odd.gram[i][j]);
                        n += 1;
                    }
                }
                let (b_re, b_im) = (at!(k, field::B_RE), at!(k, field::B_IM));
                let (z_re, z_im) = (c_im.times_plus(b_im, c_re * b_re), c_im.times_from(b_re, c_re * b_im));
                for i in 0..p {
                    even_n[i] = z_re.times_plus(number!(functions[i]), even_n[i]);
                }
                for i in 0..q {
                    odd_n[i] = z_im.times_plus(number!(functions[p + i]), odd_n[i]);
                }
            }
            let determinants = [even.determinant(p, one), odd.determinant(q, one)];
            even.forward(p, &mut even_n);
            odd.forward(q, &mut odd_n);
            even.backward(p, &mut even_n);
            odd.backward(q, &mut odd_n);
            let mut cost = zero;
            for (k, d) in block.rows.iter().enumerate() {
                let functions = &denominators.functions[k * (p + q)..(k + 1) * (p + q)];
                let (mut n_re, mut n_im) = (zero, zero);
                for i in 0..p {
                    n_re = even_n[i].times_plus(number!(functions[i]), n_re);
                }
                for i in 0..q {
                    n_im = odd_n[i].times_plus(number!(functions[p + i]), n_im);
                }
                let (i_re, i_im) = (number!(d.inverse.re), number!(d.inverse.im));
                let (q_re, q_im) = (i_im.times_from(n_im, i_re * n_re), i_im.times_plus(n_re, i_re * n_im));
                let (s_re, s_im) = (at!(k, field::SG_RE), at!(k, field::SG_IM));
                let r_re = s_im.times_plus(q_im, s_re.times_from(q_re, at!(k, field::B_RE)));
                let r_im = s_im.times_from(q_re, s_re.times_from(q_im, at!(k, field::B_IM)));
                cost = r_re.times_plus(r_re, r_im.times_plus(r_im, cost));
                residual[(2 * k) * vectors + v] = r_re.x;
                residual[(2 * k + 1) * vectors + v] = r_im.x;
            }
            // A determinant that is not positive, or no number, leaves a condition without bound.
            let mut condition = number!(1.0);
            for (n, determinant) in [p, q].into_iter().zip(determinants) {
                let numerator = number!(n as f64 * std::f64::consts::E);
                condition = condition + numerator.over(determinant.max(number!(1e-300))).root();
            }
            let slack = Packed::<S, f64>::new(simd, S::as_simd_f64s(&controllers.slack).0[v]) * condition;
            S::as_mut_simd_f64s(&mut out.cost).0[v] = cost.x;
            let limits = simd.splat_f64s(limit);
            if block.is_single() {
                let bound = cost - slack;
                let dead = simd.greater_than_f64s(bound.x, limits);
                S::as_mut_simd_f64s(&mut out.bound).0[v] = bound.x;
                S::as_mut_simd_u64s(&mut out.alive).0[v] =
                    simd.select_u64s(dead, simd.splat_u64s(0), simd.splat_u64s(mask));
                continue;
            }
            let alpha = number!(1.0).min(number!(limit).over(cost.max(number!(f64::MIN_POSITIVE))).root());
            let mut base = [zero; FREE + 1];
            let mut square = [zero; 6];
            for (k, d) in block.rows.iter().enumerate() {
                let y_re = alpha * Packed::<S, f64>::new(simd, residual[(2 * k) * vectors + v]);
                let y_im = alpha * Packed::<S, f64>::new(simd, residual[(2 * k + 1) * vectors + v]);
                let (b_re, b_im) = (at!(k, field::B_RE), at!(k, field::B_IM));
                // 2 Re ȳ (E − S)(1 + δ), and |y|² |1 + δ|².
                let (re, im) = (y_re.times_plus(b_re, y_im * b_im), y_im.times_from(b_re, y_re * b_im));
                let (re, im) = (re + re, im + im);
                let y2 = y_re.times_plus(y_re, y_im * y_im);
                base[0] = base[0] + re;
                square[0] = square[0] + y2;
                for (c, phi) in d.directions.iter().enumerate() {
                    base[c + 1] = re.times_plus(number!(phi.re), im.times_from(number!(phi.im), base[c + 1]));
                    square[c + 1] = y2.times_plus(number!(2.0 * phi.re), square[c + 1]);
                }
                let [a, b] = d.directions;
                square[3] = y2.times_plus(number!(a.norm_sqr()), square[3]);
                square[4] = y2.times_plus(number!(2.0 * (a.re * b.re + a.im * b.im)), square[4]);
                square[5] = y2.times_plus(number!(b.norm_sqr()), square[5]);
            }
            let mut least = simd.splat_f64s(f64::INFINITY);
            let mut living = simd.splat_u64s(0);
            let mut left = mask;
            while left != 0 {
                let j = left.trailing_zeros() as usize;
                left &= left - 1;
                let [o_a, o_b] = block.offsets[j];
                let (a, b) = (number!(o_a), number!(o_b));
                let mut bound = base[1].times_plus(a, base[2].times_plus(b, base[0])) - slack;
                bound = bound - square[1].times_plus(a, square[2].times_plus(b, square[0]));
                bound = square[3].times_from(number!(o_a * o_a), bound);
                bound = square[4].times_from(number!(o_a * o_b), bound);
                bound = square[5].times_from(number!(o_b * o_b), bound);
                let dead = simd.greater_than_f64s(bound.x, limits);
                living = simd.or_u64s(living, simd.select_u64s(dead, simd.splat_u64s(0), simd.splat_u64s(1 << j)));
                // NaN, which says that nothing is known, must stay: `min` may drop it.
                let unknown = simd.not_m64s(simd.less_than_or_equal_f64s(bound.x, simd.splat_f64s(f64::INFINITY)));
                let bound = simd.select_f64s(unknown, simd.splat_f64s(f64::NEG_INFINITY), bound.x);
                least = simd.min_f64s(least, bound);
            }
            S::as_mut_simd_f64s(&mut out.bound).0[v] = least;
            S::as_mut_simd_u64s(&mut out.alive).0[v] = living;
        }
    }
}
