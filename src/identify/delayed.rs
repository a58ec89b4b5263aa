//! The pool searched with pure delays in feedback and feedforward: `Gfb e^{−jωτ}`, `Gff e^{−jωσ}`.
//!
//! With `G' = G e^{−jωτ}` the loop is `G̃ = G' (Gff e^{−jω(σ−τ)} + Gfb)/(1 + G' Gfb)`: the problem of
//! [`super::problem`] on the turned plant G', with a feedforward numerator that is turned by `σ − τ` before it splits
//! into its real and imaginary part. So every pair of delays is one search of the pool, with the same bounds and the
//! same proof.
//!
//! # What is proven
//! - *Sampled time*, where delays are whole samples: `G z^{−d}` is a plant like any other, its pool holds the
//!   candidates whose loop is stable with the delay, and the optimum is that of this pool.
//! - *Continuous time*: the pool is that of the plant without delay, and candidates must also be stable with the delay,
//!   as judged by [`roots_right_of`](crate::control::delay::roots_right_of), not by an approximation of it. The search
//!   answers for the whole pool: if its optimum is stable with the delay, it is the optimum of the stable ones; if not,
//!   the near-optimal candidates ([`Optimum::near`], without a gap down to the last of them) are gone through in order
//!   of their cost, and the first that is stable is the optimum. If none of them is, only a lower bound is known, and
//!   that is what is said. Candidates that are stable with the delay but not without are no members of the pool.

use super::pool::{Pool, Recipe};
use super::problem::{Lines, NEAR, Problem};
use super::search::{MOST_NEAR, Optimum, Search};
use super::ssid::{Settings, SsidError, check_size, controllers, plant_for, weights};
use super::time::{Time, multiply};
use crate::control::delay::is_stable_continuous;
use crate::control::{System, TransferFunction};
use crate::ctl::Ctl;
use crate::response::FrequencyData;
use num_complex::Complex64;

/// A pair of delays in seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Of the feedback, τ.
    pub feedback_s: f64,
    /// Of the feedforward, σ.
    pub feedforward_s: f64,
}

/// The best candidate at a pair of delays.
#[derive(Debug, Clone, PartialEq)]
pub struct Best {
    /// Its index in the pool.
    pub index: u64,
    /// J.
    pub cost: f64,
    /// Gff, without its delay.
    pub feedforward: System,
    /// Gfb, without its delay.
    pub feedback: System,
}

/// The answer at a pair of delays.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// The delays.
    pub delays: Pair,
    /// The best candidate that is stable with them; `None` where none of the near-optimal ones is.
    pub best: Option<Best>,
    /// What every candidate that is stable with the delays is proven to cost at least: the cost of the best one, where
    /// there is one.
    pub lower_bound: f64,
    /// Candidates with a smaller cost, all of them unstable with the delay.
    pub unstable: u64,
    /// Candidates of the pool.
    pub pool_size: u64,
}

/// Searches the pool at every pair of delays.
///
/// # Errors
/// [`SsidError`]; [`SsidError::NotFinite`] for a delay that is negative or no number. A sampled pair must be whole
/// samples, which is for the caller to check.
pub fn search_with_delays(
    plant: &System,
    data: &FrequencyData,
    settings: &Settings,
    pairs: &[Pair],
    search: &impl Search,
    ctl: &Ctl,
) -> Result<Vec<Point>, SsidError> {
    let plant = plant_for(&settings.recipe, plant, settings.sample_time_s)?;
    let weights = weights(settings.weights, data)?;
    let lines = Lines::new(&plant, &data.omega_rad_s, &data.h, weights.as_deref());
    if lines.used.is_empty() {
        return Err(SsidError::NoLine(data.omega_rad_s.len()));
    }
    let share = 1.0 / pairs.len() as f64;
    pairs
        .iter()
        .map(|pair| {
            let _one_of_them = ctl.scope(share);
            point(&plant, &lines, settings, *pair, search, ctl)
        })
        .collect()
}

fn point(
    plant: &System,
    lines: &Lines,
    settings: &Settings,
    delays: Pair,
    search: &impl Search,
    ctl: &Ctl,
) -> Result<Point, SsidError> {
    if !(delays.feedback_s >= 0.0
        && delays.feedforward_s >= 0.0
        && (delays.feedback_s + delays.feedforward_s).is_finite())
    {
        return Err(SsidError::NotFinite("delays"));
    }
    let recipe = &settings.recipe;
    let problem = turned(lines, recipe, delays)?;
    let pool = match plant {
        System::Continuous(_) => search.pool(recipe, plant, ctl)?,
        System::Discrete(sampled) => {
            let samples = (delays.feedback_s / sampled.time().period_s()).round() as usize;
            let den = [sampled.den().coefficients(), &vec![0.0; samples]].concat();
            let delayed = TransferFunction::new(sampled.num().coefficients(), &den, sampled.time())
                .map_err(|_| SsidError::NotFinite("plant with delay"))?;
            search.pool(recipe, &System::Discrete(delayed), ctl)?
        }
    };
    check_size(&pool, settings.max_candidates)?;
    ctl.begin_search();
    let optimum = search.search(&problem, &pool, ctl)?;
    if !optimum.cost.is_finite() {
        return Err(SsidError::NotFinite("cost: the data are too large"));
    }
    let mut found = Point { delays, best: None, lower_bound: optimum.cost, unstable: 0, pool_size: pool.size() };
    for (index, cost) in &optimum.near {
        ctl.check()?;
        let (_, [feedforward, feedback]) = controllers(&problem, &pool, *index)?;
        found.lower_bound = *cost;
        if is_stable(plant, &feedback, delays.feedback_s, &pool) {
            found.best = Some(Best { index: *index, cost: *cost, feedforward, feedback });
            return Ok(found);
        }
        found.unstable += 1;
    }
    found.lower_bound = beyond(&optimum);
    Ok(found)
}

/// What candidates outside of the near-optimal ones cost at least.
fn beyond(optimum: &Optimum) -> f64 {
    match optimum.near.last() {
        Some((_, last)) if optimum.near.len() >= MOST_NEAR => *last,
        _ => (1.0 + NEAR) * optimum.cost,
    }
}

/// The problem with delays.
fn turned(lines: &Lines, recipe: &Recipe, delays: Pair) -> Result<Problem, SsidError> {
    let mut lines = lines.clone();
    for line in &mut lines.used {
        line.plant *= Complex64::from_polar(1.0, -line.omega_rad_s * delays.feedback_s);
    }
    let problem = Problem::holding(recipe.held, &lines, recipe.feedforward_numerator_degree)?;
    Ok(problem.with_feedforward_delay(delays.feedforward_s - delays.feedback_s))
}

/// Whether the loop keeps the pool's margin with its delay; in sampled time the pool has seen to that.
pub(super) fn is_stable(plant: &System, feedback: &System, delay_s: f64, pool: &Pool) -> bool {
    let region = pool.region();
    if region.time != Time::Continuous || delay_s == 0.0 {
        return true;
    }
    let open = multiply(plant.den().coefficients(), feedback.den().coefficients());
    let gain = multiply(plant.num().coefficients(), feedback.num().coefficients());
    gain.iter().all(|c| *c == 0.0) || is_stable_continuous(&open, &gain, delay_s, region.margin).unwrap_or(false)
}
