//! The inverse regulator problem (Priess 2015, §3.2), decided and proven.

use super::balance::balanced;
use super::condition::{self, ConditionError};
use super::fit::{Objective, refine};
use super::gains::Gains;
use super::proof::{self, Proof};
use super::space::Space;
use super::structure::{QSign, Structure, StructureError};
use super::verdict::{Margin, Units, Verdict, margin, verdict};
use crate::convex::lmi::LmiError;
use crate::ctl::{Ctl, Stopped};
use crate::num::linalg::{NoConvergence, symmetric};
use nalgebra::DMatrix;

/// A forward error above this contradicts a feasible verdict.
pub const FORWARD: f64 = 1e-6;

/// A forward error above this is worth a refinement of the weights.
const REFINE: f64 = 1e-9;
/// A scaled margin of smaller magnitude is looked at in other units before it decides.
const CLEAR: f64 = 1e-4;
/// Changes of units at most.
const REBALANCES: usize = 4;

/// How the question is put.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Settings {
    /// What is known of the weights beforehand.
    pub structure: Structure,
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
    /// Whether weights exist.
    pub verdict: Verdict,
    /// `max t` with `Q ⪰ tI`, `R ⪰ tI`, `tr Q + tr R = n + m`, in the units of the plant; `None` where no weights have
    /// a positive trace.
    pub t_star: Option<f64>,
    /// The same with Q divided by s², its natural size for R of size 1 (about ‖K‖²): the better conditioned of the two.
    /// Where it is small, in units of the states in which plant and gain are of one size, if it is larger there.
    pub t_star_scaled: Option<f64>,
    /// No larger margin exists in the units that decided, by the dual certificate: negative where the verdict is
    /// infeasible.
    pub t_star_upper_bound: Option<f64>,
    /// Dimension of the space of weights that satisfy the equalities.
    pub unknowns: usize,
    /// The weights: of least condition number where definite ones exist, those of the largest margin on the boundary.
    pub weights: Option<Weights>,
    /// The least condition number, where definite weights exist.
    pub conditioning: Option<Conditioning>,
    /// Whether the weights are those of the least condition number. False on the boundary, and where rounding keeps
    /// those from returning the gain: the weights are then those of the largest margin.
    pub best_conditioned: bool,
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
    /// The verdict is feasible, but the weights do not return the gain: the problem is beyond working precision.
    #[error(
        "weights exist with a margin of {t_star:.1e}, but solving the forward problem returns the gain only to \
         {forward_error:.1e} \
         (at most {FORWARD:.0e} is accepted)"
    )]
    Unproven {
        /// The scaled margin.
        t_star: f64,
        /// The relative forward error; infinite where the forward problem could not be solved.
        forward_error: f64,
    },
    /// The semidefinite program for the margin did not converge.
    #[error("the margin lies between {t_star:.3e} and {upper_bound:.3e}, and working precision does not tell where")]
    Undecided {
        /// A margin that is attained.
        t_star: f64,
        /// No larger one exists.
        upper_bound: f64,
    },
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

/// Decides whether weights exist for which the gain is optimal, and finds the best conditioned ones.
///
/// 1. t*, scaled: weights exist where it is positive. Where it is small, other units show it better; between ±1e-7 it
///    decides nothing.
/// 2. Where it is positive, `min α` with `I ⪯ blkdiag(Q, R) ⪯ αI` (eq. (3.12), (3.13)); of several weights those of
///    least Frobenius norm.
/// 3. The forward Riccati equation of these weights must return the gain.
///
/// # Errors
/// [`InverseError`].
pub fn inverse_lqr(gains: &Gains, settings: &Settings, ctl: &Ctl) -> Result<InverseLqr, InverseError> {
    settings.structure.check(gains.states(), gains.ports())?;
    ctl.check()?;
    let mut space = Space::new(gains, &settings.structure)?;
    let mut answer = InverseLqr {
        verdict: Verdict::Infeasible,
        t_star: None,
        t_star_scaled: None,
        t_star_upper_bound: None,
        unknowns: space.len(),
        weights: None,
        conditioning: None,
        best_conditioned: false,
    };
    if space.len() == 0 {
        return Ok(answer);
    }
    answer.t_star = margin(&space, &Units::uniform(&space, space.scale), ctl)?.filter(|m| m.solved).map(|m| m.t_star);
    let Some(mut decisive) = margin(&space, &Units::uniform(&space, 1.0), ctl)? else { return Ok(answer) };
    answer.t_star_scaled = Some(decisive.t_star);
    // The sign of the margin does not depend on the units, its size does: where it decides nothing, other units may
    // show it. First those of the states in which plant and gain are of one size, then those in which the weights found
    // so far have a diagonal of ones.
    if decisive.t_star.abs() <= CLEAR || !decisive.solved {
        let (balanced, d) = balanced(gains);
        if d.iter().any(|v| *v != 1.0) {
            let other = Space::new(&balanced, &settings.structure)?.in_states(&d);
            let found = if other.len() == 0 { None } else { margin(&other, &Units::of_states(&other, &d), ctl)? };
            if let Some(found) =
                found.filter(|m| m.solved && (m.t_star.abs() > decisive.t_star.abs() || !decisive.solved))
            {
                (space, decisive) = (other, found);
                answer.unknowns = space.len();
                answer.t_star_scaled = Some(decisive.t_star);
            }
        }
    }
    let s2 = space.scale * space.scale;
    for _ in 0..REBALANCES {
        if decisive.t_star.abs() > CLEAR && decisive.solved {
            break;
        }
        let (q, r) = space.at(&decisive.z);
        let Some(other) = margin(&space, &Units::balancing(&space.weighed(&q), &r), ctl)? else { break };
        if other.solved && (other.t_star.abs() > decisive.t_star.abs() || !decisive.solved) {
            decisive = other;
        } else {
            break;
        }
    }
    if !decisive.solved {
        return Err(InverseError::Undecided { t_star: decisive.t_star, upper_bound: decisive.upper_bound });
    }
    answer.t_star_upper_bound = Some(decisive.upper_bound);
    answer.verdict = verdict(decisive.t_star);
    match answer.verdict {
        Verdict::Infeasible => {}
        Verdict::Boundary => answer.weights = boundary_weights(gains, settings, &space, &decisive),
        Verdict::Feasible => {
            let found = condition::best_conditioned(&space, &decisive.z, settings.structure.q_sign, ctl)?;
            // The best conditioned weights; where rounding keeps those from returning the gain, the ones of the largest
            // margin.
            let mut closest = f64::INFINITY;
            for (z, is_best) in [(&found.z, true), (&decisive.z, false)] {
                let (q, r) = space.at(z);
                let (mut q, mut r) = (symmetric(&(q * s2)), symmetric(&r));
                if !is_best {
                    let least = space.weighed(&q).symmetric_eigenvalues().min().min(r.symmetric_eigenvalues().min());
                    q /= least;
                    r /= least;
                }
                settings.structure.impose(&mut q, &mut r);
                let (weights, error) = proven(gains, settings, q, r, ctl)?;
                closest = closest.min(error);
                if weights.is_some() {
                    answer.weights = weights;
                    answer.best_conditioned = is_best;
                    break;
                }
            }
            if answer.weights.is_none() {
                return Err(InverseError::Unproven { t_star: decisive.t_star, forward_error: closest });
            }
            answer.conditioning = Some(Conditioning {
                alpha: found.alpha,
                alpha_lower_bound: found.lower_bound,
                solution_dimension: found.face,
                solution_width: found.width,
            });
        }
    }
    Ok(answer)
}

/// The weights with their proof, refined where that brings the gain nearer; none where the forward error stays too
/// large.
fn proven(
    gains: &Gains,
    settings: &Settings,
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    ctl: &Ctl,
) -> Result<(Option<Weights>, f64), Stopped> {
    let error_of = |weights: &Option<Weights>| weights.as_ref().map_or(f64::INFINITY, |w| w.proof.forward_error);
    let attempt =
        |q: DMatrix<f64>, r: DMatrix<f64>| proof::prove(gains, &q, &r).ok().map(|proof| Weights { q, r, proof });
    let mut best = attempt(q.clone(), r.clone());
    if error_of(&best) > REFINE {
        let objective = Objective::new(gains, None);
        if let Some((q, r)) = refine(&objective, &settings.structure, &q, &r, ctl)? {
            let refined = attempt(q, r);
            if error_of(&refined) < error_of(&best) {
                best = refined;
            }
        }
    }
    let error = error_of(&best);
    Ok((best.filter(|_| error <= FORWARD), error))
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
