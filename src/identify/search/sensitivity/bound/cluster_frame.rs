//! A cluster of feedback controllers as the kernel reads it: numbers that all lanes share.

use super::lines::{Lines, rounding};
use crate::identify::search::sensitivity::build::cluster::{Cluster, Profile};
use crate::identify::search::sensitivity::build::denominators::{Denominators, FREE};
use crate::identify::search::sensitivity::build::size::{ALL, DIRECTIONS, FAINT, PARTS};
use crate::identify::search::simd::lanes::Real;
use num_complex::Complex64;
use pulp::{Simd, WithSimd};

/// Deviations above this are not worth a bound, which loses their square.
const LARGEST_DEVIATION: f64 = 4.0;

/// Numbers per line.
pub(super) mod field {
    use crate::identify::search::sensitivity::build::size::{DIRECTIONS as T, FAINT as F};
    /// `(E − S) √w`.
    pub(crate) const B: usize = 0;
    /// `S G √w`, turned, in units of its largest modulus.
    pub(crate) const SG: usize = 2;
    /// `E √w`.
    pub(crate) const E: usize = 4;
    /// Largest |κ|, and largest rest behind the leading directions.
    pub(crate) const RADIUS: usize = 6;
    pub(crate) const REMAINDER: usize = 7;
    /// Square of what a member typically leaves over behind all directions.
    pub(crate) const SCALE: usize = 8;
    /// Conjugate of SG times B.
    pub(crate) const TURNED_B: usize = 9;
    /// Re v of each leading direction.
    pub(crate) const REAL: usize = 11;
    /// `E √w v` of each leading direction: the real parts, then the imaginary parts, as below.
    pub(crate) const A: [usize; 2] = [REAL + T, REAL + 2 * T];
    /// Conjugate of SG times that.
    pub(crate) const TURNED_A: [usize; 2] = [A[1] + T, A[1] + 2 * T];
    /// The faint directions.
    pub(crate) const FAINT: [usize; 2] = [TURNED_A[1] + T, TURNED_A[1] + T + F];
    pub(crate) const COUNT: usize = FAINT[1] + F;
}

/// Functions of the same spans that are orthonormal with these weights, as far as that goes in numbers: the normal
/// equations of most denominators are then well conditioned.
#[inline(always)]
fn orthonormal(functions: &[f64], [even, odd]: [usize; 2], weights: &[f64]) -> Vec<f64> {
    let mut functions = functions.to_vec();
    let count = even + odd;
    for half in [0..even, even..count] {
        for i in half.clone() {
            // Twice is enough.
            for _ in 0..2 {
                for j in half.start..i {
                    let share: f64 = functions.chunks_exact(count).zip(weights).map(|(f, w)| f[i] * f[j] * w).sum();
                    functions.chunks_exact_mut(count).for_each(|f| f[i] -= share * f[j]);
                }
                let norm = functions.chunks_exact(count).zip(weights).map(|(f, w)| f[i] * f[i] * w).sum::<f64>().sqrt();
                if norm > 0.0 && norm.is_finite() {
                    functions.chunks_exact_mut(count).for_each(|f| f[i] /= norm);
                }
            }
        }
    }
    functions
}

/// The cluster. Everything that has the unit of a response is in units of [`Lines::scale`].
#[derive(Debug)]
pub(super) struct ClusterFrame<N> {
    /// How many lines, and how many basis functions of each half.
    pub lines: usize,
    pub halves: [usize; 2],
    /// Basis functions line by line; and per line Re and Im of the powers that go with a denominator's free
    /// coefficients.
    pub functions: Vec<N>,
    pub tangents: Vec<[[N; 2]; FREE]>,
    /// Per line: see [`field`].
    pub rows: Vec<[N; field::COUNT]>,
    /// Per line, |SG|² times the products of the basis functions: the lower triangle of the real half, then of the
    /// imaginary half.
    pub products: Vec<N>,
    /// Ranges of the coordinates along the directions.
    pub low: [N; DIRECTIONS],
    pub high: [N; DIRECTIONS],
    pub ranges: [Range<N>; ALL],
    /// Largest norm of what all directions leave over, in units of the scale.
    pub reach: N,
    /// Products of the leading directions, `Re ⟨E v_i, E v_j⟩`, lower triangle; with `E − S`.
    pub gram: [N; DIRECTIONS * (DIRECTIONS + 1) / 2],
    pub right: [N; DIRECTIONS],
    /// How large what is summed can be: see the kernel's remarks on rounding.
    pub size: N,
    pub magnitude: N,
    pub second: N,
    /// One and the largest |κ|.
    pub most: N,
    /// What the rounding of a member's own response may lose, before the condition of the Gram matrices.
    pub slack: N,
    /// `Σ |E|² w |κ|²`: how far the cluster extends.
    pub extent: f64,
    /// How many parts the cluster has, and their ranges in its own coordinates: along the leading directions part by
    /// part, then along the faint ones for all parts together.
    pub parts: usize,
    pub leading: [[Range<N>; DIRECTIONS]; PARTS],
    pub faint: [Range<[N; PARTS]>; FAINT],
}

/// Numbers from `middle − half` to `middle + half`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Range<T> {
    pub middle: T,
    pub half: T,
}

impl<N: Real> Range<N> {
    /// Rounded outwards.
    #[inline(always)]
    fn new([low, high]: [f64; 2]) -> Self {
        let middle = N::nearest(0.5 * (low + high));
        Self { middle, half: N::above((high - middle.value()).max(middle.value() - low) * (1.0 + f64::EPSILON)) }
    }
}

impl<N: Real> ClusterFrame<N> {
    fn empty() -> Self {
        let zero = N::default();
        Self {
            lines: 0,
            halves: [0; 2],
            functions: Vec::new(),
            tangents: Vec::new(),
            rows: Vec::new(),
            products: Vec::new(),
            low: [zero; DIRECTIONS],
            high: [zero; DIRECTIONS],
            ranges: [Range { middle: zero, half: zero }; ALL],
            reach: zero,
            gram: [zero; DIRECTIONS * (DIRECTIONS + 1) / 2],
            right: [zero; DIRECTIONS],
            size: zero,
            magnitude: zero,
            second: zero,
            most: zero,
            slack: zero,
            extent: 0.0,
            parts: 0,
            leading: [[Range { middle: zero, half: zero }; DIRECTIONS]; PARTS],
            faint: [Range { middle: [zero; PARTS], half: [zero; PARTS] }; FAINT],
        }
    }

    pub(super) fn new(denominators: &Denominators) -> Self {
        let [even, odd] = denominators.halves;
        let lines = denominators.powers.len();
        let width = (even * (even + 1) + odd * (odd + 1)) / 2;
        let tangents = denominators.powers.iter().map(|z| z.map(|z| [N::nearest(z.re), N::nearest(z.im)]));
        Self {
            lines,
            halves: denominators.halves,
            functions: denominators.functions.iter().map(|f| N::nearest(*f)).collect(),
            tangents: tangents.collect(),
            rows: vec![[N::default(); field::COUNT]; lines],
            products: vec![N::default(); lines * width],
            ..Self::empty()
        }
    }

    /// Whether a cluster is worth a bound.
    pub(super) fn can_hold(cluster: &Cluster, lines: &Lines) -> bool {
        cluster.reach.is_finite() && (0..lines.constants.len()).all(|k| cluster.profile(k).radius <= LARGEST_DEVIATION)
    }

    /// Reads the cluster.
    pub(super) fn fill(&mut self, cluster: &Cluster, lines: &Lines, denominators: &Denominators) {
        pulp::Arch::new().dispatch(Fill { frame: self, cluster, lines, denominators });
    }

    /// Reads the ranges of the parts.
    pub(super) fn fill_parts<'c>(&mut self, cluster: &Cluster, parts: impl Iterator<Item = &'c Cluster>) {
        self.parts = 0;
        for child in parts {
            let part = self.parts;
            for (m, into) in self.leading[part].iter_mut().enumerate() {
                *into = Range::new(child.range_within(cluster, m));
            }
            for (m, into) in self.faint.iter_mut().enumerate() {
                let Range { middle, half } = Range::new(child.range_within(cluster, DIRECTIONS + m));
                (into.middle[part], into.half[part]) = (middle, half);
            }
            self.parts += 1;
        }
    }

    /// Whether single precision would lose too much of a bound to be compared with this limit, in units of
    /// [`Lines::scale`] squared.
    pub(super) fn is_too_fine(&self, limit: f64) -> bool {
        const LEAST: f64 = 1e-3;
        limit < (LEAST * self.size.value()).powi(2)
    }
}

struct Fill<'a, N> {
    frame: &'a mut ClusterFrame<N>,
    cluster: &'a Cluster,
    lines: &'a Lines,
    denominators: &'a Denominators,
}

impl<N: Real> WithSimd for Fill<'_, N> {
    type Output = ();

    /// Pod loops, which the compiler vectorises for the dispatched instructions.
    #[inline(always)]
    // Indices run over several arrays at once.
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { frame, cluster, lines, denominators } = self;
        let [even, odd] = frame.halves;
        let mut largest = 0.0_f64;
        for (k, c) in lines.constants.iter().enumerate() {
            largest = largest.max((cluster.centre(k).inv() * c.plant).norm_sqr());
        }
        let unit = 1.0 / largest.sqrt();
        let weights = lines.constants.iter().enumerate().zip(&denominators.typical);
        let weights: Vec<f64> =
            weights.map(|((k, c), typical)| (cluster.centre(k).inv() * c.plant * unit).norm_sqr() * typical).collect();
        let functions = orthonormal(&denominators.functions, frame.halves, &weights);
        frame.functions.iter_mut().zip(&functions).for_each(|(into, f)| *into = N::nearest(*f));
        let mut gram = [[0.0; DIRECTIONS]; DIRECTIONS];
        let mut right = [0.0; DIRECTIONS];
        let (mut b2, mut size, mut slack, mut extent, mut most) = (0.0, 0.0, 0.0, 0.0, 0.0_f64);
        let (mut lengths, mut longest) = ([0.0; ALL], [0.0_f64; ALL]);
        let mut products = frame.products.iter_mut();
        for ((k, c), row) in lines.constants.iter().enumerate().zip(&mut frame.rows) {
            let (error, root) = (c.error / lines.scale, c.root / lines.scale);
            let s = cluster.centre(k).inv();
            let b = error - s * root;
            let sg = s * c.plant * unit;
            let mut put = |at: usize, z: Complex64| (row[at], row[at + 1]) = (N::nearest(z.re), N::nearest(z.im));
            put(field::B, b);
            put(field::SG, sg);
            put(field::E, error);
            put(field::TURNED_B, sg.conj() * b);
            let [v_re, v_im] = cluster.directions(k);
            let (mut re, mut im) = ([0.0; ALL], [0.0; ALL]);
            for m in 0..ALL {
                re[m] = error.re * v_re[m] - error.im * v_im[m];
                im[m] = error.re * v_im[m] + error.im * v_re[m];
                lengths[m] += re[m] * re[m] + im[m] * im[m];
                longest[m] = longest[m].max(v_re[m] * v_re[m] + v_im[m] * v_im[m]);
            }
            for m in 0..DIRECTIONS {
                row[field::REAL + m] = N::nearest(v_re[m]);
                row[field::A[0] + m] = N::nearest(re[m]);
                row[field::A[1] + m] = N::nearest(im[m]);
                row[field::TURNED_A[0] + m] = N::nearest(sg.re * re[m] + sg.im * im[m]);
                row[field::TURNED_A[1] + m] = N::nearest(sg.re * im[m] - sg.im * re[m]);
                right[m] += re[m] * b.re + im[m] * b.im;
            }
            for m in 0..FAINT {
                row[field::FAINT[0] + m] = N::nearest(v_re[DIRECTIONS + m]);
                row[field::FAINT[1] + m] = N::nearest(v_im[DIRECTIONS + m]);
            }
            for (i, gram) in gram.iter_mut().enumerate() {
                for (j, gram) in gram.iter_mut().enumerate() {
                    *gram += re[i] * re[j] + im[i] * im[j];
                }
            }
            let Profile { radius, remainder, scale } = cluster.profile(k);
            row[field::RADIUS] = N::above(radius);
            row[field::REMAINDER] = N::above(remainder);
            row[field::SCALE] = N::above(scale * scale * (1.0 + f64::EPSILON));
            let functions = &functions[k * (even + odd)..(k + 1) * (even + odd)];
            for half in [&functions[..even], &functions[even..]] {
                for i in 0..half.len() {
                    for (f, product) in half[..=i].iter().zip(products.by_ref()) {
                        *product = N::nearest(half[i] * f * sg.norm_sqr());
                    }
                }
            }
            let (e2, s2) = (error.norm_sqr(), s.norm_sqr());
            b2 += b.norm_sqr();
            size += (e2.sqrt() * (1.0 + radius) + s2.sqrt() * root).powi(2);
            most = most.max(radius);
            extent += e2 * radius * radius;
            // 2 Σ w (|E|² (1 + |κ|)² + σ²|S|²), with the cancellation in 1 + L of σ = (1 + |L|)/|1 + L|, where |L| ≤ 1
            // + |1 + L|: σ² ≤ 8 |S|² + 2.
            slack += 2.0 * (e2 * (1.0 + radius).powi(2) + root * root * s2 * (8.0 * s2 + 2.0));
        }
        let mut magnitude = b2.sqrt();
        let mut second = (1.0 + most).powi(2);
        let mut n = 0;
        for m in 0..ALL {
            let [low, high] = cluster.range(m);
            let furthest = low.abs().max(high.abs());
            magnitude += furthest * lengths[m].sqrt();
            second += furthest * longest[m].sqrt();
            frame.ranges[m] = Range::new([low, high]);
            if m < DIRECTIONS {
                (frame.low[m], frame.high[m]) = (N::nearest(low), N::nearest(high));
                frame.right[m] = N::nearest(right[m]);
                for entry in &gram[m][..=m] {
                    frame.gram[n] = N::nearest(*entry);
                    n += 1;
                }
            }
        }
        frame.reach = N::above(f64::from(cluster.reach));
        frame.size = N::above(size.sqrt() * (1.0 + 1e-12));
        frame.magnitude = N::above(magnitude * (1.0 + 1e-12));
        frame.second = N::above(second * (1.0 + 1e-12));
        frame.most = N::above(1.0 + most);
        frame.slack = N::above(rounding(lines) * slack);
        frame.extent = extent;
    }
}
