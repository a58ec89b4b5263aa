//! Newton's method within bounds on the eigenvalues of the weights.

use super::allowance::Allowance;
use super::objective::Objective;
use crate::ctl::{Ctl, Stopped};
use crate::inverse::structure::Structure;
use nalgebra::{DMatrix, DVector};

/// Steps for one barrier weight.
const STEPS: usize = 60;
/// The barrier's weight shrinks by this.
const SHRINK: f64 = 0.1;
/// A step that promises less than this share of the value is the last of its weight.
const CONVERGED: f64 = 1e-10;
/// The barrier ends where its part of the value is below this share of it.
const BARRIER_END: f64 = 1e-9;

/// Q and R, or a direction of both.
pub(super) type Pair = (DMatrix<f64>, DMatrix<f64>);

/// `low·I ≺ Q, R ≺ high·I`; no upper bound where it is infinite.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds<'a> {
    pub low: f64,
    pub high: f64,
    /// The states that Q weighs, where a structure leaves out others: the bounds hold for these, and Q is zero
    /// elsewhere.
    pub weighed: Option<&'a [usize]>,
}

/// Where an iteration stands.
#[derive(Debug, Clone)]
pub(super) struct Point {
    pub q: DMatrix<f64>,
    pub r: DMatrix<f64>,
    pub k: DMatrix<f64>,
    pub value: f64,
    /// Norm of the projected gradient in the barrier's metric, over the value.
    pub stationarity: f64,
}

/// Inverse slacks of both bounds on one weight.
struct Slacks {
    low: DMatrix<f64>,
    high: Option<DMatrix<f64>>,
    value: f64,
}

impl Bounds<'_> {
    /// Those of Q.
    fn of_states(self, q: &DMatrix<f64>) -> Option<Slacks> {
        let Some(kept) = self.weighed else { return self.slacks(q) };
        let found = self.slacks(&q.select_rows(kept).select_columns(kept))?;
        let whole = |part: &DMatrix<f64>| {
            let mut whole = DMatrix::zeros(q.nrows(), q.ncols());
            for (i, row) in kept.iter().enumerate() {
                for (j, column) in kept.iter().enumerate() {
                    whole[(*row, *column)] = part[(i, j)];
                }
            }
            whole
        };
        Some(Slacks { low: whole(&found.low), high: found.high.as_ref().map(whole), value: found.value })
    }

    fn slacks(self, m: &DMatrix<f64>) -> Option<Slacks> {
        let d = m.nrows();
        let log = |c: &nalgebra::Cholesky<f64, nalgebra::Dyn>| 2.0 * c.l_dirty().diagonal().map(f64::ln).sum();
        let low = (m - DMatrix::identity(d, d) * self.low).cholesky()?;
        let mut value = -log(&low);
        let high = if self.high.is_finite() {
            // As 1 − M/high, so that a loose bound costs nothing.
            let factor = (DMatrix::identity(d, d) - m / self.high).cholesky()?;
            value -= log(&factor);
            Some(factor.inverse() / self.high)
        } else {
            None
        };
        Some(Slacks { low: low.inverse(), high, value })
    }
}

impl Slacks {
    fn gradient(&self) -> DMatrix<f64> {
        self.high.as_ref().map_or_else(|| -&self.low, |high| high - &self.low)
    }

    /// `M ↦ S⁻¹MS⁻¹` summed over the bounds.
    fn curvature(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        let low = &self.low * m * &self.low;
        self.high.as_ref().map_or_else(|| low.clone(), |high| &low + high * m * high)
    }
}

/// Share of f that the barrier has at first: much, for a path that forgets its start, or little, for the minimum next
/// to the start.
pub(super) const FAR: f64 = 0.05;
/// See [`FAR`].
pub(super) const NEAR: f64 = 2e-3;
/// Next to a minimum under another bound.
pub(super) const WARM: f64 = 1e-6;

/// The local minimum of f near a start strictly within the bounds, along the directions; `None` where the start has no
/// regulator.
pub(super) fn minimise(
    objective: &Objective<'_>,
    directions: &[Pair],
    start: (DMatrix<f64>, DMatrix<f64>),
    bounds: Bounds<'_>,
    barrier: Option<f64>,
    (allowance, ctl): (&Allowance, &Ctl),
) -> Result<Option<Point>, Stopped> {
    let (mut q, mut r) = start;
    if !allowance.take() {
        return Ok(None);
    }
    let degree = 2.0 * (bounds.weighed.map_or(q.nrows(), <[usize]>::len) + r.nrows()) as f64;
    let Ok(first) = objective.evaluate(&q, &r, None) else { return Ok(None) };
    let (Some(mut sq), Some(mut sr)) = (bounds.of_states(&q), bounds.slacks(&r)) else { return Ok(None) };
    let mut at = first;
    let mut mu = barrier.map_or(0.0, |share| share * at.value / degree);
    let barrier = barrier.is_some();
    let mut stationarity = f64::INFINITY;
    let mut damping = 1e-3;
    loop {
        let mut is_over = false;
        for _ in 0..STEPS {
            ctl.check()?;
            let (mut gradient, hessian) = objective.derivatives(&at, directions, ctl)?;
            let (bq, br) = (sq.gradient(), sr.gradient());
            let curved: Vec<Pair> = directions.iter().map(|(dq, dr)| (sq.curvature(dq), sr.curvature(dr))).collect();
            let count = directions.len();
            let metric = DMatrix::from_fn(count, count, |i, j| {
                curved[i].0.dot(&directions[j].0) + curved[i].1.dot(&directions[j].1)
            });
            for (i, (dq, dr)) in directions.iter().enumerate() {
                gradient[i] += mu * (bq.dot(dq) + br.dot(dr));
            }
            let current = at.value + mu * (sq.value + sr.value);
            let mut moved = false;
            let mut promise = 0.0;
            // Sizes of f and of the metric differ: damping is relative to the curvature of f.
            let size = hessian.diagonal().component_div(&metric.diagonal()).amax().max(f64::MIN_POSITIVE);
            for _ in 0..60 {
                ctl.check()?;
                let shifted = &hessian + &metric * (mu + damping * size);
                let Some(factor) = shifted.cholesky() else {
                    damping = (damping * 8.0).max(1e-16);
                    continue;
                };
                let step = -factor.solve(&gradient);
                let model = -(gradient.dot(&step) + 0.5 * step.dot(&((&hessian + &metric * mu) * &step)));
                let next_q = &q + combine(directions, &step, |d| &d.0, q.nrows());
                let next_r = &r + combine(directions, &step, |d| &d.1, r.nrows());
                promise = model;
                // On the way only the neighbourhood of the path matters.
                let last = if barrier { CONVERGED } else { 1e-6 * CONVERGED };
                if model <= (last * at.value).max(0.02 * mu * degree).max(f64::MIN_POSITIVE) {
                    break;
                }
                if !allowance.take() {
                    is_over = true;
                    break;
                }
                let tried = bounds.of_states(&next_q).zip(bounds.slacks(&next_r)).and_then(|(nq, nr)| {
                    objective.evaluate(&next_q, &next_r, Some(&at.k)).ok().map(|next| (nq, nr, next))
                });
                let Some((nq, nr, next)) = tried else {
                    damping = (damping * 4.0).max(1e-16);
                    continue;
                };
                let gained = current - (next.value + mu * (nq.value + nr.value));
                if gained >= 0.05 * model {
                    if gained > 0.7 * model {
                        damping = (damping / 6.0).max(1e-18);
                    }
                    (q, r, at, sq, sr) = (next_q, next_r, next, nq, nr);
                    moved = true;
                    break;
                }
                damping = (damping * 4.0).max(1e-16);
                if damping > 1e12 {
                    break;
                }
            }
            stationarity = promise.max(0.0) / at.value.max(f64::MIN_POSITIVE);
            if !moved || is_over {
                break;
            }
        }
        damping = damping.min(1e-3);
        if is_over || !barrier || mu * degree <= BARRIER_END * at.value {
            return Ok(Some(Point { q, r, k: at.k, value: at.value, stationarity }));
        }
        mu *= SHRINK;
    }
}

fn combine(
    directions: &[Pair],
    step: &DVector<f64>,
    part: impl Fn(&Pair) -> &DMatrix<f64>,
    size: usize,
) -> DMatrix<f64> {
    directions.iter().zip(step.iter()).fold(DMatrix::zeros(size, size), |mut sum, (d, s)| {
        sum += part(d) * *s;
        sum
    })
}

/// Weights near the given ones whose regulator is nearer to the gain: what rounding took from an exact solution comes
/// back.
///
/// `None` where nothing is gained.
pub(in crate::inverse) fn refine(
    objective: &Objective<'_>,
    structure: &Structure,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    ctl: &Ctl,
) -> Result<Option<Pair>, Stopped> {
    let directions = &structure.directions(q.nrows(), r.nrows());
    let weighed = structure.support();
    let bounds = Bounds { low: 0.0, high: f64::INFINITY, weighed: weighed.as_deref() };
    let point = minimise(objective, directions, (q.clone(), r.clone()), bounds, None, (&Allowance::small(), ctl))?;
    Ok(point.map(|point| (point.q, point.r)))
}
