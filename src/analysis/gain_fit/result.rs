//! The result of a fit.

use super::optimal_person::OptimalPersonResult;
use super::optimality::OptimalityResult;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which of its bounds a parameter is held by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitBoundSide")]
#[serde(rename_all = "snake_case")]
pub enum BoundSide {
    /// The lower one.
    Lower,
    /// The upper one.
    Upper,
}

/// A parameter of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitParameter")]
pub struct FittedParameterResult {
    /// Its name.
    pub name: String,
    /// The estimate, in the parameter's unit.
    pub value: f64,
    /// Its standard error, in that unit; null at a bound, or where the data do not determine all parameters.
    pub standard_error: Option<f64>,
    /// Its interval of the level asked for, cut at the bounds, in that unit; null where there is no standard error.
    pub interval: Option<[f64; 2]>,
    /// The lower and the upper bound that it was held to, in that unit; null where there is none.
    pub bounds: [Option<f64>; 2],
    /// The bound that it is at; null where it is at none.
    pub at_bound: Option<BoundSide>,
}

/// What shows that the search has arrived.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitConvergence")]
pub struct FitConvergenceResult {
    /// Whether the projected gradient is zero to its tolerance: the remaining step is below 0.01 standard errors.
    pub converged: bool,
    /// The projected gradient, dimensionless: largest cosine between the residuals and their derivative with respect to
    /// a parameter that no bound holds.
    pub gradient_cosine: f64,
    /// The largest step that Newton's method would still take, in standard errors; null where the data do not determine
    /// all parameters.
    pub remaining_step: Option<f64>,
    /// Whether the gradient pushes every parameter at a bound against it.
    pub bounds_hold: bool,
    /// Draws of a start that make the loop stable, of all draws.
    pub usable_starts: usize,
    /// Starts drawn.
    pub draws: usize,
    /// Climbs from the likeliest of them.
    pub climbs: usize,
    /// Climbs that ended at the likelihood of the answer.
    pub agreeing: usize,
    /// Evaluations of the model.
    pub evaluations: usize,
    /// Rounds of reweighting by the covariance of the noise.
    pub rounds: usize,
}

/// A predicted signal, and how well it is explained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitOutput")]
pub struct FittedOutputResult {
    /// Which one, such as `output 1` or `control 1`.
    pub signal: String,
    /// Standard deviation of the noise, in the unit of the signal.
    pub noise_sd: f64,
    /// `100 (1 − ‖y − ŷ‖/‖y − ȳ‖)`, in percent; of predictions one sample ahead where the filter is estimated too.
    pub fit_percent: f64,
    /// Correlation of neighbouring residuals, dimensionless.
    pub lag_one_correlation: f64,
    /// Lags of the test of Ljung and Box.
    pub lags: usize,
    /// Its probability of larger correlations if the residuals are white, dimensionless.
    pub whiteness_p: f64,
}

/// What the data determine worst.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitIdentifiability")]
pub struct GainIdentifiabilityResult {
    /// Whether all parameters are determined.
    pub identifiable: bool,
    /// Condition number of Fisher's information with each parameter in units of its own; dimensionless, null
    /// where it is singular.
    pub condition_number: Option<f64>,
    /// The worst combination in those units, such as `0.71 k1 − 0.70 k3`.
    pub weakest_combination: String,
}

/// Another pair of gains that makes the same controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitTwin")]
pub struct TwinResult {
    /// K, m×n, in the unit of the control per unit of the state.
    pub k: Vec<Vec<f64>>,
    /// L, n×p, in the unit of the state per unit of the output.
    pub l: Vec<Vec<f64>>,
    /// Eigenvalues of A − BK in sampled time, as `[re, im]`; the others of the loop are those of A − LC.
    pub regulator_poles: Vec<[f64; 2]>,
}

/// What `inverse_lqr` takes, at the estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitInverseLqrInputs")]
pub struct InverseInputsResult {
    /// A, n×n, in the unit of `x⁺` per unit of the state.
    pub a: Vec<Vec<f64>>,
    /// B, n×m, in the unit of `x⁺` per unit of the control.
    pub b: Vec<Vec<f64>>,
    /// K, m×n, in the unit of the control per unit of the state.
    pub k: Vec<Vec<f64>>,
    /// The sample time in seconds; null in continuous time.
    pub sample_time_s: Option<f64>,
    /// The names of the states.
    pub state_names: Vec<String>,
    /// Their units, where the catalogue knows them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state_units: Option<Vec<String>>,
    /// The units of the controls, where the catalogue knows them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input_units: Option<Vec<String>>,
}

/// What `inverse_lqg` takes, at the estimate; all in sampled time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitInverseLqgInputs")]
pub struct InverseLqgInputsResult {
    /// A, n×n, in the unit of `x⁺` per unit of the state.
    pub a: Vec<Vec<f64>>,
    /// B, n×m, in the unit of `x⁺` per unit of the control.
    pub b: Vec<Vec<f64>>,
    /// C, p×n, in the unit of the output per unit of the state.
    pub c: Vec<Vec<f64>>,
    /// D, p×m, in the unit of the output per unit of the control.
    pub d: Vec<Vec<f64>>,
    /// K, m×n, in the unit of the control per unit of the state.
    pub k: Vec<Vec<f64>>,
    /// L of the predictor, n×p, in the unit of the state per unit of the output.
    pub l: Vec<Vec<f64>>,
    /// The sample time in seconds.
    pub sample_time_s: f64,
    /// The names of the states.
    pub state_names: Vec<String>,
}

/// The result of `gain_fit`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GainFitResult {
    /// K, m×n, in the unit of the control per unit of the state.
    pub k: Vec<Vec<f64>>,
    /// Covariance of K's entries, column by column, in products of their units: what `inverse_lqr` takes as
    /// `fit/gain_covariance`; null where the data do not determine all parameters.
    pub k_covariance: Option<Vec<Vec<f64>>>,
    /// L, n×p, the gain of the predictor in sampled time, in the unit of the state per unit of the output; null where
    /// it is not estimated.
    pub l: Option<Vec<Vec<f64>>>,
    /// Covariance of the entries of Lᵀ, column by column, in products of their units: what `inverse_lqe` takes; null
    /// where L is not estimated, or the data do not determine all parameters.
    pub l_covariance: Option<Vec<Vec<f64>>>,
    /// All parameters: K row by row, L row by row, those of the plant, `tau` and `t_w`.
    pub parameters: Vec<FittedParameterResult>,
    /// Their covariance in that order, in products of their units; null where the data do not determine all of them.
    pub covariance: Option<Vec<Vec<f64>>>,
    /// Covariance of the noise (of the prediction errors where the filter is estimated too) of the predicted signals,
    /// in products of their units.
    pub noise_covariance: Vec<Vec<f64>>,
    /// Natural logarithm of the likelihood's density, for outputs in their units.
    pub log_likelihood: f64,
    /// Samples of all trials together.
    pub samples: usize,
    /// Numbers measured less unknowns.
    pub degrees_of_freedom: f64,
    /// What shows that the search has arrived.
    pub convergence: FitConvergenceResult,
    /// Each predicted signal, in the order of the columns: outputs, then controls.
    pub outputs: Vec<FittedOutputResult>,
    /// What the data determine worst.
    pub identifiability: GainIdentifiabilityResult,
    /// Poles of the loop (of the predictor where the filter is estimated too) in sampled time, as `[re, im]`.
    pub sampled_poles: Vec<[f64; 2]>,
    /// States at the first sample of every trial, in their units; null where they were not estimated.
    pub initial_states: Option<Vec<Vec<f64>>>,
    /// The question that `inverse_lqr` takes as its inputs.
    pub inverse_lqr_inputs: InverseInputsResult,
    /// The question that `inverse_lqg` takes as its inputs; null where the filter is not estimated.
    pub inverse_lqg_inputs: Option<InverseLqgInputsResult>,
    /// Other pairs of K and L that make the same controller, and that no record tells from the ones given; null where
    /// the person's filter knows the input or suits the true noise, so that there are none, or where they were not
    /// looked for (a warning says why).
    pub twins: Option<Vec<TwinResult>>,
    /// Whether the gains are optimal for a cost, how surely, and for which; null where that was not asked.
    pub optimality: Option<OptimalityResult>,
    /// The person whose gain is held to be optimal, and the test against the free one; null where that was not asked.
    pub optimal: Option<OptimalPersonResult>,
}
