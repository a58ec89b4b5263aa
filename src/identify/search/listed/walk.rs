//! The walk through pairs of a cluster of feedback controllers and a block of feedforward denominators.

use super::super::decide::Found;
use super::cell::Cell;
use super::cells::Cells;
use super::group::{Group, LANES};
use super::kernel::{self, Bounds};
use super::lines::Lines;
use crate::identify::pool::Feedback;
use crate::identify::problem::Problem;
use crate::num::{Ctl, Stopped};
use std::sync::atomic::{AtomicU64, Ordering};

/// The block is divided where it extends more than this multiple of the cluster.
const BALANCE: f64 = 1.0;

/// Candidates that a thread keeps before it throws out those that a better incumbent has made worthless.
const KEPT: usize = 1 << 14;

/// Pairs that a beam keeps, and members that it evaluates of each leaf.
const BEAM: usize = 256;
const LARGEST_SAMPLE: usize = 256;

/// A block of denominators, and which of them may still have a good partner.
pub(super) type Item = (u32, u64);

/// A cluster with the denominators that may go with it.
#[derive(Debug)]
pub(super) struct Open {
    pub cell: u32,
    pub items: Vec<Item>,
    /// The smallest cost of a relaxed problem, and the smallest bound.
    pub promise: f64,
    pub bound: f64,
}

/// What a walk did.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    /// Pairs of a cluster and a block that were bounded.
    pub bounded: u64,
    /// Candidates evaluated.
    pub evaluated: u64,
}

/// One trial's search, shared by the threads.
#[derive(Debug)]
pub(super) struct Walk<'a> {
    cells: &'a Cells,
    lines: Lines,
    /// An upper bound of the smallest cost, as bits: of positive numbers the order is the same.
    best: AtomicU64,
    near: f64,
    ctl: &'a Ctl,
}

/// A thread's own memory.
#[derive(Debug)]
pub(super) struct Own {
    group: Group,
    single: Group,
    bounds: Bounds,
    /// Of the single controllers, which are evaluated while the clusters' bounds are still in use.
    one: Bounds,
    scratch: Vec<f64>,
    work: Vec<Item>,
    responses: Vec<f64>,
    pub found: Vec<Found>,
    pub counts: Counts,
    room: usize,
}

impl<'a> Walk<'a> {
    pub(super) fn new(problem: &Problem, cells: &'a Cells, near: f64, ctl: &'a Ctl) -> Self {
        Self { cells, lines: Lines::new(problem), best: AtomicU64::new(f64::MAX.to_bits()), near, ctl }
    }

    pub(super) fn own(&self) -> Own {
        Own {
            group: Group::new(&self.lines),
            single: Group::new(&self.lines),
            bounds: Bounds::default(),
            one: Bounds::default(),
            scratch: Vec::new(),
            work: Vec::new(),
            responses: vec![0.0; 2 * LANES * self.lines.constants.len()],
            found: Vec::new(),
            counts: Counts::default(),
            room: KEPT,
        }
    }

    /// An upper bound of the smallest cost.
    pub(super) fn best(&self) -> f64 {
        f64::from_bits(self.best.load(Ordering::Relaxed))
    }

    /// What costs more than this is not looked for.
    fn limit(&self) -> f64 {
        (1.0 + self.near) * self.best()
    }

    /// Every denominator.
    pub(super) fn everything(&self) -> Vec<Item> {
        let feedforward = &self.cells.feedforward;
        let all = |root: &u32| {
            let count = feedforward.blocks[*root as usize].offsets.len();
            (*root, u64::MAX >> (super::denominators::LARGEST - count))
        };
        feedforward.roots.iter().map(all).collect()
    }

    /// No feedback at all, with every feedforward denominator.
    pub(super) fn without_feedback(&self, own: &mut Own) {
        let Some((_, denominator)) = self.cells.without_feedback else { return };
        // 1 + L = 1.
        let responses = [[1.0; LANES], [0.0; LANES]].concat().repeat(self.lines.constants.len());
        own.single.fill_single(&self.lines, &responses, 1);
        let feedback = Feedback { denominator, numerator: None, gain: 0.0, gain_position: None };
        for place in 0..self.cells.feedforward.order.len() {
            self.evaluate(own, place, 1, |_| feedback);
        }
    }

    /// One member of each cluster with each block's middle: a first incumbent.
    pub(super) fn first(&self, cells: &[u32], own: &mut Own) -> Result<(), Stopped> {
        self.ctl.check()?;
        for eight in cells.chunks(LANES) {
            let middles = self.middles(own, eight);
            let mut best = [(f64::INFINITY, 0_u32); LANES];
            for root in &self.cells.feedforward.roots {
                self.bound(own, *root, 1, f64::MAX, true);
                for (lane, best) in best.iter_mut().enumerate().take(eight.len()) {
                    if own.one.cost[lane] < best.0 {
                        *best = (own.one.cost[lane], *root);
                    }
                }
            }
            for (middle, (_, root)) in middles.iter().zip(best) {
                let block = &self.cells.feedforward.blocks[root as usize];
                let place = block.first + block.offsets.len() / 2;
                self.members(own, &[*middle], place);
            }
        }
        Ok(())
    }

    /// Fills the single lanes with the middle members of clusters.
    fn middles(&self, own: &mut Own, cells: &[u32]) -> Vec<u32> {
        let middle = |cell: &u32| {
            let members = &self.cells.nodes[*cell as usize].members;
            (members.start + members.end) / 2
        };
        let middles: Vec<u32> = cells.iter().map(middle).collect();
        self.fill(own, &middles);
        middles
    }

    fn fill(&self, own: &mut Own, members: &[u32]) {
        self.cells.responses(members, &mut own.responses);
        own.single.fill_single(&self.lines, &own.responses, members.len());
    }

    fn bound(&self, own: &mut Own, block: u32, mask: u64, limit: f64, single: bool) {
        let feedforward = &self.cells.feedforward;
        let (group, out) = if single { (&own.single, &mut own.one) } else { (&own.group, &mut own.bounds) };
        let block = &feedforward.blocks[block as usize];
        kernel::bounds(group, feedforward, block, mask, limit, &mut own.scratch, out);
    }

    /// From these clusters to leaves with single denominators, keeping the most promising pairs at every level: for an incumbent. Without
    /// one near the optimum, the walk would evaluate whatever lies between the two.
    pub(super) fn beam(&self, from: &[Open], own: &mut Own) -> Result<(), Stopped> {
        let feedforward = &self.cells.feedforward;
        let mut pairs: Vec<(u32, u32)> =
            from.iter().flat_map(|open| open.items.iter().map(|item| (open.cell, item.0))).collect();
        loop {
            let done = |(cell, block): &(u32, u32)| {
                self.cells.nodes[*cell as usize].children.is_empty()
                    && feedforward.blocks[*block as usize].children.is_empty()
            };
            if pairs.iter().all(done) {
                break;
            }
            // Pairs with the same cluster share its group.
            pairs.sort_unstable();
            let mut seen: Vec<(f64, u32, u32)> = Vec::new();
            for same in pairs.chunk_by(|a, b| a.0 == b.0) {
                self.ctl.check()?;
                let children = &self.cells.nodes[same[0].0 as usize].children;
                let cells = if children.is_empty() { vec![same[0].0] } else { children.to_vec() };
                let blocks: Vec<u32> = same
                    .iter()
                    .flat_map(|(_, block)| {
                        let children = &feedforward.blocks[*block as usize].children;
                        if children.is_empty() { vec![*block] } else { children.to_vec() }
                    })
                    .collect();
                for eight in cells.chunks(LANES) {
                    own.group.fill_cells(&self.lines, eight.iter().map(|cell| &self.cells.nodes[*cell as usize]));
                    for block in &blocks {
                        // Without a limit nothing is proven: only the relaxed problem is solved.
                        self.bound(own, *block, 0, f64::MAX, false);
                        let costs = eight.iter().enumerate().map(|(lane, cell)| (own.bounds.cost[lane], *cell, *block));
                        seen.extend(costs);
                    }
                }
            }
            seen.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
            seen.truncate(BEAM);
            pairs = seen.into_iter().map(|(_, cell, block)| (cell, block)).collect();
        }
        for (cell, block) in pairs {
            self.ctl.check()?;
            let members: Vec<u32> = self.cells.nodes[cell as usize].members.clone().take(LARGEST_SAMPLE).collect();
            let place = feedforward.blocks[block as usize].first;
            members.chunks(LANES).for_each(|eight| self.members(own, eight, place));
        }
        Ok(())
    }

    /// The rest of a cluster, depth first, most promising first.
    pub(super) fn finish(&self, open: &Open, own: &mut Own) -> Result<(), Stopped> {
        if !super::super::decide::may_reach(open.bound, self.limit()) {
            return Ok(());
        }
        let node = &self.cells.nodes[open.cell as usize];
        if node.children.is_empty() && node.rough {
            return self.scattered(node, &open.items, own);
        }
        let cells = if node.children.is_empty() { vec![open.cell] } else { node.children.to_vec() };
        let mut next = self.open(&cells, &open.items, true, own)?;
        next.sort_by(|a, b| a.promise.total_cmp(&b.promise));
        for open in &next {
            self.finish(open, own)?;
        }
        Ok(())
    }

    /// These clusters with what goes with them; leaves are done with at once, if `finish`.
    pub(super) fn open(
        &self,
        cells: &[u32],
        items: &[Item],
        finish: bool,
        own: &mut Own,
    ) -> Result<Vec<Open>, Stopped> {
        let mut opened = Vec::new();
        for eight in cells.chunks(LANES) {
            self.ctl.check()?;
            self.open_eight(eight, items, finish, own, &mut opened);
        }
        Ok(opened)
    }

    fn open_eight(&self, cells: &[u32], items: &[Item], finish: bool, own: &mut Own, opened: &mut Vec<Open>) {
        let is_done = |node: &Cell| finish && node.children.is_empty() && !node.rough;
        let feedforward = &self.cells.feedforward;
        let nodes: Vec<&Cell> = cells.iter().map(|cell| &self.cells.nodes[*cell as usize]).collect();
        own.group.fill_cells(&self.lines, nodes.iter().copied());
        let mut open: Vec<Open> = cells
            .iter()
            .map(|cell| Open { cell: *cell, items: Vec::new(), promise: f64::INFINITY, bound: f64::INFINITY })
            .collect();
        let mut work = std::mem::take(&mut own.work);
        work.clear();
        work.extend_from_slice(items);
        while let Some((id, mask)) = work.pop() {
            self.bound(own, id, mask, self.limit(), false);
            own.counts.bounded += cells.len() as u64;
            let alive = own.bounds.alive;
            let any = alive[..cells.len()].iter().fold(0, |all, lane| all | lane);
            if any == 0 {
                continue;
            }
            let block = &feedforward.blocks[id as usize];
            if !block.children.is_empty() {
                let living = (0..cells.len()).filter(|lane| alive[*lane] != 0);
                let (theirs, ours) = living.fold((0.0, 0.0), |(theirs, ours), lane| {
                    (theirs + own.bounds.extent[lane], ours + own.group.extent[lane])
                });
                // Leaves are done with one denominator at a time.
                let leaves = nodes.iter().zip(alive).any(|(node, alive)| alive != 0 && is_done(node));
                if leaves || theirs > BALANCE * ours {
                    self.divide(id, any, &mut work);
                    continue;
                }
            }
            for (lane, node) in nodes.iter().enumerate() {
                if alive[lane] == 0 {
                    continue;
                }
                if is_done(node) {
                    self.leaf(own, node, id);
                } else {
                    open[lane].items.push((id, alive[lane]));
                    open[lane].promise = open[lane].promise.min(own.bounds.cost[lane]);
                    // `min` would ignore a NaN, which means that nothing is known.
                    let bound = own.bounds.bound[lane];
                    open[lane].bound = open[lane].bound.min(if bound.is_nan() { f64::NEG_INFINITY } else { bound });
                }
            }
        }
        own.work = work;
        opened.extend(open.into_iter().filter(|open| !open.items.is_empty()));
    }

    /// The members of a leaf with a single denominator.
    fn leaf(&self, own: &mut Own, cell: &Cell, block: u32) {
        let place = self.cells.feedforward.blocks[block as usize].first;
        let members: Vec<u32> = cell.members.clone().collect();
        members.chunks(LANES).for_each(|eight| self.members(own, eight, place));
    }

    /// The members of a leaf that cannot be bounded together: eight at a time, each by itself, with ever smaller blocks of denominators.
    fn scattered(&self, cell: &Cell, items: &[Item], own: &mut Own) -> Result<(), Stopped> {
        let feedforward = &self.cells.feedforward;
        let members: Vec<u32> = cell.members.clone().collect();
        let mut work = std::mem::take(&mut own.work);
        for eight in members.chunks(LANES) {
            self.ctl.check()?;
            self.fill(own, eight);
            work.clear();
            work.extend_from_slice(items);
            while let Some((id, mask)) = work.pop() {
                let block = &feedforward.blocks[id as usize];
                if block.children.is_empty() {
                    self.evaluate(own, block.first, eight.len(), |lane| self.cells.feedback(eight[lane] as usize));
                    continue;
                }
                self.bound(own, id, mask, self.limit(), true);
                own.counts.bounded += eight.len() as u64;
                let any = own.one.alive[..eight.len()].iter().fold(0, |all, lane| all | lane);
                self.divide(id, any, &mut work);
            }
        }
        own.work = work;
        Ok(())
    }

    /// The parts of a block that hold one of these denominators.
    fn divide(&self, id: u32, any: u64, work: &mut Vec<Item>) {
        let block = &self.cells.feedforward.blocks[id as usize];
        for child in &block.children {
            let part = &self.cells.feedforward.blocks[*child as usize];
            let all = u64::MAX >> (super::denominators::LARGEST - part.offsets.len());
            let mask = (any >> (part.first - block.first)) & all;
            if mask != 0 {
                work.push((*child, mask));
            }
        }
    }

    /// Up to eight members with one denominator.
    fn members(&self, own: &mut Own, members: &[u32], place: usize) {
        self.fill(own, members);
        self.evaluate(own, place, members.len(), |lane| self.cells.feedback(members[lane] as usize));
    }

    /// Evaluates the filled single lanes with one denominator, by its place in the order of the blocks.
    fn evaluate(&self, own: &mut Own, place: usize, count: usize, feedback: impl Fn(usize) -> Feedback) {
        let feedforward = &self.cells.feedforward;
        let limit = self.limit();
        self.bound(own, feedforward.single[place], 1, limit, true);
        own.counts.evaluated += count as u64;
        for lane in (0..count).filter(|lane| own.one.alive[*lane] != 0) {
            let (cost, bound) = (own.one.cost[lane], own.one.bound[lane]);
            let found = Found { cost, bound, feedback: feedback(lane), feedforward: feedforward.order[place] };
            if found.above().is_finite() {
                self.best.fetch_min(found.above().max(0.0).to_bits(), Ordering::Relaxed);
            }
            own.found.push(found);
        }
        if own.found.len() > own.room {
            let limit = self.limit();
            own.found.retain(|found| super::super::decide::may_reach(found.bound, limit));
            own.room = (2 * own.found.len()).max(KEPT);
        }
    }
}
