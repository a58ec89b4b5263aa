//! How the question is put: as written, and checked.

use super::structure_spec::{PortWeight, StateWeight, WeightName, structure};
use crate::analysis::contract::Part;
use crate::analysis::inputs::matrix::dense;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{self, wrong_spec as wrong};
use crate::inverse::fit::FitSettings;
use crate::inverse::{Gains, Structure};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Condition numbers of a fit at most.
const MAX_POINTS: usize = 20;
/// Steps of a descent at most.
const MAX_STEPS: usize = 100_000;
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
    /// Covariance of the gain's entries in their squared units, column by column, mn×mn, positive definite; of a filter
    /// those of Lᵀ. The fit then weights by its inverse. Default: none, all entries alike.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_covariance: Option<Vec<Vec<f64>>>,
    /// The gradient descent of Priess 2015, Table 3.1, beside the fit, for comparison. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub descent: Option<DescentSpec>,
}

/// The gradient descent of Priess 2015, Table 3.1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DescentSpec {
    /// λ, the length of a step over the gradient, positive.
    pub rate: f64,
    /// Steps, up to 100,000.
    pub steps: usize,
    /// Where it starts. Default: identity.
    #[serde(default)]
    pub start: DescentStart,
}

/// Where the descent starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DescentStart {
    /// Q and R are the identity.
    #[default]
    Identity,
    /// The weights of the smallest cross term (3.20), as Table 3.1 starts.
    CrossTerm,
}

impl Default for FitSpec {
    fn default() -> Self {
        let settings = FitSettings::default();
        Self {
            condition_numbers: settings.condition_numbers,
            random_starts: settings.random_starts,
            seed: settings.seed,
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
    /// The fit where no weights exist; null for none. Default: a fit with its defaults.
    pub fit: Option<FitSpec>,
}

impl Default for InverseSpec {
    fn default() -> Self {
        Self {
            state_weight: StateWeight::Name(WeightName::Full),
            port_weight: PortWeight::Name(WeightName::Full),
            semidefinite: false,
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
             ..}), semidefinite and fit.",
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
                check_fit(fit, &at)?;
                let read = |rows: &Vec<Vec<f64>>| metric(rows, n * m, &format!("{at}/gain_covariance"));
                fit.gain_covariance.as_ref().map(read).transpose()?
            }
        };
        Ok(Self { used: written, structure, metric })
    }

    /// As the fit takes it.
    pub(in crate::analysis) fn fit_settings(&self, fit: &FitSpec) -> FitSettings {
        FitSettings {
            structure: self.structure.clone(),
            condition_numbers: fit.condition_numbers.clone(),
            metric: self.metric.clone(),
            random_starts: fit.random_starts,
            seed: fit.seed,
        }
    }

    /// The seed of the random starts; none without a fit.
    pub(in crate::analysis) fn seed(&self) -> Option<u64> {
        self.used.fit.as_ref().map(|fit| fit.seed)
    }
}

fn check_fit(fit: &FitSpec, at: &str) -> Result<(), Problem> {
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
    let Some(descent) = &fit.descent else { return Ok(()) };
    if !(descent.rate > 0.0 && descent.rate.is_finite()) {
        let detail = format!("the rate is {}, and must be positive and finite", descent.rate);
        return Err(wrong(detail, format!("{at}/descent/rate")));
    }
    if !(1..=MAX_STEPS).contains(&descent.steps) {
        let detail = format!("there are {} steps; 1 to {MAX_STEPS} are taken", descent.steps);
        return Err(wrong(detail, format!("{at}/descent/steps")));
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
