//! The search that fits a pool.

use super::factored::search::{self as factored, FactoredSearch};
use super::prepared::{Prepared, PreparedPools, RecipeOnPlant, SMALL};
use super::screen::exhaustive::Exhaustive;
use super::screen::optimum::{Method, Optimum, Search};
use super::sensitivity::search::{self as sensitivity, SensitivitySearch};
use crate::control::System;
use crate::ctl::{Ctl, Phase, Stopped};
use crate::identify::pool::{Pool, PoolError, Recipe};
use crate::identify::problem::Problem;
use std::sync::Arc;

/// Without a feedforward there is nothing to solve for, and pools up to this size are evaluated before trees are made.
const WITHOUT_FEEDFORWARD: u64 = 100_000_000;

/// Which share of the time it takes to count a pool, where nothing of it was kept.
const COUNTING: f64 = 0.2;

/// Which share of the time it takes to make trees or clusters of a large pool.
const TREES: f64 = 0.6;

/// The search that a [`Method`] asks for.
#[derive(Debug, Clone, Copy)]
pub struct Automatic<'a> {
    /// How.
    pub method: Method,
    /// Where pools and their trees come from.
    pub pools: &'a dyn PreparedPools,
}

impl Search for Automatic<'_> {
    fn pool(&self, recipe: &Recipe, plant: &System, ctl: &Ctl) -> Result<Arc<Pool>, PoolError> {
        ctl.enter(Phase::Preparation, COUNTING);
        self.pools.pool(&RecipeOnPlant::new(recipe, plant), ctl)
    }

    fn search(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Optimum, Stopped> {
        let prepared = self.prepare(problem, pool, ctl)?;
        self.search_prepared(problem, pool, prepared.as_ref(), ctl)
    }

    fn prepare(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Option<Prepared>, Stopped> {
        let small = if problem.basis().is_none() { WITHOUT_FEEDFORWARD } else { SMALL };
        // Without feedback there is nothing to make trees of: as many candidates as one list holds.
        if self.method == Method::Exhaustive
            || pool.size() <= small
            || pool.feedback().gains().is_empty()
            || !factored::can_search(problem)
            || !sensitivity::can_search(problem)
        {
            return Ok(None);
        }
        ctl.enter(Phase::Preparation, TREES);
        self.pools.prepared(problem, pool, ctl).map(Some)
    }

    fn search_prepared(
        &self,
        problem: &Problem,
        pool: &Pool,
        prepared: Option<&Prepared>,
        ctl: &Ctl,
    ) -> Result<Optimum, Stopped> {
        ctl.enter(Phase::Search, 1.0);
        match prepared {
            None => Exhaustive.search(problem, pool, ctl),
            Some(Prepared::Sensitivity(clusters)) => SensitivitySearch { clusters }.search(problem, pool, ctl),
            Some(Prepared::Factored(trees)) => FactoredSearch { trees }.search(problem, pool, ctl),
        }
    }
}
