//! How it is identified: as written, and checked.

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

/// The spec of the multivariable form of `ssid`.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct SsidMimoSpec {
    /// The candidate feedback controllers.
    pub pool: MatrixPoolSpec,
    /// Order of the FIR feedforward `Gff = B_0 + B_1/z + … + B_n/z^n`. Default 2.
    pub feedforward_order: usize,
    /// How lines are weighted. Default: uniform.
    pub weights: Weights,
    /// Larger pools are refused, counted before any candidate is tested for stability. Default: 5e8.
    pub max_candidates: u64,
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
    /// Closed-loop poles have exponents with real parts below minus this, in 1/s: `|z| < exp(−margin·sample_time_s)`. Default 0.
    #[serde(default)]
    pub stability_margin: f64,
}

/// Grids for the coefficients of a left matrix fraction `Gfb = Dfb⁻¹ Nfb`, one axis for each coefficient; entries in descending powers.
///
/// Candidates are counted row by row, the first coefficient outermost: in a row the entries of the numerator from left to right,
/// then those of the denominator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MatrixGrid {
    /// Nfb, controls by fed-back outputs; each entry the axes of its coefficients. An entry without axes is 0.
    #[schemars(with = "Vec<Vec<Vec<Axis>>>")]
    pub feedback_numerator: Vec<Vec<Vec<Axis>>>,
    /// Dfb, controls by controls. A diagonal entry holds the axes of `z^d`'s lower coefficients (d axes), the others of their row at
    /// most as many. Default: the identity, which makes the feedback a matrix of gains.
    #[schemars(with = "Option<Vec<Vec<Vec<Axis>>>>")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedback_denominator: Option<Vec<Vec<Vec<Axis>>>>,
}

/// The spec as people write it.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Written {
    pool: Option<MatrixPoolSpec>,
    feedforward_order: Option<usize>,
    weights: Option<Weights>,
    max_candidates: Option<u64>,
    sample_time_s: Option<f64>,
}

/// A checked spec.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CheckedSpec {
    written: SsidMimoSpec,
    pool: FeedbackPool,
}

impl CheckedSpec {
    /// Checks the `spec` of a request.
    pub(super) fn parse(spec: &Value) -> Result<Self, Problem> {
        if let Some(pool) = spec.get("pool").filter(|pool| pool.get("matrix_grid").is_none()) {
            return Err(wrong(
                format!("the pool {pool} holds no controllers with several inputs and outputs"),
                "/spec/pool",
            )
            .mend("Add \"pool\": {\"matrix_grid\": {\"feedback_numerator\": [[[axis, ..], ..], ..]}}."));
        }
        let written: Written = reading::spec(spec)?;
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
        let written = SsidMimoSpec {
            pool,
            feedforward_order,
            weights: written.weights.unwrap_or_default(),
            max_candidates,
            sample_time_s: written.sample_time_s,
        };
        Ok(Self { written, pool: checked })
    }

    /// With its defaults filled in.
    pub(super) fn written(&self) -> &SsidMimoSpec {
        &self.written
    }

    /// The pool.
    pub(super) fn pool(&self) -> &FeedbackPool {
        &self.pool
    }
}
