//! What the search came to.

use super::spec::SubjectSpec;
use crate::excite::robust::Trace;
use crate::plants::head_neck::Axis;
use schemars::JsonSchema;
use serde::Serialize;

/// The result of `robust_input_design`.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct RobustInputDesignResult {
    /// About which axis the head turns.
    pub axis: Axis,
    /// The experiment whose worst subject costs least.
    pub robust: DesignResult,
    /// The experiment that is best for the average subject.
    pub nominal: DesignResult,
    /// What that one costs with the average subject.
    pub nominal_cost: f64,
    /// What the robust experiment spares its worst subject, with fresh draws.
    pub difference: DifferenceResult,
    /// The iterations of the simultaneous min-max (Table A.1).
    pub trace: Vec<IterationResult>,
    /// Subjects that the refinement held against the experiment.
    pub scenarios: Vec<SubjectSpec>,
    /// Rounds of the refinement.
    pub rounds: usize,
    /// Whether the last round met no subject worse than those taken into account.
    pub closed: bool,
    /// Evaluations of the cost.
    pub evaluations: usize,
    /// Everything that is assumed beyond the source, in words and numbers.
    pub assumptions: Vec<String>,
}

/// An experiment.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct DesignResult {
    /// Edge of the target's pass band, Hz.
    pub edge_hz: f64,
    /// Width of the screen, m.
    pub width_m: f64,
    /// The largest cost of a subject found, with the draws of the search.
    pub worst_cost: f64,
    /// The worst subjects found, the worst first.
    pub worst_subjects: Vec<SubjectCost>,
    /// The target as a sequence, to be made again or played elsewhere.
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub target: serde_json::Value,
    /// Its samples, rad.
    pub samples: Vec<f64>,
    /// The same with draws that the search has never seen.
    pub fresh: FreshResult,
}

/// A subject and its cost.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct SubjectCost {
    /// The controller.
    pub subject: SubjectSpec,
    /// J.
    pub cost: f64,
}

impl SubjectCost {
    pub(super) fn new(theta: [f64; 4], cost: f64) -> Self {
        Self { subject: SubjectSpec::from(theta), cost }
    }
}

/// The worst subject's cost with fresh draws.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct FreshResult {
    /// The subject: the worst, with these draws, of those that the search found worst.
    pub subject: SubjectSpec,
    /// J.
    pub cost: f64,
    /// Its 95 % interval, by Student's t over the draws.
    pub interval: [f64; 2],
    /// What J is made of.
    pub parts: CostParts,
    /// Draws.
    pub draws: usize,
    /// Fits that did not converge.
    pub not_converged: usize,
}

/// Means over the draws.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct CostParts {
    /// Squared relative errors of the fitted parameters.
    pub error: f64,
    /// L_a: excursions beyond the limit of acceleration.
    pub acceleration: f64,
    /// L_T: of torque.
    pub torque: f64,
    /// L_n: of angle.
    pub angle: f64,
}

/// The nominal experiment's worst cost less the robust one's, draw by draw.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct DifferenceResult {
    /// Mean.
    pub mean: f64,
    /// Its 95 % interval, by Student's t.
    pub interval: [f64; 2],
    /// `robust_better`, `not_distinguished` or `robust_worse`, by the interval.
    pub verdict: &'static str,
    /// Whether the interval reaches zero or above.
    pub no_worse: bool,
}

/// An iteration of the min-max.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct IterationResult {
    /// The subject, on its way to the worst.
    pub subject: SubjectSpec,
    /// The edge, on its way to the best.
    pub edge_hz: f64,
    /// The width.
    pub width_m: f64,
    /// J.
    pub cost: f64,
}

impl From<&Trace> for IterationResult {
    fn from(trace: &Trace) -> Self {
        let [edge_hz, width_m] = trace.gamma;
        Self { subject: SubjectSpec::from(trace.theta), edge_hz, width_m, cost: trace.cost }
    }
}
