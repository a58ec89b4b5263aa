//! The feedback controllers of a pool in clusters, as each search has them.

use super::pair::View;
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Feedback, Pool};
use crate::identify::problem::Problem;
use num_complex::Complex64;

/// What a cluster consists of.
pub(super) enum Parts<C> {
    Clusters(Vec<C>),
    Controllers(Vec<Feedback>),
}

/// All feedback controllers of a pool but none at all, in clusters.
pub(super) trait Controllers: Sync {
    type Cluster: Clone + Send + Sync;

    /// Clusters that together hold every controller.
    fn roots(&self) -> Vec<Self::Cluster>;

    /// What is known of a cluster.
    fn view(&self, cluster: &Self::Cluster, into: &mut View);

    /// Its parts.
    ///
    /// # Errors
    /// [`Stopped`] when the visitor was asked to stop.
    fn parts(&self, cluster: &Self::Cluster, ctl: &Ctl) -> Result<Parts<Self::Cluster>, Stopped>;
}

/// A single controller.
pub(super) fn view_of(problem: &Problem, pool: &Pool, feedback: &Feedback, into: &mut View) {
    let table = pool.feedback();
    into.radius.clear();
    into.radius.resize(problem.lines().len(), 0.0);
    into.inverse.clear();
    let Some(numerator) = feedback.numerator else {
        into.inverse.resize(problem.lines().len(), Complex64::ONE);
        return;
    };
    let numerator = problem.at_lines(&table.numerators()[numerator].coefficients);
    let reciprocal = problem.reciprocal_at_lines(&table.denominators()[feedback.denominator].coefficients);
    let factors = problem.lines().iter().zip(numerator.iter().zip(&reciprocal));
    into.inverse.extend(factors.map(|(line, (n, d))| 1.0 + line.plant * (feedback.gain * (n * d))));
}

/// Controllers that nobody has clustered: blocks of the table, of which nothing is known.
#[derive(Debug)]
pub(super) struct Listed<'a> {
    pub pool: &'a Pool,
}

impl Controllers for Listed<'_> {
    type Cluster = usize;

    fn roots(&self) -> Vec<usize> {
        (0..self.pool.feedback().blocks()).collect()
    }

    fn view(&self, _: &usize, into: &mut View) {
        into.norm = [0.0, f64::INFINITY];
        into.inverse.clear();
        into.radius.clear();
    }

    fn parts(&self, block: &usize, ctl: &Ctl) -> Result<Parts<usize>, Stopped> {
        let mut controllers = Vec::new();
        self.pool.feedback().walk(*block, ctl, |row| {
            controllers.extend(row.controllers().filter(|feedback| feedback.numerator.is_some()));
            Ok(())
        })?;
        Ok(Parts::Controllers(controllers))
    }
}
