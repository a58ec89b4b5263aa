//! Pools and their trees, kept from one analysis to the next.

use crate::cache::codec::{Sink, Source};
use crate::cache::{ByteStore, CacheCounters, CacheStatistics, Key, Origins};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Pool, PoolError};
use crate::identify::problem::Problem;
use crate::identify::search::prepared::{Prepared, PreparedLines, PreparedPools, RecipeOnPlant, save_pool};
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// Pools whose trees are kept in memory.
const KEPT: usize = 2;

/// Pools and their trees, kept from one trial to the next: they depend on the plant and the lines, not on what was
/// measured. In memory for the process, and in a byte store, where there is one, for the next.
#[derive(Debug, Default)]
pub struct PoolMemo {
    pools: Mutex<Vec<KeptPool>>,
    store: Option<Arc<dyn ByteStore>>,
    counters: Arc<CacheCounters>,
}

#[derive(Debug, Clone)]
struct KeptPool {
    recipe: RecipeOnPlant,
    pool: Arc<Pool>,
    /// What was prepared on it last, and at which lines.
    prepared: Option<(PreparedLines, Prepared)>,
}

/// Where something came from that was not in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Origin {
    Store,
    Made,
}

fn count(origins: &mut Origins, origin: Origin) {
    match origin {
        Origin::Store => origins.store += 1,
        Origin::Made => origins.made += 1,
    }
}

impl PoolMemo {
    /// With a byte store, in which pools and trees wait for the next process.
    #[must_use]
    pub fn with_store(store: Arc<dyn ByteStore>) -> Self {
        Self { store: Some(store), ..Self::default() }
    }

    /// What has been needed so far, and where it came from.
    #[must_use]
    pub fn statistics(&self) -> CacheStatistics {
        self.counters.statistics()
    }

    /// What counts it, for whoever reports it.
    #[must_use]
    pub fn counters(&self) -> Arc<CacheCounters> {
        Arc::clone(&self.counters)
    }

    fn with<T>(&self, use_pools: impl FnOnce(&mut Vec<KeptPool>) -> T) -> T {
        // What is kept is complete whenever the lock is free, so a panic elsewhere does it no harm.
        use_pools(&mut self.pools.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// From the store, or made and put there. Without a key it is made and stays in memory.
    fn load_or_make<T, E: From<Stopped>>(
        &self,
        key: Option<&Key>,
        load: impl Fn(&mut Source<'_>) -> io::Result<T>,
        make: impl FnOnce() -> Result<T, E>,
        save: impl Fn(&T, &mut Sink<'_>) -> io::Result<()>,
        ctl: &Ctl,
    ) -> Result<(T, Origin), E> {
        let stored = self.store.as_ref().zip(key);
        if let Some((store, key)) = stored {
            let mut loaded = None;
            let believed = store.load(key, &mut |from, length| {
                loaded = Some(load(&mut Source::new(from, length, ctl))?);
                Ok(())
            });
            ctl.check()?;
            if let Some(loaded) = loaded.filter(|_| believed) {
                return Ok((loaded, Origin::Store));
            }
        }
        let made = make()?;
        if let Some((store, key)) = stored {
            store.save(key, &mut |to| save(&made, &mut Sink::new(to, ctl)));
        }
        Ok((made, Origin::Made))
    }
}

impl PreparedPools for PoolMemo {
    /// Built outside the lock: two trials that start together may both build it, and one is kept.
    fn pool(&self, recipe: &RecipeOnPlant, ctl: &Ctl) -> Result<Arc<Pool>, PoolError> {
        let same = |kept: &KeptPool| kept.recipe == *recipe;
        let known = self.with(|pools| {
            let at = pools.iter().position(same)?;
            let kept = pools.remove(at);
            let pool = Arc::clone(&kept.pool);
            pools.push(kept);
            Some(pool)
        });
        if let Some(pool) = known {
            self.counters.count(|all| all.pools.memory += 1);
            return Ok(pool);
        }
        let (pool, origin) = self.load_or_make(
            recipe.key().as_ref(),
            |from| recipe.load(from, ctl),
            || recipe.build(ctl),
            save_pool,
            ctl,
        )?;
        self.counters.count(|all| count(&mut all.pools, origin));
        let pool = Arc::new(pool);
        self.with(|pools| {
            if pools.len() >= KEPT {
                pools.remove(0);
            }
            pools.push(KeptPool { recipe: recipe.clone(), pool: Arc::clone(&pool), prepared: None });
        });
        Ok(pool)
    }

    fn prepared(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Prepared, Stopped> {
        let lines = PreparedLines::new(problem, pool);
        let same = |kept: &&mut KeptPool| std::ptr::eq(Arc::as_ptr(&kept.pool), pool);
        let (known, of) = self.with(|pools| {
            let Some(kept) = pools.iter_mut().find(same) else { return (None, None) };
            match kept.prepared.as_ref().filter(|(at, _)| *at == lines) {
                Some((_, prepared)) => (Some(prepared.clone()), None),
                None => (None, Some(kept.recipe.clone())),
            }
        });
        if let Some(prepared) = known {
            self.counters.count(|all| all.trees.memory += 1);
            return Ok(prepared);
        }
        // Where other pools have pushed this one out meanwhile, the trees are made for this search alone.
        let key = of.map(|recipe| lines.key(&recipe));
        let (prepared, origin) = self.load_or_make(
            key.as_ref(),
            |from| Prepared::load(problem, pool, from, ctl),
            || Prepared::new(problem, pool, ctl),
            Prepared::save,
            ctl,
        )?;
        self.counters.count(|all| count(&mut all.trees, origin));
        self.with(|pools| {
            if let Some(kept) = pools.iter_mut().find(same) {
                kept.prepared = Some((lines, prepared.clone()));
            }
        });
        Ok(prepared)
    }
}
