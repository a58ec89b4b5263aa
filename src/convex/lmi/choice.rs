//! Which method solves a problem: clarabel, or the interior-point method of this room.

use super::{DUAL, LmiError, Problem, Solution, Status, solve};
use crate::convex::conic::{Affine, ConicError, Outcome, Program};
use crate::convex::svec;
use crate::ctl::Ctl;
use crate::num::linalg::symmetric;
use nalgebra::{DMatrix, DVector};

/// Unknowns up to which clarabel is asked first: there it answers in the time that the method of this room takes.
const SMALL: usize = 16;
/// Unknowns up to which clarabel can be asked at all: beyond one of its steps takes longer than a cancel may wait.
const LARGEST: usize = 160;
/// Relative gap up to which an answer of clarabel is accepted.
const ACCEPTED: f64 = 1e-8;
/// Shares of the strictly feasible start that bring an answer from the boundary into the interior.
const INWARD: [f64; 7] = [0.0, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8];
/// Eigenvalues of a dual below this share of the largest are set to it.
const DUAL_FLOOR: f64 = 1e-15;

/// Who is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Solver {
    /// clarabel where it is quick, the other where it is not, or where clarabel's answer fails its check.
    #[default]
    Auto,
    /// clarabel alone; where its answer fails its check, the method of this room.
    Clarabel,
    /// The method of this room.
    InteriorPoint,
}

/// Who answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolvedBy {
    /// clarabel.
    Clarabel,
    /// The method of this room.
    InteriorPoint,
    /// The method of this room, after an answer of clarabel that failed its check.
    Both,
}

/// Solves the problem from a strictly feasible start by the method asked for, and says who answered.
///
/// An answer of clarabel counts where z is strictly feasible, and where the gap and the residual of its duals, computed
/// here, are small: as an answer of [`solve`] counts.
///
/// # Errors
/// [`LmiError`].
pub fn solve_with(
    problem: &Problem,
    start: &DVector<f64>,
    solver: Solver,
    ctl: &Ctl,
) -> Result<(Solution, SolvedBy), LmiError> {
    let unknowns = problem.cost.len();
    let limit = match solver {
        Solver::Auto => SMALL,
        Solver::Clarabel => LARGEST,
        Solver::InteriorPoint => 0,
    };
    let mut by = SolvedBy::InteriorPoint;
    if unknowns <= limit {
        match by_clarabel(problem, start, ctl) {
            Ok(Some(solution)) => return Ok((solution, SolvedBy::Clarabel)),
            Ok(None) => by = SolvedBy::Both,
            Err(error) => return Err(error),
        }
    }
    Ok((solve(problem, start, ctl)?, by))
}

fn by_clarabel(problem: &Problem, start: &DVector<f64>, ctl: &Ctl) -> Result<Option<Solution>, LmiError> {
    let unknowns = problem.cost.len();
    let mut program = Program::new(unknowns);
    for (i, cost) in problem.cost.iter().enumerate() {
        program.add_cost(i, *cost);
    }
    if let Some(h) = &problem.quadratic {
        for j in 0..unknowns {
            for i in 0..=j {
                program.add_quadratic_cost(i, j, 0.5 * (h[(i, j)] + h[(j, i)]));
            }
        }
    }
    for block in &problem.blocks {
        let terms: Vec<DMatrix<f64>> = (0..unknowns).map(|i| block.term(i)).collect();
        program.semidefinite(block.size(), |i, j| Affine {
            constant: block.constant[(i, j)],
            terms: terms.iter().enumerate().map(|(k, t)| (k, t[(i, j)])).filter(|(_, v)| *v != 0.0).collect(),
        });
    }
    let answer = match program.solve(ctl) {
        Ok(answer) => answer,
        Err(ConicError::Stopped(stopped)) => return Err(stopped.into()),
        Err(ConicError::NotFinite | ConicError::Refused(_)) => return Ok(None),
    };
    if !matches!(answer.outcome, Outcome::Solved | Outcome::AlmostSolved) {
        return Ok(None);
    }
    let found = DVector::from_vec(answer.x);
    let inside = INWARD.into_iter().map(|share| &found * (1.0 - share) + start * share);
    let is_inside = |z: &DVector<f64>| problem.blocks.iter().all(|block| block.value(z).cholesky().is_some());
    let Some(z) = inside.into_iter().find(is_inside) else { return Ok(None) };
    let mut at = 0;
    let duals: Vec<DMatrix<f64>> = problem
        .blocks
        .iter()
        .map(|block| {
            let length = svec::length(block.size());
            let dual = svec::smat(&answer.dual[at..at + length], block.size());
            at += length;
            definite(&dual)
        })
        .collect();
    let half = problem.quadratic.as_ref().map_or(0.0, |h| 0.5 * z.dot(&(h * &z)));
    let slope = problem.quadratic.as_ref().map_or_else(|| DVector::zeros(unknowns), |h| h * &z);
    let adjoint = problem.blocks.iter().zip(&duals).fold(DVector::zeros(unknowns), |sum, (b, x)| sum + b.adjoint(x));
    let dual_residual = (&problem.cost + &slope - adjoint).norm();
    let size = (problem.cost.norm() + slope.norm()).max(f64::MIN_POSITIVE);
    let gap: f64 = problem.blocks.iter().zip(&duals).map(|(b, x)| b.value(&z).dot(x)).sum();
    let constant: f64 = problem.blocks.iter().zip(&duals).map(|(b, x)| b.constant.dot(x)).sum();
    let objective = problem.cost.dot(&z) + half;
    let relative = gap / objective.abs().max(problem.objective_scale).max(f64::MIN_POSITIVE);
    if !(relative <= ACCEPTED && dual_residual <= DUAL * size) {
        return Ok(None);
    }
    Ok(Some(Solution {
        z,
        duals,
        objective,
        dual_objective: -half - constant,
        gap,
        dual_residual,
        steps: answer.steps as usize,
        status: Status::Solved,
    }))
}

/// The nearest definite matrix.
fn definite(m: &DMatrix<f64>) -> DMatrix<f64> {
    let eigen = symmetric(m).symmetric_eigen();
    let floor = DUAL_FLOOR * eigen.eigenvalues.amax().max(f64::MIN_POSITIVE);
    let values = eigen.eigenvalues.map(|v| v.max(floor));
    symmetric(&(&eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose()))
}
