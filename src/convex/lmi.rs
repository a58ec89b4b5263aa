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

use super::svec;
use crate::ctl::{Ctl, Stopped};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// The relative duality gap that is asked for where nothing else is said.
pub const GAP: f64 = 1e-10;
/// Relative gap up to which an answer that makes no more progress counts as solved.
const SOLVED: f64 = 1e-7;
/// Relative dual residual up to which the dual bound is trusted.
const DUAL: f64 = 1e-7;
/// Steps at most.
const STEPS: usize = 150;
/// Share of the way to the boundary.
const TO_BOUNDARY: f64 = 0.98;
/// Steps without an improvement of gap or dual residual before giving up.
const PATIENCE: usize = 10;
/// From so many operations on a product goes to faer's kernel instead of nalgebra's.
const LARGE_PRODUCT: usize = 40_000;

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

type Factor = Cholesky<f64, Dyn>;

/// One block in the coordinates where S and X are the same diagonal matrix.
struct Scaled {
    /// λ: `R⁻¹SR⁻ᵀ = RᵀXR = diag(λ)`.
    lambda: DVector<f64>,
    /// R⁻¹.
    inverse: DMatrix<f64>,
}

impl Scaled {
    /// From the factors of S and X: with `L_xᵀL_s = UΛVᵀ`, `R = L_s V Λ^(−1/2)`.
    fn new(s: &Factor, x: &Factor) -> Option<Self> {
        let (ls, lx) = (s.l(), x.l());
        let product = lx.tr_mul(&ls);
        // Eigenvectors of the Gram matrix would lose half of the digits of the small singular values.
        let (lambda, v) = right_singular(&product)?;
        if lambda.iter().any(|l| !(l.is_finite() && *l > 0.0)) {
            return None;
        }
        // R⁻¹ = Λ^(1/2) Vᵀ L_s⁻¹: solve L_sᵀ Y = V and transpose.
        let y = ls.tr_solve_lower_triangular(&v)?;
        let mut inverse = y.transpose();
        for (i, l) in lambda.iter().enumerate() {
            inverse.row_mut(i).scale_mut(l.sqrt());
        }
        Some(Self { lambda, inverse })
    }

    /// `R⁻ᵀ M R⁻¹`, from the scaled dual to the dual.
    fn dual(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        let full = self.inverse.tr_mul(&(m * &self.inverse));
        (&full + full.transpose()) * 0.5
    }

    /// The longest step that keeps `Λ + step·M` semidefinite.
    fn longest(&self, m: &DMatrix<f64>) -> f64 {
        let d = self.lambda.len();
        let scaled =
            DMatrix::from_fn(d, d, |i, j| 0.5 * (m[(i, j)] + m[(j, i)]) / (self.lambda[i] * self.lambda[j]).sqrt());
        let least = scaled.symmetric_eigenvalues().min();
        if least < 0.0 { -1.0 / least } else { f64::INFINITY }
    }
}

/// Singular values and right singular vectors, by one-sided Jacobi rotations: small values come out with high relative
/// accuracy, and small matrices without a call into a blocked decomposition.
fn right_singular(a: &DMatrix<f64>) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let d = a.nrows();
    if d > 12 {
        let (_, values, v) = crate::num::linalg::svd(a).ok()?;
        return Some((DVector::from_vec(values), v));
    }
    let mut work = a.clone();
    let mut v = DMatrix::<f64>::identity(d, d);
    for _ in 0..40 {
        let mut rotated = false;
        for p in 0..d {
            for q in p + 1..d {
                let (alpha, beta, gamma) = {
                    let (cp, cq) = (work.column(p), work.column(q));
                    (cp.norm_squared(), cq.norm_squared(), cp.dot(&cq))
                };
                if gamma.abs() <= 1e-15 * (alpha * beta).sqrt() || gamma == 0.0 {
                    continue;
                }
                rotated = true;
                let zeta = (beta - alpha) / (2.0 * gamma);
                let t = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
                let t = if zeta == 0.0 { 1.0 } else { t };
                let c = 1.0 / t.hypot(1.0);
                let s = c * t;
                for matrix in [&mut work, &mut v] {
                    let (mut left, mut right) = matrix.columns_range_pair_mut(p..=p, q..=q);
                    for (l, r) in left.iter_mut().zip(right.iter_mut()) {
                        let (old_l, old_r) = (*l, *r);
                        *l = c * old_l - s * old_r;
                        *r = s * old_l + c * old_r;
                    }
                }
            }
        }
        if !rotated {
            break;
        }
    }
    Some((DVector::from_fn(d, |i, _| work.column(i).norm()), v))
}

/// `A·B`, or `AᵀB`.
fn product(a: &DMatrix<f64>, b: &DMatrix<f64>, transpose: bool) -> DMatrix<f64> {
    let rows = if transpose { a.ncols() } else { a.nrows() };
    if rows * a.len() / rows.max(1) * b.ncols() < LARGE_PRODUCT {
        return if transpose { a.tr_mul(b) } else { a * b };
    }
    let mut c = DMatrix::zeros(rows, b.ncols());
    let left = faer::MatRef::from_column_major_slice(a.as_slice(), a.nrows(), a.ncols());
    let right = faer::MatRef::from_column_major_slice(b.as_slice(), b.nrows(), b.ncols());
    let target = faer::MatMut::from_column_major_slice_mut(c.as_mut_slice(), rows, b.ncols());
    let left = if transpose { left.transpose() } else { left };
    faer::linalg::matmul::matmul(target, faer::Accum::Replace, left, right, 1.0, faer::Par::Seq);
    c
}

/// The rows `svec(R⁻¹F_iR⁻ᵀ)` of every block, one column per unknown.
fn scaled_terms(blocks: &[Block], scaled: &[Scaled], unknowns: usize) -> DMatrix<f64> {
    let rows: usize = blocks.iter().map(|block| svec::length(block.size())).sum();
    let mut all = DMatrix::zeros(rows, unknowns);
    let mut offset = 0;
    for (block, scaled) in blocks.iter().zip(scaled) {
        let d = block.size();
        let mut half = product(&scaled.inverse, &block.terms, false);
        let mut square = vec![0.0; d * d];
        for i in 0..unknowns {
            let part = &mut half.as_mut_slice()[i * d * d..(i + 1) * d * d];
            square.copy_from_slice(part);
            for r in 0..d {
                for c in 0..d {
                    part[c + r * d] = square[r + c * d];
                }
            }
        }
        let full = product(&scaled.inverse, &half, false);
        let length = svec::length(d);
        for i in 0..unknowns {
            let from = &full.as_slice()[i * d * d..(i + 1) * d * d];
            svec::write(from, d, &mut all.as_mut_slice()[i * rows + offset..i * rows + offset + length]);
        }
        offset += length;
    }
    all
}

struct Direction {
    dz: DVector<f64>,
    ds: Vec<DMatrix<f64>>,
    dx: Vec<DMatrix<f64>>,
}

/// Least squares `min ‖F dz − d‖² + dzᵀH dz + 2 rᵀdz` by orthogonal factors: forming FᵀF would lose half of the digits,
/// and near the optimum F is as ill-conditioned as the problem is well solved.
struct LeastSquares {
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    terms: DMatrix<f64>,
    quadratic: Option<DMatrix<f64>>,
}

impl LeastSquares {
    fn new(terms: DMatrix<f64>, quadratic: Option<&DMatrix<f64>>) -> Option<Self> {
        let (rows, unknowns) = terms.shape();
        // H = RᵀR as further rows.
        let root = quadratic.map(|h| {
            let eigen = h.clone().symmetric_eigen();
            let scale = DMatrix::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
            scale * eigen.eigenvectors.transpose()
        });
        let extra = root.as_ref().map_or(0, DMatrix::nrows);
        let mut all = DMatrix::zeros((rows + extra).max(unknowns), unknowns);
        all.view_mut((0, 0), (rows, unknowns)).copy_from(&terms);
        if let Some(root) = root {
            all.view_mut((rows, 0), (extra, unknowns)).copy_from(&root);
        }
        let (q, r) = if all.len() * unknowns < LARGE_PRODUCT {
            let qr = all.qr();
            (qr.q(), qr.r())
        } else {
            let qr = faer::MatRef::from_column_major_slice(all.as_slice(), all.nrows(), unknowns).qr();
            let (q, r) = (qr.compute_thin_Q(), qr.thin_R());
            (
                DMatrix::from_fn(q.nrows(), q.ncols(), |i, j| q[(i, j)]),
                DMatrix::from_fn(unknowns, unknowns, |i, j| if i <= j { r[(i, j)] } else { 0.0 }),
            )
        };
        let regular = r.diagonal().iter().all(|v| v.is_finite() && *v != 0.0);
        let q = q.rows(0, rows).into_owned();
        regular.then(|| Self { q, r, terms, quadratic: quadratic.cloned() })
    }

    fn solve(&self, wanted: &DVector<f64>, linear: &DVector<f64>) -> DVector<f64> {
        let zero = || DVector::from_element(linear.len(), f64::NAN);
        let normal = |right: &DVector<f64>| {
            let half = self.r.tr_solve_upper_triangular(right).unwrap_or_else(zero);
            self.r.solve_upper_triangular(&half).unwrap_or_else(zero)
        };
        let mut dz = self.r.solve_upper_triangular(&self.q.tr_mul(wanted)).unwrap_or_else(zero) - normal(linear);
        for _ in 0..2 {
            let mut residual = self.terms.tr_mul(&(wanted - &self.terms * &dz)) - linear;
            if let Some(h) = &self.quadratic {
                residual -= h * &dz;
            }
            dz += normal(&residual);
        }
        dz
    }
}

struct Linearised<'a> {
    scaled: &'a [Scaled],
    system: LeastSquares,
    dual_residual: &'a DVector<f64>,
}

impl Linearised<'_> {
    /// The step for which `Λ∘(dS + dX) = T` in scaled coordinates, T given by block.
    fn direction(&self, targets: &[DMatrix<f64>]) -> Direction {
        let mut wanted = DVector::zeros(self.system.terms.nrows());
        let mut offset = 0;
        let mut sums = Vec::with_capacity(targets.len());
        for (scaled, target) in self.scaled.iter().zip(targets) {
            let d = scaled.lambda.len();
            let sum = DMatrix::from_fn(d, d, |i, j| {
                (target[(i, j)] + target[(j, i)]) / (scaled.lambda[i] + scaled.lambda[j])
            });
            let length = svec::length(d);
            svec::write(sum.as_slice(), d, &mut wanted.as_mut_slice()[offset..offset + length]);
            offset += length;
            sums.push(sum);
        }
        let dz = self.system.solve(&wanted, self.dual_residual);
        let moved = &self.system.terms * &dz;
        let mut offset = 0;
        let mut ds = Vec::with_capacity(sums.len());
        let mut dx = Vec::with_capacity(sums.len());
        for sum in sums {
            let d = sum.nrows();
            let length = svec::length(d);
            let step = svec::smat(&moved.as_slice()[offset..offset + length], d);
            offset += length;
            dx.push(sum - &step);
            ds.push(step);
        }
        Direction { dz, ds, dx }
    }
}

/// Solves the problem from a strictly feasible start.
///
/// # Errors
/// [`LmiError::Infeasible`] where the start violates an inequality, [`LmiError::Stopped`] when `ctl` says so.
///
/// # Panics
/// If the sizes disagree, which is a mistake of the caller.
pub fn solve(problem: &Problem, start: &DVector<f64>, ctl: &Ctl) -> Result<Solution, LmiError> {
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
    let mu = starting_mu(problem, &s, &inverses, &gradient(&z));
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
        if relative <= problem.gap && relative_dual <= DUAL {
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
        let Some(next) = advance(problem, &z, &s, &duals, &dual_residual, gap / degree) else { break };
        let (next_z, next_duals) = next;
        let Ok(next_s) = factor_all(&next_z) else { break };
        (z, s, duals) = (next_z, next_s, next_duals);
    }
    best.ok_or(LmiError::Infeasible { block: 0 })
}

/// The μ with which `X = μS⁻¹` comes nearest to dual feasibility, in the metric of the barrier's Hessian (which knows
/// no units); large enough that what is missing is no larger than the barrier's own gradient.
fn starting_mu(problem: &Problem, s: &[Factor], inverses: &[DMatrix<f64>], gradient: &DVector<f64>) -> f64 {
    let unknowns = gradient.len();
    let barrier = problem.blocks.iter().zip(inverses).fold(DVector::zeros(unknowns), |sum, (b, x)| sum + b.adjoint(x));
    let local: Option<Vec<Scaled>> = s
        .iter()
        .map(|s| {
            let d = s.l_dirty().nrows();
            let inverse = s.l().solve_lower_triangular(&DMatrix::identity(d, d))?;
            Some(Scaled { lambda: DVector::from_element(d, 1.0), inverse })
        })
        .collect();
    let metric = local.and_then(|local| {
        let terms = scaled_terms(&problem.blocks, &local, unknowns);
        factor_normal(&product(&terms, &terms, true))
    });
    let solved = metric.map(|factor| (factor.solve(gradient), factor.solve(&barrier)));
    let mu = solved.map_or(1.0, |(g, b)| {
        let fitted = barrier.dot(&g) / barrier.dot(&b);
        let least = gradient.dot(&g).max(0.0).sqrt();
        if fitted.is_finite() { fitted.max(least) } else { least }
    });
    if mu.is_normal() { mu } else { 1.0 }
}

/// One predictor-corrector step; `None` where rounding allows none.
fn advance(
    problem: &Problem,
    z: &DVector<f64>,
    s: &[Factor],
    duals: &[DMatrix<f64>],
    dual_residual: &DVector<f64>,
    mu: f64,
) -> Option<(DVector<f64>, Vec<DMatrix<f64>>)> {
    let blocks = &problem.blocks;
    let scaled: Vec<Scaled> =
        s.iter().zip(duals).map(|(s, x)| Scaled::new(s, &x.clone().cholesky()?)).collect::<Option<_>>()?;
    let terms = scaled_terms(blocks, &scaled, z.len());
    let system = LeastSquares::new(terms, problem.quadratic.as_ref())?;
    let linearised = Linearised { scaled: &scaled, system, dual_residual };
    let targets: Vec<DMatrix<f64>> = scaled.iter().map(|b| DMatrix::from_diagonal(&b.lambda.map(|l| -l * l))).collect();
    let predictor = linearised.direction(&targets);
    let longest = |steps: &[DMatrix<f64>]| scaled.iter().zip(steps).map(|(b, m)| b.longest(m)).fold(1.0, f64::min);
    let joint = problem.quadratic.is_some();
    let (mut primal, mut dual) = (longest(&predictor.ds), longest(&predictor.dx));
    if joint {
        (primal, dual) = (primal.min(dual), primal.min(dual));
    }
    // The gap that the predictor alone would leave decides how much to centre.
    let mut after = 0.0;
    for ((b, ds), dx) in scaled.iter().zip(&predictor.ds).zip(&predictor.dx) {
        let diagonal = DMatrix::from_diagonal(&b.lambda);
        after += (&diagonal + ds * primal).dot(&(&diagonal + dx * dual));
    }
    let degree: f64 = scaled.iter().map(|b| b.lambda.len() as f64).sum();
    let sigma = (after / degree / mu).clamp(0.0, 1.0).powi(3);
    let targets: Vec<DMatrix<f64>> = scaled
        .iter()
        .zip(predictor.ds.iter().zip(&predictor.dx))
        .map(|(b, (ds, dx))| {
            let second = ds * dx;
            DMatrix::from_diagonal(&b.lambda.map(|l| sigma * mu - l * l)) - (&second + second.transpose()) * 0.5
        })
        .collect();
    let step = linearised.direction(&targets);
    let bounded = |steps: &[DMatrix<f64>]| {
        (TO_BOUNDARY * scaled.iter().zip(steps).map(|(b, m)| b.longest(m)).fold(f64::INFINITY, f64::min)).min(1.0)
    };
    let (mut primal, mut dual) = (bounded(&step.ds), bounded(&step.dx));
    if joint {
        (primal, dual) = (primal.min(dual), primal.min(dual));
    }
    let dx: Vec<DMatrix<f64>> = scaled.iter().zip(&step.dx).map(|(b, m)| b.dual(m)).collect();
    // Rounding may put a step that is inside on paper just outside.
    for _ in 0..20 {
        let next_z = z + &step.dz * primal;
        let next: Vec<DMatrix<f64>> = duals.iter().zip(&dx).map(|(x, m)| x + m * dual).collect();
        let primal_fits = blocks.iter().all(|b| b.value(&next_z).cholesky().is_some());
        let dual_fits = next.iter().all(|x| x.clone().cholesky().is_some());
        if primal_fits && dual_fits {
            let moves = primal > 1e-9 || dual > 1e-9;
            return moves.then_some((next_z, next));
        }
        if !primal_fits || joint {
            primal *= 0.7;
        }
        if !dual_fits || joint {
            dual *= 0.7;
        }
    }
    None
}

/// Cholesky of the normal matrix, with the least shift of its diagonal that makes it definite.
fn factor_normal(normal: &DMatrix<f64>) -> Option<Factor> {
    let diagonal = normal.diagonal();
    let largest = diagonal.max();
    let mut shift = 0.0;
    for _ in 0..12 {
        let mut shifted = normal.clone();
        for i in 0..shifted.nrows() {
            shifted[(i, i)] += shift * diagonal[i].max(1e-20 * largest);
        }
        if let Some(factor) = shifted.cholesky()
            && factor.l_dirty().diagonal().iter().all(|v| v.is_finite())
        {
            return Some(factor);
        }
        shift = if shift == 0.0 { 1e-15 } else { shift * 10.0 };
    }
    None
}
