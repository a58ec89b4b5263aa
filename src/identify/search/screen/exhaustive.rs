//! The plain search: every candidate is evaluated.

use super::block::{Batch, Evaluator};
use super::exact;
use super::near::{Bracketed, nearest, prune};
use super::optimum::{Method, Optimum, Search};
use crate::ctl::{Bracket, Ctl, Stopped};
use crate::identify::pool::Pool;
use crate::identify::problem::Problem;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicU64, Ordering};

/// Evaluates every candidate by normal equations, then decides among those that rounding cannot tell apart by QR.
///
/// 1. Each block of the pool is screened: smallest approximate cost with its index, smallest lower bound.
/// 2. The best candidate of the screening, by QR, is an upper bound of the smallest cost. Blocks with a smaller lower
///    bound are gone through again, and every candidate whose own bound is below is decided by QR.
/// 3. Blocks with a lower bound within the share [`NEAR`](crate::identify::problem::NEAR) are gone through again to
///    count the near-optimal candidates.
///
/// None of the steps depends on which thread does what.
#[derive(Debug, Clone, Copy, Default)]
pub struct Exhaustive;

/// What the screening found in a block.
#[derive(Debug, Clone, Copy)]
struct Best {
    cost: f64,
    index: u64,
    bound: f64,
    /// What that candidate costs at most, rounding allowed for.
    above: f64,
}

impl Search for Exhaustive {
    fn search(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Optimum, Stopped> {
        ctl.set_total(pool.size());
        let evaluator = Evaluator::new(problem, pool);
        let blocks = pool.feedback().blocks();
        let screened = (0..blocks)
            .into_par_iter()
            .map(|block| screen(&evaluator, block, ctl))
            .collect::<Result<Vec<_>, Stopped>>()?;

        let bound = screened.iter().map(|best| best.bound).fold(f64::INFINITY, f64::min);

        let exact_cost = |index: u64| exact::cost(problem, &pool.candidate(pool.position(index)));
        let first = screened
            .iter()
            .filter(|best| best.cost < f64::INFINITY)
            .min_by(|a, b| a.cost.total_cmp(&b.cost).then(a.index.cmp(&b.index)))
            .map_or(0, |best| best.index);
        let limit = exact_cost(first);
        ctl.set_bracket(Bracket { incumbent: limit, bound, index: first });
        let decided = AtomicU64::new(0);

        // The candidates whose bound is within the limit hold the best one, whatever their approximate costs say.
        let again = |limit: f64| -> Vec<usize> { (0..blocks).filter(|b| screened[*b].bound <= limit).collect() };
        let (cost, index) = again(limit)
            .into_par_iter()
            .map(|block| {
                let mut best = (f64::INFINITY, u64::MAX);
                each(&evaluator, block, ctl, |index, _, bound| {
                    if bound <= limit {
                        decided.fetch_add(1, Ordering::Relaxed);
                        best = smaller(best, (exact_cost(index), index));
                    }
                })?;
                Ok(best)
            })
            .try_reduce(|| (f64::INFINITY, u64::MAX), |a, b| Ok(smaller(a, b)))?;

        let near = problem.near_limit(cost);
        let feedforward = pool.feedforward().len() as u64;
        let is_without_feedback = |index: u64| pool.position(index).feedback.numerator.is_none();
        let (near_optimal, found) = again(near)
            .into_par_iter()
            .map(|block| {
                let mut count = 0;
                let mut found = Alike::default();
                each(&evaluator, block, ctl, |index, approximate, bound| {
                    // The approximate cost errs by as much upwards as the bound is below it.
                    let surely = 2.0 * approximate - bound <= near;
                    count += u64::from(surely || (bound <= near && exact_cost(index) <= near));
                    if bound <= near {
                        let alike = (index % feedforward, approximate.to_bits(), bound.to_bits());
                        found.take(alike, index, is_without_feedback);
                        found.prune();
                    }
                })?;
                Ok((count, found))
            })
            .try_reduce(
                || (0, Alike::default()),
                |(a, mut found): (u64, Alike), (b, others)| {
                    for (alike, index) in others.each() {
                        found.take(alike, index, is_without_feedback);
                    }
                    Ok((a + b, found))
                },
            )?;
        let candidate = |place: &(AlikeKey, u64)| pool.candidate(pool.position(place.1));
        let nearest = nearest(problem, found.bracketed(), near, candidate, |place| place.1, ctl)?;

        Ok(Optimum {
            index,
            cost,
            method: Method::Exhaustive,
            evaluated: pool.size(),
            bounded: 0,
            decided_by_qr: decided.into_inner(),
            near_optimal,
            near: nearest,
            near_is_cut: false,
        })
    }
}

/// Feedforward denominator, and the bits of cost and bound.
type AlikeKey = (u64, u64, u64);

/// Near-optimal candidates that a block keeps before it throws out those that cannot be among the best.
const KEPT: usize = 1 << 14;

/// Candidates that are alike to the last bit: of copies without feedback the lowest index, of others (a zero may cancel
/// a pole) each.
#[derive(Debug)]
enum Indices {
    One(u64),
    WithoutFeedback(u64),
    Different(Vec<u64>),
}

/// Near-optimal candidates.
#[derive(Debug, Default)]
struct Alike(HashMap<AlikeKey, Indices>);

impl Alike {
    fn take(&mut self, alike: AlikeKey, index: u64, is_without_feedback: impl Fn(u64) -> bool) {
        let Some(indices) = self.0.get_mut(&alike) else {
            self.0.insert(alike, Indices::One(index));
            return;
        };
        match indices {
            // What costs the same to the last bit as one without feedback is another copy of it.
            Indices::One(first) if is_without_feedback(*first) => {
                *indices = Indices::WithoutFeedback(index.min(*first));
            }
            Indices::One(first) => *indices = Indices::Different(vec![*first, index]),
            Indices::WithoutFeedback(first) => *first = index.min(*first),
            Indices::Different(all) => all.push(index),
        }
    }

    /// Each candidate that is kept.
    fn each(self) -> impl Iterator<Item = (AlikeKey, u64)> {
        self.0.into_iter().flat_map(|(alike, indices)| {
            let all = match indices {
                Indices::One(index) | Indices::WithoutFeedback(index) => vec![index],
                Indices::Different(all) => all,
            };
            all.into_iter().map(move |index| (alike, index))
        })
    }

    fn bracketed(self) -> Vec<Bracketed<(AlikeKey, u64)>> {
        let of = |(alike, index): (AlikeKey, u64)| {
            let (cost, below) = (f64::from_bits(alike.1), f64::from_bits(alike.2));
            Bracketed { below, above: 2.0 * cost - below, place: (alike, index) }
        };
        self.each().map(of).collect()
    }

    /// Without those that cannot be among the best, where there are many.
    fn prune(&mut self) {
        if self.0.len() <= KEPT {
            return;
        }
        let mut all: Vec<Bracketed<AlikeKey>> = Vec::with_capacity(self.0.len());
        for (alike, indices) in &self.0 {
            let (cost, below) = (f64::from_bits(alike.1), f64::from_bits(alike.2));
            let count = if let Indices::Different(all) = indices { all.len() } else { 1 };
            all.extend((0..count).map(|_| Bracketed { below, above: 2.0 * cost - below, place: *alike }));
        }
        prune(&mut all);
        let kept: HashSet<AlikeKey> = all.into_iter().map(|one| one.place).collect();
        self.0.retain(|alike, _| kept.contains(alike));
    }
}

/// The smaller of two (cost, index) pairs, which are never NaN.
fn smaller(a: (f64, u64), b: (f64, u64)) -> (f64, u64) {
    if b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)).is_lt() { b } else { a }
}

fn screen(evaluator: &Evaluator<'_>, block: usize, ctl: &Ctl) -> Result<Best, Stopped> {
    let mut best = Best { cost: f64::INFINITY, index: u64::MAX, bound: f64::INFINITY, above: f64::INFINITY };
    evaluator.block(block, ctl, true, |Batch { first, stride, screened }| {
        // Folds without branches, so that they are vectorised; the position is looked for only where the cost improves.
        let cost = screened.cost.iter().fold(f64::INFINITY, |a, b| if *b < a { *b } else { a });
        let bound = screened.bound.iter().fold(f64::INFINITY, |a, b| if *b < a { *b } else { a });
        best.bound = best.bound.min(bound);
        if cost <= best.cost && cost < f64::INFINITY {
            let position = screened.cost.iter().position(|c| *c == cost).unwrap_or(0);
            let index = first + stride * position as u64;
            if cost < best.cost || index < best.index {
                best.cost = cost;
                best.index = index;
                best.above = 2.0 * cost - screened.bound[position];
            }
        }
    })?;
    ctl.set_bracket(Bracket { incumbent: best.above, bound: 0.0, index: best.index });
    Ok(best)
}

/// Visits index, approximate cost and bound of every candidate of a block.
fn each(
    evaluator: &Evaluator<'_>,
    block: usize,
    ctl: &Ctl,
    mut visit: impl FnMut(u64, f64, f64),
) -> Result<(), Stopped> {
    evaluator.block(block, ctl, false, |Batch { first, stride, screened }| {
        for (i, (cost, bound)) in screened.cost.iter().zip(&screened.bound).enumerate() {
            visit(first + stride * i as u64, *cost, *bound);
        }
    })
}
