//! Linear programs with few rows over a box of many unknowns.
//!
//! ```text
//! maximise  cᵀx   subject to   l ≤ x ≤ u   and   a ≤ A x ≤ b          (n unknowns, m rows)
//! ```
//! Mehrotra's predictor and corrector on the bounded form `A x − s = 0`, `a ≤ s ≤ b` (Wright, Primal-Dual
//! Interior-Point Methods, 1997, ch. 10–11). The box never enters the linear algebra: one step factors the m×m matrix
//! `A Θ Aᵀ + Θ_s`, that is `m²n + m³/3` operations. No start is needed, and none is asked for.
//!
//! # The proof
//! For any multipliers y of the rows, `cᵀx = (c − Aᵀy)ᵀx + yᵀ(Ax)`, and so every feasible x has `cᵀx ≤ Σ_j max(r_j l_j,
//! r_j u_j) + Σ_i max(y_i a_i, y_i b_i)` with `r = c − Aᵀy`. [`Solution::bound`] is this number, computed from the
//! multipliers as they stand: it holds whatever the solver did.

use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};

/// The relative gap between objective and bound that is asked for where nothing else is said.
pub const GAP: f64 = 1e-8;
/// Violation of a row, relative to the largest value that it takes in the box, that counts as rounding.
const FEASIBLE: f64 = 1e-10;
/// Gap up to which an answer that makes no more progress counts as solved.
const SOLVED: f64 = 1e-6;
/// Steps at most.
const STEPS: usize = 100;
/// Share of the way to the boundary.
const TO_BOUNDARY: f64 = 0.995;

/// A program. Every box and every row has lower < upper, strictly and finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Program {
    /// c, n.
    pub cost: DVector<f64>,
    /// l and u, n each.
    pub bounds: [DVector<f64>; 2],
    /// A, m×n; m may be 0.
    pub rows: DMatrix<f64>,
    /// a and b, m each.
    pub limits: [DVector<f64>; 2],
}

/// How it ended. The numbers in [`Solution`] are the proof.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Feasible to rounding, with objective and bound together as asked.
    Solved,
    /// No x satisfies the rows: the bound is below the least value that the box allows.
    Infeasible,
    /// It ran out of steps or of digits.
    Failed,
}

/// An answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// x, n; within its box exactly, within the rows up to `violation`.
    pub x: DVector<f64>,
    /// y, m: positive where the upper limit of a row holds x back, negative where the lower one does.
    pub multipliers: DVector<f64>,
    /// cᵀx.
    pub objective: f64,
    /// No feasible x has a larger cᵀx; see the module's description.
    pub bound: f64,
    /// The largest violation of a row, in its own units.
    pub violation: f64,
    /// Steps taken.
    pub steps: usize,
    /// How it ended.
    pub outcome: Outcome,
}

/// A program that cannot be solved as it stands.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BoxLpError {
    /// A vector or matrix has the wrong size, a mistake of the caller.
    #[error("the {part} is of size {found} and must be {expected}")]
    Size {
        /// Which one.
        part: &'static str,
        /// Its size.
        found: usize,
        /// The size it must have.
        expected: usize,
    },
    /// A number is NaN or infinite.
    #[error("the program has a number that is not finite")]
    NotFinite,
    /// An interval is empty or a point.
    #[error("the {part} at {index} go from {lower} to {upper}, which leaves nothing between them")]
    Empty {
        /// `bounds` or `limits`.
        part: &'static str,
        /// Which one.
        index: usize,
        /// Its lower end.
        lower: f64,
        /// Its upper end.
        upper: f64,
    },
    /// Somebody asked to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

impl Program {
    /// Solves it to a relative gap.
    ///
    /// # Errors
    /// [`BoxLpError`]; `Stopped` at the next step after `ctl` says so.
    pub fn solve(&self, gap: f64, ctl: &Ctl) -> Result<Solution, BoxLpError> {
        self.check()?;
        let (m, n) = self.rows.shape();
        if m == 0 {
            let x = self.best_of_box(&self.cost);
            return Ok(self.solution(x, DVector::zeros(0), 0, gap));
        }
        // Rows of unit length and a cost of unit size: bounds on unknowns keep their own units.
        let lengths =
            DVector::from_fn(m, |i, _| Some(self.rows.row(i).norm()).filter(|length| *length > 0.0).unwrap_or(1.0));
        let size = Some(self.cost.amax()).filter(|size| *size > 0.0).unwrap_or(1.0);
        let mut scaled = self.rows.clone();
        for (mut row, length) in scaled.row_iter_mut().zip(lengths.iter()) {
            row.unscale_mut(*length);
        }
        let joined = |x: &DVector<f64>, s: DVector<f64>| {
            DVector::from_iterator(n + m, x.iter().copied().chain(s.iter().copied()))
        };
        let lower = joined(&self.bounds[0], self.limits[0].component_div(&lengths));
        let upper = joined(&self.bounds[1], self.limits[1].component_div(&lengths));
        let cost = joined(&(&self.cost / -size), DVector::zeros(m));
        let mut state = State::new(scaled, lower, upper, cost);
        let mut best: Option<(f64, Solution)> = None;
        for steps in 0..=STEPS {
            ctl.check()?;
            let x = state.x.rows(0, n).into_owned();
            let y = -state.y.component_div(&lengths) * size;
            let solution = self.solution(x, y, steps, gap);
            if solution.outcome != Outcome::Failed {
                return Ok(solution);
            }
            // The best so far, by what is left of gap and feasibility together.
            let left = self.relative_gap(&solution).max(self.relative_violation(&solution.x) / FEASIBLE * gap);
            if best.as_ref().is_none_or(|(least, _)| left < *least) {
                best = Some((left, solution));
            }
            if !state.advance() {
                break;
            }
        }
        let Some((left, mut solution)) = best else { return Err(BoxLpError::NotFinite) };
        if left <= SOLVED.max(gap) && self.relative_violation(&solution.x) <= 10.0 * FEASIBLE {
            solution.outcome = Outcome::Solved;
        }
        Ok(solution)
    }

    fn check(&self) -> Result<(), BoxLpError> {
        let (m, n) = self.rows.shape();
        let sizes = [
            ("lower bounds", self.bounds[0].len(), n),
            ("upper bounds", self.bounds[1].len(), n),
            ("cost", self.cost.len(), n),
            ("lower limits", self.limits[0].len(), m),
            ("upper limits", self.limits[1].len(), m),
        ];
        if let Some((part, found, expected)) = sizes.into_iter().find(|(_, found, expected)| found != expected) {
            return Err(BoxLpError::Size { part, found, expected });
        }
        let intervals = self.bounds.iter().chain(&self.limits).flat_map(|v| v.iter());
        if self.cost.iter().chain(self.rows.iter()).chain(intervals).any(|v| !v.is_finite()) {
            return Err(BoxLpError::NotFinite);
        }
        for (part, [lower, upper]) in [("bounds", &self.bounds), ("limits", &self.limits)] {
            for (index, (lower, upper)) in lower.iter().zip(upper.iter()).enumerate() {
                if lower >= upper {
                    return Err(BoxLpError::Empty { part, index, lower: *lower, upper: *upper });
                }
            }
        }
        Ok(())
    }

    /// The maximiser of rᵀx over the box alone.
    fn best_of_box(&self, r: &DVector<f64>) -> DVector<f64> {
        DVector::from_fn(r.len(), |j, _| self.bounds[usize::from(r[j] > 0.0)][j])
    }

    /// The bound of this module's description.
    fn bound(&self, y: &DVector<f64>) -> f64 {
        let reduced = &self.cost - self.rows.tr_mul(y);
        let of_box: f64 = reduced.dot(&self.best_of_box(&reduced));
        of_box + y.iter().enumerate().map(|(i, y)| y * self.limits[usize::from(*y > 0.0)][i]).sum::<f64>()
    }

    fn violation(&self, x: &DVector<f64>) -> f64 {
        let values = &self.rows * x;
        let beyond = |i: usize| (self.limits[0][i] - values[i]).max(values[i] - self.limits[1][i]);
        (0..values.len()).map(beyond).fold(0.0, f64::max)
    }

    /// The largest violation of a row over the largest value that it takes in the box.
    fn relative_violation(&self, x: &DVector<f64>) -> f64 {
        let values = &self.rows * x;
        let sizes = self.bounds[0].zip_map(&self.bounds[1], |l, u| l.abs().max(u.abs()));
        let mut worst: f64 = 0.0;
        for i in 0..values.len() {
            let beyond = (self.limits[0][i] - values[i]).max(values[i] - self.limits[1][i]);
            if beyond > 0.0 {
                let reach = self.rows.row(i).iter().zip(sizes.iter()).map(|(a, s)| a.abs() * s).sum::<f64>();
                worst = worst.max(beyond / reach.max(f64::MIN_POSITIVE));
            }
        }
        worst
    }

    fn relative_gap(&self, solution: &Solution) -> f64 {
        (solution.bound - solution.objective).abs() / solution.objective.abs().max(f64::MIN_POSITIVE)
    }

    fn solution(&self, x: DVector<f64>, y: DVector<f64>, steps: usize, gap: f64) -> Solution {
        let x = DVector::from_fn(x.len(), |j, _| x[j].clamp(self.bounds[0][j], self.bounds[1][j]));
        let objective = self.cost.dot(&x);
        let (bound, violation) = (self.bound(&y), self.violation(&x));
        let mut solution = Solution { x, multipliers: y, objective, bound, violation, steps, outcome: Outcome::Failed };
        let least = -(-&self.cost).dot(&self.best_of_box(&-&self.cost));
        if bound < least - 1e-9 * least.abs() {
            solution.outcome = Outcome::Infeasible;
        } else if (self.relative_gap(&solution) <= gap || bound == objective)
            && self.relative_violation(&solution.x) <= FEASIBLE
        {
            solution.outcome = Outcome::Solved;
        }
        solution
    }
}

/// The iteration on `minimise cᵀx, M x = 0, l ≤ x ≤ u` with `M = [A −I]` and `x = (unknowns, slacks)`.
struct State {
    rows: DMatrix<f64>,
    lower: DVector<f64>,
    upper: DVector<f64>,
    cost: DVector<f64>,
    x: DVector<f64>,
    y: DVector<f64>,
    /// Multipliers of the lower and of the upper bounds, positive.
    z: [DVector<f64>; 2],
}

/// A step of the iteration.
struct Direction {
    x: DVector<f64>,
    y: DVector<f64>,
    z: [DVector<f64>; 2],
}

impl State {
    fn new(rows: DMatrix<f64>, lower: DVector<f64>, upper: DVector<f64>, cost: DVector<f64>) -> Self {
        let x = (&lower + &upper) / 2.0;
        let ones = DVector::from_element(x.len(), 1.0);
        let y = DVector::zeros(rows.nrows());
        Self { rows, lower, upper, cost, x, y, z: [ones.clone(), ones] }
    }

    /// `M x`.
    fn product(&self, x: &DVector<f64>) -> DVector<f64> {
        let (m, n) = self.rows.shape();
        &self.rows * x.rows(0, n) - x.rows(n, m)
    }

    /// `Mᵀ y`.
    fn adjoint(&self, y: &DVector<f64>) -> DVector<f64> {
        let (m, n) = self.rows.shape();
        let mut all = DVector::zeros(n + m);
        all.rows_mut(0, n).copy_from(&self.rows.tr_mul(y));
        all.rows_mut(n, m).copy_from(&-y);
        all
    }

    /// One predictor and corrector; false where the linear algebra fails or no step is left.
    fn advance(&mut self) -> bool {
        let (m, n) = self.rows.shape();
        let below = &self.x - &self.lower;
        let above = &self.upper - &self.x;
        let theta = DVector::from_fn(n + m, |j, _| 1.0 / (self.z[0][j] / below[j] + self.z[1][j] / above[j]));
        let Some(factor) = factorised(&self.rows, &theta) else { return false };
        let primal = -self.product(&self.x);
        let dual = &self.cost - self.adjoint(&self.y) - &self.z[0] + &self.z[1];
        // below·dz₀ + z₀·dx = target₀ and above·dz₁ − z₁·dx = target₁ with the two residuals above.
        let solve = |targets: &[DVector<f64>; 2]| {
            let r = DVector::from_fn(n + m, |j, _| dual[j] - targets[0][j] / below[j] + targets[1][j] / above[j]);
            let right = &primal + self.product(&theta.component_mul(&r));
            let y = factor(right);
            let x = theta.component_mul(&(self.adjoint(&y) - r));
            let z = [
                DVector::from_fn(n + m, |j, _| (targets[0][j] - self.z[0][j] * x[j]) / below[j]),
                DVector::from_fn(n + m, |j, _| (targets[1][j] + self.z[1][j] * x[j]) / above[j]),
            ];
            Direction { x, y, z }
        };
        let products = [below.component_mul(&self.z[0]), above.component_mul(&self.z[1])];
        let count = 2.0 * (n + m) as f64;
        let mu = (products[0].sum() + products[1].sum()) / count;
        let predictor = solve(&[-&products[0], -&products[1]]);
        let (primal_step, dual_step) = self.steps(&predictor, &below, &above, 1.0);
        let ahead: f64 = (0..n + m)
            .map(|j| {
                (below[j] + primal_step * predictor.x[j]) * (self.z[0][j] + dual_step * predictor.z[0][j])
                    + (above[j] - primal_step * predictor.x[j]) * (self.z[1][j] + dual_step * predictor.z[1][j])
            })
            .sum::<f64>()
            / count;
        let centre = (ahead / mu).powi(3) * mu;
        let targets = [
            DVector::from_fn(n + m, |j, _| centre - products[0][j] - predictor.x[j] * predictor.z[0][j]),
            DVector::from_fn(n + m, |j, _| centre - products[1][j] + predictor.x[j] * predictor.z[1][j]),
        ];
        let step = solve(&targets);
        let (primal_step, dual_step) = self.steps(&step, &below, &above, TO_BOUNDARY);
        self.x.axpy(primal_step, &step.x, 1.0);
        self.y.axpy(dual_step, &step.y, 1.0);
        for (z, dz) in self.z.iter_mut().zip(&step.z) {
            z.axpy(dual_step, dz, 1.0);
        }
        let is_inside = (0..n + m).all(|j| {
            self.lower[j] < self.x[j] && self.x[j] < self.upper[j] && self.z[0][j] > 0.0 && self.z[1][j] > 0.0
        });
        is_inside && self.y.iter().all(|v| v.is_finite()) && primal_step.max(dual_step) > 1e-12
    }

    /// The longest primal and dual steps, times a share, up to 1.
    fn steps(&self, step: &Direction, below: &DVector<f64>, above: &DVector<f64>, share: f64) -> (f64, f64) {
        let (mut primal, mut dual): (f64, f64) = (f64::INFINITY, f64::INFINITY);
        for j in 0..step.x.len() {
            let dx = step.x[j];
            if dx < 0.0 {
                primal = primal.min(-below[j] / dx);
            } else if dx > 0.0 {
                primal = primal.min(above[j] / dx);
            }
            for (z, dz) in self.z.iter().zip(&step.z) {
                if dz[j] < 0.0 {
                    dual = dual.min(-z[j] / dz[j]);
                }
            }
        }
        ((share * primal).min(1.0), (share * dual).min(1.0))
    }
}

/// A solver with the Cholesky factor of `A Θ Aᵀ + Θ_s`; `None` where it has none.
fn factorised(rows: &DMatrix<f64>, theta: &DVector<f64>) -> Option<impl Fn(DVector<f64>) -> DVector<f64> + use<>> {
    use faer::linalg::matmul::triangular::{BlockStructure, matmul};
    use faer::linalg::solvers::SolveCore as _;
    let (m, n) = rows.shape();
    let mut weighted = rows.clone();
    for (mut column, theta) in weighted.column_iter_mut().zip(theta.iter()) {
        column.scale_mut(theta.sqrt());
    }
    let weighted = faer::MatRef::from_column_major_slice(weighted.as_slice(), m, n);
    let mut gram = faer::Mat::<f64>::zeros(m, m);
    matmul(
        gram.as_mut(),
        BlockStructure::TriangularLower,
        faer::Accum::Replace,
        weighted,
        BlockStructure::Rectangular,
        weighted.transpose(),
        BlockStructure::Rectangular,
        1.0,
        faer::Par::Seq,
    );
    for i in 0..m {
        gram[(i, i)] += theta[n + i];
    }
    let largest = (0..m).map(|i| gram[(i, i)]).fold(0.0, f64::max);
    if !largest.is_finite() {
        return None;
    }
    let factor = gram.llt(faer::Side::Lower).ok().or_else(|| {
        // Rows that depend on each other at the optimum: a shift of the size of rounding.
        for i in 0..m {
            gram[(i, i)] += 1e-14 * largest;
        }
        gram.llt(faer::Side::Lower).ok()
    })?;
    Some(move |right: DVector<f64>| {
        let mut right = right;
        let column = faer::MatMut::from_column_major_slice_mut(right.as_mut_slice(), m, 1);
        factor.solve_in_place_with_conj(faer::Conj::No, column);
        right
    })
}
