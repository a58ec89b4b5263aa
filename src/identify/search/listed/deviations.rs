//! How responses deviate from a centre, eight at a time: their coordinates along directions, and into which part of a division they fall.

use super::principal::Principal;
use super::singles::LANES;
use super::{ALL, DIRECTIONS, PARTS};
use num_complex::{Complex32, Complex64};
use pulp::{Simd, WithSimd};

/// Deviations below this hardly differ from their logarithms.
const NARROW: f64 = 0.5;

/// Rounding of a coordinate or a rest, amply, beside deviations of one.
const ROUNDING: f64 = 1e-14;

/// The middle of a range divides it, unless that leaves less than this share of the sample on one side. Bounds suffer from what is far off,
/// and the middle puts that apart; the median would leave a long tail in every part.
const LEAST_PART: f64 = 0.05;

/// A sample of a cluster around its logarithmic mean.
#[derive(Debug)]
pub(super) struct Splitter {
    /// One response after another.
    sample: Vec<Complex64>,
    centre: Vec<Complex64>,
    inverse: Vec<Complex64>,
    /// Root mean square over the lines of the largest deviation in the sample.
    pub size: f64,
}

/// A division of a cluster into parts: by halving along up to three directions, one after the other.
#[derive(Debug)]
pub(super) struct Split {
    /// In single precision, exactly; and its reciprocal.
    pub centre: Vec<Complex64>,
    inverse: Vec<Complex64>,
    /// Directions of κ, one after another; or of crude logarithms.
    pub directions: Vec<Complex64>,
    /// What a member typically leaves over at each line, as the unit of [`Extent::reach`].
    pub scale: Vec<f64>,
    /// Where each part is halved: a heap.
    thresholds: Vec<f64>,
}

impl Split {
    pub(super) fn parts(&self) -> usize {
        self.thresholds.len() + 1
    }

    fn halvings(&self) -> usize {
        self.parts().ilog2() as usize
    }

    fn part(&self, coordinates: &[f64]) -> u8 {
        let mut node = 1;
        for t in &coordinates[..self.halvings()] {
            node = 2 * node + usize::from(*t > self.thresholds[node - 1]);
        }
        (node - self.parts()) as u8
    }
}

impl Splitter {
    /// From one response after another.
    pub(super) fn new(sample: Vec<Complex64>, lines: usize) -> Self {
        let count = sample.len() / lines;
        let share = 1.0 / count as f64;
        let middle = count / 2 * lines;
        let mut centre = sample[middle..middle + lines].to_vec();
        for (k, c) in centre.iter_mut().enumerate() {
            let here = || sample.iter().skip(k).step_by(lines);
            let inverse = c.inv();
            if here().all(|x| (x * inverse - 1.0).norm_sqr() < NARROW * NARROW) {
                // Here the mean is as good as that of the logarithms.
                *c = here().sum::<Complex64>() * share;
            } else {
                // A second round removes what the branch of the logarithm did to the first.
                for _ in 0..2 {
                    let inverse = c.inv();
                    let mean = here().map(|x| (x * inverse).ln()).sum::<Complex64>() * share;
                    if mean.is_finite() {
                        *c *= mean.exp();
                    }
                }
            }
            let single = Complex32::new(c.re as f32, c.im as f32);
            *c = Complex64::new(f64::from(single.re), f64::from(single.im));
        }
        let inverse: Vec<Complex64> = centre.iter().map(Complex64::inv).collect();
        let mut squares = vec![0.0_f64; lines];
        for x in sample.chunks_exact(lines) {
            for ((square, x), inverse) in squares.iter_mut().zip(x).zip(&inverse) {
                *square = square.max((x * inverse - 1.0).norm_sqr());
            }
        }
        let size = (squares.iter().sum::<f64>() / lines as f64).sqrt();
        Self { sample, centre, inverse, size }
    }

    /// Along the principal directions of crude logarithms, which tell even clusters apart whose members differ by orders of magnitude.
    pub(super) fn by_logarithms(&self, halvings: usize) -> Split {
        self.split(|x| crude_logarithm(x.re, x.im), halvings, halvings)
    }

    /// Along the principal directions of κ.
    pub(super) fn by_coordinates(&self, halvings: usize) -> Split {
        self.split(|x| x - 1.0, ALL, halvings)
    }

    fn split(&self, deviation: impl Fn(Complex64) -> Complex64, count: usize, halvings: usize) -> Split {
        let lines = self.centre.len();
        let mut deviations: Vec<f64> = Vec::with_capacity(2 * self.sample.len());
        for x in self.sample.chunks_exact(lines) {
            for (x, inverse) in x.iter().zip(&self.inverse) {
                let d = deviation(x * inverse);
                deviations.extend([d.re, d.im]);
            }
        }
        let Principal { directions, scale } = Principal::new(&deviations, lines, count);
        let mut split = Split {
            centre: self.centre.clone(),
            inverse: self.inverse.clone(),
            directions,
            scale,
            thresholds: Vec::new(),
        };
        let mut parts = vec![(0..self.sample.len() / lines).collect::<Vec<_>>()];
        for m in 0..halvings {
            let direction = &split.directions[m * lines..(m + 1) * lines];
            let along: Vec<f64> = deviations
                .chunks_exact_mut(2 * lines)
                .map(|x| {
                    let t: f64 = x.chunks_exact(2).zip(direction).map(|(x, d)| x[0] * d.re + x[1] * d.im).sum();
                    for (x, d) in x.chunks_exact_mut(2).zip(direction) {
                        x[0] -= t * d.re;
                        x[1] -= t * d.im;
                    }
                    t
                })
                .collect();
            let mut next = Vec::new();
            for mut part in parts {
                part.sort_by(|a, b| along[*a].total_cmp(&along[*b]));
                let threshold = threshold(part.len(), |at| along[part[at]]);
                split.thresholds.push(threshold);
                let (low, high): (Vec<usize>, Vec<usize>) = part.into_iter().partition(|at| along[*at] <= threshold);
                next.extend([low, high]);
            }
            parts = next;
        }
        split
    }
}

/// Where a sorted sample is divided.
fn threshold(count: usize, sorted: impl Fn(usize) -> f64) -> f64 {
    let Some(last) = count.checked_sub(1) else { return 0.0 };
    let least = (LEAST_PART * last as f64) as usize;
    let middle = 0.5 * (sorted(0) + sorted(last));
    // No number where the ends have none; `clamp` would not take that.
    middle.max(sorted(least)).min(sorted(last - least))
}

/// A monotone stand-in for the logarithm, to some percent, and far quicker: for choosing where to divide, and nothing else.
#[inline(always)]
fn crude_logarithm(re: f64, im: f64) -> Complex64 {
    // Exponent and mantissa, read as one number, are the binary logarithm between powers of two, nearly.
    let square = (re * re + im * im).max(1e-300);
    let logarithm = 0.5 * std::f64::consts::LN_2 * (square.to_bits() as f64 * 2f64.powi(-52) - 1023.0);
    let share = im / (re.abs() + im.abs() + 1e-300);
    let turns = if re >= 0.0 { share } else { 2f64.copysign(im) - share };
    Complex64::new(logarithm, std::f64::consts::FRAC_PI_2 * turns)
}

/// How far a cluster extends around a centre.
#[derive(Debug, Clone)]
pub(super) struct Extent {
    pub low: [f64; ALL],
    pub high: [f64; ALL],
    /// Largest |κ| per line, and largest rest behind the leading directions.
    pub radius: Vec<f64>,
    pub remainder: Vec<f64>,
    /// Largest norm of a rest behind all directions, in units of the scale at each line. Infinite where something is no number.
    pub reach: f64,
}

impl Extent {
    /// With what rounding may hide: `1 + L` is known to ε (1 + |L|), and |L| ≤ 1 + |1 + L|.
    pub(super) fn new(widest: &Widest, split: &Split) -> Self {
        let largest = |lanes: &Lanes| lanes.iter().copied().fold(0.0, f64::max);
        let mut extent = Self {
            low: std::array::from_fn(|m| widest.low[m].iter().copied().fold(0.0, f64::min)),
            high: widest.high.each_ref().map(largest),
            radius: widest.radius.iter().map(|lanes| largest(lanes).sqrt()).collect(),
            remainder: widest.remainder.iter().map(|lanes| largest(lanes).sqrt()).collect(),
            reach: largest(&widest.reach).sqrt(),
        };
        let mut out_of_reach = 0.0;
        for (k, inverse) in split.inverse.iter().enumerate() {
            let hidden = ROUNDING * (3.0 + 2.0 * inverse.norm() + 8.0 * extent.radius[k]);
            extent.radius[k] += hidden;
            extent.remainder[k] += hidden;
            out_of_reach += (hidden / split.scale[k]).powi(2);
        }
        extent.reach = extent.reach * (1.0 + ROUNDING) + out_of_reach.sqrt();
        if widest.sum.iter().any(|sum| !sum.is_finite()) || extent.reach.is_nan() {
            extent.reach = f64::INFINITY;
        }
        extent
    }

    /// Root mean square of the radius over the lines.
    pub(super) fn size(&self) -> f64 {
        (self.radius.iter().map(|r| r * r).sum::<f64>() / self.radius.len() as f64).sqrt()
    }
}

type Lanes = [f64; LANES];

/// The largest of what has passed, lane by lane; moduli as their squares.
#[derive(Debug, Clone)]
pub(super) struct Widest {
    low: [Lanes; ALL],
    high: [Lanes; ALL],
    radius: Vec<Lanes>,
    remainder: Vec<Lanes>,
    reach: Lanes,
    /// Of all squares in `reach`: what is no number stays in a sum, where a maximum may drop it.
    sum: Lanes,
    /// Ranges of the coordinates of each part's members.
    parts: [Ranges; PARTS],
}

/// The smallest and the largest of each coordinate.
#[derive(Debug, Clone)]
struct Ranges {
    low: [f64; ALL],
    high: [f64; ALL],
}

impl Widest {
    pub(super) fn none(lines: usize) -> Self {
        let zero = [0.0; LANES];
        Self {
            low: [zero; ALL],
            high: [zero; ALL],
            radius: vec![zero; lines],
            remainder: vec![zero; lines],
            reach: zero,
            sum: zero,
            parts: std::array::from_fn(|_| Ranges { low: [f64::INFINITY; ALL], high: [f64::NEG_INFINITY; ALL] }),
        }
    }

    /// Ranges of the coordinates of a part's members.
    pub(super) fn ranges(&self, part: usize) -> [[f64; 2]; ALL] {
        let Ranges { low, high } = &self.parts[part];
        std::array::from_fn(|m| [low[m], high[m]])
    }

    pub(super) fn join(mut self, other: &Self) -> Self {
        let with = |into: &mut Lanes, from: &Lanes, of: fn(f64, f64) -> f64| {
            into.iter_mut().zip(from).for_each(|(a, b)| *a = of(*a, *b));
        };
        self.low.iter_mut().zip(&other.low).for_each(|(a, b)| with(a, b, f64::min));
        self.high.iter_mut().zip(&other.high).for_each(|(a, b)| with(a, b, f64::max));
        self.radius.iter_mut().zip(&other.radius).for_each(|(a, b)| with(a, b, f64::max));
        self.remainder.iter_mut().zip(&other.remainder).for_each(|(a, b)| with(a, b, f64::max));
        with(&mut self.reach, &other.reach, f64::max);
        with(&mut self.sum, &other.sum, |a, b| a + b);
        for (mine, theirs) in self.parts.iter_mut().zip(&other.parts) {
            mine.low.iter_mut().zip(&theirs.low).for_each(|(a, b)| *a = a.min(*b));
            mine.high.iter_mut().zip(&theirs.high).for_each(|(a, b)| *a = a.max(*b));
        }
        self
    }
}

/// Puts a response into a lane: per line there are eight real and eight imaginary parts.
#[inline(always)]
pub(super) fn put(values: &mut [f64], lane: usize, response: impl Iterator<Item = Complex64>) {
    for (row, x) in values.chunks_exact_mut(2 * LANES).zip(response) {
        row[lane] = x.re;
        row[LANES + lane] = x.im;
    }
}

/// Eight responses, and room to work on them.
#[derive(Debug)]
pub(super) struct Pass {
    lines: usize,
    /// Per line: eight real parts, eight imaginary parts.
    values: Vec<f64>,
    filled: usize,
}

impl Pass {
    pub(super) fn new(lines: usize) -> Self {
        Self { lines, values: vec![0.0; 2 * LANES * lines], filled: 0 }
    }

    /// Loads `count` responses; the lanes left over repeat the last.
    #[inline(always)]
    pub(super) fn load<R: Iterator<Item = Complex64>>(&mut self, count: usize, response: impl Fn(usize) -> R) {
        self.filled = count;
        for lane in 0..LANES {
            put(&mut self.values, lane, response(lane.min(count - 1)));
        }
    }

    /// Widens, and appends the part that each falls into.
    pub(super) fn widen(&mut self, split: &Split, widest: &mut Widest, codes: &mut Vec<u8>) {
        let mut along = [[0.0; LANES]; ALL];
        pulp::Arch::new().dispatch(Project { pass: self, split, along: &mut along, widest });
        let from = codes.len();
        self.append(split, &along, codes);
        for (lane, code) in codes[from..].iter().enumerate() {
            let Ranges { low, high } = &mut widest.parts[usize::from(*code)];
            for ((low, high), along) in low.iter_mut().zip(high).zip(&along) {
                *low = low.min(along[lane]);
                *high = high.max(along[lane]);
            }
        }
    }

    /// Appends the part that each falls into by its logarithm.
    pub(super) fn codes(&mut self, split: &Split, codes: &mut Vec<u8>) {
        let mut along = [[0.0; LANES]; ALL];
        let halvings = split.halvings();
        pulp::Arch::new().dispatch(Logarithms { pass: self, split, halvings, along: &mut along });
        self.append(split, &along, codes);
    }

    fn append(&self, split: &Split, along: &[Lanes; ALL], codes: &mut Vec<u8>) {
        codes.extend((0..self.filled).map(|lane| split.part(&[along[0][lane], along[1][lane], along[2][lane]])));
    }
}

struct Project<'a> {
    pass: &'a mut Pass,
    split: &'a Split,
    along: &'a mut [Lanes; ALL],
    widest: &'a mut Widest,
}

impl WithSimd for Project<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { pass, split, along, widest } = self;
        let lines = pass.lines;
        let (values, _) = S::as_mut_simd_f64s(&mut pass.values);
        let vectors = S::as_simd_f64s(&along[0]).0.len();
        let splat = |x| simd.splat_f64s(x);
        let norm = |re, im| simd.mul_add_e_f64s(re, re, simd.mul_f64s(im, im));
        for v in 0..vectors {
            let at = |k: usize, part: usize| (2 * k + part) * vectors + v;
            for k in 0..lines {
                let inverse = split.inverse[k];
                let (c_re, c_im) = (splat(inverse.re), splat(inverse.im));
                let (re, im) = (values[at(k, 0)], values[at(k, 1)]);
                let kappa_re = simd.negate_mul_add_e_f64s(im, c_im, simd.mul_add_e_f64s(re, c_re, splat(-1.0)));
                let kappa_im = simd.mul_add_e_f64s(im, c_re, simd.mul_f64s(re, c_im));
                values[at(k, 0)] = kappa_re;
                values[at(k, 1)] = kappa_im;
                let radius = &mut S::as_mut_simd_f64s(&mut widest.radius[k]).0[v];
                *radius = simd.max_f64s(*radius, norm(kappa_re, kappa_im));
            }
            for (m, row) in along.iter_mut().enumerate() {
                if m == DIRECTIONS {
                    for k in 0..lines {
                        let remainder = &mut S::as_mut_simd_f64s(&mut widest.remainder[k]).0[v];
                        *remainder = simd.max_f64s(*remainder, norm(values[at(k, 0)], values[at(k, 1)]));
                    }
                }
                let direction = &split.directions[m * lines..(m + 1) * lines];
                let (mut t, mut u) = (splat(0.0), splat(0.0));
                for (k, d) in direction.iter().enumerate() {
                    t = simd.mul_add_e_f64s(values[at(k, 0)], splat(d.re), t);
                    u = simd.mul_add_e_f64s(values[at(k, 1)], splat(d.im), u);
                }
                let t = simd.add_f64s(t, u);
                S::as_mut_simd_f64s(row).0[v] = t;
                let low = &mut S::as_mut_simd_f64s(&mut widest.low[m]).0[v];
                *low = simd.min_f64s(*low, t);
                let high = &mut S::as_mut_simd_f64s(&mut widest.high[m]).0[v];
                *high = simd.max_f64s(*high, t);
                for (k, d) in direction.iter().enumerate() {
                    let (re, im) = (at(k, 0), at(k, 1));
                    values[re] = simd.negate_mul_add_e_f64s(t, splat(d.re), values[re]);
                    values[im] = simd.negate_mul_add_e_f64s(t, splat(d.im), values[im]);
                }
            }
            let mut square = splat(0.0);
            for (k, scale) in split.scale.iter().enumerate() {
                let share = splat(1.0 / (scale * scale));
                square = simd.mul_add_e_f64s(norm(values[at(k, 0)], values[at(k, 1)]), share, square);
            }
            let reach = &mut S::as_mut_simd_f64s(&mut widest.reach).0[v];
            *reach = simd.max_f64s(*reach, square);
            let sum = &mut S::as_mut_simd_f64s(&mut widest.sum).0[v];
            *sum = simd.add_f64s(*sum, square);
        }
    }
}

struct Logarithms<'a> {
    pass: &'a Pass,
    split: &'a Split,
    halvings: usize,
    along: &'a mut [Lanes; ALL],
}

impl WithSimd for Logarithms<'_> {
    type Output = ();

    /// Plain loops over the lanes, which the compiler vectorises for the dispatched instructions.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { pass, split, halvings, along } = self;
        for (k, row) in pass.values.chunks_exact(2 * LANES).enumerate() {
            let inverse = split.inverse[k];
            let (re, im) = row.split_at(LANES);
            let mut logarithm = [[0.0; LANES]; 2];
            for lane in 0..LANES {
                let x = Complex64::new(re[lane], im[lane]) * inverse;
                let crude = crude_logarithm(x.re, x.im);
                (logarithm[0][lane], logarithm[1][lane]) = (crude.re, crude.im);
            }
            for (m, t) in along.iter_mut().enumerate().take(halvings) {
                let d = split.directions[m * pass.lines + k];
                for lane in 0..LANES {
                    t[lane] += logarithm[0][lane] * d.re + logarithm[1][lane] * d.im;
                }
            }
        }
    }
}
