//! The subspace of weights that satisfy the equalities.

use super::gains::Gains;
use super::structure::Structure;
use crate::control::lyapunov::Clock;
use crate::convex::svec::{length, smat, svec};
use crate::num::linalg::{self, NoConvergence, symmetric};
use nalgebra::{DMatrix, DVector};

/// Singular values of the equalities below this share of the largest are rounding.
const NULL: f64 = 1e-13;
/// The same for the equalities of a structure, which a gain with rounded entries satisfies only so far.
const STRUCTURE_NULL: f64 = 1e-9;
/// Sweeps that make rows and columns of the equalities equally long.
const SWEEPS: usize = 4;

/// P and R.
type Pair = (DMatrix<f64>, DMatrix<f64>);

/// Weights `Q = s² Σ z_i Q_i`, `R = Σ z_i R_i` with `BᵀP = RK` for some symmetric P.
///
/// The pairs (Q_i, R_i) are orthonormal, so that `‖z‖² = ‖Q/s²‖² + ‖R‖²`. In units with B' = sB, K' = K/s the numbers
/// of a stiff loop become of one size; without them solvers report gains as infeasible that are optimal by
/// construction.
#[derive(Debug, Clone)]
pub(super) struct Space {
    /// s.
    pub scale: f64,
    /// Q_i.
    pub q: Vec<DMatrix<f64>>,
    /// R_i.
    pub r: Vec<DMatrix<f64>>,
    /// The states that the structure lets Q weigh, where it forbids some: Q is zero elsewhere, and its sign is asked of
    /// these alone.
    support: Option<Vec<usize>>,
}

impl Space {
    /// The subspace of a gain, within a structure; empty where the structure leaves nothing.
    pub(super) fn new(gains: &Gains, structure: &Structure) -> Result<Self, NoConvergence> {
        let (n, m) = (gains.states(), gains.ports());
        let scale = natural_scale(gains);
        let (a, b, k) = (&gains.a, &gains.b * scale, &gains.k / scale);
        let pairs = equality_solutions(a, &b, &k, gains)?;
        let (nq, nr) = (length(n), length(m));
        let mut columns = DMatrix::zeros(nq + nr, pairs.len());
        for (j, (p, r)) in pairs.iter().enumerate() {
            let q = state_weight(a, &b, &k, p, r, gains.clock);
            let mut column = columns.column_mut(j);
            column.rows_mut(0, nq).copy_from(&svec(&q));
            column.rows_mut(nq, nr).copy_from(&svec(r));
            let norm = column.norm();
            if norm > 0.0 {
                column /= norm;
            }
        }
        let mut basis = orthonormal(&columns)?;
        let forbidden = structure.forbidden(n, m);
        if !forbidden.is_empty() && basis.ncols() > 0 {
            let mut rows = DMatrix::zeros(forbidden.len(), nq + nr);
            for (i, (q, r)) in forbidden.iter().enumerate() {
                rows.view_mut((i, 0), (1, nq)).copy_from(&svec(q).transpose());
                rows.view_mut((i, nq), (1, nr)).copy_from(&svec(r).transpose());
            }
            basis = &basis * null_space(&(rows * &basis), Some(1.0), STRUCTURE_NULL)?;
        }
        let matrices = |offset: usize, rows: usize, order: usize| {
            basis.column_iter().map(|c| smat(c.rows(offset, rows).clone_owned().as_slice(), order)).collect()
        };
        Ok(Self { scale, q: matrices(0, nq, n), r: matrices(nq, nr, m), support: structure.support() })
    }

    /// The subspace of gains in the states `x' = D⁻¹x` as one of the gains in x: `Q = D⁻¹Q'D⁻¹`. The pairs are then
    /// orthonormal in x' alone.
    pub(super) fn in_states(mut self, d: &DVector<f64>) -> Self {
        for q in &mut self.q {
            *q = DMatrix::from_fn(q.nrows(), q.ncols(), |i, j| q[(i, j)] / (d[i] * d[j]));
        }
        self
    }

    /// The number of unknowns.
    pub(super) fn len(&self) -> usize {
        self.q.len()
    }

    /// The states that Q may weigh, in order.
    pub(super) fn weighed_states(&self) -> Vec<usize> {
        self.support.clone().unwrap_or_else(|| (0..self.q.first().map_or(0, DMatrix::nrows)).collect())
    }

    /// The rows and columns of Q that the structure lets be other than zero.
    pub(super) fn weighed(&self, q: &DMatrix<f64>) -> DMatrix<f64> {
        self.support.as_ref().map_or_else(|| q.clone(), |kept| q.select_rows(kept).select_columns(kept))
    }

    /// The Q_i in these rows and columns.
    pub(super) fn weighed_terms(&self) -> Vec<DMatrix<f64>> {
        self.q.iter().map(|q| self.weighed(q)).collect()
    }

    /// Q/s² and R at a point.
    pub(super) fn at(&self, z: &DVector<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
        let sum = |terms: &[DMatrix<f64>]| {
            let mut total = DMatrix::zeros(terms[0].nrows(), terms[0].ncols());
            for (term, factor) in terms.iter().zip(z.iter()) {
                total += term * *factor;
            }
            total
        };
        (sum(&self.q), sum(&self.r))
    }
}

/// s, with s² the size of Q where R is of size 1: `BᵀP = RK` makes P of size ‖K‖/‖B‖, and Q is then of size `‖K‖² +
/// ‖A‖‖K‖/‖B‖` (`‖K‖² + ‖K‖/‖B‖` in sampled time).
///
/// For a gain that is large for its plant this is ‖K‖_F. For a feeble one, of a control so expensive that `K ≈ R⁻¹BᵀP`
/// with P that of the uncontrolled plant, ‖K‖_F alone would be too small by orders of magnitude, and the digits of R
/// would be lost in those of Q.
fn natural_scale(gains: &Gains) -> f64 {
    let (a, b, k) = (gains.a.norm(), gains.b.norm(), gains.k.norm());
    let plant = match gains.clock {
        Clock::Continuous => a,
        Clock::Sampled => 1.0,
    };
    (k * k + plant * k / b).sqrt()
}

/// `Q = −(A − BK)ᵀP − P(A − BK) − KᵀRK`, in sampled time `P − (A − BK)ᵀP(A − BK) − KᵀRK`.
///
/// The same as `KᵀRK − AᵀP − PA` (`P − AᵀPA + Kᵀ(BᵀPB + R)K`) where `BᵀP = RK`, and without the cancellation of large
/// terms in a loop that the gain dominates.
pub(super) fn state_weight(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    k: &DMatrix<f64>,
    p: &DMatrix<f64>,
    r: &DMatrix<f64>,
    clock: Clock,
) -> DMatrix<f64> {
    let closed = a - b * k;
    let input = k.tr_mul(&(r * k));
    match clock {
        Clock::Continuous => {
            let pc = p * &closed;
            symmetric(&(-&pc - pc.transpose() - input))
        }
        Clock::Sampled => symmetric(&(p - closed.tr_mul(&(p * &closed)) - input)),
    }
}

/// A basis of the (P, R) with `BᵀPM = RK`, where M = I, in sampled time M = A − BK.
///
/// In the coordinates of `B = U [Σ; 0] Vᵀ` the block of P that B does not touch is free, and the equalities bind the
/// others: `Σ [P₁₁ P₁₂] UᵀMU = VᵀRKU`, with as many rows as K has entries.
fn equality_solutions(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    k: &DMatrix<f64>,
    gains: &Gains,
) -> Result<Vec<Pair>, NoConvergence> {
    let (n, m) = (a.nrows(), b.ncols());
    // The factor on the right comes out square; both are needed so.
    let (u, sigma, v) = if m > n {
        linalg::svd(b)?
    } else {
        let (v, sigma, u) = linalg::svd(&b.transpose())?;
        (u, sigma, v)
    };
    let rank = sigma.iter().filter(|s| **s > NULL * sigma[0]).count();
    let u = &u;
    let closed = match gains.clock {
        Clock::Continuous => DMatrix::identity(n, n),
        Clock::Sampled => u.tr_mul(&((a - b * k) * u)),
    };
    let ku = k * u;
    // Unknowns: P₁₁ (upper triangle), P₁₂ (by columns), R (upper triangle).
    let (n11, n12) = (length(rank), rank * (n - rank));
    let unknowns = n11 + n12 + length(m);
    let mut equations = DMatrix::zeros(n * m, unknowns);
    let mut put = |column: usize, left: &dyn Fn(usize, usize) -> f64| {
        for j in 0..n {
            for i in 0..m {
                equations[(i + j * m, column)] = left(i, j);
            }
        }
    };
    let mut column = 0;
    for q in 0..n {
        for p in 0..rank.min(q + 1) {
            // The unknown in rows p and q of P, of which only the first `rank` rows enter.
            put(column, &|i, j| {
                let first = if i == p { sigma[p] * closed[(q, j)] } else { 0.0 };
                let second = if i == q && q < rank && p != q { sigma[q] * closed[(p, j)] } else { 0.0 };
                first + second
            });
            column += 1;
        }
    }
    for q in 0..m {
        for p in 0..=q {
            put(column, &|i, j| {
                let first = v[(p, i)] * ku[(q, j)];
                let second = if p == q { 0.0 } else { v[(q, i)] * ku[(p, j)] };
                -(first + second)
            });
            column += 1;
        }
    }
    let column_scale = equilibrate(&mut equations);
    let null = null_space(&equations, None, NULL)?;
    let mut pairs = Vec::with_capacity(null.ncols() + length(n - rank));
    let back = |inner: &DMatrix<f64>| symmetric(&(u * inner * u.transpose()));
    for v in null.column_iter() {
        let mut at = 0;
        let mut next = || {
            let value = v[at] * column_scale[at];
            at += 1;
            value
        };
        let mut p = DMatrix::zeros(n, n);
        for j in 0..n {
            for i in 0..rank.min(j + 1) {
                let value = next();
                p[(i, j)] = value;
                p[(j, i)] = value;
            }
        }
        let mut r = DMatrix::zeros(m, m);
        for j in 0..m {
            for i in 0..=j {
                let value = next();
                r[(i, j)] = value;
                r[(j, i)] = value;
            }
        }
        pairs.push((back(&p), r));
    }
    for j in rank..n {
        for i in rank..=j {
            let mut p = DMatrix::zeros(n, n);
            p[(i, j)] = 1.0;
            p[(j, i)] = 1.0;
            pairs.push((back(&p), DMatrix::zeros(m, m)));
        }
    }
    Ok(pairs)
}

/// Scales rows and columns to one length; returns the factors of the columns.
fn equilibrate(equations: &mut DMatrix<f64>) -> DVector<f64> {
    let mut scale = DVector::from_element(equations.ncols(), 1.0);
    for _ in 0..SWEEPS {
        for mut row in equations.row_iter_mut() {
            let norm = row.amax();
            if norm > 0.0 {
                row /= norm;
            }
        }
        for (j, mut column) in equations.column_iter_mut().enumerate() {
            let norm = column.norm();
            if norm > 0.0 {
                column /= norm;
                scale[j] /= norm;
            }
        }
    }
    scale
}

/// An orthonormal basis of the null space; singular values below `tolerance` times the largest (or `size`) count as
/// zero.
fn null_space(m: &DMatrix<f64>, size: Option<f64>, tolerance: f64) -> Result<DMatrix<f64>, NoConvergence> {
    let (_, values, v) = linalg::svd(m)?;
    let largest = size.unwrap_or_else(|| values.first().copied().unwrap_or(0.0));
    let rank = values.iter().filter(|v| **v > tolerance * largest).count();
    Ok(v.columns(rank, m.ncols() - rank).into_owned())
}

/// An orthonormal basis of the column space.
fn orthonormal(m: &DMatrix<f64>) -> Result<DMatrix<f64>, NoConvergence> {
    if m.ncols() == 0 {
        return Ok(m.clone());
    }
    // The columns are independent since the closed loop is stable: Q + KᵀRK = 0 only for P = 0.
    let qr = m.clone().qr();
    Ok(qr.q())
}
