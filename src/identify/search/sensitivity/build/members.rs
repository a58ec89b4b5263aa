//! The listed controllers, and what their responses are computed from.

use super::line_lanes::{Pair, Rows};

/// Bits of a member that hold the position of its gain.
pub(crate) const GAIN_BITS: u32 = 7;

/// Controllers that share denominator and numerator.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    pub denominator: u32,
    pub numerator: u32,
    /// What turns a listed gain into the factor in front of the numerator.
    pub unit: f64,
}

/// What members are computed from.
pub(crate) struct Table<'a> {
    rows: &'a [Row],
    gains: &'a [f64],
    denominators: &'a Rows,
    numerators: &'a Rows,
}

/// Where the factors of a member's loop are.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Place {
    pub gain: f64,
    denominator: u32,
    numerator: u32,
}

impl<'a> Table<'a> {
    pub(crate) fn new(rows: &'a [Row], gains: &'a [f64], denominators: &'a Rows, numerators: &'a Rows) -> Self {
        Self { rows, gains, denominators, numerators }
    }

    /// The gain, and the positions of denominator and numerator.
    #[inline(always)]
    pub(crate) fn place(&self, member: u32) -> Place {
        let row = &self.rows[(member >> GAIN_BITS) as usize];
        let gain = row.unit * self.gains[(member & ((1 << GAIN_BITS) - 1)) as usize];
        Place { gain, denominator: row.denominator, numerator: row.numerator }
    }

    /// Denominator and numerator: `1 + L` is one and their product with the gain.
    #[inline(always)]
    pub(crate) fn factors(&self, place: &Place) -> (&'a [Pair<f64>], &'a [Pair<f64>]) {
        (self.denominators.row(place.denominator as usize), self.numerators.row(place.numerator as usize))
    }
}
