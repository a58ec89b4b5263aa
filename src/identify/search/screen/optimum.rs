//! What a search is asked, and what it answers.

use crate::control::System;
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Pool, PoolError, Recipe};
use crate::identify::problem::Problem;
use crate::identify::search::prepared::Prepared;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Candidates that a family keeps.
pub const MOST_NEAR: usize = 100;

/// How the best candidate is found. All ways give the same answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// By bounds on clusters of candidates; small pools, and feedforward numerators of a high degree, candidate by
    /// candidate.
    #[default]
    BranchAndBound,
    /// Candidate by candidate.
    Exhaustive,
}

impl Method {
    /// The name on the wire.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::BranchAndBound => "branch_and_bound",
            Self::Exhaustive => "exhaustive",
        }
    }
}

/// An exact search: whatever way it takes, its answer is the candidate with the smallest cost of *all* candidates, and
/// of several with the same cost (in `f64`, by [`exact::fit`](super::exact::fit)) the one with the lowest index.
///
/// Runs on the rayon pool that it is called in, and gives the same answer for any number of threads.
pub trait Search {
    /// Makes the pool on a plant. A search that keeps pools for the trials of a study gives the kept one.
    ///
    /// # Errors
    /// [`PoolError`].
    fn pool(&self, recipe: &Recipe, plant: &System, ctl: &Ctl) -> Result<Arc<Pool>, PoolError> {
        recipe.build(plant, ctl).map(Arc::new)
    }

    /// Finds the best candidate.
    ///
    /// Progress is in candidates.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    fn search(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Optimum, Stopped>;

    /// Prepares what bounds on clusters of the pool need, where this search uses any.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    fn prepare(&self, _problem: &Problem, _pool: &Pool, _ctl: &Ctl) -> Result<Option<Prepared>, Stopped> {
        Ok(None)
    }

    /// [`Search::search`] with what [`Search::prepare`] gave.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    fn search_prepared(
        &self,
        problem: &Problem,
        pool: &Pool,
        _prepared: Option<&Prepared>,
        ctl: &Ctl,
    ) -> Result<Optimum, Stopped> {
        self.search(problem, pool, ctl)
    }
}

/// The best candidate, and how it was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Optimum {
    /// Its index.
    pub index: u64,
    /// Its cost, by [`exact::fit`](super::exact::fit).
    pub cost: f64,
    /// How it was found.
    pub method: Method,
    /// How many candidates were evaluated one by one (by their own least-squares problem). With bounds this depends on
    /// which thread found what first, as do the next two members and no others.
    pub evaluated: u64,
    /// How many pairs of clusters were bounded from below; 0 for a search without bounds. What was not evaluated is
    /// proven worse by these.
    pub bounded: u64,
    /// How many of those evaluated could not be told from the best one by the fast evaluation and were decided by QR.
    pub decided_by_qr: u64,
    /// How many candidates, the best one included, cost at most `1 + NEAR` times as much as it.
    pub near_optimal: u64,
    /// The best of these, the best one first: index and cost by QR, at most [`MOST_NEAR`]; of equal costs the lowest
    /// index first. A controller without feedback is every stable feedback denominator with gain 0, and here once, with
    /// its lowest index.
    pub near: Vec<(u64, f64)>,
    /// Whether candidates may be missing in `near` that cost as little: of a search it holds all of them, or the
    /// [`MOST_NEAR`] best; what is taken out afterwards may end earlier.
    pub near_is_cut: bool,
}
