//! A cluster of feedback controllers, as it is kept.

use super::deviations::Split;
use super::extent::Extent;
use super::principal::{Faint, Part};
use super::size::{ALL, DIRECTIONS, FAINT};
use num_complex::Complex64;

/// Leaves above this size are looked at member by member.
const ROUGH: f64 = 0.06;

/// Parts into which a range is divided for [`Cluster::range_within`].
const STEPS: f64 = u8::MAX as f64;

/// Where the numbers of a cluster lie, in words of 32 bits: ranges of the coordinates along the directions in single
/// precision; ranges of its members' coordinates in the cluster that it is a part of, as shares of that one's range;
/// units of the faint directions.
const RANGES: usize = 0;
const WITHIN: usize = RANGES + 2 * ALL;
const UNITS: usize = WITHIN + ALL / 2;
const LINES: usize = UNITS + FAINT / 2;

/// Then for each line: `1/S` of the centre, which need not be a member's; see [`Profile`]; the directions.
const CENTRE: usize = 0;
const PROFILE: usize = 2;
const LEADING: usize = 5;
const TRAILING: usize = LEADING + DIRECTIONS;
const PER_LINE: usize = TRAILING + FAINT / 2;

// Two ranges within, units or faint parts share a word.
const _: () = assert!(ALL.is_multiple_of(2) && FAINT.is_multiple_of(2));

/// A cluster of feedback controllers, in as little memory as bounds allow: there are many.
#[derive(Debug, Clone)]
pub(crate) struct Cluster {
    pub(crate) numbers: Box<[u32]>,
    /// Largest norm of what all directions leave over, in units of [`Profile::scale`].
    pub reach: f32,
    /// The members, a range of the sorted list.
    pub members: std::ops::Range<u32>,
    /// Clusters that divide this one; none in a leaf.
    pub children: Box<[u32]>,
    /// Whether the members of a leaf differ too much to be bounded together: beside poles and zeros of the loop on a
    /// line.
    pub rough: bool,
}

/// How far a cluster extends at a line.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Profile {
    /// Largest |κ|, and largest rest behind the leading directions.
    pub radius: f64,
    pub remainder: f64,
    /// What a member typically leaves over behind all directions.
    pub scale: f64,
}

/// The next number in single precision that is not below.
fn above(x: f64) -> f32 {
    let single = x as f32;
    if f64::from(single) < x { single.next_up() } else { single }
}

/// Half a word, by its position.
#[inline(always)]
fn half(word: u32, at: usize) -> u16 {
    (word >> (16 * (at % 2))) as u16
}

#[inline(always)]
fn number(word: u32) -> f64 {
    f64::from(f32::from_bits(word))
}

impl Cluster {
    /// Words that a cluster takes with so many lines.
    pub(crate) fn words(lines: usize) -> usize {
        LINES + PER_LINE * lines
    }

    pub(crate) fn new(split: &Split, extent: &Extent, members: std::ops::Range<u32>) -> Self {
        let lines = split.centre.len();
        let mut numbers = Vec::with_capacity(Self::words(lines));
        let halves = |low: u16, high: u16| u32::from(low) | u32::from(high) << 16;
        for (low, high) in extent.low.iter().zip(&extent.high) {
            numbers.extend([-above(-low), above(*high)].map(f32::to_bits));
        }
        numbers.extend([u32::from_le_bytes([0, u8::MAX, 0, u8::MAX]); ALL / 2]);
        let direction = |m: usize| &split.directions[m * lines..(m + 1) * lines];
        let faint: [Faint; FAINT] = std::array::from_fn(|j| Faint::new(direction(DIRECTIONS + j)));
        numbers.extend(faint.chunks_exact(2).map(|two| halves(two[0].unit(), two[1].unit())));
        for (k, centre) in split.centre.iter().enumerate() {
            numbers.extend([centre.re as f32, centre.im as f32].map(f32::to_bits));
            let profile = [above(extent.radius[k]), above(extent.remainder[k]), split.scale[k] as f32];
            numbers.extend(profile.map(f32::to_bits));
            numbers.extend((0..DIRECTIONS).map(|m| Part::new(direction(m)[k]).bits()));
            let bits = |j: usize| faint[j].bits(direction(DIRECTIONS + j)[k]);
            numbers.extend((0..FAINT / 2).map(|j| halves(bits(2 * j), bits(2 * j + 1))));
        }
        // The scale is rounded to the nearest, by less than 2⁻²³ of itself.
        let reach = above(extent.reach * (1.0 + f64::from(f32::EPSILON)));
        Self { numbers: numbers.into(), reach, members, children: Box::default(), rough: extent.size() > ROUGH }
    }

    #[inline(always)]
    fn line(&self, line: usize) -> &[u32] {
        &self.numbers[LINES + PER_LINE * line..LINES + PER_LINE * (line + 1)]
    }

    #[inline(always)]
    pub(crate) fn centre(&self, line: usize) -> Complex64 {
        let line = self.line(line);
        Complex64::new(number(line[CENTRE]), number(line[CENTRE + 1]))
    }

    /// Real and imaginary parts of all directions at a line.
    #[inline(always)]
    pub(crate) fn directions(&self, line: usize) -> [[f64; ALL]; 2] {
        let line = self.line(line);
        let (mut re, mut im) = ([0.0; ALL], [0.0; ALL]);
        for m in 0..DIRECTIONS {
            let value = Part::from_bits(line[LEADING + m]).value();
            (re[m], im[m]) = (value.re, value.im);
        }
        for j in 0..FAINT {
            let faint = Faint::from_unit(half(self.numbers[UNITS + j / 2], j));
            let value = faint.value(half(line[TRAILING + j / 2], j));
            (re[DIRECTIONS + j], im[DIRECTIONS + j]) = (value.re, value.im);
        }
        [re, im]
    }

    #[inline(always)]
    pub(crate) fn profile(&self, line: usize) -> Profile {
        let line = self.line(line);
        let of = |i: usize| number(line[PROFILE + i]);
        Profile { radius: of(0), remainder: of(1), scale: of(2) }
    }

    #[inline(always)]
    pub(crate) fn range(&self, m: usize) -> [f64; 2] {
        [number(self.numbers[RANGES + 2 * m]), number(self.numbers[RANGES + 2 * m + 1])]
    }

    /// Range of the members' coordinates in the frame of the cluster that this one is a part of.
    #[inline(always)]
    pub(crate) fn range_within(&self, whole: &Self, m: usize) -> [f64; 2] {
        let [low, high] = half(self.numbers[WITHIN + m / 2], m).to_le_bytes();
        [whole.at(m, low), whole.at(m, high)]
    }

    /// Keeps these ranges of coordinates in the frame of `whole`, rounded outwards.
    pub(crate) fn set_within(&mut self, whole: &Self, ranges: &[[f64; 2]; ALL]) {
        let mut within = [[0, u8::MAX]; ALL];
        for (m, ([low, high], within)) in ranges.iter().zip(&mut within).enumerate() {
            let [from, to] = whole.range(m);
            let share = |t: f64| if to > from { (t - from) / (to - from) * STEPS } else { 0.0 };
            let (mut below, mut above) = (share(*low).floor() as u8, share(*high).ceil() as u8);
            // The ends of the whole range are its own, so both searches end there at the latest.
            while below > 0 && whole.at(m, below) > *low {
                below -= 1;
            }
            while above < u8::MAX && whole.at(m, above) < *high {
                above += 1;
            }
            *within = [below, above];
        }
        for (word, two) in self.numbers[WITHIN..].iter_mut().zip(within.chunks_exact(2)) {
            *word = u32::from_le_bytes([two[0][0], two[0][1], two[1][0], two[1][1]]);
        }
    }

    #[inline(always)]
    fn at(&self, m: usize, share: u8) -> f64 {
        let [low, high] = self.range(m);
        match share {
            0 => low,
            u8::MAX => high,
            _ => low + (high - low) * (f64::from(share) / STEPS),
        }
    }
}
