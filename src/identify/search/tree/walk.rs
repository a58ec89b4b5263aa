//! The walk through the pairs of clusters, from the whole pool down to single candidates.

use super::super::decide::Found;
use super::kernel::{self, Bounds, Cell, Denominators, Group, LANES, Lines};
use super::prepared::Prepared;
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Feedback, Pool};
use crate::identify::problem::Problem;
use num_complex::Complex64;
use std::sync::atomic::{AtomicU64, Ordering};

/// Members of a cell that are looked at one by one instead of being divided further.
const FEW: f64 = 32.0;

/// Gains closer than this (in logarithms, half of a range) are not divided further.
const NARROW: f64 = 0.04;

/// The feedforward cluster is divided where its loss is more than this multiple of the feedback cluster's.
const BALANCE: f64 = 1.0;

/// How far rounding may move the logarithm of a gain, amply.
const LOGARITHM: f64 = 1e-9;

/// Candidates that a thread keeps before it throws out those that a better incumbent has made worthless.
const KEPT: usize = 1 << 14;

/// Cells that are opened before the work is shared out.
const TASKS: usize = 512;

/// A place without a controller.
const NONE: Feedback = Feedback { denominator: 0, numerator: None, gain: 0.0, gain_position: None };

/// A set of feedback controllers: a cluster of denominators, one of numerators, and a range of gains.
#[derive(Debug, Clone, Copy)]
pub(super) struct Range {
    denominators: usize,
    numerators: usize,
    negative: bool,
    /// Logarithms of the gains of the scaled shapes, `[low, high)`.
    low: f64,
    high: f64,
}

/// A range with the feedforward clusters that may hold a good partner.
#[derive(Debug)]
pub(super) struct Open {
    range: Range,
    feedforward: Vec<u32>,
    /// The smallest cost of a pair of centres, and the smallest bound.
    promise: f64,
    pub(super) bound: f64,
}

/// What a walk did.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    /// Pairs of clusters that were bounded.
    pub bounded: u64,
    /// Candidates evaluated.
    pub evaluated: u64,
}

/// One trial's search, shared by the threads.
#[derive(Debug)]
pub(super) struct Walk<'a> {
    prepared: &'a Prepared,
    pool: &'a Pool,
    lines: Lines,
    /// The nodes of the feedforward tree for the kernel.
    feedforward: Vec<Denominators>,
    /// An upper bound of the smallest cost, as bits: of positive numbers the order is the same.
    best: AtomicU64,
    near: f64,
    ctl: &'a Ctl,
}

/// A thread's own memory.
#[derive(Debug)]
pub(super) struct Own {
    group: Group,
    scratch: Vec<f64>,
    work: Vec<u32>,
    pub found: Vec<Found>,
    pub counts: Counts,
    room: usize,
}

impl<'a> Walk<'a> {
    pub(super) fn new(problem: &Problem, pool: &'a Pool, prepared: &'a Prepared, near: f64, ctl: &'a Ctl) -> Self {
        let lines = Lines::new(problem);
        let feedforward = prepared.feedforward.tree.nodes.iter().map(|node| Denominators::new(&lines, node)).collect();
        Self { prepared, pool, lines, feedforward, best: AtomicU64::new(f64::MAX.to_bits()), near, ctl }
    }

    pub(super) fn own(&self) -> Own {
        Own {
            group: Group::new(&self.lines),
            scratch: Vec::new(),
            work: Vec::new(),
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

    /// The pool, opened far enough to be shared out: most promising first.
    pub(super) fn tasks(&self, own: &mut Own) -> Result<Vec<Open>, Stopped> {
        let trees = (&self.prepared.denominators.tree, &self.prepared.numerators.tree);
        let roots: Vec<u32> = self.prepared.feedforward.tree.roots.iter().map(|r| *r as u32).collect();
        let mut open = std::collections::VecDeque::new();
        for negative in [false, true] {
            for &denominators in &trees.0.roots {
                for &numerators in &trees.1.roots {
                    let range =
                        Range { denominators, numerators, negative, low: f64::NEG_INFINITY, high: f64::INFINITY };
                    if let Some(range) = self.clip(range) {
                        let feedforward = roots.clone();
                        open.push_back(Open { range, feedforward, promise: 0.0, bound: 0.0 });
                    }
                }
            }
        }
        let mut whole = Vec::new();
        while whole.len() + open.len() < TASKS {
            let Some(next) = open.pop_front() else { break };
            if self.is_small(&next.range) {
                whole.push(next);
            } else {
                open.extend(self.open(&next, own)?);
            }
        }
        whole.extend(open);
        whole.sort_by(|a, b| a.promise.total_cmp(&b.promise));
        Ok(whole)
    }

    /// No feedback at all, with every feedforward denominator.
    pub(super) fn without_feedback(&self, own: &mut Own) -> Result<(), Stopped> {
        let Some((_, denominator)) = self.prepared.without_feedback else { return Ok(()) };
        let none = vec![Complex64::ZERO; self.prepared.feedforward.responses[0].len()];
        let feedback = Feedback { denominator, numerator: None, gain: 0.0, gain_position: None };
        let cell = Cell { denominator: &none, numerator: &none, gain: 0.0, half: 0.0, clusters: None };
        own.group.fill(&self.lines, std::iter::once(cell));
        let roots: Vec<u32> = self.prepared.feedforward.tree.roots.iter().map(|r| *r as u32).collect();
        self.members(&[feedback], &roots, own)
    }

    /// The rest of a task, depth first, most promising first.
    pub(super) fn finish(&self, task: &Open, own: &mut Own) -> Result<(), Stopped> {
        if task.bound > self.limit() {
            return Ok(());
        }
        if self.is_small(&task.range) {
            return self.small(task, own);
        }
        let mut open = self.open(task, own)?;
        open.sort_by(|a, b| a.promise.total_cmp(&b.promise));
        for next in &open {
            self.finish(next, own)?;
        }
        Ok(())
    }

    fn half(range: &Range) -> f64 {
        0.5 * (range.high - range.low)
    }

    fn is_small(&self, range: &Range) -> bool {
        let (p, z) = (
            &self.prepared.denominators.tree.nodes[range.denominators],
            &self.prepared.numerators.tree.nodes[range.numerators],
        );
        let gains = (2.0 * Self::half(range) / self.prepared.gain_step).max(1.0);
        (p.members.len() * z.members.len()) as f64 * gains <= FEW
            || (p.children.is_empty() && z.children.is_empty() && Self::half(range) <= NARROW)
    }

    /// Less what cannot be stable; `None` where nothing is left.
    fn clip(&self, range: Range) -> Option<Range> {
        let [low, high] = self.prepared.ranges.of(range.denominators, range.numerators, range.negative);
        let clipped = Range { low: range.low.max(low), high: range.high.min(high), ..range };
        (clipped.low < clipped.high).then_some(clipped)
    }

    /// How far a range extends along denominators, numerators and gains.
    fn spreads(&self, range: &Range) -> [f64; 3] {
        [
            self.prepared.denominators.tree.nodes[range.denominators].spread,
            self.prepared.numerators.tree.nodes[range.numerators].spread,
            Self::half(range),
        ]
    }

    /// Up to eight parts of a range, divided three times along whatever is widest.
    fn divide(&self, whole: Range) -> Vec<Range> {
        let mut parts = vec![whole];
        for _ in 0..3 {
            let mut next = Vec::with_capacity(2 * parts.len());
            for part in parts {
                let (p, z) = (
                    &self.prepared.denominators.tree.nodes[part.denominators],
                    &self.prepared.numerators.tree.nodes[part.numerators],
                );
                let spreads = self.spreads(&part);
                let divisible = [!p.children.is_empty(), !z.children.is_empty(), Self::half(&part) > NARROW];
                match (0..3).filter(|a| divisible[*a]).max_by(|a, b| spreads[*a].total_cmp(&spreads[*b])) {
                    Some(0) => next.extend(p.children.iter().map(|child| Range { denominators: *child, ..part })),
                    Some(1) => next.extend(z.children.iter().map(|child| Range { numerators: *child, ..part })),
                    Some(_) => {
                        let middle = 0.5 * (part.low + part.high);
                        next.push(Range { high: middle, ..part });
                        next.push(Range { low: middle, ..part });
                    }
                    None => next.push(part),
                }
            }
            parts = next.into_iter().filter_map(|part| self.clip(part)).collect();
        }
        parts
    }

    /// The parts of a range that may hold a good candidate.
    fn open(&self, whole: &Open, own: &mut Own) -> Result<Vec<Open>, Stopped> {
        self.ctl.check()?;
        let parts = self.divide(whole.range);
        let mut open = Vec::new();
        for parts in parts.chunks(LANES) {
            let cells = parts.iter().map(|part| {
                let p = &self.prepared.denominators.tree.nodes[part.denominators];
                let z = &self.prepared.numerators.tree.nodes[part.numerators];
                let magnitude = (0.5 * (part.low + part.high)).exp();
                Cell {
                    denominator: &p.centre,
                    numerator: &z.centre,
                    gain: if part.negative { -magnitude } else { magnitude },
                    half: Self::half(part),
                    clusters: Some([p, z]),
                }
            });
            own.group.fill(&self.lines, cells);
            let first = open.len();
            open.extend(parts.iter().map(|part| Open {
                range: *part,
                feedforward: Vec::new(),
                promise: f64::INFINITY,
                bound: f64::INFINITY,
            }));
            let mut work = std::mem::take(&mut own.work);
            work.clear();
            work.extend_from_slice(&whole.feedforward);
            while let Some(node) = work.pop() {
                let limit = self.limit();
                let bounds =
                    kernel::bounds(&self.lines, &own.group, &self.feedforward[node as usize], limit, &mut own.scratch);
                own.counts.bounded += parts.len() as u64;
                let mut alive = [false; LANES];
                let (mut feedback_loss, mut feedforward_loss) = (0.0, 0.0);
                for (lane, alive) in alive.iter_mut().enumerate().take(parts.len()) {
                    *alive = kernel::may_reach(bounds.bound[lane], limit);
                    if *alive {
                        feedback_loss += bounds.feedback_loss[lane];
                        feedforward_loss += bounds.feedforward_loss[lane];
                    }
                }
                if !alive.contains(&true) {
                    continue;
                }
                let children = &self.prepared.feedforward.tree.nodes[node as usize].children;
                // Where nothing could be proven, nothing was lost either: the wider cluster is divided.
                let undivided = if feedback_loss + feedforward_loss > 0.0 {
                    feedforward_loss <= BALANCE * feedback_loss
                } else {
                    self.prepared.feedforward.tree.nodes[node as usize].spread
                        <= 0.5 * self.spreads(&whole.range).iter().sum::<f64>()
                };
                if children.is_empty() || undivided {
                    for lane in (0..parts.len()).filter(|lane| alive[*lane]) {
                        let part = &mut open[first + lane];
                        part.feedforward.push(node);
                        part.promise = part.promise.min(bounds.cost[lane]);
                        // `min` would ignore a NaN, which means that nothing is known.
                        let bound = bounds.bound[lane];
                        part.bound = part.bound.min(if bound.is_nan() { f64::NEG_INFINITY } else { bound });
                    }
                } else {
                    work.extend(children.iter().map(|child| *child as u32));
                }
            }
            own.work = work;
        }
        open.retain(|part| !part.feedforward.is_empty());
        Ok(open)
    }

    /// Every stable controller of a small range.
    fn small(&self, task: &Open, own: &mut Own) -> Result<(), Stopped> {
        self.ctl.check()?;
        let range = &task.range;
        let prepared = self.prepared;
        let p = &prepared.denominators.tree.nodes[range.denominators];
        let z = &prepared.numerators.tree.nodes[range.numerators];
        // A little wider than the range, whose ends are decided by the logarithms.
        let bounds = [(range.low - LOGARITHM).exp(), (range.high + LOGARITHM).exp()];
        let mut found = Vec::new();
        let mut members = [NONE; LANES];
        let mut count = 0;
        for i in p.members.clone() {
            let denominator = prepared.denominators.tree.order[i];
            let opened = self.pool.feedback().open(denominator);
            for j in z.members.clone() {
                let numerator = prepared.numerators.tree.order[j];
                let scale = prepared.denominators.scales[denominator] * prepared.numerators.scales[numerator];
                opened.visit(numerator, range.negative, bounds.map(|bound| bound / scale), |feedback| {
                    let log = (feedback.gain.abs() * scale).ln();
                    if range.low <= log && log < range.high {
                        found.push(feedback);
                    }
                });
                for feedback in found.drain(..) {
                    members[count] = feedback;
                    count += 1;
                    if count == LANES {
                        count = 0;
                        self.fill(&members, own);
                        self.members(&members, &task.feedforward, own)?;
                    }
                }
            }
        }
        if count > 0 {
            self.fill(&members[..count], own);
            self.members(&members[..count], &task.feedforward, own)?;
        }
        Ok(())
    }

    fn fill(&self, members: &[Feedback], own: &mut Own) {
        let (denominators, numerators) = (&self.prepared.denominators, &self.prepared.numerators);
        let cells = members.iter().filter_map(|feedback| {
            let numerator = feedback.numerator?;
            Some(Cell {
                denominator: &denominators.responses[feedback.denominator],
                numerator: &numerators.responses[numerator],
                gain: feedback.gain * denominators.scales[feedback.denominator] * numerators.scales[numerator],
                half: 0.0,
                clusters: None,
            })
        });
        own.group.fill(&self.lines, cells);
    }

    /// The controllers in the group, with every denominator in these clusters that the bounds do not exclude.
    fn members(&self, members: &[Feedback], feedforward: &[u32], own: &mut Own) -> Result<(), Stopped> {
        let mut work = std::mem::take(&mut own.work);
        work.clear();
        work.extend_from_slice(feedforward);
        while let Some(node) = work.pop() {
            let limit = self.limit();
            let bounds: Bounds =
                kernel::bounds(&self.lines, &own.group, &self.feedforward[node as usize], limit, &mut own.scratch);
            let cluster = &self.prepared.feedforward.tree.nodes[node as usize];
            let single = cluster.children.is_empty();
            own.counts.bounded += if single { 0 } else { members.len() as u64 };
            own.counts.evaluated += if single { members.len() as u64 } else { 0 };
            let mut alive = false;
            for (lane, feedback) in members.iter().enumerate() {
                if !kernel::may_reach(bounds.bound[lane], limit) {
                    continue;
                }
                alive = true;
                if single {
                    let (cost, bound) = (bounds.cost[lane], bounds.bound[lane]);
                    let above = cost + (cost - bound);
                    if above.is_finite() {
                        self.best.fetch_min(above.max(0.0).to_bits(), Ordering::Relaxed);
                    }
                    let feedforward = self.prepared.feedforward.tree.order[cluster.members.start] as u32;
                    own.found.push(Found { cost, bound, feedback: *feedback, feedforward });
                }
            }
            if alive && !single {
                work.extend(cluster.children.iter().map(|child| *child as u32));
            }
        }
        own.work = work;
        if own.found.len() > own.room {
            let limit = self.limit();
            own.found.retain(|found| kernel::may_reach(found.bound, limit));
            own.room = (2 * own.found.len()).max(KEPT);
            self.ctl.check()?;
        }
        Ok(())
    }
}
