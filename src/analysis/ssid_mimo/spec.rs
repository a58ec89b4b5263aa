//! How it is identified: as written, and checked.

use crate::analysis::contract::Part;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::{self, wrong_spec as wrong};
use crate::identify::mimo::FeedbackPool;
use crate::identify::pool::spec::Axis;
use crate::identify::ssid::Weights;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Candidates tried where the spec does not say otherwise.
const MAX_CANDIDATES: u64 = 500_000_000;

/// The order of the feedforward where the spec does not say otherwise.
const FEEDFORWARD_ORDER: usize = 2;

/// The highest order of the feedforward.
const MAX_ORDER: usize = 200;

/// How it is identified.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(extend("required" = ["pool"]))]
pub struct SsidMimoSpec {
    /// The candidate feedback controllers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pool: Option<MatrixPoolSpec>,
    /// Order of the FIR feedforward `Gff = B_0 + B_1/z + … + B_n/z^n`. Default 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedforward_order: Option<usize>,
    /// How lines are weighted. Default: uniform.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<Weights>,
    /// Larger pools are refused, counted before any candidate is tested for stability. Default: 5e8.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_candidates: Option<u64>,
    /// The sample time of the controllers on a continuous plant, which is sampled behind a zero-order hold.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_time_s: Option<f64>,
}

/// A pool of feedback controllers with several inputs and outputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MatrixPoolSpec {
    /// The grids.
    pub matrix_grid: MatrixGrid,
    /// Closed-loop poles have exponents with real parts below minus this, in 1/s: `|z| < exp(−margin·sample_time_s)`.
    /// Default 0.
    #[serde(default)]
    pub stability_margin: f64,
}

/// Grids for the coefficients of a left matrix fraction `Gfb = Dfb⁻¹ Nfb`, one axis for each coefficient; entries in
/// descending powers.
///
/// Candidates are counted row by row, the first coefficient outermost: in a row the entries of the numerator from left
/// to right, then those of the denominator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MatrixGrid {
    /// Nfb, controls by fed-back outputs; each entry the axes of its coefficients. An entry without axes is 0.
    #[schemars(with = "Vec<Vec<Vec<Axis>>>")]
    pub feedback_numerator: Vec<Vec<Vec<Axis>>>,
    /// Dfb, controls by controls. A diagonal entry holds the axes of `z^d`'s lower coefficients (d axes), the others of
    /// their row at most as many. Default: the identity, which makes the feedback a matrix of gains.
    #[schemars(with = "Option<Vec<Vec<Vec<Axis>>>>")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedback_denominator: Option<Vec<Vec<Vec<Axis>>>>,
}

impl Part for SsidMimoSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        if let Some(pool) = value.get("pool").filter(|pool| pool.get("matrix_grid").is_none()) {
            return Err(wrong(
                format!("the pool {pool} holds no controllers with several inputs and outputs"),
                format!("{at}/pool"),
            )
            .mend("Add \"pool\": {\"matrix_grid\": {\"feedback_numerator\": [[[axis, ..], ..], ..]}}."));
        }
        reading::spec(value, at)
    }
}

/// A checked spec.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CheckedSpec {
    /// With every default filled in.
    pub used: SsidMimoSpec,
    /// The pool.
    pub pool: FeedbackPool,
    /// Order of the FIR feedforward.
    pub feedforward_order: usize,
    /// How lines are weighted.
    pub weights: Weights,
    /// Larger pools are refused.
    pub max_candidates: u64,
}

impl CheckedSpec {
    /// Checks a spec.
    pub(super) fn new(written: SsidMimoSpec) -> Result<Self, Problem> {
        let Some(pool) = written.pool else {
            return Err(wrong("there is no pool of candidates", "/spec")
                .mend("Add \"pool\": {\"matrix_grid\": {\"feedback_numerator\": [[[axis, ..], ..], ..]}}."));
        };
        let grid = &pool.matrix_grid;
        let checked = FeedbackPool::new(
            &grid.feedback_numerator,
            grid.feedback_denominator.as_ref(),
            pool.stability_margin,
            "pool/matrix_grid",
        )
        .map_err(|error| {
            let code = if error.too_large { Code::Unaffordable } else { Code::Invalid };
            Problem::new(code, "unusable candidate pool", error.message).at(format!("/spec/{}", error.field))
        })?;
        let feedforward_order = written.feedforward_order.unwrap_or(FEEDFORWARD_ORDER);
        if feedforward_order > MAX_ORDER {
            let detail = format!("the order {feedforward_order} is above {MAX_ORDER}");
            return Err(wrong(detail, "/spec/feedforward_order"));
        }
        let max_candidates = written.max_candidates.unwrap_or(MAX_CANDIDATES);
        if max_candidates == 0 {
            return Err(wrong("at least one candidate must be allowed", "/spec/max_candidates"));
        }
        if let Some(period) = written.sample_time_s.filter(|t| !(t.is_finite() && *t > 0.0)) {
            return Err(wrong(format!("the sample time {period} s is not positive"), "/spec/sample_time_s"));
        }
        let weights = written.weights.unwrap_or_default();
        let used = SsidMimoSpec {
            pool: Some(pool),
            feedforward_order: Some(feedforward_order),
            weights: Some(weights),
            max_candidates: Some(max_candidates),
            sample_time_s: written.sample_time_s,
        };
        Ok(Self { used, pool: checked, feedforward_order, weights, max_candidates })
    }
}
