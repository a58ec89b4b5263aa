//! Parts of results that regulators and filters have in common.

use crate::inverse::fit::{Descent, Fit};
use crate::inverse::lqr::Weights;
use crate::inverse::reading::{Axis, Comparison};
use nalgebra::DMatrix;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::Serialize;

/// Components of an axis below this are left out of its words.
const WORTH_SAYING: f64 = 0.05;

/// A matrix as an array of rows.
pub type Rows = Vec<Vec<f64>>;

/// Whether a cost (of a filter: noises) exists for which the gain is optimal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "InverseVerdict")]
pub enum Verdict {
    /// Weights exist that are definite (Q on the states that the structure lets it weigh), for some data within the
    /// rounding of those given, and by a margin above it.
    Feasible,
    /// Neither is proven: the boundary is nearer than the digits of the data, and singular weights may exist.
    Boundary,
    /// None exist for any data within the rounding, not even a semidefinite Q.
    Infeasible,
}

impl From<crate::inverse::Verdict> for Verdict {
    fn from(verdict: crate::inverse::Verdict) -> Self {
        match verdict {
            crate::inverse::Verdict::Feasible => Self::Feasible,
            crate::inverse::Verdict::Infeasible => Self::Infeasible,
            crate::inverse::Verdict::Boundary => Self::Boundary,
        }
    }
}

/// Kalman's inequality over frequency.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "ReturnDifference")]
pub struct ReturnDifferenceResult {
    /// The least eigenvalue of `R^(−1/2) (T*RT − R) R^(−1/2)` with `T = I + K(jωI − A)⁻¹B` (in sampled time with R +
    /// BᵀPB), dimensionless; not negative for an optimal gain, and tending to 0 at high frequency in continuous time.
    /// Of a filter that of its dual.
    pub margin: f64,
    /// Where it is, in rad/s.
    pub omega_rad_s: f64,
}

/// What shows that the weights belong to the gain.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseProof")]
pub struct ProofResult {
    /// `‖BᵀP − RK‖/‖RK‖`, in sampled time `‖BᵀPA − (BᵀPB + R)K‖/‖(BᵀPB + R)K‖`, dimensionless; of a filter that of its
    /// dual.
    pub gain_residual: f64,
    /// Relative residual of the Riccati equation, dimensionless.
    pub riccati_residual: f64,
    /// The gain that solving the forward problem returns, in the unit and shape of the gain given: m×n, of a filter
    /// n×p.
    pub forward_gain: Rows,
    /// Largest relative difference of two independent forward methods to the refined one, dimensionless; null where one
    /// broke down.
    pub method_difference: Option<f64>,
    /// Poles of the loop with that gain, as `[re, im]`, in rad/s (in sampled time in z, dimensionless).
    pub forward_poles: Vec<[f64; 2]>,
    /// Kalman's inequality; null where it was not judged.
    pub return_difference: Option<ReturnDifferenceResult>,
}

/// A principal axis of a weight.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "PrincipalAxis")]
pub struct AxisResult {
    /// What a unit along it costs (of noise: its variance or intensity), in the unit of the weight.
    pub weight: f64,
    /// Its share of the trace, dimensionless.
    pub share: f64,
    /// The unit vector, dimensionless, in the order of the states, inputs or outputs.
    pub direction: Vec<f64>,
    /// The same in words, such as `0.89 x1 + 0.45 x2`.
    pub combination: String,
}

/// Other weights beside these.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "WeightComparison")]
pub struct ComparisonResult {
    /// The factor on the other weights that brings them nearest to these, dimensionless.
    pub scale: f64,
    /// Cosine between blkdiag(Q, R) of both, dimensionless: 1 for equal weights, whatever their scales.
    pub similarity: f64,
    /// Root mean square of the logarithms of the relative weights around their mean, dimensionless: 0 for equal
    /// weights, whatever the units; null where a weight is singular.
    pub log_distance: Option<f64>,
    /// The factor on the other weights that makes the geometric mean of the relative weights 1, whatever the units,
    /// dimensionless; null where a weight is singular.
    pub log_scale: Option<f64>,
    /// For every state its diagonal weight here over the other one, brought to one scale (`log_scale`, else `scale`),
    /// dimensionless: above 1 where it counts for more here. Null where it counts for nothing there.
    pub state_ratios: Vec<Option<f64>>,
    /// The same for every input (of a filter: output), dimensionless.
    pub port_ratios: Vec<Option<f64>>,
}

/// What a state is worth.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "StateEquivalent")]
pub struct EquivalentResult {
    /// The state, by name.
    pub state: String,
    /// The input that costs as much as one unit of the state, others at zero: `√Q_ii` where R has the mean eigenvalue
    /// 1. In `unit`.
    pub input: f64,
    /// In which unit, such as `(N m)/rad`; null where units are not given.
    pub unit: Option<String>,
}

/// The best fit under one condition number.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseFitPoint")]
pub struct FitPointResult {
    /// κ, dimensionless.
    pub condition_number: f64,
    /// The squared distance of the gains in their squared units, or, with a covariance, weighted by its inverse and
    /// dimensionless.
    pub residual: f64,
    /// What another Newton step promises, as a share of the residual, dimensionless.
    pub stationarity: f64,
    /// Starts that ended there.
    pub agreeing_starts: usize,
    /// Starts in all.
    pub starts: usize,
}

/// Points of a descent's course at most; its first and last are among them.
const COURSE: usize = 400;

/// How a descent went: at the start, at the end, and at equal distances between.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseDescentCourse")]
pub struct DescentCourse {
    /// Steps that were taken before each of the values.
    pub step: Vec<usize>,
    /// The squared distance of the gains there, in the unit of the fit's `residual`.
    pub residual: Vec<f64>,
    /// `‖K − K_e‖_F/‖K_e‖_F` there, dimensionless.
    pub relative_distance: Vec<f64>,
}

impl DescentCourse {
    pub(super) fn new(found: &Descent) -> Self {
        let last = found.values.len().saturating_sub(1);
        let points = last.clamp(1, COURSE - 1);
        let mut step: Vec<usize> = (0..=points).map(|k| (k * last + points / 2) / points).collect();
        step.dedup();
        let of = |values: &[f64]| step.iter().filter_map(|at| values.get(*at).copied()).collect();
        let (residual, relative_distance) = (of(&found.values), of(&found.distances));
        Self { step, residual, relative_distance }
    }
}

/// A matrix as an array of rows.
pub(in crate::analysis) fn rows(m: &DMatrix<f64>) -> Rows {
    m.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// Poles as `[re, im]`.
pub(super) fn poles(values: &[Complex64]) -> Vec<[f64; 2]> {
    values.iter().map(|p| [p.re, p.im]).collect()
}

/// The proof of weights; frequencies of sampled time become rad/s by the sample time.
pub(super) fn proof(weights: &Weights, sample_time_s: Option<f64>) -> ProofResult {
    let per_second = sample_time_s.map_or(1.0, |period| 1.0 / period);
    let found = &weights.proof;
    ProofResult {
        gain_residual: found.gain_residual,
        riccati_residual: found.riccati_residual,
        forward_gain: rows(&found.forward_gain),
        method_difference: found.method_difference,
        forward_poles: poles(&found.forward_poles),
        return_difference: found
            .return_difference
            .map(|d| ReturnDifferenceResult { margin: d.margin, omega_rad_s: d.omega * per_second }),
    }
}

/// The trade-off between distance and condition number.
pub(super) fn curve(fit: &Fit) -> Vec<FitPointResult> {
    let point = |p: &crate::inverse::fit::FitPoint| FitPointResult {
        condition_number: p.condition_number,
        residual: p.residual,
        stationarity: p.stationarity,
        agreeing_starts: p.agreeing_starts,
        starts: p.starts,
    };
    fit.curve.iter().map(point).collect()
}

/// An axis, with the names of what it is made of.
pub(super) fn axis(axis: Axis, names: &[String]) -> AxisResult {
    let mut combination = String::new();
    for (value, name) in axis.direction.iter().zip(names) {
        if value.abs() >= WORTH_SAYING {
            let sign = match (combination.is_empty(), *value < 0.0) {
                (true, true) => "−",
                (true, false) => "",
                (false, true) => " − ",
                (false, false) => " + ",
            };
            combination.push_str(&format!("{sign}{:.2} {name}", value.abs()));
        }
    }
    AxisResult { weight: axis.weight, share: axis.share, direction: axis.direction, combination }
}

/// A comparison, as it is written.
pub(super) fn comparison(found: Comparison) -> ComparisonResult {
    let Comparison { scale, similarity, log_distance, log_scale, state_ratios, input_ratios } = found;
    ComparisonResult { scale, similarity, log_distance, log_scale, state_ratios, port_ratios: input_ratios }
}
