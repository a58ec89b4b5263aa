//! Lower bounds for eight clusters of feedback controllers at once, against a block of feedforward denominators, each by itself.
//!
//! # Bound
//! With the measured error `E = 1 − H`, the sensitivity `S = 1/(1 + G Gfb)` and the feedforward N/D, the residual at a line is
//! `e = E − S + (S G/D) N` (up to the sign of N), and a candidate costs `J = min_N ‖e‖²`. A cluster has the centre S, and members
//! `S/(1 + κ)` with `κ = Σ t_i v_i + ρ`; a block has the centre D, and members `D (1 + δ)`. Multiplied by `(1 + κ)(1 + δ)`, a member's
//! residual is `(E (1 + κ) − S)(1 + δ) + (S G/D) N`: **linear in κ**, with the centre's columns. So for any y that is orthogonal to these,
//!
//! `J ≥ 2 Re Σ ȳ (E (1 + κ) − S)(1 + δ) − Σ |y|² |1 + κ|² |1 + δ|²`
//!
//! (weak duality, with `y · conj((1 + κ)(1 + δ))` for the member). What is quadratic in κ costs the bound no more than `Σ |y|² |κ|²`,
//! a share |κ|² of the cost itself, so clusters may be large. For each denominator of the block δ is known, and the right side is affine in
//! t but for that term; it is minimised over the box of the cluster's coordinates. `2 Re δ` in `|1 + δ|²` is kept, `|δ|²` beside κ is not:
//! with the largest `|μ| ≤ r` that the leading directions leave over, `|κ|` and `|δ|` of cluster and block a line loses at most
//!
//! `|y|² (2 |δ|² (|κ| + r) + (1 + |δ|)² |κ|²)`,
//!
//! and what is left over brings `2 Re g μ` with `g = ȳ (E − y)`, and at most `2 |y| r |δ| (|E − y| + |y| (1 + |δ|))` more. Of `μ = Σ t_j v_j + ρ`
//! the faint directions v_j are minimised over their box as well, and `2 Re Σ g ρ ≥ −2 R (Σ s² |g|²)^½` with the largest norm R of a
//! member's ρ/s. First order in μ as these are, they cost more than all that is of second order in κ.
//!
//! # Choice of y
//! The residual of the relaxed problem `min ‖E (1 + Σ t_i v_i) − S + (S G/D) N‖²` over N and the box of t, by a few rounds of coordinate
//! descent: where t is inside its box, y is orthogonal to that direction and the bound loses nothing along it but for `|1 + κ|²`, whose
//! linear part `Σ |y|² 2 Re v_i t_i` then joins the relaxed problem for a second time. y is scaled by `α = min(1, √(limit/J))`, which is
//! best for proving that members cost more than `limit`. Any y gives a valid bound.
//!
//! # Rounding
//! As in the kernel of the other tree: the computed y is orthogonal to the columns only up to γ √C times their norms, and with a positive
//! definite Gram matrix of unit diagonal and order n the bound can lose `32 γ C (1 + √(e p/det_p) + √(e q/det_q))` for halves of p and q
//! coefficients, where `C = 2 Σ w (|E|² (1 + |κ|)² + σ²|S|²)` and σ is the cancellation in 1 + L.

use super::denominators::{Block, Denominators, FREE};
use super::group::{DIRECTIONS, FAINT, Group, LANES, field};
use pulp::{Simd, WithSimd};

/// The largest half of a feedforward numerator that the kernel takes.
pub(super) const LARGEST_HALF: usize = 8;

/// Rounds of coordinate descent, at first and again. More would tighten the bound a little, fewer would loosen it.
const ROUNDS: [usize; 2] = [4, 3];

type Lanes = [f64; LANES];

/// What is known about each of eight clusters (or controllers) together with a block.
#[derive(Debug, Clone, Default)]
pub(super) struct Bounds {
    /// Cost of the relaxed problem at the centre; of a single candidate its cost.
    pub cost: Lanes,
    /// No member costs less, rounding included; −∞ or NaN where nothing is known.
    pub bound: Lanes,
    /// Per lane, a bit for each denominator that may have a member within the limit.
    pub alive: [u64; LANES],
    /// `Σ |E − S|² w |δ|²`: how far the block extends.
    pub extent: Lanes,
}

/// Bounds of a group of clusters with those denominators of a block that are in `mask`.
pub(super) fn bounds(
    group: &Group,
    denominators: &Denominators,
    block: &Block,
    mask: u64,
    limit: f64,
    scratch: &mut Vec<f64>,
    out: &mut Bounds,
) {
    scratch.resize(2 * block.rows.len() * LANES, 0.0);
    let arch = pulp::Arch::new();
    macro_rules! with {
        ($p:literal, $q:literal) => {
            if group.extended {
                arch.dispatch(Bound::<'_, $p, $q, DIRECTIONS> { group, denominators, block, mask, limit, scratch, out })
            } else {
                arch.dispatch(Bound::<'_, $p, $q, 0> { group, denominators, block, mask, limit, scratch, out })
            }
        };
    }
    match denominators.halves {
        [1, 0] => with!(1, 0),
        [1, 1] => with!(1, 1),
        [2, 1] => with!(2, 1),
        [2, 2] => with!(2, 2),
        [3, 2] => with!(3, 2),
        [3, 3] => with!(3, 3),
        [4, 3] => with!(4, 3),
        [4, 4] => with!(4, 4),
        _ => with!(8, 8),
    }
}

struct Bound<'a, const P: usize, const Q: usize, const T: usize> {
    group: &'a Group,
    denominators: &'a Denominators,
    block: &'a Block,
    mask: u64,
    limit: f64,
    scratch: &'a mut [f64],
    out: &'a mut Bounds,
}

/// The factors `G = L D Lᵀ` of one half's normal equations, from its lower triangle.
struct Half<V, const N: usize> {
    gram: [[V; N]; N],
    inverse: [V; N],
}

// Indices run over rows and columns of several arrays at once.
#[allow(clippy::needless_range_loop)]
impl<V: Copy, const N: usize> Half<V, N> {
    /// Factors in place: L below the diagonal. Returns the determinant of G scaled to unit diagonal.
    #[inline(always)]
    fn factor<S: Simd<f64s = V>>(&mut self, simd: S, n: usize) -> V {
        let one = simd.splat_f64s(1.0);
        let mut determinant = one;
        for j in 0..n {
            let diagonal = self.gram[j][j];
            let mut pivot = diagonal;
            for k in 0..j {
                pivot = simd.negate_mul_add_e_f64s(self.gram[j][k], self.gram[k][j], pivot);
            }
            self.inverse[j] = simd.div_f64s(one, pivot);
            determinant = simd.mul_f64s(determinant, simd.div_f64s(pivot, diagonal));
            for i in j + 1..n {
                let mut entry = self.gram[i][j];
                for k in 0..j {
                    entry = simd.negate_mul_add_e_f64s(self.gram[i][k], self.gram[k][j], entry);
                }
                // L D above the diagonal, for the steps that follow.
                self.gram[j][i] = entry;
                self.gram[i][j] = simd.mul_f64s(entry, self.inverse[j]);
            }
        }
        determinant
    }

    /// `L⁻¹ r`, in place.
    #[inline(always)]
    fn forward<S: Simd<f64s = V>>(&self, simd: S, n: usize, r: &mut [V; N]) {
        for i in 0..n {
            for j in 0..i {
                r[i] = simd.negate_mul_add_e_f64s(self.gram[i][j], r[j], r[i]);
            }
        }
    }

    /// `L⁻ᵀ D⁻¹ r`, in place.
    #[inline(always)]
    fn backward<S: Simd<f64s = V>>(&self, simd: S, n: usize, r: &mut [V; N]) {
        for i in (0..n).rev() {
            r[i] = simd.mul_f64s(r[i], self.inverse[i]);
            for j in i + 1..n {
                r[i] = simd.negate_mul_add_e_f64s(self.gram[j][i], r[j], r[i]);
            }
        }
    }

    /// `Σ a D⁻¹ b` taken from `sum`.
    #[inline(always)]
    fn reduce<S: Simd<f64s = V>>(&self, simd: S, n: usize, a: &[V; N], b: &[V; N], mut sum: V) -> V {
        for i in 0..n {
            sum = simd.negate_mul_add_e_f64s(simd.mul_f64s(a[i], b[i]), self.inverse[i], sum);
        }
        sum
    }
}

/// Adds `2 Re ȳ z (1 + δ)` as an affine form of the block's offsets; of a block of one only what does not depend on them.
// A function and no closure, so that it is inlined where the instructions are known.
#[inline(always)]
fn form<S: Simd>(
    simd: S,
    y: (S::f64s, S::f64s),
    z: (S::f64s, S::f64s),
    directions: &[(S::f64s, S::f64s); FREE],
    alone: bool,
    into: &mut [S::f64s; FREE + 1],
) {
    let re = simd.mul_add_e_f64s(y.1, z.1, simd.mul_f64s(y.0, z.0));
    let re = simd.add_f64s(re, re);
    into[0] = simd.add_f64s(into[0], re);
    if !alone {
        let im = simd.negate_mul_add_e_f64s(y.1, z.0, simd.mul_f64s(y.0, z.1));
        let im = simd.add_f64s(im, im);
        for (into, phi) in into[1..].iter_mut().zip(directions) {
            *into = simd.mul_add_e_f64s(re, phi.0, simd.negate_mul_add_e_f64s(im, phi.1, *into));
        }
    }
}

impl<const P: usize, const Q: usize, const T: usize> WithSimd for Bound<'_, P, Q, T> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::needless_range_loop, clippy::too_many_lines)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { group, denominators, block, mask, limit, scratch, out } = self;
        let general = P == LARGEST_HALF;
        let (p, q) = if general { (denominators.halves[0], denominators.halves[1]) } else { (P, Q) };
        let width = (p * (p + 1) + q * (q + 1)) / 2;
        let vectors = S::as_simd_f64s(&group.slack).0.len();
        let mul = |a, b| simd.mul_f64s(a, b);
        let add = |a, b| simd.add_f64s(a, b);
        let sub = |a, b| simd.sub_f64s(a, b);
        let fma = |a, b, c| simd.mul_add_e_f64s(a, b, c);
        let nfma = |a, b, c| simd.negate_mul_add_e_f64s(a, b, c);
        let splat = |x| simd.splat_f64s(x);
        let zero = splat(0.0);
        let limits = splat(limit);
        let (residual, _) = S::as_mut_simd_f64s(scratch);
        for v in 0..vectors {
            let rows =
                |k: usize| S::as_simd_f64s(&group.fields[k * field::COUNT * LANES..(k + 1) * field::COUNT * LANES]).0;
            let mut even = Half::<S::f64s, P> { gram: [[zero; P]; P], inverse: [zero; P] };
            let mut odd = Half::<S::f64s, Q> { gram: [[zero; Q]; Q], inverse: [zero; Q] };
            let (mut even_b, mut odd_b) = ([zero; P], [zero; Q]);
            let (mut even_a, mut odd_a) = ([[zero; P]; T], [[zero; Q]; T]);
            for (k, d) in block.rows.iter().enumerate() {
                let row = rows(k);
                let at = |field: usize| row[field * vectors + v];
                let products = &block.products[k * width..(k + 1) * width];
                let functions = &denominators.functions[k * (p + q)..(k + 1) * (p + q)];
                let (s_re, s_im) = (at(field::SG_RE), at(field::SG_IM));
                let (i_re, i_im) = (splat(d.inverse.re), splat(d.inverse.im));
                let (c_re, c_im) = (nfma(s_im, i_im, mul(s_re, i_re)), fma(s_im, i_re, mul(s_re, i_im)));
                let weight = fma(s_re, s_re, mul(s_im, s_im));
                let mut n = 0;
                for i in 0..p {
                    for j in 0..=i {
                        even.gram[i][j] = fma(weight, splat(products[n]), even.gram[i][j]);
                        n += 1;
                    }
                }
                for i in 0..q {
                    for j in 0..=i {
                        odd.gram[i][j] = fma(weight, splat(products[n]), odd.gram[i][j]);
                        n += 1;
                    }
                }
                // conj(c) z: the real half sees its real part, the imaginary half its imaginary part.
                let turned = |z_re, z_im| (fma(c_im, z_im, mul(c_re, z_re)), nfma(c_im, z_re, mul(c_re, z_im)));
                let (z_re, z_im) = turned(at(field::B_RE), at(field::B_IM));
                for i in 0..p {
                    even_b[i] = fma(z_re, splat(functions[i]), even_b[i]);
                }
                for i in 0..q {
                    odd_b[i] = fma(z_im, splat(functions[p + i]), odd_b[i]);
                }
                for m in 0..T {
                    let (z_re, z_im) = turned(at(field::DIRECTIONS + 3 * m + 1), at(field::DIRECTIONS + 3 * m + 2));
                    for i in 0..p {
                        even_a[m][i] = fma(z_re, splat(functions[i]), even_a[m][i]);
                    }
                    for i in 0..q {
                        odd_a[m][i] = fma(z_im, splat(functions[p + i]), odd_a[m][i]);
                    }
                }
            }
            let determinants = [even.factor(simd, p), odd.factor(simd, q)];
            even.forward(simd, p, &mut even_b);
            odd.forward(simd, q, &mut odd_b);
            // The relaxed problem over the box: minimise tᵀ H t + 2 gᵀ t, less what the numerator takes.
            let mut t = [zero; T];
            let mut hessian = [[zero; T]; T];
            let mut slope = [zero; T];
            let mut inverse = [zero; T];
            if T > 0 {
                let mut n = 0;
                for i in 0..T {
                    even.forward(simd, p, &mut even_a[i]);
                    odd.forward(simd, q, &mut odd_a[i]);
                    let right = S::as_simd_f64s(&group.right[i]).0[v];
                    let right = even.reduce(simd, p, &even_a[i], &even_b, right);
                    slope[i] = odd.reduce(simd, q, &odd_a[i], &odd_b, right);
                    for j in 0..=i {
                        let entry = S::as_simd_f64s(&group.gram[n]).0[v];
                        n += 1;
                        let entry = even.reduce(simd, p, &even_a[i], &even_a[j], entry);
                        let entry = odd.reduce(simd, q, &odd_a[i], &odd_a[j], entry);
                        (hessian[i][j], hessian[j][i]) = (entry, entry);
                    }
                    inverse[i] = simd.div_f64s(splat(1.0), simd.max_f64s(hessian[i][i], splat(1e-14)));
                }
            }
            let (mut cost, mut extent) = (zero, zero);
            for &rounds in if T > 0 { &ROUNDS[..] } else { &ROUNDS[..1] } {
                for _ in 0..rounds {
                    for i in 0..T {
                        let mut sum = slope[i];
                        // What has just changed comes last, so that the rest need not wait for it.
                        for j in i + 1..T {
                            sum = fma(hessian[i][j], t[j], sum);
                        }
                        for j in 0..i {
                            sum = fma(hessian[i][j], t[j], sum);
                        }
                        let (low, high) = (S::as_simd_f64s(&group.low[i]).0[v], S::as_simd_f64s(&group.high[i]).0[v]);
                        t[i] = simd.min_f64s(simd.max_f64s(nfma(sum, inverse[i], zero), low), high);
                    }
                }
                let (mut even_n, mut odd_n) = (even_b, odd_b);
                for m in 0..T {
                    for i in 0..p {
                        even_n[i] = fma(even_a[m][i], t[m], even_n[i]);
                    }
                    for i in 0..q {
                        odd_n[i] = fma(odd_a[m][i], t[m], odd_n[i]);
                    }
                }
                even.backward(simd, p, &mut even_n);
                odd.backward(simd, q, &mut odd_n);
                // Its residual.
                (cost, extent) = (zero, zero);
                let mut lean = [zero; T];
                for (k, d) in block.rows.iter().enumerate() {
                    let row = rows(k);
                    let at = |field: usize| row[field * vectors + v];
                    let functions = &denominators.functions[k * (p + q)..(k + 1) * (p + q)];
                    let (mut n_re, mut n_im) = (zero, zero);
                    for i in 0..p {
                        n_re = fma(even_n[i], splat(functions[i]), n_re);
                    }
                    for i in 0..q {
                        n_im = fma(odd_n[i], splat(functions[p + i]), n_im);
                    }
                    let (i_re, i_im) = (splat(d.inverse.re), splat(d.inverse.im));
                    let (q_re, q_im) = (nfma(i_im, n_im, mul(i_re, n_re)), fma(i_im, n_re, mul(i_re, n_im)));
                    let (s_re, s_im) = (at(field::SG_RE), at(field::SG_IM));
                    let (b_re, b_im) = (at(field::B_RE), at(field::B_IM));
                    extent = fma(splat(d.radius * d.radius), fma(b_re, b_re, mul(b_im, b_im)), extent);
                    let mut r_re = fma(s_im, q_im, nfma(s_re, q_re, b_re));
                    let mut r_im = nfma(s_im, q_re, nfma(s_re, q_im, b_im));
                    for m in 0..T {
                        r_re = fma(at(field::DIRECTIONS + 3 * m + 1), t[m], r_re);
                        r_im = fma(at(field::DIRECTIONS + 3 * m + 2), t[m], r_im);
                    }
                    let square = fma(r_re, r_re, mul(r_im, r_im));
                    cost = add(cost, square);
                    for (m, lean) in lean.iter_mut().enumerate() {
                        *lean = fma(square, at(field::DIRECTIONS + 3 * m), *lean);
                    }
                    residual[(2 * k) * vectors + v] = r_re;
                    residual[(2 * k + 1) * vectors + v] = r_im;
                }
                for (slope, lean) in slope.iter_mut().zip(lean) {
                    *slope = sub(*slope, lean);
                }
            }
            let condition = {
                let of = |n: usize, determinant| {
                    simd.sqrt_f64s(simd.div_f64s(splat(n as f64 * std::f64::consts::E), determinant))
                };
                let positive = simd.and_m64s(
                    simd.greater_than_f64s(determinants[0], zero),
                    simd.greater_than_f64s(determinants[1], zero),
                );
                let sum = add(of(p, determinants[0]), of(q, determinants[1]));
                simd.select_f64s(positive, add(splat(1.0), sum), splat(f64::INFINITY))
            };
            let slack = mul(S::as_simd_f64s(&group.slack).0[v], condition);
            S::as_mut_simd_f64s(&mut out.cost).0[v] = cost;
            let alive = &mut S::as_mut_simd_u64s(&mut out.alive).0[v];
            let bits = |dead, bit: u64| simd.select_u64s(dead, simd.splat_u64s(0), simd.splat_u64s(bit));
            let alone = block.children.is_empty();
            if T == 0 && alone {
                let bound = sub(cost, slack);
                S::as_mut_simd_f64s(&mut out.bound).0[v] = bound;
                *alive = bits(simd.greater_than_f64s(bound, limits), mask);
                continue;
            }

            S::as_mut_simd_f64s(&mut out.extent).0[v] = extent;
            // Where every relaxed cost is within the limit nothing can be proven.
            let hopeless = simd.less_than_or_equal_f64s(cost, limits);
            if simd.first_true_m64s(simd.not_m64s(hopeless)) >= LANES / vectors {
                S::as_mut_simd_f64s(&mut out.bound).0[v] = splat(f64::NEG_INFINITY);
                *alive = simd.splat_u64s(mask);
                continue;
            }
            let floor = simd.max_f64s(cost, splat(f64::MIN_POSITIVE));
            let alpha = simd.min_f64s(splat(1.0), simd.sqrt_f64s(simd.div_f64s(limits, floor)));
            let mut base = [zero; FREE + 1];
            let mut square = [zero; 6];
            let mut slopes = [[zero; FREE + 1]; T];
            let (mut lost, mut left, mut crossed) = (zero, zero, zero);
            let mut faint = [zero; FAINT];
            for (k, d) in block.rows.iter().enumerate() {
                let row = rows(k);
                let at = |field: usize| row[field * vectors + v];
                let y_re = mul(alpha, residual[(2 * k) * vectors + v]);
                let y_im = mul(alpha, residual[(2 * k + 1) * vectors + v]);
                let phi = d.directions.map(|x| (splat(x.re), splat(x.im)));
                let y = (y_re, y_im);
                let (b_re, b_im) = (at(field::B_RE), at(field::B_IM));
                form(simd, y, (b_re, b_im), &phi, alone, &mut base);
                let y2 = fma(y_re, y_re, mul(y_im, y_im));
                square[0] = add(square[0], y2);
                if !alone {
                    let [a, b] = d.directions;
                    square[1] = fma(y2, splat(2.0 * a.re), square[1]);
                    square[2] = fma(y2, splat(2.0 * b.re), square[2]);
                    square[3] = fma(y2, splat(a.norm_sqr()), square[3]);
                    square[4] = fma(y2, splat(2.0 * (a.re * b.re + a.im * b.im)), square[4]);
                    square[5] = fma(y2, splat(b.norm_sqr()), square[5]);
                }
                for m in 0..T {
                    let field = field::DIRECTIONS + 3 * m;
                    form(simd, y, (at(field + 1), at(field + 2)), &phi, alone, &mut slopes[m]);
                    // −2 |y|² (1 + 2 Re δ) Re v
                    let w = mul(add(y2, y2), at(field));
                    slopes[m][0] = sub(slopes[m][0], w);
                    if !alone {
                        for i in 0..FREE {
                            slopes[m][i + 1] = nfma(w, splat(2.0 * d.directions[i].re), slopes[m][i + 1]);
                        }
                    }
                }
                if T == 0 {
                    continue;
                }
                let (m_re, m_im) = (sub(at(field::E_RE), y_re), sub(at(field::E_IM), y_im));
                let (g_re, g_im) = (fma(y_re, m_re, mul(y_im, m_im)), nfma(y_im, m_re, mul(y_re, m_im)));
                for (c, faint) in faint.iter_mut().enumerate() {
                    let (v_re, v_im) = (at(field::FAINT + 2 * c), at(field::FAINT + 2 * c + 1));
                    *faint = fma(g_re, v_re, nfma(g_im, v_im, *faint));
                }
                let g2 = fma(g_re, g_re, mul(g_im, g_im));
                let (kappa, rest, scale) = (at(field::RADIUS), at(field::REMAINDER), at(field::SCALE));
                left = fma(mul(scale, scale), g2, left);
                let (delta, more) = (splat(d.radius), splat(1.0 + d.radius));
                let whole = mul(more, kappa);
                lost = fma(y2, mul(whole, whole), lost);
                if !alone {
                    let second = mul(mul(splat(2.0 * d.radius), delta), add(kappa, rest));
                    lost = fma(y2, fma(splat(2.0 * d.radius), mul(rest, more), second), lost);
                    let crossed_here = mul(rest, delta);
                    crossed = fma(mul(crossed_here, crossed_here), g2, crossed);
                }
            }
            let boxes: [(S::f64s, S::f64s); T] =
                std::array::from_fn(|m| (S::as_simd_f64s(&group.low[m]).0[v], S::as_simd_f64s(&group.high[m]).0[v]));
            if T > 0 {
                let reach = S::as_simd_f64s(&group.reach).0[v];
                // Σ r |δ| |g| over the lines, by its root mean square.
                let crossed = mul(splat((block.rows.len() as f64).sqrt()), simd.sqrt_f64s(crossed));
                let left = fma(reach, simd.sqrt_f64s(left), crossed);
                lost = fma(splat(2.0), left, lost);
                for (c, faint) in faint.into_iter().enumerate() {
                    let low = S::as_simd_f64s(&group.low[DIRECTIONS + c]).0[v];
                    let high = S::as_simd_f64s(&group.high[DIRECTIONS + c]).0[v];
                    let slope = add(faint, faint);
                    lost = sub(lost, simd.min_f64s(mul(slope, low), mul(slope, high)));
                }
            }
            let lost = add(lost, slack);
            // All denominators together first: most blocks end here.
            let [reach_a, reach_b] = block.reach.map(splat);
            let spread = |f: &[S::f64s; FREE + 1]| fma(simd.abs_f64s(f[1]), reach_a, mul(simd.abs_f64s(f[2]), reach_b));
            let tilt = [zero, sub(base[1], square[1]), sub(base[2], square[2])];
            let mut whole = sub(sub(sub(base[0], square[0]), spread(&tilt)), lost);
            whole = nfma(mul(reach_a, reach_a), square[3], whole);
            whole = nfma(mul(reach_a, reach_b), simd.abs_f64s(square[4]), whole);
            whole = nfma(mul(reach_b, reach_b), square[5], whole);
            for m in 0..T {
                let (low, high) = boxes[m];
                let centre = simd.min_f64s(mul(slopes[m][0], low), mul(slopes[m][0], high));
                let largest = simd.max_f64s(simd.abs_f64s(low), simd.abs_f64s(high));
                whole = add(whole, nfma(spread(&slopes[m]), largest, centre));
            }
            let dead = simd.greater_than_f64s(whole, limits);
            if alone {
                S::as_mut_simd_f64s(&mut out.bound).0[v] = whole;
                *alive = bits(dead, mask);
                continue;
            }
            if simd.first_true_m64s(simd.not_m64s(dead)) >= LANES / vectors {
                S::as_mut_simd_f64s(&mut out.bound).0[v] = whole;
                *alive = simd.splat_u64s(0);
                continue;
            }
            let mut least = splat(f64::INFINITY);
            let mut living = simd.splat_u64s(0);
            let mut left = mask;
            while left != 0 {
                let j = left.trailing_zeros() as usize;
                left &= left - 1;
                let [o_a, o_b] = block.offsets[j];
                let (a, b) = (splat(o_a), splat(o_b));
                let affine = |f: &[S::f64s; FREE + 1]| fma(f[1], a, fma(f[2], b, f[0]));
                let mut bound = sub(affine(&base), lost);
                bound = sub(bound, fma(square[1], a, fma(square[2], b, square[0])));
                bound = nfma(square[3], splat(o_a * o_a), bound);
                bound = nfma(square[4], splat(o_a * o_b), bound);
                bound = nfma(square[5], splat(o_b * o_b), bound);
                for m in 0..T {
                    let slope = affine(&slopes[m]);
                    bound = add(bound, simd.min_f64s(mul(slope, boxes[m].0), mul(slope, boxes[m].1)));
                }
                living = simd.or_u64s(living, bits(simd.greater_than_f64s(bound, limits), 1 << j));
                // NaN, which says that nothing is known, must stay: `min` may drop it.
                let unknown = simd.not_m64s(simd.less_than_or_equal_f64s(bound, splat(f64::INFINITY)));
                let bound = simd.select_f64s(unknown, splat(f64::NEG_INFINITY), bound);
                least = simd.min_f64s(least, bound);
            }
            S::as_mut_simd_f64s(&mut out.bound).0[v] = least;
            *alive = living;
        }
    }
}
