//! What an estimate is made of: segments, what is known of them at the lines, and what becomes of transients.

use super::segments::Segment;
use super::settings::{Channels, CheckedSettings};
use crate::trial::Trial;
use num_complex::Complex64;

/// A line counts as on the grid up to this fraction of the grid's step.
pub(super) const GRID_TOLERANCE: f64 = 1e-3;

/// An amplitude below this fraction of the signal's largest value is the rounding of the transform, not a signal.
pub(super) const ZERO_AMPLITUDE: f64 = 1e-10;

/// What becomes of transients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Removal {
    /// They are kept.
    None,
    /// The segments are whole periods, and nothing stands above the noise.
    Nothing,
    /// The segments are whole periods, and their transients are taken off.
    Corrected,
    /// The response is that of the local polynomials.
    Local,
}

/// A segment of a trial.
pub(super) struct Piece {
    pub trial: usize,
    pub segment: Segment,
}

/// A segment at the lines.
pub(super) struct Transformed {
    /// `(R, Y)`; `None` where the input has no power.
    pub pairs: Vec<Option<(Complex64, Complex64)>>,
    /// Input power at the lines, and of its strongest line.
    pub power: Vec<f64>,
    pub strongest: f64,
    /// Lines on which the other stimulus has power too.
    pub shared: Vec<bool>,
    /// `S/|R|²` at the lines, for a single segment.
    pub nearby_variance: Vec<Option<f64>>,
}

/// What is estimated from what.
pub(super) struct Job<'a> {
    pub trials: &'a [&'a Trial],
    pub settings: &'a CheckedSettings,
    pub channels: Channels,
    pub pieces: Vec<Piece>,
    /// Samples at the end of trials that are in no segment, the largest number.
    pub unused: usize,
}

/// The grid line that a frequency is, if it is one.
pub(super) fn on_grid(frequency_hz: f64, length_s: f64) -> Option<usize> {
    let cycles = frequency_hz * length_s;
    ((cycles - cycles.round()).abs() <= GRID_TOLERANCE).then_some(cycles.round() as usize)
}

pub(super) fn largest(column: &[f64], segment: &Segment) -> f64 {
    column[segment.start..segment.start + segment.samples].iter().fold(0.0, |most, x| most.max(x.abs()))
}
