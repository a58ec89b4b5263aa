//! The relaxed problem whose residual the bound is made of: `kernel.rs` derives it.

use super::block_lanes::{BlockLanes, LANES};
use super::bounds::Bounds;
use super::cluster_frame::{ClusterFrame, field};
use crate::identify::search::sensitivity::build::denominators::FREE;
use crate::identify::search::sensitivity::build::size::DIRECTIONS;
use crate::identify::search::simd::dispatch::Halves;
use crate::identify::search::simd::lanes::{Packed, Real};
use crate::identify::search::simd::ldl::Half;
use pulp::Simd;

/// Numbers per line of the working memory: y, |y|², g, and for each free coefficient `ȳ φ` and `2 |y|² Re φ`.
pub(super) const WORKED: usize = 5 + 3 * FREE;

/// A cluster with some blocks, and where its bounds go.
pub(super) struct Bound<'a, N, const P: usize, const Q: usize, const KNOWN: bool> {
    pub halves: Halves<P, Q, KNOWN>,
    pub frame: &'a ClusterFrame<N>,
    pub blocks: &'a BlockLanes<N>,
    pub limit: N,
    pub scratch: &'a mut [N],
    pub out: &'a mut Bounds<N>,
}

/// A line: the cluster, the basis functions, the blocks.
type Line<'a, N> = ((&'a [N; field::COUNT], &'a [N]), &'a [[N; LANES]; 3]);

/// A number for each coefficient of the numerator, half by half.
type Sides<V, const P: usize, const Q: usize> = ([V; P], [V; Q]);

/// A vector of the lanes.
#[inline(always)]
pub(super) fn vector<S: Simd, N: Real>(simd: S, lanes: &[N; LANES], v: usize) -> Packed<S, N> {
    let vectors = N::vectors::<S>(lanes);
    // A power of two, and v is below: the compiler does not know, and would check.
    Packed::new(simd, vectors[v & (vectors.len() - 1)])
}

/// The relaxed problem of a vector of lanes: the numerator eliminated, a quadratic function of t remains.
#[derive(Clone, Copy)]
pub(super) struct Relaxed<V: Copy, const P: usize, const Q: usize> {
    pub even: Half<V, P>,
    pub odd: Half<V, Q>,
    /// Squares of the columns' lengths.
    pub columns: Sides<V, P, Q>,
    pub determinants: [V; 2],
    /// Right sides of the centre, and along each direction, reduced.
    pub centre: Sides<V, P, Q>,
    pub along: ([[V; P]; DIRECTIONS], [[V; Q]; DIRECTIONS]),
    pub hessian: [[V; DIRECTIONS]; DIRECTIONS],
    pub inverse: [V; DIRECTIONS],
    pub slope: [V; DIRECTIONS],
    pub t: [V; DIRECTIONS],
}

#[allow(clippy::needless_range_loop)]
impl<S: Simd, N: Real, const P: usize, const Q: usize> Relaxed<Packed<S, N>, P, Q> {
    #[inline(always)]
    pub(super) fn none(simd: S) -> Self {
        let zero = Packed::of(simd, N::default());
        Self {
            even: Half::new(zero),
            odd: Half::new(zero),
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
pub(super) struct Summed<V> {
    pub cost: V,
    pub extent: V,
    /// `Σ |r|² Re v_m`.
    pub lean: [V; DIRECTIONS],
}

// Indices run over several arrays at once.
#[allow(clippy::needless_range_loop)]
impl<N: Real, const P: usize, const Q: usize, const KNOWN: bool> Bound<'_, N, P, Q, KNOWN> {
    #[inline(always)]
    pub(super) fn halves(&self) -> (usize, usize) {
        self.halves.sizes(self.frame.halves)
    }

    #[inline(always)]
    pub(super) fn lines(&self) -> impl Iterator<Item = Line<'_, N>> {
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
    pub(super) fn relax<S: Simd>(&self, simd: S, v: usize, into: &mut Relaxed<Packed<S, N>, P, Q>) {
        let (zero, one) = (Packed::of(simd, N::default()), Packed::of(simd, N::nearest(1.0)));
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
        *determinants = [even.determinant(p, one), odd.determinant(q, one)];
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
    pub(super) fn descend<S: Simd>(&self, simd: S, of: &mut [Relaxed<Packed<S, N>, P, Q>], rounds: usize) {
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
    pub(super) fn residual<S: Simd>(
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
