//! The walk through pairs of a cluster of feedback controllers and a block of feedforward denominators.

use super::block_lanes::{BlockLanes, LANES as BLOCK_LANES};
use super::bounds::Bounds;
use super::cluster_frame::ClusterFrame;
use super::controller_bound::{self, ControllerBounds};
use super::controller_lanes::ControllerLanes;
use super::kernel;
use super::lines::Lines;
use super::verdict::{Verdict, verdict};
use super::work::{Item, Open, Pair, Work, best};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Feedback;
use crate::identify::problem::Problem;
use crate::identify::search::screen::decide::{Found, may_reach};
use crate::identify::search::sensitivity::build::cluster::Cluster;
use crate::identify::search::sensitivity::build::clusters::Clusters;
use crate::identify::search::sensitivity::build::denominators::Tabled;
use crate::identify::search::sensitivity::build::size::CONTROLLER_LANES as LANES;
use std::sync::atomic::{AtomicU64, Ordering};

/// The block is divided where it extends more than this multiple of the cluster.
const BALANCE: f64 = 4.0;

/// Candidates that a thread keeps before it throws out those that a better incumbent has made worthless.
const KEPT: usize = 1 << 14;

/// Of a cluster's blocks, as many as there is room for at once in the list of each part.
const LARGEST_SHARE: usize = 64;

/// Pairs that a beam keeps, and members that it evaluates of each leaf.
pub(crate) const BEAM: usize = 256;
const LARGEST_SAMPLE: usize = 256;

/// Single precision is not fine enough for relaxed problems that cost less, in units of the scale squared.
const FINE: f64 = 1e-6;

/// What a walk did.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Counts {
    /// Pairs of a cluster and a block that were bounded.
    pub bounded: u64,
    /// Candidates evaluated.
    pub evaluated: u64,
}

/// One trial's search, shared by the threads.
#[derive(Debug)]
pub(crate) struct Walk<'a> {
    clusters: &'a Clusters,
    lines: Lines,
    /// An upper bound of the smallest cost, as bits: of positive numbers the order is the same.
    best: AtomicU64,
    near: f64,
    /// Costs that differ by less cannot be told apart.
    rounding: f64,
    ctl: &'a Ctl,
}

/// What bounds are computed in, in one of the precisions.
#[derive(Debug)]
struct Scratch<N> {
    frame: ClusterFrame<N>,
    blocks: BlockLanes<N>,
    bounds: Bounds<N>,
    scratch: Vec<N>,
}

impl<N: Tabled> Scratch<N> {
    fn new(clusters: &Clusters) -> Self {
        let frame = ClusterFrame::new(&clusters.feedforward);
        let blocks = BlockLanes::new(frame.lines);
        Self { frame, blocks, bounds: Bounds::default(), scratch: Vec::new() }
    }

    /// Bounds of the cluster in the frame with up to so many blocks as there are lanes.
    fn bound(&mut self, clusters: &Clusters, items: &[Item], limit: N) {
        self.blocks.fill(&clusters.feedforward, items.iter().map(|item| item.0));
        kernel::bounds(&self.frame, &self.blocks, limit, &mut self.scratch, &mut self.bounds);
    }
}

/// A thread's own memory.
#[derive(Debug)]
pub(crate) struct WorkerState {
    single_precision: Scratch<f32>,
    double_precision: Scratch<f64>,
    controllers: ControllerLanes,
    /// Of the single controllers.
    one: ControllerBounds,
    scratch: Vec<f64>,
    responses: Vec<f64>,
    pub found: Vec<Found>,
    /// The smallest bound of all that was ever found.
    pub lowest: f64,
    pub counts: Counts,
    most_found: usize,
}

impl<'a> Walk<'a> {
    pub(crate) fn new(problem: &Problem, clusters: &'a Clusters, near: f64, ctl: &'a Ctl) -> Self {
        let best = AtomicU64::new(f64::MAX.to_bits());
        Self { clusters, lines: Lines::new(problem), best, near, rounding: problem.rounding(), ctl }
    }

    pub(crate) fn worker_state(&self) -> WorkerState {
        WorkerState {
            single_precision: Scratch::new(self.clusters),
            double_precision: Scratch::new(self.clusters),
            controllers: ControllerLanes::new(&self.lines),
            one: ControllerBounds::default(),
            scratch: Vec::new(),
            responses: vec![0.0; 2 * LANES * self.lines.constants.len()],
            found: Vec::new(),
            lowest: f64::INFINITY,
            counts: Counts::default(),
            most_found: KEPT,
        }
    }

    /// An upper bound of the smallest cost.
    pub(crate) fn best(&self) -> f64 {
        f64::from_bits(self.best.load(Ordering::Relaxed))
    }

    /// What costs more than this is not looked for.
    fn limit(&self) -> f64 {
        let best = self.best();
        ((1.0 + self.near) * best).max(best + self.rounding)
    }

    /// Every denominator.
    pub(crate) fn everything(&self) -> Vec<Item> {
        let feedforward = &self.clusters.feedforward;
        feedforward.roots.iter().map(|root| (*root, feedforward.divisions[*root as usize].everything())).collect()
    }

    /// No feedback at all, with every feedforward denominator.
    pub(crate) fn without_feedback(&self, state: &mut WorkerState) {
        let Some((_, denominator)) = self.clusters.without_feedback else { return };
        // 1 + L = 1.
        let responses = [[1.0; LANES], [0.0; LANES]].concat().repeat(self.lines.constants.len());
        state.controllers.fill(&self.lines, &responses);
        let feedback = Feedback { denominator, numerator: None, gain: 0.0, gain_position: None };
        for place in 0..self.clusters.feedforward.order.len() {
            self.evaluate(state, place, 1, |_| feedback);
        }
    }

    /// One member of each cluster with each block's middle: a first incumbent.
    pub(crate) fn first(&self, clusters: &[u32], state: &mut WorkerState) -> Result<(), Stopped> {
        self.ctl.check()?;
        for eight in clusters.chunks(LANES) {
            let middles = self.middles(state, eight);
            let mut best = [(f64::INFINITY, 0_u32); LANES];
            for root in &self.clusters.feedforward.roots {
                self.bound(state, *root, 1, f64::MAX);
                for (lane, best) in best.iter_mut().enumerate().take(eight.len()) {
                    if state.one.cost[lane] < best.0 {
                        *best = (state.one.cost[lane], *root);
                    }
                }
            }
            for (middle, (_, root)) in middles.iter().zip(best) {
                self.members(state, &[*middle], self.clusters.feedforward.divisions[root as usize].middle());
            }
        }
        Ok(())
    }

    /// Fills the single lanes with the middle members of clusters.
    fn middles(&self, state: &mut WorkerState, clusters: &[u32]) -> Vec<u32> {
        let middle = |cluster: &u32| {
            let members = &self.clusters.nodes[*cluster as usize].members;
            (members.start + members.end) / 2
        };
        let middles: Vec<u32> = clusters.iter().map(middle).collect();
        self.fill(state, &middles);
        middles
    }

    fn fill(&self, state: &mut WorkerState, members: &[u32]) {
        self.clusters.responses(members, &mut state.responses);
        state.controllers.fill(&self.lines, &state.responses);
    }

    /// Bounds of the filled single controllers with a block.
    fn bound(&self, state: &mut WorkerState, block: u32, mask: u64, limit: f64) {
        let feedforward = &self.clusters.feedforward;
        let block = &feedforward.blocks[block as usize];
        controller_bound::bounds(
            &state.controllers,
            feedforward,
            block,
            mask,
            limit,
            &mut state.scratch,
            &mut state.one,
        );
    }

    /// What the relaxed problems of a cluster cost, the cheapest of them.
    pub(crate) fn promising(
        &self,
        cluster: u32,
        items: &[Item],
        state: &mut WorkerState,
    ) -> Result<Vec<(f64, u32, u32)>, Stopped> {
        const EACH: usize = 16;
        self.ctl.check()?;
        let mut seen = Vec::new();
        self.costs(&mut state.single_precision, cluster, items, &mut seen);
        if seen.len() > EACH {
            seen.select_nth_unstable_by(EACH, |a, b| a.0.total_cmp(&b.0));
            seen.truncate(EACH);
        }
        Ok(seen)
    }

    /// From these pairs to leaves with single denominators, keeping the most promising ones at every level: for an
    /// incumbent. Without one near the optimum, the walk would evaluate whatever lies between the two.
    pub(crate) fn beam(&self, mut pairs: Vec<Pair>, state: &mut WorkerState) -> Result<(), Stopped> {
        let feedforward = &self.clusters.feedforward;
        let mut fine = false;
        loop {
            let done = |(cluster, block): &(u32, u32)| {
                self.clusters.nodes[*cluster as usize].children.is_empty()
                    && feedforward.divisions[*block as usize].is_single()
            };
            if pairs.iter().all(done) {
                break;
            }
            // Pairs with the same cluster share its frame.
            pairs.sort_unstable();
            let mut seen: Vec<(f64, u32, u32)> = Vec::new();
            for same in pairs.chunk_by(|a, b| a.0 == b.0) {
                self.ctl.check()?;
                let children = &self.clusters.nodes[same[0].0 as usize].children;
                let clusters = if children.is_empty() { &[same[0].0][..] } else { children };
                let items: Vec<Item> = same
                    .iter()
                    .flat_map(|(_, block)| {
                        let children = feedforward.divisions[*block as usize].parts();
                        if children.is_empty() { vec![(*block, 0)] } else { children.iter().map(|c| (*c, 0)).collect() }
                    })
                    .collect();
                for cluster in clusters {
                    if fine {
                        self.costs(&mut state.double_precision, *cluster, &items, &mut seen);
                    } else {
                        self.costs(&mut state.single_precision, *cluster, &items, &mut seen);
                    }
                }
            }
            fine = fine || seen.iter().any(|one| one.0 < FINE);
            pairs = best(seen, BEAM);
        }
        for (cluster, block) in pairs {
            self.ctl.check()?;
            let members: Vec<u32> =
                self.clusters.nodes[cluster as usize].members.clone().take(LARGEST_SAMPLE).collect();
            let place = feedforward.divisions[block as usize].first as usize;
            members.chunks(LANES).for_each(|eight| self.members(state, eight, place));
        }
        Ok(())
    }

    /// What the relaxed problems of a cluster cost, in units of the scale squared. Without a limit nothing is proven.
    fn costs<N: Tabled>(
        &self,
        scratch: &mut Scratch<N>,
        cluster: u32,
        items: &[Item],
        seen: &mut Vec<(f64, u32, u32)>,
    ) {
        let node = &self.clusters.nodes[cluster as usize];
        let known = ClusterFrame::<N>::can_hold(node, &self.lines);
        if known {
            scratch.frame.fill(node, &self.lines, &self.clusters.feedforward);
        }
        for items in items.chunks(BLOCK_LANES) {
            if known {
                scratch.bound(self.clusters, items, N::INFINITY);
            }
            let cost = |lane: usize| if known { scratch.bounds.cost[lane].value() } else { f64::MAX };
            seen.extend(items.iter().enumerate().map(|(lane, item)| (cost(lane), cluster, item.0)));
        }
    }

    /// The rest of a cluster, depth first, most promising first.
    pub(crate) fn finish(&self, open: &Open, state: &mut WorkerState) -> Result<(), Stopped> {
        if !may_reach(open.bound, self.limit()) {
            return Ok(());
        }
        let mut next = self.open(open.cluster, &open.items, true, state)?;
        next.sort_by(|a, b| a.bound.total_cmp(&b.bound));
        for open in &next {
            self.finish(open, state)?;
        }
        Ok(())
    }

    /// The parts of a cluster with what may go with them; leaves are done with at once, if `finish`, or else returned
    /// as they are.
    pub(crate) fn open(
        &self,
        cluster: u32,
        items: &[Item],
        finish: bool,
        state: &mut WorkerState,
    ) -> Result<Vec<Open>, Stopped> {
        self.ctl.check()?;
        let node = &self.clusters.nodes[cluster as usize];
        if !ClusterFrame::<f32>::can_hold(node, &self.lines) {
            // Nothing is known of it.
            let parts = if node.children.is_empty() { &[cluster][..] } else { &node.children };
            if node.children.is_empty() && finish {
                self.scattered(node, items, state)?;
                return Ok(Vec::new());
            }
            let open = |cluster: &u32| Open { cluster: *cluster, items: items.to_vec(), bound: f64::NEG_INFINITY };
            return Ok(parts.iter().map(open).collect());
        }
        state.single_precision.frame.fill(node, &self.lines, &self.clusters.feedforward);
        if state.single_precision.frame.is_too_fine(self.limit_in_units()) {
            state.double_precision.frame.fill(node, &self.lines, &self.clusters.feedforward);
            self.open_in(|state| &mut state.double_precision, cluster, items, finish, state)
        } else {
            self.open_in(|state| &mut state.single_precision, cluster, items, finish, state)
        }
    }

    /// The limit in units of the scale squared.
    fn limit_in_units(&self) -> f64 {
        self.limit() / (self.lines.scale * self.lines.scale) * (1.0 + 4.0 * f64::EPSILON)
    }

    /// Opens the cluster that is in the frame of this precision.
    fn open_in<N: Tabled>(
        &self,
        scratch: impl Fn(&mut WorkerState) -> &mut Scratch<N>,
        cluster: u32,
        items: &[Item],
        finish: bool,
        state: &mut WorkerState,
    ) -> Result<Vec<Open>, Stopped> {
        let feedforward = &self.clusters.feedforward;
        let node = &self.clusters.nodes[cluster as usize];
        let is_leaf = node.children.is_empty();
        // Leaves are done with one denominator at a time.
        let is_done = finish && is_leaf && !node.rough;
        let parts = if is_leaf { &[cluster][..] } else { &node.children };
        let none = |cluster: &u32| {
            let items = Vec::with_capacity(items.len().min(LARGEST_SHARE));
            Open { cluster: *cluster, items, bound: f64::INFINITY }
        };
        let mut opened: Vec<Open> = parts.iter().map(none).collect();
        if !is_leaf {
            let children = node.children.iter().map(|child| &self.clusters.nodes[*child as usize]);
            scratch(state).frame.fill_parts(node, children);
        }
        // BlockLanes, and single denominators, which need fewer operations.
        let mut work = Work::default();
        items.iter().for_each(|item| work.push(self.clusters, *item));
        let mut batch = Vec::with_capacity(BLOCK_LANES);
        let mut places = Vec::new();
        while work.next(&mut batch) {
            let limit = N::above(self.limit_in_units());
            let extent = scratch(state).frame.extent;
            scratch(state).bound(self.clusters, &batch, limit);
            state.counts.bounded += batch.len() as u64;
            for (lane, &(id, mask)) in batch.iter().enumerate() {
                let Scratch { frame, bounds, .. } = scratch(state);
                if bounds.whole[lane] > limit {
                    continue;
                }
                let block = &feedforward.divisions[id as usize];
                let divide = !block.is_single() && (is_done || bounds.extent[lane].value() > BALANCE * extent);
                let divided = !is_leaf && !divide;
                let Verdict { alive, parts, least, bound } =
                    verdict(frame, bounds, lane, N::table(feedforward).offsets(id), mask, limit, divided);
                if alive == 0 {
                    continue;
                }
                if divide {
                    self.divide(id, alive, &mut work);
                } else if is_done {
                    places.push(block.first as usize);
                } else if is_leaf {
                    opened[0].add((id, alive), self.in_units_of_cost(bound));
                } else {
                    for ((open, alive), bound) in opened.iter_mut().zip(parts).zip(least) {
                        if alive != 0 {
                            open.add((id, alive), self.in_units_of_cost(bound));
                        }
                    }
                }
            }
        }
        if !places.is_empty() {
            self.leaf(state, node, &places);
        }
        opened.retain(|open| !open.items.is_empty());
        if is_leaf
            && node.rough
            && finish
            && let Some(open) = opened.pop()
        {
            self.scattered(node, &open.items, state)?;
        }
        Ok(opened)
    }

    fn in_units_of_cost<N: Tabled>(&self, bound: N) -> f64 {
        bound.value() * self.lines.scale * self.lines.scale * (1.0 - 4.0 * f64::EPSILON)
    }

    /// The members of a leaf with single denominators, by their places in the order of the blocks.
    fn leaf(&self, state: &mut WorkerState, cluster: &Cluster, places: &[usize]) {
        let members: Vec<u32> = cluster.members.clone().collect();
        for eight in members.chunks(LANES) {
            self.fill(state, eight);
            for place in places {
                self.evaluate(state, *place, eight.len(), |lane| self.clusters.feedback(eight[lane] as usize));
            }
        }
    }

    /// The members of a leaf that cannot be bounded together: eight at a time, each by itself, with ever smaller blocks
    /// of denominators.
    fn scattered(&self, cluster: &Cluster, items: &[Item], state: &mut WorkerState) -> Result<(), Stopped> {
        let feedforward = &self.clusters.feedforward;
        let members: Vec<u32> = cluster.members.clone().collect();
        for eight in members.chunks(LANES) {
            self.ctl.check()?;
            self.fill(state, eight);
            let mut work = Work::default();
            items.iter().for_each(|item| work.push(self.clusters, *item));
            while let Some((id, mask)) = work.pop() {
                let block = &feedforward.divisions[id as usize];
                if block.is_single() {
                    self.evaluate(state, block.first as usize, eight.len(), |lane| {
                        self.clusters.feedback(eight[lane] as usize)
                    });
                    continue;
                }
                self.bound(state, id, mask, self.limit());
                state.counts.bounded += eight.len() as u64;
                let any = state.one.alive[..eight.len()].iter().fold(0, |all, lane| all | lane);
                self.divide(id, any, &mut work);
            }
        }
        Ok(())
    }

    /// The parts of a block that hold one of these denominators.
    fn divide(&self, id: u32, any: u64, work: &mut Work) {
        let divisions = &self.clusters.feedforward.divisions;
        let block = &divisions[id as usize];
        for child in block.parts() {
            let part = &divisions[*child as usize];
            let mask = (any >> (part.first - block.first)) & part.everything();
            if mask != 0 {
                work.push(self.clusters, (*child, mask));
            }
        }
    }

    /// Up to eight members with one denominator.
    fn members(&self, state: &mut WorkerState, members: &[u32], place: usize) {
        self.fill(state, members);
        self.evaluate(state, place, members.len(), |lane| self.clusters.feedback(members[lane] as usize));
    }

    /// Evaluates the filled single lanes with one denominator, by its place in the order of the blocks.
    fn evaluate(&self, state: &mut WorkerState, place: usize, count: usize, feedback: impl Fn(usize) -> Feedback) {
        let feedforward = &self.clusters.feedforward;
        let limit = self.limit();
        self.bound(state, feedforward.single[place], 1, limit);
        state.counts.evaluated += count as u64;
        for lane in (0..count).filter(|lane| state.one.alive[*lane] != 0) {
            let (cost, bound) = (state.one.cost[lane], state.one.bound[lane]);
            let found = Found { cost, bound, feedback: feedback(lane), feedforward: feedforward.order[place] };
            if found.above().is_finite() {
                self.best.fetch_min(found.above().max(0.0).to_bits(), Ordering::Relaxed);
            }
            // `min` ignores a bound that is no number, which says nothing.
            state.lowest = if bound.is_nan() { f64::NEG_INFINITY } else { state.lowest.min(bound) };
            state.found.push(found);
        }
        if state.found.len() > state.most_found {
            let limit = self.limit();
            state.found.retain(|found| may_reach(found.bound, limit));
            state.most_found = (2 * state.found.len()).max(KEPT);
        }
    }
}
