//! The result of a fit.

use super::spec::LqgFitControl;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The matrix that a parameter is a coefficient of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LqgFitRole {
    /// Q.
    StateWeight,
    /// Q_N, of the end of a horizon.
    TerminalWeight,
    /// R.
    ControlWeight,
    /// W_p.
    PerceivedProcessNoise,
    /// V_p.
    PerceivedMeasurementNoise,
    /// The person's covariance of the first state.
    InitialCovariance,
    /// W.
    ProcessNoise,
    /// V.
    MeasurementNoise,
    /// M.
    MotorNoise,
    /// c, of noise that grows with the control.
    ControlDependentNoise,
}

/// Why no number is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LqgFitRefusal {
    /// The standard error of the logarithm is above 0.7: not known to a factor of four.
    StandardError,
    /// The interval has no end on a side, within a factor of ten thousand.
    OpenInterval,
    /// The interval is wider than that of such a standard error.
    WideInterval,
    /// The search ran to a factor of a hundred million from its start.
    AtBound,
    /// Other explanations of the same records have other values.
    OtherExplanations,
}

/// A parameter of the fit: a coefficient of a term.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LqgFitParameter {
    /// The name of the term.
    pub name: String,
    /// The matrix that it is part of.
    pub role: LqgFitRole,
    /// The estimate, in the unit that the term's matrix leaves it; null where it is refused.
    pub value: Option<f64>,
    /// The standard error of its natural logarithm, dimensionless; null at a bound.
    pub log_standard_error: Option<f64>,
    /// The interval of the likelihood ratio, all other parameters climbed anew along it, in the unit of the value; an
    /// end is null where the interval is open there, and both where it was not looked for because the standard error is
    /// above 2.
    pub interval: [Option<f64>; 2],
    /// Why there is no value; null where there is one.
    pub refused: Option<LqgFitRefusal>,
}

/// A product of powers of parameters that is known better than they are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LqgFitCombination {
    /// The product, such as `q1/q2` or `q1^0.84 q2^-0.54`.
    pub name: String,
    /// The power of each parameter, dimensionless, by its name.
    pub exponents: BTreeMap<String, f64>,
    /// Its value, in the product of those powers of the parameters' units.
    pub value: f64,
    /// The standard error of its natural logarithm, dimensionless.
    pub log_standard_error: f64,
    /// Its interval to first order in the logarithm, in the unit of the value.
    pub interval: [f64; 2],
}

/// A person who explains the records.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LqgFitExplanation {
    /// The natural logarithm of the likelihood's density, for signals in their units.
    pub log_likelihood: f64,
    /// The coefficients of the terms by name, held ones too, in the units that the terms' matrices leave them; null
    /// where the records do not determine one.
    pub coefficients: BTreeMap<String, Option<f64>>,
    /// Q, n×n, on the scale of R, in the unit of the cost over those of two states; null where a coefficient of it is.
    pub q: Option<Vec<Vec<f64>>>,
    /// W_p, n×n, on the scale of V_p, in products of the units of two states; null where a coefficient of it is.
    pub perceived_process_noise: Option<Vec<Vec<f64>>>,
    /// K, m×n, in the unit of the control per unit of the state, of the first sample where the horizon ends; null where
    /// its standard errors are above 0.7 of it.
    pub k: Option<Vec<Vec<f64>>>,
    /// Standard errors of its entries to first order, in their units.
    pub k_standard_error: Vec<Vec<f64>>,
    /// L, n×p, of the predictor or of the filter by the spec's belief, in the unit of the state per unit of the output,
    /// of the first sample where the horizon ends; null where its standard errors are above 0.7 of it.
    pub l: Option<Vec<Vec<f64>>>,
    /// Standard errors of its entries to first order, in their units.
    pub l_standard_error: Vec<Vec<f64>>,
    /// Eigenvalues of A − BK in sampled time, as `[re, im]`; null where K is, or the horizon ends.
    pub regulator_poles: Option<Vec<[f64; 2]>>,
}

/// What shows that the search has arrived.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LqgFitConvergence {
    /// Whether the step that Newton's method would still take is below 0.01 standard errors.
    pub converged: bool,
    /// That step, in standard errors: the largest of all parameters.
    pub remaining_step: f64,
    /// Starts.
    pub starts: usize,
    /// Climbs that ended within 0.001 of the log likelihood of the answer.
    pub arrived: usize,
    /// The log likelihood that each climb ended at, in the order of the starts.
    pub log_likelihoods: Vec<f64>,
    /// Evaluations of the likelihood with derivatives.
    pub evaluations: usize,
    /// Whether the observed information is positive definite; otherwise standard errors are those of the expected one.
    pub information_is_observed: bool,
}

/// A recorded signal, and what of it was not foreseen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LqgFitSignal {
    /// Which one, such as `output 1` or `control 1`.
    pub signal: String,
    /// Correlation of neighbouring prediction errors, dimensionless.
    pub lag_one_correlation: f64,
    /// Lags of the test of Ljung and Box.
    pub lags: usize,
    /// Its probability of larger correlations if the errors are white, dimensionless.
    pub whiteness_p: f64,
}

/// The result of `lqg_fit`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LqgFitResult {
    /// The parameters: the coefficients of terms that are neither held nor those of another term.
    pub parameters: Vec<LqgFitParameter>,
    /// Combinations of refused parameters that are known: ratios within a matrix, and the best determined products of
    /// powers.
    pub combinations: Vec<LqgFitCombination>,
    /// All persons found whose log likelihoods are within 2 of the largest, the likeliest first. With more than one,
    /// none of them is the answer alone.
    pub explanations: Vec<LqgFitExplanation>,
    /// Pairs of K and L that make the same controller and are optimal for nothing that the spec allows, not even
    /// nearly; null where the person knows the disturbance, so that there are none, or where they were not looked for.
    pub twins_outside: Option<usize>,
    /// R, m×m, the scale of Q, in the unit of the cost over those of two controls; null where it has terms.
    pub control_weight: Option<Vec<Vec<f64>>>,
    /// V_p, p×p, the scale of W_p, in products of the units of two outputs; null where it has terms.
    pub perceived_measurement_noise: Option<Vec<Vec<f64>>>,
    /// The natural logarithm of the likelihood's density at the answer, for signals in their units.
    pub log_likelihood: f64,
    /// What the recorded control was taken for.
    pub control: LqgFitControl,
    /// Samples of all trials together.
    pub samples: usize,
    /// The sample time in seconds; A, B, K and L are those of the samples.
    pub sample_time_s: f64,
    /// What shows that the search has arrived.
    pub convergence: LqgFitConvergence,
    /// Each recorded signal that is not exact: outputs, then controls.
    pub signals: Vec<LqgFitSignal>,
}
