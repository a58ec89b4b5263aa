//! The exact search for pools whose feedback controllers can be listed: branch and bound over clusters of like
//! sensitivities, with every feedforward denominator by itself. `kernel.rs` derives the bound.

use super::bound::bounds::LARGEST_HALF;
use super::bound::walk::{self, Walk, WorkerState};
use super::bound::work::{Open, Pair, best};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Pool;
use crate::identify::problem::{NEAR, Problem};
use crate::identify::search::screen::decide::{BracketReporter, Found, Harvest, decide, may_reach};
use crate::identify::search::screen::optimum::{Optimum, Search};
use crate::identify::search::sensitivity::build::clusters::Clusters;
use crate::identify::search::sensitivity::build::size::CONTROLLER_LANES;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

/// Beams for an incumbent.
const BEAMS: usize = 8;

/// Whether the kernel takes the numerator of this problem.
#[must_use]
pub(crate) fn can_search(problem: &Problem) -> bool {
    problem.basis().even().len().max(problem.basis().odd().len()) <= LARGEST_HALF
}

/// Branch and bound over a pool whose controllers have been clustered.
#[derive(Debug)]
pub struct SensitivitySearch<'a> {
    /// The clusters of this pool at the problem's lines.
    pub clusters: &'a Clusters,
}

/// Threads take the chunks in order, each with its own memory; what comes of them is in the order of the chunks.
fn share<T: Send>(
    walk: &Walk<'_>,
    count: usize,
    of: impl Fn(usize, &mut WorkerState) -> Result<T, Stopped> + Sync,
) -> Result<(Vec<T>, Vec<WorkerState>), Stopped> {
    let next = AtomicUsize::new(0);
    let threads = (0..rayon::current_num_threads())
        .into_par_iter()
        .with_max_len(1)
        .map(|_| {
            let mut state = walk.worker_state();
            let mut made = Vec::new();
            loop {
                let at = next.fetch_add(1, Ordering::Relaxed);
                if at >= count {
                    return Ok((made, state));
                }
                made.push((at, of(at, &mut state)?));
            }
        })
        .collect::<Result<Vec<_>, Stopped>>()?;
    let (made, states): (Vec<_>, Vec<_>) = threads.into_iter().unzip();
    let mut made: Vec<(usize, T)> = made.into_iter().flatten().collect();
    made.sort_by_key(|(at, _)| *at);
    Ok((made.into_iter().map(|(_, made)| made).collect(), states))
}

impl Search for SensitivitySearch<'_> {
    fn search(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Optimum, Stopped> {
        let walk = Walk::new(problem, self.clusters, NEAR, ctl);
        ctl.set_total(pool.size());
        let mut state = walk.worker_state();
        walk.without_feedback(&mut state);
        let mut states = vec![state];
        let roots = &self.clusters.roots;
        let chunks: Vec<&[u32]> = roots.chunks(CONTROLLER_LANES).collect();
        states.extend(share(&walk, chunks.len(), |at, state| walk.first(chunks[at], state))?.1);
        let everything = walk.everything();
        let (seen, more) = share(&walk, roots.len(), |at, state| walk.promising(roots[at], &everything, state))?;
        states.extend(more);
        let pairs = best(seen.into_iter().flatten().collect(), BEAMS * walk::BEAM);
        let beams: Vec<&[Pair]> = pairs.chunks(walk::BEAM).collect();
        states.extend(share(&walk, beams.len(), |at, state| walk.beam(beams[at].to_vec(), state))?.1);
        // With an incumbent.
        let (opened, more) = share(&walk, roots.len(), |at, state| walk.open(roots[at], &everything, false, state))?;
        states.extend(more);
        let mut tasks: Vec<Open> = opened.into_iter().flatten().collect();
        // With a good incumbent the smallest bound goes first, so that the certified gap shrinks.
        tasks.sort_by(|a, b| a.bound.total_cmp(&b.bound));
        let found = |states: &[WorkerState]| states.iter().flat_map(|state| &state.found).copied().collect::<Vec<_>>();
        let reporter = BracketReporter::new(pool, ctl);
        reporter.report(&found(&states), walk.best(), 0.0);
        let lowest = states.iter().flat_map(|state| &state.found).map(|f| f.bound).fold(f64::INFINITY, f64::min);
        let lowest = AtomicU64::new(lowest.max(0.0).to_bits());
        let finished: Vec<AtomicBool> = tasks.iter().map(|_| AtomicBool::new(false)).collect();
        // The tasks lie in the order of their bounds: the first that is open has the smallest.
        let first_open = AtomicUsize::new(0);
        let part = pool.size() / tasks.len().max(1) as u64;
        let (_, more) = share(&walk, tasks.len(), |at, state| {
            walk.finish(&tasks[at], state)?;
            // Of what is found before the task counts as finished, the bounds are known.
            lowest.fetch_min(state.lowest.max(0.0).to_bits(), Ordering::SeqCst);
            finished[at].store(true, Ordering::SeqCst);
            let from = first_open.load(Ordering::SeqCst);
            let open = (from..tasks.len()).find(|at| !finished[*at].load(Ordering::SeqCst)).unwrap_or(tasks.len());
            first_open.fetch_max(open, Ordering::SeqCst);
            let open = tasks.get(open).map_or(walk.best(), |task| task.bound);
            let bound = open.min(walk.best()).min(f64::from_bits(lowest.load(Ordering::SeqCst)));
            reporter.report(&state.found, walk.best(), bound);
            ctl.advance(part);
            Ok(())
        })?;
        states.extend(more);
        ctl.advance(pool.size());
        let harvest = Harvest {
            found: found(&states),
            best: walk.best(),
            evaluated: states.iter().map(|state| state.counts.evaluated).sum(),
            bounded: states.iter().map(|state| state.counts.bounded).sum(),
            without_feedback: self.clusters.without_feedback.map_or(1, |(count, _)| count),
        };
        decide(problem, pool, unique(problem, harvest), ctl)
    }
}

/// Each candidate once: dives meet what the walk meets again.
fn unique(problem: &Problem, mut harvest: Harvest) -> Harvest {
    let limit = problem.near_limit(harvest.best);
    harvest.found.retain(|f| may_reach(f.bound, limit));
    let key = |f: &Found| (f.feedforward, f.feedback.denominator, f.feedback.numerator, f.feedback.gain_position);
    harvest.found.sort_by_key(key);
    harvest.found.dedup_by_key(|f| key(f));
    harvest
}
