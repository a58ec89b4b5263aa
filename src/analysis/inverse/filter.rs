//! The result about a filter: that of its dual regulator with the letters and shapes of a filter.

use super::evidence::{EvidenceResult, RefutationResult, SolvedByName, UnreachedResult};
use super::parts::{AxisResult, ComparisonResult, DescentCourse, FitPointResult, ProofResult, Rows, Verdict};
use super::regulator::{CostDescent, CostFit, CostReading, CostWithCrossTerm, InverseLqrResult};
use schemars::JsonSchema;
use serde::Serialize;

/// What the noises of a filter mean.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseLqeReading")]
pub struct NoiseReading {
    /// W on the scale on which V has the mean eigenvalue 1, in `normalised_w_units`.
    pub normalised_w: Rows,
    /// V on that scale, in `normalised_v_units`.
    pub normalised_v: Rows,
    /// The units of the entries of `normalised_w`; null where `state_units` or `output_units` are not given.
    pub normalised_w_units: Option<Vec<Vec<String>>>,
    /// The units of the entries of `normalised_v`; null likewise.
    pub normalised_v_units: Option<Vec<Vec<String>>>,
    /// Always null: only a cost says what a state is worth.
    pub equivalents: (),
    /// Principal axes of W, largest first. Of states with different units they turn with the units.
    pub w_axes: Vec<AxisResult>,
    /// Principal axes of V, largest first.
    pub v_axes: Vec<AxisResult>,
    /// Always null: of a cost only.
    pub sized_axes: (),
    /// Always null: of a cost only.
    pub sizes: (),
    /// Always null: of a cost only.
    pub stationary_shares: (),
    /// Always null: of a cost only.
    pub trajectory_shares: (),
    /// The other noises of the request; null without them.
    pub comparison: Option<ComparisonResult>,
}

/// The nearest optimal gain, where this one is optimal for no noises.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseLqeFit")]
pub struct NoiseFit {
    /// W under the largest condition number, n×n, in units of a noise of the states.
    pub w: Rows,
    /// V under the largest condition number, p×p, in units of a noise of the outputs.
    pub v: Rows,
    /// Its gain, n×p, in units of the states over those of the outputs (in continuous time per s).
    pub l: Rows,
    /// Its squared distance in squared units of the gain, or, with a covariance, weighted by its inverse and
    /// dimensionless.
    pub residual: f64,
    /// `‖L̂ − L‖_F/‖L‖_F`, dimensionless.
    pub relative_distance: f64,
    /// The largest condition number, dimensionless.
    pub condition_number: f64,
    /// The trade-off between distance and condition number.
    pub curve: Vec<FitPointResult>,
    /// Without a bound on the condition number, W ⪰ 0 and V ≻ 0 alone: the least squared distance found, in the unit of
    /// `residual`. It is usually not attained, and falls as far as the steps still gain.
    pub unbounded_residual: Option<f64>,
    /// The condition number of blkdiag(W, V) there, dimensionless; null where rounding leaves no least eigenvalue.
    pub unbounded_condition_number: Option<f64>,
    /// The smallest `‖S‖_F` of correlated noises with `E wvᵀ = S` and V ⪰ I for which the gain is optimal, in the unit
    /// of S; null with a structure, and beyond 20 states and outputs together.
    pub smallest_cross_term: Option<f64>,
    /// Those noises; null with a structure.
    pub cross_term: Option<NoiseWithCrossTerm>,
    /// Evaluations of the filter that the fit took.
    pub evaluations: usize,
    /// Evaluations that it was allowed.
    pub evaluations_allowed: usize,
    /// The gradient descent of Priess 2015, where it was asked for.
    pub descent: Option<NoiseDescent>,
}

/// Correlated noises for which the gain is optimal.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseLqeCrossTerm")]
pub struct NoiseWithCrossTerm {
    /// W, n×n, in units of a noise of the states.
    pub w: Rows,
    /// V ⪰ I, p×p, in units of a noise of the outputs.
    pub v: Rows,
    /// S, n×p, of the smallest norm, in units of a noise of states and outputs.
    pub s: Rows,
}

/// Where the descent of Priess 2015, Table 3.1, ended. It promises no minimum: the fit beside it is usually nearer.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "InverseLqeDescent")]
pub struct NoiseDescent {
    /// W, n×n, in units of a noise of the states.
    pub w: Rows,
    /// V, p×p, in units of a noise of the outputs.
    pub v: Rows,
    /// Its gain, n×p, in units of the states over those of the outputs (in continuous time per s).
    pub l: Rows,
    /// The squared distance before the first step, in the unit of the fit's `residual`.
    pub first_residual: f64,
    /// And after the last.
    pub residual: f64,
    /// Steps of W that were left out, since it would not have stayed semidefinite.
    pub rejected_q: usize,
    /// Steps of V that were left out.
    pub rejected_r: usize,
    /// How it went, at 400 places at most; its distances are those of the dual's gain Lᵀ.
    pub course: DescentCourse,
}

/// Whether noises exist for which the gain is optimal, and which.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct InverseLqeResult {
    /// Whether noises exist, within the structure that was asked for.
    pub verdict: Verdict,
    /// Whether that structure leaves states out of W. A feasible verdict then means noises that are definite on the
    /// others, which for the whole are on the boundary.
    pub within_pattern: bool,
    /// The verdict without a structure, what it rests on, and by how much, with A, B and K those of the dual: Aᵀ, Cᵀ,
    /// Lᵀ. Where that is infeasible every structure is.
    pub evidence: EvidenceResult,
    /// What proves that the structure that was asked for has no noises, likewise; null where it has some or nothing
    /// proves either, and where the whole has none.
    pub refutation: Option<RefutationResult>,
    /// ‖ΔL‖/‖L‖ up to the boundary, dimensionless, in units in which plant and gain are of one size. With one output to
    /// first order (where infeasible a lower bound of it), with several a lower bound, up to which the certificate
    /// holds. Null without a certificate.
    pub relative_change: Option<f64>,
    /// c*: the factor on the whole gain at which it becomes optimal, dimensionless; null where no factor helps.
    /// With several outputs to a thousandth, certified on both sides, up to 36 entries of the gain; null beyond.
    pub c_star: Option<f64>,
    /// Whether the verdict carries no information: in sampled time with a singular A and one output every stable
    /// filter whose gain vanishes on the kernel of Aᵀ is optimal for some W.
    pub uninformative: bool,
    /// Modes that no output sees; null where outputs see every state.
    pub unreached: Option<UnreachedResult>,
    /// `max t` with `W ⪰ tI`, `V ⪰ tI`, `tr W + tr V = n + p` (Priess 2015), in the units of the plant. It is no
    /// distance and decides nothing: it is 0 for many gains that no V ≻ 0 makes optimal, since V may become singular.
    /// Null where no noises have a positive trace, and beyond 64 unknowns without a structure.
    pub t_star: Option<f64>,
    /// The same in units in which W and V are of one size, dimensionless.
    pub t_star_scaled: Option<f64>,
    /// No larger `t_star_scaled` exists, by the dual; dimensionless.
    pub t_star_upper_bound: Option<f64>,
    /// Dimension of the space of noises that satisfy the equalities.
    pub unknowns: usize,
    /// The least condition number of blkdiag(W, V), dimensionless; null without definite noises, and beyond 600
    /// unknowns.
    pub alpha: Option<f64>,
    /// No smaller one exists, by the dual; dimensionless.
    pub alpha_lower_bound: Option<f64>,
    /// Dimension of the set of noises that attain it.
    pub solution_dimension: Option<usize>,
    /// Largest range of a diagonal entry within that set, as a share of the entry, dimensionless; null where its
    /// dimension is too high for that to be measured.
    pub solution_width: Option<f64>,
    /// Who solved the matrix inequality of the least condition number; null where it was not solved.
    pub solved_by: Option<SolvedByName>,
    /// W, n×n, in units of a noise of the states: intensity in continuous time, covariance in sampled time; null where
    /// none exist.
    pub w: Option<Rows>,
    /// V, p×p, in units of a noise of the outputs.
    pub v: Option<Rows>,
    /// The error covariance H of the Riccati equation, n×n, up to the scale of W and V.
    pub h: Option<Rows>,
    /// `‖L̂ − L‖_F/‖L‖_F` of the gain that the forward problem returns, dimensionless.
    pub forward_error: Option<f64>,
    /// Poles of A − LC with the gain given, as `[re, im]`, in rad/s (in sampled time in z, dimensionless).
    pub closed_loop_poles: Vec<[f64; 2]>,
    /// What shows that the noises belong to the gain; null where none exist.
    pub proof: Option<ProofResult>,
    /// What the noises mean: these, or those of the fit; null without either.
    pub reading: Option<NoiseReading>,
    /// Where the gain is optimal for no noises; null where it is, and where no fit was asked for.
    pub fit: Option<NoiseFit>,
}

/// The gain of a filter is n×p, that of the dual regulator p×n.
fn transposed(rows: &Rows) -> Rows {
    let columns = rows.first().map_or(0, Vec::len);
    (0..columns).map(|j| rows.iter().map(|row| row[j]).collect()).collect()
}

impl From<InverseLqrResult> for InverseLqeResult {
    /// From the result about the dual regulator.
    fn from(dual: InverseLqrResult) -> Self {
        Self {
            verdict: dual.verdict,
            within_pattern: dual.within_pattern,
            evidence: dual.evidence,
            refutation: dual.refutation,
            relative_change: dual.relative_change,
            c_star: dual.c_star,
            uninformative: dual.uninformative,
            unreached: dual.unreached,
            solved_by: dual.solved_by,
            t_star: dual.t_star,
            t_star_scaled: dual.t_star_scaled,
            t_star_upper_bound: dual.t_star_upper_bound,
            unknowns: dual.unknowns,
            alpha: dual.alpha,
            alpha_lower_bound: dual.alpha_lower_bound,
            solution_dimension: dual.solution_dimension,
            solution_width: dual.solution_width,
            w: dual.q,
            v: dual.r,
            h: dual.p,
            forward_error: dual.forward_error,
            closed_loop_poles: dual.closed_loop_poles,
            proof: dual.proof.map(|proof| ProofResult { forward_gain: transposed(&proof.forward_gain), ..proof }),
            reading: dual.reading.map(NoiseReading::from),
            fit: dual.fit.map(NoiseFit::from),
        }
    }
}

impl From<CostReading> for NoiseReading {
    fn from(dual: CostReading) -> Self {
        Self {
            normalised_w: dual.normalised_q,
            normalised_v: dual.normalised_r,
            normalised_w_units: dual.normalised_q_units,
            normalised_v_units: dual.normalised_r_units,
            equivalents: (),
            w_axes: dual.q_axes,
            v_axes: dual.r_axes,
            sized_axes: (),
            sizes: (),
            stationary_shares: (),
            trajectory_shares: (),
            comparison: dual.comparison,
        }
    }
}

impl From<CostFit> for NoiseFit {
    fn from(dual: CostFit) -> Self {
        Self {
            w: dual.q,
            v: dual.r,
            l: transposed(&dual.k),
            residual: dual.residual,
            relative_distance: dual.relative_distance,
            condition_number: dual.condition_number,
            curve: dual.curve,
            unbounded_residual: dual.unbounded_residual,
            unbounded_condition_number: dual.unbounded_condition_number,
            smallest_cross_term: dual.smallest_cross_term,
            cross_term: dual.cross_term.map(|CostWithCrossTerm { q, r, s }| NoiseWithCrossTerm { w: q, v: r, s }),
            evaluations: dual.evaluations,
            evaluations_allowed: dual.evaluations_allowed,
            descent: dual.descent.map(|descent| {
                let CostDescent { q, r, k, first_residual, residual, rejected_q, rejected_r, course } = descent;
                let l = transposed(&k);
                NoiseDescent { w: q, v: r, l, first_residual, residual, rejected_q, rejected_r, course }
            }),
        }
    }
}
