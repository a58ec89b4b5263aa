//! Candidate pools: every pair of a feedforward denominator and a feedback controller with a stable closed loop.
//!
//! The closed-loop denominator is `Dff (Dp Dfb + Np Nfb)` (Zhang 2015, eq. 2.5), so stability separates, and a pool is
//! a product of a list of feedforward denominators and a table of feedback controllers.

pub mod factor;
pub mod feedback;
mod feedback_lists;
mod hidden;
mod lists;
mod peak;
pub mod recipe;
pub mod roots;
mod routh;
mod scan;
pub mod spec;
mod unfold;

use crate::identify::time::Region;
use factor::Factor;
pub use feedback::{Feedback, FeedbackTable, Opened};
pub use recipe::{PoolError, Recipe};
pub use routh::LARGEST_DEGREE;
pub use scan::Extremes;
pub use spec::{Degrees, PoolName, PoolSpec, PoolSpecError};

/// A pool on a plant.
///
/// # Order
/// The candidate with feedback controller `b` (in the order of [`FeedbackTable`]) and feedforward denominator `f` has
/// the index `b · M_ff + f`: feedback is outermost. Indices start at 0.
#[derive(Debug, Clone)]
pub struct Pool {
    region: Region,
    feedforward_numerator_degree: usize,
    feedforward: Vec<Factor>,
    feedback: FeedbackTable,
    size: u64,
}

/// One candidate of a pool: everything but the feedforward numerator.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Feedforward denominator, descending powers, monic.
    pub feedforward_denominator: Vec<f64>,
    /// Feedback numerator before its gain, descending powers.
    pub feedback_numerator: Vec<f64>,
    /// The gain in front of it; 0 for no feedback.
    pub feedback_gain: f64,
    /// Feedback denominator, descending powers, monic.
    pub feedback_denominator: Vec<f64>,
}

/// Where a candidate stands in the lists of its pool.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Position {
    /// Position of the feedforward denominator among the stable ones.
    pub feedforward: usize,
    /// The feedback controller.
    pub feedback: Feedback,
}

impl Pool {
    /// The number of candidates, M = M_ff · M_fb.
    #[must_use]
    pub fn size(&self) -> u64 {
        self.size
    }

    /// Time base and stability margin.
    #[must_use]
    pub fn region(&self) -> Region {
        self.region
    }

    /// The degree of the feedforward numerator, whose coefficients are found by least squares.
    #[must_use]
    pub fn feedforward_numerator_degree(&self) -> usize {
        self.feedforward_numerator_degree
    }

    /// The stable feedforward denominators, in order.
    #[must_use]
    pub fn feedforward(&self) -> &[Factor] {
        &self.feedforward
    }

    /// The stable feedback controllers.
    #[must_use]
    pub fn feedback(&self) -> &FeedbackTable {
        &self.feedback
    }

    /// Where the candidate with an index stands.
    ///
    /// # Panics
    /// If there is none, which is a mistake of the caller.
    #[must_use]
    pub fn position(&self, index: u64) -> Position {
        assert!(index < self.size, "candidate {index} of {}", self.size);
        let count = self.feedforward.len() as u64;
        Position { feedforward: (index % count) as usize, feedback: self.feedback.get(index / count) }
    }

    /// The index of a pair of a feedforward denominator and a feedback controller of this pool.
    ///
    /// # Panics
    /// If the controller is not in the table, which is a mistake of the caller.
    #[must_use]
    pub fn index(&self, feedforward: usize, feedback: Feedback) -> u64 {
        self.feedback.index(feedback) * self.feedforward.len() as u64 + feedforward as u64
    }

    /// The candidate at a position.
    #[must_use]
    pub fn candidate(&self, position: Position) -> Candidate {
        let Position { feedforward, feedback } = position;
        Candidate {
            feedforward_denominator: self.feedforward[feedforward].coefficients.clone(),
            feedback_numerator: feedback
                .numerator
                .map_or_else(|| vec![1.0], |i| self.feedback.numerators()[i].coefficients.clone()),
            feedback_gain: feedback.gain,
            feedback_denominator: self.feedback.denominators()[feedback.denominator].coefficients.clone(),
        }
    }
}
