//! The result of an identification.

use super::delayed::DelayedPool;
use super::equivalent::EquivalentSet;
use super::family::NearOptimal;
use super::refined::RefinedResult;
use super::restricted_fit::RestrictedFit;
use super::structures::StructureComparison;
use crate::control::Model;
use crate::identify::identifiability::Identifiability;
use crate::identify::search::Method;
use crate::identify::ssid::Identified;
use crate::learning::frequency_domain::ControllerMetrics;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Why the best candidate is the best one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Certificate {
    /// True: no candidate of the pool has a smaller cost, and none with the same cost a lower index.
    pub exact: bool,
    /// How it was found.
    pub method: Method,
    /// Candidates in the pool, M = M_ff · M_fb.
    pub pool_size: u64,
    /// M_ff, the stable feedforward denominators.
    pub feedforward_denominators: u64,
    /// M_fb, the feedback controllers with a stable loop.
    pub feedback_controllers: u64,
    /// Index of the best candidate, from 0: feedback controller times M_ff plus feedforward denominator.
    pub index: u64,
    /// J once more, from the coefficients of the transfer functions as written here.
    pub cost_of_coefficients: f64,
}

/// Closed-loop stability.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Stability {
    /// Largest real part of the continuous-time exponents of the closed-loop poles, in 1/s; null where every pole is at
    /// the origin of z.
    pub largest_exponent_per_s: Option<f64>,
    /// Largest modulus of the poles; null in continuous time.
    pub spectral_radius: Option<f64>,
    /// Every candidate's exponents have real parts below minus this, in 1/s.
    pub margin_per_s: f64,
}

/// A frequency line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Fit {
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// The data.
    pub h: [f64; 2],
    /// The identified closed loop.
    pub model: [f64; 2],
    /// model − h.
    pub residual: [f64; 2],
    /// Weight of its squared modulus in the cost.
    pub weight: f64,
}

/// The share of the recorded variation that the identified loop explains, simulated from the command (and the
/// disturbance, where recorded) of the trial itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SimulatedVafResult {
    /// Of the output; the mean over the trials.
    pub y: Option<f64>,
    /// Of the control; the mean over the trials.
    pub u: Option<f64>,
    /// Of the output within the band of `metrics`; the mean over the trials.
    #[serde(default)]
    pub y_in_band: Option<f64>,
    /// Of the control within the band of `metrics`; the mean over the trials.
    #[serde(default)]
    pub u_in_band: Option<f64>,
    /// Trial by trial.
    pub trials: Vec<TrialVaf>,
}

/// One trial's share.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrialVaf {
    /// The trial, by its place in the request.
    pub trial: String,
    /// Of the output.
    pub y: Option<f64>,
    /// Of the control.
    pub u: Option<f64>,
    /// Of the output's sinusoids within the band of `metrics`; above it the model is not constrained by the data.
    #[serde(default)]
    pub y_in_band: Option<f64>,
    /// Of the control's.
    #[serde(default)]
    pub u_in_band: Option<f64>,
    /// Why one of them is null.
    pub reason: Option<String>,
}

/// The result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SsidResult {
    /// Gff.
    pub feedforward: Model,
    /// Gfb.
    pub feedback: Model,
    /// The plant in the time base of the controllers (a continuous plant behind a zero-order hold, if they are
    /// sampled).
    pub plant: Model,
    /// `J = Σ weight |model − h|²` at the best candidate, by QR.
    pub cost: f64,
    /// Why it is the best one.
    pub certificate: Certificate,
    /// Candidates that fit nearly as well: how flat the optimum is.
    pub near_optimal: NearOptimal,
    /// The candidates that the data cannot tell from the best one; null where there is no such set.
    pub equivalent: Option<EquivalentSet>,
    /// Why `equivalent` is null.
    pub equivalent_reason: Option<String>,
    /// The pool searched with delays; null where the spec does not ask for that.
    #[serde(default)]
    pub delayed: Option<DelayedPool>,
    /// Poles of the closed loop as `[re, im]`: of the feedforward, then of the feedback loop.
    pub closed_loop_poles: Vec<[f64; 2]>,
    /// Closed-loop stability.
    pub stability: Stability,
    /// Line by line.
    pub fit: Vec<Fit>,
    /// How well the lines tell the coefficients apart.
    pub identifiability: Identifiability,
    /// Norms over the band.
    pub metrics: ControllerMetrics,
    /// Simulation on the trials; null without trials.
    pub simulated_vaf: Option<SimulatedVafResult>,
    /// Why `simulated_vaf` is null.
    pub simulated_vaf_reason: Option<String>,
    /// `simulated_vaf.y_in_band` once more, as a number on its own.
    pub variance_accounted_for: Option<f64>,
    /// A local optimum near the best candidate, with its uncertainty; null where there is none.
    pub refined: Option<RefinedResult>,
    /// Why `refined` is null.
    pub refined_reason: Option<String>,
    /// Simulation on trials that were not fitted; null where none were named.
    pub held_out: Option<HeldOut>,
    /// Structures compared; null where the spec lists none.
    pub structures: Option<StructureComparison>,
    /// Fits with a controller held at zero; null where the spec lists none.
    #[serde(default)]
    pub restrictions: Option<Vec<RestrictedFit>>,
}

/// Simulation on trials that were not fitted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HeldOut {
    /// By the pool's best candidate.
    pub pool: SimulatedVafResult,
    /// By the refined controllers; null where there are none.
    pub refined: Option<SimulatedVafResult>,
}

impl SimulatedVafResult {
    pub(super) fn of(trials: Vec<TrialVaf>) -> Self {
        Self {
            y: mean(trials.iter().map(|t| t.y)),
            u: mean(trials.iter().map(|t| t.u)),
            y_in_band: mean(trials.iter().map(|t| t.y_in_band)),
            u_in_band: mean(trials.iter().map(|t| t.u_in_band)),
            trials,
        }
    }
}

fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let values: Option<Vec<f64>> = values.collect();
    crate::num::stats::mean(&values?)
}

impl SsidResult {
    pub(super) fn new(
        found: &Identified,
        metrics: ControllerMetrics,
        trials: Vec<TrialVaf>,
        is_frequency_data: bool,
    ) -> Self {
        let simulated_vaf = (!is_frequency_data).then(|| SimulatedVafResult::of(trials));
        Self {
            feedforward: found.feedforward.to_model(),
            feedback: found.feedback.to_model(),
            plant: found.plant.to_model(),
            cost: found.optimum.cost,
            certificate: Certificate {
                exact: true,
                method: found.optimum.method,
                pool_size: found.pool_size,
                feedforward_denominators: found.feedforward_denominators,
                feedback_controllers: found.feedback_controllers,
                index: found.optimum.index,
                cost_of_coefficients: found.cost_of_coefficients,
            },
            near_optimal: NearOptimal::new(found, (metrics.band_rad_s[0], metrics.band_rad_s[1])),
            equivalent: None,
            equivalent_reason: None,
            delayed: None,
            closed_loop_poles: found.closed_loop_poles.iter().map(|p| [p.re, p.im]).collect(),
            stability: Stability {
                largest_exponent_per_s: found.slowest_exponent,
                spectral_radius: found
                    .plant
                    .sample_time_s()
                    .map(|_| found.closed_loop_poles.iter().map(|p| p.norm()).fold(0.0, f64::max)),
                margin_per_s: found.stability_margin,
            },
            fit: found
                .lines
                .iter()
                .map(|(line, model)| {
                    let residual = model - line.response;
                    Fit {
                        omega_rad_s: line.omega_rad_s,
                        h: [line.response.re, line.response.im],
                        model: [model.re, model.im],
                        residual: [residual.re, residual.im],
                        weight: line.weight,
                    }
                })
                .collect(),
            identifiability: found.identifiability.clone(),
            metrics,
            variance_accounted_for: simulated_vaf.as_ref().and_then(|v| v.y_in_band),
            simulated_vaf,
            simulated_vaf_reason: is_frequency_data
                .then(|| "the request carries frequency data, and no trial to simulate".to_owned()),
            refined: None,
            refined_reason: None,
            held_out: None,
            structures: None,
            restrictions: None,
        }
    }
}
