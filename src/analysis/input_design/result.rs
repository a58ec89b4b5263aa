//! What the design came to.

use crate::excite::design::Criterion;
use schemars::JsonSchema;
use serde::Serialize;

/// The result of `input_design`.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct InputDesignResult {
    /// What was made large.
    pub criterion: Criterion,
    /// Time between samples, in s.
    pub sample_time_s: f64,
    /// The best input found: N samples in the unit of the model's input, held until the next.
    pub input: Vec<f64>,
    /// The start that it was reached from, in the same unit.
    pub start_input: Vec<f64>,
    /// By what factor the experiment is better than with that start, dimensionless: the ratio of (scaled) traces; of D
    /// the root of the ratio of determinants, the mean factor for one parameter; of A the ratio of sums of (relative)
    /// variances.
    pub factor: f64,
    /// That factor after each step: it never falls.
    pub history: Vec<f64>,
    /// Every start, in the order of the request.
    pub starts: Vec<StartResult>,
    /// Place of the best start among them.
    pub best_start: usize,
    /// What each parameter gains.
    pub parameters: Vec<ParameterResult>,
    /// The Fisher matrix with the start and with the best input, in
    /// 1/unit² of the parameter.
    pub information: [InformationResult; 2],
    /// Each limit, recomputed sample by sample from the recursion of the model, which the design itself never uses.
    pub limits: Vec<LimitResult>,
    /// Peak and root mean square of the input and of every output, before and after.
    pub signals: Vec<SignalResult>,
    /// Every output, and every difference that is limited, sample by sample.
    pub courses: Vec<CourseResult>,
    /// The autocorrelation of the inputs; null where it is not limited.
    pub autocorrelation: Option<AutocorrelationCourse>,
    /// What the last step proves.
    pub proof: DesignProof,
    /// What simulated records say; null where none were asked for.
    pub monte_carlo: Option<MonteCarloResult>,
}

/// Why a climb ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignStop")]
#[serde(rename_all = "snake_case")]
pub enum StartStop {
    /// No step within the whole trust region gains more than the tolerance, to first order.
    Converged,
    /// Steps of the smallest trust region gained less than the tolerance, while a step of the whole region might gain
    /// more to first order: the autocorrelation, or the criterion's curvature, holds it back.
    SmallestRegion,
    /// All steps allowed were made.
    StepLimit,
}

/// A start and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignStartResult")]
pub struct StartResult {
    /// By what factor its samples were scaled to fit, dimensionless; 1 where they fit as they are.
    pub scale: f64,
    /// Why it could not be used; null for one that could.
    pub refused: Option<String>,
    /// The criterion with it, in the units that the criterion has; null where it could not be used.
    pub value: Option<f64>,
    /// The criterion at the end of the climb from it, in the same units; null where it could not be used.
    pub reached: Option<f64>,
    /// By what factor the climb made it better, dimensionless; null where it could not be used.
    pub factor: Option<f64>,
    /// Steps taken.
    pub steps: usize,
    /// Linear programs solved.
    pub programs: usize,
    /// Why the climb from it ended; null for one that could not be used.
    pub stop: Option<StartStop>,
}

/// A parameter and how well the experiment tells it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignParameter")]
pub struct ParameterResult {
    /// Its name.
    pub name: String,
    /// The value that the design takes as true, in the parameter's unit.
    pub value: f64,
    /// Its diagonal entry of the Fisher matrix with the start and with the best input, in
    /// 1/unit² of the parameter.
    pub information: [f64; 2],
    /// Its share of the trace with the best input: what T-optimality looks at.
    pub trace_share: f64,
    /// Standard deviation by Cramér and Rao's bound, in the parameter's unit, with the start and with the best input;
    /// null where a parameter is not determined.
    pub standard_deviation: Option<[f64; 2]>,
    /// The variance with the best input over that with the start, by the same bound, dimensionless; null where a
    /// parameter is not determined.
    pub variance_ratio: Option<f64>,
}

/// A Fisher matrix.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignInformation")]
pub struct InformationResult {
    /// Its rows, entry i, j in 1/(unit of parameter i · unit of parameter j).
    pub matrix: Vec<Vec<f64>>,
    /// Ratio of the largest to the least eigenvalue of the matrix scaled to a diagonal of ones; null for a singular
    /// one.
    pub condition: Option<f64>,
    /// The combination of parameters that is not determined, weights by name; null where all are.
    pub undetermined: Option<Vec<(String, f64)>>,
    /// The criterion, in the units that it has; null where it needs an inverse that does not exist.
    pub value: Option<f64>,
}

/// A limit and what the best input uses of it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignLimitResult")]
pub struct LimitResult {
    /// What is limited.
    pub name: String,
    /// Least and largest value allowed, in the unit of what is limited.
    pub range: [f64; 2],
    /// Least and largest value reached, in that unit.
    pub reached: [f64; 2],
    /// The smaller distance to the range's ends, in that unit: never negative but for rounding.
    pub slack: f64,
    /// The sample, from 0 (of the autocorrelation: the lag), that comes nearest.
    pub at: usize,
}

/// An output or a difference of two, sample by sample.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignCourse")]
pub struct CourseResult {
    /// The output's name, or that of the difference.
    pub name: String,
    /// Least and largest value allowed, in its unit; null where it is not limited.
    #[schemars(with = "Option<Vec<f64>>")]
    pub range: Option<[f64; 2]>,
    /// N samples with the start, in its unit, by the recursion of the model.
    pub before: Vec<f64>,
    /// N samples with the best input.
    pub after: Vec<f64>,
}

/// The autocorrelation of the inputs, `R(l) = Σ u(k) u(k − l)/Σ u(k)²`, dimensionless.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignAutocorrelationCourse")]
pub struct AutocorrelationCourse {
    /// The lags l in samples, from 1.
    pub lag: Vec<usize>,
    /// Of the start.
    pub before: Vec<f64>,
    /// Of the best input.
    pub after: Vec<f64>,
    /// What it is to stay near to.
    pub reference: Vec<f64>,
    /// How far it may be from that.
    pub tolerance: f64,
}

/// A signal with both inputs.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignSignal")]
pub struct SignalResult {
    /// `input`, or the output's name.
    pub name: String,
    /// Largest magnitude with the start and with the best input, in the signal's unit.
    pub peak: [f64; 2],
    /// Root mean square with the start and with the best input, in that unit.
    pub rms: [f64; 2],
}

/// What the last linear program proves.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignProof")]
pub struct DesignProof {
    /// The growth of the criterion in its units, to first order, of the best further step of the size `trust_region`
    /// from the best input.
    pub first_order_gain: f64,
    /// The bound of that growth, in the same units, from the program's multipliers: no such step within the linearised
    /// limits has more.
    pub first_order_bound: f64,
    /// The gap between both, relative to the bound; dimensionless.
    pub duality_gap: f64,
    /// `first_order_bound` as relative growth of the experiment: what no step gains more than, to first order,
    /// dimensionless.
    pub stationarity: f64,
    /// The tolerance that it is held against, dimensionless.
    pub tolerance: f64,
    /// Whether it is no larger than the tolerance: the certificate that the climb has converged.
    pub is_stationary: bool,
    /// What the second order adds to the growth of such a step at most, as the same share; null of criteria that are
    /// not quadratic in the input.
    pub second_order_bound: Option<f64>,
    /// The size of the region, in units of the input: δ_u, that the climb began with.
    pub trust_region: f64,
    /// The last region that the climb used on its way, in the same unit.
    pub last_trust_region: f64,
    /// Rows of the whole program, after screening, and in the last one solved.
    pub rows: [usize; 3],
}

/// Simulated records, fitted anew.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignMonteCarloResult")]
pub struct MonteCarloResult {
    /// Records of each input.
    pub replicates: usize,
    /// Fits that did not converge, with the start and with the best input; they are left out.
    pub failed: [usize; 2],
    /// The level at which all intervals hold together (Bonferroni).
    pub joint_level: f64,
    /// For each parameter.
    pub parameters: Vec<MonteCarloParameter>,
    /// Whether every predicted ratio lies within its interval.
    pub all_within: bool,
}

/// What the records say of one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InputDesignMonteCarloParameter")]
pub struct MonteCarloParameter {
    /// Its name.
    pub name: String,
    /// Mean of the fitted values less the true one, with the start and with the best input, in the parameter's unit.
    pub bias: [f64; 2],
    /// Standard deviation of the fitted values with the start and with the best input, in the parameter's unit.
    pub standard_deviation: [f64; 2],
    /// That over the predicted one, dimensionless.
    pub over_predicted: [f64; 2],
    /// The variance with the best input over that with the start, dimensionless.
    pub variance_ratio: f64,
    /// The interval of that ratio, by Fisher's F.
    pub interval: [f64; 2],
    /// The predicted ratio.
    pub predicted_ratio: f64,
    /// Whether it lies within the interval.
    pub within: bool,
}
