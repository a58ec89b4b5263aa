//! From candidates whose cost is bracketed to the answer: QR decides.

use super::exact;
use super::near::{Bracketed, nearest};
use super::optimum::{Method, Optimum};
use crate::ctl::{Bracket, Ctl, Stopped};
use crate::identify::pool::{Feedback, Pool, Position};
use crate::identify::problem::Problem;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Whether something with this lower bound may cost as little as the limit; a bound that is not a number says nothing.
pub(crate) fn may_reach(bound: f64, limit: f64) -> bool {
    bound <= limit || bound.is_nan()
}

/// A candidate that the fast evaluation cannot exclude.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Found {
    pub cost: f64,
    pub bound: f64,
    pub feedback: Feedback,
    pub feedforward: u32,
}

impl Found {
    /// What it costs at most: what rounding may hide below the cost may also be above it.
    pub(crate) fn above(&self) -> f64 {
        self.cost + (self.cost - self.bound)
    }

    fn position(&self) -> Position {
        Position { feedforward: self.feedforward as usize, feedback: self.feedback }
    }
}

/// What a search by bounds has found, and with how much work.
#[derive(Debug)]
pub(crate) struct Harvest {
    /// Everything that may cost at most `1 + NEAR` times as much as the best candidate, and perhaps more.
    pub found: Vec<Found>,
    /// An upper bound of the smallest cost.
    pub best: f64,
    pub evaluated: u64,
    pub bounded: u64,
    /// How many denominators make a stable loop without feedback: copies of one candidate, found once.
    pub without_feedback: u64,
}

/// Tells, as a search goes on, the best candidate and what every candidate of the pool costs at least.
#[derive(Debug)]
pub(crate) struct BracketReporter<'a> {
    pool: &'a Pool,
    ctl: &'a Ctl,
    /// What the best candidate costs at most, and its index, which takes a walk through a block of the pool: not for
    /// every task.
    reported: Mutex<Option<(f64, u64)>>,
}

impl<'a> BracketReporter<'a> {
    pub(crate) fn new(pool: &'a Pool, ctl: &'a Ctl) -> Self {
        Self { pool, ctl, reported: Mutex::new(None) }
    }

    /// With what a thread has found, the smallest cost that is known to any, and the bound.
    pub(crate) fn report(&self, found: &[Found], best: f64, bound: f64) {
        // A plain value: whole whenever the lock is free.
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        let before = reported.map_or(f64::INFINITY, |(above, _)| above);
        if best < before
            && let Some(best) = found.iter().min_by(|a, b| a.above().total_cmp(&b.above()))
            && best.above() < before
        {
            *reported = Some((best.above(), self.pool.index(best.feedforward as usize, best.feedback)));
        }
        if let Some((incumbent, index)) = *reported {
            self.ctl.set_bracket(Bracket { incumbent, bound, index });
        }
    }
}

/// Decides by QR among the candidates that the fast evaluation cannot tell apart.
pub(crate) fn decide(problem: &Problem, pool: &Pool, harvest: Harvest, ctl: &Ctl) -> Result<Optimum, Stopped> {
    let Harvest { mut found, best, evaluated, bounded, without_feedback } = harvest;
    let exact_cost = |found: &Found| exact::cost(problem, &pool.candidate(found.position()));
    let decided = AtomicU64::new(0);
    let close: Vec<Found> = found.iter().filter(|f| may_reach(f.bound, best)).copied().collect();
    let costs = close
        .par_iter()
        .map(|f| {
            ctl.check()?;
            decided.fetch_add(1, Ordering::Relaxed);
            Ok(exact_cost(f))
        })
        .collect::<Result<Vec<f64>, Stopped>>()?;
    let cost = costs.iter().copied().fold(f64::INFINITY, f64::min);
    let index = close
        .iter()
        .zip(&costs)
        .filter(|(_, c)| **c <= cost)
        .map(|(f, _)| pool.index(f.feedforward as usize, f.feedback))
        .min()
        .unwrap_or(0);
    let near = problem.near_limit(cost);
    found.retain(|f| may_reach(f.bound, near));
    let candidates = found.iter().map(|f| Bracketed { below: f.bound, above: f.above(), place: *f }).collect();
    let nearest = nearest(
        problem,
        candidates,
        near,
        |f| pool.candidate(f.position()),
        |f| pool.index(f.feedforward as usize, f.feedback),
        ctl,
    )?;
    let near_optimal = found
        .par_iter()
        .map(|f| {
            let surely = f.above() <= near;
            // Every stable denominator without feedback is the same candidate again.
            let copies = if f.feedback.numerator.is_none() { without_feedback } else { 1 };
            if surely || exact_cost(f) <= near { copies } else { 0 }
        })
        .sum();
    Ok(Optimum {
        index,
        cost,
        method: Method::BranchAndBound,
        evaluated,
        bounded,
        decided_by_qr: decided.into_inner(),
        near_optimal,
        near: nearest,
        near_is_cut: false,
    })
}
