//! The population and the experiments, as people write them.

use super::refusal::{TITLE, wrong};
use crate::analysis::contract::{Inputs, Part};
use crate::analysis::problem::Problem;
use crate::analysis::reading;
use crate::plants::head_neck::{Axis, DERIVATIVE_FILTER_S, MUSCLE_LAG_S};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Ranges of the controller's parameters that differ from those of Tables 2.1 and 2.2, each `[least, largest]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(rename = "RobustInputDesignControllerRanges")]
pub struct ControllerRanges {
    /// Least and largest proportional gain K_p, in N m/rad. Default: that of the tables.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_p: Option<[f64; 2]>,
    /// Least and largest derivative gain K_d, in N m s/rad. Default: that of the tables.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_d: Option<[f64; 2]>,
    /// Least and largest integral gain K_i, in N m/(rad s). Default: that of the tables.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_i: Option<[f64; 2]>,
    /// Least and largest delay τ, in s. Default: that of the tables.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tau: Option<[f64; 2]>,
}

/// What differs from Tables 2.1 to 2.4 and the weights of §2.2.3.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(rename = "RobustInputDesignPopulation")]
pub struct PopulationInput {
    /// Ranges of the controller's parameters.
    pub controller: ControllerRanges,
    /// Mean inertia of the head, in kg m². Default: that of Table 2.3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inertia: Option<f64>,
    /// Mean damping of the neck, in N m s/rad. Default: that of Table 2.3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damping: Option<f64>,
    /// Mean stiffness of the neck, in N m/rad. Default: that of Table 2.3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<f64>,
    /// T_v, in N m: the noise of the muscle's torque is uniform between −T_v and T_v. Default: that of Table 2.4.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_nm: Option<f64>,
    /// T_M, the largest torque, in N m. Default: that of Table 2.4.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub torque_nm: Option<f64>,
    /// ρ_M, the largest angle of linear motion, in rad. Default: that of Table 2.4.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angle_rad: Option<f64>,
    /// ρ̈_M, the largest comfortable acceleration, in rad/s². Default: that of Table 2.4.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceleration_rad_s2: Option<f64>,
    /// W_a, W_T and W_n, dimensionless: the weights of excursions beyond the limits of acceleration, torque and angle.
    /// Default: those of §2.2.3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<[f64; 3]>,
}

/// The inputs of `robust_input_design`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobustInputDesignInputs {
    /// About which axis the head turns: which of the tables.
    pub axis: Axis,
    /// What differs from the tables.
    #[serde(default)]
    pub population: PopulationInput,
}

/// A subject's controller.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "RobustInputDesignSubject")]
pub struct SubjectSpec {
    /// The proportional gain K_p, in N m/rad.
    pub k_p: f64,
    /// The derivative gain K_d, in N m s/rad.
    pub k_d: f64,
    /// The integral gain K_i, in N m/(rad s).
    pub k_i: f64,
    /// The delay τ, in s.
    pub tau: f64,
}

impl From<[f64; 4]> for SubjectSpec {
    fn from([k_p, k_d, k_i, tau]: [f64; 4]) -> Self {
        Self { k_p, k_d, k_i, tau }
    }
}

/// Which experiments are considered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(rename = "RobustInputDesignExperiment")]
pub struct ExperimentSpec {
    /// Least and largest edge of the target's pass band, in Hz. Default: 0.1 to 2.
    pub edge_hz: [f64; 2],
    /// Least and largest width of the screen, in m. Default: 0.2 to 2.5.
    pub width_m: [f64; 2],
    /// Distance of the person from the screen, in m. Default: 3.
    pub distance_m: f64,
    /// Length of a record, in s. Default: 20.
    pub duration_s: f64,
    /// Time between samples, in s. Default: 0.02.
    pub sample_time_s: f64,
    /// Standard deviation of the target's noise before it is cut to ±0.5, in widths of the screen. Default: 0.25.
    pub noise_rms: f64,
    /// Seed of the target's noise. Default: 1.
    pub target_seed: u64,
}

impl Default for ExperimentSpec {
    fn default() -> Self {
        Self {
            edge_hz: [0.1, 2.0],
            width_m: [0.2, 2.5],
            distance_m: 3.0,
            duration_s: 20.0,
            sample_time_s: 0.02,
            noise_rms: 0.25,
            target_seed: 1,
        }
    }
}

/// An experiment that is at hand.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "RobustInputDesignGiven")]
pub struct GivenExperiment {
    /// Edge of the target's pass band, in Hz; it may lie outside of the range that is searched.
    pub edge_hz: f64,
    /// Width of the screen, in m; likewise.
    pub width_m: f64,
}

/// The spec of `robust_input_design`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RobustInputDesignSpec {
    /// Which experiments are considered.
    pub experiment: ExperimentSpec,
    /// θ_A: whom the nominal experiment is designed for, and where the min-max starts. Default: as the thesis defines
    /// it, the subject that fits the mean response of eight best; here of eight simulated subjects of the population
    /// whose target steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub average_subject: Option<SubjectSpec>,
    /// An experiment that is at hand: its worst subject is sought, and it is compared with the nominal and the robust
    /// one. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub given: Option<GivenExperiment>,
    /// Edge (Hz) and width (m) that the searches start from. Default: the middle of the ranges.
    pub start: Option<[f64; 2]>,
    /// T_m, the time constant of the muscle, in s. Default: 0.05.
    pub muscle_lag_s: f64,
    /// T_f, the time constant of the derivative's filter, in s. Default: 0.02.
    pub derivative_filter_s: f64,
    /// Bodies are drawn uniformly within this share of their mean, from 0 to below 1. Default: 0.2.
    pub body_spread: f64,
    /// Draws of body and muscle noise in the search, the same for all that it compares. Default: 48.
    pub draws: usize,
    /// Draws that the answers are re-estimated with, 4 at least: the first half chooses the worst of the subjects that
    /// the search found worst, the other half says what it costs. Default: 200.
    pub fresh_draws: usize,
    /// Iterations of the min-max at most. Default: 25.
    pub max_iterations: usize,
    /// Rounds of its refinement at most. Default: 4.
    pub rounds: usize,
    /// Seed of the draws. Default: 1.
    pub seed: u64,
}

impl Default for RobustInputDesignSpec {
    fn default() -> Self {
        Self {
            experiment: ExperimentSpec::default(),
            average_subject: None,
            given: None,
            start: None,
            muscle_lag_s: MUSCLE_LAG_S,
            derivative_filter_s: DERIVATIVE_FILTER_S,
            body_spread: 0.2,
            draws: 48,
            fresh_draws: 200,
            max_iterations: 25,
            rounds: 4,
            seed: 1,
        }
    }
}

impl Part for RobustInputDesignInputs {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        let members = value.as_object().ok_or_else(|| wrong("this is no object", at))?;
        if !members.contains_key("axis") {
            return Err(wrong("there is no axis", at).mend("Give flexion_extension or axial_rotation."));
        }
        reading::read(value, at, TITLE)
    }
}

impl Inputs for RobustInputDesignInputs {}

impl Part for RobustInputDesignSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        if !value.is_object() {
            return Err(wrong("this is no object", at));
        }
        reading::read(value, at, TITLE)
    }
}
