//! Eight clusters of feedback controllers, or eight single ones, as the kernel reads them.

use super::cell::{Cell, Profile};
use super::lines::Lines;
use pulp::{Simd, WithSimd};

/// Clusters per group.
pub(super) const LANES: usize = 8;

/// Leading directions of a cluster, to which y adapts.
pub(super) const DIRECTIONS: usize = 6;

/// Faint ones after them, along which the bound only takes the worst.
pub(super) const FAINT: usize = 6;
pub(super) const ALL: usize = DIRECTIONS + FAINT;

/// Deviations above this claim nothing: their remainder is said to be so large that no bound is left of it. Not infinite, which makes no
/// number of a product with zero.
const LARGEST_DEVIATION: f64 = 4.0;
const UNKNOWN: f64 = 1e60;

/// Fields of a group per line.
pub(super) mod field {
    /// `(E − S) √w`.
    pub const B_RE: usize = 0;
    pub const B_IM: usize = 1;
    /// `S G √w`, turned.
    pub const SG_RE: usize = 2;
    pub const SG_IM: usize = 3;
    /// Largest |κ|, and largest rest behind the leading directions.
    pub const RADIUS: usize = 4;
    pub const REMAINDER: usize = 5;
    /// `E √w`.
    pub const E_RE: usize = 6;
    pub const E_IM: usize = 7;
    /// Re v_m, then Re and Im of `E √w v_m`.
    pub const DIRECTIONS: usize = 8;
    /// Re and Im of a faint direction.
    pub const FAINT: usize = DIRECTIONS + 3 * super::DIRECTIONS;
    /// What a member typically leaves over behind all directions.
    pub const SCALE: usize = FAINT + 2 * super::FAINT;
    pub const COUNT: usize = SCALE + 1;
}

type Lanes = [f64; LANES];

/// The group.
#[derive(Debug)]
pub(super) struct Group {
    pub fields: Vec<f64>,
    /// Ranges of the coordinates along the directions.
    pub low: [Lanes; ALL],
    pub high: [Lanes; ALL],
    /// Largest norm of what all directions leave over, in units of the scale.
    pub reach: Lanes,
    /// Products of the directions, `Re ⟨E v_i, E v_j⟩`, lower triangle; with `E − S`.
    pub gram: [Lanes; DIRECTIONS * (DIRECTIONS + 1) / 2],
    pub right: [Lanes; DIRECTIONS],
    /// What rounding may lose, before the condition of the Gram matrices.
    pub slack: Lanes,
    /// `Σ |E|² w |κ|²`: how far the clusters extend.
    pub extent: Lanes,
    /// How many lanes hold something of their own.
    pub filled: usize,
    /// Whether they are clusters.
    pub extended: bool,
}

impl Group {
    pub(super) fn new(lines: &Lines) -> Self {
        Self {
            fields: vec![0.0; lines.constants.len() * field::COUNT * LANES],
            low: [[0.0; LANES]; ALL],
            high: [[0.0; LANES]; ALL],
            reach: [0.0; LANES],
            gram: [[0.0; LANES]; DIRECTIONS * (DIRECTIONS + 1) / 2],
            right: [[0.0; LANES]; DIRECTIONS],
            slack: [0.0; LANES],
            extent: [0.0; LANES],
            filled: 0,
            extended: false,
        }
    }

    /// Fills the lanes with up to eight clusters; the lanes left over repeat the last.
    pub(super) fn fill_cells<'c>(&mut self, lines: &Lines, cells: impl Iterator<Item = &'c Cell>) {
        self.begin(true);
        for cell in cells {
            self.put(lines, cell);
        }
        self.end(lines);
    }

    /// Fills the lanes with `count` single controllers by their `1 + L`: per line eight real and eight imaginary parts, of which those left
    /// over repeat the last.
    pub(super) fn fill_single(&mut self, lines: &Lines, responses: &[f64], count: usize) {
        self.begin(false);
        self.filled = count;
        pulp::Arch::new().dispatch(Single { lines, responses, group: self });
    }

    fn begin(&mut self, extended: bool) {
        (self.filled, self.extended) = (0, extended);
    }

    fn put(&mut self, lines: &Lines, cell: &Cell) {
        let lane = self.filled;
        self.filled += 1;
        let (mut scale, mut extent) = (0.0, 0.0);
        for (k, row) in self.fields.chunks_exact_mut(field::COUNT * LANES).enumerate() {
            let c = &lines.constants[k];
            let s = cell.centre(k).inv();
            let b = c.error - s * c.root;
            let sg = s * c.plant;
            let mut put = |field: usize, value: f64| row[field * LANES + lane] = value;
            put(field::B_RE, b.re);
            put(field::B_IM, b.im);
            put(field::SG_RE, sg.re);
            put(field::SG_IM, sg.im);
            let Profile { radius, remainder, scale: rest } = cell.profile(k);
            let known = radius <= LARGEST_DEVIATION;
            put(field::RADIUS, radius.min(LARGEST_DEVIATION));
            put(field::REMAINDER, if known { remainder } else { UNKNOWN });
            put(field::SCALE, if known { rest } else { UNKNOWN });
            put(field::E_RE, c.error.re);
            put(field::E_IM, c.error.im);
            for m in 0..DIRECTIONS {
                let v = cell.direction(m, k);
                let a = c.error * v;
                put(field::DIRECTIONS + 3 * m, v.re);
                put(field::DIRECTIONS + 3 * m + 1, a.re);
                put(field::DIRECTIONS + 3 * m + 2, a.im);
            }
            for m in 0..FAINT {
                let v = cell.direction(DIRECTIONS + m, k);
                put(field::FAINT + 2 * m, v.re);
                put(field::FAINT + 2 * m + 1, v.im);
            }
            extent += c.error.norm_sqr() * radius * radius;
            // 2 Σ w (|E|² (1 + |κ|)² + σ²|S|²), with the cancellation in 1 + L of σ = (1 + |L|)/|1 + L|, where |L| ≤ 1 + |1 + L|:
            // σ² ≤ 8 |S|² + 2.
            let s2 = s.norm_sqr();
            scale += 2.0 * (c.error.norm_sqr() * (1.0 + radius).powi(2) + c.root * c.root * s2 * (8.0 * s2 + 2.0));
        }
        self.slack[lane] = rounding(lines) * scale;
        self.extent[lane] = extent;
        self.reach[lane] = f64::from(cell.reach);
        for m in 0..ALL {
            [self.low[m][lane], self.high[m][lane]] = cell.range(m);
        }
    }

    fn end(&mut self, lines: &Lines) {
        let last = self.filled - 1;
        for lane in self.filled..LANES {
            self.fields.chunks_exact_mut(LANES).for_each(|row| row[lane] = row[last]);
            let rows =
                self.low.iter_mut().chain(&mut self.high).chain([&mut self.slack, &mut self.extent, &mut self.reach]);
            rows.for_each(|row| row[lane] = row[last]);
        }
        pulp::Arch::new().dispatch(Products { lines: lines.constants.len(), group: self });
    }
}

/// What a unit of magnitude may lose by rounding, before the condition.
fn rounding(lines: &Lines) -> f64 {
    32.0 * (2 * lines.constants.len() + 32) as f64 * f64::EPSILON
}

struct Single<'a> {
    lines: &'a Lines,
    responses: &'a [f64],
    group: &'a mut Group,
}

impl WithSimd for Single<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { lines, responses, group } = self;
        let (slack, _) = S::as_mut_simd_f64s(&mut group.slack);
        let vectors = slack.len();
        let mul = |a, b| simd.mul_f64s(a, b);
        let fma = |a, b, c| simd.mul_add_e_f64s(a, b, c);
        let nfma = |a, b, c| simd.negate_mul_add_e_f64s(a, b, c);
        let splat = |x| simd.splat_f64s(x);
        slack.iter_mut().for_each(|s| *s = splat(0.0));
        let (responses, _) = S::as_simd_f64s(responses);
        let rows = group.fields.chunks_exact_mut(field::COUNT * LANES);
        for ((k, row), c) in rows.enumerate().zip(&lines.constants) {
            let (row, _) = S::as_mut_simd_f64s(row);
            let (e2, w) = (c.error.norm_sqr(), c.root * c.root);
            for v in 0..vectors {
                let (re, im) = (responses[2 * k * vectors + v], responses[(2 * k + 1) * vectors + v]);
                let s2 = simd.div_f64s(splat(1.0), fma(re, re, mul(im, im)));
                let (s_re, s_im) = (mul(re, s2), nfma(im, s2, splat(0.0)));
                let mut put = |field: usize, value| row[field * vectors + v] = value;
                put(field::B_RE, nfma(s_re, splat(c.root), splat(c.error.re)));
                put(field::B_IM, nfma(s_im, splat(c.root), splat(c.error.im)));
                let (g_re, g_im) = (splat(c.plant.re), splat(c.plant.im));
                put(field::SG_RE, nfma(s_im, g_im, mul(s_re, g_re)));
                put(field::SG_IM, fma(s_im, g_re, mul(s_re, g_im)));
                // As for clusters, without their extent.
                let sensitive = mul(mul(s2, splat(w)), fma(splat(8.0), s2, splat(2.0)));
                slack[v] = simd.add_f64s(slack[v], fma(splat(2.0), sensitive, splat(2.0 * e2)));
            }
        }
        slack.iter_mut().for_each(|s| *s = mul(*s, splat(rounding(lines))));
    }
}

struct Products<'a> {
    lines: usize,
    group: &'a mut Group,
}

impl WithSimd for Products<'_> {
    type Output = ();

    #[inline(always)]
    // The index runs over several arrays at once.
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { lines, group } = self;
        let vectors = S::as_simd_f64s(&group.slack).0.len();
        let zero = simd.splat_f64s(0.0);
        for v in 0..vectors {
            let mut gram = [zero; DIRECTIONS * (DIRECTIONS + 1) / 2];
            let mut right = [zero; DIRECTIONS];
            for k in 0..lines {
                let (row, _) = S::as_simd_f64s(&group.fields[k * field::COUNT * LANES..(k + 1) * field::COUNT * LANES]);
                let at = |field: usize| row[field * vectors + v];
                let (b_re, b_im) = (at(field::B_RE), at(field::B_IM));
                let mut n = 0;
                for i in 0..DIRECTIONS {
                    let (re, im) = (at(field::DIRECTIONS + 3 * i + 1), at(field::DIRECTIONS + 3 * i + 2));
                    right[i] = simd.mul_add_e_f64s(re, b_re, simd.mul_add_e_f64s(im, b_im, right[i]));
                    for j in 0..=i {
                        let (re_j, im_j) = (at(field::DIRECTIONS + 3 * j + 1), at(field::DIRECTIONS + 3 * j + 2));
                        gram[n] = simd.mul_add_e_f64s(re, re_j, simd.mul_add_e_f64s(im, im_j, gram[n]));
                        n += 1;
                    }
                }
            }
            for (out, value) in group.gram.iter_mut().zip(gram).chain(group.right.iter_mut().zip(right)) {
                S::as_mut_simd_f64s(out).0[v] = value;
            }
        }
    }
}
