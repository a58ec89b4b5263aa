//! The subspace of weights that satisfy the equalities.

use super::gains::Gains;
use super::rounding::Rounding;
use super::structure::Structure;
use crate::control::lyapunov::{Clock, LinearEquationError, Lyapunov};
use crate::convex::svec::{length, smat, svec};
use crate::ctl::{Ctl, Stopped};
use crate::num::linalg::{self, NoConvergence, symmetric};
use crate::num::rng;
use nalgebra::{DMatrix, DVector};
use rand::RngExt;

/// Singular values of the equalities below this share of the largest are rounding.
const NULL: f64 = 1e-13;
/// The same for the equalities of a structure.
const STRUCTURE_NULL: f64 = 1e-12;
/// States up to which the rounding of a structure's equalities is measured.
const PERTURBED: usize = 32;
/// Draws of data for that.
const DRAWS: usize = 3;
/// How much more than the draws show counts as rounding.
const NOISE: f64 = 4.0;
/// From so many columns on an orthonormal basis comes from faer.
const LARGE: usize = 40;
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
    /// The subspace of a gain of u = −Kx, given as A, B and K.
    pub(super) fn new([a, b, k]: [&DMatrix<f64>; 3], clock: Clock) -> Result<Self, NoConvergence> {
        let m = b.ncols();
        let scale = natural_scale(a, b, k, clock);
        let (b, k) = (b * scale, k / scale);
        let pairs = equality_solutions(a, &b, &k, clock)?;
        let weights = pairs.into_iter().map(|(p, r)| (state_weight(a, &b, &k, &p, &r, clock), r)).collect::<Vec<_>>();
        Self::spanned(scale, &weights, [a.nrows(), m], None)
    }

    /// The same in the units of the plant, by balanced ones where inputs reach every state: there rounding does the
    /// least harm.
    pub(super) fn of(gains: &Gains) -> Result<Self, NoConvergence> {
        let Some((balanced, core)) = gains.reach.whole() else {
            return Self::new([&gains.a, &gains.b, &gains.k], gains.clock);
        };
        let mut space = Self::new([&core.a, &core.b, &core.k], gains.clock)?;
        for (q, r) in space.q.iter_mut().zip(&mut space.r) {
            (*q, *r) = (balanced.state_weight(q), balanced.input_weight(r));
        }
        // Orthonormal again, in the units and on the scale of the plant.
        let scale = natural_scale(&gains.a, &gains.b, &gains.k, gains.clock);
        let ratio = (space.scale / scale).powi(2);
        let pairs: Vec<Pair> = space.q.into_iter().zip(space.r).map(|(q, r)| (q * ratio, r)).collect();
        Self::spanned(scale, &pairs, [gains.states(), gains.ports()], None)
    }

    /// Of independent pairs (Q/s², R).
    fn spanned(
        scale: f64,
        pairs: &[Pair],
        [n, m]: [usize; 2],
        support: Option<Vec<usize>>,
    ) -> Result<Self, NoConvergence> {
        let (nq, nr) = (length(n), length(m));
        let mut columns = DMatrix::zeros(nq + nr, pairs.len());
        for (mut column, (q, r)) in columns.column_iter_mut().zip(pairs) {
            column.rows_mut(0, nq).copy_from(&svec(q));
            column.rows_mut(nq, nr).copy_from(&svec(r));
            let norm = column.norm();
            if norm > 0.0 {
                column /= norm;
            }
        }
        let basis = orthonormal(&columns)?;
        let matrices = |offset: usize, rows: usize, order: usize| {
            basis.column_iter().map(|c| smat(c.rows(offset, rows).clone_owned().as_slice(), order)).collect()
        };
        Ok(Self { scale, q: matrices(0, nq, n), r: matrices(nq, nr, m), support })
    }

    /// The subspace within a structure, with how far the rounding of the data may move a unit vector of it; empty where
    /// no weights of the structure satisfy the equalities for any data within the rounding.
    ///
    /// The unknowns are the structure's own: P follows from Q and R by the closed loop, and `BᵀP = RK` is left.
    pub(super) fn within(gains: &Gains, structure: &Structure, ctl: &Ctl) -> Result<(Self, f64), SpaceError> {
        let (n, m) = (gains.states(), gains.ports());
        let scale = natural_scale(&gains.a, &gains.b, &gains.k, gains.clock);
        let directions = structure.directions(n, m);
        let (_, values, v) = linalg::svd(&misfits(gains, &directions, scale, None, ctl)?)?;
        let at = |values: &[f64], i: usize| values.get(i).copied().unwrap_or(0.0);
        let mut noise = 0.0_f64;
        if n <= PERTURBED {
            // How far the singular values move under data somewhere in the box.
            let mut stream = rng::stream(1, "structure");
            for _ in 0..DRAWS {
                let (_, moved, _) = linalg::svd(&misfits(gains, &directions, scale, Some(&mut stream), ctl)?)?;
                let count = directions.len();
                noise = (0..count).map(|i| (at(&values, i) - at(&moved, i)).abs()).fold(noise, f64::max);
            }
        }
        let threshold = (NOISE * noise).max(STRUCTURE_NULL * at(&values, 0));
        let rank = (0..directions.len()).filter(|i| at(&values, *i) > threshold).count();
        let gap = if rank > 0 { values[rank - 1] } else { f64::INFINITY };
        let pairs: Vec<Pair> = (rank..directions.len())
            .map(|column| {
                let mut sum = (DMatrix::zeros(n, n), DMatrix::zeros(m, m));
                for ((q, r), factor) in directions.iter().zip(v.column(column).iter()) {
                    sum.0 += q * *factor;
                    sum.1 += r * *factor;
                }
                sum
            })
            .collect();
        let space = Self::spanned(scale, &pairs, [n, m], structure.support())?;
        Ok((space, NOISE * noise / gap))
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

    /// The reverse: a matrix of the states that are weighed among all, with zeros.
    pub(super) fn among_states(&self, weighed: &DMatrix<f64>) -> DMatrix<f64> {
        let Some(kept) = &self.support else { return weighed.clone() };
        let n = self.q.first().map_or(0, DMatrix::nrows);
        let mut all = DMatrix::zeros(n, n);
        for (i, row) in kept.iter().enumerate() {
            for (j, column) in kept.iter().enumerate() {
                all[(*row, *column)] = weighed[(i, j)];
            }
        }
        all
    }

    /// The Q_i in these rows and columns.
    pub(super) fn weighed_terms(&self) -> Vec<DMatrix<f64>> {
        self.q.iter().map(|q| self.weighed(q)).collect()
    }

    /// The coordinates of weights (Q/s², R) that lie in the space.
    pub(super) fn coordinates(&self, q: &DMatrix<f64>, r: &DMatrix<f64>) -> DVector<f64> {
        DVector::from_fn(self.len(), |i, _| self.q[i].dot(q) + self.r[i].dot(r))
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
fn natural_scale(a: &DMatrix<f64>, b: &DMatrix<f64>, k: &DMatrix<f64>, clock: Clock) -> f64 {
    let (a, b, k) = (a.norm(), b.norm(), k.norm());
    let plant = match clock {
        Clock::Continuous => a,
        Clock::Sampled => 1.0,
    };
    let square = k * k + plant * k / b;
    if square > 0.0 { square.sqrt() } else { 1.0 }
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
    clock: Clock,
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
    let closed = match clock {
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
    let null = null_space(&equations)?;
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

/// The columns `vec(BᵀPM − RK)` of the directions (s²Q, R), each entry over the size of what K's rounding makes of it;
/// for data drawn from the box where a stream is given.
fn misfits(
    gains: &Gains,
    directions: &[Pair],
    scale: f64,
    stream: Option<&mut rng::Stream>,
    ctl: &Ctl,
) -> Result<DMatrix<f64>, SpaceError> {
    let bounds = Rounding::around(&gains.a, &gains.b, &gains.k, None);
    let (mut a, mut b, mut k) = (gains.a.clone(), gains.b.clone(), gains.k.clone());
    if let Some(stream) = stream {
        let given = gains.reach.gain_box();
        for (m, bound) in [(&mut a, &bounds.a), (&mut b, &bounds.b), (&mut k, given.as_ref().unwrap_or(&bounds.k))] {
            m.zip_apply(bound, |v, bound| *v += bound * stream.random_range(-1.0..1.0));
        }
    }
    let closed = &a - &b * &k;
    let equation = Lyapunov::new(&closed, gains.clock)?;
    let s2 = scale * scale;
    let unit = bounds.k.map(|v| if v > 0.0 { v.recip() } else { 0.0 });
    let unit = &unit / unit.amax().max(f64::MIN_POSITIVE);
    let mut columns = DMatrix::zeros(k.len(), directions.len());
    for (mut column, (q, r)) in columns.column_iter_mut().zip(directions) {
        ctl.check()?;
        let p = equation.solve(&(q * s2 + k.tr_mul(&(r * &k))));
        let bp = match gains.clock {
            Clock::Continuous => b.tr_mul(&p),
            Clock::Sampled => b.tr_mul(&(p * &closed)),
        };
        column.copy_from_slice((bp - r * &k).component_mul(&unit).as_slice());
    }
    Ok(columns)
}

/// Why there is no subspace.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum SpaceError {
    #[error(transparent)]
    Stopped(#[from] Stopped),
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
    #[error(transparent)]
    Linear(#[from] LinearEquationError),
}

/// An orthonormal basis of the null space.
fn null_space(m: &DMatrix<f64>) -> Result<DMatrix<f64>, NoConvergence> {
    let (_, values, v) = linalg::svd(m)?;
    let largest = values.first().copied().unwrap_or(0.0);
    let rank = values.iter().filter(|v| **v > NULL * largest).count();
    Ok(v.columns(rank, m.ncols() - rank).into_owned())
}

/// An orthonormal basis of the column space.
fn orthonormal(m: &DMatrix<f64>) -> Result<DMatrix<f64>, NoConvergence> {
    if m.ncols() == 0 {
        return Ok(m.clone());
    }
    // The columns are independent since the closed loop is stable: Q + KᵀRK = 0 only for P = 0.
    if m.ncols() < LARGE {
        return Ok(m.clone().qr().q());
    }
    let q = faer::MatRef::from_column_major_slice(m.as_slice(), m.nrows(), m.ncols()).qr().compute_thin_Q();
    Ok(DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| q[(i, j)]))
}
