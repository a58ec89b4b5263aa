//! The candidates that fit nearly as well as the best one: how flat the optimum is.

use super::pool::Pool;
use super::problem::Problem;
use super::search::Optimum;
use super::ssid::{SsidError, controllers};
use crate::control::System;
use rayon::prelude::*;

/// A candidate whose cost is within the share [`NEAR`](super::problem::NEAR) of the smallest one, or within rounding.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// Its index in the pool.
    pub index: u64,
    /// J, by QR.
    pub cost: f64,
    /// Gff.
    pub feedforward: System,
    /// Gfb.
    pub feedback: System,
}

/// The controllers of an optimum's near-optimal candidates, the best one first.
///
/// # Errors
/// [`SsidError::NotFinite`] where a coefficient overflows.
pub(super) fn family(problem: &Problem, pool: &Pool, optimum: &Optimum) -> Result<Vec<Member>, SsidError> {
    optimum
        .near
        .par_iter()
        .map(|(index, cost)| {
            let (_, [feedforward, feedback]) = controllers(problem, pool, *index)?;
            Ok(Member { index: *index, cost: *cost, feedforward, feedback })
        })
        .collect()
}
