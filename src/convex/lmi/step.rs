//! One predictor-corrector step.

use super::Problem;
use super::scaling::{Factor, LARGE_PRODUCT, Scaled, scaled_terms};
use crate::convex::svec;
use crate::num::linalg::symmetric;
use nalgebra::{DMatrix, DVector};

/// Share of the way to the boundary.
const TO_BOUNDARY: f64 = 0.98;

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

/// One predictor-corrector step; `None` where rounding allows none.
pub(super) fn advance(
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
            DMatrix::from_diagonal(&b.lambda.map(|l| sigma * mu - l * l)) - symmetric(&second)
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
