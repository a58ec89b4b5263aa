//! What the search came to.

use super::spec::SubjectSpec;
use crate::excite::robust::Trace;
use crate::excite::sequence::SequenceSpec;
use crate::plants::head_neck::Axis;
use schemars::JsonSchema;
use serde::Serialize;

/// The result of `robust_input_design`.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct RobustInputDesignResult {
    /// What came of it, in a sentence; of a search that found nothing better it begins with `Null result`.
    pub conclusion: String,
    /// About which axis the head turns.
    pub axis: Axis,
    /// The experiment whose worst subject costs least.
    pub robust: DesignResult,
    /// The experiment that is best for the average subject: the baseline.
    pub nominal: DesignResult,
    /// The experiment at hand, with what it costs its worst subject more than the nominal and than the robust one; null
    /// without.
    pub given: Option<GivenResult>,
    /// θ_A: whom the nominal experiment is best for.
    pub average_subject: SubjectSpec,
    /// What that one costs with the average subject: its J, dimensionless.
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
    /// Evaluations of the cost, those included that the excursions alone settled.
    pub evaluations: usize,
    /// Everything that is assumed beyond the source, in words and numbers.
    pub assumptions: Vec<String>,
}

/// An experiment.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "RobustInputDesignExperimentResult")]
pub struct DesignResult {
    /// Edge of the target's pass band, in Hz.
    pub edge_hz: f64,
    /// Width of the screen, in m.
    pub width_m: f64,
    /// The largest cost J of a subject found, dimensionless, with the draws of the search.
    pub worst_cost: f64,
    /// The worst subjects found, the worst first.
    pub worst_subjects: Vec<SubjectCost>,
    /// The target as a sequence, to be made again or played elsewhere.
    pub target: SequenceSpec,
    /// Its samples, in rad.
    pub samples: Vec<f64>,
    /// The same with draws that the search has never seen.
    pub fresh: FreshResult,
}

/// The experiment at hand.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "RobustInputDesignGivenResult")]
pub struct GivenResult {
    /// The experiment.
    pub design: DesignResult,
    /// Its worst cost less that of the nominal experiment, draw by draw.
    pub over_nominal: CostDifference,
    /// Its worst cost less that of the robust experiment, draw by draw.
    pub over_robust: CostDifference,
}

/// A mean with its interval.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "RobustInputDesignCostDifference")]
pub struct CostDifference {
    /// Mean of the difference of J, dimensionless.
    pub mean: f64,
    /// Its 95 % interval, by Student's t.
    pub interval: [f64; 2],
}

/// A subject and its cost.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "RobustInputDesignSubjectCost")]
pub struct SubjectCost {
    /// The controller.
    pub subject: SubjectSpec,
    /// Its cost J, dimensionless.
    pub cost: f64,
}

impl SubjectCost {
    pub(super) fn new(theta: [f64; 4], cost: f64) -> Self {
        Self { subject: SubjectSpec::from(theta), cost }
    }
}

/// The worst subject's cost with fresh draws.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "RobustInputDesignFresh")]
pub struct FreshResult {
    /// The subject: the worst of those that the search found worst, with draws that are used for nothing else.
    pub subject: SubjectSpec,
    /// Its cost J, dimensionless, with draws that neither the search nor this choice has seen.
    pub cost: f64,
    /// Its 95 % interval, by Student's t over the draws.
    pub interval: [f64; 2],
    /// The optimism of the search: that cost less the one that the search saw for the same subject with its own draws.
    pub optimism: CostDifference,
    /// What J is made of.
    pub parts: CostParts,
    /// Draws of body and muscle noise.
    pub draws: usize,
    /// Fits that did not converge.
    pub not_converged: usize,
}

/// Means over the draws.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "RobustInputDesignCostParts")]
pub struct CostParts {
    /// Squared relative errors of the fitted parameters, dimensionless.
    pub error: f64,
    /// L_a: excursions beyond the limit of acceleration, dimensionless.
    pub acceleration: f64,
    /// L_T: excursions beyond the limit of torque, dimensionless.
    pub torque: f64,
    /// L_n: excursions beyond the limit of angle, dimensionless.
    pub angle: f64,
}

/// The nominal experiment's worst cost less the robust one's, draw by draw.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "RobustInputDesignDifference")]
pub struct DifferenceResult {
    /// Mean of the difference of J, dimensionless.
    pub mean: f64,
    /// Its 95 % interval, by Student's t.
    pub interval: [f64; 2],
    /// What the interval says.
    pub verdict: RobustVerdict,
    /// Whether the interval reaches zero or above.
    pub no_worse: bool,
}

/// Whether fresh draws tell the robust experiment from the nominal one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[schemars(rename = "RobustInputDesignVerdict")]
#[serde(rename_all = "snake_case")]
pub enum RobustVerdict {
    /// The whole interval is above zero.
    RobustBetter,
    /// The interval holds zero.
    NotDistinguished,
    /// The whole interval is below zero.
    RobustWorse,
}

/// An iteration of the min-max.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "RobustInputDesignIteration")]
pub struct IterationResult {
    /// The subject, on its way to the worst.
    pub subject: SubjectSpec,
    /// The edge of the pass band in Hz, on its way to the best.
    pub edge_hz: f64,
    /// The width of the screen in m, on its way to the best.
    pub width_m: f64,
    /// The cost J there, dimensionless.
    pub cost: f64,
}

impl From<&Trace> for IterationResult {
    fn from(trace: &Trace) -> Self {
        let [edge_hz, width_m] = trace.gamma;
        Self { subject: SubjectSpec::from(trace.theta), edge_hz, width_m, cost: trace.cost }
    }
}
