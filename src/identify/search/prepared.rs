//! What searches on one pool share, whatever was measured: the pool itself, and its trees or clusters at the lines.

use super::factored;
use super::factored::trees::FactorTrees;
use super::keys::{hash_lines, hash_plant, hash_recipe};
use super::sensitivity::build::clusters::Clusters;
use super::sensitivity::build::codec;
use crate::cache::codec::{Sink, Source, invalid};
use crate::cache::{Key, KeyHasher};
use crate::control::System;
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Pool, PoolError, Recipe};
use crate::identify::problem::Problem;
use crate::num::Complex64;
use std::fmt;
use std::io;
use std::sync::Arc;

/// Pools up to this size are searched before their trees would be built.
pub(crate) const SMALL: u64 = 200_000;

/// Listing and clustering feedback controllers is worth while from so many feedforward denominators on: it takes each
/// of them about as long as an evaluation with a hundred. An FIR feedforward has one denominator only.
const WORTH_LISTING: usize = 100;

/// The first byte of trees in a byte store.
const SENSITIVITY: u8 = 1;
const FACTORED: u8 = 2;

/// A recipe and the plant that it is for: all that a pool depends on, so whoever keeps pools tells them apart by it.
#[derive(Debug, Clone, PartialEq)]
pub struct RecipeOnPlant {
    recipe: Recipe,
    plant: System,
}

impl RecipeOnPlant {
    /// Of a recipe and a plant.
    #[must_use]
    pub fn new(recipe: &Recipe, plant: &System) -> Self {
        Self { recipe: recipe.clone(), plant: plant.clone() }
    }

    /// Makes the pool.
    ///
    /// # Errors
    /// [`PoolError`].
    pub fn build(&self, ctl: &Ctl) -> Result<Pool, PoolError> {
        self.recipe.build(&self.plant, ctl)
    }

    /// The key of the pool's counts of stable controllers; `None` where they are counted as quickly as read.
    pub(crate) fn key(&self) -> Option<Key> {
        (self.recipe.combinations() > u128::from(SMALL)).then(|| self.hasher("counts").key())
    }

    /// Reads the counts that [`save_pool`] wrote, and makes the pool with them.
    pub(crate) fn load(&self, from: &mut Source<'_>, ctl: &Ctl) -> io::Result<Pool> {
        let counts = from.array()?;
        // A recipe and a plant that make no pool have left nothing in the store.
        let pool = self.recipe.build_counted(&self.plant, Some(&counts), ctl).map_err(io::Error::other)?;
        if pool.feedback().counts() == counts { Ok(pool) } else { Err(invalid("counts of another pool")) }
    }

    fn hasher(&self, kind: &'static str) -> KeyHasher {
        let mut hasher = KeyHasher::new(kind);
        hash_recipe(&mut hasher, &self.recipe);
        hash_plant(&mut hasher, &self.plant);
        hasher
    }
}

/// Where a search gets pools and what it prepares on them: made, or kept from an earlier trial of the study. Whatever
/// is given depends on the arguments alone, so that keeping changes nothing but the time.
pub trait PreparedPools: fmt::Debug + Send + Sync {
    /// The pool of a recipe on a plant.
    ///
    /// # Errors
    /// [`PoolError`].
    fn pool(&self, recipe: &RecipeOnPlant, ctl: &Ctl) -> Result<Arc<Pool>, PoolError>;

    /// What branch and bound needs of a pool at the lines of a problem.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    fn prepared(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Prepared, Stopped>;
}

/// Makes everything anew and keeps nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct KeepNothing;

impl PreparedPools for KeepNothing {
    fn pool(&self, recipe: &RecipeOnPlant, ctl: &Ctl) -> Result<Arc<Pool>, PoolError> {
        recipe.build(ctl).map(Arc::new)
    }

    fn prepared(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Prepared, Stopped> {
        Prepared::new(problem, pool, ctl)
    }
}

/// What branch and bound needs of a pool and the lines, whatever was measured.
#[derive(Debug, Clone)]
pub enum Prepared {
    /// The controllers can be listed, and meet enough feedforward denominators.
    Sensitivity(Arc<Clusters>),
    /// Otherwise.
    Factored(Arc<FactorTrees>),
}

impl Prepared {
    /// Makes it. The measured responses of the problem are not used.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn new(problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Self, Stopped> {
        let listed = pool.feedforward().len() >= WORTH_LISTING;
        match if listed { Clusters::new(problem, pool, ctl)? } else { None } {
            Some(clusters) => Ok(Self::Sensitivity(Arc::new(clusters))),
            None => Ok(Self::Factored(Arc::new(FactorTrees::new(problem, pool, ctl)?))),
        }
    }

    /// Writes what [`Prepared::load`] reads.
    pub(crate) fn save(&self, to: &mut Sink<'_>) -> io::Result<()> {
        match self {
            Self::Sensitivity(clusters) => {
                to.pod(SENSITIVITY)?;
                clusters.save(to)
            }
            Self::Factored(trees) => {
                to.pod(FACTORED)?;
                trees.save(to)
            }
        }
    }

    /// Reads what [`Prepared::save`] wrote of this pool at these lines.
    pub(crate) fn load(problem: &Problem, pool: &Pool, from: &mut Source<'_>, ctl: &Ctl) -> io::Result<Self> {
        match from.pod()? {
            SENSITIVITY => Ok(Self::Sensitivity(Arc::new(Clusters::load(problem, pool, from, ctl)?))),
            FACTORED => Ok(Self::Factored(Arc::new(FactorTrees::load(problem, pool, from)?))),
            _ => Err(invalid("neither clusters nor trees")),
        }
    }
}

/// The lines of a problem as far as [`Prepared`] depends on them: angular frequency and plant, and the degree of the
/// feedforward numerator.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PreparedLines {
    lines: Vec<(f64, Complex64)>,
    degree: usize,
}

impl PreparedLines {
    pub(crate) fn new(problem: &Problem, pool: &Pool) -> Self {
        let lines = problem.lines().iter().map(|line| (line.omega_rad_s, line.plant)).collect();
        Self { lines, degree: pool.feedforward_numerator_degree() }
    }

    /// The key of what is prepared on a pool at these lines.
    pub(crate) fn key(&self, recipe: &RecipeOnPlant) -> Key {
        let mut hasher = recipe.hasher("trees");
        hash_lines(&mut hasher, &self.lines);
        hasher.length(self.degree);
        hasher.length(WORTH_LISTING);
        codec::parameters(&mut hasher);
        factored::codec::parameters(&mut hasher);
        hasher.key()
    }
}

/// Writes what [`RecipeOnPlant::load`] reads.
pub(crate) fn save_pool(pool: &Pool, to: &mut Sink<'_>) -> io::Result<()> {
    to.array(pool.feedback().counts())
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
            let prepared = Prepared::new(&problem, &pool, &Ctl::new()).unwrap();
            assert_eq!(matches!(prepared, Prepared::Sensitivity(_)), listed);
        }
    }
}
