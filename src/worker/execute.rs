//! What a worker runs. The seam at which tests put jobs of their own.

use crate::analysis::{Failure, Library, Plan, Problem, References, Report, Request};
use crate::num::Ctl;

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

/// The analyses of [`crate::analysis`].
#[derive(Debug, Clone, Copy, Default)]
pub struct Analyses;

impl Execute for Analyses {
    fn plan(&self, request: &Request) -> Result<Box<dyn Work>, Problem> {
        Ok(Box::new(Plan::parse(request)?))
    }
}
