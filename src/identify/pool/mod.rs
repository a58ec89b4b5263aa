//! Candidate pools: every pair of a feedforward denominator and a feedback controller with a stable closed loop.
//!
//! The closed-loop denominator is `Dff (Dp Dfb + Np Nfb)` (Zhang 2015, eq. 2.5), so stability separates, and a pool is a
//! product of a list of feedforward denominators and a table of feedback controllers.

pub mod factor;
pub mod feedback;
mod lists;
mod peak;
pub mod recipe;
pub mod roots;
mod routh;
pub mod spec;

use crate::identify::time::Region;
use factor::Factor;
pub use feedback::{Feedback, FeedbackTable};
pub use recipe::{PoolError, Recipe};
pub use routh::LARGEST_DEGREE;
pub use spec::{Degrees, PoolName, PoolSpec, PoolSpecError};

/// A pool on a plant.
///
/// # Order
/// The candidate with feedback controller `b` (in the order of [`FeedbackTable`]) and feedforward denominator `f` has the index
/// `b · M_ff + f`: feedback is outermost. Indices start at 0.
#[derive(Debug, Clone)]
pub struct Pool {
    region: Region,
    feedforward_numerator_degree: usize,
    feedforward: Vec<Factor>,
    feedback: FeedbackTable,
    size: u64,
}

/// One candidate of a pool.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Position of the feedforward denominator.
    pub feedforward: usize,
    /// The feedback controller.
    pub feedback: Feedback,
    /// Feedforward denominator, descending powers, monic.
    pub feedforward_denominator: Vec<f64>,
    /// Feedback numerator, descending powers.
    pub feedback_numerator: Vec<f64>,
    /// Feedback denominator, descending powers, monic.
    pub feedback_denominator: Vec<f64>,
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

    /// The candidate with an index.
    ///
    /// # Panics
    /// If there is none, which is a mistake of the caller.
    #[must_use]
    pub fn candidate(&self, index: u64) -> Candidate {
        assert!(index < self.size, "candidate {index} of {}", self.size);
        let count = self.feedforward.len() as u64;
        let feedforward = (index % count) as usize;
        let feedback = self.feedback.get(index / count);
        let (feedback_numerator, feedback_denominator) = self.feedback.coefficients(feedback);
        Candidate {
            feedforward,
            feedback,
            feedforward_denominator: self.feedforward[feedforward].coefficients.clone(),
            feedback_numerator,
            feedback_denominator,
        }
    }
}
