//! The inverse regulator problem (Priess 2015, §3.2), decided and proven.

use super::condition::{self, ConditionError};
use super::fit::{Objective, refine};
use super::gains::Gains;
use super::margin::{Margin, Units, margin};
use super::proof::{self, Proof};
use super::space::{Space, SpaceError};
use super::structure::{QSign, Structure, StructureError};
use super::verdict::{Decision, DecisionError, Refutation, Verdict, decide, factor, refuted};
use crate::control::lyapunov::LinearEquationError;
use crate::convex::lmi::{LmiError, SolvedBy, Solver};
use crate::ctl::{Ctl, Stopped};
use crate::num::linalg::{NoConvergence, symmetric};
use nalgebra::{DMatrix, DVector};

/// A forward error above this contradicts a feasible verdict.
pub const FORWARD: f64 = 1e-6;

/// A forward error above this is worth a refinement of the weights.
const REFINE: f64 = 1e-9;
/// Unknowns of the weights up to which they are refined.
const REFINED_UNKNOWNS: usize = 400;
/// Unknowns up to which the margins t* are computed: beyond they would cost more than everything else.
pub const MARGIN_UNKNOWNS: usize = 64;
/// Unknowns up to which the least condition number is looked for.
pub const CONDITION_UNKNOWNS: usize = 600;
/// Margins of larger magnitude belong to weights without a trace, and mean nothing.
const LARGEST_MARGIN: f64 = 1e6;
/// Entries of the gain up to which it is looked for: a decomposition of the equalities is not interrupted.
const CONDITION_EQUATIONS: usize = 300;
/// How well a semidefinite program finds a margin.
const MARGIN_PRECISION: f64 = 1e-9;
/// Within a structure a margin of smaller magnitude is looked at in other units before it decides.
const CLEAR: f64 = 1e-4;
/// Changes of units at most.
const REBALANCES: usize = 4;

/// How the question is put.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Settings {
    /// What is known of the weights beforehand.
    pub structure: Structure,
    /// Who solves the matrix inequality of the least condition number.
    pub solver: Solver,
}

/// Weights that make the gain optimal.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// Q, n×n.
    pub q: DMatrix<f64>,
    /// R, m×m.
    pub r: DMatrix<f64>,
    /// Evidence.
    pub proof: Proof,
}

/// The least condition number, and how unique its weights are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conditioning {
    /// α: the least `a` with `I ⪯ blkdiag(Q, R) ⪯ aI`.
    pub alpha: f64,
    /// No smaller one exists, by the dual.
    pub alpha_lower_bound: f64,
    /// Dimension of the set of weights that attain α; the one of least Frobenius norm is given.
    pub solution_dimension: usize,
    /// Largest range of a diagonal weight within that set, as a share of the weight; `None` where the dimension is too
    /// high for that to be measured, and the weights are then any of the set.
    pub solution_width: Option<f64>,
}

/// The answer.
#[derive(Debug, Clone, PartialEq)]
pub struct InverseLqr {
    /// Whether weights exist, within the structure.
    pub verdict: Verdict,
    /// The verdict without a structure, and what it rests on. Where that is infeasible, so is every structure.
    pub decision: Decision,
    /// Whether the structure leaves states out of Q: a feasible verdict then means weights that are definite on the
    /// others, and is a boundary for the whole.
    pub is_within_pattern: bool,
    /// What proves that the structure has no weights, where the whole may have some.
    pub refutation: Option<Refutation>,
    /// `max t` with `Q ⪰ tI`, `R ⪰ tI`, `tr Q + tr R = n + m`, in the units of the plant; `None` where no weights have
    /// a positive trace, and beyond [`MARGIN_UNKNOWNS`]. It is no distance: where R may become singular it is 0
    /// whatever the gain.
    pub t_star: Option<f64>,
    /// The same with Q divided by s², its natural size for R of size 1 (about ‖K‖²).
    pub t_star_scaled: Option<f64>,
    /// No larger `t_star_scaled` exists, by the dual.
    pub t_star_upper_bound: Option<f64>,
    /// Dimension of the space of weights that satisfy the equalities; for large problems what it is where inputs do not
    /// depend on each other.
    pub unknowns: usize,
    /// The weights: of least condition number where definite ones exist, those of the largest margin on the boundary.
    pub weights: Option<Weights>,
    /// The least condition number, where definite weights exist and it was looked for.
    pub conditioning: Option<Conditioning>,
    /// Whether the weights are those of the least condition number. False on the boundary, where rounding keeps those
    /// from returning the gain, and beyond [`CONDITION_UNKNOWNS`].
    pub best_conditioned: bool,
    /// Who solved the matrix inequality of the least condition number.
    pub solved_by: Option<SolvedBy>,
}

/// Why there is no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InverseError {
    /// The structure does not fit.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// Somebody asked to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// A decomposition failed.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
    /// A matrix equation of the loop is singular.
    #[error(transparent)]
    Linear(#[from] LinearEquationError),
    /// The interior-point method had no start.
    #[error("the semidefinite program could not be started")]
    NoStart,
}

impl From<LmiError> for InverseError {
    fn from(error: LmiError) -> Self {
        match error {
            LmiError::Stopped(stopped) => stopped.into(),
            LmiError::Infeasible { .. } => Self::NoStart,
        }
    }
}

impl From<ConditionError> for InverseError {
    fn from(error: ConditionError) -> Self {
        match error {
            ConditionError::Lmi(error) => error.into(),
            ConditionError::NoConvergence(error) => error.into(),
        }
    }
}

impl From<DecisionError> for InverseError {
    fn from(error: DecisionError) -> Self {
        match error {
            DecisionError::Stopped(stopped) => stopped.into(),
            DecisionError::NoConvergence(error) => error.into(),
        }
    }
}

impl From<SpaceError> for InverseError {
    fn from(error: SpaceError) -> Self {
        match error {
            SpaceError::Stopped(stopped) => stopped.into(),
            SpaceError::NoConvergence(error) => error.into(),
            SpaceError::Linear(error) => error.into(),
        }
    }
}

/// Decides whether weights exist for which the gain is optimal, and finds the best conditioned ones.
///
/// 1. The verdict without a structure, by its own certificate ([`Decision`]).
/// 2. Where definite weights exist `min α` with `I ⪯ blkdiag(Q, R) ⪯ αI` (Priess 2015, eq. (3.12), (3.13)); of several
///    weights those of least Frobenius norm.
/// 3. The forward Riccati equation of these weights must return the gain.
///
/// Within a structure the weights are looked for among the structured ones. Of set points that no input reaches Q
/// weighs the distance: `Q = MᵀQ_eM`.
///
/// # Errors
/// [`InverseError`].
pub fn inverse_lqr(gains: &Gains, settings: &Settings, ctl: &Ctl) -> Result<InverseLqr, InverseError> {
    settings.structure.check(gains.states(), gains.ports())?;
    ctl.check()?;
    let decision = decide(gains, ctl)?;
    let Some(targets) = &gains.reach.targets else { return answered(gains, decision, settings, ctl) };
    if settings.structure.q_pattern.is_some() {
        return Err(StructureError::Targets { order: gains.states() }.into());
    }
    let errors = gains.errors(targets);
    let mut answer = answered(&errors, decision, settings, ctl)?;
    if let Some(weights) = &mut answer.weights {
        weights.q = targets.lift(&weights.q);
        weights.proof.p = targets.lift(&weights.proof.p);
        weights.proof.forward_gain = &weights.proof.forward_gain * &targets.map;
        weights.proof.forward_error =
            (&weights.proof.forward_gain - &gains.k).norm() / gains.k.norm().max(f64::MIN_POSITIVE);
    }
    Ok(answer)
}

/// The verdict on the gain alone, whatever the structure of its weights.
///
/// # Errors
/// [`InverseError`].
pub fn decision(gains: &Gains, ctl: &Ctl) -> Result<Decision, InverseError> {
    Ok(decide(gains, ctl)?)
}

/// c*: the factor on the whole gain at which it becomes optimal. Of several inputs it is found to a thousandth by some
/// verdicts on multiples of the gain, up to 36 entries of it; `None` beyond, and where no factor helps.
///
/// # Errors
/// [`InverseError`].
pub fn gain_factor(gains: &Gains, decision: &Decision, ctl: &Ctl) -> Result<Option<f64>, InverseError> {
    Ok(factor(decision, gains, ctl)?)
}

/// The answer about a loop that is stable as a whole.
fn answered(gains: &Gains, decision: Decision, settings: &Settings, ctl: &Ctl) -> Result<InverseLqr, InverseError> {
    let structure = &settings.structure;
    let (n, m) = (gains.states(), gains.ports());
    // The dimension of the space where inputs do not depend on each other: at least this.
    let least = (n.saturating_sub(m).pow(2) + n + m) / 2;
    let mut answer = InverseLqr {
        verdict: decision.verdict,
        decision,
        is_within_pattern: structure.support().is_some(),
        refutation: None,
        t_star: None,
        t_star_scaled: None,
        t_star_upper_bound: None,
        unknowns: least,
        weights: None,
        conditioning: None,
        best_conditioned: false,
        solved_by: None,
    };
    if structure.is_free() && (least > CONDITION_UNKNOWNS || n * m > CONDITION_EQUATIONS) {
        // Too many unknowns for anything but the weights that prove the verdict.
        answer.weights = match &answer.decision.weights {
            Some((q, r)) => as_proven(gains, settings, q, r, ctl)?,
            None => None,
        };
        return Ok(answer);
    }
    let (space, noise) =
        if structure.is_free() { (Space::of(gains)?, 0.0) } else { Space::within(gains, structure, ctl)? };
    answer.unknowns = space.len();
    let whole = answer.decision.verdict;
    if space.len() == 0 {
        refute(gains, structure, None, &mut answer)?;
        return Ok(answer);
    }
    let is_small = space.len() <= MARGIN_UNKNOWNS;
    let mut scaled = None;
    if is_small || !structure.is_free() {
        let own = margin(&space, &Units::uniform(&space, space.scale), ctl)?;
        answer.t_star = own.filter(|m| m.solved && m.t_star.abs() <= LARGEST_MARGIN).map(|m| m.t_star);
        scaled = margin(&space, &Units::uniform(&space, 1.0), ctl)?;
        if let Some(found) = scaled.as_ref().filter(|m| m.t_star.abs() <= LARGEST_MARGIN) {
            answer.t_star_scaled = Some(found.t_star);
            answer.t_star_upper_bound = Some(found.upper_bound);
        }
    }
    if whole == Verdict::Infeasible {
        return Ok(answer);
    }
    if structure.is_free() {
        match whole {
            Verdict::Feasible => conditioned(gains, settings, &space, scaled, &mut answer, ctl)?,
            _ => {
                let found = match scaled {
                    None if space.len() <= CONDITION_UNKNOWNS => margin(&space, &Units::uniform(&space, 1.0), ctl)?,
                    found => found,
                };
                answer.weights = found.and_then(|found| boundary_weights(gains, settings, &space, &found));
            }
        }
        return Ok(answer);
    }
    let Some(found) = scaled else {
        refute(gains, structure, None, &mut answer)?;
        return Ok(answer);
    };
    let (verdict, found, units) = within(&space, found, noise, ctl)?;
    // A structure is never better than the whole, unless it leaves out what the whole cannot weigh.
    answer.verdict = match (whole, verdict) {
        (Verdict::Boundary, Verdict::Feasible) if !answer.is_within_pattern => Verdict::Boundary,
        (_, verdict) => verdict,
    };
    match verdict {
        Verdict::Infeasible => refute(gains, structure, Some(found.dual(&space, &units)), &mut answer)?,
        Verdict::Boundary => answer.weights = boundary_weights(gains, settings, &space, &found),
        Verdict::Feasible => {
            conditioned(gains, settings, &space, Some(found), &mut answer, ctl)?;
            if answer.weights.is_none() {
                answer.verdict = Verdict::Boundary;
            }
        }
    }
    Ok(answer)
}

/// Infeasible within the structure where a certificate says so, and otherwise the boundary.
fn refute(
    gains: &Gains,
    structure: &Structure,
    dual: Option<[DMatrix<f64>; 2]>,
    answer: &mut InverseLqr,
) -> Result<(), NoConvergence> {
    if answer.decision.verdict != Verdict::Infeasible {
        answer.refutation = refuted(gains, structure, dual)?;
        let is_refuted = answer.refutation.is_some();
        answer.verdict = if is_refuted { Verdict::Infeasible } else { Verdict::Boundary };
    }
    Ok(())
}

/// The weights that prove the verdict, where inputs reach every state.
fn as_proven(
    gains: &Gains,
    settings: &Settings,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    ctl: &Ctl,
) -> Result<Option<Weights>, Stopped> {
    let Some(q) = gains.reach.state_weight(q) else { return Ok(None) };
    let (q, r) = (symmetric(&q), symmetric(&gains.reach.input_weight(r)));
    let least = q.symmetric_eigenvalues().min().min(r.symmetric_eigenvalues().min());
    if least <= 0.0 {
        return Ok(None);
    }
    proven(gains, settings, q / least, r / least, ctl)
}

/// The verdict within a structure with its margin and the units of that: by the sign of the margin, in units in which
/// it is large, against what the rounding of the data makes of it.
fn within(space: &Space, first: Margin, noise: f64, ctl: &Ctl) -> Result<(Verdict, Margin, Units), LmiError> {
    let (mut decisive, mut its_units) = (first, Units::uniform(space, 1.0));
    let mut rounding = MARGIN_PRECISION.max(noise);
    for _ in 0..REBALANCES {
        if decisive.t_star.abs() > CLEAR.max(4.0 * rounding) && decisive.solved {
            break;
        }
        let (q, r) = space.at(&decisive.z);
        let units = Units::balancing(&space.weighed(&q), &r);
        let largest = units.q.amax().max(units.r.amax()).powi(2);
        let Some(other) = margin(space, &units, ctl)? else { break };
        let moved = MARGIN_PRECISION.max(noise * largest);
        let is_better = other.t_star.abs() / moved > decisive.t_star.abs() / rounding || !decisive.solved;
        if !(other.solved && is_better) {
            break;
        }
        (decisive, rounding, its_units) = (other, moved, units);
    }
    let verdict = if !decisive.solved {
        Verdict::Boundary
    } else if decisive.t_star > rounding {
        Verdict::Feasible
    } else if decisive.upper_bound < -rounding {
        Verdict::Infeasible
    } else {
        Verdict::Boundary
    };
    Ok((verdict, decisive, its_units))
}

/// The best conditioned weights of a feasible gain; where rounding keeps those from returning the gain, the ones that
/// proved it feasible, or those of the largest margin.
fn conditioned(
    gains: &Gains,
    settings: &Settings,
    space: &Space,
    scaled: Option<Margin>,
    answer: &mut InverseLqr,
    ctl: &Ctl,
) -> Result<(), InverseError> {
    let s2 = space.scale * space.scale;
    let is_definite = |z: &DVector<f64>| {
        let (q, r) = space.at(z);
        space.weighed(&q).cholesky().is_some() && r.cholesky().is_some()
    };
    let proven_by = answer.decision.weights.as_ref().filter(|_| settings.structure.is_free());
    let known = proven_by.and_then(|(q, r)| {
        let (q, r) = (gains.reach.state_weight(q)?, gains.reach.input_weight(r));
        let z = space.coordinates(&(q / s2), &r);
        is_definite(&z).then_some(z)
    });
    let mut starts: Vec<DVector<f64>> = known.into_iter().collect();
    if starts.is_empty() || scaled.is_some() {
        let found = match scaled {
            Some(found) => Some(found),
            None if space.len() <= CONDITION_UNKNOWNS => margin(space, &Units::uniform(space, 1.0), ctl)?,
            None => None,
        };
        starts.extend(found.map(|found| found.z).filter(is_definite));
    }
    let mut candidates: Vec<(DVector<f64>, bool)> = Vec::new();
    let mut found = None;
    if let Some(start) = starts.first().filter(|_| space.len() <= CONDITION_UNKNOWNS) {
        let best = condition::best_conditioned(space, start, settings, ctl)?;
        candidates.push((best.z.clone(), true));
        found = Some(best);
    }
    candidates.extend(starts.into_iter().map(|z| (z, false)));
    for (z, is_best) in candidates {
        let (q, r) = space.at(&z);
        let (mut q, mut r) = (symmetric(&(q * s2)), symmetric(&r));
        if !is_best {
            let least = space.weighed(&q).symmetric_eigenvalues().min().min(r.symmetric_eigenvalues().min());
            q /= least;
            r /= least;
        }
        settings.structure.impose(&mut q, &mut r);
        let weights = proven(gains, settings, q, r, ctl)?;
        if weights.is_some() {
            answer.weights = weights;
            answer.best_conditioned = is_best;
            break;
        }
    }
    if let Some(found) = found {
        answer.solved_by = Some(found.solved_by);
        answer.conditioning = Some(Conditioning {
            alpha: found.alpha,
            alpha_lower_bound: found.lower_bound,
            solution_dimension: found.face,
            solution_width: found.width,
        });
    }
    Ok(())
}

/// The weights with their proof, refined where that brings the gain nearer; none where the forward error stays too
/// large.
fn proven(
    gains: &Gains,
    settings: &Settings,
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    ctl: &Ctl,
) -> Result<Option<Weights>, Stopped> {
    let error_of = |weights: &Option<Weights>| weights.as_ref().map_or(f64::INFINITY, |w| w.proof.forward_error);
    let attempt =
        |q: DMatrix<f64>, r: DMatrix<f64>| proof::prove(gains, &q, &r).ok().map(|proof| Weights { q, r, proof });
    let mut best = attempt(q.clone(), r.clone());
    let (n, m) = (gains.states(), gains.ports());
    if error_of(&best) > REFINE && settings.structure.unknowns(n, m) <= REFINED_UNKNOWNS {
        let objective = Objective::new(gains, None);
        if let Some((q, r)) = refine(&objective, &settings.structure, &q, &r, ctl)? {
            let refined = attempt(q, r);
            if error_of(&refined) < error_of(&best) {
                best = refined;
            }
        }
    }
    let error = error_of(&best);
    Ok(best.filter(|_| error <= FORWARD))
}

/// The weights of the largest margin, with eigenvalues of the wrong sign set to zero; only if they return the gain.
fn boundary_weights(gains: &Gains, settings: &Settings, space: &Space, margin: &Margin) -> Option<Weights> {
    let (q, r) = space.at(&margin.z);
    let mut q = semidefinite(&(q * (space.scale * space.scale)));
    let mut r = symmetric(&r);
    let least = r.symmetric_eigenvalues().min();
    if least <= 0.0 {
        return None;
    }
    q /= least;
    r /= least;
    settings.structure.impose(&mut q, &mut r);
    let proof = proof::prove(gains, &q, &r).ok()?;
    (proof.forward_error <= FORWARD).then_some(Weights { q, r, proof })
}

fn semidefinite(m: &DMatrix<f64>) -> DMatrix<f64> {
    let eigen = symmetric(m).symmetric_eigen();
    let values = eigen.eigenvalues.map(|v| v.max(0.0));
    symmetric(&(&eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose()))
}

/// Whether Q must be definite for the verdict that is asked for.
impl Settings {
    /// Whether a boundary verdict with proven weights answers the question: a semidefinite Q was asked for.
    #[must_use]
    pub fn accepts_boundary(&self) -> bool {
        self.structure.q_sign == QSign::Semidefinite
    }
}
