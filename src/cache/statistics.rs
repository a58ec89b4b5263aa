//! How often what analyses share was needed, and where it came from.

use std::sync::{Mutex, PoisonError};

/// How often something was needed, by where it came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Origins {
    /// An earlier analysis of this process had left it in memory.
    pub memory: u64,
    /// It was read from the byte store.
    pub store: u64,
    /// It was made.
    pub made: u64,
}

/// What has been needed so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CacheStatistics {
    /// Pools, whose stable controllers are to be counted.
    pub pools: Origins,
    /// What branch and bound needs of a pool at the lines of a trial: trees or clusters.
    pub trees: Origins,
}

/// Counts, from any thread.
#[derive(Debug, Default)]
pub struct CacheCounters(Mutex<CacheStatistics>);

impl CacheCounters {
    /// What has been counted so far.
    #[must_use]
    pub fn statistics(&self) -> CacheStatistics {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts.
    pub fn count(&self, add: impl FnOnce(&mut CacheStatistics)) {
        add(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}
