//! Blocks in the coordinates of Nesterov and Todd, and what every step computes in them.

use super::{Block, Problem};
use crate::convex::svec;
use crate::ctl::{Ctl, Stopped};
use crate::num::linalg::{svd, symmetric};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, SymmetricTridiagonal};

/// From so many operations on a product goes to faer's kernel instead of nalgebra's.
const LARGE_PRODUCT: usize = 40_000;

/// Up to this size rotations are quicker than a blocked decomposition: near the central path few are needed.
const JACOBI: usize = 12;

/// Halvings of an interval around an eigenvalue at most.
const HALVINGS: usize = 60;

pub(super) type Factor = Cholesky<f64, Dyn>;

/// One block in the coordinates where S and X are the same diagonal matrix.
pub(super) struct Scaled {
    /// λ: `R⁻¹SR⁻ᵀ = RᵀXR = diag(λ)`.
    pub(super) lambda: DVector<f64>,
    /// R⁻¹.
    inverse: DMatrix<f64>,
}

impl Scaled {
    /// From the factors of S and X: with `L_xᵀL_s = UΛVᵀ`, `R = L_s V Λ^(−1/2)`.
    pub(super) fn new(s: &Factor, x: &Factor) -> Option<Self> {
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
    pub(super) fn dual(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        symmetric(&self.inverse.tr_mul(&(m * &self.inverse)))
    }

    /// The longest step that keeps `Λ + step·M` semidefinite, to a thousandth and never longer.
    pub(super) fn longest(&self, m: &DMatrix<f64>) -> f64 {
        let d = self.lambda.len();
        let scaled =
            DMatrix::from_fn(d, d, |i, j| 0.5 * (m[(i, j)] + m[(j, i)]) / (self.lambda[i] * self.lambda[j]).sqrt());
        least_eigenvalue(scaled).map_or(f64::INFINITY, |least| -1.0 / least)
    }
}

/// The least eigenvalue of a symmetric matrix where that is negative: a bound from below that is a thousandth off.
/// Steps are shortened by more than that, and a count of signs in the tridiagonal form costs next to nothing.
fn least_eigenvalue(m: DMatrix<f64>) -> Option<f64> {
    let (diagonal, squares) = if m.nrows() == 1 {
        (DVector::from_element(1, m[(0, 0)]), DVector::zeros(0))
    } else {
        let (diagonal, off) = SymmetricTridiagonal::new(m).unpack_tridiagonal();
        (diagonal, off.map(|v| v * v))
    };
    // Sylvester: as many negative pivots as eigenvalues below x.
    let is_below = |x: f64| {
        let mut pivot = f64::INFINITY;
        (0..diagonal.len()).any(|i| {
            let taken = if i == 0 || squares[i - 1] == 0.0 { 0.0 } else { squares[i - 1] / pivot };
            pivot = diagonal[i] - x - taken;
            pivot < 0.0
        })
    };
    if !is_below(0.0) {
        return None;
    }
    let reach = |i: usize| {
        let (left, right) =
            (if i == 0 { 0.0 } else { squares[i - 1].sqrt() }, squares.get(i).map_or(0.0, |v| v.sqrt()));
        diagonal[i] - left - right
    };
    let mut low = (0..diagonal.len()).map(reach).fold(0.0, f64::min) * (1.0 + 1e-12);
    let mut high = diagonal.min().min(0.0);
    for _ in 0..HALVINGS {
        if high - low <= -1e-3 * high {
            break;
        }
        let middle = 0.5 * (low + high);
        if is_below(middle) { high = middle } else { low = middle }
    }
    Some(low)
}

/// Singular values and right singular vectors, by one-sided Jacobi rotations: small values come out with high relative
/// accuracy, and small matrices without a call into a blocked decomposition.
fn right_singular(a: &DMatrix<f64>) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let d = a.nrows();
    if d > JACOBI {
        let (_, values, v) = svd(a).ok()?;
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
pub(super) fn product(a: &DMatrix<f64>, b: &DMatrix<f64>, transpose: bool) -> DMatrix<f64> {
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
pub(super) fn scaled_terms(
    blocks: &[Block],
    scaled: &[Scaled],
    unknowns: usize,
    ctl: &Ctl,
) -> Result<DMatrix<f64>, Stopped> {
    let rows: usize = blocks.iter().map(|block| svec::length(block.size())).sum();
    let mut all = DMatrix::zeros(rows, unknowns);
    let mut offset = 0;
    for (block, scaled) in blocks.iter().zip(scaled) {
        let d = block.size();
        ctl.check()?;
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
        ctl.check()?;
        let full = product(&scaled.inverse, &half, false);
        let length = svec::length(d);
        for i in 0..unknowns {
            let from = &full.as_slice()[i * d * d..(i + 1) * d * d];
            svec::write(from, d, &mut all.as_mut_slice()[i * rows + offset..i * rows + offset + length]);
        }
        offset += length;
    }
    Ok(all)
}

/// The μ with which `X = μS⁻¹` comes nearest to dual feasibility, in the metric of the barrier's Hessian (which knows
/// no units); large enough that what is missing is no larger than the barrier's own gradient.
pub(super) fn starting_mu(
    problem: &Problem,
    s: &[Factor],
    inverses: &[DMatrix<f64>],
    gradient: &DVector<f64>,
    ctl: &Ctl,
) -> Result<f64, Stopped> {
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
    let terms = local.map(|local| scaled_terms(&problem.blocks, &local, unknowns, ctl)).transpose()?;
    let metric = terms.and_then(|terms| factor_normal(&product(&terms, &terms, true)));
    let solved = metric.map(|factor| (factor.solve(gradient), factor.solve(&barrier)));
    let mu = solved.map_or(1.0, |(g, b)| {
        let fitted = barrier.dot(&g) / barrier.dot(&b);
        let least = gradient.dot(&g).max(0.0).sqrt();
        if fitted.is_finite() { fitted.max(least) } else { least }
    });
    Ok(if mu.is_normal() { mu } else { 1.0 })
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

#[cfg(test)]
mod tests {
    use super::least_eigenvalue;
    use crate::num::rng;
    use nalgebra::DMatrix;
    use rand::RngExt;

    #[test]
    fn the_least_eigenvalue_is_bounded_from_below_within_a_thousandth() {
        let mut stream = rng::stream(20_261_130, "least eigenvalue");
        let mut negative = 0;
        for _ in 0..300 {
            let d = stream.random_range(1..=12usize);
            let m = DMatrix::from_fn(d, d, |_, _| stream.random_range(-1.0..1.0));
            let m = (&m + m.transpose()) + DMatrix::identity(d, d) * stream.random_range(-1.0..3.0);
            let truth = m.symmetric_eigenvalues().min();
            match least_eigenvalue(m.clone()) {
                Some(found) => {
                    negative += 1;
                    assert!(found <= truth * (1.0 - 1e-12) && found >= truth * 1.0011, "{found} {truth} {m}");
                }
                None => assert!(truth >= -1e-12, "{truth} {m}"),
            }
        }
        assert!((50..290).contains(&negative), "{negative}");
    }

    #[test]
    fn blocks_that_do_not_meet_are_counted_one_by_one() {
        let m = DMatrix::from_row_slice(3, 3, &[0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, -0.5]);
        let found = least_eigenvalue(m).unwrap();
        assert!((found / -0.5 - 1.0).abs() <= 1.1e-3, "{found}");
    }
}
