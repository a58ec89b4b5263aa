//! How the question is put: as written, and checked.

use super::structure_spec::{PortWeight, StateWeight, WeightName, structure};
use crate::analysis::contract::Part;
use crate::analysis::inputs::matrix::dense;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{self, wrong_spec as wrong};
use crate::control::riccati::SYMMETRY;
use crate::convex::lmi::Solver;
use crate::inverse::fit::FitSettings;
use crate::inverse::{Gains, Knowledge, Settings, Structure};
use crate::num::linalg::symmetric;
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Condition numbers of a fit at most.
const MAX_POINTS: usize = 20;
/// Steps of a descent at most.
const MAX_STEPS: usize = 100_000;
/// Evaluations of a fit at most.
const MAX_EVALUATIONS: usize = 1_000_000;
/// Random starts of a fit at most.
const MAX_STARTS: usize = 100;

/// How weights are fitted where none make the gain optimal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(rename = "InverseFitSpec")]
pub struct FitSpec {
    /// Condition numbers κ of `I ⪯ blkdiag(Q, R) ⪯ κI`, dimensionless, increasing, each above 1. Default: 10 to 1e8 by
    /// tens.
    pub condition_numbers: Vec<f64>,
    /// Random starts for every κ, beside the fixed ones. Default: 4.
    pub random_starts: usize,
    /// Seed of the random starts. Default: 1.
    pub seed: u64,
    /// Evaluations of the regulator at most, 1 to 1,000,000; a fit that reaches them ends where it is. Default: by the
    /// size of the problem, some 2 s of one core.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub evaluations: Option<usize>,
    /// Covariance of the gain's entries in their squared units, column by column, mn×mn, positive definite; of a filter
    /// those of Lᵀ. The fit then weights by its inverse. Default: none, all entries alike.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_covariance: Option<Vec<Vec<f64>>>,
    /// The gradient descent of Priess 2015, Table 3.1, beside the fit, for comparison. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub descent: Option<DescentSpec>,
}

/// The gradient descent of Priess 2015, Table 3.1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DescentSpec {
    /// λ, the length of a step over the gradient, positive.
    pub rate: f64,
    /// Steps, up to 100,000.
    pub steps: usize,
    /// Where it starts: `"identity"`, `"cross_term"` or `{"state_weight": [[..]], "port_weight": [[..]]}`. Default:
    /// identity.
    #[serde(default)]
    pub start: DescentStart,
}

/// Where the descent starts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum DescentStart {
    /// By name.
    #[schemars(title = "Name")]
    Name(DescentStartName),
    /// From weights as they are given.
    #[schemars(title = "Weights")]
    Weights(DescentWeights),
}

impl Default for DescentStart {
    fn default() -> Self {
        Self::Name(DescentStartName::Identity)
    }
}

/// A start that has a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DescentStartName {
    /// Q and R are the identity.
    Identity,
    /// The weights of the smallest cross term (3.20), as Table 3.1 starts.
    CrossTerm,
}

/// Weights that a descent starts from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DescentWeights {
    /// Q, or W of a filter, n×n, symmetric and positive semidefinite.
    pub state_weight: Vec<Vec<f64>>,
    /// R, or V of a filter, m×m, symmetric and positive definite.
    pub port_weight: Vec<Vec<f64>>,
}

impl DescentWeights {
    /// The weights, checked against the sizes of the half; `at` is their pointer.
    ///
    /// # Errors
    /// Where one has another size, is not symmetric, or not (semi)definite.
    pub(super) fn checked(&self, [n, m]: [usize; 2], at: &str) -> Result<[DMatrix<f64>; 2], Problem> {
        let one = |rows: &[Vec<f64>], name: &str, order: usize, is_definite: bool| {
            let at = format!("{at}/{name}");
            let found = dense(rows, "the weight", &at)?;
            if found.shape() != (order, order) {
                let (rows, columns) = found.shape();
                return Err(wrong(format!("the weight is {rows}x{columns} and must be {order}x{order}"), at));
            }
            if (&found - found.transpose()).amax() > SYMMETRY * found.amax() {
                return Err(wrong("the weight is not symmetric", at));
            }
            let found = symmetric(&found);
            let least = found.symmetric_eigenvalues().min();
            if least < 0.0 || (is_definite && least == 0.0) {
                let word = if is_definite { "positive definite" } else { "positive semidefinite" };
                return Err(wrong(format!("the weight is not {word}: its least eigenvalue is {least:e}"), at));
            }
            Ok(found)
        };
        Ok([one(&self.state_weight, "state_weight", n, false)?, one(&self.port_weight, "port_weight", m, true)?])
    }
}

impl Default for FitSpec {
    fn default() -> Self {
        let settings = FitSettings::default();
        Self {
            condition_numbers: settings.condition_numbers,
            random_starts: settings.random_starts,
            seed: settings.seed,
            evaluations: None,
            gain_covariance: None,
            descent: None,
        }
    }
}

/// What is known of the weights of a regulator or a filter, and how they are fitted where none make the gain optimal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InverseSpec {
    /// Q, or W: `"full"`, `"diagonal"` or `{"pattern": [[true, ..], ..]}`. Default: full.
    pub state_weight: StateWeight,
    /// R, or V: `"full"`, `"diagonal"`, `{"fixed": [[..]]}` or `{"pattern": ..}`. Default: full.
    pub port_weight: PortWeight,
    /// Whether Q (W) may be singular; a boundary verdict with proven weights then answers the question. Default: false.
    pub semidefinite: bool,
    /// Who solves the matrix inequalities (3.12) and (3.13) of Priess 2015: `auto`, `clarabel` or `interior_point`. The
    /// verdict rests on neither. Default: auto.
    pub solver: SolverName,
    /// Half a unit of the last digit of the gain, absolute, in the unit of its entries: one number for all entries, or
    /// a matrix of the gain's shape. Default: none, the entries are as exact as their doubles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_rounding: Option<GainRounding>,
    /// A discount of the cost: the factor γ < 1 of each sample, dimensionless, or in continuous time the rate ρ > 0 of
    /// `e^(−ρt)`, in 1/s. The weights are those of the discounted cost. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub discount: Option<f64>,
    /// Which gain of a sampled filter L is: `predictor` of `x̂⁺ = Ax̂ + L(y − Cx̂)`, or `filter` of the corrected
    /// estimate `x̂ + L(y − Cx̂)`, whose predictor's gain is AL. Default: predictor.
    #[serde(skip_serializing_if = "Form::is_predictor")]
    pub form: Form,
    /// The fit where no weights exist; null for none. Default: a fit with its defaults.
    pub fit: Option<FitSpec>,
}

/// Who solves the matrix inequalities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "InverseSolver")]
pub enum SolverName {
    /// clarabel where it is as quick, the built-in method where it is not, or where clarabel's answer fails its check.
    #[default]
    Auto,
    /// clarabel, for up to 160 unknowns; the built-in method where its answer fails its check.
    Clarabel,
    /// The built-in primal-dual method.
    InteriorPoint,
}

impl From<SolverName> for Solver {
    fn from(name: SolverName) -> Self {
        match name {
            SolverName::Auto => Self::Auto,
            SolverName::Clarabel => Self::Clarabel,
            SolverName::InteriorPoint => Self::InteriorPoint,
        }
    }
}

/// How far the entries of a gain are known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "InverseGainRounding")]
pub enum GainRounding {
    /// All entries alike, in their units.
    #[schemars(title = "Number")]
    All(f64),
    /// Entry by entry, in the shape of the gain and its units.
    #[schemars(title = "Matrix")]
    Entries(Vec<Vec<f64>>),
}

/// Which gain of a sampled filter is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "InverseFilterForm")]
pub enum Form {
    /// `x̂⁺ = Ax̂ + Bu + L(y − Cx̂ − Du)`.
    #[default]
    Predictor,
    /// `x̂ ← x̂ + L(y − Cx̂ − Du)` before the step: the gain of Kalman's filter as it is printed most often.
    Filter,
}

impl Form {
    fn is_predictor(&self) -> bool {
        *self == Self::Predictor
    }
}

impl InverseSpec {
    /// What is said about the gain, rows×columns; `at` is the pointer of the spec.
    pub(in crate::analysis) fn knowledge(&self, shape: (usize, usize), at: &str) -> Result<Knowledge, Problem> {
        let gain_rounding = match &self.gain_rounding {
            None => None,
            Some(GainRounding::All(value)) => Some(DMatrix::from_element(shape.0, shape.1, *value)),
            Some(GainRounding::Entries(rows)) => {
                Some(dense(rows, "the rounding of the gain", &format!("{at}/gain_rounding"))?)
            }
        };
        if let Some(found) = gain_rounding.as_ref()
            && (found.shape() != shape || found.iter().any(|v| !(v.is_finite() && *v >= 0.0)))
        {
            let (rows, columns) = shape;
            let detail = format!("the rounding of the gain must be {rows}x{columns}, with numbers from 0 on");
            return Err(wrong(detail, format!("{at}/gain_rounding")));
        }
        Ok(Knowledge { gain_rounding, discount: self.discount })
    }
}

impl Default for InverseSpec {
    fn default() -> Self {
        Self {
            state_weight: StateWeight::Name(WeightName::Full),
            port_weight: PortWeight::Name(WeightName::Full),
            semidefinite: false,
            solver: SolverName::Auto,
            gain_rounding: None,
            discount: None,
            form: Form::Predictor,
            fit: Some(FitSpec::default()),
        }
    }
}

/// Reads a spec all of whose members may be left out.
pub(in crate::analysis) fn read<T: DeserializeOwned>(value: &Value, at: &str, advice: &str) -> Result<T, Problem> {
    if !value.is_object() {
        return Err(wrong("the spec is no object", at));
    }
    reading::read(value, at, "unusable spec").map_err(|problem| problem.mend(advice))
}

impl Part for InverseSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        read(
            value,
            at,
            "A spec has state_weight (\"full\", \"diagonal\" or {\"pattern\": ..}), port_weight (also {\"fixed\": \
             ..}), semidefinite, solver, gain_rounding, discount, form and fit.",
        )
    }
}

/// A checked spec of one half.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::analysis) struct CheckedSpec {
    /// With every default filled in.
    pub used: InverseSpec,
    /// What is known of the weights.
    pub structure: Structure,
    /// The inverse of the gain's covariance.
    pub metric: Option<DMatrix<f64>>,
}

impl CheckedSpec {
    /// Checks a spec against the sizes of the half; `at` is its pointer.
    pub(in crate::analysis) fn new(written: InverseSpec, gains: &Gains, at: &str) -> Result<Self, Problem> {
        let (n, m) = (gains.states(), gains.ports());
        let structure = structure(&written.state_weight, &written.port_weight, written.semidefinite, [n, m], at)?;
        let metric = match &written.fit {
            None => None,
            Some(fit) => {
                let at = format!("{at}/fit");
                check_fit(fit, [n, m], &at)?;
                let read = |rows: &Vec<Vec<f64>>| metric(rows, n * m, &format!("{at}/gain_covariance"));
                fit.gain_covariance.as_ref().map(read).transpose()?
            }
        };
        Ok(Self { used: written, structure, metric })
    }

    /// As the question takes it.
    pub(in crate::analysis) fn settings(&self) -> Settings {
        Settings { structure: self.structure.clone(), solver: self.used.solver.into() }
    }

    /// As the fit takes it.
    pub(in crate::analysis) fn fit_settings(&self, fit: &FitSpec) -> FitSettings {
        FitSettings {
            structure: self.structure.clone(),
            condition_numbers: fit.condition_numbers.clone(),
            metric: self.metric.clone(),
            random_starts: fit.random_starts,
            seed: fit.seed,
            evaluations: fit.evaluations,
        }
    }

    /// The seed of the random starts; none without a fit.
    pub(in crate::analysis) fn seed(&self) -> Option<u64> {
        self.used.fit.as_ref().map(|fit| fit.seed)
    }
}

fn check_fit(fit: &FitSpec, sizes: [usize; 2], at: &str) -> Result<(), Problem> {
    let list = &fit.condition_numbers;
    let increasing = list.windows(2).all(|pair| pair[0] < pair[1]);
    let in_range = list.iter().all(|k| *k > 1.0 && *k <= 1e12);
    if list.is_empty() || list.len() > MAX_POINTS || !increasing || !in_range {
        let detail = format!("condition_numbers must be 1 to {MAX_POINTS} increasing numbers above 1, up to 1e12");
        return Err(wrong(detail, format!("{at}/condition_numbers")));
    }
    if fit.random_starts > MAX_STARTS {
        let detail = format!("there are {} random starts; at most {MAX_STARTS} are taken", fit.random_starts);
        return Err(wrong(detail, format!("{at}/random_starts")));
    }
    if fit.evaluations.is_some_and(|count| !(1..=MAX_EVALUATIONS).contains(&count)) {
        let detail = format!("evaluations must be 1 to {MAX_EVALUATIONS}");
        return Err(wrong(detail, format!("{at}/evaluations")));
    }
    let Some(descent) = &fit.descent else { return Ok(()) };
    if !(descent.rate > 0.0 && descent.rate.is_finite()) {
        let detail = format!("the rate is {}, and must be positive and finite", descent.rate);
        return Err(wrong(detail, format!("{at}/descent/rate")));
    }
    if !(1..=MAX_STEPS).contains(&descent.steps) {
        let detail = format!("there are {} steps; 1 to {MAX_STEPS} are taken", descent.steps);
        return Err(wrong(detail, format!("{at}/descent/steps")));
    }
    if let DescentStart::Weights(weights) = &descent.start {
        weights.checked(sizes, &format!("{at}/descent/start"))?;
    }
    Ok(())
}

/// The inverse of a covariance of `size` entries.
fn metric(rows: &[Vec<f64>], size: usize, at: &str) -> Result<DMatrix<f64>, Problem> {
    let covariance = dense(rows, "the covariance", at)?;
    if covariance.shape() != (size, size) {
        let (rows, columns) = covariance.shape();
        return Err(wrong(format!("the covariance is {rows}x{columns} and must be {size}x{size}"), at));
    }
    let asymmetric = (&covariance - covariance.transpose()).norm() > 1e-10 * covariance.norm();
    let inverse = if asymmetric { None } else { covariance.cholesky().map(|factor| factor.inverse()) };
    inverse.ok_or_else(|| wrong("the covariance is not symmetric and positive definite", at))
}
