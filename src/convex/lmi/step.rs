//! One predictor-corrector step.

use super::Problem;
use super::scaling::{Factor, Scaled, product, scaled_terms};
use crate::convex::svec;
use crate::ctl::{Ctl, Stopped};
use crate::num::linalg::symmetric;
use nalgebra::{DMatrix, DVector};

/// Share of the way to the boundary.
const TO_BOUNDARY: f64 = 0.98;
/// Rows that are factored at a time, or as many as there are unknowns.
const ROWS: usize = 512;
/// Steps of refinement.
const REFINEMENTS: usize = 6;
/// A step of refinement that moves the solution by less than this share is the last.
const REFINED: f64 = 1e-11;
/// From this size on a Cholesky factor comes from faer.
const LARGE_FACTOR: usize = 40;

struct Direction {
    dz: DVector<f64>,
    ds: Vec<DMatrix<f64>>,
    dx: Vec<DMatrix<f64>>,
}

/// Least squares `min ‖F dz − d‖² + dzᵀH dz + 2 rᵀdz` by a triangular factor of FᵀF + H, with refinement against F
/// itself (corrected seminormal equations, Björck, Linear Algebra Appl. 88/89, 31–48, 1987).
///
/// The factor of the Gram matrix is quick and has half of the digits; where refinement does not make up for that, near
/// the optimum, the factor comes from F by orthogonal transformations.
struct LeastSquares {
    r: DMatrix<f64>,
    terms: DMatrix<f64>,
    quadratic: Option<DMatrix<f64>>,
}

impl LeastSquares {
    /// From the Gram matrix; `None` where that is not definite to working precision.
    fn quick(terms: &DMatrix<f64>, quadratic: Option<&DMatrix<f64>>) -> Option<DMatrix<f64>> {
        let mut gram = product(terms, terms, true);
        if let Some(h) = quadratic {
            gram += h;
        }
        // Columns of one size: the units of the unknowns do not matter.
        let scale = gram.diagonal().map(|v| v.sqrt());
        if scale.iter().any(|v| !(v.is_finite() && *v > 0.0)) {
            return None;
        }
        let scaled = DMatrix::from_fn(scale.len(), scale.len(), |i, j| gram[(i, j)] / (scale[i] * scale[j]));
        let mut r = cholesky(&scaled)?;
        for (mut column, factor) in r.column_iter_mut().zip(scale.iter()) {
            column *= *factor;
        }
        Some(r)
    }

    /// From F itself, and the root of H below it, some rows at a time.
    fn careful(
        terms: &DMatrix<f64>,
        quadratic: Option<&DMatrix<f64>>,
        ctl: &Ctl,
    ) -> Result<Option<DMatrix<f64>>, Stopped> {
        let unknowns = terms.ncols();
        let root = quadratic.map(|h| {
            let eigen = h.clone().symmetric_eigen();
            let scale = DMatrix::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
            scale * eigen.eigenvectors.transpose()
        });
        let mut r = root.unwrap_or_else(|| DMatrix::zeros(0, unknowns));
        let mut at = 0;
        while at < terms.nrows() || r.nrows() < unknowns {
            ctl.check()?;
            let count = ROWS.max(unknowns).min(terms.nrows() - at);
            let rows = (r.nrows() + count).max(unknowns);
            let mut all = DMatrix::zeros(rows, unknowns);
            all.rows_mut(0, r.nrows()).copy_from(&r);
            all.rows_mut(r.nrows(), count).copy_from(&terms.rows(at, count));
            let qr = faer::MatRef::from_column_major_slice(all.as_slice(), rows, unknowns).qr();
            let upper = qr.thin_R();
            r = DMatrix::from_fn(unknowns, unknowns, |i, j| if i <= j { upper[(i, j)] } else { 0.0 });
            at += count;
        }
        let regular = r.diagonal().iter().all(|v| v.is_finite() && *v != 0.0);
        Ok(regular.then_some(r))
    }

    /// The minimiser, and whether refinement ended with a residual that is rounding.
    fn solve(&self, wanted: &DVector<f64>, linear: &DVector<f64>) -> (DVector<f64>, bool) {
        let zero = || DVector::from_element(linear.len(), f64::NAN);
        let normal = |right: &DVector<f64>| {
            let half = self.r.tr_solve_upper_triangular(right).unwrap_or_else(zero);
            self.r.solve_upper_triangular(&half).unwrap_or_else(zero)
        };
        let residual = |dz: &DVector<f64>| {
            let mut residual = self.terms.tr_mul(&(wanted - &self.terms * dz)) - linear;
            if let Some(h) = &self.quadratic {
                residual -= h * dz;
            }
            residual
        };
        let mut dz = normal(&(self.terms.tr_mul(wanted) - linear));
        let mut is_exact = false;
        for _ in 0..REFINEMENTS {
            let step = normal(&residual(&dz));
            let (moved, size) = (step.norm(), dz.norm());
            dz += step;
            if moved <= REFINED * size {
                is_exact = true;
                break;
            }
        }
        (dz, is_exact)
    }
}

/// The upper triangular R with `RᵀR = M`.
fn cholesky(m: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    if m.nrows() < LARGE_FACTOR {
        return m.clone().cholesky().map(|factor| factor.l().transpose());
    }
    let factor =
        faer::MatRef::from_column_major_slice(m.as_slice(), m.nrows(), m.ncols()).llt(faer::Side::Lower).ok()?;
    let l = factor.L();
    Some(DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| if i <= j { l[(j, i)] } else { 0.0 }))
}

struct Linearised<'a> {
    scaled: &'a [Scaled],
    system: LeastSquares,
    dual_residual: &'a DVector<f64>,
}

impl Linearised<'_> {
    /// The step for which `Λ∘(dS + dX) = T` in scaled coordinates, T given by block.
    fn direction(&self, targets: &[DMatrix<f64>]) -> (Direction, bool) {
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
        let (dz, is_exact) = self.system.solve(&wanted, self.dual_residual);
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
        (Direction { dz, ds, dx }, is_exact)
    }
}

/// Steps of the unknowns and of the duals.
type Step = (DVector<f64>, Vec<DMatrix<f64>>);

/// One predictor-corrector step; `None` where rounding allows none.
pub(super) fn advance(
    problem: &Problem,
    z: &DVector<f64>,
    s: &[Factor],
    duals: &[DMatrix<f64>],
    dual_residual: &DVector<f64>,
    mu: f64,
    ctl: &Ctl,
) -> Result<Option<Step>, Stopped> {
    let blocks = &problem.blocks;
    let scaled: Option<Vec<Scaled>> =
        s.iter().zip(duals).map(|(s, x)| Scaled::new(s, &x.clone().cholesky()?)).collect();
    let Some(scaled) = scaled else { return Ok(None) };
    let terms = scaled_terms(blocks, &scaled, z.len(), ctl)?;
    ctl.check()?;
    let quadratic = problem.quadratic.as_ref();
    let targets: Vec<DMatrix<f64>> = scaled.iter().map(|b| DMatrix::from_diagonal(&b.lambda.map(|l| -l * l))).collect();
    let mut linearised = None;
    if let Some(r) = LeastSquares::quick(&terms, quadratic) {
        let system = LeastSquares { r, terms: terms.clone(), quadratic: quadratic.cloned() };
        let tried = Linearised { scaled: &scaled, system, dual_residual };
        let (predictor, is_exact) = tried.direction(&targets);
        linearised = is_exact.then_some((tried, predictor));
    }
    let (mut linearised, predictor) = match linearised {
        Some(found) => found,
        None => {
            let Some(r) = LeastSquares::careful(&terms, quadratic, ctl)? else { return Ok(None) };
            let system = LeastSquares { r, terms, quadratic: quadratic.cloned() };
            let tried = Linearised { scaled: &scaled, system, dual_residual };
            let (predictor, _) = tried.direction(&targets);
            (tried, predictor)
        }
    };
    ctl.check()?;
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
    let (mut step, is_exact) = linearised.direction(&targets);
    if !is_exact && let Some(r) = LeastSquares::careful(&linearised.system.terms, quadratic, ctl)? {
        linearised.system.r = r;
        (step, _) = linearised.direction(&targets);
    }
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
            return Ok(moves.then_some((next_z, next)));
        }
        if !primal_fits || joint {
            primal *= 0.7;
        }
        if !dual_fits || joint {
            dual *= 0.7;
        }
    }
    Ok(None)
}
