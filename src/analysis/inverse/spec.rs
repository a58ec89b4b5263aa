//! How the question is put: as written, and checked.

use super::inputs::{InverseInputs, matrix};
use super::problems;
use crate::analysis::kind::Kind;
use crate::analysis::problem::{Code, Problem};
use crate::inverse::fit::FitSettings;
use crate::inverse::{Gains, QSign, Structure};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Condition numbers of a fit at most.
const MAX_POINTS: usize = 20;
/// Steps of a descent at most.
const MAX_STEPS: usize = 100_000;
/// Random starts of a fit at most.
const MAX_STARTS: usize = 100;

/// What is known of the weight on the states: Q of a regulator, W of a filter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum StateWeight {
    /// `full` or `diagonal`.
    Name(WeightName),
    /// Entries that may differ from zero, n×n, symmetric.
    Pattern {
        /// Rows of true and false.
        pattern: Vec<Vec<bool>>,
    },
}

/// A shape of a weight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WeightName {
    /// Any symmetric matrix.
    Full,
    /// A diagonal one.
    Diagonal,
}

/// What is known of the weight on the inputs: R of a regulator, or V, on the outputs of a filter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum PortWeight {
    /// `full` or `diagonal`.
    Name(WeightName),
    /// The weight itself, up to its scale.
    Fixed {
        /// Rows, m×m, positive definite.
        fixed: Vec<Vec<f64>>,
    },
    /// Entries that may differ from zero, m×m, symmetric.
    Pattern {
        /// Rows of true and false.
        pattern: Vec<Vec<bool>>,
    },
}

/// How weights are fitted where none make the gain optimal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FitSpec {
    /// Condition numbers κ of `I ⪯ blkdiag(Q, R) ⪯ κI`, increasing, each above 1. Default: 10 to 1e8 by tens.
    pub condition_numbers: Vec<f64>,
    /// Random starts for every κ, beside the fixed ones. Default: 4.
    pub random_starts: usize,
    /// Seed of the random starts. Default: 1.
    pub seed: u64,
    /// Covariance of the gain's entries, column by column, mn×mn, positive definite; of a filter those of Lᵀ. The fit then weights by its
    /// inverse. Default: none, all entries alike.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_covariance: Option<Vec<Vec<f64>>>,
    /// The gradient descent of Priess 2015, Table 3.1, beside the fit, for comparison. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub descent: Option<DescentSpec>,
}

/// The thesis' own descent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DescentSpec {
    /// λ, the length of a step over the gradient.
    pub rate: f64,
    /// Steps, up to 100,000.
    pub steps: usize,
    /// `identity` (default), or `cross_term`: the weights of the smallest cross term, as Table 3.1 starts.
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
    /// The weights of the smallest cross term (3.20).
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

/// The spec of `inverse_lqr` and `inverse_lqe`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InverseSpec {
    /// Q, or W: `"full"`, `"diagonal"` or `{"pattern": [[true, ..], ..]}`. Default: full.
    pub state_weight: StateWeight,
    /// R, or V: `"full"`, `"diagonal"`, `{"fixed": [[..]]}` or `{"pattern": ..}`. Default: full.
    pub port_weight: PortWeight,
    /// Whether Q (W) may be singular; a boundary verdict with proven weights then answers the question. Default: false.
    pub semidefinite: bool,
    /// The fit where no weights exist; null for none.
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

/// The spec of `inverse_lqg`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InverseLqgSpec {
    /// For K.
    pub regulator: InverseSpec,
    /// For L.
    pub filter: InverseSpec,
}

/// A checked spec of one half.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Checked {
    pub written: InverseSpec,
    pub structure: Structure,
    pub metric: Option<DMatrix<f64>>,
}

/// The checked specs of the halves that are asked for.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CheckedSpecs {
    pub regulator: Option<Checked>,
    pub filter: Option<Checked>,
}

fn wrong(detail: impl Into<String>, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "unusable spec", detail).at(at)
}

fn pattern(rows: &[Vec<bool>], order: usize, at: &str) -> Result<DMatrix<bool>, Problem> {
    if rows.len() != order || rows.iter().any(|row| row.len() != order) {
        return Err(wrong(format!("the pattern has {} rows and must be {order}x{order}", rows.len()), at));
    }
    Ok(DMatrix::from_fn(order, order, |i, j| rows[i][j]))
}

/// What a spec says about the weights of n states and m ports.
pub(in crate::analysis) fn structure(
    written: &InverseSpec,
    n: usize,
    m: usize,
    at: &str,
) -> Result<Structure, Problem> {
    let diagonal = |order: usize| DMatrix::from_fn(order, order, |i, j| i == j);
    let mut structure = Structure {
        q_sign: if written.semidefinite { QSign::Semidefinite } else { QSign::Definite },
        ..Structure::default()
    };
    structure.q_pattern = match &written.state_weight {
        StateWeight::Name(WeightName::Full) => None,
        StateWeight::Name(WeightName::Diagonal) => Some(diagonal(n)),
        StateWeight::Pattern { pattern: rows } => Some(pattern(rows, n, &format!("{at}/state_weight/pattern"))?),
    };
    match &written.port_weight {
        PortWeight::Name(WeightName::Full) => {}
        PortWeight::Name(WeightName::Diagonal) => structure.r_pattern = Some(diagonal(m)),
        PortWeight::Pattern { pattern: rows } => {
            structure.r_pattern = Some(pattern(rows, m, &format!("{at}/port_weight/pattern"))?);
        }
        PortWeight::Fixed { fixed } => {
            structure.r = Some(matrix(&json!(fixed), "the fixed weight", &format!("{at}/port_weight/fixed"))?);
        }
    }
    structure.check(n, m).map_err(|error| problems::structure(&error, at))?;
    Ok(structure)
}

impl Checked {
    fn new(written: InverseSpec, gains: &Gains, at: &str) -> Result<Self, Problem> {
        let (n, m) = (gains.states(), gains.ports());
        let structure = structure(&written, n, m, at)?;
        let mut metric = None;
        if let Some(fit) = &written.fit {
            let list = &fit.condition_numbers;
            let increasing = list.windows(2).all(|pair| pair[0] < pair[1]);
            if list.is_empty()
                || list.len() > MAX_POINTS
                || !increasing
                || list.iter().any(|k| !(*k > 1.0 && *k <= 1e12))
            {
                return Err(wrong(
                    format!("condition_numbers must be 1 to {MAX_POINTS} increasing numbers above 1, up to 1e12"),
                    format!("{at}/fit/condition_numbers"),
                ));
            }
            if fit.random_starts > MAX_STARTS {
                return Err(wrong(
                    format!("there are {} random starts; at most {MAX_STARTS} are taken", fit.random_starts),
                    format!("{at}/fit/random_starts"),
                ));
            }
            if let Some(descent) = &fit.descent {
                if !(descent.rate > 0.0 && descent.rate.is_finite()) {
                    let detail = format!("the rate is {}, and must be positive and finite", descent.rate);
                    return Err(wrong(detail, format!("{at}/fit/descent/rate")));
                }
                if !(1..=MAX_STEPS).contains(&descent.steps) {
                    let detail = format!("there are {} steps; 1 to {MAX_STEPS} are taken", descent.steps);
                    return Err(wrong(detail, format!("{at}/fit/descent/steps")));
                }
            }
            if let Some(rows) = &fit.gain_covariance {
                let at = format!("{at}/fit/gain_covariance");
                let covariance = matrix(&json!(rows), "the covariance", &at)?;
                let size = n * m;
                if covariance.shape() != (size, size) {
                    let (rows, columns) = covariance.shape();
                    return Err(wrong(format!("the covariance is {rows}x{columns} and must be {size}x{size}"), at));
                }
                let asymmetric = (&covariance - covariance.transpose()).norm() > 1e-10 * covariance.norm();
                let inverse = if asymmetric { None } else { covariance.cholesky().map(|factor| factor.inverse()) };
                metric =
                    Some(inverse.ok_or_else(|| wrong("the covariance is not symmetric and positive definite", at))?);
            }
        }
        Ok(Self { written, structure, metric })
    }

    pub(super) fn fit_settings(&self) -> FitSettings {
        let fit = self.written.fit.clone().unwrap_or_default();
        FitSettings {
            structure: self.structure.clone(),
            condition_numbers: fit.condition_numbers,
            metric: self.metric.clone(),
            random_starts: fit.random_starts,
            seed: fit.seed,
        }
    }
}

impl CheckedSpecs {
    pub(super) fn parse(spec: &Value, kind: Kind, inputs: &InverseInputs) -> Result<Self, Problem> {
        let Value::Object(members) = spec else {
            return Err(wrong("the spec is no object", "/spec"));
        };
        let read = |value: &Value, at: &str| {
            serde_json::from_value::<InverseSpec>(value.clone()).map_err(|error| {
                wrong(error.to_string(), at).mend(
                    "A spec has state_weight (\"full\", \"diagonal\" or {\"pattern\": ..}), port_weight (also {\"fixed\": ..}), \
                     semidefinite and fit.",
                )
            })
        };
        let (mut regulator, mut filter) = (InverseSpec::default(), InverseSpec::default());
        match kind {
            Kind::InverseLqg => {
                for (name, value) in members {
                    match name.as_str() {
                        "regulator" => regulator = read(value, "/spec/regulator")?,
                        "filter" => filter = read(value, "/spec/filter")?,
                        _ => {
                            return Err(wrong(format!("there is no setting {name:?}"), "/spec")
                                .mend("Give regulator and filter, each with the spec of its half."));
                        }
                    }
                }
            }
            Kind::InverseLqe => filter = read(spec, "/spec")?,
            _ => regulator = read(spec, "/spec")?,
        }
        let (at_regulator, at_filter) =
            if kind == Kind::InverseLqg { ("/spec/regulator", "/spec/filter") } else { ("/spec", "/spec") };
        Ok(Self {
            regulator: inputs.regulator.as_ref().map(|g| Checked::new(regulator, g, at_regulator)).transpose()?,
            filter: inputs.filter.as_ref().map(|g| Checked::new(filter, g, at_filter)).transpose()?,
        })
    }

    pub(super) fn to_value(&self) -> Value {
        match (&self.regulator, &self.filter) {
            (Some(regulator), Some(filter)) => json!({"regulator": regulator.written, "filter": filter.written}),
            (Some(half), None) | (None, Some(half)) => json!(half.written),
            (None, None) => json!({}),
        }
    }

    /// The seed of the first half that may draw random starts.
    pub(super) fn seed(&self) -> Option<u64> {
        self.regulator.iter().chain(&self.filter).find_map(|half| half.written.fit.as_ref().map(|fit| fit.seed))
    }
}
