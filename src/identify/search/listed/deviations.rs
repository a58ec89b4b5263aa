//! How responses deviate from a centre, eight at a time: their coordinates along directions, and into which part of a division they fall.

use super::group::{DIRECTIONS, LANES};
use num_complex::{Complex32, Complex64};
use pulp::{Simd, WithSimd};

/// Rounds of power iteration per direction. An inexact direction costs a little in the remainder, which is measured after it.
const POWER_ITERATIONS: usize = 3;

/// Deviations below this hardly differ from their logarithms.
const NARROW: f64 = 0.5;

/// Rounding of a coordinate or a rest, amply, beside deviations of one.
const ROUNDING: f64 = 1e-14;

/// A sample of a cluster around its logarithmic mean.
#[derive(Debug)]
pub(super) struct Splitter {
    sample: Vec<Vec<Complex64>>,
    centre: Vec<Complex64>,
    /// Root mean square over the lines of the largest deviation in the sample.
    pub size: f64,
}

/// A division of a cluster into parts: by halving along up to three directions, one after the other.
#[derive(Debug)]
pub(super) struct Split {
    pub centre: Vec<Complex64>,
    /// Directions of κ, one after another; of logarithms, as real and imaginary parts, where `logarithms`.
    pub directions: Vec<Complex32>,
    logarithms: bool,
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
    pub(super) fn new(sample: Vec<Vec<Complex64>>) -> Self {
        let mut centre = sample[sample.len() / 2].clone();
        let count = sample.len() as f64;
        for (k, c) in centre.iter_mut().enumerate() {
            let inverse = c.inv();
            if sample.iter().all(|x| (x[k] * inverse - 1.0).norm_sqr() < NARROW * NARROW) {
                // Here the mean is as good as that of the logarithms.
                *c = sample.iter().map(|x| x[k]).sum::<Complex64>() / count;
                continue;
            }
            // A second round removes what the branch of the logarithm did to the first.
            for _ in 0..2 {
                let mean = sample.iter().map(|x| (x[k] / *c).ln()).sum::<Complex64>() / count;
                if mean.is_finite() {
                    *c *= mean.exp();
                }
            }
        }
        let square = |k: usize| sample.iter().map(|x| (x[k] / centre[k] - 1.0).norm_sqr()).fold(0.0, f64::max);
        let size = ((0..centre.len()).map(square).sum::<f64>() / centre.len() as f64).sqrt();
        Self { sample, centre, size }
    }

    /// Along the principal directions of crude logarithms, which tell even clusters apart whose members differ by orders of magnitude.
    pub(super) fn by_logarithms(&self, halvings: usize) -> Split {
        let crude: Vec<Vec<Complex64>> = self
            .sample
            .iter()
            .map(|x| x.iter().zip(&self.centre).map(|(x, c)| crude_logarithm((x / c).re, (x / c).im)).collect())
            .collect();
        let (directions, coordinates) = principal(crude, halvings);
        self.split(directions, coordinates, halvings, true)
    }

    /// Along the principal directions of κ.
    pub(super) fn by_coordinates(&self, halvings: usize) -> Split {
        let deviations =
            self.sample.iter().map(|x| x.iter().zip(&self.centre).map(|(x, c)| x / c - 1.0).collect()).collect();
        let (directions, coordinates) = principal(deviations, DIRECTIONS);
        self.split(directions, coordinates, halvings, false)
    }

    fn split(
        &self,
        directions: Vec<Complex32>,
        coordinates: Vec<Vec<f64>>,
        halvings: usize,
        logarithms: bool,
    ) -> Split {
        let mut split = Split { centre: self.centre.clone(), directions, logarithms, thresholds: Vec::new() };
        let mut parts = vec![(0..self.sample.len()).collect::<Vec<_>>()];
        for along in coordinates.iter().take(halvings) {
            let mut next = Vec::new();
            for mut part in parts {
                part.sort_by(|a, b| along[*a].total_cmp(&along[*b]));
                let threshold = part.get(part.len() / 2).map_or(0.0, |at| along[*at]);
                split.thresholds.push(threshold);
                let (low, high): (Vec<usize>, Vec<usize>) = part.into_iter().partition(|at| along[*at] <= threshold);
                next.extend([low, high]);
            }
            parts = next;
        }
        split
    }
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

fn product(a: &[Complex64], b: &[Complex64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.re * b.re + a.im * b.im).sum()
}

/// Up to `count` directions along which these vectors are longest, nearly, and every vector's coordinate along each.
fn principal(mut left: Vec<Vec<Complex64>>, count: usize) -> (Vec<Complex32>, Vec<Vec<f64>>) {
    let lines = left.first().map_or(0, Vec::len);
    let mut directions = vec![Complex32::ZERO; count * lines];
    let mut coordinates = vec![vec![0.0; left.len()]; count];
    for (m, along) in coordinates.iter_mut().enumerate() {
        let longest = left.iter().max_by(|a, b| product(a, a).total_cmp(&product(b, b)));
        let Some(mut direction) = longest.cloned() else { break };
        let mut norm = product(&direction, &direction).sqrt();
        for _ in 0..POWER_ITERATIONS {
            if !(norm > 1e-13 && norm < 1e150) {
                break;
            }
            direction.iter_mut().for_each(|x| *x /= norm);
            let mut next = vec![Complex64::ZERO; lines];
            for v in &left {
                let share = product(v, &direction);
                next.iter_mut().zip(v).for_each(|(n, x)| *n += x * share);
            }
            norm = product(&next, &next).sqrt();
            direction = next;
        }
        if !(norm > 1e-26 && norm < 1e300) {
            break;
        }
        let unit: Vec<Complex32> =
            direction.iter().map(|x| Complex32::new((x.re / norm) as f32, (x.im / norm) as f32)).collect();
        let exact: Vec<Complex64> = unit.iter().map(|v| Complex64::new(f64::from(v.re), f64::from(v.im))).collect();
        for (v, t) in left.iter_mut().zip(along.iter_mut()) {
            *t = product(v, &exact);
            v.iter_mut().zip(&exact).for_each(|(x, d)| *x -= d * *t);
        }
        directions[m * lines..(m + 1) * lines].copy_from_slice(&unit);
    }
    (directions, coordinates)
}

/// How far a cluster extends around a centre.
#[derive(Debug, Clone)]
pub(super) struct Extent {
    pub low: [f64; DIRECTIONS],
    pub high: [f64; DIRECTIONS],
    /// Per line; squares until [`Extent::rounded`].
    pub radius: Vec<f64>,
    pub remainder: Vec<f64>,
    /// Largest 1/|centre| per line.
    inverse: Vec<f64>,
}

impl Extent {
    pub(super) fn none(lines: usize) -> Self {
        Self {
            low: [0.0; DIRECTIONS],
            high: [0.0; DIRECTIONS],
            radius: vec![0.0; lines],
            remainder: vec![0.0; lines],
            inverse: vec![0.0; lines],
        }
    }

    /// Root mean square of the radius over the lines.
    pub(super) fn size(&self) -> f64 {
        (self.radius.iter().map(|r| r * r).sum::<f64>() / self.radius.len() as f64).sqrt()
    }

    pub(super) fn join(mut self, other: Self) -> Self {
        // NaN is kept, where `max` would drop it.
        let larger = |a: &mut f64, b: f64| {
            if b.is_nan() || b > *a {
                *a = b;
            }
        };
        self.radius.iter_mut().zip(other.radius).for_each(|(a, b)| larger(a, b));
        self.remainder.iter_mut().zip(other.remainder).for_each(|(a, b)| larger(a, b));
        self.inverse.iter_mut().zip(other.inverse).for_each(|(a, b)| larger(a, b));
        for m in 0..DIRECTIONS {
            self.low[m] = self.low[m].min(other.low[m]);
            self.high[m] = self.high[m].max(other.high[m]);
        }
        self
    }

    /// From squares to moduli, with what rounding may hide: `1 + L` is known to ε (1 + |L|), and |L| ≤ 1 + |1 + L|.
    pub(super) fn rounded(mut self) -> Self {
        for ((radius, remainder), inverse) in self.radius.iter_mut().zip(&mut self.remainder).zip(&self.inverse) {
            let largest = |square: f64| if square.is_nan() { f64::INFINITY } else { square.sqrt() };
            let hidden = ROUNDING * (3.0 + 2.0 * inverse + 8.0 * largest(*radius));
            *radius = largest(*radius) + hidden;
            *remainder = largest(*remainder) + hidden;
        }
        self
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
    pub(super) fn load(&mut self, count: usize, response: impl Fn(usize, &mut dyn FnMut(usize, Complex64))) {
        self.filled = count;
        for lane in 0..LANES {
            let values = &mut self.values;
            response(lane.min(count - 1), &mut |k, x| {
                values[2 * LANES * k + lane] = x.re;
                values[2 * LANES * k + LANES + lane] = x.im;
            });
        }
    }

    /// Appends the coordinates: `DIRECTIONS` rows of eight.
    pub(super) fn coordinates(&mut self, centre: &[Complex64], directions: &[Complex32], into: &mut Vec<f64>) {
        let mut along = [[0.0; LANES]; DIRECTIONS];
        self.project(centre, directions, &mut along, None);
        along.iter().for_each(|row| into.extend_from_slice(row));
    }

    /// Widens an extent to hold these.
    pub(super) fn extend(&mut self, centre: &[Complex64], directions: &[Complex32], extent: &mut Extent) {
        let mut along = [[0.0; LANES]; DIRECTIONS];
        self.project(centre, directions, &mut along, Some(extent));
        for (m, row) in along.iter().enumerate() {
            extent.low[m] = row.iter().copied().fold(extent.low[m], f64::min);
            extent.high[m] = row.iter().copied().fold(extent.high[m], f64::max);
        }
    }

    /// Appends the part that each of the first `count` falls into.
    pub(super) fn codes(&mut self, split: &Split, count: usize, codes: &mut Vec<u8>) {
        let mut along = [[0.0; LANES]; DIRECTIONS];
        if split.logarithms {
            let halvings = split.halvings();
            pulp::Arch::new().dispatch(Logarithms { pass: self, split, halvings, along: &mut along });
        } else {
            self.project(&split.centre, &split.directions, &mut along, None);
        }
        codes.extend((0..count).map(|lane| split.part(&[along[0][lane], along[1][lane], along[2][lane]])));
    }

    fn project(
        &mut self,
        centre: &[Complex64],
        directions: &[Complex32],
        along: &mut [[f64; LANES]; DIRECTIONS],
        extent: Option<&mut Extent>,
    ) {
        pulp::Arch::new().dispatch(Project { pass: self, centre, directions, along, extent });
    }
}

struct Project<'a> {
    pass: &'a mut Pass,
    centre: &'a [Complex64],
    directions: &'a [Complex32],
    along: &'a mut [[f64; LANES]; DIRECTIONS],
    extent: Option<&'a mut Extent>,
}

impl WithSimd for Project<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { pass, centre, directions, along, mut extent } = self;
        let lines = pass.lines;
        let (values, _) = S::as_mut_simd_f64s(&mut pass.values);
        let vectors = S::as_simd_f64s(&along[0]).0.len();
        let splat = |x| simd.splat_f64s(x);
        let largest = |x: S::f64s| simd.reduce_max_f64s(x);
        let norm = |re, im| simd.mul_add_e_f64s(re, re, simd.mul_f64s(im, im));
        for v in 0..vectors {
            let at = |k: usize, part: usize| (2 * k + part) * vectors + v;
            for k in 0..lines {
                let inverse = centre[k].inv();
                let (c_re, c_im) = (splat(inverse.re), splat(inverse.im));
                let (re, im) = (values[at(k, 0)], values[at(k, 1)]);
                let kappa_re = simd.negate_mul_add_e_f64s(im, c_im, simd.mul_add_e_f64s(re, c_re, splat(-1.0)));
                let kappa_im = simd.mul_add_e_f64s(im, c_re, simd.mul_f64s(re, c_im));
                values[at(k, 0)] = kappa_re;
                values[at(k, 1)] = kappa_im;
                if let Some(extent) = extent.as_deref_mut() {
                    let square = largest(norm(kappa_re, kappa_im));
                    // NaN is kept, and ends as infinity.
                    if square.is_nan() || square > extent.radius[k] {
                        extent.radius[k] = square;
                    }
                    extent.inverse[k] = inverse.norm();
                }
            }
            for (m, row) in along.iter_mut().enumerate() {
                let direction = &directions[m * lines..(m + 1) * lines];
                let mut t = splat(0.0);
                for (k, d) in direction.iter().enumerate() {
                    t = simd.mul_add_e_f64s(values[at(k, 0)], splat(f64::from(d.re)), t);
                    t = simd.mul_add_e_f64s(values[at(k, 1)], splat(f64::from(d.im)), t);
                }
                S::as_mut_simd_f64s(row).0[v] = t;
                for (k, d) in direction.iter().enumerate() {
                    let (re, im) = (at(k, 0), at(k, 1));
                    values[re] = simd.negate_mul_add_e_f64s(t, splat(f64::from(d.re)), values[re]);
                    values[im] = simd.negate_mul_add_e_f64s(t, splat(f64::from(d.im)), values[im]);
                }
            }
            if let Some(extent) = extent.as_deref_mut() {
                for k in 0..lines {
                    let square = largest(norm(values[at(k, 0)], values[at(k, 1)]));
                    if square.is_nan() || square > extent.remainder[k] {
                        extent.remainder[k] = square;
                    }
                }
            }
        }
    }
}

struct Logarithms<'a> {
    pass: &'a Pass,
    split: &'a Split,
    halvings: usize,
    along: &'a mut [[f64; LANES]; DIRECTIONS],
}

impl WithSimd for Logarithms<'_> {
    type Output = ();

    /// Plain loops over the lanes, which the compiler vectorises for the dispatched instructions.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { pass, split, halvings, along } = self;
        for (k, row) in pass.values.chunks_exact(2 * LANES).enumerate() {
            let inverse = split.centre[k].inv();
            let (re, im) = row.split_at(LANES);
            let mut logarithm = [[0.0; LANES]; 2];
            for lane in 0..LANES {
                let x = Complex64::new(re[lane], im[lane]) * inverse;
                let crude = crude_logarithm(x.re, x.im);
                (logarithm[0][lane], logarithm[1][lane]) = (crude.re, crude.im);
            }
            for (m, t) in along.iter_mut().enumerate().take(halvings) {
                let d = split.directions[m * pass.lines + k];
                let (d_re, d_im) = (f64::from(d.re), f64::from(d.im));
                for lane in 0..LANES {
                    t[lane] += logarithm[0][lane] * d_re + logarithm[1][lane] * d_im;
                }
            }
        }
    }
}
