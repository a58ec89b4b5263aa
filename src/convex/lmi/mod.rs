//! A dense primal-dual interior-point method for linear matrix inequalities.
//!
//! ```text
//! minimise  cᵀz + ½ zᵀHz   subject to   S_k(z) = F_k0 + Σ_i z_i F_ki ⪰ 0   for every block k
//! maximise  −½ zᵀHz − Σ tr(F_k0 X_k)   subject to   Σ_k tr(F_ki X_k) = (c + Hz)_i,   X_k ⪰ 0
//! ```
//! Nesterov and Todd's scaling with Mehrotra's predictor and corrector (Vandenberghe, The CVXOPT linear and quadratic
//! cone program solvers, 2010). It starts at a strictly feasible z and never leaves the interior: each S_k is computed
//! from z anew, so that it is exactly what z says. With N unknowns and blocks of size d one step costs `N Σ d³ + N² Σ
//! d²/2` operations.

mod choice;
mod scaling;
mod step;

use crate::ctl::{Ctl, Stopped};
pub use choice::{SolvedBy, Solver, solve_with};
use nalgebra::{DMatrix, DVector};
use scaling::{Factor, starting_mu};
use step::advance;

/// The relative duality gap that is asked for where nothing else is said.
pub const GAP: f64 = 1e-10;
/// Relative gap up to which an answer that makes no more progress counts as solved.
const SOLVED: f64 = 1e-7;
/// Relative dual residual up to which the dual bound is trusted.
const DUAL: f64 = 1e-7;
/// Steps at most.
const STEPS: usize = 150;
/// Steps without an improvement of gap or dual residual before giving up.
const PATIENCE: usize = 10;

/// One inequality `F_0 + Σ z_i F_i ⪰ 0`.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// F_0, d×d.
    constant: DMatrix<f64>,
    /// [F_1 … F_N], d×dN.
    terms: DMatrix<f64>,
}

impl Block {
    /// From `F_0` and the `F_i`, all symmetric d×d.
    ///
    /// # Panics
    /// If a size differs, which is a mistake of the caller.
    #[must_use]
    pub fn new<'a>(constant: DMatrix<f64>, terms: impl ExactSizeIterator<Item = &'a DMatrix<f64>>) -> Self {
        let d = constant.nrows();
        let mut all = DMatrix::zeros(d, d * terms.len());
        for (i, term) in terms.enumerate() {
            assert_eq!(term.shape(), (d, d), "a term of a block of size {d}");
            all.columns_mut(i * d, d).copy_from(term);
        }
        Self { constant, terms: all }
    }

    /// The number of rows, d.
    #[must_use]
    pub fn size(&self) -> usize {
        self.constant.nrows()
    }

    /// S(z).
    #[must_use]
    pub fn value(&self, z: &DVector<f64>) -> DMatrix<f64> {
        let d = self.size();
        let mut s = self.constant.clone();
        let slice = s.as_mut_slice();
        for (i, factor) in z.iter().enumerate() {
            if *factor != 0.0 {
                let term = &self.terms.as_slice()[i * d * d..(i + 1) * d * d];
                for (to, from) in slice.iter_mut().zip(term) {
                    *to += factor * from;
                }
            }
        }
        s
    }

    /// F_i, counted from 0.
    #[must_use]
    pub fn term(&self, i: usize) -> DMatrix<f64> {
        self.terms.columns(i * self.size(), self.size()).into_owned()
    }

    /// `tr(F_i X)` for every i.
    fn adjoint(&self, x: &DMatrix<f64>) -> DVector<f64> {
        let d = self.size();
        let n = self.terms.ncols() / d.max(1);
        let x = x.as_slice();
        DVector::from_fn(n, |i, _| {
            self.terms.as_slice()[i * d * d..(i + 1) * d * d].iter().zip(x).map(|(f, x)| f * x).sum()
        })
    }
}

/// A problem in N unknowns.
#[derive(Debug, Clone, PartialEq)]
pub struct Problem {
    /// c, N.
    pub cost: DVector<f64>,
    /// H ⪰ 0, N×N; none for a linear cost.
    pub quadratic: Option<DMatrix<f64>>,
    /// Below this size of the cost the gap counts absolutely; 0 for a cost that is known to stay away from 0.
    pub objective_scale: f64,
    /// The relative duality gap that ends the iteration.
    pub gap: f64,
    /// The inequalities, each with N terms.
    pub blocks: Vec<Block>,
}

/// How an iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Relative gap and dual residual are small.
    Solved,
    /// No more progress; the values say how far it came.
    Stalled,
}

/// Where an iteration ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// The unknowns, strictly feasible.
    pub z: DVector<f64>,
    /// X_k, positive definite.
    pub duals: Vec<DMatrix<f64>>,
    /// The cost of z.
    pub objective: f64,
    /// The dual cost; a lower bound up to the dual residual.
    pub dual_objective: f64,
    /// `Σ tr(S_k X_k)`.
    pub gap: f64,
    /// Norm of `c + Hz − Σ tr(F_i X)`.
    pub dual_residual: f64,
    /// Steps taken.
    pub steps: usize,
    /// How it ended.
    pub status: Status,
}

/// Why there is no iteration at all.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LmiError {
    /// The start violates an inequality.
    #[error("the start is not strictly feasible in inequality {block}")]
    Infeasible {
        /// Which one, from 0.
        block: usize,
    },
    /// Somebody asked to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

/// Solves the problem from a strictly feasible start.
///
/// # Errors
/// [`LmiError::Infeasible`] where the start violates an inequality, [`LmiError::Stopped`] when `ctl` says so.
///
/// # Panics
/// If the sizes disagree, which is a mistake of the caller.
pub fn solve(problem: &Problem, start: &DVector<f64>, ctl: &Ctl) -> Result<Solution, LmiError> {
    solve_unless(problem, start, f64::INFINITY, ctl)
}

/// As [`solve`], but it ends as soon as the dual shows that no cost is below `enough`.
///
/// # Errors
/// As [`solve`].
///
/// # Panics
/// As [`solve`].
pub fn solve_unless(problem: &Problem, start: &DVector<f64>, enough: f64, ctl: &Ctl) -> Result<Solution, LmiError> {
    let unknowns = problem.cost.len();
    assert_eq!(start.len(), unknowns, "unknowns of a start");
    let blocks = &problem.blocks;
    let floor = problem.objective_scale.max(f64::MIN_POSITIVE);
    let degree: f64 = blocks.iter().map(|block| block.size() as f64).sum();
    let mut z = start.clone();
    let factor_all = |z: &DVector<f64>| -> Result<Vec<Factor>, usize> {
        blocks.iter().enumerate().map(|(k, block)| block.value(z).cholesky().ok_or(k)).collect()
    };
    let mut s = factor_all(&z).map_err(|block| LmiError::Infeasible { block })?;
    let gradient = |z: &DVector<f64>| match &problem.quadratic {
        Some(h) => &problem.cost + h * z,
        None => problem.cost.clone(),
    };
    let inverses: Vec<DMatrix<f64>> = s.iter().map(Factor::inverse).collect();
    let mu = starting_mu(problem, &s, &inverses, &gradient(&z), ctl)?;
    let mut duals: Vec<DMatrix<f64>> = inverses.into_iter().map(|x| x * mu).collect();

    let mut best: Option<Solution> = None;
    let mut since_best = 0;
    let mut least_dual = f64::INFINITY;
    for step in 0..=STEPS {
        ctl.check()?;
        let g = gradient(&z);
        let adjoint = blocks.iter().zip(&duals).fold(DVector::zeros(unknowns), |sum, (b, x)| sum + b.adjoint(x));
        let dual_residual = &g - adjoint;
        let gap: f64 = blocks.iter().zip(&duals).map(|(b, x)| b.value(&z).dot(x)).sum();
        let half = problem.quadratic.as_ref().map_or(0.0, |h| 0.5 * z.dot(&(h * &z)));
        let objective = problem.cost.dot(&z) + half;
        let constant: f64 = blocks.iter().zip(&duals).map(|(b, x)| b.constant.dot(x)).sum();
        let relative = gap / objective.abs().max(floor);
        // Both parts of the gradient: their sum vanishes where no inequality is active.
        let size = (problem.cost.norm() + (&g - &problem.cost).norm()).max(f64::MIN_POSITIVE);
        let relative_dual = dual_residual.norm() / size;
        let merit = relative.max(relative_dual);
        let solution = |status| Solution {
            z: z.clone(),
            duals: duals.clone(),
            objective,
            dual_objective: -half - constant,
            gap,
            dual_residual: dual_residual.norm(),
            steps: step,
            status,
        };
        if relative_dual <= DUAL && (relative <= problem.gap || -half - constant >= enough) {
            return Ok(solution(Status::Solved));
        }
        let merit_of = |s: &Solution| (s.gap / s.objective.abs().max(floor)).max(s.dual_residual / size);
        if best.as_ref().is_none_or(|b| merit < 0.9 * merit_of(b)) {
            let status = if relative <= SOLVED.max(problem.gap) && relative_dual <= DUAL {
                Status::Solved
            } else {
                Status::Stalled
            };
            best = Some(solution(status));
            since_best = 0;
        } else if relative_dual < 0.9 * least_dual {
            // The gap may grow while the dual is still on its way to feasibility.
            since_best = 0;
        } else {
            since_best += 1;
        }
        least_dual = least_dual.min(relative_dual);
        if since_best > PATIENCE || step == STEPS {
            break;
        }
        let Some(next) = advance(problem, &z, &s, &duals, &dual_residual, gap / degree, ctl)? else { break };
        let (next_z, next_duals) = next;
        let Ok(next_s) = factor_all(&next_z) else { break };
        (z, s, duals) = (next_z, next_s, next_duals);
    }
    best.ok_or(LmiError::Infeasible { block: 0 })
}
