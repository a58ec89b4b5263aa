//! Between which values ‖Gfb‖ lies, for every pair of a numerator and a denominator of the feedback.
//!
//! `‖Gfb‖ = |gain| · mean |N|/|D|` over the band. Each polynomial alone is bounded from both sides on each cell of the
//! band, so that a pair takes two sums of products.

use super::models::Cells;
use crate::identify::pool::{Feedback, FeedbackTable};

/// Cells of the band.
const CELLS: usize = 128;

/// What a factor is at least and at most, cell by cell, rounded outwards.
#[derive(Debug, Clone)]
pub(super) struct Sides {
    low: Vec<f32>,
    high: Vec<f32>,
}

impl Sides {
    fn of(sides: impl Iterator<Item = [f64; 2]>) -> Self {
        // Nothing is lost where it underflows: a low of 0 and an infinite high are bounds too.
        let outwards = |[low, high]: [f64; 2]| ((low as f32).next_down().max(0.0), (high as f32).next_up());
        let (low, high) = sides.map(outwards).unzip();
        Self { low, high }
    }

    /// Of a multiple.
    pub(super) fn scaled(&self, factor: f64) -> Self {
        let of = |sides: &[f32]| sides.iter().map(|side| f64::from(*side) * factor).collect::<Vec<_>>();
        Self::of(of(&self.low).into_iter().zip(of(&self.high)).map(|(low, high)| [low, high]))
    }

    /// What holds for both.
    pub(super) fn unite(&mut self, other: &Self) {
        self.low.iter_mut().zip(&other.low).for_each(|(a, b)| *a = a.min(*b));
        self.high.iter_mut().zip(&other.high).for_each(|(a, b)| *a = a.max(*b));
    }

    /// The mean of the product lies between these.
    pub(super) fn mean_with(&self, other: &Self) -> [f64; 2] {
        let sum = |a: &[f32], b: &[f32]| -> f64 { a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum() };
        let count = self.low.len() as f64;
        let (low, high) = (sum(&self.low, &other.low) / count, sum(&self.high, &other.high) / count);
        // Zero times infinity: nothing is known.
        [low * (1.0 - 1e-12), if high.is_nan() { f64::INFINITY } else { high * (1.0 + 1e-12) }]
    }
}

/// The factors of every feedback controller.
#[derive(Debug)]
pub(super) struct Norms {
    /// Of `1/D`.
    pub denominators: Vec<Sides>,
    /// Of N.
    pub numerators: Vec<Sides>,
}

impl Norms {
    pub(super) fn new(table: &FeedbackTable, cells: &Cells) -> Self {
        let cells = cells.divided(CELLS);
        let sides = |descending: &[f64]| {
            let of = |cell: usize| {
                let model = cells.polynomial(descending, cell);
                [model.least(cells.half).max(0.0), model.most(cells.half)]
            };
            (0..CELLS).map(of).collect::<Vec<_>>()
        };
        let numerators = table.numerators().iter().map(|n| Sides::of(sides(&n.coefficients).into_iter())).collect();
        let reciprocal = |[low, high]: [f64; 2]| [1.0 / high, 1.0 / low];
        let denominators = table
            .denominators()
            .iter()
            .map(|d| Sides::of(sides(&d.coefficients).into_iter().map(reciprocal)))
            .collect();
        Self { denominators, numerators }
    }

    /// Between which values the norm of a controller with gain one lies.
    pub(super) fn of_unit(&self, denominator: usize, numerator: usize) -> [f64; 2] {
        self.denominators[denominator].mean_with(&self.numerators[numerator])
    }

    /// Between which values the norm of a controller lies.
    pub(super) fn of(&self, feedback: &Feedback) -> [f64; 2] {
        let Some(numerator) = feedback.numerator else { return [0.0, 0.0] };
        self.of_unit(feedback.denominator, numerator).map(|norm| feedback.gain.abs() * norm)
    }
}
