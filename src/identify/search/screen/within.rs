//! How many candidates cost at most so much, candidate by candidate.

use super::block::{Batch, Evaluator};
use super::exact;
use super::kernel::{FeedbackAtLines, FeedforwardAtLines, Layout, Screened, across_feedforward};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Feedback, Pool, Position};
use crate::identify::problem::Problem;
use num_complex::Complex64;
use rayon::prelude::*;

/// The number of candidates that cost at most `limit` (by QR). Progress is in candidates.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub(crate) fn count_within(problem: &Problem, pool: &Pool, limit: f64, ctl: &Ctl) -> Result<u64, Stopped> {
    ctl.set_total(pool.size());
    let evaluator = Evaluator::new(problem, pool);
    (0..pool.feedback().blocks())
        .into_par_iter()
        .map(|block| {
            let mut count = 0;
            evaluator.block(block, ctl, true, |Batch { first, stride, screened }| {
                for (i, (cost, bound)) in screened.cost.iter().zip(&screened.bound).enumerate() {
                    // The approximate cost errs by as much upwards as the bound is below it.
                    let surely = 2.0 * cost - bound <= limit;
                    let candidate = |index: u64| pool.candidate(pool.position(index));
                    let within = surely
                        || (*bound <= limit && exact::cost(problem, &candidate(first + stride * i as u64)) <= limit);
                    count += u64::from(within);
                }
            })?;
            Ok(count)
        })
        .sum()
}

/// Counts the feedforward denominators with which a feedback controller costs at most so much.
#[derive(Debug)]
pub(crate) struct Partners<'a> {
    problem: &'a Problem,
    pool: &'a Pool,
    limit: f64,
    layout: Layout,
    feedforward: FeedforwardAtLines,
}

impl<'a> Partners<'a> {
    pub(crate) fn new(problem: &'a Problem, pool: &'a Pool, limit: f64) -> Self {
        let feedforward = FeedforwardAtLines::new(problem, pool.feedforward());
        Self { problem, pool, limit, layout: Layout::new(problem), feedforward }
    }

    /// How many denominators.
    pub(crate) fn count(&self, feedback: Feedback) -> u64 {
        let Self { problem, pool, limit, .. } = *self;
        let table = pool.feedback();
        let reciprocal = problem.reciprocal_at_lines(&table.denominators()[feedback.denominator].coefficients);
        let numerator = feedback.numerator.map(|n| problem.at_lines(&table.numerators()[n].coefficients));
        // As every evaluation does it: the quotient at the lines first, then the gain.
        let value =
            |(k, d): (usize, &Complex64)| numerator.as_ref().map_or(Complex64::ZERO, |n| feedback.gain * (n[k] * d));
        let mut at_lines = FeedbackAtLines::default();
        at_lines.set(problem, reciprocal.iter().enumerate().map(value));
        let mut screened = Screened::default();
        across_feedforward(&self.layout, &self.feedforward, &at_lines, &mut screened);
        let within = |(feedforward, (cost, bound)): &(usize, (&f64, &f64))| {
            let position = Position { feedforward: *feedforward, feedback };
            2.0 * **cost - **bound <= limit
                || (**bound <= limit && exact::cost(problem, &pool.candidate(position)) <= limit)
        };
        screened.cost.iter().zip(&screened.bound).enumerate().filter(within).count() as u64
    }
}
