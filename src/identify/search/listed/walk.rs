//! The walk through pairs of a cluster of feedback controllers and a block of feedforward denominators.

use super::super::decide::Found;
use super::blocks::{Blocks, LANES as BLOCKS};
use super::cell::Cell;
use super::cells::Cells;
use super::denominators::Kept;
use super::frame::Frame;
use super::kernel::{self, Bounds};
use super::lines::Lines;
use super::single;
use super::singles::{LANES, Singles};
use super::verdict::{Verdict, verdict};
use super::work::{Item, Open, Pair, Work, best};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Feedback;
use crate::identify::problem::Problem;
use std::sync::atomic::{AtomicU64, Ordering};

/// The block is divided where it extends more than this multiple of the cluster.
const BALANCE: f64 = 4.0;

/// Candidates that a thread keeps before it throws out those that a better incumbent has made worthless.
const KEPT: usize = 1 << 14;

/// Of a cluster's blocks, as many as there is room for at once in the list of each part.
const LARGEST_SHARE: usize = 64;

/// Pairs that a beam keeps, and members that it evaluates of each leaf.
pub(super) const BEAM: usize = 256;
const LARGEST_SAMPLE: usize = 256;

/// Single precision is not fine enough for relaxed problems that cost less, in units of the scale squared.
const FINE: f64 = 1e-6;

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

/// What bounds are computed in, in one of the precisions.
#[derive(Debug)]
struct Room<N> {
    frame: Frame<N>,
    blocks: Blocks<N>,
    bounds: Bounds<N>,
    scratch: Vec<N>,
}

impl<N: Kept> Room<N> {
    fn new(cells: &Cells) -> Self {
        let frame = Frame::new(&cells.feedforward);
        let blocks = Blocks::new(frame.lines);
        Self { frame, blocks, bounds: Bounds::default(), scratch: Vec::new() }
    }

    /// Bounds of the cluster in the frame with up to so many blocks as there are lanes.
    fn bound(&mut self, cells: &Cells, items: &[Item], limit: N) {
        self.blocks.fill(&cells.feedforward, items.iter().map(|item| item.0));
        kernel::bounds(&self.frame, &self.blocks, limit, &mut self.scratch, &mut self.bounds);
    }
}

/// A thread's own memory.
#[derive(Debug)]
pub(super) struct Own {
    single_precision: Room<f32>,
    double_precision: Room<f64>,
    singles: Singles,
    /// Of the single controllers.
    one: single::Bounds,
    scratch: Vec<f64>,
    responses: Vec<f64>,
    pub found: Vec<Found>,
    /// The smallest bound of all that was ever found.
    pub lowest: f64,
    pub counts: Counts,
    room: usize,
}

impl<'a> Walk<'a> {
    pub(super) fn new(problem: &Problem, cells: &'a Cells, near: f64, ctl: &'a Ctl) -> Self {
        Self { cells, lines: Lines::new(problem), best: AtomicU64::new(f64::MAX.to_bits()), near, ctl }
    }

    pub(super) fn own(&self) -> Own {
        Own {
            single_precision: Room::new(self.cells),
            double_precision: Room::new(self.cells),
            singles: Singles::new(&self.lines),
            one: single::Bounds::default(),
            scratch: Vec::new(),
            responses: vec![0.0; 2 * LANES * self.lines.constants.len()],
            found: Vec::new(),
            lowest: f64::INFINITY,
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
        feedforward.roots.iter().map(|root| (*root, feedforward.divisions[*root as usize].everything())).collect()
    }

    /// No feedback at all, with every feedforward denominator.
    pub(super) fn without_feedback(&self, own: &mut Own) {
        let Some((_, denominator)) = self.cells.without_feedback else { return };
        // 1 + L = 1.
        let responses = [[1.0; LANES], [0.0; LANES]].concat().repeat(self.lines.constants.len());
        own.singles.fill(&self.lines, &responses);
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
                self.bound(own, *root, 1, f64::MAX);
                for (lane, best) in best.iter_mut().enumerate().take(eight.len()) {
                    if own.one.cost[lane] < best.0 {
                        *best = (own.one.cost[lane], *root);
                    }
                }
            }
            for (middle, (_, root)) in middles.iter().zip(best) {
                self.members(own, &[*middle], self.cells.feedforward.divisions[root as usize].middle());
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
        own.singles.fill(&self.lines, &own.responses);
    }

    /// Bounds of the filled single controllers with a block.
    fn bound(&self, own: &mut Own, block: u32, mask: u64, limit: f64) {
        let feedforward = &self.cells.feedforward;
        let block = &feedforward.blocks[block as usize];
        single::bounds(&own.singles, feedforward, block, mask, limit, &mut own.scratch, &mut own.one);
    }

    /// What the relaxed problems of a cluster cost, the cheapest of them.
    pub(super) fn promising(&self, cell: u32, items: &[Item], own: &mut Own) -> Result<Vec<(f64, u32, u32)>, Stopped> {
        const EACH: usize = 16;
        self.ctl.check()?;
        let mut seen = Vec::new();
        self.costs(&mut own.single_precision, cell, items, &mut seen);
        if seen.len() > EACH {
            seen.select_nth_unstable_by(EACH, |a, b| a.0.total_cmp(&b.0));
            seen.truncate(EACH);
        }
        Ok(seen)
    }

    /// From these pairs to leaves with single denominators, keeping the most promising ones at every level: for an incumbent. Without
    /// one near the optimum, the walk would evaluate whatever lies between the two.
    pub(super) fn beam(&self, mut pairs: Vec<Pair>, own: &mut Own) -> Result<(), Stopped> {
        let feedforward = &self.cells.feedforward;
        let mut fine = false;
        loop {
            let done = |(cell, block): &(u32, u32)| {
                self.cells.nodes[*cell as usize].children.is_empty()
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
                let children = &self.cells.nodes[same[0].0 as usize].children;
                let cells = if children.is_empty() { &[same[0].0][..] } else { children };
                let items: Vec<Item> = same
                    .iter()
                    .flat_map(|(_, block)| {
                        let children = feedforward.divisions[*block as usize].parts();
                        if children.is_empty() { vec![(*block, 0)] } else { children.iter().map(|c| (*c, 0)).collect() }
                    })
                    .collect();
                for cell in cells {
                    if fine {
                        self.costs(&mut own.double_precision, *cell, &items, &mut seen);
                    } else {
                        self.costs(&mut own.single_precision, *cell, &items, &mut seen);
                    }
                }
            }
            fine = fine || seen.iter().any(|one| one.0 < FINE);
            pairs = best(seen, BEAM);
        }
        for (cell, block) in pairs {
            self.ctl.check()?;
            let members: Vec<u32> = self.cells.nodes[cell as usize].members.clone().take(LARGEST_SAMPLE).collect();
            let place = feedforward.divisions[block as usize].first as usize;
            members.chunks(LANES).for_each(|eight| self.members(own, eight, place));
        }
        Ok(())
    }

    /// What the relaxed problems of a cluster cost, in units of the scale squared. Without a limit nothing is proven.
    fn costs<N: Kept>(&self, room: &mut Room<N>, cell: u32, items: &[Item], seen: &mut Vec<(f64, u32, u32)>) {
        let node = &self.cells.nodes[cell as usize];
        let known = Frame::<N>::can_hold(node, &self.lines);
        if known {
            room.frame.fill(node, &self.lines, &self.cells.feedforward);
        }
        for items in items.chunks(BLOCKS) {
            if known {
                room.bound(self.cells, items, N::INFINITY);
            }
            let cost = |lane: usize| if known { room.bounds.cost[lane].value() } else { f64::MAX };
            seen.extend(items.iter().enumerate().map(|(lane, item)| (cost(lane), cell, item.0)));
        }
    }

    /// The rest of a cluster, depth first, most promising first.
    pub(super) fn finish(&self, open: &Open, own: &mut Own) -> Result<(), Stopped> {
        if !super::super::decide::may_reach(open.bound, self.limit()) {
            return Ok(());
        }
        let mut next = self.open(open.cell, &open.items, true, own)?;
        next.sort_by(|a, b| a.bound.total_cmp(&b.bound));
        for open in &next {
            self.finish(open, own)?;
        }
        Ok(())
    }

    /// The parts of a cluster with what may go with them; leaves are done with at once, if `finish`, or else returned as they are.
    pub(super) fn open(&self, cell: u32, items: &[Item], finish: bool, own: &mut Own) -> Result<Vec<Open>, Stopped> {
        self.ctl.check()?;
        let node = &self.cells.nodes[cell as usize];
        if !Frame::<f32>::can_hold(node, &self.lines) {
            // Nothing is known of it.
            let parts = if node.children.is_empty() { &[cell][..] } else { &node.children };
            if node.children.is_empty() && finish {
                self.scattered(node, items, own)?;
                return Ok(Vec::new());
            }
            let open = |cell: &u32| Open { cell: *cell, items: items.to_vec(), bound: f64::NEG_INFINITY };
            return Ok(parts.iter().map(open).collect());
        }
        own.single_precision.frame.fill(node, &self.lines, &self.cells.feedforward);
        if own.single_precision.frame.is_too_fine(self.limit_in_units()) {
            own.double_precision.frame.fill(node, &self.lines, &self.cells.feedforward);
            self.open_in(|own| &mut own.double_precision, cell, items, finish, own)
        } else {
            self.open_in(|own| &mut own.single_precision, cell, items, finish, own)
        }
    }

    /// The limit in units of the scale squared.
    fn limit_in_units(&self) -> f64 {
        self.limit() / (self.lines.scale * self.lines.scale) * (1.0 + 4.0 * f64::EPSILON)
    }

    /// Opens the cluster that is in the frame of this precision.
    fn open_in<N: Kept>(
        &self,
        room: impl Fn(&mut Own) -> &mut Room<N>,
        cell: u32,
        items: &[Item],
        finish: bool,
        own: &mut Own,
    ) -> Result<Vec<Open>, Stopped> {
        let feedforward = &self.cells.feedforward;
        let node = &self.cells.nodes[cell as usize];
        let is_leaf = node.children.is_empty();
        // Leaves are done with one denominator at a time.
        let is_done = finish && is_leaf && !node.rough;
        let parts = if is_leaf { &[cell][..] } else { &node.children };
        let none = |cell: &u32| {
            let items = Vec::with_capacity(items.len().min(LARGEST_SHARE));
            Open { cell: *cell, items, bound: f64::INFINITY }
        };
        let mut opened: Vec<Open> = parts.iter().map(none).collect();
        if !is_leaf {
            let children = node.children.iter().map(|child| &self.cells.nodes[*child as usize]);
            room(own).frame.fill_parts(node, children);
        }
        // Blocks, and single denominators, which need fewer operations.
        let mut work = Work::default();
        items.iter().for_each(|item| work.push(self.cells, *item));
        let mut batch = Vec::with_capacity(BLOCKS);
        let mut places = Vec::new();
        while work.next(&mut batch) {
            let limit = N::above(self.limit_in_units());
            let extent = room(own).frame.extent;
            room(own).bound(self.cells, &batch, limit);
            own.counts.bounded += batch.len() as u64;
            for (lane, &(id, mask)) in batch.iter().enumerate() {
                let Room { frame, bounds, .. } = room(own);
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
            self.leaf(own, node, &places);
        }
        opened.retain(|open| !open.items.is_empty());
        if is_leaf
            && node.rough
            && finish
            && let Some(open) = opened.pop()
        {
            self.scattered(node, &open.items, own)?;
        }
        Ok(opened)
    }

    fn in_units_of_cost<N: Kept>(&self, bound: N) -> f64 {
        bound.value() * self.lines.scale * self.lines.scale * (1.0 - 4.0 * f64::EPSILON)
    }

    /// The members of a leaf with single denominators, by their places in the order of the blocks.
    fn leaf(&self, own: &mut Own, cell: &Cell, places: &[usize]) {
        let members: Vec<u32> = cell.members.clone().collect();
        for eight in members.chunks(LANES) {
            self.fill(own, eight);
            for place in places {
                self.evaluate(own, *place, eight.len(), |lane| self.cells.feedback(eight[lane] as usize));
            }
        }
    }

    /// The members of a leaf that cannot be bounded together: eight at a time, each by itself, with ever smaller blocks of denominators.
    fn scattered(&self, cell: &Cell, items: &[Item], own: &mut Own) -> Result<(), Stopped> {
        let feedforward = &self.cells.feedforward;
        let members: Vec<u32> = cell.members.clone().collect();
        for eight in members.chunks(LANES) {
            self.ctl.check()?;
            self.fill(own, eight);
            let mut work = Work::default();
            items.iter().for_each(|item| work.push(self.cells, *item));
            while let Some((id, mask)) = work.pop() {
                let block = &feedforward.divisions[id as usize];
                if block.is_single() {
                    self.evaluate(own, block.first as usize, eight.len(), |lane| {
                        self.cells.feedback(eight[lane] as usize)
                    });
                    continue;
                }
                self.bound(own, id, mask, self.limit());
                own.counts.bounded += eight.len() as u64;
                let any = own.one.alive[..eight.len()].iter().fold(0, |all, lane| all | lane);
                self.divide(id, any, &mut work);
            }
        }
        Ok(())
    }

    /// The parts of a block that hold one of these denominators.
    fn divide(&self, id: u32, any: u64, work: &mut Work) {
        let divisions = &self.cells.feedforward.divisions;
        let block = &divisions[id as usize];
        for child in block.parts() {
            let part = &divisions[*child as usize];
            let mask = (any >> (part.first - block.first)) & part.everything();
            if mask != 0 {
                work.push(self.cells, (*child, mask));
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
        self.bound(own, feedforward.single[place], 1, limit);
        own.counts.evaluated += count as u64;
        for lane in (0..count).filter(|lane| own.one.alive[*lane] != 0) {
            let (cost, bound) = (own.one.cost[lane], own.one.bound[lane]);
            let found = Found { cost, bound, feedback: feedback(lane), feedforward: feedforward.order[place] };
            if found.above().is_finite() {
                self.best.fetch_min(found.above().max(0.0).to_bits(), Ordering::Relaxed);
            }
            // `min` ignores a bound that is no number, which says nothing.
            own.lowest = if bound.is_nan() { f64::NEG_INFINITY } else { own.lowest.min(bound) };
            own.found.push(found);
        }
        if own.found.len() > own.room {
            let limit = self.limit();
            own.found.retain(|found| super::super::decide::may_reach(found.bound, limit));
            own.room = (2 * own.found.len()).max(KEPT);
        }
    }
}
