//! The best candidate of a pool for both responses.

use super::inputs::no_disturbance;
use crate::analysis::contract::Failure;
use crate::analysis::inputs::pool_problem;
use crate::analysis::problem::{Code, Problem};
use crate::control::{Continuous, Model, System, TransferFunction};
use crate::ctl::Ctl;
use crate::identify::both_stimuli::{DisturbanceLine, PoolSearchError, search};
use crate::identify::pool::{PoolError, Recipe};
use crate::identify::problem::{Lines, Problem as Command};
use crate::identify::ssid::{SsidError, plant_for};
use crate::identify::time::Time;
use crate::two_stimulus::responses::{LineResponse, YD, YR};
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The best candidate of a pool.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PoolResult {
    /// Gff.
    pub feedforward: Model,
    /// Gfb.
    pub feedback: Model,
    /// The plant in the time base of the controllers.
    pub plant: Model,
    /// `J = Σ w_r |G̃_yr − H_yr|² + Σ w_d |G̃_yd − H_yd|²`: no candidate has a smaller one, and none with the same a
    /// lower index.
    pub cost: f64,
    /// The part of J from the disturbance.
    pub disturbance_cost: f64,
    /// Whether lines are weighted by the inverse of their variance, scaled to a mean of 1; all alike otherwise.
    pub weighted: bool,
    /// Candidates in the pool.
    pub pool_size: u64,
    /// Index of the best candidate, from 0.
    pub index: u64,
}

fn failed(error: &SsidError) -> Failure {
    Failure::Problem(pool_problem::problem(error))
}

/// Searches the pool.
pub(super) fn best(
    recipe: &Recipe,
    plant: &System,
    sample_time_s: Option<f64>,
    lines: &[LineResponse],
    max_candidates: u64,
    ctl: &Ctl,
) -> Result<PoolResult, Failure> {
    let plant = plant_for(recipe, plant, sample_time_s).map_err(|error| failed(&error))?;
    let variance = |line: &LineResponse, i: usize| line.covariance.as_ref().map(|c| c[(i, i)].re).filter(|v| *v > 0.0);
    let of = |pick: fn(&LineResponse) -> Option<Complex64>, i: usize| -> Vec<(f64, Complex64, Option<f64>)> {
        lines.iter().filter_map(|line| Some((line.omega_rad_s, pick(line)?, variance(line, i)))).collect()
    };
    let command = of(|line| line.command.map(|h| h[1]), YR);
    let disturbance = of(|line| line.disturbance.map(|h| h[1]), YD);
    if command.is_empty() {
        let detail = "the command excites no line, so nothing determines the feedforward of the pool's candidates";
        return Err(Problem::new(Code::NotIdentifiable, "no feedforward", detail)
            .at("/spec/pool")
            .mend("Add trials with a command, or leave the pool out.")
            .into());
    }
    let inverse: Option<Vec<f64>> = command.iter().chain(&disturbance).map(|(_, _, v)| v.map(|v| 1.0 / v)).collect();
    let weighted = inverse.is_some();
    let weights = inverse.unwrap_or_else(|| vec![1.0; command.len() + disturbance.len()]);
    let mean = weights.iter().sum::<f64>() / weights.len() as f64;
    let weights: Vec<f64> = weights.into_iter().map(|w| w / mean).collect();
    let (own, others) = weights.split_at(command.len());
    let (omega, h): (Vec<f64>, Vec<Complex64>) = command.iter().map(|(w, h, _)| (*w, *h)).unzip();
    let usable = Lines::new(&plant, &omega, &h, Some(own));
    if usable.used.is_empty() {
        return Err(failed(&SsidError::NoLine(omega.len())));
    }
    let problem = Command::new(&usable, recipe.feedforward_numerator_degree)
        .map_err(|error| failed(&SsidError::TooFewLines(error)))?;
    let disturbance: Vec<DisturbanceLine> = disturbance
        .iter()
        .zip(others)
        .map(|((omega_rad_s, response, _), weight)| DisturbanceLine {
            omega_rad_s: *omega_rad_s,
            plant: plant.response(*omega_rad_s),
            response: *response,
            weight: *weight,
        })
        .filter(|line| line.plant.norm().is_finite() && line.plant.norm() > 0.0)
        .collect();
    let pool = recipe.build(&plant, ctl).map_err(|error| match error {
        PoolError::Stopped(stopped) => Failure::Stopped(stopped),
        error => failed(&SsidError::Pool(error)),
    })?;
    let found = search(&problem, &disturbance, &pool, max_candidates, ctl).map_err(|error| match error {
        PoolSearchError::Stopped(stopped) => Failure::Stopped(stopped),
        PoolSearchError::Unaffordable { size, limit } => failed(&SsidError::Unaffordable {
            size,
            feedforward: pool.feedforward().len() as u64,
            feedback: pool.feedback().len(),
            limit,
        }),
        PoolSearchError::NoDisturbance => no_disturbance(lines).into(),
    })?;
    if !found.cost.is_finite() {
        return Err(failed(&SsidError::NotFinite("cost: the data are too large")));
    }
    let system = |num: &[f64], den: &[f64]| match problem.time() {
        Time::Continuous => TransferFunction::new(num, den, Continuous).map(System::Continuous),
        Time::Sampled(time) => TransferFunction::new(num, den, time).map(System::Discrete),
    };
    let candidate = &found.candidate;
    let numerator: Vec<f64> = candidate.feedback_numerator.iter().map(|c| candidate.feedback_gain * c).collect();
    let overflow = |_| failed(&SsidError::NotFinite("feedforward"));
    let feedforward =
        system(&found.feedforward_numerator, &candidate.feedforward_denominator).map_err(overflow)?.to_model();
    let feedback = system(&numerator, &candidate.feedback_denominator).map_err(overflow)?.to_model();
    Ok(PoolResult {
        feedforward,
        feedback,
        plant: plant.to_model(),
        cost: found.cost,
        disturbance_cost: found.disturbance_cost.max(0.0),
        weighted,
        pool_size: pool.size(),
        index: found.index,
    })
}
