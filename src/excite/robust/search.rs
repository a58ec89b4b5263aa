//! The search for the experiment whose worst subject costs least.

use super::cost::{Draw, DrawCost, Setting, TOLERANCE, costs};
use crate::ctl::Ctl;
use crate::excite::sequence::SequenceError;
use std::collections::BTreeMap;

/// A search over experiments, with one set of draws for all that it compares.
pub struct Search<'a> {
    setting: &'a Setting,
    /// Γ: least and largest edge and width.
    gamma_box: [[f64; 2]; 2],
    draws: &'a [Draw],
    ctl: &'a Ctl,
    targets: BTreeMap<[u64; 2], Vec<f64>>,
    known: BTreeMap<[u64; 6], f64>,
    /// Lower bounds of others.
    bounds: BTreeMap<[u64; 6], f64>,
}

/// What a compass search minimises: the cost of an experiment, or any number that is no less than the third argument
/// where it is not less.
type Objective<'f, 'a> = dyn Fn(&mut Search<'a>, [f64; 2], f64) -> Result<f64, SequenceError> + 'f;

/// One iteration of the simultaneous min-max.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trace {
    /// θ.
    pub theta: [f64; 4],
    /// γ.
    pub gamma: [f64; 2],
    /// J(θ, γ).
    pub cost: f64,
}

/// The worst subjects found for an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Worst {
    /// γ.
    pub gamma: [f64; 2],
    /// Subjects with their costs, the worst first.
    pub subjects: Vec<([f64; 4], f64)>,
}

impl Worst {
    /// The largest cost found.
    #[must_use]
    pub fn cost(&self) -> f64 {
        self.subjects.first().map_or(f64::INFINITY, |(_, cost)| *cost)
    }
}

/// What the search came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// The best experiment for the average subject, with its worst subjects.
    pub nominal: Worst,
    /// J of the average subject there.
    pub nominal_cost: f64,
    /// The experiment whose worst subject costs least.
    pub robust: Worst,
    /// The iterations of the simultaneous min-max.
    pub trace: Vec<Trace>,
    /// Subjects that the refinement held against the experiment.
    pub scenarios: Vec<[f64; 4]>,
    /// Rounds of the refinement, and whether the last one met no worse subject than it had taken into account.
    pub rounds: usize,
    /// See `rounds`.
    pub closed: bool,
    /// Evaluations of J, those included that a bound settled.
    pub evaluations: usize,
}

/// First steps of the min-max, shares of the widths of the boxes.
const FIRST_STEP: f64 = 0.25;
/// First relative tolerances Q of the min-max.
const FIRST_TOLERANCE: f64 = 0.05;
/// It ends when every step is below this share of its first size.
const LEAST_STEP: f64 = 1.0 / 32.0;
/// Points of a first look at Γ along each side.
const GRID: usize = 5;
/// First step of a compass search, share of the box, and its last one.
const COMPASS: [f64; 2] = [0.25, 1.0 / 64.0];
/// A worst subject that costs no more than this factor of those known closes the refinement.
const CLOSED: f64 = 1.001;
/// Worst subjects that are kept.
const KEPT: usize = 6;

impl<'a> Search<'a> {
    /// A search over Γ with these draws.
    #[must_use]
    pub fn new(setting: &'a Setting, gamma_box: [[f64; 2]; 2], draws: &'a [Draw], ctl: &'a Ctl) -> Self {
        Self {
            setting,
            gamma_box,
            draws,
            ctl,
            targets: BTreeMap::new(),
            known: BTreeMap::new(),
            bounds: BTreeMap::new(),
        }
    }

    /// J(θ, γ); every evaluation advances the progress by one.
    fn cost(&mut self, theta: [f64; 4], gamma: [f64; 2]) -> Result<f64, SequenceError> {
        self.cost_below(theta, gamma, f64::INFINITY)
    }

    /// J(θ, γ), or a lower bound of it that is no less than `enough`: excursions cost no fit.
    fn cost_below(&mut self, theta: [f64; 4], gamma: [f64; 2], enough: f64) -> Result<f64, SequenceError> {
        let [e, w] = gamma.map(f64::to_bits);
        let [p, d, i, t] = theta.map(f64::to_bits);
        let key = [e, w, p, d, i, t];
        if let Some(known) = self.known.get(&key) {
            return Ok(*known);
        }
        if let Some(bound) = self.bounds.get(&key).filter(|bound| **bound >= enough) {
            return Ok(*bound);
        }
        if !self.targets.contains_key(&[e, w]) {
            let target = self.setting.target(gamma, self.ctl)?;
            self.targets.insert([e, w], target);
        }
        let found = costs(self.setting, theta, &self.targets[&[e, w]], self.draws, TOLERANCE[0], enough, self.ctl)?;
        let cost = found.iter().map(DrawCost::total).sum::<f64>() / found.len().max(1) as f64;
        if cost >= enough {
            self.bounds.insert(key, cost);
        } else {
            self.known.insert(key, cost);
        }
        self.ctl.advance(1);
        Ok(cost)
    }

    /// The best of a start and of a grid over Γ for one subject: the cost has several valleys, and the experiment that
    /// is best for the average subject is that of the whole of Γ.
    fn best_of_grid(&mut self, theta: [f64; 4], start: [f64; 2]) -> Result<[f64; 2], SequenceError> {
        let mut best = (self.cost(theta, start)?, start);
        for i in 0..GRID {
            for j in 0..GRID {
                let share = |k: usize| (k as f64 + 0.5) / GRID as f64;
                let at = |axis: usize, k: usize| {
                    let [lower, upper] = self.gamma_box[axis];
                    lower + share(k) * (upper - lower)
                };
                let gamma = [at(0, i), at(1, j)];
                let cost = self.cost_below(theta, gamma, best.0)?;
                if cost < best.0 {
                    best = (cost, gamma);
                }
            }
        }
        Ok(best.1)
    }

    /// Minimises over Γ from a start by a compass search: the best of a step to each side of each parameter, or half
    /// the step.
    fn compass(&mut self, start: [f64; 2], of: &Objective<'_, 'a>) -> Result<([f64; 2], f64), SequenceError> {
        let mut at = start;
        let mut best = of(self, at, f64::INFINITY)?;
        let mut step = COMPASS[0];
        while step >= COMPASS[1] {
            let mut next = None;
            for i in 0..2 {
                for sign in [1.0, -1.0] {
                    let [lower, upper] = self.gamma_box[i];
                    let mut moved = at;
                    moved[i] = (at[i] + sign * step * (upper - lower)).clamp(lower, upper);
                    if moved == at {
                        continue;
                    }
                    let value = of(self, moved, best)?;
                    if value < best {
                        (best, next) = (value, Some(moved));
                    }
                }
            }
            match next {
                Some(moved) => at = moved,
                None => step *= 0.5,
            }
        }
        Ok((at, best))
    }

    /// The simultaneous min-max of Table A.1 from θ and γ: every parameter moves by its step against (γ) or along (θ)
    /// the sign of its own difference, within its box; a step is halved, and its tolerance divided by five, when its
    /// sign turns or it moves less than the tolerance.
    fn min_max(&mut self, theta: [f64; 4], gamma: [f64; 2], iterations: usize) -> Result<Vec<Trace>, SequenceError> {
        let boxes: Vec<[f64; 2]> = self.gamma_box.iter().chain(&self.setting.population.controller).copied().collect();
        let mut at: Vec<f64> = gamma.iter().chain(&theta).copied().collect();
        let split = |at: &[f64]| ([at[2], at[3], at[4], at[5]], [at[0], at[1]]);
        let first: Vec<f64> = boxes.iter().map(|[lower, upper]| FIRST_STEP * (upper - lower)).collect();
        let mut steps = first.clone();
        let mut tolerances = [FIRST_TOLERANCE; 6];
        let mut before = [0.0; 6];
        let mut trace = Vec::new();
        for _ in 0..iterations {
            let (theta, gamma) = split(&at);
            let cost = self.cost(theta, gamma)?;
            trace.push(Trace { theta, gamma, cost });
            let mut signs = [0.0; 6];
            for i in 0..6 {
                let [lower, upper] = boxes[i];
                // Inward where the box ends.
                let inward = if at[i] + steps[i] <= upper { 1.0 } else { -1.0 };
                let mut moved = at.clone();
                moved[i] = (at[i] + inward * steps[i]).clamp(lower, upper);
                let (theta, gamma) = split(&moved);
                // Its sign is all that matters, and excursions may settle it.
                let difference = inward * (self.cost_below(theta, gamma, cost * (1.0 + 1e-12))? - cost);
                signs[i] = if difference == 0.0 { 0.0 } else { difference.signum() };
            }
            for i in 0..6 {
                let [lower, upper] = boxes[i];
                let direction = if i < 2 { -1.0 } else { 1.0 };
                let next = (at[i] + direction * steps[i] * signs[i]).clamp(lower, upper);
                let relative = ((next - at[i]) / at[i]).abs();
                at[i] = next;
                if relative < tolerances[i] || signs[i] != before[i] {
                    steps[i] *= 0.5;
                    tolerances[i] /= 5.0;
                }
                before[i] = signs[i];
            }
            if steps.iter().zip(&first).all(|(step, first)| *step <= LEAST_STEP * first) {
                break;
            }
        }
        Ok(trace)
    }

    /// The worst subjects of an experiment: every corner of Θ, its middle, those given, and coordinate steps from the
    /// worst of these.
    ///
    /// # Errors
    /// [`SequenceError`].
    pub fn worst(&mut self, gamma: [f64; 2], given: &[[f64; 4]]) -> Result<Worst, SequenceError> {
        let boxes = self.setting.population.controller;
        let mut all: Vec<([f64; 4], f64)> = Vec::new();
        let corners = (0..16_usize).map(|corner| std::array::from_fn(|i| boxes[i][corner >> i & 1]));
        let middle = boxes.map(|[lower, upper]| 0.5 * (lower + upper));
        for theta in corners.chain([middle]).chain(given.iter().copied()) {
            if all.iter().all(|(known, _)| *known != theta) {
                all.push((theta, self.cost(theta, gamma)?));
            }
        }
        let most = |all: &[([f64; 4], f64)]| all.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1));
        let mut step = 0.5;
        while step >= 0.125 {
            let Some((at, worst)) = most(&all) else { break };
            for i in 0..4 {
                for sign in [1.0, -1.0] {
                    let [lower, upper] = boxes[i];
                    let mut theta = at;
                    theta[i] = (at[i] + sign * step * (upper - lower)).clamp(lower, upper);
                    if all.iter().all(|(known, _)| *known != theta) {
                        all.push((theta, self.cost(theta, gamma)?));
                    }
                }
            }
            if most(&all).is_none_or(|(_, cost)| cost <= worst) {
                step *= 0.5;
            }
        }
        all.sort_by(|a, b| b.1.total_cmp(&a.1));
        all.truncate(KEPT);
        Ok(Worst { gamma, subjects: all })
    }

    /// The whole search from the average subject and a first experiment.
    ///
    /// The answer is the best of all experiments whose worst subject was sought over Θ: that of the average subject,
    /// that of the min-max, and those of the refinement, which minimises the largest cost of the subjects met so far
    /// and adds the worst subject of what it finds (Blankenship and Falk 1976) for at most `rounds` rounds.
    ///
    /// # Errors
    /// [`SequenceError`].
    pub fn run(
        &mut self,
        average: [f64; 4],
        start: [f64; 2],
        iterations: usize,
        rounds: usize,
    ) -> Result<Outcome, SequenceError> {
        let start = self.best_of_grid(average, start)?;
        let (gamma, nominal_cost) =
            self.compass(start, &|search, gamma, enough| search.cost_below(average, gamma, enough))?;
        let nominal = self.worst(gamma, &[average])?;
        let trace = self.min_max(average, start, iterations)?;
        let last = trace.last().copied().unwrap_or(Trace { theta: average, gamma: start, cost: f64::INFINITY });
        let of_min_max = self.worst(last.gamma, &[average, last.theta])?;
        let mut scenarios: Vec<[f64; 4]> = Vec::new();
        let met = |theta: [f64; 4], scenarios: &mut Vec<[f64; 4]>| {
            let is_new = !scenarios.contains(&theta);
            if is_new {
                scenarios.push(theta);
            }
            is_new
        };
        for theta in [nominal.subjects[0].0, of_min_max.subjects[0].0, average] {
            met(theta, &mut scenarios);
        }
        let mut best = if of_min_max.cost() < nominal.cost() { of_min_max } else { nominal.clone() };
        let (mut done, mut closed) = (0, false);
        while done < rounds && !closed {
            done += 1;
            let (gamma, known) = self.compass(best.gamma, &|search, gamma, enough| {
                let mut largest = f64::NEG_INFINITY;
                for theta in &scenarios {
                    largest = largest.max(search.cost_below(*theta, gamma, enough)?);
                    if largest >= enough {
                        break;
                    }
                }
                Ok(largest)
            })?;
            let found = self.worst(gamma, &scenarios)?;
            closed = found.cost() <= CLOSED * known || !met(found.subjects[0].0, &mut scenarios);
            if found.cost() < best.cost() {
                best = found;
            }
        }
        let evaluations = self.known.len() + self.bounds.len();
        Ok(Outcome { nominal, nominal_cost, robust: best, trace, scenarios, rounds: done, closed, evaluations })
    }
}

/// Evaluations of J that [`Search::run`] makes about at most, for progress.
#[must_use]
pub fn expected_evaluations(iterations: usize, rounds: usize) -> u64 {
    (40 + GRID * GRID + 7 * iterations + 2 * 40 + rounds * (40 * 3 + 40)) as u64
}
