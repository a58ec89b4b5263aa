//! What inputs reach: the controllable block, modes that decay by themselves, and set points.
//!
//! In orthogonal coordinates `A = [A₁ A₁₂; 0 A_u]`, `B = [B₁; 0]`, `K = [K_c K_u]` (Rosenbrock's staircase; Van Dooren,
//! IEEE Trans. Automat. Contr. 26, 111–129, 1981). A cost on all states exists if and only if one on the controllable
//! block does: the weight on what decays by itself may be as large as wanted, and K_u follows. Modes that do not decay
//! are targets or references. With `V = [X; W]`, W their invariant subspace under A_u with `A_uW = WA_n`, and
//! `(A₁ − B₁K_c)X + (A₁₂ − B₁K_u)W = XA_n`, V is the set point that the loop steers to. Where KV = 0 holding it costs
//! nothing, and the cost is one on `e = x_c − Xη` alone.

use super::balance::Balanced;
use super::rounding::stability::{Pole, poles};
use super::rounding::{PLANT, UNIT};
use crate::control::lyapunov::{Clock, sylvester};
use crate::num::linalg::{self, NoConvergence, symmetric};
use crate::num::schur::ComplexSchur;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

/// Singular values below this many units of rounding of A (of B in the first step) are zero.
const RANK: f64 = 2.0 * PLANT;
/// A set point whose holding costs less than this multiple of its rounding is held for nothing.
const HELD: f64 = 4.0;

/// The staircase of balanced matrices.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Staircase {
    /// The coordinates, n×n and orthogonal; the identity where everything is reached.
    pub basis: DMatrix<f64>,
    /// The number of states that inputs reach.
    pub reached: usize,
    /// `UᵀAU`.
    pub a: DMatrix<f64>,
    /// `UᵀB`.
    pub b: DMatrix<f64>,
    /// `KU`.
    pub k: DMatrix<f64>,
}

/// Rows of M from the left singular vectors of its leading ones on, and their number.
fn range(m: &DMatrix<f64>, tolerance: f64) -> Result<(DMatrix<f64>, usize), NoConvergence> {
    if m.nrows() == 0 {
        return Ok((DMatrix::zeros(0, 0), 0));
    }
    let (_, values, left) = linalg::svd(&m.transpose())?;
    Ok((left, values.iter().filter(|v| **v > tolerance).count()))
}

impl Staircase {
    pub(super) fn new(of: &Balanced) -> Result<Self, NoConvergence> {
        let n = of.a.nrows();
        let (mut a, mut b) = (of.a.clone(), of.b.clone());
        let mut basis = DMatrix::<f64>::identity(n, n);
        let tolerance = |m: &DMatrix<f64>| RANK * UNIT * m.norm();
        let (mut reached, mut step) = (0, 0);
        while reached < n {
            let part =
                if step == 0 { b.clone() } else { a.view((reached, reached - step), (n - reached, step)).into() };
            let (turn, rank) = range(&part, tolerance(if step == 0 { &of.b } else { &of.a }))?;
            if rank == 0 {
                break;
            }
            let mut whole = DMatrix::identity(n, n);
            whole.view_mut((reached, reached), (n - reached, n - reached)).copy_from(&turn);
            a = whole.tr_mul(&a) * &whole;
            b = whole.tr_mul(&b);
            basis *= whole;
            (reached, step) = (reached + rank, rank);
        }
        if reached == n {
            // As it was written, to the last digit.
            let basis = DMatrix::identity(n, n);
            return Ok(Self { basis, reached, a: of.a.clone(), b: of.b.clone(), k: of.k.clone() });
        }
        // What rounding left below the staircase is zero.
        a.view_mut((reached, 0), (n - reached, reached)).fill(0.0);
        b.rows_mut(reached, n - reached).fill(0.0);
        let k = &of.k * &basis;
        Ok(Self { basis, reached, a, b, k })
    }

    /// A₁, B₁, K_c.
    pub(super) fn controllable(&self) -> [DMatrix<f64>; 3] {
        let (r, m) = (self.reached, self.b.ncols());
        [
            self.a.view((0, 0), (r, r)).into_owned(),
            self.b.rows(0, r).into_owned(),
            self.k.view((0, 0), (m, r)).into_owned(),
        ]
    }

    /// The eigenvalues of A_u, with how far rounding may move them.
    pub(super) fn unreached(&self) -> Result<Vec<Pole>, NoConvergence> {
        let (n, r) = (self.a.nrows(), self.reached);
        let part = self.a.view((r, r), (n - r, n - r)).into_owned();
        if n == r {
            return Ok(Vec::new());
        }
        let floor = self.a.norm() / n as f64;
        poles(&part, &part.map(|v| PLANT * UNIT * v.abs().max(floor)))
    }

    /// The set points of the modes that do not decay; none where all do.
    pub(super) fn set_points(&self, clock: Clock, rounding: &DMatrix<f64>) -> Result<Option<SetPoints>, NoConvergence> {
        let is_lasting = |pole: &Pole| clock.margin(pole.value) <= pole.shift.min(LASTING);
        let lasting: Vec<Pole> = self.unreached()?.into_iter().filter(is_lasting).collect();
        if lasting.is_empty() {
            return Ok(None);
        }
        let (n, r, count) = (self.a.nrows(), self.reached, lasting.len());
        let [a, b, k] = self.controllable();
        let rest = n - r;
        let inner = self.a.view((r, r), (rest, rest)).into_owned();
        let modes: Vec<Complex64> = lasting.iter().map(|pole| pole.value).collect();
        let whole = invariant_subspace(&inner, &modes)?;
        let (w, other) = (whole.columns(0, count).into_owned(), whole.columns(count, rest - count).into_owned());
        let moved = w.tr_mul(&(&inner * &w));
        let (coupling, k_u) = (self.a.view((0, r), (r, rest)).into_owned(), self.k.columns(r, rest).into_owned());
        let closed = &a - &b * &k;
        let driven = &coupling - &b * &k_u;
        let Ok(x) = sylvester(&closed, &-&moved, &-(&driven * &w)) else {
            return Err(NoConvergence { rows: r, columns: count });
        };
        let held = &k * &x + &k_u * &w;
        // How far KV may move: through K itself, and through X by the inverse of the Sylvester operator.
        let probe = DMatrix::from_fn(r, count, |i, j| if (i + 2 * j) % 3 == 0 { -1.0 } else { 1.0 });
        let inverse = sylvester(&closed, &-&moved, &probe).map_or(f64::INFINITY, |s| s.norm() / probe.norm());
        let direct = (rounding.columns(0, r) * x.abs() + rounding.columns(r, rest) * w.abs()).norm();
        let size = closed.norm() + b.norm() * k_u.norm() + self.a.norm();
        let through = k.norm() * inverse * PLANT * UNIT * size * (x.norm() + w.norm());
        Ok(Some(SetPoints {
            modes,
            states: x.clone(),
            unreached: w.clone(),
            cost: held.norm(),
            is_held: held.norm() <= HELD * (direct + through),
            lift: Lift { x, w, other },
        }))
    }
}

/// An eigenvalue nearer to the boundary of stability than this does not decay, whatever its own uncertainty.
const LASTING: f64 = 1e-7;

/// Modes that no input reaches and that do not decay, and the states that the loop holds against them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SetPoints {
    pub modes: Vec<Complex64>,
    /// X, in the coordinates of the staircase.
    pub states: DMatrix<f64>,
    /// W.
    pub unreached: DMatrix<f64>,
    /// ‖KV‖.
    pub cost: f64,
    /// Whether KV = 0 to rounding.
    pub is_held: bool,
    lift: Lift,
}

/// The coordinates `e = x_c − Xη` and what decays of the rest.
#[derive(Debug, Clone, PartialEq)]
struct Lift {
    x: DMatrix<f64>,
    w: DMatrix<f64>,
    /// An orthonormal complement of W.
    other: DMatrix<f64>,
}

/// The question that is left when set points are held: states e and what decays.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Errors {
    pub a: DMatrix<f64>,
    pub b: DMatrix<f64>,
    pub k: DMatrix<f64>,
    /// L with `(e, δ) = L x`, x in the coordinates of the staircase.
    pub map: DMatrix<f64>,
}

impl SetPoints {
    pub(super) fn errors(&self, of: &Staircase) -> Errors {
        let (n, r) = (of.a.nrows(), of.reached);
        let rest = n - r;
        let Lift { x, w, other } = &self.lift;
        let left = other.ncols();
        let [a1, b1, k1] = of.controllable();
        let inner = of.a.view((r, r), (rest, rest)).into_owned();
        let coupling = of.a.view((0, r), (r, rest)) * other - x * w.tr_mul(&(&inner * other));
        let size = r + left;
        let mut a = DMatrix::zeros(size, size);
        a.view_mut((0, 0), (r, r)).copy_from(&a1);
        a.view_mut((0, r), (r, left)).copy_from(&coupling);
        a.view_mut((r, r), (left, left)).copy_from(&other.tr_mul(&(&inner * other)));
        let mut b = DMatrix::zeros(size, b1.ncols());
        b.rows_mut(0, r).copy_from(&b1);
        let mut k = DMatrix::zeros(k1.nrows(), size);
        k.columns_mut(0, r).copy_from(&k1);
        k.columns_mut(r, left).copy_from(&(of.k.columns(r, rest) * other));
        let mut map = DMatrix::zeros(size, n);
        map.view_mut((0, 0), (r, r)).fill_with_identity();
        map.view_mut((0, r), (r, rest)).copy_from(&-(x * w.transpose()));
        map.view_mut((r, r), (left, rest)).copy_from(&other.transpose());
        Errors { a, b, k, map }
    }
}

/// A real orthonormal basis whose first columns span the invariant subspace of these eigenvalues.
fn invariant_subspace(m: &DMatrix<f64>, wanted: &[Complex64]) -> Result<DMatrix<f64>, NoConvergence> {
    let n = m.nrows();
    let count = wanted.len();
    if count == n {
        return Ok(DMatrix::identity(n, n));
    }
    let mut schur = ComplexSchur::new(m)?;
    let is_wanted = |v: Complex64| wanted.iter().any(|w| (w - v).norm() <= 1e-10 * (1.0 + v.norm()));
    for place in 0..count {
        let Some(from) = (place..n).find(|i| is_wanted(schur.t[(*i, *i)])) else { break };
        for i in (place..from).rev() {
            swap(&mut schur, i);
        }
    }
    // The span is that of its conjugate too: the projector is real.
    let leading = schur.u.columns(0, count);
    let projector = symmetric(&(leading * leading.adjoint()).map(|v| v.re));
    let eigen = projector.symmetric_eigen();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|i, j| eigen.eigenvalues[*j].total_cmp(&eigen.eigenvalues[*i]));
    Ok(eigen.eigenvectors.select_columns(&order))
}

/// Exchanges the eigenvalues i and i + 1 of a Schur form by a rotation.
fn swap(schur: &mut ComplexSchur, i: usize) {
    let (first, second, above) = (schur.t[(i, i)], schur.t[(i + 1, i + 1)], schur.t[(i, i + 1)]);
    let vector = DVector::from_vec(vec![above, second - first]);
    let norm = vector.norm();
    if norm == 0.0 {
        return;
    }
    let (c, s) = (vector[0] / norm, vector[1] / norm);
    // Columns of the rotation: the eigenvector of the second eigenvalue, and its complement.
    let n = schur.t.nrows();
    for matrix in [&mut schur.t, &mut schur.u] {
        for row in 0..n {
            let (x, y) = (matrix[(row, i)], matrix[(row, i + 1)]);
            matrix[(row, i)] = x * c + y * s;
            matrix[(row, i + 1)] = y * c.conj() - x * s.conj();
        }
    }
    for column in 0..n {
        let (x, y) = (schur.t[(i, column)], schur.t[(i + 1, column)]);
        schur.t[(i, column)] = c.conj() * x + s.conj() * y;
        schur.t[(i + 1, column)] = c * y - s * x;
    }
    schur.t[(i + 1, i)] = Complex64::new(0.0, 0.0);
}
