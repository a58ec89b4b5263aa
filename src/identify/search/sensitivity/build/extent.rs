//! How far a cluster extends around its centre.

use super::deviations::Split;
use super::line_lanes::{LINE_LANES, LineLanes, blocks};
use super::size::{ALL, PARTS};

/// Rounding of a deviation in double precision, amply, beside one of one.
const ROUNDING: f64 = 1e-14;

/// Half a unit in the last place of one in single precision.
const SINGLE: f64 = 0.5 * f32::EPSILON as f64;

/// What is added to a modulus for what its square may lose below the smallest normal number.
const TINY: f64 = 1e-18;

/// The largest scale of a cluster that is bounded.
const LARGEST_SCALE: f64 = 1e30;

/// How far a cluster extends around a centre.
#[derive(Debug, Clone)]
pub(crate) struct Extent {
    pub low: [f64; ALL],
    pub high: [f64; ALL],
    /// Largest |κ| per line, and largest rest behind the leading directions.
    pub radius: Vec<f64>,
    pub remainder: Vec<f64>,
    /// Largest norm of a rest behind all directions, in units of the scale at each line. Infinite where something is no
    /// number.
    pub reach: f64,
}

impl Extent {
    /// With what rounding may hide.
    ///
    /// `1 + L` is known to ε (1 + |L|), and |L| ≤ 1 + |1 + L|. The coordinates t are what they are: the rest is
    /// *defined* as `κ − Σ t v`, with the directions v exact in single precision. What κ loses in single precision, it
    /// loses relative to |κ|; and each of the [`ALL`] subtractions loses relative to its result and (where
    /// multiplication and addition round by themselves) its product, all of which are within `|κ| + Σ |t| |v|`:
    /// together less than (1 + 2 · 12) of that, doubled for the roundings of the bound. Squares, their sums and their
    /// shares then lose relative to themselves.
    pub(crate) fn new(widest: &Widest, split: &Split) -> Self {
        let lines = split.centre.len();
        let each = |of: &[LineLanes<f32>]| -> Vec<f64> {
            let squares = of.iter().flat_map(|wide| wide.0).take(lines);
            squares.map(|square| f64::from(square).sqrt() * (1.0 + 8.0 * SINGLE) + TINY).collect()
        };
        let end = |m: usize, end: usize, start: f64, of: fn(f64, f64) -> f64| {
            widest.parts.iter().map(|part| f64::from(part[end].0[m])).fold(start, of)
        };
        let mut extent = Self {
            low: std::array::from_fn(|m| end(m, 0, 0.0, f64::min)),
            high: std::array::from_fn(|m| end(m, 1, 0.0, f64::max)),
            radius: each(&widest.radius),
            remainder: each(&widest.remainder),
            reach: f64::from(widest.reach).sqrt() * (1.0 + (16 + lines) as f64 * SINGLE) + TINY,
        };
        let mut out_of_reach = 0.0;
        for (k, inverse) in split.inverse.iter().enumerate() {
            let along = |m: usize| -extent.low[m].min(-extent.high[m]) * split.directions[m * lines + k].l1_norm();
            let terms = extent.radius[k] + (0..ALL).map(along).sum::<f64>();
            let hidden = ROUNDING * (3.0 + 2.0 * inverse.norm_sqr().sqrt() + 8.0 * extent.radius[k])
                + 2.0 * (1 + 2 * ALL) as f64 * SINGLE * terms;
            extent.radius[k] += hidden;
            extent.remainder[k] += hidden;
            out_of_reach += (hidden / split.scale[k]).powi(2);
        }
        extent.reach = extent.reach * (1.0 + ROUNDING) + out_of_reach.sqrt();
        // Beyond, single precision holds no inverse of the scale.
        let is_unknown = split.scale.iter().any(|scale| *scale > LARGEST_SCALE);
        if widest.is_lost || is_unknown || extent.reach.is_nan() {
            extent.reach = f64::INFINITY;
        }
        extent
    }

    /// Root mean square of the radius over the lines.
    pub(crate) fn size(&self) -> f64 {
        (self.radius.iter().map(|r| r * r).sum::<f64>() / self.radius.len() as f64).sqrt()
    }
}

/// The largest of what has passed; moduli as their squares.
#[derive(Debug, Clone)]
pub(crate) struct Widest {
    /// In blocks of lines.
    pub radius: Vec<LineLanes<f32>>,
    pub remainder: Vec<LineLanes<f32>>,
    reach: f32,
    /// Whether something was no number, which a maximum may drop; or too large.
    is_lost: bool,
    /// The smallest and the largest of each coordinate, of each part's members.
    pub parts: [[LineLanes<f32>; 2]; PARTS],
}

impl Widest {
    pub(crate) fn none(lines: usize) -> Self {
        let zero = vec![LineLanes::default(); blocks(lines)];
        Self {
            radius: zero.clone(),
            remainder: zero,
            reach: 0.0,
            is_lost: false,
            parts: [[LineLanes([f32::INFINITY; LINE_LANES]), LineLanes([f32::NEG_INFINITY; LINE_LANES])]; PARTS],
        }
    }

    /// Ranges of the coordinates of a part's members.
    pub(crate) fn ranges(&self, part: usize) -> [[f64; 2]; ALL] {
        std::array::from_fn(|m| self.parts[part].map(|end| f64::from(end.0[m])))
    }

    /// Takes the square of a rest, in units of the scale.
    #[inline(always)]
    pub(crate) fn reach(&mut self, square: f32) {
        self.reach = self.reach.max(square);
        self.is_lost |= !square.is_finite();
    }

    pub(crate) fn join(mut self, other: &Self) -> Self {
        let with = |into: &mut LineLanes<f32>, from: &LineLanes<f32>, of: fn(f32, f32) -> f32| {
            into.0.iter_mut().zip(&from.0).for_each(|(a, b)| *a = of(*a, *b));
        };
        self.radius.iter_mut().zip(&other.radius).for_each(|(a, b)| with(a, b, f32::max));
        self.remainder.iter_mut().zip(&other.remainder).for_each(|(a, b)| with(a, b, f32::max));
        self.reach = self.reach.max(other.reach);
        self.is_lost |= other.is_lost;
        for (mine, theirs) in self.parts.iter_mut().zip(&other.parts) {
            with(&mut mine[0], &theirs[0], f32::min);
            with(&mut mine[1], &theirs[1], f32::max);
        }
        self
    }
}
