//! Transforms of the segments on their own grids, without a window: where the power is, and what transients are fitted
//! on.

use super::error::FrequencyError;
use super::excited::{excited_lines, strongest};
use super::job::{GRID_TOLERANCE, Job, ZERO_AMPLITUDE, largest};
use super::segments::Segment;
use super::settings::{Detrend, Window};
use super::spectrum::line_power;
use super::variance::dark_lines;
use super::{drift, settings::Stimulus};
use crate::ctl::Ctl;
use crate::num::fourier::RealTransform;
use num_complex::Complex64;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A segment on the lines `0 … ⌊N/2⌋` of its grid.
pub(super) struct Grids {
    pub input: Vec<Complex64>,
    /// The output, from which `slope` was taken off.
    pub output: Vec<Complex64>,
    /// Power of the input's sinusoids, and of the other stimulus' where it was recorded.
    pub power: Vec<f64>,
    pub other_power: Vec<f64>,
    /// Lines on which no stimulus has power.
    pub dark: Vec<bool>,
    /// Slope that was taken off the output, in units a sample.
    pub slope: Option<f64>,
}

fn powers(grid: &[Complex64], samples: usize) -> Vec<f64> {
    grid.iter().enumerate().map(|(k, x)| line_power(*x, samples as f64, k == 0)).collect()
}

impl Job<'_> {
    /// The grids of all segments.
    pub(super) fn grids(&self, ctl: &Ctl) -> Result<Vec<Grids>, FrequencyError> {
        let lengths: BTreeMap<usize, RealTransform> = self
            .pieces
            .iter()
            .map(|piece| (piece.segment.samples, RealTransform::new(piece.segment.samples)))
            .collect();
        self.pieces
            .par_iter()
            .map(|piece| {
                ctl.check()?;
                Ok(self.grid(piece.trial, &piece.segment, &lengths[&piece.segment.samples]))
            })
            .collect()
    }

    fn grid(&self, trial: usize, segment: &Segment, transform: &RealTransform) -> Grids {
        let keeps_mean = self.settings.detrend == Detrend::None;
        let cut = |column: &[f64]| -> Vec<f64> {
            let own = &column[segment.start..segment.start + segment.samples];
            let mean = if keeps_mean { 0.0 } else { own.iter().sum::<f64>() / own.len() as f64 };
            own.iter().map(|x| x - mean).collect()
        };
        let input = transform.of(&cut(self.input(trial)));
        let mut output = transform.of(&cut(&self.output(trial)));
        let power = powers(&input, segment.samples);
        let other_power =
            self.other(trial).map_or_else(Vec::new, |column| powers(&transform.of(&cut(column)), segment.samples));
        let dark = if other_power.is_empty() {
            dark_lines(std::slice::from_ref(&power), Window::Rectangular)
        } else {
            dark_lines(&[power.clone(), other_power.clone()], Window::Rectangular)
        };
        let slope = (self.settings.detrend == Detrend::Line || !self.removes_transients())
            .then(|| drift::slope(&input, &output, &dark, segment.samples))
            .flatten();
        if let Some(slope) = slope {
            drift::take_off(&mut output, slope, segment.samples);
        }
        Grids { input, output, power, other_power, dark, slope }
    }

    /// The excited lines of the common grid, in Hz.
    pub(super) fn excited(&self, grids: &[Grids]) -> Result<Vec<f64>, FrequencyError> {
        let first = self.pieces[0].segment;
        if let Some(piece) = self.pieces.iter().find(|piece| piece.segment.samples != first.samples) {
            return Err(FrequencyError::UnequalSegments {
                trial: piece.trial,
                segment: piece.segment.number,
                samples: piece.segment.samples,
                first: first.samples,
            });
        }
        let mut mean = vec![0.0; first.samples / 2 + 1];
        let mut has_power = vec![false; self.trials.len()];
        for (piece, grids) in self.pieces.iter().zip(grids) {
            let floor = 2.0 * (ZERO_AMPLITUDE * largest(self.input(piece.trial), &piece.segment)).powi(2);
            has_power[piece.trial] |= strongest(&grids.power) > floor;
            for (sum, power) in mean.iter_mut().zip(&grids.power) {
                *sum += power / self.pieces.len() as f64;
            }
        }
        if let Some(trial) = has_power.iter().position(|has| !has) {
            return Err(self.no_power(trial));
        }
        let settings = self.settings.settings();
        let step_hz = 1.0 / (first.samples as f64 * self.trials[0].sample_time_s);
        let [low, high] = settings.band_hz.unwrap_or([0.0, f64::INFINITY]);
        // Band edges are meant to hold the lines that they name.
        let slack = GRID_TOLERANCE * step_hz;
        let lines: Vec<f64> = excited_lines(&mean, first.samples, settings)
            .into_iter()
            .map(|k| k as f64 * step_hz)
            .filter(|f| *f >= low - slack && *f <= high + slack)
            .collect();
        if lines.is_empty() {
            return Err(FrequencyError::NothingExcited { input: self.channels.input, band_hz: settings.band_hz });
        }
        Ok(lines)
    }

    fn other(&self, trial: usize) -> Option<&[f64]> {
        let other: Stimulus = super::error::other(self.channels.input);
        self.stimulus(trial, other)
    }
}
