//! What a worker runs. The seam at which tests put jobs of their own.

use crate::analysis::{Failure, Library, Plan, Problem, References, Report, Request, Shared};
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

/// The analyses of [`crate::analysis`], with what they leave for each other.
#[derive(Debug, Clone, Default)]
pub struct Analyses {
    shared: Arc<Shared>,
}

impl Analyses {
    /// Over what they leave for each other: with a shelf in it, for the next process too.
    #[must_use]
    pub fn new(shared: Arc<Shared>) -> Self {
        Self { shared }
    }
}

/// A plan that finds what earlier ones have left.
struct Sharing {
    plan: Plan,
    shared: Arc<Shared>,
}

impl Work for Sharing {
    fn references(&self) -> References {
        self.plan.references()
    }

    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        self.plan.run(&Library { shared: Arc::clone(&self.shared), ..library.clone() }, ctl)
    }
}

impl Execute for Analyses {
    fn plan(&self, request: &Request) -> Result<Box<dyn Work>, Problem> {
        Ok(Box::new(Sharing { plan: Plan::parse(request)?, shared: Arc::clone(&self.shared) }))
    }
}
