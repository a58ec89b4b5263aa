//! How it is fitted: as written, and checked.

use crate::analysis::contract::Part;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{self, wrong_spec as wrong};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Starts at least and at most.
const STARTS: [usize; 2] = [5, 100];

/// What the person knows of the disturbance d.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LqgFitDisturbance {
    /// Nothing: d moves the plant, and the person's filter sees it in what is sensed alone.
    UnknownToPerson,
    /// All of it at all times: the filter takes d as the plant does.
    KnownToPerson,
}

/// When the person's belief takes in what is sensed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LqgFitBelief {
    /// A sample later: u rests on y up to the sample before, `x̂⁺ = Ax̂ + Bu + L(y − Cx̂)`.
    Predicted,
    /// At once: u rests on y up to its own sample, `x̂ = x̂⁻ + L(y − Cx̂⁻)`.
    Filtered,
}

/// What the recorded control is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LqgFitControl {
    /// Left out of the fit.
    NotUsed,
    /// The command u = −Kx̂.
    Commanded,
    /// What reached the plant, `u + m` with the noise of the motor.
    Applied,
}

/// What the trials start from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LqgFitInitialState {
    /// The state and the belief are zero, exactly.
    Rest,
    /// Where the noise of the loop takes them: of mean zero, and spread as in the loop's steady state.
    Settled,
    /// The state is that of the first recorded outputs, which are exact, and the belief before anything is sensed is
    /// the same; the likelihood is that of the later samples.
    FirstSample,
    /// The state is `initial_state` of each trial, and the belief is the same.
    Given,
}

/// A target among the states of the plant, such as a cursor's: it moves by itself, and was recorded as the disturbance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LqgFitTarget {
    /// Which state of the plant it is, from 0.
    pub state: usize,
}

/// Which gain takes the first sample in.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LqgFitFirstGain {
    /// Its own: the initial covariance is that before the first sample.
    #[default]
    Own,
    /// That of the second sample, before which the initial covariance is that of the belief: as in the Python package
    /// `lqg`.
    OfSecond,
}

/// A horizon that ends with the trials, which are all of one length: gains change from sample to sample, and the cost
/// is `Σ_{k<N} xᵀQx + uᵀRu + x_NᵀQ_Nx_N` of N + 1 samples.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LqgFitHorizon {
    /// Q_N, n×n, as a sum of terms, in the unit of the cost over those of two states. Default: Q.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub terminal_weight: Option<Vec<LqgFitTerm>>,
    /// The person's covariance of the first state before anything is sensed, n×n, as a sum of terms, in products of the
    /// units of two states; an empty list is none. Default: the filter is that of the steady state from the first
    /// sample on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial_covariance: Option<Vec<LqgFitTerm>>,
    /// Which gain takes the first sample in, where there is such a covariance. Default: `own`.
    pub first_gain: LqgFitFirstGain,
}

/// Noise of the motor that grows with the control.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LqgFitControlDependentNoise {
    /// Its name, of which the spec has no other.
    pub name: String,
    /// c, the standard deviation of the noise over the magnitude of the control, dimensionless, where it is known.
    /// Default: estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held: Option<f64>,
    /// A positive value that the search starts it at, dimensionless. Default: found from the trials.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<f64>,
}

/// A weight or covariance: known, or a sum of terms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum LqgFitScale {
    /// The matrix, positive definite.
    #[schemars(title = "Known")]
    Known(Vec<Vec<f64>>),
    /// Terms, of which one at least is not held.
    #[schemars(title = "Terms")]
    Terms(Vec<LqgFitTerm>),
}

/// A term `coefficient · matrix` of a weight or of a covariance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LqgFitTerm {
    /// Its name, of which the spec has no other.
    pub name: String,
    /// The matrix's diagonal, the rest being zero: entries that are not negative, in the unit of the matrix per unit of
    /// the coefficient. Either this or `matrix`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diagonal: Option<Vec<f64>>,
    /// The matrix itself, symmetric and positive semidefinite, in that unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub matrix: Option<Vec<Vec<f64>>>,
    /// The coefficient where it is known, zero included, in the unit that the matrix leaves it. Default: estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held: Option<f64>,
    /// A positive value that the search starts it at, in that unit. Default: found from the trials.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<f64>,
    /// The name of another term that has the same coefficient, such as a true noise that the person perceives as it is.
    /// Default: a coefficient of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub same_as: Option<String>,
}

/// The spec of `lqg_fit`. Costs are those of samples, `Σ xᵀQx + uᵀRu`, and noises are covariances of one sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LqgFitSpec {
    /// What the person knows of d. Default: `unknown_to_person`.
    pub disturbance: LqgFitDisturbance,
    /// When the belief takes in what is sensed. Default: `predicted`.
    pub belief: LqgFitBelief,
    /// What the recorded control is. Default: `commanded` where every trial has one, `not_used` otherwise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control: Option<LqgFitControl>,
    /// The covariance of what recorded the control, m×m, in squares of its unit. Default: zero, recorded exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control_variance: Option<Vec<Vec<f64>>>,
    /// The covariance of an instrument that recorded the outputs apart from the senses, p×p (or r×r of `c_recorded`),
    /// in squares of their units; zero where it is exact. Default: none; the outputs are what the person sensed, its
    /// noise included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instrument_variance: Option<Vec<Vec<f64>>>,
    /// How much later what is sensed reaches the person, in seconds: a whole number of samples. Default: 0.
    pub sensory_delay_s: f64,
    /// The target among the states of the plant, which was recorded as the disturbance and is conditioned on: its own
    /// noise need not be known. Default: none; a state that moves by itself is a random walk like any other state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<LqgFitTarget>,
    /// A horizon that ends. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub horizon: Option<LqgFitHorizon>,
    /// What the trials start from. Default: `settled`.
    pub initial_state: LqgFitInitialState,
    /// Q, n×n, as a sum of terms, in the unit of the cost over those of two states. Default: a term `q1`, `q2`, .. for
    /// every state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state_weight: Option<Vec<LqgFitTerm>>,
    /// R, m×m, in the unit of the cost over those of two controls: a matrix that is the scale of the cost and not
    /// estimated, or terms, where Q holds the scale. Default: the identity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control_weight: Option<LqgFitScale>,
    /// W_p, n×n, the process noise that the person's filter is made for, in products of the units of two states, on the
    /// scale of `perceived_measurement_noise`. Default: a term `wp`, noise that enters where the controls do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub perceived_process_noise: Option<Vec<LqgFitTerm>>,
    /// V_p, p×p, in products of the units of two outputs: a matrix that is the scale of the perceived noises and not
    /// estimated, or terms, where something else holds the scale, such as a true noise that they are the same as.
    /// Default: the identity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub perceived_measurement_noise: Option<LqgFitScale>,
    /// W, n×n, the true process noise, in products of the units of two states. Default: a term `w`, noise that enters
    /// where the controls do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub process_noise: Option<Vec<LqgFitTerm>>,
    /// V, p×p, the true noise of the senses, in products of the units of two outputs. Default: a term `v1`, `v2`, ..
    /// for every output.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measurement_noise: Option<Vec<LqgFitTerm>>,
    /// M, m×m, the true noise of the motor beside W, in products of the units of two controls. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motor_noise: Option<Vec<LqgFitTerm>>,
    /// Noise of the motor whose standard deviation is c times the control, which the person knows and reckons with.
    /// Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control_dependent_noise: Option<LqgFitControlDependentNoise>,
    /// The level of the intervals, above 0 and below 1. Default: 0.95.
    pub confidence: f64,
    /// Starts that are climbed from, 5 to 100. Default: 5.
    pub starts: usize,
    /// The seed of all draws. Default: 1.
    pub seed: u64,
}

impl Default for LqgFitSpec {
    fn default() -> Self {
        Self {
            disturbance: LqgFitDisturbance::UnknownToPerson,
            belief: LqgFitBelief::Predicted,
            control: None,
            control_variance: None,
            instrument_variance: None,
            sensory_delay_s: 0.0,
            target: None,
            horizon: None,
            initial_state: LqgFitInitialState::Settled,
            state_weight: None,
            control_weight: None,
            perceived_process_noise: None,
            perceived_measurement_noise: None,
            process_noise: None,
            measurement_noise: None,
            motor_noise: None,
            control_dependent_noise: None,
            confidence: 0.95,
            starts: 5,
            seed: 1,
        }
    }
}

impl Part for LqgFitSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        if !value.is_object() {
            return Err(wrong("the spec is no object", at));
        }
        reading::read(value, at, "unusable spec")
    }
}

impl LqgFitSpec {
    /// Checks it, as far as the plant does not matter.
    pub(super) fn check(&self) -> Result<(), Problem> {
        if !(self.confidence > 0.0 && self.confidence < 1.0) {
            let detail = format!("the level is {}, and must lie between 0 and 1", self.confidence);
            return Err(wrong(detail, "/spec/confidence"));
        }
        if !(self.sensory_delay_s >= 0.0 && self.sensory_delay_s.is_finite()) {
            let detail = format!("the delay is {} s, and must not be negative", self.sensory_delay_s);
            return Err(wrong(detail, "/spec/sensory_delay_s"));
        }
        let [least, most] = STARTS;
        if !(least..=most).contains(&self.starts) {
            let detail = format!("starts is {}; {least} to {most} are taken", self.starts);
            return Err(wrong(detail, "/spec/starts").mend("Fewer would not show that a likelihood has several hills."));
        }
        Ok(())
    }
}
