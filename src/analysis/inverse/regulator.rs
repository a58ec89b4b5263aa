//! The result about a regulator.

use super::evidence::{
    EvidenceResult, RefutationResult, SolvedByName, UnreachedResult, evidence, refutation, unreached,
};
use super::findings::Findings;
use super::half::Half;
use super::parts::{
    AxisResult, ComparisonResult, DescentCourse, EquivalentResult, FitPointResult, ProofResult, Rows, Verdict, curve,
    poles, proof, rows,
};
use super::reading::read;
use super::shares::SharesResult;
use crate::inverse::Gains;
use crate::inverse::fit::{Fit, FitPoint};
use schemars::JsonSchema;
use serde::Serialize;

/// What the weights of a regulator mean.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseLqrReading")]
pub struct CostReading {
    /// Q on the scale on which R has the mean eigenvalue 1, in `normalised_q_units`.
    pub normalised_q: Rows,
    /// R on that scale, in `normalised_r_units`.
    pub normalised_r: Rows,
    /// The units of the entries of `normalised_q`; null where `state_units` or `input_units` are not given.
    pub normalised_q_units: Option<Vec<Vec<String>>>,
    /// The units of the entries of `normalised_r`; null likewise.
    pub normalised_r_units: Option<Vec<Vec<String>>>,
    /// What one unit of each state is worth in input.
    pub equivalents: Option<Vec<EquivalentResult>>,
    /// Principal axes of Q, dearest first. Of states with different units they turn with the units: see `sized_axes`.
    pub q_axes: Vec<AxisResult>,
    /// Principal axes of R, dearest first.
    pub r_axes: Vec<AxisResult>,
    /// Principal axes of Q with every state counted in its own size (`sizes`): what is paid for motions as they are,
    /// whatever the units. Null where there are no sizes.
    pub sized_axes: Option<Vec<AxisResult>>,
    /// The root mean square of every state in its unit, along the trajectory of the request, or else in the steady
    /// state under white noise of unit intensity on every state; null where neither exists.
    pub sizes: Option<Vec<f64>>,
    /// Shares in the steady state under white noise of unit intensity on every state; null where the cost is zero
    /// there.
    pub stationary_shares: Option<SharesResult>,
    /// Shares along the trajectory of the request; null without one, or where it costs nothing.
    pub trajectory_shares: Option<SharesResult>,
    /// The other cost of the request; null without one.
    pub comparison: Option<ComparisonResult>,
}

/// The nearest optimal gain, where this one is optimal for no cost.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseLqrFit")]
pub struct CostFit {
    /// Q under the largest condition number, n×n, in units of cost over those of the states.
    pub q: Rows,
    /// R under the largest condition number, m×m, in units of cost over those of the inputs.
    pub r: Rows,
    /// Its gain, m×n, in units of the inputs over those of the states.
    pub k: Rows,
    /// Its squared distance in squared units of the gain, or, with a covariance, weighted by its inverse and
    /// dimensionless.
    pub residual: f64,
    /// `‖K̂ − K‖_F/‖K‖_F`, dimensionless.
    pub relative_distance: f64,
    /// The largest condition number, dimensionless.
    pub condition_number: f64,
    /// The trade-off between distance and condition number.
    pub curve: Vec<FitPointResult>,
    /// Without a bound on the condition number, Q ⪰ 0 and R ≻ 0 alone: the least squared distance found, in the unit of
    /// `residual`. It is usually not attained, and falls as far as the steps still gain.
    pub unbounded_residual: Option<f64>,
    /// The condition number of blkdiag(Q, R) there, dimensionless; null where rounding leaves no least eigenvalue.
    pub unbounded_condition_number: Option<f64>,
    /// The smallest `‖S‖_F` of a cost with a cross term 2xᵀSu and R ⪰ I for which the gain is optimal (Priess 2015, eq.
    /// (3.20)), in the unit of S; null with a structure, and beyond 20 states and inputs together.
    pub smallest_cross_term: Option<f64>,
    /// The weights of that cost; null with a structure.
    pub cross_term: Option<CostWithCrossTerm>,
    /// Evaluations of the regulator that the fit took.
    pub evaluations: usize,
    /// Evaluations that it was allowed.
    pub evaluations_allowed: usize,
    /// The gradient descent of Priess 2015, where it was asked for.
    pub descent: Option<CostDescent>,
}

/// A cost `xᵀQx + 2xᵀSu + uᵀRu` for which the gain is optimal.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseLqrCrossTerm")]
pub struct CostWithCrossTerm {
    /// Q, n×n, in units of cost over those of the states.
    pub q: Rows,
    /// R ⪰ I, m×m, in units of cost over those of the inputs.
    pub r: Rows,
    /// S, n×m, of the smallest norm, in units of cost over those of states and inputs.
    pub s: Rows,
}

/// Where the descent of Priess 2015, Table 3.1, ended. It promises no minimum: the fit beside it is usually nearer.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseLqrDescent")]
pub struct CostDescent {
    /// Q, n×n, in units of cost over those of the states.
    pub q: Rows,
    /// R, m×m, in units of cost over those of the inputs.
    pub r: Rows,
    /// Its gain, m×n, in units of the inputs over those of the states.
    pub k: Rows,
    /// The squared distance before the first step, in the unit of the fit's `residual`.
    pub first_residual: f64,
    /// And after the last.
    pub residual: f64,
    /// Steps of Q that were left out, since it would not have stayed semidefinite.
    pub rejected_q: usize,
    /// Steps of R that were left out.
    pub rejected_r: usize,
    /// How it went, at 400 places at most.
    pub course: DescentCourse,
}

/// Whether a cost exists for which the gain is optimal, and which.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct InverseLqrResult {
    /// Whether weights exist, within the structure that was asked for.
    pub verdict: Verdict,
    /// Whether that structure leaves states out of Q. A feasible verdict then means weights that are definite on the
    /// others, which for the whole are on the boundary.
    pub within_pattern: bool,
    /// The verdict without a structure, what it rests on, and by how much. Where that is infeasible every structure is.
    pub evidence: EvidenceResult,
    /// What proves that the structure that was asked for has no weights; null where it has some or nothing proves
    /// either, and where the whole has none.
    pub refutation: Option<RefutationResult>,
    /// ‖ΔK‖/‖K‖ up to the boundary, dimensionless, in units in which plant and gain are of one size. With one input to
    /// first order (where infeasible a lower bound of it), with several a lower bound, up to which the certificate
    /// holds. Null without a certificate.
    pub relative_change: Option<f64>,
    /// c*: the factor on the whole gain at which it becomes optimal, dimensionless, whatever the units; below 1 where
    /// it is. Null where no factor helps. With several inputs to a thousandth, certified on both sides, up to 36
    /// entries of the gain; null beyond. It never replaces `relative_change`: a gain on the boundary may have any c* up
    /// to 1.
    pub c_star: Option<f64>,
    /// Whether the verdict carries no information: in sampled time with a singular A and one input every stabilising
    /// gain that vanishes on the kernel of A is optimal for some Q.
    pub uninformative: bool,
    /// Modes that no input reaches; null where inputs reach every state.
    pub unreached: Option<UnreachedResult>,
    /// `max t` with `Q ⪰ tI`, `R ⪰ tI`, `tr Q + tr R = n + m` (Priess 2015), in the units of the plant. It is no
    /// distance and decides nothing: it is 0 for many gains that no R ≻ 0 makes optimal, since R may become singular.
    /// Null where no weights have a positive trace, and beyond 64 unknowns without a structure.
    pub t_star: Option<f64>,
    /// The same in units in which Q and R are of one size, dimensionless.
    pub t_star_scaled: Option<f64>,
    /// No larger `t_star_scaled` exists, by the dual; dimensionless.
    pub t_star_upper_bound: Option<f64>,
    /// Dimension of the space of weights that satisfy the equalities.
    pub unknowns: usize,
    /// The least condition number of blkdiag(Q, R), dimensionless; null without definite weights, and beyond 600
    /// unknowns.
    pub alpha: Option<f64>,
    /// No smaller one exists, by the dual; dimensionless.
    pub alpha_lower_bound: Option<f64>,
    /// Dimension of the set of weights that attain it.
    pub solution_dimension: Option<usize>,
    /// Largest range of a diagonal weight within that set, as a share of the weight, dimensionless; null where its
    /// dimension is too high for that to be measured.
    pub solution_width: Option<f64>,
    /// Who solved the matrix inequality of the least condition number; null where it was not solved.
    pub solved_by: Option<SolvedByName>,
    /// Q, n×n, in units of cost over those of the states; null without weights.
    pub q: Option<Rows>,
    /// R, m×m, in units of cost over those of the inputs.
    pub r: Option<Rows>,
    /// P of the Riccati equation, n×n, in units of cost over those of the states (in continuous time times s).
    pub p: Option<Rows>,
    /// `‖K̂ − K‖_F/‖K‖_F` of the gain that the forward problem returns, dimensionless.
    pub forward_error: Option<f64>,
    /// Poles of the closed loop with the gain given, as `[re, im]`, in rad/s (in sampled time in z, dimensionless).
    pub closed_loop_poles: Vec<[f64; 2]>,
    /// What shows that the weights belong to the gain; null without weights.
    pub proof: Option<ProofResult>,
    /// What the weights mean: these, or those of the fit; null without either.
    pub reading: Option<CostReading>,
    /// Where the gain is optimal for no cost; null where it is, and where no fit was asked for.
    pub fit: Option<CostFit>,
}

impl InverseLqrResult {
    pub(super) fn new(half: &Half, findings: &Findings) -> Self {
        let Findings { answer, fitted, .. } = findings;
        let gains = &half.gains;
        let weights = answer.weights.as_ref();
        let best = fitted.as_ref().and_then(|fit| Some((fit, fit.curve.last()?)));
        let reading = match (weights, best) {
            (Some(w), _) => Some(read(half, &w.q, &w.r, gains.k())),
            (None, Some((_, best))) => Some(read(half, &best.q, &best.r, &best.k)),
            (None, None) => None,
        };
        Self {
            verdict: answer.verdict.into(),
            within_pattern: answer.is_within_pattern,
            evidence: evidence(half, answer),
            refutation: refutation(half, answer),
            relative_change: answer.decision.relative_change.filter(|v| v.is_finite()),
            c_star: answer.decision.factor,
            uninformative: answer.decision.is_uninformative,
            unreached: unreached(half),
            solved_by: answer.solved_by.map(SolvedByName::from),
            t_star: answer.t_star,
            t_star_scaled: answer.t_star_scaled,
            t_star_upper_bound: answer.t_star_upper_bound,
            unknowns: answer.unknowns,
            alpha: answer.conditioning.map(|c| c.alpha),
            alpha_lower_bound: answer.conditioning.map(|c| c.alpha_lower_bound),
            solution_dimension: answer.conditioning.map(|c| c.solution_dimension),
            solution_width: answer.conditioning.and_then(|c| c.solution_width),
            q: weights.map(|w| rows(&w.q)),
            r: weights.map(|w| rows(&w.r)),
            p: weights.map(|w| rows(&w.proof.p)),
            forward_error: weights.map(|w| w.proof.forward_error),
            closed_loop_poles: poles(gains.poles()),
            proof: weights.map(|w| proof(w, half.sample_time_s)),
            reading,
            fit: best.map(|(fit, best)| CostFit::new(gains, fit, best, findings)),
        }
    }
}

impl CostFit {
    fn new(gains: &Gains, fit: &Fit, best: &FitPoint, findings: &Findings) -> Self {
        Self {
            q: rows(&best.q),
            r: rows(&best.r),
            k: rows(&best.k),
            residual: best.residual,
            relative_distance: (&best.k - gains.k()).norm() / gains.k().norm(),
            condition_number: best.condition_number,
            curve: curve(fit),
            unbounded_residual: fit.unbounded.map(|found| found.residual),
            unbounded_condition_number: fit.unbounded.map(|u| u.condition_number).filter(|v| v.is_finite()),
            smallest_cross_term: findings.cross_term.as_ref().map(|found| found.norm),
            cross_term: findings.cross_term.as_ref().map(|found| CostWithCrossTerm {
                q: rows(&found.q),
                r: rows(&found.r),
                s: rows(&found.s),
            }),
            evaluations: fit.evaluations,
            evaluations_allowed: fit.allowed,
            descent: findings.descent.as_ref().map(|found| CostDescent {
                q: rows(&found.q),
                r: rows(&found.r),
                k: rows(&found.k),
                first_residual: found.values.first().copied().unwrap_or_default(),
                residual: found.values.last().copied().unwrap_or_default(),
                rejected_q: found.rejected_q,
                rejected_r: found.rejected_r,
                course: DescentCourse::new(found),
            }),
        }
    }
}
