//! Lower bounds for eight clusters of feedback controllers at once, against one cluster of feedforward denominators.
//!
//! # Bound
//! With the measured error `E = 1 − H`, the sensitivity `S = 1/(1 + G Gfb)` and the feedforward N/D, the residual at a line is
//! `e = E − S + (S G / D) N`, and a candidate costs `J = min_N ‖e‖²`. By duality, for **any** y that is orthogonal to the columns of N,
//! `J ≥ 2⟨y, E − S⟩ − ‖y‖²`. Let a cluster have the centre `S, D` and a member `S/(1+κ), D(1+δ)`. If y is orthogonal to the columns of
//! the centre, then `y · conj((1+κ)(1+δ))` is orthogonal to those of the member, so with one y every member has the bound
//!
//! `J ≥ 2 Re Σ ȳ (E(1+κ) − S)(1+δ) − Σ |y|² |1+κ|² |1+δ|²`.
//!
//! Here `y = α r` with the centre's least-squares residual r. To first order the bound is linear in κ and δ, with the coefficients
//! `2 α r̄ M` and `2 α r̄ (M − S)`, where `M = E − α r`, and since r is orthogonal to the columns, whatever part of a variation
//! the feedforward numerator can make up for drops out of it. With `κ = T (e^Λ − 1)`, `T = G Gfb/(1 + G Gfb)`, and Λ the sum of the
//! deviations of numerator, denominator and gain in logarithms, the linear part is minimised over the boxes of the clusters'
//! coordinates. With `Λ = λ + ρ`, λ along the directions, the quadratic part `2 α Re Σ r̄ M T λ²/2` has one coefficient per pair of
//! coordinates; r is nearly orthogonal to whatever is smooth, so these are far smaller than the moduli of their terms. Squares
//! are minimised with their linear part, products by their moduli. What is left:
//!
//! `2 α Σ |r| |M| (|T| (ρ (1 + |Λ| + ρ/2) + e^|Λ| − 1 − |Λ| − |Λ|²/2) + |κ| |δ|) + α² Σ |r|² ((1+|κ|)(1+|δ|) − 1)²`,
//!
//! its first sum by Cauchy and Schwarz. `α = min(1, √(limit/J))` is best for proving that members cost more than `limit`.
//!
//! # Rounding
//! Sums of K complex terms and the elimination err by multiples of γ = (2K + 32) ε. The computed r is orthogonal to the columns only
//! up to γ √C times their norms, and what a member's numerator x makes of that is first order in γ: with the columns at unit norm,
//! `‖x‖₁ ≤ √(n C/λ_min)`, and a positive definite matrix of order n with unit diagonal has `1/λ_min ≤ e/det`. So with
//! `C = 2 Σ weight (|E|² + σ²|S|²)`, where `σ = (1+|L|)/|1+L|` is the cancellation in 1 + L, the bound can lose
//! `16 γ C (1 + √(e p/det_p) + √(e q/det_q))` for halves of p and q coefficients, which also covers the rounding of the QR that decides.

pub(super) use super::super::decide::may_reach;
use super::axis::DIRECTIONS;
use crate::identify::problem::Problem;
use num_complex::Complex64;
use pulp::{Simd, WithSimd};

/// Clusters per group.
pub(super) const LANES: usize = 8;

/// The largest half of a feedforward numerator that the kernel takes.
pub(super) const LARGEST_HALF: usize = 8;

/// Deviations in logarithms above this claim nothing: their remainder is said to be so large that no bound is left of it. Not
/// infinite, which makes no number of a product with zero.
const LARGEST_DEVIATION: f64 = 2.0;
const UNKNOWN: f64 = 1e60;

/// What a trial and its lines give.
#[derive(Debug)]
pub(super) struct Lines {
    count: usize,
    even: usize,
    odd: usize,
    /// Per line: Re E, Im E, Re G, Im G, √weight, and Re and Im of the rotation of the half-bases.
    constants: Vec<[f64; 7]>,
    /// Per line: the products of the Gram matrices' lower triangles, row by row, the real half first.
    products: Vec<f64>,
    /// Per line: the basis functions.
    functions: Vec<f64>,
}

impl Lines {
    pub(super) fn new(problem: &Problem) -> Self {
        let (even, odd) = (problem.basis().even(), problem.basis().odd());
        let (mut constants, mut products, mut functions) = (Vec::new(), Vec::new(), Vec::new());
        for (k, line) in problem.lines().iter().enumerate() {
            let error = 1.0 - line.response;
            // The numerator is turned back by this angle from where it splits into halves.
            let rotation = Complex64::from_polar(1.0, -problem.basis().rotation(line.omega_rad_s));
            constants.push([
                error.re,
                error.im,
                line.plant.re,
                line.plant.im,
                line.weight.sqrt(),
                rotation.re,
                rotation.im,
            ]);
            for part in [even, odd] {
                for i in 0..part.len() {
                    products.extend((0..=i).map(|j| part.values[i][k] * part.values[j][k]));
                }
                functions.extend(part.values.iter().map(|v| v[k]));
            }
        }
        Self { count: problem.lines().len(), even: even.len(), odd: odd.len(), constants, products, functions }
    }

    fn product_count(&self) -> usize {
        (self.even * (self.even + 1) + self.odd * (self.odd + 1)) / 2
    }
}

/// A cluster of feedforward denominators at the lines.
#[derive(Debug)]
pub(super) struct Denominators {
    /// Per line: Re and Im of 1/D, the radius of δ, Re and Im of each direction.
    rows: Vec<[f64; 3 + 2 * DIRECTIONS]>,
    /// Per line: the products of [`Lines`], over |D|².
    products: Vec<f64>,
    low: [f64; DIRECTIONS],
    high: [f64; DIRECTIONS],
    spread: f64,
    /// Per line: what the directions leave over; empty where that is rounding.
    remainder: Vec<f64>,
}

/// Remainders below this share of the radius are rounding, which the slack covers.
const LINEAR: f64 = 1e-12;

impl Denominators {
    pub(super) fn new(lines: &Lines, node: &super::axis::Node) -> Self {
        let (mut rows, mut products) = (Vec::new(), Vec::new());
        for k in 0..lines.count {
            let inverse = node.centre[k].inv();
            let mut row = [0.0; 3 + 2 * DIRECTIONS];
            (row[0], row[1], row[2]) = (inverse.re, inverse.im, node.radius[k]);
            for m in 0..DIRECTIONS {
                let direction = node.directions[m * lines.count + k];
                (row[3 + 2 * m], row[4 + 2 * m]) = (direction.re, direction.im);
            }
            rows.push(row);
            let (u, width) = (inverse.norm_sqr(), lines.product_count());
            products.extend(lines.products[k * width..(k + 1) * width].iter().map(|p| p * u));
        }
        let linear = node.remainder.iter().zip(&node.radius).all(|(left, radius)| *left <= LINEAR * (1.0 + radius));
        let remainder = if linear { Vec::new() } else { node.remainder.clone() };
        Self { rows, products, low: node.low, high: node.high, spread: node.spread, remainder }
    }
}

/// Fields of a group per line, as it is filled in.
mod given {
    pub const P_RE: usize = 0;
    pub const P_IM: usize = 1;
    pub const Z_RE: usize = 2;
    pub const Z_IM: usize = 3;
    /// Radius of the logarithmic deviation of numerator and denominator together.
    pub const RADIUS: usize = 4;
    /// What their directions leave over.
    pub const REMAINDER: usize = 5;
    /// Directions: of the denominator, then of the numerator, real and imaginary parts.
    pub const DIRECTIONS: usize = 6;
    pub const COUNT: usize = DIRECTIONS + 4 * super::DIRECTIONS;
}

/// Fields of a group per line, as they are computed once per trial.
mod found {
    pub const ES_RE: usize = 0;
    pub const ES_IM: usize = 1;
    /// S G √weight, turned.
    pub const SG_RE: usize = 2;
    pub const SG_IM: usize = 3;
    /// conj(S G) (S − E) weight, turned back.
    pub const B_RE: usize = 4;
    pub const B_IM: usize = 5;
    /// |S G|² weight.
    pub const A: usize = 6;
    pub const S_RE: usize = 7;
    pub const S_IM: usize = 8;
    pub const T_RE: usize = 9;
    pub const T_IM: usize = 10;
    /// |T| (ρ (1 + |Λ| + ρ/2) + e^|Λ| − 1 − |Λ| − |Λ|²/2).
    pub const CURVATURE: usize = 11;
    /// Bound of |κ|.
    pub const KAPPA: usize = 12;
    pub const COUNT: usize = 13;
}

/// Eight clusters of feedback controllers.
#[derive(Debug)]
pub(super) struct Group {
    lines: usize,
    given: Vec<f64>,
    found: Vec<f64>,
    /// Gain at the centre, with its sign; half width of its logarithm.
    gain: [f64; LANES],
    half: [f64; LANES],
    /// Ranges of the coordinates along the directions, in the order of the fields.
    low: [[f64; LANES]; 2 * DIRECTIONS],
    high: [[f64; LANES]; 2 * DIRECTIONS],
    /// What rounding may lose, before the condition of the Gram matrices.
    slack: [f64; LANES],
    /// Whether any cluster holds more than its centre.
    extended: bool,
}

/// What a lane is filled with: the centres, and for a cluster its deviations.
#[derive(Clone, Copy)]
pub(super) struct Cell<'a> {
    pub denominator: &'a [Complex64],
    pub numerator: &'a [Complex64],
    pub gain: f64,
    pub half: f64,
    pub clusters: Option<[&'a super::axis::Node; 2]>,
}

impl Group {
    pub(super) fn new(lines: &Lines) -> Self {
        let count = lines.count;
        Self {
            lines: count,
            given: vec![0.0; count * given::COUNT * LANES],
            found: vec![0.0; count * found::COUNT * LANES],
            gain: [0.0; LANES],
            half: [0.0; LANES],
            low: [[0.0; LANES]; 2 * DIRECTIONS],
            high: [[0.0; LANES]; 2 * DIRECTIONS],
            slack: [0.0; LANES],
            extended: false,
        }
    }

    /// Fills the lanes with up to eight cells of one kind, single controllers or clusters; the lanes left over repeat the last.
    pub(super) fn fill<'c>(&mut self, lines: &Lines, mut cells: impl Iterator<Item = Cell<'c>>) {
        let Some(mut last) = cells.next() else { return };
        let mut lanes = [last; LANES];
        for lane in &mut lanes[1..] {
            last = cells.next().unwrap_or(last);
            *lane = last;
        }
        self.gain = lanes.map(|cell| cell.gain);
        self.half = lanes.map(|cell| cell.half);
        for c in 0..2 {
            for m in 0..DIRECTIONS {
                self.low[c * DIRECTIONS + m] = lanes.map(|cell| cell.clusters.map_or(0.0, |n| n[c].low[m]));
                self.high[c * DIRECTIONS + m] = lanes.map(|cell| cell.clusters.map_or(0.0, |n| n[c].high[m]));
            }
        }
        self.extended = lanes[0].clusters.is_some();
        self.put(&lanes);
        pulp::Arch::new().dispatch(Prepare { lines, group: self });
    }

    /// Line by line, so that what is written stays near: lane by lane it took more time than the bounds.
    fn put(&mut self, lanes: &[Cell<'_>; LANES]) {
        let count = self.lines;
        let centres = lanes.map(|cell| [&cell.denominator[..count], &cell.numerator[..count]]);
        for (k, row) in self.given.chunks_exact_mut(given::COUNT * LANES).enumerate() {
            for (lane, [p, z]) in centres.iter().enumerate() {
                row[given::P_RE * LANES + lane] = p[k].re;
                row[given::P_IM * LANES + lane] = p[k].im;
                row[given::Z_RE * LANES + lane] = z[k].re;
                row[given::Z_IM * LANES + lane] = z[k].im;
            }
        }
        let Some(first) = lanes[0].clusters else { return };
        let nodes = lanes.map(|cell| cell.clusters.unwrap_or(first));
        let sides = nodes.map(|nodes| nodes.map(|n| (&n.radius[..count], &n.remainder[..count], &n.directions[..])));
        for (k, row) in self.given.chunks_exact_mut(given::COUNT * LANES).enumerate() {
            for (lane, [p, z]) in sides.iter().enumerate() {
                row[given::RADIUS * LANES + lane] = p.0[k] + z.0[k] + lanes[lane].half;
                row[given::REMAINDER * LANES + lane] = p.1[k] + z.1[k];
                for (c, (_, _, directions)) in [p, z].into_iter().enumerate() {
                    for m in 0..DIRECTIONS {
                        let v = directions[m * count + k];
                        let field = given::DIRECTIONS + 2 * (c * DIRECTIONS + m);
                        row[field * LANES + lane] = v.re;
                        row[(field + 1) * LANES + lane] = v.im;
                    }
                }
            }
        }
    }
}

struct Prepare<'a> {
    lines: &'a Lines,
    group: &'a mut Group,
}

impl WithSimd for Prepare<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { lines, group } = self;
        let extended = group.extended;
        let (gain, _) = S::as_simd_f64s(&group.gain);
        let (slack, _) = S::as_mut_simd_f64s(&mut group.slack);
        let vectors = gain.len();
        let mul = |a, b| simd.mul_f64s(a, b);
        let fma = |a, b, c| simd.mul_add_e_f64s(a, b, c);
        let nfma = |a, b, c| simd.negate_mul_add_e_f64s(a, b, c);
        let splat = |x| simd.splat_f64s(x);
        let (zero, one) = (splat(0.0), splat(1.0));
        slack.iter_mut().for_each(|s| *s = zero);
        let rows = group.given.chunks_exact(given::COUNT * LANES);
        let out = group.found.chunks_exact_mut(found::COUNT * LANES);
        for ((row, out), c) in rows.zip(out).zip(&lines.constants) {
            let (row, _) = S::as_simd_f64s(row);
            let (out, _) = S::as_mut_simd_f64s(out);
            let (e_re, e_im, g_re, g_im, root) = (splat(c[0]), splat(c[1]), splat(c[2]), splat(c[3]), splat(c[4]));
            for v in 0..vectors {
                let at = |field: usize| row[field * vectors + v];
                // L = G · gain · numerator/denominator, by components.
                let (p_re, p_im) = (mul(at(given::P_RE), gain[v]), mul(at(given::P_IM), gain[v]));
                let (z_re, z_im) = (at(given::Z_RE), at(given::Z_IM));
                let f_re = nfma(p_im, z_im, mul(p_re, z_re));
                let f_im = fma(p_im, z_re, mul(p_re, z_im));
                let l_re = nfma(g_im, f_im, mul(g_re, f_re));
                let l_im = fma(g_im, f_re, mul(g_re, f_im));
                let d_re = simd.add_f64s(one, l_re);
                let square = fma(d_re, d_re, mul(l_im, l_im));
                let inverse = simd.div_f64s(one, square);
                let (s_re, s_im) = (mul(d_re, inverse), simd.neg_f64s(mul(l_im, inverse)));
                let t_re = nfma(l_im, s_im, mul(l_re, s_re));
                let t_im = fma(l_im, s_re, mul(l_re, s_im));
                let (ws_re, ws_im) = (mul(s_re, root), mul(s_im, root));
                let es_re = nfma(s_re, root, mul(e_re, root));
                let es_im = nfma(s_im, root, mul(e_im, root));
                let sg_re = nfma(ws_im, g_im, mul(ws_re, g_re));
                let sg_im = fma(ws_im, g_re, mul(ws_re, g_im));
                let (r_re, r_im) = (splat(c[5]), splat(c[6]));
                let (sg_re, sg_im) = (nfma(sg_im, r_im, mul(sg_re, r_re)), fma(sg_im, r_re, mul(sg_re, r_im)));
                // −conj(SG) (E − S)
                let b_re = simd.neg_f64s(fma(sg_im, es_im, mul(sg_re, es_re)));
                let b_im = simd.neg_f64s(nfma(sg_im, es_re, mul(sg_re, es_im)));
                let mut put = |field: usize, value| out[field * vectors + v] = value;
                put(found::ES_RE, es_re);
                put(found::ES_IM, es_im);
                put(found::SG_RE, sg_re);
                put(found::SG_IM, sg_im);
                put(found::B_RE, b_re);
                put(found::B_IM, b_im);
                put(found::A, fma(sg_re, sg_re, mul(sg_im, sg_im)));
                put(found::S_RE, ws_re);
                put(found::S_IM, ws_im);
                // C = 2 Σ w (|E|² + σ²|S|²), σ² ≤ 2 (1 + |L|²) |S|².
                let l2 = fma(l_re, l_re, fma(l_im, l_im, one));
                let e2 = fma(e_re, e_re, mul(e_im, e_im));
                let sigma = mul(splat(2.0), mul(l2, inverse));
                let sum = mul(splat(2.0 * c[4] * c[4]), fma(sigma, inverse, e2));
                slack[v] = simd.add_f64s(slack[v], sum);
                if extended {
                    let modulus = simd.sqrt_f64s(fma(t_re, t_re, mul(t_im, t_im)));
                    let x = at(given::RADIUS);
                    let rho = at(given::REMAINDER);
                    // e^x − 1 − x − x²/2 ≤ x³ (1/6 + x (1/24 + x/82)) up to x = 2.
                    let x2 = mul(x, x);
                    let third = mul(mul(x, x2), fma(x, fma(x, splat(1.0 / 82.0), splat(1.0 / 24.0)), splat(1.0 / 6.0)));
                    let small = simd.less_than_or_equal_f64s(x, splat(LARGEST_DEVIATION));
                    let third = simd.select_f64s(small, third, splat(UNKNOWN));
                    // Λ²/2 − λ²/2 = ρ (Λ − ρ/2).
                    let left = mul(rho, fma(rho, splat(0.5), simd.add_f64s(x, splat(1.0))));
                    let exponential = fma(x2, splat(0.5), simd.add_f64s(x, third));
                    put(found::T_RE, t_re);
                    put(found::T_IM, t_im);
                    put(found::CURVATURE, mul(modulus, simd.add_f64s(left, third)));
                    put(found::KAPPA, mul(modulus, exponential));
                }
            }
        }
        let gamma = 16.0 * (2 * lines.count + 32) as f64 * f64::EPSILON;
        slack.iter_mut().for_each(|s| *s = mul(*s, splat(gamma)));
    }
}

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

/// Bounds of a group with a cluster of denominators, for proving that members cost more than `limit`.
pub(super) fn bounds(
    lines: &Lines,
    group: &Group,
    denominators: &Denominators,
    limit: f64,
    scratch: &mut Vec<f64>,
) -> Bounds {
    let mut out = Bounds::default();
    scratch.resize(2 * lines.count * LANES, 0.0);
    let arch = pulp::Arch::new();
    macro_rules! with {
        ($p:literal, $q:literal) => {
            arch.dispatch(Bound::<'_, $p, $q> { lines, group, denominators, limit, scratch, out: &mut out })
        };
    }
    match (lines.even, lines.odd) {
        (1, 0) => with!(1, 0),
        (1, 1) => with!(1, 1),
        (2, 1) => with!(2, 1),
        (2, 2) => with!(2, 2),
        (3, 2) => with!(3, 2),
        (3, 3) => with!(3, 3),
        (4, 3) => with!(4, 3),
        (4, 4) => with!(4, 4),
        _ => with!(8, 8),
    }
    out
}

struct Bound<'a, const P: usize, const Q: usize> {
    lines: &'a Lines,
    group: &'a Group,
    denominators: &'a Denominators,
    limit: f64,
    scratch: &'a mut [f64],
    out: &'a mut Bounds,
}

/// The normal equations of one half, G x = b, by their lower triangle.
struct Half<V, const N: usize> {
    gram: [[V; N]; N],
    right: [V; N],
}

// Indices run over rows and columns of several arrays at once.
#[allow(clippy::needless_range_loop)]
impl<V: Copy, const N: usize> Half<V, N> {
    /// Solves in place; `right` becomes x. Returns the determinant of G scaled to unit diagonal.
    #[inline(always)]
    fn solve<S: Simd<f64s = V>>(&mut self, simd: S, n: usize) -> V {
        let one = simd.splat_f64s(1.0);
        let mut determinant = one;
        // G = L D Lᵀ; L below the diagonal, L D above, 1/D in `inverse`.
        let mut inverse = [one; N];
        for j in 0..n {
            let diagonal = self.gram[j][j];
            let mut pivot = diagonal;
            for k in 0..j {
                pivot = simd.negate_mul_add_e_f64s(self.gram[j][k], self.gram[k][j], pivot);
            }
            inverse[j] = simd.div_f64s(one, pivot);
            determinant = simd.mul_f64s(determinant, simd.div_f64s(pivot, diagonal));
            for i in j + 1..n {
                let mut entry = self.gram[i][j];
                for k in 0..j {
                    entry = simd.negate_mul_add_e_f64s(self.gram[i][k], self.gram[k][j], entry);
                }
                self.gram[j][i] = entry;
                self.gram[i][j] = simd.mul_f64s(entry, inverse[j]);
            }
            for k in 0..j {
                self.right[j] = simd.negate_mul_add_e_f64s(self.gram[j][k], self.right[k], self.right[j]);
            }
        }
        for j in (0..n).rev() {
            self.right[j] = simd.mul_f64s(self.right[j], inverse[j]);
            for i in j + 1..n {
                self.right[j] = simd.negate_mul_add_e_f64s(self.gram[i][j], self.right[i], self.right[j]);
            }
        }
        determinant
    }
}

impl<const P: usize, const Q: usize> WithSimd for Bound<'_, P, Q> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { lines, group, denominators, limit, scratch, out } = self;
        let (p, q) = if P == LARGEST_HALF { (lines.even, lines.odd) } else { (P, Q) };
        let width = (p * (p + 1) + q * (q + 1)) / 2;
        let vectors = S::as_simd_f64s(&group.gain).0.len();
        let mul = |a, b| simd.mul_f64s(a, b);
        let fma = |a, b, c| simd.mul_add_e_f64s(a, b, c);
        let nfma = |a, b, c| simd.negate_mul_add_e_f64s(a, b, c);
        let splat = |x| simd.splat_f64s(x);
        let zero = splat(0.0);
        let (residual, _) = S::as_mut_simd_f64s(scratch);
        for v in 0..vectors {
            let mut even = Half::<S::f64s, P> { gram: [[zero; P]; P], right: [zero; P] };
            let mut odd = Half::<S::f64s, Q> { gram: [[zero; Q]; Q], right: [zero; Q] };
            for (k, d) in denominators.rows.iter().enumerate() {
                let (row, _) = S::as_simd_f64s(&group.found[k * found::COUNT * LANES..(k + 1) * found::COUNT * LANES]);
                let at = |field: usize| row[field * vectors + v];
                let products = &denominators.products[k * width..(k + 1) * width];
                let functions = &lines.functions[k * (p + q)..(k + 1) * (p + q)];
                let a = at(found::A);
                let (b_re, b_im) = (at(found::B_RE), at(found::B_IM));
                // conj(1/D) B
                let (i_re, i_im) = (splat(d[0]), splat(d[1]));
                let right_re = fma(i_im, b_im, mul(i_re, b_re));
                let right_im = nfma(i_im, b_re, mul(i_re, b_im));
                let mut n = 0;
                for i in 0..p {
                    for j in 0..=i {
                        even.gram[i][j] = fma(a, splat(products[n]), even.gram[i][j]);
                        n += 1;
                    }
                    even.right[i] = fma(right_re, splat(functions[i]), even.right[i]);
                }
                for i in 0..q {
                    for j in 0..=i {
                        odd.gram[i][j] = fma(a, splat(products[n]), odd.gram[i][j]);
                        n += 1;
                    }
                    odd.right[i] = fma(right_im, splat(functions[p + i]), odd.right[i]);
                }
            }
            let even_determinant = even.solve(simd, p);
            let odd_determinant = odd.solve(simd, q);
            // The residual, and its inner product with E − S.
            let mut cost = zero;
            for (k, d) in denominators.rows.iter().enumerate() {
                let (row, _) = S::as_simd_f64s(&group.found[k * found::COUNT * LANES..(k + 1) * found::COUNT * LANES]);
                let at = |field: usize| row[field * vectors + v];
                let functions = &lines.functions[k * (p + q)..(k + 1) * (p + q)];
                let (mut n_re, mut n_im) = (zero, zero);
                for i in 0..p {
                    n_re = fma(even.right[i], splat(functions[i]), n_re);
                }
                for i in 0..q {
                    n_im = fma(odd.right[i], splat(functions[p + i]), n_im);
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
            let slack = mul(S::as_simd_f64s(&group.slack).0[v], condition);
            S::as_mut_simd_f64s(&mut out.cost).0[v] = cost;
            let bound = &mut S::as_mut_simd_f64s(&mut out.bound).0[v];
            if !group.extended && denominators.spread == 0.0 {
                *bound = simd.sub_f64s(cost, slack);
                continue;
            }

            // Where every centre is good, nothing can be proven, and nothing needs to be computed.
            let hopeless = simd.less_than_or_equal_f64s(cost, splat(limit));
            if group.extended && simd.first_true_m64s(simd.not_m64s(hopeless)) >= LANES / vectors {
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
                let (row, _) = S::as_simd_f64s(&group.found[k * found::COUNT * LANES..(k + 1) * found::COUNT * LANES]);
                let (box_row, _) =
                    S::as_simd_f64s(&group.given[k * given::COUNT * LANES..(k + 1) * given::COUNT * LANES]);
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
                if group.extended {
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
            let half = S::as_simd_f64s(&group.half).0[v];
            let square = mul(splat(0.5), mul(half, half));
            let inner = simd.less_than_f64s(half, splat(1.0));
            let gain_low = simd.select_f64s(inner, simd.sub_f64s(square, half), splat(-0.5));
            let mut linear_own = support(gain_slope, gain_low, simd.add_f64s(square, half));
            let mut extent = [zero; 2 * DIRECTIONS];
            for i in 0..2 * DIRECTIONS {
                let (low, high) = (S::as_simd_f64s(&group.low[i]).0[v], S::as_simd_f64s(&group.high[i]).0[v]);
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
