//! The search that fits a pool, with the work that trials of one study share.

use super::listed::{self, Cells, Listed};
use super::tree::{self, BranchAndBound, Prepared};
use super::{Exhaustive, Optimum, Search};
use crate::control::System;
use crate::identify::pool::{Pool, PoolError, Recipe};
use crate::identify::problem::Problem;
use crate::num::{Complex64, Ctl, Stopped};
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, PoisonError};
use utoipa::ToSchema;

/// How the best candidate is found. All ways give the same answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// By bounds on clusters of candidates; small pools, and feedforward numerators of a high degree, candidate by candidate.
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

/// Pools up to this size are searched before their trees would be built.
const SMALL: u64 = 200_000;

/// Listing and clustering feedback controllers is worth while from so many feedforward denominators on: it takes each of them about as long as
/// an evaluation with a hundred. An FIR feedforward has one denominator only.
const WORTH_LISTING: usize = 100;

/// Pools whose trees are kept.
const KEPT: usize = 2;

/// Pools and their trees, kept from one trial to the next: they depend on the plant and the lines, not on what was measured.
#[derive(Debug, Default)]
pub struct Shared {
    pools: Mutex<Vec<KeptPool>>,
}

#[derive(Debug, Clone)]
struct KeptPool {
    recipe: Recipe,
    plant: System,
    pool: Arc<Pool>,
    /// Lines (angular frequency, plant) and degree of the feedforward numerator, with their trees.
    prepared: Option<(Lines, Trees)>,
}

type Lines = (Vec<(f64, Complex64)>, usize);

/// What a search needs of a pool and the lines, whatever was measured.
#[derive(Debug, Clone)]
enum Trees {
    /// The controllers can be listed, and meet enough feedforward denominators.
    Listed(Arc<Cells>),
    /// Otherwise.
    Product(Arc<Prepared>),
}

impl Trees {
    fn new(problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Self, Stopped> {
        let listed = pool.feedforward().len() >= WORTH_LISTING;
        match if listed { Cells::new(problem, pool, ctl)? } else { None } {
            Some(cells) => Ok(Self::Listed(Arc::new(cells))),
            None => Ok(Self::Product(Arc::new(Prepared::new(problem, pool, ctl)?))),
        }
    }
}

fn lines_of(problem: &Problem, pool: &Pool) -> Lines {
    let lines = problem.lines().iter().map(|line| (line.omega_rad_s, line.plant)).collect();
    (lines, pool.feedforward_numerator_degree())
}

impl Shared {
    fn with<T>(&self, use_pools: impl FnOnce(&mut Vec<KeptPool>) -> T) -> T {
        // What is kept is complete whenever the lock is free, so a panic elsewhere does it no harm.
        use_pools(&mut self.pools.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// The search that a [`Method`] asks for.
#[derive(Debug, Clone, Copy)]
pub struct Automatic<'a> {
    /// How.
    pub method: Method,
    /// What earlier trials have left.
    pub shared: &'a Shared,
}

impl Search for Automatic<'_> {
    /// Built outside the lock: two trials that start together may both build it, and one is kept.
    fn pool(&self, recipe: &Recipe, plant: &System, ctl: &Ctl) -> Result<Arc<Pool>, PoolError> {
        let same = |kept: &KeptPool| kept.recipe == *recipe && kept.plant == *plant;
        let known = self.shared.with(|pools| {
            let at = pools.iter().position(same)?;
            let kept = pools.remove(at);
            let pool = Arc::clone(&kept.pool);
            pools.push(kept);
            Some(pool)
        });
        if let Some(pool) = known {
            return Ok(pool);
        }
        let pool = Arc::new(recipe.build(plant, ctl)?);
        self.shared.with(|pools| {
            if pools.len() >= KEPT {
                pools.remove(0);
            }
            let (recipe, plant) = (recipe.clone(), plant.clone());
            pools.push(KeptPool { recipe, plant, pool: Arc::clone(&pool), prepared: None });
        });
        Ok(pool)
    }

    fn search(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Optimum, Stopped> {
        if self.method == Method::Exhaustive
            || pool.size() <= SMALL
            || !tree::can_search(problem)
            || !listed::can_search(problem)
        {
            return Exhaustive.search(problem, pool, ctl);
        }
        let lines = lines_of(problem, pool);
        let own = |kept: &&mut KeptPool| std::ptr::eq(Arc::as_ptr(&kept.pool), pool);
        let known = self.shared.with(|pools| {
            let kept = pools.iter_mut().find(own)?;
            let (of, prepared) = kept.prepared.as_ref()?;
            (*of == lines).then(|| prepared.clone())
        });
        let prepared = match known {
            Some(prepared) => prepared,
            None => {
                let prepared = Trees::new(problem, pool, ctl)?;
                self.shared.with(|pools| {
                    if let Some(kept) = pools.iter_mut().find(own) {
                        kept.prepared = Some((lines, prepared.clone()));
                    }
                });
                prepared
            }
        };
        match &prepared {
            Trees::Listed(cells) => Listed { cells }.search(problem, pool, ctl),
            Trees::Product(prepared) => BranchAndBound { prepared }.search(problem, pool, ctl),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Continuous, TransferFunction};
    use crate::identify::pool::{Degrees, PoolSpec};
    use serde_json::json;

    /// With an FIR feedforward the walk through of the README took over a minute, nearly all of it for clusters.
    #[test]
    fn controllers_are_listed_only_where_that_is_worth_while() {
        let plant = TransferFunction::new(&[2.0, 4.4], &[1.0, 3.6, 4.0], Continuous).unwrap();
        let plant = System::Continuous(plant);
        let omega = [0.7, 1.1, 1.6, 2.2, 2.6, 3.0];
        let h = omega.map(|w| Complex64::new(0.0, -w).exp());
        let problem = Problem::new(&crate::identify::problem::Lines::new(&plant, &omega, &h, None), 4).unwrap();
        for (poles, listed) in [(3, true), (40, false)] {
            let spec = json!({"name": "zhang2015_appendix_b", "thin": {"poles": poles, "zeros": 20, "gains": 20}});
            let recipe = serde_json::from_value::<PoolSpec>(spec).unwrap().check(Degrees::default()).unwrap();
            let pool = recipe.build(&plant, &Ctl::new()).unwrap();
            assert_eq!(pool.feedforward().len() >= WORTH_LISTING, listed, "{}", pool.feedforward().len());
            let trees = Trees::new(&problem, &pool, &Ctl::new()).unwrap();
            assert_eq!(matches!(trees, Trees::Listed(_)), listed);
        }
    }
}
