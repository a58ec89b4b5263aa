//! The search that fits a pool.

use super::factored::search::{self as factored, FactoredSearch};
use super::prepared::{Prepared, PreparedPools, RecipeOnPlant, SMALL};
use super::screen::exhaustive::Exhaustive;
use super::screen::optimum::{Method, Optimum, Search};
use super::sensitivity::search::{self as sensitivity, SensitivitySearch};
use crate::control::System;
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Pool, PoolError, Recipe};
use crate::identify::problem::Problem;
use std::sync::Arc;

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
        self.pools.pool(&RecipeOnPlant::new(recipe, plant), ctl)
    }

    fn search(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Optimum, Stopped> {
        if self.method == Method::Exhaustive
            || pool.size() <= SMALL
            || !factored::can_search(problem)
            || !sensitivity::can_search(problem)
        {
            return Exhaustive.search(problem, pool, ctl);
        }
        match self.pools.prepared(problem, pool, ctl)? {
            Prepared::Sensitivity(clusters) => SensitivitySearch { clusters: &clusters }.search(problem, pool, ctl),
            Prepared::Factored(trees) => FactoredSearch { trees: &trees }.search(problem, pool, ctl),
        }
    }
}
