//! Branch and bound for one end of one range.
//!
//! A pair of a cluster of feedback controllers and a block of feedforward denominators is left out where each of its
//! members costs too much to belong to the set, or has no norm beyond the best one found so far; else the wider of the
//! two is divided. What is left in the end are single candidates, which QR and quadrature decide.

use super::best::Best;
use super::controllers::{Controllers, Parts, view_of};
use super::denominators::Denominators;
use super::norms::Norms;
use super::pair::{Bracket, Scratch, Trial, View};
use super::question::{Quantity, Question, norm_of};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Feedback, Position};
use crate::identify::search::screen::exact;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

/// The block is divided where it extends more than this multiple of the cluster.
const BALANCE: f64 = 1.0;

/// Clusters that are opened before the work is shared out.
const TASKS: usize = 512;

/// What a trial and its pool give to every walk.
#[derive(Debug)]
pub(super) struct Material {
    pub trial: Trial,
    pub denominators: Denominators,
    pub norms: Norms,
    /// No feedback at all, where the pool has it: the first of the copies.
    pub without_feedback: Option<Feedback>,
}

/// What the walks did. It depends on which thread found what first.
#[derive(Debug, Default)]
pub(super) struct Work {
    /// Pairs of a cluster and a block that were bounded.
    pub bounded: AtomicU64,
    /// Norms by quadrature.
    pub evaluated: AtomicU64,
}

/// A cluster with the blocks that may go with it.
#[derive(Debug)]
struct Open<C> {
    cluster: C,
    blocks: Vec<u32>,
    /// The best signed norm that a member may have.
    potential: f64,
    /// What to look at first.
    promise: f64,
}

/// A thread's own memory.
#[derive(Debug, Default)]
struct WorkerState {
    view: View,
    scratch: Scratch,
    bounded: u64,
    evaluated: u64,
}

/// One end of one range.
pub(super) struct Walk<'a, C> {
    pub controllers: &'a C,
    pub question: &'a Question<'a>,
    pub material: &'a Material,
    pub best: &'a Best,
    pub ctl: &'a Ctl,
}

impl<C: Controllers> Walk<'_, C> {
    /// Finds the end.
    pub(super) fn run(&self, work: &Work) -> Result<(), Stopped> {
        let mut state = WorkerState::default();
        if let Some(feedback) = self.material.without_feedback {
            self.single(&feedback, &self.material.denominators.roots, &mut state)?;
        }
        let mut tasks = self.tasks(&mut state)?;
        tasks.sort_by(|a, b| b.promise.total_cmp(&a.promise));
        self.ctl.set_total(tasks.len() as u64);
        let next = AtomicUsize::new(0);
        let states = (0..rayon::current_num_threads())
            .into_par_iter()
            .with_max_len(1)
            .map(|_| {
                let mut state = WorkerState::default();
                while let Some(task) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) {
                    self.finish(task, &mut state)?;
                    self.ctl.advance(1);
                }
                Ok(state)
            })
            .collect::<Result<Vec<WorkerState>, Stopped>>()?;
        for state in states.iter().chain([&state]) {
            work.bounded.fetch_add(state.bounded, Ordering::Relaxed);
            work.evaluated.fetch_add(state.evaluated, Ordering::Relaxed);
        }
        Ok(())
    }

    /// The pool, opened far enough to be shared out.
    fn tasks(&self, state: &mut WorkerState) -> Result<Vec<Open<C::Cluster>>, Stopped> {
        let roots = self.controllers.roots();
        let everything = &self.material.denominators.roots;
        let opened = roots
            .par_iter()
            .map_init(WorkerState::default, |state, root| {
                let open = self.open(root.clone(), everything, state)?;
                Ok((open, std::mem::take(&mut state.bounded)))
            })
            .collect::<Result<Vec<_>, Stopped>>()?;
        state.bounded += opened.iter().map(|(_, bounded)| bounded).sum::<u64>();
        let mut open: std::collections::VecDeque<_> = opened.into_iter().filter_map(|(open, _)| open).collect();
        let mut whole = Vec::new();
        while whole.len() + open.len() < TASKS {
            let Some(next) = open.pop_front() else { break };
            match self.controllers.parts(&next.cluster, self.ctl)? {
                Parts::Controllers(_) => whole.push(next),
                Parts::Clusters(parts) => {
                    for part in parts {
                        open.extend(self.open(part, &next.blocks, state)?);
                    }
                }
            }
        }
        whole.extend(open);
        Ok(whole)
    }

    /// The rest of a cluster, depth first, most promising first.
    fn finish(&self, open: &Open<C::Cluster>, state: &mut WorkerState) -> Result<(), Stopped> {
        if self.best.is_infinite() || !self.best.may_be(open.potential) {
            return Ok(());
        }
        match self.controllers.parts(&open.cluster, self.ctl)? {
            Parts::Controllers(controllers) => {
                for feedback in &controllers {
                    self.single(feedback, &open.blocks, state)?;
                }
            }
            Parts::Clusters(parts) => {
                let mut next = Vec::with_capacity(parts.len());
                for part in parts {
                    next.extend(self.open(part, &open.blocks, state)?);
                }
                next.sort_by(|a, b| b.promise.total_cmp(&a.promise));
                for open in &next {
                    self.finish(open, state)?;
                }
            }
        }
        Ok(())
    }

    /// A cluster with what may go with it of some blocks; `None` where that is nothing.
    fn open(
        &self,
        cluster: C::Cluster,
        blocks: &[u32],
        state: &mut WorkerState,
    ) -> Result<Option<Open<C::Cluster>>, Stopped> {
        self.ctl.check()?;
        let WorkerState { view, scratch, bounded, .. } = state;
        self.controllers.view(&cluster, view);
        let of_distance = self.best.quantity() == Quantity::Distance;
        let own = if of_distance { f64::INFINITY } else { self.best.potential(view.norm) };
        if !self.best.may_be(own) {
            return Ok(None);
        }
        let is_known = !view.radius.is_empty() && view.radius.iter().all(|radius| radius.is_finite());
        if !is_known {
            return Ok(Some(Open { cluster, blocks: blocks.to_vec(), potential: own, promise: own }));
        }
        let mut open = Open { cluster, blocks: Vec::new(), potential: own, promise: own };
        let (mut potential, mut promise) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        let mut left = blocks.to_vec();
        while let Some(at) = left.pop() {
            let block = &self.material.denominators.blocks[at as usize];
            *bounded += 1;
            let bracket = self.material.trial.bracket(view, block, self.question.limit, of_distance, scratch);
            if !self.may_belong(&bracket) {
                continue;
            }
            let [by_feedback, by_feedforward] = bracket.losses;
            let is_wide = by_feedforward > BALANCE * by_feedback || by_feedforward.is_infinite();
            if is_wide && !block.is_single() {
                left.extend(&block.parts);
                continue;
            }
            open.blocks.push(at);
            let [low, high] = bracket.distance;
            potential = potential.max(self.best.potential([low, high]));
            let middle = if high.is_finite() { 0.5 * (low + high) } else { low };
            promise = promise.max(self.best.signed(middle));
        }
        if open.blocks.is_empty() {
            return Ok(None);
        }
        if of_distance {
            (open.potential, open.promise) = (potential, promise);
        }
        Ok(Some(open))
    }

    /// Whether a pair may hold a member of the set with a norm that is asked for.
    fn may_belong(&self, bracket: &Bracket) -> bool {
        let is_dear = bracket.cost > self.question.limit;
        let of_distance = self.best.quantity() == Quantity::Distance;
        !is_dear && (!of_distance || self.best.may_be(self.best.potential(bracket.distance)))
    }

    /// A controller with every denominator of some blocks.
    fn single(&self, feedback: &Feedback, blocks: &[u32], state: &mut WorkerState) -> Result<(), Stopped> {
        self.ctl.check()?;
        let WorkerState { view, scratch, bounded, evaluated } = state;
        let Question { problem, pool, limit, .. } = self.question;
        let of_distance = self.best.quantity() == Quantity::Distance;
        let mut own = 0.0;
        if !of_distance {
            if !self.best.may_be(self.best.potential(self.material.norms.of(feedback))) {
                return Ok(());
            }
            let candidate = pool.candidate(Position { feedforward: 0, feedback: *feedback });
            *evaluated += 1;
            own = norm_of(self.question, Quantity::Feedback, &candidate);
            if !self.best.is_better(own) {
                return Ok(());
            }
        }
        view_of(problem, pool, feedback, view);
        let mut left = blocks.to_vec();
        while let Some(at) = left.pop() {
            let block = &self.material.denominators.blocks[at as usize];
            *bounded += 1;
            let bracket = self.material.trial.bracket(view, block, *limit, of_distance, scratch);
            if !self.may_belong(&bracket) {
                continue;
            }
            if !block.is_single() {
                left.extend(&block.parts);
                continue;
            }
            let position = Position { feedforward: block.first as usize, feedback: *feedback };
            let candidate = pool.candidate(position);
            if bracket.above > *limit && exact::cost(problem, &candidate) > *limit {
                continue;
            }
            if of_distance {
                *evaluated += 1;
                own = norm_of(self.question, Quantity::Distance, &candidate);
                if !self.best.is_better(own) {
                    continue;
                }
            }
            self.best.take(own, pool.index(position.feedforward, position.feedback));
            if !of_distance {
                // Any partner does; the first is looked for when the controller is known.
                return Ok(());
            }
        }
        Ok(())
    }
}
