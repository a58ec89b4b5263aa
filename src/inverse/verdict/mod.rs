//! Whether weights exist, decided on the states that inputs reach.
//!
//! - **feasible**: for some data within the rounding R ≻ 0 and Q ≻ 0 exist, by a margin above the rounding;
//! - **infeasible**: for no data within the rounding do even Q ⪰ 0 and R of a condition number up to 1e6 exist;
//! - **boundary**: neither.
//!
//! The two are not alike on purpose: equalities are thin (`A = B = I`, `K = 3I` is optimal, `K = [3 ε; −ε 3]` never
//! is), the cone is not. One input is decided by Kalman's polynomial, several by certificates; no solver's status
//! counts.

mod distance;
mod dual;
mod factor;
mod giving;
mod kalman;
mod majorant;
mod plane;
mod primal;
mod reduced;
mod residual;
mod sensitivity;
mod structured;

use super::gains::Gains;
use super::margin;
use super::reach::{Core, Reach};
use super::space::Space;
use crate::control::lyapunov::{Clock, Lyapunov};
use crate::convex::lmi::LmiError;
use crate::ctl::{Ctl, Stopped};
use crate::num::linalg::{self, NoConvergence, symmetric};
use dual::{Coupling, Dual, DualTest};
use kalman::{Kalman, OneInput};
use nalgebra::{DMatrix, DVector};
use plane::{Outcome, PlaneError};
use primal::{CLEAR, Primal, PrimalTest};
use reduced::Reduced;
pub use structured::Refutation;
pub(super) use structured::refuted;

/// States up to which the whole semidefinite program stands in where the reduction does not apply.
const WHOLE_PROGRAM: usize = 24;

/// Whether a cost exists for which the gain is optimal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Weights exist that are definite, Q on the states that the structure lets it weigh, for some data within the
    /// rounding of these.
    Feasible,
    /// None exist for any data within the rounding, not even a semidefinite Q.
    Infeasible,
    /// Neither is proven: the gain is nearer to the boundary than its digits, and singular weights may exist.
    Boundary,
}

/// What a verdict rests on.
#[derive(Debug, Clone, PartialEq)]
pub enum Evidence {
    /// One input: the least of `F = |1 + K(jω − A)⁻¹B|² − 1` (in sampled time less `R/(R + BᵀPB)`) over its
    /// uncertainty.
    ReturnDifference {
        /// Where, in rad per unit of time (sampled: per sample); infinite where the limit of ω²F decides.
        omega: f64,
        /// F there, or that limit.
        value: f64,
        /// How far the rounding of the data moves it.
        rounding: f64,
    },
    /// One input in sampled time: `R/(R + BᵀPB) = det(A − BK)/det A`, which must be positive.
    InputWeight {
        /// Its value.
        value: f64,
        /// How far the rounding of the data moves it.
        rounding: f64,
    },
    /// Weights whose margin exceeds the rounding.
    Weights {
        /// P, n×n, in the units of the plant; none where inputs do not reach every state.
        p: Option<DMatrix<f64>>,
        /// R, m×m, in the units of the plant.
        r: DMatrix<f64>,
    },
    /// A multiplier N for which `⟨X, Q⟩ = −⟨R, T⟩ < 0` for all weights.
    Multiplier {
        /// N, m×n, in the units of the plant; none where inputs do not reach every state.
        n: Option<DMatrix<f64>>,
        /// The frequencies that it is made of, in rad per unit of time (sampled: per sample).
        frequencies: Vec<f64>,
    },
    /// An antisymmetric Ω for which `T = ΩMᵀ − MΩ` is definite, with `M = KB` (in sampled time `K(A − BK)⁻¹B`): since
    /// `R·M` is symmetric for all weights, `⟨R, T⟩ = 0` for them.
    Coupling {
        /// Ω, m×m, in the units of the plant.
        omega: DMatrix<f64>,
    },
    /// In sampled time with a singular A the gain must vanish on the kernel of A.
    Kernel {
        /// ‖K·ker A‖, in balanced units.
        value: f64,
        /// How far the rounding of the data moves it.
        rounding: f64,
    },
    /// No certificate was found on either side.
    None,
}

/// A verdict on the core, and how far it is from another one.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// The verdict.
    pub verdict: Verdict,
    /// What it rests on.
    pub evidence: Evidence,
    /// The margin of the evidence over the rounding of the data, positive on the feasible side; between −1 and 1 it is
    /// the boundary. `None` where there is no certificate.
    pub ratio: Option<f64>,
    /// The relative change of K (‖ΔK‖/‖K‖ in balanced units) up to the boundary. One input: to first order where
    /// feasible, a lower bound to first order where infeasible. Several inputs: a lower bound, up to which the
    /// certificate holds.
    pub relative_change: Option<f64>,
    /// c*: the factor on the whole gain at which it becomes optimal; `None` where no factor helps. Several inputs: to a
    /// thousandth, by certificates on both sides, and looked for by [`gain_factor`](super::lqr::gain_factor) alone.
    pub factor: Option<f64>,
    /// In sampled time with a singular A any stabilising gain that vanishes on its kernel is optimal for some Q: the
    /// answer is true, and carries no information.
    pub is_uninformative: bool,
    /// Weights in the units of the core, where definite ones are known.
    pub(super) weights: Option<(DMatrix<f64>, DMatrix<f64>)>,
}

/// Why there is no decision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum DecisionError {
    Stopped(Stopped),
    NoConvergence(NoConvergence),
}

impl From<Stopped> for DecisionError {
    fn from(stopped: Stopped) -> Self {
        Self::Stopped(stopped)
    }
}

impl From<NoConvergence> for DecisionError {
    fn from(error: NoConvergence) -> Self {
        Self::NoConvergence(error)
    }
}

impl From<PlaneError> for DecisionError {
    fn from(error: PlaneError) -> Self {
        match error {
            PlaneError::Stopped(stopped) => Self::Stopped(stopped),
            PlaneError::NoConvergence(error) => Self::NoConvergence(error),
        }
    }
}

impl Decision {
    fn new(verdict: Verdict, evidence: Evidence, ratio: Option<f64>) -> Self {
        Self { verdict, evidence, ratio, relative_change: None, factor: None, is_uninformative: false, weights: None }
    }
}

/// Decides for the gain, whatever the structure of its weights.
pub(super) fn decide(gains: &Gains, ctl: &Ctl) -> Result<Decision, DecisionError> {
    let reach = &gains.reach;
    let core = &reach.core;
    if let Some(decision) = kernel(core)? {
        return Ok(decision);
    }
    if core.ports() == 1 { one_input(core, ctl) } else { several_inputs(reach, ctl) }
}

/// c* of a decided gain: of several inputs up to 36 entries of the gain.
pub(super) fn factor(decision: &Decision, gains: &Gains, ctl: &Ctl) -> Result<Option<f64>, DecisionError> {
    let core = &gains.reach.core;
    let has_one = matches!(decision.evidence, Evidence::Weights { .. } | Evidence::Multiplier { .. } | Evidence::None);
    if core.ports() > 1 && core.ports() * core.states() <= factor::ENTRIES && has_one {
        return factor::several_inputs(core, decision.verdict, ctl);
    }
    Ok(decision.factor)
}

/// In sampled time with an A that is singular to rounding.
fn kernel(core: &Core) -> Result<Option<Decision>, NoConvergence> {
    if core.clock == Clock::Continuous {
        return Ok(None);
    }
    let n = core.states();
    let (u, values, v) = linalg::svd(&core.a)?;
    let moved = core.rounding.a.norm();
    let rank = values.iter().filter(|s| **s > moved).count();
    if rank == n {
        return Ok(None);
    }
    let null = v.columns(rank, n - rank);
    let value = (&core.k * null).norm();
    let gap = if rank > 0 { values[rank - 1] } else { f64::INFINITY };
    let rounding = core.rounding.k.norm() + 2.0 * core.k.norm() * moved / gap;
    let evidence = Evidence::Kernel { value, rounding };
    let reached = (u.columns(rank, n - rank).tr_mul(&core.b)).norm();
    if value <= rounding {
        if core.ports() > 1 {
            return Ok(None);
        }
        let decision = Decision::new(Verdict::Feasible, evidence, None);
        return Ok(Some(Decision { is_uninformative: true, ..decision }));
    }
    // Within the rounding A may be regular, and K·A⁻¹B then is at least this.
    let least = (value - rounding) * reached / (values[n - 1] + 2.0 * moved);
    let verdict = if least > 4.0 { Verdict::Infeasible } else { Verdict::Boundary };
    Ok(Some(Decision::new(verdict, evidence, Some(-value / rounding))))
}

fn one_input(core: &Core, ctl: &Ctl) -> Result<Decision, DecisionError> {
    let Core { a, b, k, clock, rounding } = core;
    let question = OneInput { a, b, k, rounding, clock: *clock };
    let found: Kalman = question.judge(ctl)?;
    let verdict = if found.ratio < -1.0 {
        Verdict::Infeasible
    } else if found.ratio > 1.0 && found.is_proven {
        Verdict::Feasible
    } else {
        Verdict::Boundary
    };
    let Kalman { omega, value, rounding, .. } = found;
    let evidence = if found.is_input_weight {
        Evidence::InputWeight { value, rounding }
    } else {
        Evidence::ReturnDifference { omega, value, rounding }
    };
    let mut decision = Decision::new(verdict, evidence, Some(found.ratio));
    decision.relative_change = found.relative_change;
    decision.factor = distance::factor(core);
    if verdict == Verdict::Feasible
        && let Some(reduced) = Reduced::new(core)
        && let Outcome::Primal(weights) = plane::search(core, &reduced, ctl)?.outcome
    {
        decision.weights = Some((weights.q, weights.r));
    }
    Ok(decision)
}

fn several_inputs(reach: &Reach, ctl: &Ctl) -> Result<Decision, DecisionError> {
    let core = &reach.core;
    let outcome = match Reduced::new(core) {
        Some(reduced) => plane::search(core, &reduced, ctl)?.outcome,
        None if core.states() <= WHOLE_PROGRAM => whole_program(core, ctl)?,
        None => Outcome::Neither,
    };
    Ok(match outcome {
        Outcome::Primal(found) => {
            let Primal { p, r, q, ratio, .. } = &found;
            let evidence = Evidence::Weights { p: reach.state_weight(p), r: reach.input_weight(r) };
            let mut decision = Decision::new(Verdict::Feasible, evidence, Some(*ratio));
            decision.relative_change = PrimalTest::new(core).and_then(|test| test.change(p, r));
            decision.weights = Some((q.clone(), r.clone()));
            decision
        }
        Outcome::Dual(Dual { n, ratio, change }, frequencies) => {
            let evidence = Evidence::Multiplier { n: reach.multiplier(&n), frequencies };
            let mut decision = Decision::new(Verdict::Infeasible, evidence, Some(-ratio));
            decision.relative_change = change;
            decision
        }
        Outcome::Coupling(Coupling { omega, ratio, change }) => {
            let evidence = Evidence::Coupling { omega: reach.coupling(&omega) };
            let mut decision = Decision::new(Verdict::Infeasible, evidence, Some(-ratio));
            decision.relative_change = change;
            decision
        }
        Outcome::Neither => Decision::new(Verdict::Boundary, Evidence::None, None),
    })
}

/// Candidates from the semidefinite program in all unknowns, where inputs depend on each other or A − BK is singular.
fn whole_program(core: &Core, ctl: &Ctl) -> Result<Outcome, DecisionError> {
    let Some((primal, dual)) = PrimalTest::new(core).zip(DualTest::new(core)) else { return Ok(Outcome::Neither) };
    let space = Space::new([&core.a, &core.b, &core.k], core.clock)?;
    if space.len() == 0 {
        return Ok(Outcome::Neither);
    }
    let found = match margin::margin(&space, &margin::Units::uniform(&space, 1.0), ctl) {
        Ok(Some(found)) => found,
        Ok(None) | Err(LmiError::Infeasible { .. }) => return Ok(Outcome::Neither),
        Err(LmiError::Stopped(stopped)) => return Err(stopped.into()),
    };
    if found.t_star > 0.0 {
        let (q, r) = space.at(&found.z);
        let q = q * (space.scale * space.scale);
        let Ok(equation) = Lyapunov::new(&core.closed_loop(), core.clock) else { return Ok(Outcome::Neither) };
        let p = equation.solve(&(q + core.k.tr_mul(&(&r * &core.k))));
        return Ok(primal.check(&p, &r).map_or(Outcome::Neither, Outcome::Primal));
    }
    let [x, t] = &found.duals;
    let s2 = space.scale * space.scale;
    let Some(n) = multiplier(core, &(x / s2), t) else { return Ok(Outcome::Neither) };
    let Some(prepared) = dual.prepared(&n) else { return Ok(Outcome::Neither) };
    let by_gain = dual.moved_by_gain(&prepared, &core.rounding.k);
    let ratio = dual.ratio(&prepared, &core.rounding.k, &by_gain);
    let Some(ratio) = ratio.filter(|ratio| *ratio > CLEAR) else { return Ok(Outcome::Neither) };
    let change = distance::dual(core, &dual, &prepared);
    Ok(Outcome::Dual(Dual { n, ratio, change }, Vec::new()))
}

/// N with `BN + NᵀBᵀ = A_cX + XA_cᵀ` (`−BNA_cᵀ − A_cNᵀBᵀ = X − A_cXA_cᵀ`) and `NKᵀ + KNᵀ = T − KXKᵀ`, by least squares.
fn multiplier(core: &Core, x: &DMatrix<f64>, t: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let (n, m) = (core.states(), core.ports());
    let closed = core.closed_loop();
    let (left, first) = match core.clock {
        Clock::Continuous => (DMatrix::identity(n, n), symmetric(&(&closed * x)) * 2.0),
        Clock::Sampled => (-&closed, x - &closed * x * closed.transpose()),
    };
    let second = t - &core.k * x * core.k.transpose();
    let stack = |one: &DMatrix<f64>, two: &DMatrix<f64>| {
        DVector::from_iterator(n * n + m * m, one.iter().chain(two.iter()).copied())
    };
    let mut matrix = DMatrix::zeros(n * n + m * m, n * m);
    for column in 0..n * m {
        let mut unit = DMatrix::zeros(m, n);
        unit[(column % m, column / m)] = 1.0;
        let one = &core.b * &unit * left.transpose();
        let two = &unit * core.k.transpose();
        matrix.set_column(column, &stack(&(&one + one.transpose()), &(&two + two.transpose())));
    }
    let (u, values, v) = linalg::svd(&matrix).ok()?;
    let right = u.tr_mul(&stack(&first, &second));
    let kept = values.iter().filter(|s| **s > 1e-13 * values[0]).count();
    let solution = DVector::from_fn(kept, |i, _| right[i] / values[i]);
    let entries = v.columns(0, kept) * solution;
    Some(DMatrix::from_column_slice(m, n, entries.as_slice()))
}
