//! Eight clusters of feedback controllers, or single ones, as the kernel reads them.

use super::lines::Lines;
use super::tree::{DIRECTIONS, Node};
use num_complex::Complex64;
use pulp::{Simd, WithSimd};

/// Clusters of feedback controllers that are bounded at once.
pub(super) const LANES: usize = 8;

/// Deviations in logarithms above this claim nothing: their remainder is said to be so large that no bound is left of
/// it. Not infinite, which makes no number of a product with zero.
const LARGEST_DEVIATION: f64 = 2.0;
const UNKNOWN: f64 = 1e60;

/// Fields of the lanes per line, as it is filled in.
pub(super) mod given {
    pub(crate) const P_RE: usize = 0;
    pub(crate) const P_IM: usize = 1;
    pub(crate) const Z_RE: usize = 2;
    pub(crate) const Z_IM: usize = 3;
    /// Radius of the logarithmic deviation of numerator and denominator together.
    pub(crate) const RADIUS: usize = 4;
    /// What their directions leave over.
    pub(crate) const REMAINDER: usize = 5;
    /// Directions: of the denominator, then of the numerator, real and imaginary parts.
    pub(crate) const DIRECTIONS: usize = 6;
    pub(crate) const COUNT: usize = DIRECTIONS + 4 * super::DIRECTIONS;
}

/// Fields of the lanes per line, as they are computed once per trial.
pub(super) mod found {
    pub(crate) const ES_RE: usize = 0;
    pub(crate) const ES_IM: usize = 1;
    /// S G √weight, turned.
    pub(crate) const SG_RE: usize = 2;
    pub(crate) const SG_IM: usize = 3;
    /// conj(S G) (S − E) weight, turned back.
    pub(crate) const B_RE: usize = 4;
    pub(crate) const B_IM: usize = 5;
    /// |S G|² weight.
    pub(crate) const A: usize = 6;
    pub(crate) const S_RE: usize = 7;
    pub(crate) const S_IM: usize = 8;
    pub(crate) const T_RE: usize = 9;
    pub(crate) const T_IM: usize = 10;
    /// |T| (ρ (1 + |Λ| + ρ/2) + e^|Λ| − 1 − |Λ| − |Λ|²/2).
    pub(crate) const CURVATURE: usize = 11;
    /// Bound of |κ|.
    pub(crate) const KAPPA: usize = 12;
    pub(crate) const COUNT: usize = 13;
}

/// Eight clusters of feedback controllers.
#[derive(Debug)]
pub(super) struct FeedbackLanes {
    lines: usize,
    pub given: Vec<f64>,
    pub found: Vec<f64>,
    /// Gain at the centre, with its sign; half width of its logarithm.
    pub gain: [f64; LANES],
    pub half: [f64; LANES],
    /// Ranges of the coordinates along the directions, in the order of the fields.
    pub low: [[f64; LANES]; 2 * DIRECTIONS],
    pub high: [[f64; LANES]; 2 * DIRECTIONS],
    /// What rounding may lose, before the condition of the Gram matrices.
    pub slack: [f64; LANES],
    /// Whether any cluster holds more than its centre.
    pub extended: bool,
}

/// What a lane is filled with: the centres, and for a cluster its deviations.
#[derive(Clone, Copy)]
pub(super) struct FeedbackCluster<'a> {
    pub denominator: &'a [Complex64],
    pub numerator: &'a [Complex64],
    pub gain: f64,
    pub half: f64,
    pub clusters: Option<[&'a Node; 2]>,
}

impl FeedbackLanes {
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

    /// Fills the lanes with up to eight of one kind, single controllers or clusters; the lanes left over repeat
    /// the last.
    pub(super) fn fill<'c>(&mut self, lines: &Lines, mut clusters: impl Iterator<Item = FeedbackCluster<'c>>) {
        let Some(mut last) = clusters.next() else { return };
        let mut lanes = [last; LANES];
        for lane in &mut lanes[1..] {
            last = clusters.next().unwrap_or(last);
            *lane = last;
        }
        self.gain = lanes.map(|cluster| cluster.gain);
        self.half = lanes.map(|cluster| cluster.half);
        for c in 0..2 {
            for m in 0..DIRECTIONS {
                self.low[c * DIRECTIONS + m] = lanes.map(|cluster| cluster.clusters.map_or(0.0, |n| n[c].low[m]));
                self.high[c * DIRECTIONS + m] = lanes.map(|cluster| cluster.clusters.map_or(0.0, |n| n[c].high[m]));
            }
        }
        self.extended = lanes[0].clusters.is_some();
        self.put(&lanes);
        pulp::Arch::new().dispatch(Prepare { lines, feedback: self });
    }

    /// Line by line, so that what is written stays near: lane by lane it took more time than the bounds.
    fn put(&mut self, lanes: &[FeedbackCluster<'_>; LANES]) {
        let count = self.lines;
        let centres = lanes.map(|cluster| [&cluster.denominator[..count], &cluster.numerator[..count]]);
        for (k, row) in self.given.chunks_exact_mut(given::COUNT * LANES).enumerate() {
            for (lane, [p, z]) in centres.iter().enumerate() {
                row[given::P_RE * LANES + lane] = p[k].re;
                row[given::P_IM * LANES + lane] = p[k].im;
                row[given::Z_RE * LANES + lane] = z[k].re;
                row[given::Z_IM * LANES + lane] = z[k].im;
            }
        }
        let Some(first) = lanes[0].clusters else { return };
        let nodes = lanes.map(|cluster| cluster.clusters.unwrap_or(first));
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
    feedback: &'a mut FeedbackLanes,
}

impl WithSimd for Prepare<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { lines, feedback } = self;
        let extended = feedback.extended;
        let (gain, _) = S::as_simd_f64s(&feedback.gain);
        let (slack, _) = S::as_mut_simd_f64s(&mut feedback.slack);
        let vectors = gain.len();
        let mul = |a, b| simd.mul_f64s(a, b);
        let fma = |a, b, c| simd.mul_add_e_f64s(a, b, c);
        let nfma = |a, b, c| simd.negate_mul_add_e_f64s(a, b, c);
        let splat = |x| simd.splat_f64s(x);
        let (zero, one) = (splat(0.0), splat(1.0));
        slack.iter_mut().for_each(|s| *s = zero);
        let rows = feedback.given.chunks_exact(given::COUNT * LANES);
        let out = feedback.found.chunks_exact_mut(found::COUNT * LANES);
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
