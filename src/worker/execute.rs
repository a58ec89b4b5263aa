//! What a worker runs. The seam at which tests put jobs of their own.

use super::pool_memo::PoolMemo;
use crate::analysis::{Failure, Library, Plan, Problem, References, Report, Request};
use crate::ctl::Ctl;
use std::sync::Arc;

/// Turns requests into work.
pub trait Execute: Send + Sync + 'static {
    /// Checks a request.
    ///
    /// # Errors
    /// The problem that the analysis then fails with.
    fn plan(&self, request: &Request) -> Result<Box<dyn Work>, Problem>;
}

/// A checked request.
pub trait Work: Send + Sync {
    /// The stored things that it needs.
    fn references(&self) -> References;

    /// Computes the report, on the rayon pool that it is called in.
    ///
    /// # Errors
    /// As [`Plan::run`].
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure>;
}

impl Work for Plan {
    fn references(&self) -> References {
        Plan::references(self)
    }

    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        Plan::run(self, library, ctl)
    }
}

/// The analyses of [`crate::analysis`], with the candidate pools that they share.
#[derive(Debug, Clone, Default)]
pub struct Analyses {
    pools: Arc<PoolMemo>,
}

impl Analyses {
    /// Over the pools that they keep for each other: with a byte store, for the next process too.
    #[must_use]
    pub fn new(pools: Arc<PoolMemo>) -> Self {
        Self { pools }
    }
}

/// A plan that finds the pools that earlier ones have left.
struct WithPools {
    plan: Plan,
    pools: Arc<PoolMemo>,
}

impl Work for WithPools {
    fn references(&self) -> References {
        self.plan.references()
    }

    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        let pools = Arc::<PoolMemo>::clone(&self.pools);
        self.plan.run(&Library { pools, ..library.clone() }, ctl)
    }
}

impl Execute for Analyses {
    fn plan(&self, request: &Request) -> Result<Box<dyn Work>, Problem> {
        Ok(Box::new(WithPools { plan: Plan::parse(request)?, pools: Arc::clone(&self.pools) }))
    }
}
