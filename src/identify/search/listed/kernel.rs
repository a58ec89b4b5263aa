//! Lower bounds for a cluster of feedback controllers against blocks of feedforward denominators, a block in each lane.
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
//! The computed y is taken as it is; what matters is how far it is from orthogonal, and what the sums above lose.
//! With unit roundoff u:
//! - Its products with the columns are computed as well, to (2C + 14) u ‖y‖ in units of a column's length, with C lines. Of a member within the limit, the
//!   numerator's part of the residual is no longer than `n = (‖(|E| (1 + |κ|) + |S|)‖ + √limit (1 + |κ|)) (1 + |δ|)`, and its coefficients
//!   in those units no longer than `n √(e/det)` for a half whose Gram matrix, scaled to unit diagonal, has the determinant det (the other
//!   eigenvalues have a product below e). That matrix and its factors err by no more than (C + 16) u in an entry, so det by that times
//!   the square of its order.
//! - A sum over the lines has at most 2C + 16 roundings in its terms and after each other, and 48 more follow on the way to the bound.
//!   Nothing is lost but (4C + 80) u times the moduli that are summed: `‖y‖ (‖E − S‖ + Σ |t_m| ‖E v_m‖)` and
//!   `‖y‖² ((1 + |κ|)² + Σ |t_m v_m|)`, each with `(1 + |δ|)²`.
//!   A box is kept as its middle and half its width, rounded outwards: the products of a slope with both have the modulus that its
//!   product with the furthest end has.
//! - Where a square of the rest underflows, a line loses less than the smallest normal number of it, which is added. Everything else that
//!   may underflow is far below the terms above, since the limit is not below a millionth of the size squared.
//! - The member's own response has an error of its own, as derived in `single.rs`.

mod conclude;

use super::blocks::{Blocks, LANES};
use super::denominators::FREE;
use super::frame::{Frame, field};
use super::real::{Half, Packed, Real};
use super::{DIRECTIONS, FAINT};
use pulp::{Simd, WithSimd};

/// The largest half of a feedforward numerator that the kernel takes.
pub(super) const LARGEST_HALF: usize = 8;

/// Rounds of coordinate descent, at first and again. More would tighten the bound a little, fewer would loosen it.
const ROUNDS: [usize; 2] = [4, 3];

/// Numbers per line of the working memory: y, |y|², g, and for each free coefficient `ȳ φ` and `2 |y|² Re φ`.
const WORKED: usize = 5 + 3 * FREE;

/// What is known about the cluster together with each of the blocks.
#[derive(Debug, Clone, Default)]
pub(super) struct Bounds<N> {
    /// Cost of the relaxed problem.
    pub cost: [N; LANES],
    /// No member with any denominator of the block costs less, rounding included; −∞ or NaN where nothing is known.
    pub whole: [N; LANES],
    /// `Σ |E − S|² w |δ|²`: how far the block extends.
    pub extent: [N; LANES],
    /// The bound's parts, affine and quadratic in the offsets: `base − square − lost + Σ_m min over the box of slope_m t_m`.
    pub base: [[N; LANES]; FREE + 1],
    pub square: [[N; LANES]; 6],
    pub slopes: [[[N; LANES]; FREE + 1]; DIRECTIONS],
    /// Slopes along the faint directions, for all denominators of the block.
    pub faint: [[N; LANES]; FAINT],
    pub lost: [N; LANES],
}

/// Bounds of a cluster with some blocks.
pub(super) fn bounds<N: Real>(
    frame: &Frame<N>,
    blocks: &Blocks<N>,
    limit: N,
    scratch: &mut Vec<N>,
    out: &mut Bounds<N>,
) {
    scratch.resize(WORKED * frame.lines * LANES, N::default());
    let arch = pulp::Arch::new();
    macro_rules! with {
        ($p:literal, $q:literal) => {
            arch.dispatch(Bound::<'_, N, $p, $q> { frame, blocks, limit, scratch, out })
        };
    }
    match frame.halves {
        [1, 1] => with!(1, 1),
        [2, 1] => with!(2, 1),
        [2, 2] => with!(2, 2),
        [3, 2] => with!(3, 2),
        [3, 3] => with!(3, 3),
        _ => with!(8, 8),
    }
}

struct Bound<'a, N, const P: usize, const Q: usize> {
    frame: &'a Frame<N>,
    blocks: &'a Blocks<N>,
    limit: N,
    scratch: &'a mut [N],
    out: &'a mut Bounds<N>,
}

/// A line: the cluster, the basis functions, the blocks.
type Line<'a, N> = ((&'a [N; field::COUNT], &'a [N]), &'a [[N; LANES]; 3]);

/// A number for each coefficient of the numerator, half by half.
type Sides<V, const P: usize, const Q: usize> = ([V; P], [V; Q]);

/// A vector of the lanes.
#[inline(always)]
fn vector<S: Simd, N: Real>(simd: S, lanes: &[N; LANES], v: usize) -> Packed<S, N> {
    let vectors = N::vectors::<S>(lanes);
    // A power of two, and v is below: the compiler does not know, and would check.
    Packed::new(simd, vectors[v & (vectors.len() - 1)])
}

/// The relaxed problem of a vector of lanes: the numerator eliminated, a quadratic function of t remains.
#[derive(Clone, Copy)]
struct Relaxed<V: Copy, const P: usize, const Q: usize> {
    even: Half<V, P>,
    odd: Half<V, Q>,
    /// Squares of the columns' lengths.
    columns: Sides<V, P, Q>,
    determinants: [V; 2],
    /// Right sides of the centre, and along each direction, reduced.
    centre: Sides<V, P, Q>,
    along: ([[V; P]; DIRECTIONS], [[V; Q]; DIRECTIONS]),
    hessian: [[V; DIRECTIONS]; DIRECTIONS],
    inverse: [V; DIRECTIONS],
    slope: [V; DIRECTIONS],
    t: [V; DIRECTIONS],
}

#[allow(clippy::needless_range_loop)]
impl<S: Simd, N: Real, const P: usize, const Q: usize> Relaxed<Packed<S, N>, P, Q> {
    #[inline(always)]
    fn none(simd: S) -> Self {
        let zero = Packed::of(simd, N::default());
        Self {
            even: Half { gram: [[zero; P]; P], inverse: [zero; P] },
            odd: Half { gram: [[zero; Q]; Q], inverse: [zero; Q] },
            columns: ([zero; P], [zero; Q]),
            determinants: [zero; 2],
            centre: ([zero; P], [zero; Q]),
            along: ([[zero; P]; DIRECTIONS], [[zero; Q]; DIRECTIONS]),
            hessian: [[zero; DIRECTIONS]; DIRECTIONS],
            inverse: [zero; DIRECTIONS],
            slope: [zero; DIRECTIONS],
            t: [zero; DIRECTIONS],
        }
    }

    /// The best t_i with all others fixed.
    #[inline(always)]
    fn step(&mut self, i: usize, low: Packed<S, N>, high: Packed<S, N>) {
        let mut sum = self.slope[i];
        // What has just changed comes last, so that the rest need not wait for it.
        for j in i + 1..DIRECTIONS {
            sum = self.hessian[i][j].times_plus(self.t[j], sum);
        }
        for j in 0..i {
            sum = self.hessian[i][j].times_plus(self.t[j], sum);
        }
        self.t[i] = (sum * self.inverse[i]).max(low).min(high);
    }
}

/// What the residual of a relaxed problem sums up to.
struct Summed<V> {
    cost: V,
    extent: V,
    /// `Σ |r|² Re v_m`.
    lean: [V; DIRECTIONS],
}

// Indices run over several arrays at once.
#[allow(clippy::needless_range_loop)]
impl<N: Real, const P: usize, const Q: usize> Bound<'_, N, P, Q> {
    #[inline(always)]
    fn halves(&self) -> (usize, usize) {
        if P == LARGEST_HALF { (self.frame.halves[0], self.frame.halves[1]) } else { (P, Q) }
    }

    #[inline(always)]
    fn lines(&self) -> impl Iterator<Item = Line<'_, N>> {
        let (p, q) = self.halves();
        self.frame.rows.iter().zip(self.frame.functions.chunks_exact(p + q)).zip(&self.blocks.rows)
    }

    /// Products of the columns with what is at some fields, once turned by the conjugate of SG.
    #[inline(always)]
    fn products<S: Simd, const F: usize>(
        &self,
        simd: S,
        fields: [[usize; 2]; F],
        v: usize,
    ) -> [Sides<Packed<S, N>, P, Q>; F] {
        let zero = Packed::of(simd, N::default());
        let (p, q) = self.halves();
        let mut products = [([zero; P], [zero; Q]); F];
        for ((row, functions), block) in self.lines() {
            let (i_re, i_im) = (vector(simd, &block[0], v), vector(simd, &block[1], v));
            for ((even, odd), [re, im]) in products.iter_mut().zip(fields) {
                let (c_re, c_im) = (Packed::of(simd, row[re]), Packed::of(simd, row[im]));
                let re = i_re.times_plus(c_re, i_im * c_im);
                let im = i_im.times_from(c_re, i_re * c_im);
                for i in 0..p {
                    even[i] = re.times_plus(Packed::of(simd, functions[i]), even[i]);
                }
                for i in 0..q {
                    odd[i] = im.times_plus(Packed::of(simd, functions[p + i]), odd[i]);
                }
            }
        }
        products
    }

    #[inline(always)]
    fn relax<S: Simd>(&self, simd: S, v: usize, into: &mut Relaxed<Packed<S, N>, P, Q>) {
        let zero = Packed::of(simd, N::default());
        let (p, q) = self.halves();
        // In place: it is large.
        let Relaxed { even, odd, columns, determinants, centre, along, hessian, inverse, slope, t } = into;
        (even.gram, odd.gram) = ([[zero; P]; P], [[zero; Q]; Q]);
        let width = (p * (p + 1) + q * (q + 1)) / 2;
        for (products, block) in self.frame.products.chunks_exact(width).zip(&self.blocks.rows) {
            let (i_re, i_im) = (vector(simd, &block[0], v), vector(simd, &block[1], v));
            let u = i_re.times_plus(i_re, i_im * i_im);
            let mut n = 0;
            for i in 0..p {
                for j in 0..=i {
                    even.gram[i][j] = u.times_plus(Packed::of(simd, products[n]), even.gram[i][j]);
                    n += 1;
                }
            }
            for i in 0..q {
                for j in 0..=i {
                    odd.gram[i][j] = u.times_plus(Packed::of(simd, products[n]), odd.gram[i][j]);
                    n += 1;
                }
            }
        }
        for i in 0..p {
            columns.0[i] = even.gram[i][i];
        }
        for i in 0..q {
            columns.1[i] = odd.gram[i][i];
        }
        *determinants = [even.factor(simd, p), odd.factor(simd, q)];
        let reduced = |(mut e, mut o): Sides<Packed<S, N>, P, Q>| {
            even.forward(p, &mut e);
            odd.forward(q, &mut o);
            (e, o)
        };
        let [turned_b] = self.products(simd, [[field::TURNED_B, field::TURNED_B + 1]], v);
        *centre = reduced(turned_b);
        // Two directions in a pass have their sums in registers.
        for pair in 0..DIRECTIONS / 2 {
            let fields = |m: usize| [field::TURNED_A[0] + m, field::TURNED_A[1] + m];
            let products = self.products(simd, [fields(2 * pair), fields(2 * pair + 1)], v);
            for (m, products) in products.into_iter().enumerate() {
                (along.0[2 * pair + m], along.1[2 * pair + m]) = reduced(products);
            }
        }
        let least = Packed::of(simd, N::nearest(1e-14));
        let mut n = 0;
        for i in 0..DIRECTIONS {
            let (e, o) = (along.0[i], along.1[i]);
            let (mut over_e, mut over_o) = (e, o);
            for k in 0..p {
                over_e[k] = over_e[k] * even.inverse[k];
            }
            for k in 0..q {
                over_o[k] = over_o[k] * odd.inverse[k];
            }
            let reduce = |mut sum: Packed<S, N>, e: &[Packed<S, N>; P], o: &[Packed<S, N>; Q]| {
                for k in 0..p {
                    sum = over_e[k].times_from(e[k], sum);
                }
                for k in 0..q {
                    sum = over_o[k].times_from(o[k], sum);
                }
                sum
            };
            slope[i] = reduce(Packed::of(simd, self.frame.right[i]), &centre.0, &centre.1);
            for j in 0..=i {
                let entry = reduce(Packed::of(simd, self.frame.gram[n]), &along.0[j], &along.1[j]);
                n += 1;
                (hessian[i][j], hessian[j][i]) = (entry, entry);
            }
            inverse[i] = Packed::of(simd, N::nearest(-1.0)).over(hessian[i][i].max(least));
        }
        *t = [zero; DIRECTIONS];
    }

    /// Coordinate descent over the box, for two vectors in turns so that neither waits for itself.
    #[inline(always)]
    fn descend<S: Simd>(&self, simd: S, of: &mut [Relaxed<Packed<S, N>, P, Q>], rounds: usize) {
        if let [one, other] = of {
            for _ in 0..rounds {
                for i in 0..DIRECTIONS {
                    let (low, high) = (Packed::of(simd, self.frame.low[i]), Packed::of(simd, self.frame.high[i]));
                    one.step(i, low, high);
                    other.step(i, low, high);
                }
            }
        } else if let [one] = of {
            for _ in 0..rounds {
                for i in 0..DIRECTIONS {
                    let (low, high) = (Packed::of(simd, self.frame.low[i]), Packed::of(simd, self.frame.high[i]));
                    one.step(i, low, high);
                }
            }
        }
    }

    /// Leaves the residual in the working memory.
    #[inline(always)]
    fn residual<S: Simd>(
        &self,
        simd: S,
        v: usize,
        of: &Relaxed<Packed<S, N>, P, Q>,
        worked: &mut [N::Vector<S>],
    ) -> Summed<Packed<S, N>> {
        let zero = Packed::of(simd, N::default());
        let (p, q) = self.halves();
        let (mut even, mut odd) = of.centre;
        for m in 0..DIRECTIONS {
            for i in 0..p {
                even[i] = of.along.0[m][i].times_plus(of.t[m], even[i]);
            }
            for i in 0..q {
                odd[i] = of.along.1[m][i].times_plus(of.t[m], odd[i]);
            }
        }
        of.even.backward(p, &mut even);
        of.odd.backward(q, &mut odd);
        let mut sums = Summed { cost: zero, extent: zero, lean: [zero; DIRECTIONS] };
        for (((row, functions), block), worked) in self.lines().zip(worked.chunks_exact_mut(WORKED)) {
            let (i_re, i_im) = (vector(simd, &block[0], v), vector(simd, &block[1], v));
            let radius = vector(simd, &block[2], v);
            let (mut n_re, mut n_im) = (zero, zero);
            for i in 0..p {
                n_re = even[i].times_plus(Packed::of(simd, functions[i]), n_re);
            }
            for i in 0..q {
                n_im = odd[i].times_plus(Packed::of(simd, functions[p + i]), n_im);
            }
            let (q_re, q_im) = (i_im.times_from(n_im, i_re * n_re), i_im.times_plus(n_re, i_re * n_im));
            let (s_re, s_im) = (Packed::of(simd, row[field::SG]), Packed::of(simd, row[field::SG + 1]));
            let (b_re, b_im) = (Packed::of(simd, row[field::B]), Packed::of(simd, row[field::B + 1]));
            sums.extent = (radius * radius).times_plus(b_re.times_plus(b_re, b_im * b_im), sums.extent);
            let mut r_re = s_im.times_plus(q_im, s_re.times_from(q_re, b_re));
            let mut r_im = s_im.times_from(q_re, s_re.times_from(q_im, b_im));
            for m in 0..DIRECTIONS {
                r_re = of.t[m].times_plus(Packed::of(simd, row[field::A[0] + m]), r_re);
                r_im = of.t[m].times_plus(Packed::of(simd, row[field::A[1] + m]), r_im);
            }
            let square = r_re.times_plus(r_re, r_im * r_im);
            sums.cost = sums.cost + square;
            for (m, lean) in sums.lean.iter_mut().enumerate() {
                *lean = square.times_plus(Packed::of(simd, row[field::REAL + m]), *lean);
            }
            (worked[0], worked[1]) = (r_re.x, r_im.x);
        }
        sums
    }
}

impl<N: Real, const P: usize, const Q: usize> Bound<'_, N, P, Q> {
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

impl<N: Real, const P: usize, const Q: usize> WithSimd for Bound<'_, N, P, Q> {
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
