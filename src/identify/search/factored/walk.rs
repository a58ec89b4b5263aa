//! The walk through the pairs of clusters, from the whole pool down to single candidates.

use super::feedback_lanes::{FeedbackCluster, FeedbackLanes, LANES};
use super::kernel::{self, Bounds};
use super::lines::{Denominators, Lines};
use super::trees::FactorTrees;
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Feedback, Pool};
use crate::identify::problem::Problem;
use crate::identify::search::screen::decide::{Found, may_reach};
use num_complex::Complex64;
use std::sync::atomic::{AtomicU64, Ordering};

/// Members of a range that are looked at one by one instead of being divided further.
const FEW: f64 = 32.0;

/// Gains closer than this (in logarithms, half of a range) are not divided further.
const NARROW: f64 = 0.04;

/// The feedforward cluster is divided where its loss is more than this multiple of the feedback cluster's.
const BALANCE: f64 = 1.0;

/// How far rounding may move the logarithm of a gain, amply.
const LOGARITHM: f64 = 1e-9;

/// Candidates that a thread keeps before it throws out those that a better incumbent has made worthless.
const KEPT: usize = 1 << 14;

/// Ranges that are opened before the work is shared out.
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
    trees: &'a FactorTrees,
    pool: &'a Pool,
    lines: Lines,
    /// The nodes of the feedforward tree for the kernel.
    feedforward: Vec<Denominators>,
    /// An upper bound of the smallest cost, as bits: of positive numbers the order is the same.
    best: AtomicU64,
    near: f64,
    /// Costs that differ by less cannot be told apart.
    rounding: f64,
    ctl: &'a Ctl,
}

/// A thread's own memory.
#[derive(Debug)]
pub(super) struct WorkerState {
    feedback: FeedbackLanes,
    scratch: Vec<f64>,
    work: Vec<u32>,
    pub found: Vec<Found>,
    pub counts: Counts,
    most_found: usize,
}

impl<'a> Walk<'a> {
    pub(super) fn new(problem: &Problem, pool: &'a Pool, trees: &'a FactorTrees, near: f64, ctl: &'a Ctl) -> Self {
        let lines = Lines::new(problem);
        let feedforward = trees.feedforward.tree.nodes.iter().map(|node| Denominators::new(&lines, node)).collect();
        let best = AtomicU64::new(f64::MAX.to_bits());
        Self { trees, pool, lines, feedforward, best, near, rounding: problem.rounding(), ctl }
    }

    pub(super) fn worker_state(&self) -> WorkerState {
        WorkerState {
            feedback: FeedbackLanes::new(&self.lines),
            scratch: Vec::new(),
            work: Vec::new(),
            found: Vec::new(),
            counts: Counts::default(),
            most_found: KEPT,
        }
    }

    /// An upper bound of the smallest cost.
    pub(super) fn best(&self) -> f64 {
        f64::from_bits(self.best.load(Ordering::Relaxed))
    }

    /// What costs more than this is not looked for.
    fn limit(&self) -> f64 {
        let best = self.best();
        ((1.0 + self.near) * best).max(best + self.rounding)
    }

    /// The pool, opened far enough to be shared out: most promising first.
    pub(super) fn tasks(&self, state: &mut WorkerState) -> Result<Vec<Open>, Stopped> {
        let trees = (&self.trees.denominators.tree, &self.trees.numerators.tree);
        let roots: Vec<u32> = self.trees.feedforward.tree.roots.iter().map(|r| *r as u32).collect();
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
                open.extend(self.open(&next, state)?);
            }
        }
        whole.extend(open);
        whole.sort_by(|a, b| a.promise.total_cmp(&b.promise));
        Ok(whole)
    }

    /// No feedback at all, with every feedforward denominator.
    pub(super) fn without_feedback(&self, state: &mut WorkerState) -> Result<(), Stopped> {
        let Some((_, denominator)) = self.trees.without_feedback else { return Ok(()) };
        let none = vec![Complex64::ZERO; self.trees.feedforward.responses[0].len()];
        let feedback = Feedback { denominator, numerator: None, gain: 0.0, gain_position: None };
        let cluster = FeedbackCluster { denominator: &none, numerator: &none, gain: 0.0, half: 0.0, clusters: None };
        state.feedback.fill(&self.lines, std::iter::once(cluster));
        let roots: Vec<u32> = self.trees.feedforward.tree.roots.iter().map(|r| *r as u32).collect();
        self.members(&[feedback], &roots, state)
    }

    /// The rest of a task, depth first, most promising first.
    pub(super) fn finish(&self, task: &Open, state: &mut WorkerState) -> Result<(), Stopped> {
        if task.bound > self.limit() {
            return Ok(());
        }
        if self.is_small(&task.range) {
            return self.small(task, state);
        }
        let mut open = self.open(task, state)?;
        open.sort_by(|a, b| a.promise.total_cmp(&b.promise));
        for next in &open {
            self.finish(next, state)?;
        }
        Ok(())
    }

    fn half(range: &Range) -> f64 {
        0.5 * (range.high - range.low)
    }

    fn is_small(&self, range: &Range) -> bool {
        let (p, z) = (
            &self.trees.denominators.tree.nodes[range.denominators],
            &self.trees.numerators.tree.nodes[range.numerators],
        );
        let gains = (2.0 * Self::half(range) / self.trees.gain_step).max(1.0);
        (p.members.len() * z.members.len()) as f64 * gains <= FEW
            || (p.children.is_empty() && z.children.is_empty() && Self::half(range) <= NARROW)
    }

    /// Less what cannot be stable; `None` where nothing is left.
    fn clip(&self, range: Range) -> Option<Range> {
        let [low, high] = self.trees.ranges.of(range.denominators, range.numerators, range.negative);
        let clipped = Range { low: range.low.max(low), high: range.high.min(high), ..range };
        (clipped.low < clipped.high).then_some(clipped)
    }

    /// How far a range extends along denominators, numerators and gains.
    fn spreads(&self, range: &Range) -> [f64; 3] {
        [
            self.trees.denominators.tree.nodes[range.denominators].spread,
            self.trees.numerators.tree.nodes[range.numerators].spread,
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
                    &self.trees.denominators.tree.nodes[part.denominators],
                    &self.trees.numerators.tree.nodes[part.numerators],
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
    fn open(&self, whole: &Open, state: &mut WorkerState) -> Result<Vec<Open>, Stopped> {
        self.ctl.check()?;
        let parts = self.divide(whole.range);
        let mut open = Vec::new();
        for parts in parts.chunks(LANES) {
            let clusters = parts.iter().map(|part| {
                let p = &self.trees.denominators.tree.nodes[part.denominators];
                let z = &self.trees.numerators.tree.nodes[part.numerators];
                let magnitude = (0.5 * (part.low + part.high)).exp();
                FeedbackCluster {
                    denominator: &p.centre,
                    numerator: &z.centre,
                    gain: if part.negative { -magnitude } else { magnitude },
                    half: Self::half(part),
                    clusters: Some([p, z]),
                }
            });
            state.feedback.fill(&self.lines, clusters);
            let first = open.len();
            open.extend(parts.iter().map(|part| Open {
                range: *part,
                feedforward: Vec::new(),
                promise: f64::INFINITY,
                bound: f64::INFINITY,
            }));
            let mut work = std::mem::take(&mut state.work);
            work.clear();
            work.extend_from_slice(&whole.feedforward);
            while let Some(node) = work.pop() {
                let limit = self.limit();
                let bounds = kernel::bounds(
                    &self.lines,
                    &state.feedback,
                    &self.feedforward[node as usize],
                    limit,
                    &mut state.scratch,
                );
                state.counts.bounded += parts.len() as u64;
                let mut alive = [false; LANES];
                let (mut feedback_loss, mut feedforward_loss) = (0.0, 0.0);
                for (lane, alive) in alive.iter_mut().enumerate().take(parts.len()) {
                    *alive = may_reach(bounds.bound[lane], limit);
                    if *alive {
                        feedback_loss += bounds.feedback_loss[lane];
                        feedforward_loss += bounds.feedforward_loss[lane];
                    }
                }
                if !alive.contains(&true) {
                    continue;
                }
                let children = &self.trees.feedforward.tree.nodes[node as usize].children;
                // Where nothing could be proven, nothing was lost either: the wider cluster is divided.
                let undivided = if feedback_loss + feedforward_loss > 0.0 {
                    feedforward_loss <= BALANCE * feedback_loss
                } else {
                    self.trees.feedforward.tree.nodes[node as usize].spread
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
            state.work = work;
        }
        open.retain(|part| !part.feedforward.is_empty());
        Ok(open)
    }

    /// Every stable controller of a small range.
    fn small(&self, task: &Open, state: &mut WorkerState) -> Result<(), Stopped> {
        self.ctl.check()?;
        let range = &task.range;
        let trees = self.trees;
        let p = &trees.denominators.tree.nodes[range.denominators];
        let z = &trees.numerators.tree.nodes[range.numerators];
        // A little wider than the range, whose ends are decided by the logarithms.
        let bounds = [(range.low - LOGARITHM).exp(), (range.high + LOGARITHM).exp()];
        let mut found = Vec::new();
        let mut members = [NONE; LANES];
        let mut count = 0;
        for i in p.members.clone() {
            let denominator = trees.denominators.tree.order[i];
            let opened = self.pool.feedback().open(denominator);
            for j in z.members.clone() {
                let numerator = trees.numerators.tree.order[j];
                let scale = trees.denominators.scales[denominator] * trees.numerators.scales[numerator];
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
                        self.fill(&members, state);
                        self.members(&members, &task.feedforward, state)?;
                    }
                }
            }
        }
        if count > 0 {
            self.fill(&members[..count], state);
            self.members(&members[..count], &task.feedforward, state)?;
        }
        Ok(())
    }

    fn fill(&self, members: &[Feedback], state: &mut WorkerState) {
        let (denominators, numerators) = (&self.trees.denominators, &self.trees.numerators);
        let clusters = members.iter().filter_map(|feedback| {
            let numerator = feedback.numerator?;
            Some(FeedbackCluster {
                denominator: &denominators.responses[feedback.denominator],
                numerator: &numerators.responses[numerator],
                gain: feedback.gain * denominators.scales[feedback.denominator] * numerators.scales[numerator],
                half: 0.0,
                clusters: None,
            })
        });
        state.feedback.fill(&self.lines, clusters);
    }

    /// The controllers in the lanes, with every denominator in these clusters that the bounds do not exclude.
    fn members(&self, members: &[Feedback], feedforward: &[u32], state: &mut WorkerState) -> Result<(), Stopped> {
        let mut work = std::mem::take(&mut state.work);
        work.clear();
        work.extend_from_slice(feedforward);
        while let Some(node) = work.pop() {
            let limit = self.limit();
            let bounds: Bounds = kernel::bounds(
                &self.lines,
                &state.feedback,
                &self.feedforward[node as usize],
                limit,
                &mut state.scratch,
            );
            let cluster = &self.trees.feedforward.tree.nodes[node as usize];
            let single = cluster.children.is_empty();
            state.counts.bounded += if single { 0 } else { members.len() as u64 };
            state.counts.evaluated += if single { members.len() as u64 } else { 0 };
            let mut alive = false;
            for (lane, feedback) in members.iter().enumerate() {
                if !may_reach(bounds.bound[lane], limit) {
                    continue;
                }
                alive = true;
                if single {
                    let (cost, bound) = (bounds.cost[lane], bounds.bound[lane]);
                    let above = cost + (cost - bound);
                    if above.is_finite() {
                        self.best.fetch_min(above.max(0.0).to_bits(), Ordering::Relaxed);
                    }
                    let feedforward = self.trees.feedforward.tree.order[cluster.members.start] as u32;
                    state.found.push(Found { cost, bound, feedback: *feedback, feedforward });
                }
            }
            if alive && !single {
                work.extend(cluster.children.iter().map(|child| *child as u32));
            }
        }
        state.work = work;
        if state.found.len() > state.most_found {
            let limit = self.limit();
            state.found.retain(|found| may_reach(found.bound, limit));
            state.most_found = (2 * state.found.len()).max(KEPT);
            self.ctl.check()?;
        }
        Ok(())
    }
}
