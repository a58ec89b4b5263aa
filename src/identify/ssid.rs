//! Subsystem identification: from a known plant and the closed loop's frequency response to feedforward and feedback.
//!
//! Zhang 2015, algorithms 2.1 and 3.1 (continuous), 5.1 (sampled, FIR feedforward), and the sampled IIR feedforward of
//! example 4.5: of all candidates of a pool, with the best feedforward numerator each, the one whose closed loop `G̃ =
//! G (Gff + Gfb)/(1 + G Gfb)` comes closest to the data in `J = Σ weight |G̃ − H|²`. The algorithms are one: they
//! differ in time base and pool.

use super::basis::TooFewLines;
use super::family::{Member, family};
use super::identifiability::{self, Identifiability};
use super::pool::{Pool, PoolError, Position, Recipe};
use super::problem::{Dropped, Line, Lines, Problem, Unusable};
use super::search::{NEAR, Optimum, Search, exact};
use super::time::Time;
use crate::control::discretise::{DiscretiseError, zero_order_hold};
use crate::control::time_base::BadSampleTime;
use crate::control::{Continuous, Discrete, System, TimeBase, TransferFunction};
use crate::ctl::{Bracket, Ctl, Stopped};
use crate::num::linalg::NoConvergence;
use crate::person::two_degrees_of_freedom::TwoDegreesOfFreedom;
use crate::response::FrequencyData;
use num_complex::Complex64;

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
    /// The plant in the time base of the controllers.
    pub plant: System,
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

/// Below this separation, or above this condition number, feedback and feedforward count as confounded.
const POOR_SEPARATION: f64 = 0.02;
const POOR_CONDITION: f64 = 1e4;

/// Relative difference between J by least squares and J of the reported coefficients that is worth a warning.
const COST_MISMATCH: f64 = 1e-6;

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
    let recipe = &settings.recipe;
    let plant = plant_for(recipe, plant, settings.sample_time_s)?;
    let weights = weights(settings.weights, data)?;
    let lines = Lines::new(&plant, &data.omega_rad_s, &data.h, weights.as_deref());
    if lines.used.is_empty() {
        return Err(SsidError::NoLine(data.omega_rad_s.len()));
    }
    let problem = Problem::new(&lines, recipe.feedforward_numerator_degree)?;
    let structure = recipe.structure();
    let (equations, unknowns) = (identifiability::equations(&problem), structure.unknowns());
    if equations < unknowns {
        return Err(SsidError::Underdetermined { lines: lines.used.len(), equations, unknowns });
    }

    let pool = search.pool(recipe, &plant, ctl)?;
    check_size(&pool, settings.max_candidates)?;
    ctl.begin_search();
    let optimum = search.search(&problem, &pool, ctl).map_err(|stopped| interrupted(stopped, &problem, &pool, ctl))?;
    if !optimum.cost.is_finite() {
        return Err(SsidError::NotFinite("cost: the data are too large"));
    }
    // Found and proven, by QR; whoever stops what follows still has it.
    ctl.begin_search();
    ctl.set_bracket(Bracket { incumbent: optimum.cost, bound: optimum.cost, index: optimum.index });
    let time = pool.region().time;
    let (_, [feedforward, feedback]) = controllers(&problem, &pool, optimum.index)?;
    let (closed_loop_poles, model) = closed_loop(&plant, &feedforward, &feedback, &lines.used)?;
    let slowest_exponent = time.slowest_exponent(&closed_loop_poles).filter(|e| e.is_finite());
    let cost_of_coefficients =
        lines.used.iter().zip(&model).map(|(line, g)| line.weight * (g - line.response).norm_sqr()).sum();
    let mut identified = Identified {
        identifiability: identifiability::judge(&problem, structure, &feedforward, &feedback),
        plant,
        feedforward,
        feedback,
        cost_of_coefficients,
        pool_size: pool.size(),
        feedforward_denominators: pool.feedforward().len() as u64,
        feedback_controllers: pool.feedback().len(),
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
    Ok(identified)
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
    let candidate = pool.candidate(pool.position(index));
    let fit = exact::fit(problem, &candidate);
    let numerator: Vec<f64> = candidate.feedback_numerator.iter().map(|c| candidate.feedback_gain * c).collect();
    let time = pool.region().time;
    let feedforward = system(time, &fit.feedforward_numerator, &candidate.feedforward_denominator, "feedforward")?;
    let feedback = system(time, &numerator, &candidate.feedback_denominator, "feedback")?;
    Ok((fit.cost, [feedforward, feedback]))
}

/// What a stopped search leaves. Its incumbent gets the cost by QR, which is what a finished search would have said.
fn interrupted(stopped: Stopped, problem: &Problem, pool: &Pool, ctl: &Ctl) -> SsidError {
    let Some(bracket) = ctl.bracket().filter(|bracket| bracket.index < pool.size()) else { return stopped.into() };
    let Ok((cost, [feedforward, feedback])) = controllers(problem, pool, bracket.index) else { return stopped.into() };
    ctl.set_bracket(Bracket { incumbent: cost, ..bracket });
    SsidError::Interrupted(Box::new(Interrupted { stopped, feedforward, feedback }))
}

fn system(time: Time, num: &[f64], den: &[f64], part: &'static str) -> Result<System, SsidError> {
    match time {
        Time::Continuous => TransferFunction::new(num, den, Continuous).map(System::Continuous),
        Time::Sampled(time) => TransferFunction::new(num, den, time).map(System::Discrete),
    }
    .map_err(|_| SsidError::NotFinite(part))
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

fn findings(found: &Identified, recipe: &Recipe, pool: &Pool, position: Position) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut say = |code: &'static str, message: String| findings.push(Finding { code, message });
    for (why, code, words) in [
        (
            Unusable::PlantPole,
            "line_on_plant_pole",
            "a plant pole lies there, and the response tells nothing about the feedforward relative to the plant",
        ),
        (Unusable::PlantZero, "line_on_plant_zero", "the plant transmits nothing there, whatever the person does"),
        (Unusable::NoResponse, "line_without_response", "there is no finite response"),
        (Unusable::NoWeight, "line_without_weight", "its variance gives no positive weight"),
        (Unusable::AboveNyquist, "line_above_nyquist", "it lies above the Nyquist frequency"),
    ] {
        let lines: Vec<String> = found
            .dropped
            .iter()
            .filter(|dropped| dropped.why == why)
            .map(|dropped| format!("{:.4}", dropped.omega_rad_s / std::f64::consts::TAU))
            .collect();
        if !lines.is_empty() {
            say(code, format!("left out at {} Hz: {words}", lines.join(", ")));
        }
    }

    let structure = recipe.structure();
    let (np, dp) = (found.plant.num().degree(), found.plant.den().degree());
    let wanted = dp
        + structure.feedforward_denominator
        + structure.feedback_denominator
        + np
        + (structure.feedforward_numerator + structure.feedback_denominator)
            .max(structure.feedback_numerator + structure.feedforward_denominator);
    if found.lines.len() <= wanted {
        say(
            "few_lines",
            format!(
                "{} frequency lines; more than {wanted} are needed to make sure that no other controllers of these \
                 degrees \
                 have the same closed loop (Zhang 2015, assumption A2.3)",
                found.lines.len()
            ),
        );
    }
    if position.feedback.gain == 0.0 {
        say(
            "zero_feedback",
            "the best candidate has no feedback at all; its feedback denominator means nothing".to_owned(),
        );
    }
    let judged = &found.identifiability;
    let poor = judged.separation.is_some_and(|s| s < POOR_SEPARATION)
        || judged.condition_number.is_none_or(|c| c > POOR_CONDITION);
    let numbers = format!(
        "separation {} (1: unlike, 0: confounded), condition number {}",
        judged.separation.map_or_else(|| "undefined".to_owned(), |s| format!("{s:.2e}")),
        judged.condition_number.map_or_else(|| "undefined".to_owned(), |c| format!("{c:.2e}")),
    );
    if poor && position.feedback.gain != 0.0 {
        say(
            "feedback_poorly_determined",
            format!(
                "one response cannot tell two controllers apart but by their assumed degrees, and here it hardly does: \
                 {numbers}. \
                 Feedback and feedforward of much the same cost may differ a lot; a second stimulus at the plant's \
                 input would separate them"
            ),
        );
    } else {
        say(
            "feedback_from_structure",
            format!(
                "feedback and feedforward are told apart only by their assumed degrees (Zhang 2015, example 2.1); \
                 {numbers}. \
                 They describe the modelled loop on the known plant, which is no proof about the person"
            ),
        );
    }
    let near = found.optimum.near_optimal;
    if near > 1 {
        say(
            "near_optimal_candidates",
            format!("{near} candidates of the pool cost at most {:.0} % more than the best one", 100.0 * NEAR),
        );
    }
    for edge in recipe.edges(pool, position) {
        say(
            "edge_of_pool",
            format!("the best candidate lies on the edge of the pool: {edge}; a wider pool may hold a better one"),
        );
    }
    let mismatch = (found.cost_of_coefficients - found.optimum.cost).abs();
    let scale: f64 = found.lines.iter().map(|(line, _)| line.weight * line.response.norm_sqr()).sum();
    if mismatch > COST_MISMATCH * found.optimum.cost && mismatch > 1e-12 * scale {
        say(
            "ill_conditioned_coefficients",
            format!(
                "the coefficients as written give the cost {:.6e} instead of {:.6e}: the feedforward numerator is too \
                 high in degree \
                 for its lines to be written in powers of the variable",
                found.cost_of_coefficients, found.optimum.cost
            ),
        );
    }
    findings
}
