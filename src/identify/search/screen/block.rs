//! A block of a pool's feedback controllers, evaluated with every feedforward denominator.

use super::kernel::{self, FeedbackAtLines, FeedbackBatch, FeedforwardAtLines, Layout, LineConstants, Screened};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Pool;
use crate::identify::problem::Problem;
use num_complex::Complex64;

/// From this many feedforward denominators on, candidates that differ in these are evaluated together; below,
/// candidates that differ in the feedback controller.
const MANY_DENOMINATORS: usize = 8;

/// Feedback controllers evaluated together.
const BATCH: usize = 64;

/// Candidates between two looks at the stop flag, and two reports of progress: a few milliseconds.
const CANDIDATES_PER_CHECK: u64 = 1 << 17;

/// Most values of numerators at lines that are kept (64 MiB).
const KEPT_VALUES: usize = 1 << 22;

/// A problem and a pool, prepared.
#[derive(Debug)]
pub(super) struct Evaluator<'a> {
    pub(super) problem: &'a Problem,
    pub(super) pool: &'a Pool,
    layout: Layout,
    way: Way,
    /// Values of the feedback numerators at the lines, if there are not too many.
    numerators: Option<Vec<Complex64>>,
}

#[derive(Debug)]
enum Way {
    AcrossFeedforward(FeedforwardAtLines),
    AcrossFeedback(Vec<LineConstants>),
}

/// Candidates `first`, `first + stride`, …, evaluated.
pub(super) struct Batch<'a> {
    pub(super) first: u64,
    pub(super) stride: u64,
    pub(super) screened: &'a Screened,
}

impl<'a> Evaluator<'a> {
    pub(super) fn new(problem: &'a Problem, pool: &'a Pool) -> Self {
        let denominators = pool.feedforward();
        let way = if denominators.len() >= MANY_DENOMINATORS {
            Way::AcrossFeedforward(FeedforwardAtLines::new(problem, denominators))
        } else {
            Way::AcrossFeedback(denominators.iter().map(|d| LineConstants::new(problem, d)).collect())
        };
        let numerators = pool.feedback().numerators();
        let numerators = (numerators.len() * problem.lines().len() <= KEPT_VALUES)
            .then(|| numerators.iter().flat_map(|n| problem.at_lines(&n.coefficients)).collect());
        Self { problem, pool, layout: Layout::new(problem), way, numerators }
    }

    /// Evaluates every candidate of a block, in batches of no particular order.
    pub(super) fn block(
        &self,
        block: usize,
        ctl: &Ctl,
        count: bool,
        mut visit: impl FnMut(Batch<'_>),
    ) -> Result<(), Stopped> {
        let table = self.pool.feedback();
        let lines = self.problem.lines().len();
        let feedforward = self.pool.feedforward().len() as u64;
        let mut screened = Screened::default();
        let mut since = 0;
        let mut report = |candidates: u64, force: bool| {
            since += candidates;
            if since < CANDIDATES_PER_CHECK && !force {
                return Ok(());
            }
            if count {
                ctl.advance(since);
            }
            since = 0;
            ctl.check()
        };
        let mut denominator = None;
        let mut inverse = Vec::new();
        let mut unit: Vec<Complex64> = Vec::with_capacity(lines);
        let mut at_lines = FeedbackAtLines::default();
        let mut batch = FeedbackBatch::new(lines, BATCH);
        let mut index = table.before(block);
        table.walk(block, ctl, |row| {
            if denominator != Some(row.denominator) {
                inverse = self.problem.reciprocal_at_lines(&table.denominators()[row.denominator].coefficients);
                denominator = Some(row.denominator);
            }
            unit.clear();
            match (row.numerator, &self.numerators) {
                (None, _) => unit.resize(lines, Complex64::new(0.0, 0.0)),
                (Some(i), Some(kept)) => {
                    unit.extend(kept[i * lines..(i + 1) * lines].iter().zip(&inverse).map(|(n, d)| n * d));
                }
                (Some(i), None) => {
                    let values = self.problem.at_lines(&table.numerators()[i].coefficients);
                    unit.extend(values.iter().zip(&inverse).map(|(n, d)| n * d));
                }
            }
            match &self.way {
                Way::AcrossFeedforward(tables) => {
                    for gain in row.gains {
                        at_lines.set(self.problem, unit.iter().map(|value| gain * value));
                        kernel::across_feedforward(&self.layout, tables, &at_lines, &mut screened);
                        visit(Batch { first: index * feedforward, stride: 1, screened: &screened });
                        index += 1;
                        report(feedforward, false)?;
                    }
                }
                Way::AcrossFeedback(_) => {
                    let mut gains = row.gains;
                    while !gains.is_empty() {
                        let (now, later) = gains.split_at(gains.len().min(batch.free()));
                        batch.push(now, &unit);
                        index += now.len() as u64;
                        if batch.free() == 0 {
                            self.flush(&mut batch, index, &mut screened, &mut visit);
                        }
                        report(feedforward * now.len() as u64, false)?;
                        gains = later;
                    }
                }
            }
            Ok(())
        })?;
        if batch.count > 0 {
            self.flush(&mut batch, index, &mut screened, &mut visit);
        }
        report(0, true)
    }

    /// Evaluates and empties a batch of feedback controllers that ends before `end`.
    fn flush(&self, batch: &mut FeedbackBatch, end: u64, screened: &mut Screened, visit: &mut impl FnMut(Batch<'_>)) {
        if let Way::AcrossFeedback(constants) = &self.way {
            let stride = constants.len() as u64;
            let first = (end - batch.count as u64) * stride;
            for (i, constants) in constants.iter().enumerate() {
                kernel::across_feedback(&self.layout, constants, batch, screened);
                visit(Batch { first: first + i as u64, stride, screened });
            }
        }
        batch.count = 0;
    }
}
