//! Nonlinear least squares under inequalities: Levenberg-Marquardt for small dense problems.
//!
//! ```text
//! minimise  F(x) = ‖r(x)‖²   subject to   lower ≤ x ≤ upper,   c(x) ≥ 0,   x feasible (a yes-or-no test)
//! ```
//! Every step p minimises `‖r + J p‖² + λ ‖D p‖²` under the linearised inequalities `x + p` within its bounds and `c +
//! C p ≥ 0`, a strictly convex quadratic program that is solved through its dual. `D` holds the largest norm that each
//! column of J has had (Moré 1978), so units of the unknowns do not matter; λ follows Nielsen (1999). A step that
//! leaves the feasible set is bent back by a second-order correction of c first and shortened by a larger λ next: every
//! iterate is feasible, the answer included.
//!
//! # When it has converged
//! With multipliers `μ ≥ 0` of the inequalities and `g = Jᵀr`, the stationarity measure is `max_j |(g − Cᵀμ)_j| /
//! (‖J_j‖ ‖r‖)`: the cosine of the angle between the residual and a column of the Jacobian, as far as no inequality
//! holds it; it is free of units. It counts only where complementarity `Σ μᵢ cᵢ ≤ tolerance · F` holds too.

use super::nonnegative;
use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};

/// A problem: what is evaluated.
pub trait LeastSquares {
    /// Number of unknowns, n.
    fn unknowns(&self) -> usize;

    /// Number of residuals, m; it may be less than n.
    fn equations(&self) -> usize;

    /// Writes the residuals (m), and their derivatives (m×n) if asked; false where they are not defined.
    fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool;

    /// Lower and upper bound of each unknown, infinite where there is none; no vector for no bounds at all.
    fn bounds(&self) -> Vec<[f64; 2]> {
        Vec::new()
    }

    /// Number of smooth inequalities c(x) ≥ 0.
    fn inequalities(&self) -> usize {
        0
    }

    /// Writes c, and its derivatives (inequalities × n) if asked.
    fn constrain(&self, _x: &[f64], _values: &mut DVector<f64>, _jacobian: Option<&mut DMatrix<f64>>) {}

    /// Whether a point may be taken; asked only of points that satisfy bounds and inequalities.
    fn is_feasible(&self, _x: &[f64]) -> bool {
        true
    }
}

/// When to stop. Relative quantities, all of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// The stationarity measure that counts as converged.
    pub gradient_tolerance: f64,
    /// A residual norm that is nothing but rounding, in the units of the residuals.
    pub residual_floor: f64,
    /// Evaluations of the residuals at most.
    pub max_evaluations: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { gradient_tolerance: 1e-7, residual_floor: 0.0, max_evaluations: 500 }
    }
}

/// Why it stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The stationarity measure is below its tolerance.
    Converged,
    /// The residuals are nothing but rounding.
    PerfectFit,
    /// No step decreases the cost by more than its rounding, though the stationarity measure is above its tolerance.
    Precision,
    /// The feasibility test refuses every step, however short: the point is on the edge of the feasible set, and no
    /// inequality says which way the edge runs.
    Blocked,
    /// The evaluations ran out.
    EvaluationLimit,
}

impl Stop {
    /// Whether the answer is a local optimum as far as it can be told.
    #[must_use]
    pub fn is_converged(self) -> bool {
        matches!(self, Self::Converged | Self::PerfectFit)
    }
}

/// An inequality that holds the answer back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Active {
    /// The lower bound of an unknown.
    Lower(usize),
    /// The upper bound of an unknown.
    Upper(usize),
    /// A smooth inequality.
    Inequality(usize),
}

/// The answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// The unknowns; always feasible.
    pub x: Vec<f64>,
    /// `F = ‖r‖²`.
    pub cost: f64,
    /// The residuals there.
    pub residuals: DVector<f64>,
    /// Their derivatives there.
    pub jacobian: DMatrix<f64>,
    /// The stationarity measure there.
    pub gradient_cosine: f64,
    /// Inequalities with a positive multiplier there.
    pub active: Vec<Active>,
    /// Steps taken.
    pub iterations: usize,
    /// Evaluations of the residuals.
    pub residual_evaluations: usize,
    /// Evaluations of the derivatives.
    pub jacobian_evaluations: usize,
    /// Why it stopped.
    pub stop: Stop,
}

/// Why nothing was minimised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum LeastSquaresError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// The start has the wrong length, violates an inequality, or the feasibility test refuses it.
    #[error("the start of the minimisation is not feasible")]
    InfeasibleStart,
    /// The residuals or their derivatives are not finite at the start.
    #[error("the residuals are not finite at the start of the minimisation")]
    NotFinite,
}

/// Everything at a point.
struct Point {
    x: DVector<f64>,
    residuals: DVector<f64>,
    jacobian: DMatrix<f64>,
    cost: f64,
    /// Values and derivatives of the linear and smooth inequalities, `c + C p ≥ 0`.
    constants: DVector<f64>,
    rows: DMatrix<f64>,
}

/// A step with the multipliers of the inequalities.
struct Step {
    p: DVector<f64>,
    multipliers: DVector<f64>,
}

struct Solver<'a, P> {
    problem: &'a P,
    bounds: Vec<[f64; 2]>,
    /// The finite bounds, in the order of the rows.
    bounded: Vec<Active>,
    residual_evaluations: usize,
    jacobian_evaluations: usize,
}

/// Second-order corrections of a step before it is shortened.
const CORRECTIONS: usize = 3;

/// A corrected step aims this share of the violation inside.
const INSIDE: f64 = 0.1;

/// Damping beyond which steps are nothing but rounding.
const LARGEST_DAMPING: f64 = 1e20;

/// Changes of the cost below this share of it are rounding.
const UNDECIDED: f64 = 1e-13;

/// Minimises from a feasible start.
///
/// # Errors
/// [`LeastSquaresError`]; [`LeastSquaresError::Stopped`] at the next evaluation after `ctl` says so.
pub fn minimise<P: LeastSquares>(
    problem: &P,
    start: &[f64],
    options: &Options,
    ctl: &Ctl,
) -> Result<Minimum, LeastSquaresError> {
    let mut solver = Solver::new(problem);
    let mut point = solver.start(start)?;
    let n = problem.unknowns();
    let mut scale = DVector::from_element(n, 0.0);
    let (mut damping, mut growth) = (1e-3, 2.0);
    let mut iterations = 0;
    let mut refused = false;
    loop {
        ctl.check()?;
        for j in 0..n {
            scale[j] = f64::max(scale[j], point.jacobian.column(j).norm());
        }
        let units = scale.map(|d| if d > 0.0 { d } else { 1.0 });
        let step = step(&point, &point.constants, damping, &units);
        // Of many equations a decomposition takes about as long as their derivatives: asked between each.
        ctl.check()?;
        let gradient_cosine = stationarity(&point, &step);
        let finish = |stop, solver: Solver<'_, P>, point: Point| {
            Ok(solver.minimum(point, &step.multipliers, gradient_cosine, iterations, stop))
        };
        if point.cost.sqrt() <= options.residual_floor {
            return finish(Stop::PerfectFit, solver, point);
        }
        if gradient_cosine <= options.gradient_tolerance {
            return finish(Stop::Converged, solver, point);
        }
        if solver.residual_evaluations >= options.max_evaluations {
            return finish(Stop::EvaluationLimit, solver, point);
        }
        let predicted = point.cost - (&point.residuals + &point.jacobian * &step.p).norm_squared();
        let is_short = step.p.component_mul(&units).norm() <= f64::EPSILON * point.x.component_mul(&units).norm();
        let stuck = if refused { Stop::Blocked } else { Stop::Precision };
        if is_short || predicted <= 0.0 || damping > LARGEST_DAMPING {
            return finish(stuck, solver, point);
        }
        if predicted <= UNDECIDED * point.cost {
            // The cost cannot tell any more which point is better; the stationarity measure, whose rounding is its own
            // and not its root, can.
            match solver.polished(&point, &step.p, (damping, &units), gradient_cosine, ctl)? {
                Some(next) => {
                    point = next;
                    damping /= 3.0;
                    iterations += 1;
                    continue;
                }
                None => {
                    damping *= growth;
                    growth *= 2.0;
                    continue;
                }
            }
        }
        let tried = solver.tried(&point, &step.p, damping, &units);
        ctl.check()?;
        match tried {
            Trial::Taken(next, p) if next.cost < point.cost => {
                let predicted = point.cost - (&point.residuals + &point.jacobian * &p).norm_squared();
                let ratio = (point.cost - next.cost) / predicted.max(f64::MIN_POSITIVE);
                damping *= f64::max(1.0 / 3.0, 1.0 - (2.0 * ratio.min(2.0) - 1.0).powi(3));
                damping = damping.max(1e-18);
                growth = 2.0;
                refused = false;
                iterations += 1;
                point = solver.differentiate(*next).ok_or(LeastSquaresError::NotFinite)?;
            }
            other => {
                refused = matches!(other, Trial::Infeasible);
                damping *= growth;
                growth *= 2.0;
            }
        }
    }
}

/// What became of a step.
enum Trial {
    /// A feasible point without derivatives yet, and the step to it.
    Taken(Box<Point>, DVector<f64>),
    /// The residuals are not defined there.
    Undefined,
    /// It leaves the feasible set.
    Infeasible,
}

impl<'a, P: LeastSquares> Solver<'a, P> {
    fn new(problem: &'a P) -> Self {
        let bounds = problem.bounds();
        let mut bounded = Vec::new();
        for (i, [lower, upper]) in bounds.iter().enumerate() {
            bounded.extend(lower.is_finite().then_some(Active::Lower(i)));
            bounded.extend(upper.is_finite().then_some(Active::Upper(i)));
        }
        Self { problem, bounds, bounded, residual_evaluations: 0, jacobian_evaluations: 0 }
    }

    fn is_within(&self, x: &DVector<f64>) -> bool {
        let inside = self.bounds.iter().zip(x.iter()).all(|([lower, upper], x)| lower <= x && x <= upper);
        inside && x.iter().all(|x| x.is_finite())
    }

    fn inequalities(&self, x: &DVector<f64>) -> DVector<f64> {
        let mut values = DVector::zeros(self.problem.inequalities());
        self.problem.constrain(x.as_slice(), &mut values, None);
        values
    }

    fn start(&mut self, start: &[f64]) -> Result<Point, LeastSquaresError> {
        let x = DVector::from_column_slice(start);
        let is_feasible = x.len() == self.problem.unknowns()
            && self.is_within(&x)
            && self.inequalities(&x).iter().all(|c| *c >= 0.0)
            && self.problem.is_feasible(start);
        if !is_feasible {
            return Err(LeastSquaresError::InfeasibleStart);
        }
        let point = self.valued(x).ok_or(LeastSquaresError::NotFinite)?;
        self.differentiate(point).ok_or(LeastSquaresError::NotFinite)
    }

    /// The residuals at a point; `None` where they are not defined or not finite.
    fn valued(&mut self, x: DVector<f64>) -> Option<Point> {
        self.residual_evaluations += 1;
        let mut residuals = DVector::zeros(self.problem.equations());
        let is_defined = self.problem.evaluate(x.as_slice(), &mut residuals, None);
        let cost = residuals.norm_squared();
        let (jacobian, constants, rows) = (DMatrix::zeros(0, 0), DVector::zeros(0), DMatrix::zeros(0, 0));
        (is_defined && cost.is_finite()).then_some(Point { x, residuals, jacobian, cost, constants, rows })
    }

    fn differentiate(&mut self, mut point: Point) -> Option<Point> {
        self.jacobian_evaluations += 1;
        let (m, n, smooth) = (self.problem.equations(), self.problem.unknowns(), self.problem.inequalities());
        point.jacobian = DMatrix::zeros(m, n);
        let is_defined = self.problem.evaluate(point.x.as_slice(), &mut point.residuals, Some(&mut point.jacobian));
        let (mut values, mut jacobian) = (DVector::zeros(smooth), DMatrix::zeros(smooth, n));
        self.problem.constrain(point.x.as_slice(), &mut values, Some(&mut jacobian));
        let linear = self.bounded.len();
        point.constants = DVector::zeros(linear + smooth);
        point.rows = DMatrix::zeros(linear + smooth, n);
        for (row, bound) in self.bounded.iter().enumerate() {
            match *bound {
                Active::Lower(i) => {
                    point.constants[row] = point.x[i] - self.bounds[i][0];
                    point.rows[(row, i)] = 1.0;
                }
                Active::Upper(i) => {
                    point.constants[row] = self.bounds[i][1] - point.x[i];
                    point.rows[(row, i)] = -1.0;
                }
                Active::Inequality(_) => {}
            }
        }
        point.constants.rows_mut(linear, smooth).copy_from(&values);
        point.rows.rows_mut(linear, smooth).copy_from(&jacobian);
        let is_finite = point.jacobian.iter().chain(point.rows.iter()).all(|v| v.is_finite());
        (is_defined && is_finite).then_some(point)
    }

    /// Tries a step, bent back into the inequalities where it leaves them.
    fn tried(&mut self, point: &Point, step_p: &DVector<f64>, damping: f64, units: &DVector<f64>) -> Trial {
        let linear = self.bounded.len();
        let mut p = step_p.clone();
        let mut constants = point.constants.clone();
        for correction in 0..=CORRECTIONS {
            let mut x = &point.x + &p;
            for (x, [lower, upper]) in x.iter_mut().zip(&self.bounds) {
                // Rounding of the sum must not pass a bound that the step keeps.
                *x = x.clamp(*lower, *upper);
            }
            let values = self.inequalities(&x);
            if values.iter().all(|c| *c >= 0.0) {
                if !self.is_within(&x) || !self.problem.is_feasible(x.as_slice()) {
                    return Trial::Infeasible;
                }
                return self.valued(x).map_or(Trial::Undefined, |next| Trial::Taken(Box::new(next), p));
            }
            if correction == CORRECTIONS || values.iter().any(|c| c.is_nan()) {
                break;
            }
            let slope = &point.rows * &p;
            for (i, value) in values.iter().enumerate().filter(|(_, value)| **value < 0.0) {
                // Rounding alone may leave a linear inequality: its unit comes from the terms that it is the sum of.
                let row = point.rows.row(linear + i);
                let terms: f64 = row.iter().zip(x.iter()).map(|(c, x)| (c * x).abs()).sum();
                let rounding = 16.0 * f64::EPSILON * (terms + point.constants[linear + i].abs());
                constants[linear + i] = value - slope[linear + i] - INSIDE * value.abs() - rounding;
            }
            p = step(point, &constants, damping, units).p;
        }
        Trial::Infeasible
    }

    /// The next point, if its cost is the same to rounding and its stationarity measure clearly smaller.
    fn polished(
        &mut self,
        point: &Point,
        p: &DVector<f64>,
        (damping, units): (f64, &DVector<f64>),
        cosine: f64,
        ctl: &Ctl,
    ) -> Result<Option<Point>, LeastSquaresError> {
        let Trial::Taken(next, _) = self.tried(point, p, damping, units) else { return Ok(None) };
        ctl.check()?;
        if next.cost > point.cost * (1.0 + UNDECIDED) {
            return Ok(None);
        }
        let next = self.differentiate(*next).ok_or(LeastSquaresError::NotFinite)?;
        ctl.check()?;
        let ahead = step(&next, &next.constants, damping, units);
        Ok((stationarity(&next, &ahead) < 0.9 * cosine).then_some(next))
    }

    fn minimum(
        self,
        point: Point,
        multipliers: &DVector<f64>,
        gradient_cosine: f64,
        iterations: usize,
        stop: Stop,
    ) -> Minimum {
        let smooth = (0..self.problem.inequalities()).map(Active::Inequality);
        let names: Vec<Active> = self.bounded.iter().copied().chain(smooth).collect();
        let active = names.into_iter().zip(multipliers.iter()).filter(|(_, mu)| **mu > 0.0).map(|(a, _)| a).collect();
        Minimum {
            x: point.x.as_slice().to_vec(),
            cost: point.cost,
            residuals: point.residuals,
            jacobian: point.jacobian,
            gradient_cosine,
            active,
            iterations,
            residual_evaluations: self.residual_evaluations,
            jacobian_evaluations: self.jacobian_evaluations,
            stop,
        }
    }
}

/// The minimiser of the damped model under `constants + rows·p ≥ 0`.
fn step(point: &Point, constants: &DVector<f64>, damping: f64, units: &DVector<f64>) -> Step {
    let (m, n) = point.jacobian.shape();
    // In scaled unknowns D p, whose columns are at most unit vectors; QR keeps what normal equations would square away.
    let root = damping.sqrt();
    let stacked = DMatrix::from_fn(m + n, n, |i, j| {
        if i < m { point.jacobian[(i, j)] / units[j] } else { f64::from(u8::from(i - m == j)) * root }
    });
    let mut right = DVector::zeros(m + n);
    right.rows_mut(0, m).copy_from(&-&point.residuals);
    let qr = stacked.qr();
    qr.q_tr_mul(&mut right);
    let r = qr.unpack_r();
    let free = r.solve_upper_triangular(&right.rows(0, n).into_owned()).unwrap_or_else(|| DVector::zeros(n));
    let rows = DMatrix::from_fn(point.rows.nrows(), n, |i, j| point.rows[(i, j)] / units[j]);
    let mut multipliers = DVector::zeros(rows.nrows());
    let slack = constants + &rows * &free;
    let mut scaled = free;
    if slack.iter().any(|s| *s < 0.0) {
        // G = C R⁻¹, with rows of unit length.
        let mut g = r.tr_solve_upper_triangular(&rows.transpose()).unwrap_or_else(|| DMatrix::zeros(n, rows.nrows()));
        let norms: Vec<f64> =
            (0..g.ncols()).map(|i| Some(g.column(i).norm()).filter(|n| *n > 0.0).unwrap_or(1.0)).collect();
        for (i, norm) in norms.iter().enumerate() {
            g.column_mut(i).unscale_mut(*norm);
        }
        let linear = DVector::from_fn(slack.len(), |i, _| slack[i] / norms[i]);
        // Of the inequalities that the free step breaks; those far away say nothing about rounding here.
        let tolerance = 1e-14 * -linear.min();
        let dual = nonnegative::minimise(&(g.transpose() * &g), &linear, tolerance);
        if let Some(turned) = r.solve_upper_triangular(&(&g * &dual)) {
            scaled += turned;
        }
        multipliers = DVector::from_fn(dual.len(), |i, _| dual[i] / norms[i]);
    }
    Step { p: scaled.component_div(units), multipliers }
}

/// The stationarity measure of this module's description, and complementarity in the same units: the larger of the two.
fn stationarity(point: &Point, step: &Step) -> f64 {
    let norm = point.cost.sqrt();
    if norm == 0.0 {
        return 0.0;
    }
    let gradient = point.jacobian.tr_mul(&point.residuals) - point.rows.tr_mul(&step.multipliers);
    let cosine = gradient
        .iter()
        .zip(point.jacobian.column_iter())
        .map(|(g, column)| g.abs() / column.norm().max(f64::MIN_POSITIVE))
        .fold(0.0, f64::max)
        / norm;
    // Σ μ c is what the cost can still fall by until the inequalities hold with equality.
    f64::max(cosine, (step.multipliers.dot(&point.constants) / point.cost).abs())
}

#[cfg(test)]
mod tests;
