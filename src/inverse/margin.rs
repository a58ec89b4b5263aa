//! The largest margin t*: how definite weights may be, with Q and R under one trace.
//!
//! It is no verdict: for many gains that no R ≻ 0 makes optimal it is 0, since R may become singular.

use super::space::Space;
use crate::convex::lmi::{self, Block, LmiError, Problem, Solution, Status};
use crate::ctl::Ctl;
use nalgebra::{DMatrix, DVector};

/// Weights below this share of the largest are not brought to size 1: their rounding would grow too large.
const ROUNDING: f64 = 1e-8;
/// Below this share of the weights' size their trace is rounding.
const NO_TRACE: f64 = 1e-12;

/// `t* = max t` with `Q ⪰ tI`, `R ⪰ tI`, `tr Q + tr R = n + m` over the weights that satisfy the equalities.
#[derive(Debug, Clone)]
pub(super) struct Margin {
    /// t*, attained by the point.
    pub t_star: f64,
    /// No t exceeds this, by the dual certificate.
    pub upper_bound: f64,
    /// The weights that attain it, in the coordinates of the space.
    pub z: DVector<f64>,
    /// Whether the iteration converged.
    pub solved: bool,
    /// The dual weights of Q and R, positive definite.
    pub duals: [DMatrix<f64>; 2],
}

impl Margin {
    /// `(X̂, T̂)` with `⟨X̂, Q⟩ + ⟨T̂, R⟩ = 0` for all weights of the space in the units of the plant, where t* is
    /// negative: the dual weights with the share of −t* that falls on the trace.
    pub(super) fn dual(&self, space: &Space, units: &Units) -> [DMatrix<f64>; 2] {
        let share = -self.t_star / (units.q.len() + units.r.len()) as f64;
        let back = |dual: &DMatrix<f64>, d: &DVector<f64>| {
            DMatrix::from_fn(d.len(), d.len(), |i, j| (dual[(i, j)] + if i == j { share } else { 0.0 }) * d[i] * d[j])
        };
        let states = back(&self.duals[0], &units.q) / (space.scale * space.scale);
        [space.among_states(&states), back(&self.duals[1], &units.r)]
    }
}

/// Units in which a margin is measured: `D_q Q D_q ⪰ tI` and `D_r R D_r ⪰ tI` with diagonal D, n and m entries.
#[derive(Debug, Clone)]
pub(super) struct Units {
    /// The diagonal of D_q.
    pub q: DVector<f64>,
    /// The diagonal of D_r.
    pub r: DVector<f64>,
}

impl Units {
    /// Of one size each.
    pub(super) fn uniform(space: &Space, q: f64) -> Self {
        let ports = space.r.first().map_or(0, DMatrix::nrows);
        Self { q: DVector::from_element(space.weighed_states().len(), q), r: DVector::from_element(ports, 1.0) }
    }

    /// Such that the diagonals of these weights (Q where it is weighed) become 1, as far as they stand out from
    /// rounding.
    pub(super) fn balancing(q: &DMatrix<f64>, r: &DMatrix<f64>) -> Self {
        let largest = q.diagonal().amax().max(r.diagonal().amax()).max(f64::MIN_POSITIVE);
        let unit = |m: &DMatrix<f64>| m.diagonal().map(|v| v.abs().max(ROUNDING * largest).sqrt().recip());
        Self { q: unit(q), r: unit(r) }
    }
}

/// The margin of `Q = Σ z_i Q_i`, `R = Σ z_i R_i` in these units; `None` where every weight of the space has trace
/// zero, so that none is definite.
///
/// # Errors
/// [`LmiError`] when stopped.
pub(super) fn margin(space: &Space, units: &Units, ctl: &Ctl) -> Result<Option<Margin>, LmiError> {
    let total = (units.q.len() + units.r.len()) as f64;
    let congruent = |terms: &[DMatrix<f64>], d: &DVector<f64>| -> Vec<DMatrix<f64>> {
        terms.iter().map(|t| DMatrix::from_fn(d.len(), d.len(), |i, j| t[(i, j)] * d[i] * d[j])).collect()
    };
    let (q, r) = (congruent(&space.weighed_terms(), &units.q), congruent(&space.r, &units.r));
    let traces = DVector::from_fn(space.len(), |i, _| q[i].trace() + r[i].trace());
    let sizes = DVector::from_fn(space.len(), |i, _| q[i].norm() + r[i].norm());
    // Directions of one size each: what is small in these units is not lost behind what is large.
    let scale = sizes.map(|s| if s > 0.0 { s.recip() } else { 0.0 });
    let traces = traces.component_mul(&scale);
    if space.len() == 0 || traces.norm() <= NO_TRACE {
        return Ok(None);
    }
    // z = z₀ + N w, with N an orthonormal basis of the trace's null space.
    let fixed = (&traces * (total / traces.norm_squared())).component_mul(&scale);
    let free = DMatrix::from_diagonal(&scale) * complement(&traces);
    let combine = |terms: &[DMatrix<f64>], z: &[f64]| {
        terms.iter().zip(z).fold(DMatrix::zeros(terms[0].nrows(), terms[0].ncols()), |sum, (t, z)| sum + t * *z)
    };
    let block = |terms: &[DMatrix<f64>]| {
        let d = terms[0].nrows();
        let mut all: Vec<DMatrix<f64>> =
            free.column_iter().map(|c| combine(terms, c.clone_owned().as_slice())).collect();
        all.push(-DMatrix::identity(d, d));
        Block::new(combine(terms, fixed.as_slice()), all.iter())
    };
    let blocks = vec![block(&q), block(&r)];
    let unknowns = free.ncols() + 1;
    let mut cost = DVector::zeros(unknowns);
    cost[unknowns - 1] = -1.0;
    let mut start = DVector::zeros(unknowns);
    let least = blocks.iter().map(|b| b.value(&start).symmetric_eigenvalues().min()).fold(f64::INFINITY, f64::min);
    start[unknowns - 1] = least - least.abs().max(1.0);
    let problem = Problem { cost, quadratic: None, objective_scale: 1e-2, gap: lmi::GAP, blocks };
    let solution = lmi::solve(&problem, &start, ctl)?;
    let z = &fixed + &free * solution.z.rows(0, unknowns - 1);
    Ok(Some(Margin {
        t_star: solution.z[unknowns - 1],
        upper_bound: upper_bound(&solution, total),
        z,
        solved: solution.status == Status::Solved,
        duals: [solution.duals[0].clone(), solution.duals[1].clone()],
    }))
}

/// The dual bound, corrected for what is left of the dual residual: `t ≤ dual + r·(w, t)` for every feasible point.
/// With the trace fixed no eigenvalue of a feasible point exceeds `(n + m)(1 + |t|)`, which bounds its norm by about
/// the square.
fn upper_bound(solution: &Solution, total: f64) -> f64 {
    let dual = -solution.dual_objective;
    dual + solution.dual_residual * total * total * (2.0 + dual.abs())
}

/// An orthonormal basis of the orthogonal complement of a vector, from one Householder reflection.
pub(super) fn complement(v: &DVector<f64>) -> DMatrix<f64> {
    let n = v.len();
    let norm = v.norm();
    let mut w = v / norm;
    let sign = if w[0] >= 0.0 { 1.0 } else { -1.0 };
    w[0] += sign;
    let beta = 2.0 / w.norm_squared();
    DMatrix::from_fn(n, n - 1, |i, j| {
        let j = j + 1;
        f64::from(u8::from(i == j)) - beta * w[i] * w[j]
    })
}
