//! From the residual of the relaxed problem to the bound: `kernel.rs` derives it.

use super::block_lanes::LANES;
use super::cluster_frame::field;
use super::relaxed::{Bound, Relaxed, Summed, WORKED, vector};
use crate::identify::search::sensitivity::build::denominators::FREE;
use crate::identify::search::sensitivity::build::size::{DIRECTIONS, FAINT};
use crate::identify::search::simd::lanes::{Packed, Real};
use pulp::Simd;

/// Directions whose slopes are summed in one pass.
const TOGETHER: usize = 3;

// Indices run over several arrays at once.
#[allow(clippy::needless_range_loop)]
impl<N: Real, const P: usize, const Q: usize, const KNOWN: bool> Bound<'_, N, P, Q, KNOWN> {
    /// The bound, from the residual in the working memory.
    #[inline(always)]
    #[allow(clippy::too_many_lines)]
    pub(super) fn conclude<S: Simd>(
        &mut self,
        simd: S,
        v: usize,
        of: &Relaxed<Packed<S, N>, P, Q>,
        sums: &Summed<Packed<S, N>>,
        worked: &mut [N::Vector<S>],
    ) {
        let number = |x: f64| Packed::<S, N>::of(simd, N::nearest(x));
        let zero = number(0.0);
        let (p, q) = self.halves();
        let lines = self.frame.lines;
        let alone = self.blocks.alone;
        let limit = Packed::of(simd, self.limit);
        let floor = sums.cost.max(number(1e-35));
        let alpha = number(1.0).min(limit.over(floor).root());
        let (mut base, mut square) = ([zero; FREE + 1], [zero; 6]);
        // What is lost of a square by underflow is made up for, since the reach may be large where the scale is small.
        let (mut left, mut lost, mut crossed) = (number(lines as f64 * N::SMALLEST), zero, zero);
        let mut leaks = ([zero; P], [zero; Q]);
        let rows = self.lines().zip(&self.frame.tangents).zip(worked.chunks_exact_mut(WORKED));
        for ((((row, functions), block), tangents), worked) in rows {
            let (y_re, y_im) = (alpha * Packed::new(simd, worked[0]), alpha * Packed::new(simd, worked[1]));
            let y2 = y_re.times_plus(y_re, y_im * y_im);
            let (b_re, b_im) = (Packed::of(simd, row[field::B]), Packed::of(simd, row[field::B + 1]));
            base[0] = y_re.times_plus(b_re, y_im.times_plus(b_im, base[0]));
            square[0] = square[0] + y2;
            let (i_re, i_im) = (vector(simd, &block[0], v), vector(simd, &block[1], v));
            // How far y is from orthogonal.
            let (s_re, s_im) = (Packed::of(simd, row[field::SG]), Packed::of(simd, row[field::SG + 1]));
            let (w_re, w_im) = (s_re.times_plus(y_re, s_im * y_im), s_im.times_from(y_re, s_re * y_im));
            let (z_re, z_im) = (i_re.times_plus(w_re, i_im * w_im), i_im.times_from(w_re, i_re * w_im));
            for i in 0..p {
                leaks.0[i] = z_re.times_plus(Packed::of(simd, functions[i]), leaks.0[i]);
            }
            for i in 0..q {
                leaks.1[i] = z_im.times_plus(Packed::of(simd, functions[p + i]), leaks.1[i]);
            }
            let (e_re, e_im) = (Packed::of(simd, row[field::E]) - y_re, Packed::of(simd, row[field::E + 1]) - y_im);
            let (g_re, g_im) = (y_re.times_plus(e_re, y_im * e_im), y_im.times_from(e_re, y_re * e_im));
            let g2 = g_re.times_plus(g_re, g_im * g_im);
            left = g2.times_plus(Packed::of(simd, row[field::SCALE]), left);
            let (kappa, rest) = (Packed::of(simd, row[field::RADIUS]), Packed::of(simd, row[field::REMAINDER]));
            let delta = vector(simd, &block[2], v);
            let more = number(1.0) + delta;
            let whole = more * kappa;
            lost = y2.times_plus(whole * whole, lost);
            worked[..5].copy_from_slice(&[y_re.x, y_im.x, y2.x, g_re.x, g_im.x]);
            if alone {
                continue;
            }
            let twice = delta + delta;
            let more = (twice * delta).times_plus(kappa + rest, twice * (rest * more));
            lost = y2.times_plus(more, lost);
            let crossed_here = rest * delta;
            crossed = g2.times_plus(crossed_here * crossed_here, crossed);
            let mut phi = [(zero, zero); FREE];
            for (c, phi) in phi.iter_mut().enumerate() {
                let [re, im] = tangents[c].map(|x| Packed::of(simd, x));
                *phi = (i_im.times_from(im, i_re * re), i_im.times_plus(re, i_re * im));
                let h_re = y_re.times_plus(phi.0, y_im * phi.1);
                let h_im = y_im.times_from(phi.0, y_re * phi.1);
                let x = y2 * phi.0;
                let x = x + x;
                base[c + 1] = h_re.times_plus(b_re, h_im.times_from(b_im, base[c + 1]));
                square[c + 1] = square[c + 1] + x;
                worked[5 + 3 * c..8 + 3 * c].copy_from_slice(&[h_re.x, h_im.x, x.x]);
            }
            let [(a_re, a_im), (c_re, c_im)] = phi;
            square[3] = y2.times_plus(a_re.times_plus(a_re, a_im * a_im), square[3]);
            square[4] = (y2 + y2).times_plus(a_re.times_plus(c_re, a_im * c_im), square[4]);
            square[5] = y2.times_plus(c_re.times_plus(c_re, c_im * c_im), square[5]);
        }
        let mut slopes = [[zero; FREE + 1]; DIRECTIONS];
        // As many directions together as there are registers for their sums.
        for (group, slopes) in slopes.chunks_exact_mut(TOGETHER).enumerate() {
            let mut sums = [[zero; FREE + 1]; TOGETHER];
            for (row, y) in self.frame.rows.iter().zip(worked.chunks_exact(WORKED)) {
                let (y_re, y_im) = (Packed::new(simd, y[0]), Packed::new(simd, y[1]));
                let y2 = Packed::new(simd, y[2]);
                for (m, sums) in sums.iter_mut().enumerate() {
                    let m = TOGETHER * group + m;
                    let (a_re, a_im) = (Packed::of(simd, row[field::A[0] + m]), Packed::of(simd, row[field::A[1] + m]));
                    let real = Packed::of(simd, row[field::REAL + m]);
                    // Re ȳ E v − |y|² Re v
                    sums[0] = y2.times_from(real, y_im.times_plus(a_im, y_re.times_plus(a_re, sums[0])));
                    if alone {
                        continue;
                    }
                    for c in 0..FREE {
                        let of = |at: usize| Packed::new(simd, y[5 + 3 * c + at]);
                        sums[c + 1] =
                            of(2).times_from(real, of(1).times_from(a_im, of(0).times_plus(a_re, sums[c + 1])));
                    }
                }
            }
            for (slopes, sums) in slopes.iter_mut().zip(sums) {
                for (slope, sum) in slopes.iter_mut().zip(sums) {
                    *slope = sum + sum;
                }
            }
        }
        let mut faint = [zero; FAINT];
        for (c, faint) in faint.iter_mut().enumerate() {
            for (row, g) in self.frame.rows.iter().zip(worked.chunks_exact(WORKED)) {
                let (g_re, g_im) = (Packed::<S, N>::new(simd, g[3]), Packed::new(simd, g[4]));
                *faint = g_re.times_plus(Packed::of(simd, row[field::FAINT[0] + c]), *faint);
                *faint = g_im.times_from(Packed::of(simd, row[field::FAINT[1] + c]), *faint);
            }
            *faint = *faint + *faint;
        }
        for base in &mut base {
            *base = *base + *base;
        }

        // What is lost: the rest, and by rounding.
        let u = N::ROUNDOFF;
        let rounded = number((4.0 * lines as f64 + 80.0) * u);
        let one_more = number(1.0) + rounded;
        // Σ r |δ| |g| over the lines, by its root mean square.
        let crossed = number((lines as f64).sqrt()) * crossed.root();
        let left = Packed::of(simd, self.frame.reach).times_plus(left.root(), crossed);
        lost = (lost + (left + left)) * one_more;
        let spread = vector(simd, &self.blocks.spread, v);
        let length = square[0].root();
        let size =
            Packed::of(simd, self.frame.most).times_plus(limit.root(), Packed::of(simd, self.frame.size)) * spread;
        let mut leaked = number(1.0) * Packed::of(simd, self.frame.slack);
        let halves = [(p, &leaks.0[..], &of.columns.0[..]), (q, &leaks.1[..], &of.columns.1[..])];
        for ((n, leaks, columns), determinant) in halves.into_iter().zip(of.determinants) {
            let order = n as f64;
            let mut leak = zero;
            for i in 0..n {
                leak = (leaks[i] * leaks[i]).over(columns[i]) + leak;
            }
            let least = (determinant - number((lines as f64 + 16.0) * u * order * order)).max(number(1e-30));
            let condition = number(std::f64::consts::E).over(least).root();
            let off = number((2.0 * lines as f64 + 14.0) * u * order.sqrt()).times_plus(length, leak.root());
            leaked = (size * condition).times_plus(off + off, leaked);
            leaked = (Packed::of(simd, self.frame.slack) * number(order.sqrt())).times_plus(condition, leaked);
        }
        let terms =
            length.times_plus(Packed::of(simd, self.frame.magnitude), square[0] * Packed::of(simd, self.frame.second));
        lost = lost + (rounded * spread * spread).times_plus(terms, leaked);

        // All denominators and the whole box together: most blocks end here.
        let reach: [Packed<S, N>; FREE] = std::array::from_fn(|c| vector(simd, &self.blocks.reach[c], v));
        let tilt = |a: Packed<S, N>, b: Packed<S, N>| a.modulus().times_plus(reach[0], b.modulus() * reach[1]);
        let mut whole = base[0] - square[0] - lost - tilt(base[1] - square[1], base[2] - square[2]);
        whole = (reach[0] * reach[0]).times_from(square[3], whole);
        whole = (reach[0] * reach[1]).times_from(square[4].modulus(), whole);
        whole = (reach[1] * reach[1]).times_from(square[5], whole);
        for (m, range) in self.frame.ranges.iter().enumerate() {
            let (middle, half) = (Packed::of(simd, range.middle), Packed::of(simd, range.half));
            if m < DIRECTIONS {
                let [centre, a, b] = slopes[m];
                whole = centre.times_plus(middle, whole);
                whole = (centre.modulus()).times_from(half, whole);
                whole = tilt(a, b).times_from(middle.modulus() + half, whole);
            } else {
                let slope = faint[m - DIRECTIONS];
                whole = slope.modulus().times_from(half, slope.times_plus(middle, whole));
            }
        }
        let put = |into: &mut [N; LANES], x: Packed<S, N>| N::vectors_mut::<S>(into)[v] = x.x;
        put(&mut self.out.cost, sums.cost);
        put(&mut self.out.extent, sums.extent);
        put(&mut self.out.whole, whole);
        put(&mut self.out.lost, lost);
        self.out.base.iter_mut().zip(base).for_each(|(into, x)| put(into, x));
        self.out.square.iter_mut().zip(square).for_each(|(into, x)| put(into, x));
        self.out.faint.iter_mut().zip(faint).for_each(|(into, x)| put(into, x));
        for (into, slopes) in self.out.slopes.iter_mut().zip(slopes) {
            into.iter_mut().zip(slopes).for_each(|(into, x)| put(into, x));
        }
    }
}
