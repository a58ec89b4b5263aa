//! The best conditioned weights (Priess 2015, eq. (3.11)–(3.13)).

use super::lqr::Settings;
use super::space::Space;
use super::structure::QSign;
use crate::convex::lmi::{self, Block, LmiError, Problem, SolvedBy};
use crate::ctl::Ctl;
use crate::num::linalg::{self, NoConvergence};
use nalgebra::{DMatrix, DVector};

/// Room that the tie-break gets above the least condition number, as a share of it.
const ROOM: f64 = 1e-7;
/// A slack counts as zero below this share of the unit of its block, together with a dual that does not.
const ACTIVE: f64 = 1e-5;
/// Singular values of the active inequalities below this share of the largest leave a direction free.
const FREE: f64 = 1e-6;
/// Relative duality gap of the tie-break.
const FACE_GAP: f64 = 1e-8;
/// Relative duality gap of the width.
const WIDTH_GAP: f64 = 1e-3;
/// In optimal sets of a higher dimension no point is chosen, and they are not measured.
const MAX_FACE: usize = 24;

/// Weights `Q/s²` and R with the least condition number of blkdiag(Q, R).
#[derive(Debug, Clone)]
pub(super) struct Conditioned {
    /// In the coordinates of the space, scaled so that the least eigenvalue is 1 (in the units of the plant).
    pub z: DVector<f64>,
    /// α.
    pub alpha: f64,
    /// No smaller α is possible, by the dual.
    pub lower_bound: f64,
    /// Dimension of the set of weights with the same α.
    pub face: usize,
    /// Who solved it.
    pub solved_by: SolvedBy,
    /// Largest change of a diagonal weight within that set, as a share of the weight; `None` where the set is too large
    /// to be measured, and the weights are then any of it.
    pub width: Option<f64>,
}

/// Why there are none.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum ConditionError {
    #[error(transparent)]
    Lmi(#[from] LmiError),
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
}

/// `min a` with `Q' ⪰ ℓ_Q I`, `R ⪰ ℓ_R I`, `Q' ⪯ a u_Q I`, `R ⪯ a u_R I` from a point with definite weights.
pub(super) fn best_conditioned(
    space: &Space,
    start: &DVector<f64>,
    settings: &Settings,
    ctl: &Ctl,
) -> Result<Conditioned, ConditionError> {
    let s2 = space.scale * space.scale;
    // Q = s²Q' ⪰ I reads Q' ⪰ I/s².
    let (least_q, least_r) = (1.0 / s2, 1.0);
    let (q0, r0) = space.at(start);
    let (q0, weighed) = (space.weighed(&q0), space.weighed_terms());
    let range = |w: &DMatrix<f64>| {
        let values = w.symmetric_eigenvalues();
        (values.min(), values.max())
    };
    let ((low_q, high_q), (low_r, high_r)) = (range(&q0), range(&r0));
    let floor_q = if settings.structure.q_sign == QSign::Definite { least_q } else { 0.0 };
    let factor = 1.5 * (floor_q / low_q).max(least_r / low_r);
    let a0 = 1.5 * factor * (high_q * s2).max(high_r);
    // Blocks in units in which their entries at the start are of size 1.
    let unknowns = space.len() + 1;
    let block = |terms: &[DMatrix<f64>], size: f64, constant: f64, sign: f64, bound: f64| {
        let d = terms[0].nrows();
        let mut all: Vec<DMatrix<f64>> = terms.iter().map(|t| t * (sign * factor / size)).collect();
        all.push(DMatrix::identity(d, d) * (bound / size));
        Block::new(DMatrix::identity(d, d) * (constant / size), all.iter())
    };
    let (size_q, size_r) = (factor * high_q, factor * high_r);
    let blocks = vec![
        block(&weighed, size_q, -floor_q, 1.0, 0.0),
        block(&space.r, size_r, -least_r, 1.0, 0.0),
        block(&weighed, size_q, 0.0, -1.0, a0 / s2),
        block(&space.r, size_r, 0.0, -1.0, a0),
    ];
    let mut cost = DVector::zeros(unknowns);
    cost[unknowns - 1] = 1.0;
    let mut z0 = DVector::zeros(unknowns);
    z0.rows_mut(0, space.len()).copy_from(start);
    z0[unknowns - 1] = 1.0;
    let problem = Problem { cost, quadratic: None, objective_scale: 0.0, gap: lmi::GAP, blocks };
    let (solution, solved_by) = lmi::solve_with(&problem, &z0, settings.solver, ctl)?;
    let alpha = solution.objective * a0;
    // α is at most a0 at the start, and every weight in the feasible set is then bounded; so is what the residual can
    // hide.
    let hidden = solution.dual_residual * (1.0 + solution.z.norm()) * 4.0;
    let lower_bound = ((solution.dual_objective - hidden) * a0).max(1.0);
    let mut found = Conditioned {
        z: solution.z.rows(0, space.len()) * factor,
        alpha,
        lower_bound,
        face: 0,
        solved_by,
        width: Some(0.0),
    };
    let free = free_directions(&problem, &solution)?;
    found.face = free.ncols();
    if free.ncols() > MAX_FACE {
        found.width = None;
    } else if free.ncols() > 0 {
        let face = Face { problem: &problem, solution: &solution, free: &free };
        let chosen = face.least_norm(space, ctl)?;
        found.width = Some(face.width(space, &chosen, ctl)?);
        found.z = chosen.rows(0, space.len()) * factor;
    }
    Ok(found)
}

/// Directions of z, with α kept, that move no active inequality: those within the optimal set, by strict
/// complementarity.
fn free_directions(problem: &Problem, solution: &lmi::Solution) -> Result<DMatrix<f64>, NoConvergence> {
    let unknowns = problem.cost.len() - 1;
    let mut rows: Vec<DVector<f64>> = Vec::new();
    let duals: Vec<_> = solution.duals.iter().map(|x| x.clone().symmetric_eigen()).collect();
    let largest = duals.iter().map(|e| e.eigenvalues.max()).fold(0.0, f64::max);
    for (block, dual) in problem.blocks.iter().zip(&duals) {
        let slack = block.value(&solution.z);
        let active: Vec<usize> = (0..block.size())
            .filter(|i| {
                let u = dual.eigenvectors.column(*i);
                let slack = (u.transpose() * &slack * u)[0];
                dual.eigenvalues[*i] / largest > ACTIVE * 1e-3 && slack < dual.eigenvalues[*i] / largest
            })
            .collect();
        // A slack that the dual annihilates, SX = 0, is zero on the whole range of X: its mixed entries vanish too.
        let u = dual.eigenvectors.select_columns(&active);
        let moved: Vec<DMatrix<f64>> = (0..unknowns).map(|i| block.term(i) * &u).collect();
        for p in 0..block.size() {
            for q in 0..active.len() {
                rows.push(DVector::from_fn(unknowns, |i, _| moved[i][(p, q)]));
            }
        }
    }
    if rows.is_empty() {
        return Ok(DMatrix::zeros(unknowns, 0));
    }
    let matrix = DMatrix::from_fn(rows.len(), unknowns, |i, j| rows[i][j]);
    let (_, values, v) = linalg::svd(&matrix)?;
    let rank = values.iter().filter(|s| **s > FREE * values[0]).count();
    Ok(v.columns(rank, unknowns - rank).into_owned())
}

/// The set of optimal weights around a point in its interior.
struct Face<'a> {
    problem: &'a Problem,
    solution: &'a lmi::Solution,
    free: &'a DMatrix<f64>,
}

impl Face<'_> {
    /// The problem in the free directions, with a little room in α so that it has an interior.
    fn restricted(&self) -> (Vec<Block>, DVector<f64>) {
        let unknowns = self.problem.cost.len();
        let mut base = self.solution.z.clone();
        base[unknowns - 1] *= 1.0 + ROOM;
        let blocks = self
            .problem
            .blocks
            .iter()
            .map(|block| {
                let terms: Vec<DMatrix<f64>> = self
                    .free
                    .column_iter()
                    .map(|c| {
                        let d = block.size();
                        (0..unknowns - 1).fold(DMatrix::zeros(d, d), |sum, i| sum + block.term(i) * c[i])
                    })
                    .collect();
                Block::new(block.value(&base), terms.iter())
            })
            .collect();
        (blocks, base)
    }

    fn point(&self, w: &DVector<f64>) -> DVector<f64> {
        let unknowns = self.problem.cost.len() - 1;
        self.solution.z.rows(0, unknowns) + self.free * w
    }

    /// The point with the least Frobenius norm of blkdiag(Q, R).
    fn least_norm(&self, space: &Space, ctl: &Ctl) -> Result<DVector<f64>, LmiError> {
        let (blocks, _) = self.restricted();
        let s4 = space.scale.powi(4);
        let (q0, r0) = space.at(&self.solution.z);
        let parts: Vec<_> = self.free.column_iter().map(|c| space.at(&c.clone_owned())).collect();
        let inner =
            |a: &(DMatrix<f64>, DMatrix<f64>), b: &(DMatrix<f64>, DMatrix<f64>)| s4 * a.0.dot(&b.0) + a.1.dot(&b.1);
        let base = (q0, r0);
        let scale = inner(&base, &base).max(f64::MIN_POSITIVE);
        let d = parts.len();
        let problem = Problem {
            cost: DVector::from_fn(d, |i, _| inner(&parts[i], &base) / scale),
            quadratic: Some(DMatrix::from_fn(d, d, |i, j| inner(&parts[i], &parts[j]) / scale)),
            objective_scale: 1.0,
            gap: FACE_GAP,
            blocks,
        };
        let solution = lmi::solve(&problem, &DVector::zeros(d), ctl)?;
        Ok(self.point(&solution.z))
    }

    /// The largest relative range of a diagonal weight.
    fn width(&self, space: &Space, chosen: &DVector<f64>, ctl: &Ctl) -> Result<f64, LmiError> {
        let (blocks, _) = self.restricted();
        let d = self.free.ncols();
        let (of_q, of_r): (Vec<_>, Vec<_>) = self.free.column_iter().map(|c| space.at(&c.clone_owned())).unzip();
        let (q, r) = space.at(chosen);
        let diagonal = |parts: &[DMatrix<f64>], chosen: &DMatrix<f64>| {
            let one = |i: usize| (chosen[(i, i)], DVector::from_fn(d, |j, _| parts[j][(i, i)]));
            (0..chosen.nrows()).map(one).collect::<Vec<_>>()
        };
        let mut weights = diagonal(&of_q, &q);
        weights.extend(diagonal(&of_r, &r));
        weights.retain(|(weight, direction)| *weight > 0.0 && direction.norm() > 1e-9 * weight);
        // The widest first, as far as that can be told: others are then given up early.
        weights.sort_by(|(x, to), (y, other)| (other.norm() / y).total_cmp(&(to.norm() / x)));
        if d == 1
            && let Some(length) = segment(&blocks)
        {
            return Ok(weights.iter().map(|(weight, to)| to[0].abs() / weight * length).fold(0.0, f64::max));
        }
        let mut width: f64 = 0.0;
        for (weight, direction) in weights {
            let extreme = |sign: f64, enough: f64| -> Result<f64, LmiError> {
                let problem = Problem {
                    cost: &direction * (sign / weight),
                    quadratic: None,
                    objective_scale: 1.0,
                    gap: WIDTH_GAP,
                    blocks: blocks.clone(),
                };
                let solution = lmi::solve_unless(&problem, &DVector::zeros(d), enough, ctl)?;
                Ok(problem.cost.dot(&solution.z))
            };
            let low = extreme(1.0, f64::INFINITY)?;
            // No wider than what is known.
            width = width.max(-low - extreme(-1.0, -low - width)?);
        }
        Ok(width)
    }
}

/// How long the segment of w is on which `F_0 + wF_1 ⪰ 0` in every block, 0 being inside: from the eigenvalues of
/// `L⁻¹F_1L⁻ᵀ` with `F_0 = LLᵀ`. None where it has no end, or 0 is not inside but for rounding.
fn segment(blocks: &[Block]) -> Option<f64> {
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for block in blocks {
        let factor = block.value(&DVector::zeros(1)).cholesky()?.l();
        let half = factor.solve_lower_triangular(&block.term(0))?;
        let values = factor.solve_lower_triangular(&half.transpose())?.symmetric_eigenvalues();
        // A block that the direction does not make smaller bounds nothing on that side.
        let (least, most) = (values.min(), values.max());
        if most > 0.0 {
            low = low.max(-1.0 / most);
        }
        if least < 0.0 {
            high = high.min(-1.0 / least);
        }
    }
    Some(high - low).filter(|length| length.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One block bounds each side, and one does not move at all.
    #[test]
    fn a_segment_ends_where_the_first_block_is_singular() {
        let block = |constant: f64, term: f64| {
            Block::new(DMatrix::from_element(1, 1, constant), [&DMatrix::from_element(1, 1, term)].into_iter())
        };
        let (up, down, still) = (block(2.0, 1.0), block(3.0, -2.0), block(1.0, 0.0));
        let length = |blocks: &[&Block]| segment(&blocks.iter().map(|b| (*b).clone()).collect::<Vec<_>>());
        assert!((length(&[&up, &still, &down]).unwrap() - 3.5).abs() < 1e-15);
        assert!((length(&[&down, &up]).unwrap() - 3.5).abs() < 1e-15);
        assert_eq!(length(&[&up, &still]), None, "no end above");
        assert_eq!(length(&[&still]), None);
        assert_eq!(length(&[&up, &down, &block(0.0, 1.0)]), None, "on the edge");
    }
}
