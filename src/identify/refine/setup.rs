//! What is refined, from where, and why it may not be.

use crate::control::System;
use crate::ctl::Stopped;
use crate::identify::identifiability::Structure;
use crate::identify::problem::Problem;

/// What is refined on.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    /// Lines and numerator basis.
    pub problem: &'a Problem,
    /// The plant, in the time base of the controllers.
    pub plant: &'a System,
    /// Degrees, and what is free.
    pub structure: Structure,
    /// Exponents of the closed loop keep real parts below minus this, in 1/s.
    pub margin_per_s: f64,
}

/// Controllers to start from, in descending powers of s or z; they must keep the margin.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// Denominator of the feedforward; monic.
    pub feedforward_denominator: Vec<f64>,
    /// Numerator of the feedback.
    pub feedback_numerator: Vec<f64>,
    /// Denominator of the feedback; monic.
    pub feedback_denominator: Vec<f64>,
}

impl Start {
    /// The denominators and the feedback of identified controllers.
    #[must_use]
    pub fn of(feedforward: &System, feedback: &System) -> Self {
        Self {
            feedforward_denominator: feedforward.den().coefficients().to_vec(),
            feedback_numerator: feedback.num().coefficients().to_vec(),
            feedback_denominator: feedback.den().coefficients().to_vec(),
        }
    }
}

/// Why nothing was refined.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RefineError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// The start does not keep the margin, or lies on its edge to working precision.
    #[error("the {0} of the start lies on the edge of the stability margin to working precision")]
    OnTheEdge(&'static str),
    /// A polynomial has another degree than the structure says.
    #[error("the {0} of the start has another degree than the structure")]
    Degree(&'static str),
    /// The residuals or the refined coefficients overflow, or the lines do not determine the numerator.
    #[error("the residuals or coefficients are not finite")]
    NotFinite,
}

/// A delay of one refinement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DelayValue {
    /// Its value, or where it starts.
    pub start_s: f64,
    /// Where it may go; `None` where it is fixed.
    pub range_s: Option<[f64; 2]>,
}

impl DelayValue {
    /// No delay.
    pub const NONE: Self = Self { start_s: 0.0, range_s: None };

    /// Whether it is no delay, and stays none.
    #[must_use]
    pub fn is_none(self) -> bool {
        self == Self::NONE
    }
}
