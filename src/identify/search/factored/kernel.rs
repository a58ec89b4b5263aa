//! Lower bounds for eight clusters of feedback controllers at once, against one cluster of feedforward denominators.
//!
//! # Bound
//! With the measured error `E = 1 − H`, the sensitivity `S = 1/(1 + G Gfb)` and the feedforward N/D, the residual at a
//! line is `e = E − S + (S G / D) N`, and a candidate costs `J = min_N ‖e‖²`. By duality, for **any** y that is
//! orthogonal to the columns of N, `J ≥ 2⟨y, E − S⟩ − ‖y‖²`. Let a cluster have the centre `S, D` and a member
//! `S/(1+κ), D(1+δ)`. If y is orthogonal to the columns of the centre, then `y · conj((1+κ)(1+δ))` is orthogonal to
//! those of the member, so with one y every member has the bound
//!
//! `J ≥ 2 Re Σ ȳ (E(1+κ) − S)(1+δ) − Σ |y|² |1+κ|² |1+δ|²`.
//!
//! Here `y = α r` with the centre's least-squares residual r. To first order the bound is linear in κ and δ, with the
//! coefficients `2 α r̄ M` and `2 α r̄ (M − S)`, where `M = E − α r`, and since r is orthogonal to the columns,
//! whatever part of a variation the feedforward numerator can make up for drops out of it. With `κ = T (e^Λ − 1)`,
//! `T = G Gfb/(1 + G Gfb)`, and Λ the sum of the deviations of numerator, denominator and gain in logarithms, the
//! linear part is minimised over the boxes of the clusters' coordinates. With `Λ = λ + ρ`, λ along the directions, the
//! quadratic part `2 α Re Σ r̄ M T λ²/2` has one coefficient per pair of coordinates; r is nearly orthogonal to
//! whatever is smooth, so these are far smaller than the moduli of their terms. Squares are minimised with their linear
//! part, products by their moduli. What is left:
//!
//! `2 α Σ |r| |M| (|T| (ρ (1 + |Λ| + ρ/2) + e^|Λ| − 1 − |Λ| − |Λ|²/2) + |κ| |δ|) + α² Σ |r|² ((1+|κ|)(1+|δ|) − 1)²`,
//!
//! its first sum by Cauchy and Schwarz. `α = min(1, √(limit/J))` is best for proving that members cost more than
//! `limit`.
//!
//! # Rounding
//! Sums of K complex terms and the elimination err by multiples of γ = (2K + 32) ε. The computed r is orthogonal to the
//! columns only up to γ √C times their norms, and what a member's numerator x makes of that is first order in γ: with
//! the columns at unit norm, `‖x‖₁ ≤ √(n C/λ_min)`, and a positive definite matrix of order n with unit diagonal has
//! `1/λ_min ≤ e/det`. So with `C = 2 Σ weight (|E|² + σ²|S|²)`, where `σ = (1+|L|)/|1+L|` is the cancellation in 1 + L,
//! the bound can lose `16 γ C (1 + √(e p/det_p) + √(e q/det_q))` for halves of p and q coefficients, which also covers
//! the rounding of the QR that decides.

use super::feedback_lanes::{FeedbackLanes, LANES, found, given};
use super::lines::{Denominators, Lines};
use super::tree::DIRECTIONS;
use crate::identify::search::simd::dispatch::{Halves, dispatch_halves};
use crate::identify::search::simd::lanes::Packed;
use crate::identify::search::simd::ldl::Half;
use pulp::{Simd, WithSimd};

/// The largest half of a feedforward numerator that the kernel takes.
pub(super) const LARGEST_HALF: usize = 8;

/// What is known about each of eight clusters together with the denominators.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Bounds {
    /// Cost of the centre.
    pub cost: [f64; LANES],
    /// No member costs less, rounding included; −∞ or NaN where nothing is known.
    pub bound: [f64; LANES],
    /// What the feedback cluster's and the feedforward cluster's extent cost in the bound.
    pub feedback_loss: [f64; LANES],
    pub feedforward_loss: [f64; LANES],
}

/// Bounds of eight feedback clusters with a cluster of denominators, for proving that members cost more than `limit`.
pub(super) fn bounds(
    lines: &Lines,
    feedback: &FeedbackLanes,
    denominators: &Denominators,
    limit: f64,
    scratch: &mut Vec<f64>,
) -> Bounds {
    let mut out = Bounds::default();
    scratch.resize(2 * lines.count * LANES, 0.0);
    dispatch_halves!(
        [lines.even, lines.odd],
        in [0 0, 1 0, 1 1, 2 1, 2 2, 3 2, 3 3, 4 3, 4 4] else LARGEST_HALF,
        |halves| Bound { halves, lines, feedback, denominators, limit, scratch, out: &mut out }
    );
    out
}

struct Bound<'a, const P: usize, const Q: usize, const KNOWN: bool> {
    halves: Halves<P, Q, KNOWN>,
    lines: &'a Lines,
    feedback: &'a FeedbackLanes,
    denominators: &'a Denominators,
    limit: f64,
    scratch: &'a mut [f64],
    out: &'a mut Bounds,
}

type Lane<S> = Packed<S, f64>;

impl<const P: usize, const Q: usize, const KNOWN: bool> WithSimd for Bound<'_, P, Q, KNOWN> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { halves, lines, feedback, denominators, limit, scratch, out } = self;
        let (p, q) = halves.sizes([lines.even, lines.odd]);
        let width = (p * (p + 1) + q * (q + 1)) / 2;
        let vectors = S::as_simd_f64s(&feedback.gain).0.len();
        let mul = |a, b| simd.mul_f64s(a, b);
        let fma = |a, b, c| simd.mul_add_e_f64s(a, b, c);
        let nfma = |a, b, c| simd.negate_mul_add_e_f64s(a, b, c);
        let splat = |x| simd.splat_f64s(x);
        let zero = splat(0.0);
        let (residual, _) = S::as_mut_simd_f64s(scratch);
        for v in 0..vectors {
            let (none, one) = (Lane::<S>::of(simd, 0.0), Lane::<S>::of(simd, 1.0));
            let (mut even, mut odd) = (Half::<Lane<S>, P>::new(none), Half::<Lane<S>, Q>::new(none));
            let (mut even_n, mut odd_n) = ([none; P], [none; Q]);
            for (k, d) in denominators.rows.iter().enumerate() {
                let (row, _) =
                    S::as_simd_f64s(&feedback.found[k * found::COUNT * LANES..(k + 1) * found::COUNT * LANES]);
                let at = |field: usize| row[field * vectors + v];
                let products = &denominators.products[k * width..(k + 1) * width];
                let functions = &lines.functions[k * (p + q)..(k + 1) * (p + q)];
                let a = Lane::<S>::new(simd, at(found::A));
                let (b_re, b_im) = (at(found::B_RE), at(found::B_IM));
                // conj(1/D) B
                let (i_re, i_im) = (splat(d[0]), splat(d[1]));
                let right_re = Lane::<S>::new(simd, fma(i_im, b_im, mul(i_re, b_re)));
                let right_im = Lane::<S>::new(simd, nfma(i_im, b_re, mul(i_re, b_im)));
                let mut n = 0;
                for i in 0..p {
                    for j in 0..=i {
                        even.gram[i][j] = a.times_plus(Packed::of(simd, products[n]), even.gram[i][j]);
                        n += 1;
                    }
                    even_n[i] = right_re.times_plus(Packed::of(simd, functions[i]), even_n[i]);
                }
                for i in 0..q {
                    for j in 0..=i {
                        odd.gram[i][j] = a.times_plus(Packed::of(simd, products[n]), odd.gram[i][j]);
                        n += 1;
                    }
                    odd_n[i] = right_im.times_plus(Packed::of(simd, functions[p + i]), odd_n[i]);
                }
            }
            let even_determinant = even.determinant(p, one).x;
            let odd_determinant = odd.determinant(q, one).x;
            even.forward(p, &mut even_n);
            odd.forward(q, &mut odd_n);
            even.backward(p, &mut even_n);
            odd.backward(q, &mut odd_n);
            // The residual, and its inner product with E − S.
            let mut cost = zero;
            for (k, d) in denominators.rows.iter().enumerate() {
                let (row, _) =
                    S::as_simd_f64s(&feedback.found[k * found::COUNT * LANES..(k + 1) * found::COUNT * LANES]);
                let at = |field: usize| row[field * vectors + v];
                let functions = &lines.functions[k * (p + q)..(k + 1) * (p + q)];
                let (mut n_re, mut n_im) = (zero, zero);
                for i in 0..p {
                    n_re = fma(even_n[i].x, splat(functions[i]), n_re);
                }
                for i in 0..q {
                    n_im = fma(odd_n[i].x, splat(functions[p + i]), n_im);
                }
                let (i_re, i_im) = (splat(d[0]), splat(d[1]));
                let (q_re, q_im) = (nfma(i_im, n_im, mul(i_re, n_re)), fma(i_im, n_re, mul(i_re, n_im)));
                let (sg_re, sg_im) = (at(found::SG_RE), at(found::SG_IM));
                let r_re = nfma(sg_im, q_im, fma(sg_re, q_re, at(found::ES_RE)));
                let r_im = fma(sg_im, q_re, fma(sg_re, q_im, at(found::ES_IM)));
                cost = fma(r_re, r_re, fma(r_im, r_im, cost));
                residual[(2 * k) * vectors + v] = r_re;
                residual[(2 * k + 1) * vectors + v] = r_im;
            }
            let condition = {
                let of = |n: usize, determinant| {
                    simd.sqrt_f64s(simd.div_f64s(splat(n as f64 * std::f64::consts::E), determinant))
                };
                let positive = simd.and_m64s(
                    simd.greater_than_f64s(even_determinant, zero),
                    simd.greater_than_f64s(odd_determinant, zero),
                );
                let sum = simd.add_f64s(of(p, even_determinant), of(q, odd_determinant));
                simd.select_f64s(positive, simd.add_f64s(splat(1.0), sum), splat(f64::INFINITY))
            };
            let slack = mul(S::as_simd_f64s(&feedback.slack).0[v], condition);
            S::as_mut_simd_f64s(&mut out.cost).0[v] = cost;
            let bound = &mut S::as_mut_simd_f64s(&mut out.bound).0[v];
            if !feedback.extended && denominators.spread == 0.0 {
                *bound = simd.sub_f64s(cost, slack);
                continue;
            }

            // Where every centre is good, nothing can be proven, and nothing needs to be computed.
            let hopeless = simd.less_than_or_equal_f64s(cost, splat(limit));
            if feedback.extended && simd.first_true_m64s(simd.not_m64s(hopeless)) >= LANES / vectors {
                *bound = splat(f64::NEG_INFINITY);
                continue;
            }
            let floor = simd.max_f64s(cost, splat(f64::MIN_POSITIVE));
            let alpha = simd.min_f64s(splat(1.0), simd.sqrt_f64s(simd.div_f64s(splat(limit), floor)));
            let mut gain_slope = zero;
            let mut slopes = [zero; 2 * DIRECTIONS];
            let mut other_slopes = [zero; DIRECTIONS];
            // Coefficients of the products of two coordinates; half of the diagonal counts.
            let mut products = [[zero; 2 * DIRECTIONS]; 2 * DIRECTIONS];
            let (mut curved, mut curved_own, mut curved_other) = (zero, zero, zero);
            let (mut squares, mut squares_own, mut squares_other) = (zero, zero, zero);
            for (k, d) in denominators.rows.iter().enumerate() {
                let (row, _) =
                    S::as_simd_f64s(&feedback.found[k * found::COUNT * LANES..(k + 1) * found::COUNT * LANES]);
                let (box_row, _) =
                    S::as_simd_f64s(&feedback.given[k * given::COUNT * LANES..(k + 1) * given::COUNT * LANES]);
                let at = |field: usize| row[field * vectors + v];
                let (r_re, r_im) = (residual[(2 * k) * vectors + v], residual[(2 * k + 1) * vectors + v]);
                // M = E − α r = (E − S) + S − α r, and r̄ M.
                let x_re = nfma(alpha, r_re, at(found::ES_RE));
                let x_im = nfma(alpha, r_im, at(found::ES_IM));
                let m_re = simd.add_f64s(x_re, at(found::S_RE));
                let m_im = simd.add_f64s(x_im, at(found::S_IM));
                let r2 = fma(r_re, r_re, mul(r_im, r_im));
                let m2 = fma(m_re, m_re, mul(m_im, m_im));
                let delta = splat(d[2]);
                let one_plus_delta = splat(1.0 + d[2]);
                // r̄ (M − S), against the directions of D.
                let y_re = fma(r_im, x_im, mul(r_re, x_re));
                let y_im = nfma(r_im, x_re, mul(r_re, x_im));
                for m in 0..DIRECTIONS {
                    other_slopes[m] = nfma(y_im, splat(d[4 + 2 * m]), fma(y_re, splat(d[3 + 2 * m]), other_slopes[m]));
                }
                squares_other = fma(mul(r2, delta), delta, squares_other);
                if let Some(rho) = denominators.remainder.get(k) {
                    let x2 = fma(x_re, x_re, mul(x_im, x_im));
                    curved_other = fma(x2, splat(rho * rho), curved_other);
                }
                if feedback.extended {
                    let u_re = fma(r_im, m_im, mul(r_re, m_re));
                    let u_im = nfma(r_im, m_re, mul(r_re, m_im));
                    let (t_re, t_im) = (at(found::T_RE), at(found::T_IM));
                    let w_re = nfma(u_im, t_im, mul(u_re, t_re));
                    let w_im = fma(u_im, t_re, mul(u_re, t_im));
                    gain_slope = simd.add_f64s(gain_slope, w_re);
                    let direction = |i: usize| {
                        let field = given::DIRECTIONS + 2 * i;
                        (box_row[field * vectors + v], box_row[(field + 1) * vectors + v])
                    };
                    for i in 0..2 * DIRECTIONS {
                        let (v_re, v_im) = direction(i);
                        let (p_re, p_im) = (nfma(w_im, v_im, mul(w_re, v_re)), fma(w_im, v_re, mul(w_re, v_im)));
                        slopes[i] = simd.add_f64s(slopes[i], p_re);
                        for j in 0..=i {
                            let (v_re, v_im) = direction(j);
                            products[i][j] = nfma(p_im, v_im, fma(p_re, v_re, products[i][j]));
                        }
                    }
                    let (kappa, own) = (at(found::KAPPA), at(found::CURVATURE));
                    let both = fma(kappa, delta, own);
                    curved = fma(mul(m2, both), both, curved);
                    curved_own = fma(mul(m2, own), own, curved_own);
                    let eta = fma(kappa, one_plus_delta, delta);
                    squares = fma(mul(r2, eta), eta, squares);
                    squares_own = fma(mul(r2, kappa), kappa, squares_own);
                } else {
                    squares = squares_other;
                }
            }
            let two_alpha = simd.add_f64s(alpha, alpha);
            // min of c t over [low, high], for c = 2 α slope.
            let support = |slope, low, high| {
                let c = mul(two_alpha, slope);
                simd.min_f64s(mul(c, low), mul(c, high))
            };
            // g + g²/2 of the gain's coordinate g, its ends.
            let half = S::as_simd_f64s(&feedback.half).0[v];
            let square = mul(splat(0.5), mul(half, half));
            let inner = simd.less_than_f64s(half, splat(1.0));
            let gain_low = simd.select_f64s(inner, simd.sub_f64s(square, half), splat(-0.5));
            let mut linear_own = support(gain_slope, gain_low, simd.add_f64s(square, half));
            let mut extent = [zero; 2 * DIRECTIONS];
            for i in 0..2 * DIRECTIONS {
                let (low, high) = (S::as_simd_f64s(&feedback.low[i]).0[v], S::as_simd_f64s(&feedback.high[i]).0[v]);
                extent[i] = simd.max_f64s(simd.abs_f64s(low), simd.abs_f64s(high));
                let bend = mul(splat(0.5), simd.min_f64s(products[i][i], zero));
                let at = |t| mul(two_alpha, mul(t, fma(bend, t, slopes[i])));
                linear_own = simd.add_f64s(linear_own, simd.min_f64s(at(low), at(high)));
                // Products of this coordinate with the gain's and with those before it.
                let mut moduli = mul(simd.abs_f64s(slopes[i]), half);
                for j in 0..i {
                    moduli = fma(simd.abs_f64s(products[i][j]), extent[j], moduli);
                }
                linear_own = nfma(two_alpha, mul(moduli, extent[i]), linear_own);
            }
            let mut linear_other = zero;
            for m in 0..DIRECTIONS {
                let s = support(other_slopes[m], splat(denominators.low[m]), splat(denominators.high[m]));
                linear_other = simd.add_f64s(linear_other, s);
            }
            let alpha2 = mul(alpha, alpha);
            let root = |sum| mul(two_alpha, simd.sqrt_f64s(mul(cost, sum)));
            let centre = nfma(alpha2, cost, mul(two_alpha, cost));
            let whole = simd.add_f64s(simd.add_f64s(linear_own, linear_other), centre);
            let lost = fma(alpha2, squares, simd.add_f64s(root(curved), root(curved_other)));
            *bound = simd.sub_f64s(simd.sub_f64s(whole, lost), slack);
            let own = simd.sub_f64s(fma(alpha2, squares_own, root(curved_own)), linear_own);
            let total = simd.sub_f64s(simd.sub_f64s(lost, linear_own), linear_other);
            S::as_mut_simd_f64s(&mut out.feedback_loss).0[v] = own;
            S::as_mut_simd_f64s(&mut out.feedforward_loss).0[v] = simd.sub_f64s(total, own);
        }
    }
}
