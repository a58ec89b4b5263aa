//! What is asked about the candidates that the data cannot tell from the best one.

use crate::control::System;
use crate::identify::held::Held;
use crate::identify::pool::{Candidate, Pool};
use crate::identify::problem::Problem;
use crate::identify::search::screen::systems;
use std::fmt;

/// Norms over a band, as they are defined for reports: the search only bounds them.
pub trait BandNorms: Sync + fmt::Debug {
    /// The band in rad/s.
    fn band_rad_s(&self) -> [f64; 2];

    /// ‖Gfb‖; infinite where there is none.
    fn feedback(&self, feedback: &System) -> f64;

    /// ‖Gff G − 1‖; infinite where there is none.
    fn feedforward_plant_minus_one(&self, feedforward: &System) -> f64;
}

/// The candidates of a pool that cost at most `limit`, and the norms whose ranges over all of them are asked for.
#[derive(Debug, Clone, Copy)]
pub struct Question<'a> {
    /// What candidates are judged by.
    pub problem: &'a Problem,
    /// The candidates.
    pub pool: &'a Pool,
    /// The plant, in the time base of the pool and without delay beside it.
    pub plant: &'a System,
    /// What a member costs at most (by QR).
    pub limit: f64,
    /// Index of the candidate that costs least.
    pub best: u64,
    /// The norms.
    pub norms: &'a dyn BandNorms,
    /// The controller that is held at zero: its norm is the same for every candidate and not asked for.
    pub held: Option<Held>,
}

/// One of two norms over the band.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    /// ‖Gfb‖.
    Feedback,
    /// ‖Gff G − 1‖.
    Distance,
}

/// A norm of a candidate; infinite where there is none.
pub(super) fn norm_of(question: &Question<'_>, quantity: Quantity, candidate: &Candidate) -> f64 {
    let Question { problem, pool, norms, .. } = question;
    let norm = match quantity {
        Quantity::Feedback => systems::feedback(pool, candidate).map(|system| norms.feedback(&system)),
        Quantity::Distance => systems::systems(problem, pool, candidate)
            .map(|(_, [feedforward, _])| norms.feedforward_plant_minus_one(&feedforward)),
    };
    norm.unwrap_or(f64::INFINITY)
}
