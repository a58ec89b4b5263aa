//! What the bounds say against what members cost, by QR.

use super::block_lanes::{BlockLanes, LANES};
use super::bounds::Bounds;
use super::cluster_frame::ClusterFrame;
use super::kernel::bounds;
use super::lines::Lines;
use super::verdict::verdict;
use crate::control::{Continuous, System, TransferFunction};
use crate::ctl::Ctl;
use crate::identify::pool::{Degrees, Pool, PoolSpec, Position};
use crate::identify::problem::{Lines as Measured, Problem};
use crate::identify::search::screen::exact;
use crate::identify::search::sensitivity::build::cluster::Cluster;
use crate::identify::search::sensitivity::build::clusters::Clusters;
use crate::identify::search::sensitivity::build::denominators::{Denominators, Tabled};
use crate::identify::search::sensitivity::build::size::ALL;
use crate::num::{Complex64, rng};
use rand::RngExt;
use serde_json::json;

/// A thinned pool of appendix B with a response that no candidate fits, in clusters of three at most.
fn case(degree: usize, noise: f64, lines: u32) -> (Problem, Pool, Clusters) {
    let spec = json!({"name": "zhang2015_appendix_b", "thin": {"poles": 9, "zeros": 9, "damping": 4, "gains": 6}});
    let recipe = serde_json::from_value::<PoolSpec>(spec).unwrap().check(Degrees::default()).unwrap();
    let plant = System::Continuous(TransferFunction::new(&[2.0, 4.4], &[1.0, 3.6, 4.0], Continuous).unwrap());
    let pool = recipe.build(&plant, &Ctl::new()).unwrap();
    let omega: Vec<f64> = (0..lines).map(|k| std::f64::consts::TAU * (0.1 + 0.025 * f64::from(k))).collect();
    let mut rng = rng::stream(29, "response");
    let mut draw = || noise * (2.0 * rng.random::<f64>() - 1.0);
    let h: Vec<Complex64> =
        omega.iter().map(|w| Complex64::from_polar(0.9, -0.1 * w) + Complex64::new(draw(), draw())).collect();
    let problem = Problem::new(&Measured::new(&plant, &omega, &h, None), degree).unwrap();
    let clusters = Clusters::with_leaves(&problem, &pool, 3, &Ctl::new()).unwrap().unwrap();
    (problem, pool, clusters)
}

/// What each member costs with each denominator, by its place.
fn costs(problem: &Problem, pool: &Pool, clusters: &Clusters) -> Vec<Vec<f64>> {
    let members = clusters.nodes.iter().map(|node| node.members.end).max().unwrap() as usize;
    let cost = |member: usize, denominator: u32| {
        let position = Position { feedforward: denominator as usize, feedback: clusters.feedback(member) };
        exact::cost(problem, &pool.candidate(position))
    };
    (0..members).map(|member| clusters.feedforward.order.iter().map(|d| cost(member, *d)).collect()).collect()
}

/// How many candidates were called dearer than the limit by their block's bound, by their own, and as members of a
/// part; all are.
fn check<N: Tabled>(problem: &Problem, clusters: &Clusters, costs: &[Vec<f64>], limit: f64) -> [usize; 3] {
    let lines = Lines::new(problem);
    let feedforward: &Denominators = &clusters.feedforward;
    let mut frame = ClusterFrame::<N>::new(feedforward);
    let (mut blocks, mut out, mut scratch) = (BlockLanes::<N>::new(frame.lines), Bounds::default(), Vec::new());
    let narrow = N::above(limit / (lines.scale * lines.scale) * (1.0 + 4.0 * f64::EPSILON));
    let mut dead = [0; 3];
    let ids: Vec<u32> = (0..feedforward.blocks.len() as u32).collect();
    for node in clusters.nodes.iter().filter(|node| ClusterFrame::<N>::can_hold(node, &lines)) {
        frame.fill(node, &lines, feedforward);
        let parts: Vec<_> = node.children.iter().map(|child| &clusters.nodes[*child as usize]).collect();
        if !parts.is_empty() {
            frame.fill_parts(node, parts.iter().copied());
        }
        for ids in ids.chunks(LANES) {
            blocks.fill(feedforward, ids.iter().copied());
            bounds(&frame, &blocks, narrow, &mut scratch, &mut out);
            for (lane, id) in ids.iter().enumerate() {
                let division = &feedforward.divisions[*id as usize];
                let (first, mask) = (division.first as usize, division.everything());
                let offsets = N::table(feedforward).offsets(*id);
                let [whole, divided] =
                    [false, true].map(|divided| verdict(&frame, &out, lane, offsets, mask, narrow, divided));
                let mut refuse = |members: &std::ops::Range<u32>, j: usize, by: usize| {
                    for member in members.clone() {
                        let cost = costs[member as usize][first + j];
                        assert!(cost > limit * (1.0 - 1e-12), "{cost} {limit} {by} {node:?}");
                        dead[by] += 1;
                    }
                };
                for j in 0..mask.count_ones() as usize {
                    if out.whole[lane] > narrow {
                        refuse(&node.members, j, 0);
                    }
                    if whole.alive & (1 << j) == 0 {
                        refuse(&node.members, j, 1);
                    }
                    for (part, alive) in parts.iter().zip(divided.parts) {
                        if alive & (1 << j) == 0 {
                            refuse(&part.members, j, 2);
                        }
                    }
                }
            }
        }
    }
    dead
}

#[test]
fn nothing_is_refused_that_costs_less_than_the_limit() {
    let mut refused = [0; 3];
    for (degree, noise, lines) in [(4, 0.3, 13), (4, 0.02, 13), (3, 0.1, 40), (1, 0.1, 13)] {
        let (problem, pool, clusters) = case(degree, noise, lines);
        let costs = costs(&problem, &pool, &clusters);
        let mut sorted: Vec<f64> = costs.iter().flatten().copied().collect();
        sorted.sort_by(f64::total_cmp);
        for share in [0.0, 0.05, 0.4] {
            let limit = 1.01 * sorted[(share * sorted.len() as f64) as usize];
            let single = check::<f32>(&problem, &clusters, &costs, limit);
            let double = check::<f64>(&problem, &clusters, &costs, limit);
            // In single precision nearly as much is refused.
            for (i, (single, double)) in single.into_iter().zip(double).enumerate() {
                assert!(single as f64 > 0.9 * double as f64 - 100.0, "{degree} {noise} {share}: {single} {double}");
                refused[i] += double;
            }
        }
    }
    // More by their own bounds than by those of blocks; leaves have no parts.
    assert!(refused[0] > 1_000_000 && refused[1] > refused[0] && refused[2] > 1_000_000, "{refused:?}");
}

#[test]
fn ranges_of_parts_are_rounded_outwards() {
    let (_, _, clusters) = case(4, 0.1, 13);
    let mut seen = 0;
    for node in &clusters.nodes {
        for child in &node.children {
            for m in 0..ALL {
                let ([low, high], [from, to]) = (clusters.nodes[*child as usize].range_within(node, m), node.range(m));
                assert!(from <= low && low <= high && high <= to, "{from} {low} {high} {to}");
                seen += usize::from(high - low < 0.9 * (to - from));
            }
        }
    }
    assert!(seen > 100, "{seen}");
    let mut part = Cluster::clone(&clusters.nodes[0]);
    let whole = &clusters.nodes[0];
    let mut rng = rng::stream(31, "ranges");
    for _ in 0..2000 {
        let ranges = std::array::from_fn(|m| {
            let [from, to] = whole.range(m);
            let (a, b) = (from + (to - from) * rng.random::<f64>(), from + (to - from) * rng.random::<f64>());
            [a.min(b), a.max(b)]
        });
        part.set_within(whole, &ranges);
        for (m, [low, high]) in ranges.into_iter().enumerate() {
            let [below, above] = part.range_within(whole, m);
            let step = (whole.range(m)[1] - whole.range(m)[0]) / 255.0;
            assert!(below <= low && high <= above && low - below <= 1.01 * step && above - high <= 1.01 * step);
        }
    }
}
