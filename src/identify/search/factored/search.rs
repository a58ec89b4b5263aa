//! The exact search by branch and bound over pairs of clusters: of feedback controllers, and of feedforward
//! denominators.

use super::kernel::LARGEST_HALF;
use super::trees::FactorTrees;
use super::walk::{Walk, WorkerState};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Pool;
use crate::identify::problem::{NEAR, Problem};
use crate::identify::search::screen::decide::{BracketReporter, Harvest, decide};
use crate::identify::search::screen::optimum::{Optimum, Search};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

/// Whether the numerator of this problem is of a degree that the kernel takes.
#[must_use]
pub(crate) fn can_search(problem: &Problem) -> bool {
    problem.basis().even().len().max(problem.basis().odd().len()) <= LARGEST_HALF
}

/// Branch and bound over a pool whose [`FactorTrees`] have been made.
#[derive(Debug)]
pub struct FactoredSearch<'a> {
    /// The trees of this pool at the problem's lines.
    pub trees: &'a FactorTrees,
}

impl FactoredSearch<'_> {
    /// Every candidate that may cost at most `1 + NEAR` times as much as the best one, as far as the fast evaluation
    /// can tell.
    fn walk(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Harvest, Stopped> {
        let walk = Walk::new(problem, pool, self.trees, NEAR, ctl);
        let mut state = walk.worker_state();
        ctl.set_total(pool.size());
        walk.without_feedback(&mut state)?;
        let tasks = walk.tasks(&mut state)?;
        let reporter = BracketReporter::new(pool, ctl);
        reporter.report(&state.found, walk.best(), 0.0);
        let next = AtomicUsize::new(0);
        // The smallest bound of a candidate that was found; what was passed over costs more than the best one.
        let lowest =
            AtomicU64::new(state.found.iter().map(|f| f.bound).fold(f64::INFINITY, f64::min).max(0.0).to_bits());
        let finished: Vec<AtomicBool> = tasks.iter().map(|_| AtomicBool::new(false)).collect();
        let share = pool.size() / tasks.len().max(1) as u64;
        let threads = rayon::current_num_threads();
        // Threads take the tasks in order, so that a good candidate is known early.
        let states = (0..threads)
            .into_par_iter()
            .with_max_len(1)
            .map(|_| {
                let mut state = walk.worker_state();
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let Some(task) = tasks.get(at) else { break };
                    walk.finish(task, &mut state)?;
                    // Of what is found before the task counts as finished, the bounds are known.
                    let state_lowest = state.found.iter().map(|f| f.bound).fold(f64::INFINITY, f64::min);
                    lowest.fetch_min(state_lowest.max(0.0).to_bits(), Ordering::SeqCst);
                    finished[at].store(true, Ordering::SeqCst);
                    let open = tasks.iter().zip(&finished).filter(|(_, done)| !done.load(Ordering::SeqCst));
                    let open = open.map(|(task, _)| task.bound).fold(walk.best(), f64::min);
                    let bound = open.min(f64::from_bits(lowest.load(Ordering::SeqCst)));
                    reporter.report(&state.found, walk.best(), bound);
                    ctl.advance(share);
                }
                Ok(state)
            })
            .collect::<Result<Vec<WorkerState>, Stopped>>()?;
        let mut found = state.found;
        let (mut evaluated, mut bounded) = (state.counts.evaluated, state.counts.bounded);
        for state in states {
            found.extend(state.found);
            evaluated += state.counts.evaluated;
            bounded += state.counts.bounded;
        }
        ctl.advance(pool.size());
        let without_feedback = self.trees.without_feedback.map_or(1, |(count, _)| count);
        Ok(Harvest { found, best: walk.best(), evaluated, bounded, without_feedback })
    }
}

impl Search for FactoredSearch<'_> {
    fn search(&self, problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Optimum, Stopped> {
        decide(problem, pool, self.walk(problem, pool, ctl)?, ctl)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Continuous, System, TransferFunction};
    use crate::identify::pool::{Degrees, PoolSpec, Position};
    use crate::identify::problem::Lines as Measured;
    use crate::identify::search::factored::feedback_lanes::{FeedbackCluster, FeedbackLanes};
    use crate::identify::search::factored::kernel;
    use crate::identify::search::factored::lines::{Denominators, Lines};
    use crate::identify::search::screen::decide::may_reach;
    use crate::identify::search::screen::exact;
    use crate::num::{Complex64, rng};
    use rand::RngExt;

    /// A thinned pool of appendix B or C with a response that no candidate fits.
    fn case(sampled: bool, noise: f64) -> (Problem, Pool) {
        let (name, plant) = if sampled {
            ("zhang2015_appendix_c", ([-2.0, 4.4], [1.0, 3.6, 4.0]))
        } else {
            ("zhang2015_appendix_b", ([2.0, 4.4], [1.0, 1.6, 4.0]))
        };
        let spec: PoolSpec = serde_json::from_value(serde_json::json!({
            "name": name, "thin": {"poles": 12, "zeros": 12, "damping": 4, "gains": 4}
        }))
        .unwrap();
        let recipe = spec.check(Degrees::default()).unwrap();
        let plant = TransferFunction::new(&plant.0, &plant.1, Continuous).unwrap();
        let plant = crate::identify::ssid::plant_for(&recipe, &System::Continuous(plant), Some(0.02)).unwrap();
        let pool = recipe.build(&plant, &Ctl::new()).unwrap();
        let omega: Vec<f64> = (0..13).map(|k| std::f64::consts::TAU * (0.05 + 0.03 * f64::from(k))).collect();
        let mut rng = rng::stream(5, "response");
        let h: Vec<Complex64> = omega
            .iter()
            .map(|w| {
                let mut draw = || noise * (2.0 * rng.random::<f64>() - 1.0);
                0.9 / (1.0 + Complex64::new(0.0, 0.4 * w)) + Complex64::new(draw(), draw())
            })
            .collect();
        let lines = Measured::new(&plant, &omega, &h, None);
        (Problem::new(&lines, recipe.feedforward_numerator_degree).unwrap(), pool)
    }

    #[test]
    fn no_member_costs_less_than_the_bound_of_its_clusters() {
        let mut rng = rng::stream(17, "clusters");
        let (mut tight, mut checked) = (0, 0);
        for (sampled, noise) in [(false, 0.01), (false, 0.3), (true, 0.05)] {
            let (problem, pool) = case(sampled, noise);
            let ctl = Ctl::new();
            let trees = FactorTrees::new(&problem, &pool, &ctl).unwrap();
            let lines = Lines::new(&problem);
            let mut feedback_lanes = FeedbackLanes::new(&lines);
            let (p_tree, z_tree) = (&trees.denominators.tree, &trees.numerators.tree);
            let f_tree = &trees.feedforward.tree;
            for _ in 0..400 {
                let p = &p_tree.nodes[rng.random_range(0..p_tree.nodes.len())];
                let z = &z_tree.nodes[rng.random_range(0..z_tree.nodes.len())];
                let f = &f_tree.nodes[rng.random_range(0..f_tree.nodes.len())];
                // Members of the clusters, and the range of gains around one of them.
                let mut members = Vec::new();
                for i in p.members.clone().take(6) {
                    for j in z.members.clone().take(6) {
                        let (denominator, numerator) = (p_tree.order[i], z_tree.order[j]);
                        let scale = trees.denominators.scales[denominator] * trees.numerators.scales[numerator];
                        for negative in [false, true] {
                            let opened = pool.feedback().open(denominator);
                            opened.visit(numerator, negative, [0.0, f64::INFINITY], |feedback| {
                                members.push((feedback, (feedback.gain.abs() * scale).ln()));
                            });
                        }
                    }
                }
                if members.is_empty() {
                    continue;
                }
                let (first, log) = members[rng.random_range(0..members.len())];
                let half = 0.3 * rng.random::<f64>();
                let negative = first.gain < 0.0;
                let range = trees.ranges.of(
                    p_tree.nodes.iter().position(|n| std::ptr::eq(n, p)).unwrap(),
                    z_tree.nodes.iter().position(|n| std::ptr::eq(n, z)).unwrap(),
                    negative,
                );
                assert!(range[0] <= log && log < range[1], "{log} outside {range:?}");
                let gain = if negative { -log.exp() } else { log.exp() };
                let cluster = FeedbackCluster {
                    denominator: &p.centre,
                    numerator: &z.centre,
                    gain,
                    half,
                    clusters: Some([p, z]),
                };
                feedback_lanes.fill(&lines, std::iter::once(cluster));
                let limit = 10f64.powf(-4.0 + 5.0 * rng.random::<f64>());
                let denominators = Denominators::new(&lines, f);
                let bounds = kernel::bounds(&lines, &feedback_lanes, &denominators, limit, &mut Vec::new());
                let mut smallest = f64::INFINITY;
                for (feedback, at) in &members {
                    if (feedback.gain < 0.0) != negative || (at - log).abs() > half {
                        continue;
                    }
                    for i in f.members.clone().take(6) {
                        let position = Position { feedforward: f_tree.order[i], feedback: *feedback };
                        let cost = exact::cost(&problem, &pool.candidate(position));
                        smallest = smallest.min(cost);
                        assert!(
                            may_reach(bounds.bound[0], cost),
                            "sampled {sampled}: bound {} above the cost {cost} of {position:?}, half {half}, \
                             {} denominators, {} numerators, {} feedforward",
                            bounds.bound[0],
                            p.members.len(),
                            z.members.len(),
                            f.members.len()
                        );
                        checked += 1;
                    }
                }
                tight += usize::from(bounds.bound[0] > 0.5 * smallest.min(limit));
            }
        }
        assert!(checked > 5_000 && tight > 100, "{checked} checked, {tight} tight");
    }
}
