//! The search that fits a pool, with the work that trials of one study share.

use super::listed::{self, Cells, Listed};
use super::shelf::{Key, Maker, Shelf, Sink, Source, bad};
use super::tree::{self, BranchAndBound, Prepared};
use super::{Exhaustive, Optimum, Search};
use crate::control::System;
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Pool, PoolError, Recipe};
use crate::identify::problem::Problem;
use crate::num::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// How the best candidate is found. All ways give the same answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
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

/// The first byte of trees on a shelf.
const LISTED: u8 = 1;
const PRODUCT: u8 = 2;

/// Pools and their trees, kept from one trial to the next: they depend on the plant and the lines, not on what was measured. In memory for
/// the process, and on a shelf, where there is one, for the next.
#[derive(Debug, Default)]
pub struct Shared {
    pools: Mutex<Vec<KeptPool>>,
    shelf: Option<Arc<dyn Shelf>>,
    tally: Mutex<Tally>,
}

/// How often something that trials share was needed, by where it came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Origins {
    /// An earlier trial of this process had left it.
    pub memory: u64,
    /// It was read from the shelf.
    pub shelf: u64,
    /// It was made.
    pub made: u64,
}

/// What has been needed so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// Pools, whose stable controllers are to be counted.
    pub pools: Origins,
    /// Trees, or clusters, of a pool at the lines of a trial.
    pub trees: Origins,
}

/// Where something came from that was not in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Origin {
    Shelf,
    Made,
}

impl Origins {
    fn count(&mut self, origin: Origin) {
        match origin {
            Origin::Shelf => self.shelf += 1,
            Origin::Made => self.made += 1,
        }
    }
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

    fn save(&self, to: &mut Sink<'_>) -> io::Result<()> {
        match self {
            Self::Listed(cells) => {
                to.plain(LISTED)?;
                cells.save(to)
            }
            Self::Product(prepared) => {
                to.plain(PRODUCT)?;
                prepared.save(to)
            }
        }
    }

    fn load(problem: &Problem, pool: &Pool, from: &mut Source<'_>, ctl: &Ctl) -> io::Result<Self> {
        match from.plain()? {
            LISTED => Ok(Self::Listed(Arc::new(Cells::load(problem, pool, from, ctl)?))),
            PRODUCT => Ok(Self::Product(Arc::new(Prepared::load(problem, pool, from)?))),
            _ => Err(bad("neither clusters nor trees")),
        }
    }
}

/// What a shelf has of a pool, or of a pool at some lines.
fn key_of(kind: &'static str, recipe: &Recipe, plant: &System, lines: Option<&Lines>) -> Key {
    let mut maker = Maker::new(kind);
    maker.recipe(recipe);
    maker.plant(plant);
    if let Some((lines, degree)) = lines {
        maker.lines(lines);
        maker.length(*degree);
        maker.length(WORTH_LISTING);
        listed::parameters(&mut maker);
        tree::parameters(&mut maker);
    }
    maker.key()
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

    /// With a shelf, on which pools and trees wait for the next process.
    #[must_use]
    pub fn with_shelf(shelf: Arc<dyn Shelf>) -> Self {
        Self { shelf: Some(shelf), ..Self::default() }
    }

    /// What has been needed so far, and where it came from.
    #[must_use]
    pub fn tally(&self) -> Tally {
        *self.tally.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, note: impl FnOnce(&mut Tally)) {
        note(&mut self.tally.lock().unwrap_or_else(PoisonError::into_inner));
    }

    /// From the shelf, or made and put there. Without a key it is made and stays in memory.
    fn load_or_make<T, E: From<Stopped>>(
        &self,
        key: Option<&Key>,
        load: impl Fn(&mut Source<'_>) -> io::Result<T>,
        make: impl FnOnce() -> Result<T, E>,
        save: impl Fn(&T, &mut Sink<'_>) -> io::Result<()>,
        ctl: &Ctl,
    ) -> Result<(T, Origin), E> {
        let shelved = self.shelf.as_ref().zip(key);
        if let Some((shelf, key)) = shelved {
            let mut loaded = None;
            let believed = shelf.load(key, &mut |from, length| {
                loaded = Some(load(&mut Source::new(from, length, ctl))?);
                Ok(())
            });
            ctl.check()?;
            if let Some(loaded) = loaded.filter(|_| believed) {
                return Ok((loaded, Origin::Shelf));
            }
        }
        let made = make()?;
        if let Some((shelf, key)) = shelved {
            shelf.save(key, &mut |to| save(&made, &mut Sink::new(to, ctl)));
        }
        Ok((made, Origin::Made))
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
            self.shared.note(|tally| tally.pools.memory += 1);
            return Ok(pool);
        }
        let key = (recipe.combinations() > u128::from(SMALL)).then(|| key_of("counts", recipe, plant, None));
        let load = |from: &mut Source<'_>| {
            let counts = from.array()?;
            // A recipe and a plant that make no pool have left nothing on the shelf.
            let pool = recipe.build_counted(plant, Some(&counts), ctl).map_err(io::Error::other)?;
            if pool.feedback().counts() == counts { Ok(pool) } else { Err(bad("counts of another pool")) }
        };
        let (pool, origin) = self.shared.load_or_make(
            key.as_ref(),
            load,
            || recipe.build(plant, ctl),
            |pool, to| to.array(pool.feedback().counts()),
            ctl,
        )?;
        self.shared.note(|tally| tally.pools.count(origin));
        let pool = Arc::new(pool);
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
        let (known, of) = self.shared.with(|pools| {
            let Some(kept) = pools.iter_mut().find(own) else { return (None, None) };
            match kept.prepared.as_ref().filter(|(of, _)| *of == lines) {
                Some((_, prepared)) => (Some(prepared.clone()), None),
                None => (None, Some((kept.recipe.clone(), kept.plant.clone()))),
            }
        });
        let prepared = match known {
            Some(prepared) => {
                self.shared.note(|tally| tally.trees.memory += 1);
                prepared
            }
            None => {
                // Where other pools have pushed this one out meanwhile, the trees are made for this search alone.
                let key = of.map(|(recipe, plant)| key_of("trees", &recipe, &plant, Some(&lines)));
                let (prepared, origin) = self.shared.load_or_make(
                    key.as_ref(),
                    |from| Trees::load(problem, pool, from, ctl),
                    || Trees::new(problem, pool, ctl),
                    |prepared, to| prepared.save(to),
                    ctl,
                )?;
                self.shared.note(|tally| tally.trees.count(origin));
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
