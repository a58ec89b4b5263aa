//! The result of an inverse problem.

use super::inputs::InverseInputs;
use super::units;
use crate::control::lyapunov::Clock;
use crate::inverse::fit::{CrossTerm, Descent, Fit};
use crate::inverse::lqr::Weights;
use crate::inverse::reading::{self, Axis, Comparison, Shares};
use crate::inverse::{Gains, InverseLqr, Role, Verdict};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Components of an axis below this are left out of its words.
const WORTH_SAYING: f64 = 0.05;

/// Kalman's inequality over frequency.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReturnDifferenceResult {
    /// The least eigenvalue of `R^(−1/2) (T*RT − R) R^(−1/2)` with `T = I + K(jωI − A)⁻¹B` (in sampled time with R + BᵀPB); not negative for
    /// an optimal gain, and tending to 0 at high frequency in continuous time.
    pub margin: f64,
    /// Where it is.
    pub omega_rad_s: f64,
}

/// What shows that the weights belong to the gain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProofResult {
    /// `‖BᵀP − RK‖/‖RK‖`, in sampled time `‖BᵀPA − (BᵀPB + R)K‖/‖(BᵀPB + R)K‖`.
    pub gain_residual: f64,
    /// Relative residual of the Riccati equation.
    pub riccati_residual: f64,
    /// The gain that solving the forward problem returns.
    pub forward_gain: Vec<Vec<f64>>,
    /// Largest relative difference of two independent forward methods to the refined one; null where one broke down.
    pub method_difference: Option<f64>,
    /// Poles of the loop with that gain, as `[re, im]`.
    pub forward_poles: Vec<[f64; 2]>,
    /// Kalman's inequality.
    pub return_difference: Option<ReturnDifferenceResult>,
}

/// A principal axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AxisResult {
    /// What a unit along it costs.
    pub weight: f64,
    /// Its share of the trace.
    pub share: f64,
    /// The unit vector.
    pub direction: Vec<f64>,
    /// The same in words, such as `0.89 x1 + 0.45 x2`.
    pub combination: String,
}

/// Shares of the cost; they sum to 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SharesResult {
    /// Of each state.
    pub states: Vec<f64>,
    /// Of each input (of a filter: output).
    pub ports: Vec<f64>,
}

/// Another cost beside this one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ComparisonResult {
    /// The factor on the other cost that brings it nearest to this one.
    pub scale: f64,
    /// Cosine between blkdiag(Q, R) of both: 1 for equal costs, whatever their scales.
    pub similarity: f64,
    /// Root mean square of the logarithms of the relative weights around their mean: 0 for equal costs, whatever the units; null where a
    /// cost is singular.
    pub log_distance: Option<f64>,
    /// The factor on the other cost that makes the geometric mean of the relative weights 1, whatever the units; null where a cost is singular.
    pub log_scale: Option<f64>,
    /// For every state its diagonal weight here over that in the other cost, brought to one scale (`log_scale`, else `scale`): above 1 where it
    /// counts for more here. Null where it counts for nothing there.
    pub state_ratios: Vec<Option<f64>>,
    /// The same for every input (of a filter: output).
    pub port_ratios: Vec<Option<f64>>,
}

/// What a state is worth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EquivalentResult {
    /// The state.
    pub state: String,
    /// The input that costs as much as one unit of the state, others at zero: `√Q_ii` where R has the mean eigenvalue 1.
    pub input: f64,
    /// In which unit, such as `(N m)/rad`; null where units are not given.
    pub unit: Option<String>,
}

/// What the weights mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReadingResult {
    /// Q on the scale on which R has the mean eigenvalue 1.
    pub normalised_q: Vec<Vec<f64>>,
    /// R on that scale.
    pub normalised_r: Vec<Vec<f64>>,
    /// The units of its entries; null where `state_units` or those of the inputs are not given.
    pub normalised_q_units: Option<Vec<Vec<String>>>,
    /// The units of R's.
    pub normalised_r_units: Option<Vec<Vec<String>>>,
    /// What one unit of each state is worth in input; null of a filter.
    pub equivalents: Option<Vec<EquivalentResult>>,
    /// Principal axes of Q, dearest first. Of states with different units they turn with the units: see `sized_axes`.
    pub q_axes: Vec<AxisResult>,
    /// Principal axes of R, dearest first.
    pub r_axes: Vec<AxisResult>,
    /// Principal axes of Q with every state counted in its own size (`sizes`): what is paid for motions as they are, whatever the units. Null of
    /// a filter.
    pub sized_axes: Option<Vec<AxisResult>>,
    /// The root mean square of every state, along the trajectory of the request, or else in the steady state under white noise of unit intensity
    /// on every state; null of a filter.
    pub sizes: Option<Vec<f64>>,
    /// Shares in the steady state under white noise of unit intensity on every state; null of a filter.
    pub stationary_shares: Option<SharesResult>,
    /// Shares along the trajectory of the request.
    pub trajectory_shares: Option<SharesResult>,
    /// The other cost of the request.
    pub comparison: Option<ComparisonResult>,
}

/// The best fit under one condition number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FitPointResult {
    /// κ.
    pub condition_number: f64,
    /// The squared distance of the gains, weighted by the inverse covariance where one is given.
    pub residual: f64,
    /// What another Newton step promises, as a share of the residual.
    pub stationarity: f64,
    /// Starts that ended there.
    pub agreeing_starts: usize,
    /// Starts in all.
    pub starts: usize,
}

/// The nearest optimal gain, where this one is optimal for no cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FitResult {
    /// Q under the largest condition number.
    pub q: Vec<Vec<f64>>,
    /// R under the largest condition number.
    pub r: Vec<Vec<f64>>,
    /// Its gain.
    pub k: Vec<Vec<f64>>,
    /// Its squared distance, weighted as asked.
    pub residual: f64,
    /// `‖K̂ − K‖_F/‖K‖_F`.
    pub relative_distance: f64,
    /// The largest condition number.
    pub condition_number: f64,
    /// The trade-off between distance and condition number.
    pub curve: Vec<FitPointResult>,
    /// Without a bound on the condition number, Q ⪰ 0 and R ≻ 0 alone: the least squared distance found. It is usually not attained, and falls
    /// as far as the steps still gain.
    pub unbounded_residual: Option<f64>,
    /// The condition number of blkdiag(Q, R) there; null where rounding leaves no least eigenvalue.
    pub unbounded_condition_number: Option<f64>,
    /// The smallest `‖S‖_F` of a cost with a cross term 2xᵀSu and R ⪰ I for which the gain is optimal (Priess 2015, eq. (3.20)).
    pub smallest_cross_term: Option<f64>,
    /// The weights of that cost; null with a structure.
    pub cross_term: Option<CrossTermResult>,
    /// The thesis' own descent, where it was asked for.
    pub descent: Option<DescentResult>,
}

/// A cost `xᵀQx + 2xᵀSu + uᵀRu` for which the gain is optimal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CrossTermResult {
    /// Q, n×n.
    pub q: Vec<Vec<f64>>,
    /// R ⪰ I, m×m.
    pub r: Vec<Vec<f64>>,
    /// S, n×m, of the smallest norm.
    pub s: Vec<Vec<f64>>,
}

/// Where the descent of Priess 2015, Table 3.1, ended. It promises no minimum: the fit beside it is usually nearer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DescentResult {
    /// Q.
    pub q: Vec<Vec<f64>>,
    /// R.
    pub r: Vec<Vec<f64>>,
    /// Its gain.
    pub k: Vec<Vec<f64>>,
    /// The squared distance before the first step.
    pub first_residual: f64,
    /// And after the last.
    pub residual: f64,
    /// Steps of Q that were left out, since it would not have stayed semidefinite.
    pub rejected_q: usize,
    /// Steps of R that were left out.
    pub rejected_r: usize,
}

/// The result of `inverse_lqr`; of `inverse_lqe` with w, v, h and l in place of q, r, p and k. `inverse_lqg` has both as `regulator` and
/// `filter`, with q, r, w, v and the verdict on both beside them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InverseLqrResult {
    /// `feasible`, `infeasible` or `boundary`.
    pub verdict: String,
    /// `max t` with `Q ⪰ tI`, `R ⪰ tI`, `tr Q + tr R = n + m`: positive where weights exist. Null where no weights have a positive trace,
    /// or their sizes differ too much in the units of the plant.
    pub t_star: Option<f64>,
    /// The same in units in which Q and R are of one size.
    pub t_star_scaled: Option<f64>,
    /// No larger margin exists, by the dual certificate, in the units that decided.
    pub t_star_upper_bound: Option<f64>,
    /// Dimension of the space of weights that satisfy the equalities.
    pub unknowns: usize,
    /// The least condition number of blkdiag(Q, R).
    pub alpha: Option<f64>,
    /// No smaller one exists, by the dual.
    pub alpha_lower_bound: Option<f64>,
    /// Dimension of the set of weights that attain it.
    pub solution_dimension: Option<usize>,
    /// Largest range of a diagonal weight within that set, as a share of the weight; null where its dimension is too high for that to be measured.
    pub solution_width: Option<f64>,
    /// Q, n×n.
    pub q: Option<Vec<Vec<f64>>>,
    /// R, m×m.
    pub r: Option<Vec<Vec<f64>>>,
    /// P, n×n.
    pub p: Option<Vec<Vec<f64>>>,
    /// `‖K̂ − K‖_F/‖K‖_F` of the gain that the forward problem returns.
    pub forward_error: Option<f64>,
    /// Poles of the closed loop with the gain given, as `[re, im]`.
    pub closed_loop_poles: Vec<[f64; 2]>,
    /// What shows that the weights belong to the gain.
    pub proof: Option<ProofResult>,
    /// What the weights mean: these, or those of the fit.
    pub reading: Option<ReadingResult>,
    /// Where the gain is optimal for no cost.
    pub fit: Option<FitResult>,
}

pub(in crate::analysis) fn rows(m: &DMatrix<f64>) -> Vec<Vec<f64>> {
    m.row_iter().map(|row| row.iter().copied().collect()).collect()
}

fn poles(values: &[num_complex::Complex64]) -> Vec<[f64; 2]> {
    values.iter().map(|p| [p.re, p.im]).collect()
}

fn axis(axis: Axis, names: &[String]) -> AxisResult {
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

pub(in crate::analysis) fn shares(shares: Shares) -> SharesResult {
    SharesResult { states: shares.states, ports: shares.inputs }
}

fn read(gains: &Gains, q: &DMatrix<f64>, r: &DMatrix<f64>, k: &DMatrix<f64>, inputs: &InverseInputs) -> ReadingResult {
    let (normalised_q, normalised_r, _) = reading::normalised(q, r);
    let regulator = gains.role() == Role::Regulator;
    let (ports, other) =
        if regulator { (&inputs.inputs, &inputs.other_cost) } else { (&inputs.outputs, &inputs.other_noise) };
    let (states, names) = (&inputs.states, &inputs.states.names);
    let units = states.units.as_ref().zip(ports.units.as_ref()).map(|(x, y)| {
        if regulator { units::of_cost(x, y) } else { units::of_noise(x, y, gains.clock() == Clock::Continuous) }
    });
    let [q_units, r_units] = units.map_or([None, None], |pair| pair.map(Some));
    let worth = states.units.as_ref().zip(ports.units.as_ref()).map(|(x, u)| units::of_equivalents(x, u));
    let equivalent = |(i, state): (usize, &String)| EquivalentResult {
        state: state.clone(),
        input: normalised_q[(i, i)].max(0.0).sqrt(),
        unit: worth.as_ref().map(|units| units[i].clone()),
    };
    let along = inputs.trajectory.as_ref().filter(|_| regulator);
    let (mut stationary, mut sizes) = (None, None);
    if regulator {
        let closed = gains.a() - gains.b() * k;
        let noise = DMatrix::identity(gains.states(), gains.states());
        stationary = reading::stationary_shares(&closed, k, q, r, &noise, gains.clock()).ok().flatten();
        let steady = || reading::stationary_covariance(&closed, &noise, gains.clock()).ok().map(|x| x.diagonal());
        let recorded = along.map(|(x, _)| x.map(|v| v * v).row_mean().transpose());
        sizes = recorded.or_else(steady).map(|squares| squares.iter().map(|v| v.max(0.0).sqrt()).collect::<Vec<f64>>());
    }
    let sized = sizes.as_ref().map(|sizes| reading::sized_axes(&normalised_q, sizes));
    ReadingResult {
        normalised_q: rows(&normalised_q),
        normalised_r: rows(&normalised_r),
        normalised_q_units: q_units,
        normalised_r_units: r_units,
        equivalents: regulator.then(|| names.iter().enumerate().map(equivalent).collect()),
        q_axes: reading::axes(q).into_iter().map(|a| axis(a, names)).collect(),
        r_axes: reading::axes(r).into_iter().map(|a| axis(a, &ports.names)).collect(),
        sized_axes: sized.map(|axes| axes.into_iter().map(|a| axis(a, names)).collect()),
        sizes,
        stationary_shares: stationary.map(shares),
        trajectory_shares: along.and_then(|(x, u)| reading::shares_along(q, r, x, u)).map(shares),
        comparison: other.as_ref().map(|(other_q, other_r)| {
            let Comparison { scale, similarity, log_distance, log_scale, state_ratios, input_ratios } =
                reading::compare((q, r), (other_q, other_r));
            ComparisonResult { scale, similarity, log_distance, log_scale, state_ratios, port_ratios: input_ratios }
        }),
    }
}

impl InverseLqrResult {
    pub(super) fn new(
        gains: &Gains,
        answer: &InverseLqr,
        fitted: Option<&Fit>,
        (cross_term, descent): (Option<&CrossTerm>, Option<&Descent>),
        inputs: &InverseInputs,
    ) -> Self {
        let weights = answer.weights.as_ref();
        let per_second = inputs.sample_time_s.map_or(1.0, |period| 1.0 / period);
        let proof = |w: &Weights| ProofResult {
            gain_residual: w.proof.gain_residual,
            riccati_residual: w.proof.riccati_residual,
            forward_gain: rows(&w.proof.forward_gain),
            method_difference: w.proof.method_difference,
            forward_poles: poles(&w.proof.forward_poles),
            return_difference: w
                .proof
                .return_difference
                .map(|d| ReturnDifferenceResult { margin: d.margin, omega_rad_s: d.omega * per_second }),
        };
        let fit = fitted.and_then(|fit| fit.curve.last().map(|best| (fit, best))).map(|(fit, best)| FitResult {
            q: rows(&best.q),
            r: rows(&best.r),
            k: rows(&best.k),
            residual: best.residual,
            relative_distance: (&best.k - gains.k()).norm() / gains.k().norm(),
            condition_number: best.condition_number,
            curve: fit
                .curve
                .iter()
                .map(|p| FitPointResult {
                    condition_number: p.condition_number,
                    residual: p.residual,
                    stationarity: p.stationarity,
                    agreeing_starts: p.agreeing_starts,
                    starts: p.starts,
                })
                .collect(),
            unbounded_residual: fit.unbounded.map(|found| found.residual),
            unbounded_condition_number: fit.unbounded.map(|u| u.condition_number).filter(|v| v.is_finite()),
            smallest_cross_term: cross_term.map(|found| found.norm),
            cross_term: cross_term.map(|found| CrossTermResult {
                q: rows(&found.q),
                r: rows(&found.r),
                s: rows(&found.s),
            }),
            descent: descent.map(|found| DescentResult {
                q: rows(&found.q),
                r: rows(&found.r),
                k: rows(&found.k),
                first_residual: found.values.first().copied().unwrap_or_default(),
                residual: found.values.last().copied().unwrap_or_default(),
                rejected_q: found.rejected_q,
                rejected_r: found.rejected_r,
            }),
        });
        let reading = match (weights, fitted.and_then(|fit| fit.curve.last())) {
            (Some(w), _) => Some(read(gains, &w.q, &w.r, gains.k(), inputs)),
            (None, Some(best)) => Some(read(gains, &best.q, &best.r, &best.k, inputs)),
            (None, None) => None,
        };
        Self {
            verdict: match answer.verdict {
                Verdict::Feasible => "feasible",
                Verdict::Infeasible => "infeasible",
                Verdict::Boundary => "boundary",
            }
            .to_owned(),
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
            proof: weights.map(proof),
            reading,
            fit,
        }
    }
}
