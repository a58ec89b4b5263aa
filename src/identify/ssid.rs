//! Subsystem identification: from a known plant and the closed loop's frequency response to feedforward and feedback.
//!
//! Zhang 2015, algorithms 2.1 and 3.1 (continuous), 5.1 (sampled, FIR feedforward), and the sampled IIR feedforward of
//! example 4.5: of all candidates of a pool, with the best feedforward numerator each, the one whose closed loop `G̃ =
//! G (Gff + Gfb)/(1 + G Gfb)` comes closest to the data in `J = Σ weight |G̃ − H|²`. The algorithms are one: they
//! differ in time base and pool.

use super::basis::TooFewLines;
use super::delayed::is_stable;
use super::family::{Member, family};
use super::findings::findings;
use super::identifiability::{self, Identifiability, Structure};
use super::pool::{Pool, PoolError, Recipe};
use super::problem::{Dropped, Line, Lines, Problem};
use super::search::screen::systems::{NotFinite, systems};
use super::search::{MOST_NEAR, Optimum, Prepared, Search};
use crate::control::discretise::{DiscretiseError, zero_order_hold};
use crate::control::model::whole_samples;
use crate::control::time_base::BadSampleTime;
use crate::control::{Discrete, ModelError, System, TimeBase, TransferFunction};
use crate::ctl::{Bracket, Ctl, Stopped};
use crate::num::linalg::NoConvergence;
use crate::person::two_degrees_of_freedom::TwoDegreesOfFreedom;
use crate::response::FrequencyData;
use num_complex::Complex64;
use std::sync::Arc;

/// How lines are weighted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Weights {
    /// All alike, as Zhang 2015 does.
    #[default]
    Uniform,
    /// By the inverse of each line's variance, scaled to a mean of 1.
    InverseVariance,
}

/// What is identified, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The pool.
    pub recipe: Recipe,
    /// How lines are weighted.
    pub weights: Weights,
    /// The sample time of sampled controllers on a continuous plant.
    pub sample_time_s: Option<f64>,
    /// Larger pools are refused.
    pub max_candidates: u64,
}

/// Why nothing was identified.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SsidError {
    /// Somebody asked it to stop, before a candidate was found.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// Somebody asked it to stop, and these are the best controllers found until then.
    #[error("{}", .0.stopped)]
    Interrupted(Box<Interrupted>),
    /// Recipe and plant make no pool.
    #[error(transparent)]
    Pool(PoolError),
    /// The pool is larger than allowed.
    #[error(
        "the pool holds {size} candidates ({feedforward} feedforward denominators, {feedback} feedback controllers), \
         and at most {limit} are searched"
    )]
    Unaffordable {
        /// Candidates.
        size: u64,
        /// Feedforward denominators among them.
        feedforward: u64,
        /// Feedback controllers among them.
        feedback: u64,
        /// The limit.
        limit: u64,
    },
    /// Sampled controllers on a continuous plant, and no sample time.
    #[error("the pool is sampled and the plant continuous, and there is no sample time to discretise it with")]
    NoSampleTime,
    /// The sample time is not positive.
    #[error(transparent)]
    SampleTime(#[from] BadSampleTime),
    /// A delay of the plant that its controllers cannot have.
    #[error(transparent)]
    PlantDelay(#[from] ModelError),
    /// No near-optimal candidate is stable with the plant's delay.
    #[error(
        "the {tried} candidates that fit best are all unstable with the plant's delay of {delay_s} s (they are stable \
         without it)"
    )]
    UnstableWithDelay {
        /// Candidates tried.
        tried: usize,
        /// The delay.
        delay_s: f64,
    },
    /// The plant cannot be discretised.
    #[error(transparent)]
    Discretise(#[from] DiscretiseError),
    /// Weights by variance without variances.
    #[error("the data have no variance, which the weights need")]
    NoVariance,
    /// None of the lines can be used.
    #[error("none of the {0} frequency lines can be used")]
    NoLine(usize),
    /// The lines do not determine the feedforward numerator.
    #[error(transparent)]
    TooFewLines(#[from] TooFewLines),
    /// Fewer equations than unknowns: every pool would fit.
    #[error("the {lines} usable frequency lines give {equations} equations for {unknowns} unknown coefficients")]
    Underdetermined {
        /// Usable lines.
        lines: usize,
        /// Real equations.
        equations: usize,
        /// Unknown coefficients.
        unknowns: usize,
    },
    /// The closed-loop poles were not found.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
    /// The cost or a coefficient of the identified controllers overflows.
    #[error("not finite: {0}")]
    NotFinite(&'static str),
}

impl From<PoolError> for SsidError {
    fn from(error: PoolError) -> Self {
        match error {
            PoolError::Stopped(stopped) => Self::Stopped(stopped),
            error => Self::Pool(error),
        }
    }
}

/// What a stopped search had found. Its cost and how far it may be from the smallest one are in [`Ctl::bracket`].
#[derive(Debug, Clone, PartialEq)]
pub struct Interrupted {
    /// Why it was stopped.
    pub stopped: Stopped,
    /// Gff of the incumbent.
    pub feedforward: System,
    /// Gfb of the incumbent.
    pub feedback: System,
}

/// A finding that must be read before the result is used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// A stable name, in `snake_case`.
    pub code: &'static str,
    /// The finding, in words and numbers.
    pub message: String,
}

/// The identified controllers.
#[derive(Debug, Clone, PartialEq)]
pub struct Identified {
    /// The plant in the time base of the controllers, without `plant_delay_s`.
    pub plant: System,
    /// The delay behind a continuous plant, in seconds; of a sampled one it is part of the plant.
    pub plant_delay_s: f64,
    /// Gff.
    pub feedforward: System,
    /// Gfb.
    pub feedback: System,
    /// The best candidate and how it was found; its cost is J.
    pub optimum: Optimum,
    /// J of the transfer functions as reported, from their coefficients.
    pub cost_of_coefficients: f64,
    /// Size of the pool.
    pub pool_size: u64,
    /// Feedforward denominators of the pool.
    pub feedforward_denominators: u64,
    /// Feedback controllers of the pool.
    pub feedback_controllers: u64,
    /// The controllers of the near-optimal candidates in [`Optimum::near`], the best one first.
    pub family: Vec<Member>,
    /// A difference of costs that rounding alone can make.
    pub rounding: f64,
    /// Poles of the closed loop: of the feedforward, then of the feedback loop.
    pub closed_loop_poles: Vec<Complex64>,
    /// Largest real part of their exponents in 1/s; `None` where there is no pole with a finite one.
    pub slowest_exponent: Option<f64>,
    /// The margin that the pool keeps, in 1/s.
    pub stability_margin: f64,
    /// The lines, with the modelled response at each.
    pub lines: Vec<(Line, Complex64)>,
    /// Lines that were left out.
    pub dropped: Vec<Dropped>,
    /// How well the lines determine the coefficients.
    pub identifiability: Identifiability,
    /// What must be read.
    pub findings: Vec<Finding>,
}

/// What an identification searched, for whoever has more to ask about it.
#[derive(Debug)]
pub struct Searched {
    /// What candidates are judged by.
    pub problem: Problem,
    /// The candidates.
    pub pool: Arc<Pool>,
    /// What the search had prepared, if anything.
    pub prepared: Option<Prepared>,
    /// The degrees of the controllers.
    pub structure: Structure,
}

/// The plant in the time base that the recipe asks for: a continuous plant with sampled controllers goes through a
/// zero-order hold (Zhang 2015, section 5.6.1).
///
/// # Errors
/// [`SsidError`] where there is no sample time or the plant cannot be discretised.
pub fn plant_for(recipe: &Recipe, plant: &System, sample_time_s: Option<f64>) -> Result<System, SsidError> {
    match (plant, recipe.sampled) {
        (System::Continuous(continuous), Some(true)) => {
            let time = Discrete::new(sample_time_s.ok_or(SsidError::NoSampleTime)?)?;
            Ok(System::Discrete(zero_order_hold(continuous, time)?))
        }
        _ => Ok(plant.clone()),
    }
}

/// Identifies feedforward and feedback with a search of one's choice.
///
/// # Errors
/// [`SsidError`].
pub fn identify(
    plant: &System,
    data: &FrequencyData,
    settings: &Settings,
    search: &impl Search,
    ctl: &Ctl,
) -> Result<Identified, SsidError> {
    identify_delayed(plant, 0.0, data, settings, search, ctl)
}

/// [`identify`] with a known delay behind a continuous plant, `G e^{−sτ}`.
///
/// With sampled controllers the plant and its delay, whole samples, go through the hold together. With continuous ones
/// the lines have the plant with its delay, the pool holds what is stable without the delay, and of its near-optimal
/// candidates the first counts whose loop is stable with the delay too, as [`delayed`](super::delayed) has it.
///
/// # Errors
/// [`SsidError`]; [`SsidError::UnstableWithDelay`] where none of the near-optimal candidates is stable with it.
pub fn identify_delayed(
    plant: &System,
    plant_delay_s: f64,
    data: &FrequencyData,
    settings: &Settings,
    search: &impl Search,
    ctl: &Ctl,
) -> Result<Identified, SsidError> {
    identify_searched(plant, plant_delay_s, data, settings, search, ctl).map(|(identified, _)| identified)
}

/// [`identify_delayed`], and what was searched.
///
/// # Errors
/// [`SsidError`].
pub fn identify_searched(
    plant: &System,
    plant_delay_s: f64,
    data: &FrequencyData,
    settings: &Settings,
    search: &impl Search,
    ctl: &Ctl,
) -> Result<(Identified, Searched), SsidError> {
    let recipe = &settings.recipe;
    let plant = plant_for(recipe, plant, settings.sample_time_s)?;
    let (plant, plant_delay_s) = match plant {
        System::Discrete(sampled) => (System::Discrete(behind(&sampled, plant_delay_s)?), 0.0),
        continuous @ System::Continuous(_) => (continuous, plant_delay_s),
    };
    let weights = weights(settings.weights, data)?;
    let lines = Lines::new(&plant, &data.omega_rad_s, &data.h, weights.as_deref());
    if lines.used.is_empty() {
        return Err(SsidError::NoLine(data.omega_rad_s.len()));
    }
    let mut turned = lines.clone();
    for line in &mut turned.used {
        line.plant *= Complex64::from_polar(1.0, -line.omega_rad_s * plant_delay_s);
    }
    let problem = Problem::holding(recipe.held, &turned, recipe.feedforward_numerator_degree)?;
    let structure = recipe.structure();
    let (equations, unknowns) = (identifiability::equations(&problem), structure.unknowns());
    if equations < unknowns {
        return Err(SsidError::Underdetermined { lines: lines.used.len(), equations, unknowns });
    }

    let pool = search.pool(recipe, &plant, ctl)?;
    check_size(&pool, settings.max_candidates)?;
    ctl.begin_search();
    let prepared = search.prepare(&problem, &pool, ctl)?;
    let mut optimum = search
        .search_prepared(&problem, &pool, prepared.as_ref(), ctl)
        .map_err(|stopped| interrupted(stopped, &problem, &pool, ctl))?;
    if !optimum.cost.is_finite() {
        return Err(SsidError::NotFinite("cost: the data are too large"));
    }
    keep_stable(&mut optimum, &problem, &pool, &plant, plant_delay_s, ctl)?;
    // Found and proven, by QR; whoever stops what follows still has it.
    ctl.begin_search();
    ctl.set_bracket(Bracket { incumbent: optimum.cost, bound: optimum.cost, index: optimum.index });
    let time = pool.region().time;
    let (_, [feedforward, feedback]) = controllers(&problem, &pool, optimum.index)?;
    let (closed_loop_poles, model) = closed_loop(&plant, &feedforward, &feedback, &lines.used)?;
    let (closed_loop_poles, model) = if plant_delay_s > 0.0 {
        // A loop with a delay has poles without end, and these are not among them.
        (Vec::new(), turned.used.iter().map(|line| responds(line, &feedforward, &feedback)).collect())
    } else {
        (closed_loop_poles, model)
    };
    let slowest_exponent = time.slowest_exponent(&closed_loop_poles).filter(|e| e.is_finite());
    let cost_of_coefficients =
        lines.used.iter().zip(&model).map(|(line, g)| line.weight * (g - line.response).norm_sqr()).sum();
    let mut identified = Identified {
        identifiability: identifiability::judge(&problem, structure, &feedforward, &feedback),
        plant,
        plant_delay_s,
        feedforward,
        feedback,
        cost_of_coefficients,
        pool_size: pool.size(),
        feedforward_denominators: pool.feedforward().len() as u64,
        feedback_controllers: pool.feedback().len(),
        rounding: problem.rounding(),
        family: family(&problem, &pool, &optimum)?,
        closed_loop_poles,
        slowest_exponent,
        stability_margin: pool.region().margin,
        lines: lines.used.iter().copied().zip(model).collect(),
        dropped: lines.dropped,
        findings: Vec::new(),
        optimum,
    };
    identified.findings = findings(&identified, recipe, &pool, pool.position(identified.optimum.index));
    Ok((identified, Searched { problem, pool, prepared, structure }))
}

/// A sampled plant with a delay of whole samples.
fn behind(plant: &TransferFunction<Discrete>, delay_s: f64) -> Result<TransferFunction<Discrete>, SsidError> {
    let samples = whole_samples(delay_s, plant.time().period_s())?;
    let den = [plant.den().coefficients(), &vec![0.0; samples]].concat();
    TransferFunction::new(plant.num().coefficients(), &den, plant.time())
        .map_err(|_| SsidError::NotFinite("plant with delay"))
}

/// The response from command to output at a line whose plant is given there.
fn responds(line: &Line, feedforward: &System, feedback: &System) -> Complex64 {
    let (gff, gfb) = (feedforward.response(line.omega_rad_s), feedback.response(line.omega_rad_s));
    line.plant * (gff + gfb) / (1.0 + line.plant * gfb)
}

/// Leaves of an optimum and its family what is stable with the plant's delay.
fn keep_stable(
    optimum: &mut Optimum,
    problem: &Problem,
    pool: &Pool,
    plant: &System,
    delay_s: f64,
    ctl: &Ctl,
) -> Result<(), SsidError> {
    if delay_s == 0.0 {
        return Ok(());
    }
    let tried = optimum.near.len();
    let mut stable = Vec::with_capacity(tried);
    for (index, cost) in &optimum.near {
        ctl.check()?;
        let (_, [_, feedback]) = controllers(problem, pool, *index)?;
        if is_stable(plant, &feedback, delay_s, pool) {
            stable.push((*index, *cost));
        }
    }
    let Some((index, cost)) = stable.first().copied() else {
        return Err(SsidError::UnstableWithDelay { tried, delay_s });
    };
    // Up to which cost all candidates were tried; the family of the one that is left ends there.
    let limit = problem.near_limit(cost);
    let whole = problem.near_limit(optimum.cost);
    stable.retain(|(_, cost)| *cost <= limit);
    (optimum.index, optimum.cost) = (index, cost);
    optimum.near_optimal = stable.len() as u64;
    optimum.near = stable;
    optimum.near_is_cut = limit > whole || tried >= MOST_NEAR;
    Ok(())
}

pub(super) fn weights(weights: Weights, data: &FrequencyData) -> Result<Option<Vec<f64>>, SsidError> {
    match weights {
        Weights::Uniform => Ok(None),
        Weights::InverseVariance => {
            let variance = data.variance.as_ref().ok_or(SsidError::NoVariance)?;
            let inverse: Vec<f64> = variance.iter().map(|v| 1.0 / v).collect();
            let usable: Vec<f64> = inverse.iter().copied().filter(|w| w.is_finite() && *w > 0.0).collect();
            let mean = crate::num::stats::mean(&usable).ok_or(SsidError::NoVariance)?;
            Ok(Some(inverse.into_iter().map(|w| w / mean).collect()))
        }
    }
}

/// Refuses a pool that is larger than allowed.
pub(super) fn check_size(pool: &Pool, limit: u64) -> Result<(), SsidError> {
    if pool.size() > limit {
        let (feedforward, feedback) = (pool.feedforward().len() as u64, pool.feedback().len());
        return Err(SsidError::Unaffordable { size: pool.size(), feedforward, feedback, limit });
    }
    Ok(())
}

/// A candidate with its best feedforward numerator: its cost by QR, and Gff and Gfb.
pub(super) fn controllers(problem: &Problem, pool: &Pool, index: u64) -> Result<(f64, [System; 2]), SsidError> {
    systems(problem, pool, &pool.candidate(pool.position(index))).map_err(|NotFinite(part)| SsidError::NotFinite(part))
}

/// What a stopped search leaves. Its incumbent gets the cost by QR, which is what a finished search would have said.
fn interrupted(stopped: Stopped, problem: &Problem, pool: &Pool, ctl: &Ctl) -> SsidError {
    let Some(bracket) = ctl.bracket().filter(|bracket| bracket.index < pool.size()) else { return stopped.into() };
    let Ok((cost, [feedforward, feedback])) = controllers(problem, pool, bracket.index) else { return stopped.into() };
    ctl.set_bracket(Bracket { incumbent: cost, ..bracket });
    SsidError::Interrupted(Box::new(Interrupted { stopped, feedforward, feedback }))
}

/// Poles, and the response from command to output at the lines.
fn closed_loop(
    plant: &System,
    feedforward: &System,
    feedback: &System,
    lines: &[Line],
) -> Result<(Vec<Complex64>, Vec<Complex64>), SsidError> {
    fn of<T: TimeBase>(
        plant: &TransferFunction<T>,
        feedforward: &TransferFunction<T>,
        feedback: &TransferFunction<T>,
        lines: &[Line],
    ) -> Result<(Vec<Complex64>, Vec<Complex64>), SsidError> {
        let closed = TwoDegreesOfFreedom::new(plant.clone(), feedforward.clone(), feedback.clone())
            .map_err(|_| SsidError::NotFinite("closed loop"))?;
        let model = lines.iter().map(|line| closed.command_to_output(line.omega_rad_s)).collect();
        Ok((closed.poles()?, model))
    }
    match (plant, feedforward, feedback) {
        (System::Continuous(g), System::Continuous(ff), System::Continuous(fb)) => of(g, ff, fb, lines),
        (System::Discrete(g), System::Discrete(ff), System::Discrete(fb)) => of(g, ff, fb, lines),
        // The controllers were made in the plant's time base.
        _ => Err(SsidError::NotFinite("time bases of plant and controllers")),
    }
}
