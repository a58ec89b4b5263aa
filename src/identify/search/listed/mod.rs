//! The exact search for pools whose feedback controllers can be listed: branch and bound over clusters of like sensitivities, with
//! every feedforward denominator by itself. `kernel.rs` derives the bound.

mod blocks;
mod cell;
mod cells;
mod denominators;
mod deviations;
mod extent;
mod frame;
mod grower;
mod kept;
mod kernel;
mod lines;
mod principal;
#[cfg(test)]
mod proofs;
mod real;
mod sample;
mod single;
mod singles;
mod verdict;
mod walk;
mod wide;
mod work;

use super::decide::{Harvest, Teller, decide};
use super::{NEAR, Optimum, Search};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Pool;
use crate::identify::problem::Problem;
pub use cells::{Cells, can_list};
pub(super) use kept::parameters;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use walk::{Own, Walk};
use work::{Open, Pair, best};

/// Leading directions of a cluster, to which y adapts.
const DIRECTIONS: usize = 6;

/// Faint ones after them, along which the bound only takes the worst.
const FAINT: usize = 6;
const ALL: usize = DIRECTIONS + FAINT;

/// The most parts that a cluster is divided into.
const PARTS: usize = 8;

/// Beams for an incumbent.
const BEAMS: usize = 8;

/// Whether the kernel takes the numerator of this problem.
#[must_use]
pub fn can_search(problem: &Problem) -> bool {
    problem.basis().even().len().max(problem.basis().odd().len()) <= kernel::LARGEST_HALF
}

/// Branch and bound over a pool whose controllers have been clustered.
#[derive(Debug)]
pub struct Listed<'a> {
    /// The clusters of this pool at the problem's lines.
    pub cells: &'a Cells,
}

/// What a unit of magnitude may lose by rounding in double precision, before the condition.
fn rounding(lines: &lines::Lines) -> f64 {
    32.0 * (2 * lines.constants.len() + 32) as f64 * f64::EPSILON
}

/// Threads take the chunks in order, each with its own memory; what comes of them is in the order of the chunks.
fn share<T: Send>(
    walk: &Walk<'_>,
    count: usize,
    of: impl Fn(usize, &mut Own) -> Result<T, Stopped> + Sync,
) -> Result<(Vec<T>, Vec<Own>), Stopped> {
    let next = AtomicUsize::new(0);
    let threads = (0..rayon::current_num_threads())
        .into_par_iter()
        .with_max_len(1)
        .map(|_| {
            let mut own = walk.own();
            let mut made = Vec::new();
            loop {
                let at = next.fetch_add(1, Ordering::Relaxed);
                if at >= count {
                    return Ok((made, own));
                }
                made.push((at, of(at, &mut own)?));
            }
        })
        .collect::<Result<Vec<_>, Stopped>>()?;
    let (made, owns): (Vec<_>, Vec<_>) = threads.into_iter().unzip();
    let mut made: Vec<(usize, T)> = made.into_iter().flatten().collect();
    made.sort_by_key(|(at, _)| *at);
    Ok((made.into_iter().map(|(_, made)| made).collect(), owns))
}

impl Search for Listed<'_> {
    fn search(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Optimum, Stopped> {
        let walk = Walk::new(problem, self.cells, NEAR, ctl);
        ctl.set_total(pool.size());
        let mut own = walk.own();
        walk.without_feedback(&mut own);
        let mut owns = vec![own];
        let roots = &self.cells.roots;
        let chunks: Vec<&[u32]> = roots.chunks(singles::LANES).collect();
        owns.extend(share(&walk, chunks.len(), |at, own| walk.first(chunks[at], own))?.1);
        let everything = walk.everything();
        let (seen, more) = share(&walk, roots.len(), |at, own| walk.promising(roots[at], &everything, own))?;
        owns.extend(more);
        let pairs = best(seen.into_iter().flatten().collect(), BEAMS * walk::BEAM);
        let beams: Vec<&[Pair]> = pairs.chunks(walk::BEAM).collect();
        owns.extend(share(&walk, beams.len(), |at, own| walk.beam(beams[at].to_vec(), own))?.1);
        // With an incumbent.
        let (opened, more) = share(&walk, roots.len(), |at, own| walk.open(roots[at], &everything, false, own))?;
        owns.extend(more);
        let mut tasks: Vec<Open> = opened.into_iter().flatten().collect();
        // With a good incumbent the smallest bound goes first, so that the certified gap shrinks.
        tasks.sort_by(|a, b| a.bound.total_cmp(&b.bound));
        let found = |owns: &[Own]| owns.iter().flat_map(|own| &own.found).copied().collect::<Vec<_>>();
        let teller = Teller::new(pool, ctl);
        teller.tell(&found(&owns), walk.best(), 0.0);
        let lowest = owns.iter().flat_map(|own| &own.found).map(|f| f.bound).fold(f64::INFINITY, f64::min);
        let lowest = AtomicU64::new(lowest.max(0.0).to_bits());
        let finished: Vec<AtomicBool> = tasks.iter().map(|_| AtomicBool::new(false)).collect();
        // The tasks lie in the order of their bounds: the first that is open has the smallest.
        let first_open = AtomicUsize::new(0);
        let part = pool.size() / tasks.len().max(1) as u64;
        let (_, more) = share(&walk, tasks.len(), |at, own| {
            walk.finish(&tasks[at], own)?;
            // Of what is found before the task counts as finished, the bounds are known.
            lowest.fetch_min(own.lowest.max(0.0).to_bits(), Ordering::SeqCst);
            finished[at].store(true, Ordering::SeqCst);
            let from = first_open.load(Ordering::SeqCst);
            let open = (from..tasks.len()).find(|at| !finished[*at].load(Ordering::SeqCst)).unwrap_or(tasks.len());
            first_open.fetch_max(open, Ordering::SeqCst);
            let open = tasks.get(open).map_or(walk.best(), |task| task.bound);
            let bound = open.min(walk.best()).min(f64::from_bits(lowest.load(Ordering::SeqCst)));
            teller.tell(&own.found, walk.best(), bound);
            ctl.advance(part);
            Ok(())
        })?;
        owns.extend(more);
        ctl.advance(pool.size());
        let harvest = Harvest {
            found: found(&owns),
            best: walk.best(),
            evaluated: owns.iter().map(|own| own.counts.evaluated).sum(),
            bounded: owns.iter().map(|own| own.counts.bounded).sum(),
            without_feedback: self.cells.without_feedback.map_or(1, |(count, _)| count),
        };
        decide(problem, pool, unique(harvest), ctl)
    }
}

/// Each candidate once: dives meet what the walk meets again.
fn unique(mut harvest: Harvest) -> Harvest {
    let limit = (1.0 + NEAR) * harvest.best;
    harvest.found.retain(|f| super::decide::may_reach(f.bound, limit));
    let key = |f: &super::decide::Found| {
        (f.feedforward, f.feedback.denominator, f.feedback.numerator, f.feedback.gain_position)
    };
    harvest.found.sort_by_key(key);
    harvest.found.dedup_by_key(|f| key(f));
    harvest
}
