//! A cluster of feedback controllers, as it is kept.

use super::ALL;
use super::deviations::{Extent, Split};
use super::principal::Part;
use num_complex::{Complex32, Complex64};

/// Leaves above this size are looked at member by member.
const ROUGH: f64 = 0.03;

/// Parts into which a range is divided for [`Cell::range_within`].
const STEPS: f64 = u8::MAX as f64;

/// A cluster of feedback controllers, in as little memory as bounds allow: there are many.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    /// `1/S` of the centre at each line, which need not be a member's.
    pub(super) centre: Box<[Complex32]>,
    /// Principal directions, one after another.
    pub(super) directions: Box<[Part]>,
    /// Range of the coordinate along each.
    pub(super) ranges: [[f32; 2]; ALL],
    /// Range of its members' coordinates in the cluster that it is a part of, as shares of that one's range.
    pub(super) within: [[u8; 2]; ALL],
    /// Three values a line: see [`Profile`].
    pub(super) profile: Box<[[f32; 3]]>,
    /// Largest norm of what all directions leave over, in units of [`Profile::scale`].
    pub reach: f32,
    /// The members, a range of the sorted list.
    pub members: std::ops::Range<u32>,
    /// Clusters that divide this one; none in a leaf.
    pub children: Box<[u32]>,
    /// Whether the members of a leaf differ too much to be bounded together: beside poles and zeros of the loop on a line.
    pub rough: bool,
}

/// How far a cluster extends at a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Profile {
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

impl Cell {
    pub(super) fn new(split: &Split, extent: &Extent, members: std::ops::Range<u32>) -> Self {
        let single = |x: &Complex64| Complex32::new(x.re as f32, x.im as f32);
        let profile = |k: usize| [above(extent.radius[k]), above(extent.remainder[k]), split.scale[k] as f32];
        // The scale is rounded to the nearest, by less than 2⁻²³ of itself.
        let reach = above(extent.reach * (1.0 + f64::from(f32::EPSILON)));
        Self {
            centre: split.centre.iter().map(single).collect(),
            directions: split.directions.iter().copied().map(Part::new).collect(),
            ranges: std::array::from_fn(|m| [-above(-extent.low[m]), above(extent.high[m])]),
            within: [[0, u8::MAX]; ALL],
            profile: (0..split.centre.len()).map(profile).collect(),
            reach,
            members,
            children: Box::default(),
            rough: extent.size() > ROUGH,
        }
    }

    pub(super) fn centre(&self, line: usize) -> Complex64 {
        let c = self.centre[line];
        Complex64::new(f64::from(c.re), f64::from(c.im))
    }

    pub(super) fn direction(&self, m: usize, line: usize) -> Complex64 {
        self.directions[m * self.centre.len() + line].value()
    }

    pub(super) fn profile(&self, line: usize) -> Profile {
        let [radius, remainder, scale] = self.profile[line].map(f64::from);
        Profile { radius, remainder, scale }
    }

    pub(super) fn range(&self, m: usize) -> [f64; 2] {
        self.ranges[m].map(f64::from)
    }

    /// Range of the members' coordinates in the frame of the cluster that this one is a part of.
    pub(super) fn range_within(&self, whole: &Self, m: usize) -> [f64; 2] {
        self.within[m].map(|share| whole.at(m, share))
    }

    /// Keeps these ranges of coordinates in the frame of `whole`, rounded outwards.
    pub(super) fn set_within(&mut self, whole: &Self, ranges: &[[f64; 2]; ALL]) {
        for (m, ([low, high], within)) in ranges.iter().zip(&mut self.within).enumerate() {
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
    }

    fn at(&self, m: usize, share: u8) -> f64 {
        let [low, high] = self.range(m);
        match share {
            0 => low,
            u8::MAX => high,
            _ => low + (high - low) * (f64::from(share) / STEPS),
        }
    }
}
