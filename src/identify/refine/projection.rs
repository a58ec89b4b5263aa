//! The residual with the feedforward numerator projected out, and its derivatives.
//!
//! With `L = Dfb + G Nfb e^{−jωτ}` the residual `√w (G̃ − H) = A β − b` is linear in the numerator's coefficients β in
//! the orthonormal basis: `A_ki = √w G Dfb e^{−jωτff}/(Dff L) · B_i(x_k)` and `b = √w (H − G Nfb e^{−jωτ}/L)`. For the
//! other unknowns φ, `β = A⁺b`, and (Golub and Pereyra 1973, in full) `∂r = P⊥ (∂A β − ∂b) − (A⁺)ᵀ ∂Aᵀ r`, with the
//! projector `P⊥ = I − A A⁺`. All is written in polynomials, so a feedback pole on a line (an integrator at 0 Hz) does
//! no harm.

use super::region::Margin;
use super::setup::DelayValue;
use super::variable::{Variable, power};
use crate::identify::problem::Problem;
use crate::identify::time::multiply;
use crate::num::least_squares::LeastSquares;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use std::sync::Arc;

/// A diagonal entry of R below this share of the largest one means that the lines do not determine the numerator.
const DEPENDENT: f64 = 1e-13;

/// Where the unknowns φ are: feedforward denominator, feedback numerator and denominator, delays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    /// Degree of the feedforward denominator.
    pub feedforward_degree: usize,
    /// Whether it is free (not of an FIR filter).
    pub feedforward_is_free: bool,
    /// Whether there is a feedback; one that is held at zero has no unknowns.
    pub has_feedback: bool,
    /// Degree of the feedback numerator.
    pub feedback_numerator: usize,
    /// Degree of the feedback denominator.
    pub feedback_denominator: usize,
    /// Whether the feedback's delay is free.
    pub feedback_delay_is_free: bool,
    /// Whether the feedforward's delay is free.
    pub feedforward_delay_is_free: bool,
}

/// What one unknown of φ is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unknown {
    /// Coefficient of this power of x in the feedforward denominator.
    FeedforwardDenominator(usize),
    /// Coefficient of this power of x in the feedback numerator.
    FeedbackNumerator(usize),
    /// Coefficient of this power of x in the feedback denominator.
    FeedbackDenominator(usize),
    /// The feedback's delay, times ω₀.
    FeedbackDelay,
    /// The feedforward's delay, times ω₀.
    FeedforwardDelay,
}

impl Unknown {
    /// The power of x that it multiplies, as a coefficient of the feedforward denominator.
    pub(super) fn feedforward_denominator(self) -> Option<usize> {
        if let Self::FeedforwardDenominator(power) = self { Some(power) } else { None }
    }

    /// The power of x that it multiplies, as a coefficient of the feedback numerator.
    pub(super) fn feedback_numerator(self) -> Option<usize> {
        if let Self::FeedbackNumerator(power) = self { Some(power) } else { None }
    }

    /// The power of x that it multiplies, as a coefficient of the feedback denominator.
    pub(super) fn feedback_denominator(self) -> Option<usize> {
        if let Self::FeedbackDenominator(power) = self { Some(power) } else { None }
    }

    /// The polynomial that it multiplies in the feedforward denominator.
    pub(super) fn in_feedforward(self) -> Option<Vec<f64>> {
        match self {
            Self::FeedforwardDenominator(p) => Some(power(p)),
            _ => None,
        }
    }

    /// The polynomial that it multiplies in `Dp Dfb + Np Nfb`, from the plant's polynomials in x.
    pub(super) fn in_loop(self, plant_numerator: &[f64], plant_denominator: &[f64]) -> Option<Vec<f64>> {
        match self {
            Self::FeedbackNumerator(p) => Some(multiply(plant_numerator, &power(p))),
            Self::FeedbackDenominator(p) => Some(multiply(plant_denominator, &power(p))),
            _ => None,
        }
    }
}

impl Layout {
    /// Whether the feedforward denominator has roots that could leave the region.
    pub(super) fn has_feedforward_margin(&self) -> bool {
        self.feedforward_is_free && self.feedforward_degree > 0
    }

    /// The unknowns, in order.
    pub(super) fn unknowns(&self) -> Vec<Unknown> {
        let mut unknowns = Vec::new();
        if self.feedforward_is_free {
            unknowns.extend((0..self.feedforward_degree).rev().map(Unknown::FeedforwardDenominator));
        }
        if self.has_feedback {
            unknowns.extend((0..=self.feedback_numerator).rev().map(Unknown::FeedbackNumerator));
            unknowns.extend((0..self.feedback_denominator).rev().map(Unknown::FeedbackDenominator));
        }
        unknowns.extend(self.feedback_delay_is_free.then_some(Unknown::FeedbackDelay));
        unknowns.extend(self.feedforward_delay_is_free.then_some(Unknown::FeedforwardDelay));
        unknowns
    }
}

/// The parts of a point φ, as polynomials in x (descending, denominators monic) and delays times ω₀.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Parts {
    /// `None` for an FIR filter, whose denominator is `z^n`.
    pub feedforward_denominator: Option<Vec<f64>>,
    pub feedback_numerator: Vec<f64>,
    pub feedback_denominator: Vec<f64>,
    pub feedback_delay: f64,
    pub feedforward_delay: f64,
}

/// The test of a loop with delay, in place of the smooth inequalities: given the parts, whether every root keeps the
/// margin.
pub(super) type DelayedLoop<'a> = Arc<dyn Fn(&Parts) -> bool + Send + Sync + 'a>;

/// The refinement of one problem.
#[derive(Clone)]
pub(super) struct Projection<'a> {
    pub problem: &'a Problem,
    pub variable: Variable,
    pub layout: Layout,
    pub unknowns: Vec<Unknown>,
    /// Delays where they are not free, times ω₀.
    pub fixed_feedback_delay: f64,
    pub fixed_feedforward_delay: f64,
    /// Smallest and largest delays where they are free, times ω₀.
    pub feedback_delay_range: [f64; 2],
    pub feedforward_delay_range: [f64; 2],
    /// The margins of the feedforward and of the loop; of the loop only where there is no delay.
    pub margins: Vec<Margin>,
    pub delayed_loop: Option<DelayedLoop<'a>>,
    /// Responses to fit, in place of the problem's: for resampling.
    pub response: Vec<Complex64>,
    /// Weights of the squared residuals.
    pub weight: Vec<f64>,
    /// x, and the numerator's basis functions, at the lines.
    x: Vec<Complex64>,
    basis: Vec<Vec<Complex64>>,
}

/// A point, with all that the derivatives need.
pub(super) struct Point {
    pub beta: DVector<f64>,
    pub residuals: DVector<f64>,
    /// `A`, 2K × (n+1).
    pub a: DMatrix<f64>,
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    pub values: Vec<Values>,
}

/// Polynomials and exponentials at a line.
#[derive(Clone, Copy)]
pub(super) struct Values {
    /// `Dff`, scaled so that the numerator in powers of s or z goes over it.
    pub dff: Complex64,
    /// `Nfb e^{−jωτ}`.
    pub nfb: Complex64,
    pub dfb: Complex64,
    /// `Dfb + G Nfb e^{−jωτ}`.
    pub l: Complex64,
    /// `e^{−jωτ}` of the feedback.
    pub feedback_turn: Complex64,
    /// `e^{−jωτff}`.
    pub turn: Complex64,
}

fn stacked(lines: usize, row: impl Fn(usize) -> Complex64) -> DVector<f64> {
    DVector::from_fn(2 * lines, |i, _| if i < lines { row(i).re } else { row(i - lines).im })
}

impl<'a> Projection<'a> {
    pub(super) fn new(problem: &'a Problem, variable: Variable, layout: Layout, margins: Vec<Margin>) -> Self {
        let lines = problem.lines();
        let basis = lines
            .iter()
            .enumerate()
            .map(|(k, line)| {
                let turn = Complex64::from_polar(1.0, -problem.basis().rotation(line.omega_rad_s));
                let even = problem.basis().even().values.iter().map(|v| turn * v[k]);
                let odd = problem.basis().odd().values.iter().map(|v| turn * Complex64::new(0.0, v[k]));
                even.chain(odd).collect()
            })
            .collect();
        Self {
            problem,
            variable,
            layout,
            unknowns: layout.unknowns(),
            fixed_feedback_delay: 0.0,
            fixed_feedforward_delay: 0.0,
            feedback_delay_range: [0.0, f64::INFINITY],
            feedforward_delay_range: [0.0, f64::INFINITY],
            margins,
            delayed_loop: None,
            response: lines.iter().map(|l| l.response).collect(),
            weight: lines.iter().map(|l| l.weight).collect(),
            x: lines.iter().map(|l| variable.at(l.omega_rad_s)).collect(),
            basis,
        }
    }

    /// Takes delays: fixed, or free in a range.
    pub(super) fn set_delays(&mut self, feedback: DelayValue, feedforward: DelayValue) {
        let in_units = |seconds: f64| seconds * self.variable.omega;
        self.fixed_feedback_delay = in_units(feedback.start_s);
        self.fixed_feedforward_delay = in_units(feedforward.start_s);
        if let Some(range) = feedback.range_s {
            self.feedback_delay_range = range.map(in_units);
        }
        if let Some(range) = feedforward.range_s {
            self.feedforward_delay_range = range.map(in_units);
        }
    }

    /// Coefficients of the feedforward numerator: none where the feedforward is held at zero.
    pub(super) fn numerator_size(&self) -> usize {
        self.basis.first().map_or(0, Vec::len)
    }

    /// Basis functions of the numerator at a line.
    pub(super) fn basis_at(&self, line: usize) -> &[Complex64] {
        &self.basis[line]
    }

    pub(super) fn parts(&self, phi: &[f64]) -> Parts {
        let layout = &self.layout;
        let mut rest = phi;
        let mut take = |count: usize| {
            let (head, tail) = rest.split_at(count);
            rest = tail;
            head.to_vec()
        };
        let monic = |low: Vec<f64>| [vec![1.0], low].concat();
        Parts {
            feedforward_denominator: layout.feedforward_is_free.then(|| monic(take(layout.feedforward_degree))),
            feedback_numerator: if layout.has_feedback { take(layout.feedback_numerator + 1) } else { vec![0.0] },
            feedback_denominator: monic(if layout.has_feedback { take(layout.feedback_denominator) } else { vec![] }),
            feedback_delay: if layout.feedback_delay_is_free { take(1)[0] } else { self.fixed_feedback_delay },
            feedforward_delay: if layout.feedforward_delay_is_free { take(1)[0] } else { self.fixed_feedforward_delay },
        }
    }

    /// What a polynomial that is monic in x has as its leading coefficient in powers of s or z, turned over: `Dff =
    /// unit^n · monic(x)`.
    fn feedforward_unit(&self) -> f64 {
        self.variable.unit.powi(self.layout.feedforward_degree as i32)
    }

    /// Everything at a line.
    pub(super) fn values(&self, parts: &Parts, k: usize) -> Values {
        let (x, line) = (self.x[k], &self.problem.lines()[k]);
        let at = |p: &[f64]| p.iter().fold(Complex64::new(0.0, 0.0), |sum, c| sum * x + c);
        let turned = |delay: f64| Complex64::from_polar(1.0, -delay * line.omega_rad_s / self.variable.omega);
        let dff = match &parts.feedforward_denominator {
            Some(p) => at(p) * self.feedforward_unit(),
            // An FIR filter's z^n, or 1.
            None => self.problem.time().point(line.omega_rad_s).powu(self.layout.feedforward_degree as u32),
        };
        let feedback_turn = turned(parts.feedback_delay);
        let nfb = at(&parts.feedback_numerator) * feedback_turn;
        let dfb = at(&parts.feedback_denominator);
        Values { dff, nfb, dfb, l: dfb + line.plant * nfb, feedback_turn, turn: turned(parts.feedforward_delay) }
    }

    /// `∂` of `√w (model)` at a line by an unknown: the factor of the numerator's value `N`, and the part without it.
    ///
    /// The model is `factor₀ N + rest₀`, with `factor₀ = G Dfb e^{−jωτff}/(Dff L)` and `rest₀ = G Nfb e^{−jωτ}/L`.
    pub(super) fn derivative(&self, values: &Values, k: usize, unknown: Unknown) -> (Complex64, Complex64) {
        let line = &self.problem.lines()[k];
        let (g, x) = (line.plant, self.x[k]);
        let Values { dff, nfb, dfb, l, turn, .. } = *values;
        let zero = Complex64::new(0.0, 0.0);
        let lead = g * turn / dff;
        let turning = self.turning(k);
        // ∂(Dfb/L) and ∂(G Nfb/L) by a change of Nfb, in L²: −G Dfb and G Dfb.
        let by_numerator = |change: Complex64| {
            let common = g * dfb / (l * l) * change;
            (-lead * common, common)
        };
        match unknown {
            Unknown::FeedforwardDenominator(power) => {
                (-lead * (dfb / l) / dff * self.feedforward_unit() * x.powu(power as u32), zero)
            }
            Unknown::FeedbackNumerator(power) => by_numerator(values.feedback_turn * x.powu(power as u32)),
            Unknown::FeedbackDenominator(power) => {
                let common = g * nfb / (l * l) * x.powu(power as u32);
                (lead * common, -common)
            }
            Unknown::FeedbackDelay => by_numerator(nfb * turning),
            Unknown::FeedforwardDelay => (lead * (dfb / l) * turning, zero),
        }
    }

    /// `∂ ln Gff` at a line by an unknown.
    pub(super) fn feedforward_log_derivative(&self, values: &Values, k: usize, unknown: Unknown) -> Complex64 {
        match unknown {
            Unknown::FeedforwardDenominator(power) => {
                -self.x[k].powu(power as u32) * self.feedforward_unit() / values.dff
            }
            Unknown::FeedforwardDelay => self.turning(k),
            _ => Complex64::new(0.0, 0.0),
        }
    }

    /// `∂ ln Gfb` at a line by an unknown.
    pub(super) fn feedback_log_derivative(&self, values: &Values, k: usize, unknown: Unknown) -> Complex64 {
        match unknown {
            Unknown::FeedbackNumerator(power) => self.x[k].powu(power as u32) * values.feedback_turn / values.nfb,
            Unknown::FeedbackDenominator(power) => -self.x[k].powu(power as u32) / values.dfb,
            Unknown::FeedbackDelay => self.turning(k),
            _ => Complex64::new(0.0, 0.0),
        }
    }

    /// `∂ ln e^{−jωτ}` by the delay times ω₀.
    fn turning(&self, k: usize) -> Complex64 {
        Complex64::new(0.0, -self.problem.lines()[k].omega_rad_s / self.variable.omega)
    }

    /// The factor of the numerator's value and the rest; see [`Projection::derivative`].
    pub(super) fn model(&self, values: &Values, k: usize) -> (Complex64, Complex64) {
        let g = self.problem.lines()[k].plant;
        (g * values.turn / values.dff * (values.dfb / values.l), g * values.nfb / values.l)
    }

    pub(super) fn point(&self, phi: &[f64]) -> Option<Point> {
        let parts = self.parts(phi);
        let lines = self.problem.lines().len();
        let size = self.numerator_size();
        let values: Vec<Values> = (0..lines).map(|k| self.values(&parts, k)).collect();
        let model: Vec<(Complex64, Complex64)> = (0..lines).map(|k| self.model(&values[k], k)).collect();
        let roots: Vec<f64> = self.weight.iter().map(|w| w.sqrt()).collect();
        let mut a = DMatrix::zeros(2 * lines, size);
        for i in 0..size {
            a.set_column(i, &stacked(lines, |k| roots[k] * model[k].0 * self.basis[k][i]));
        }
        let b = stacked(lines, |k| roots[k] * (self.response[k] - model[k].1));
        if a.iter().chain(b.iter()).any(|v| !v.is_finite()) {
            return None;
        }
        if size == 0 {
            // Nothing to project out: the feedforward is held at zero.
            let (q, r) = (DMatrix::zeros(2 * lines, 0), DMatrix::zeros(0, 0));
            return Some(Point { beta: DVector::zeros(0), residuals: -b, a, q, r, values });
        }
        let qr = a.clone().qr();
        let (q, r) = (qr.q(), qr.r());
        let diagonal = r.diagonal().map(f64::abs);
        if diagonal.min() <= DEPENDENT * diagonal.max() {
            return None;
        }
        let beta = r.solve_upper_triangular(&q.tr_mul(&b))?;
        let residuals = &a * &beta - b;
        Some(Point { beta, residuals, a, q, r, values })
    }

    /// `∂A_j` for an unknown, and `∂A_j β − ∂b_j`.
    fn columns(&self, point: &Point, unknown: Unknown) -> (DMatrix<f64>, DVector<f64>) {
        let lines = self.problem.lines().len();
        let derivative: Vec<(Complex64, Complex64)> = (0..lines)
            .map(|k| {
                let (factor, rest) = self.derivative(&point.values[k], k, unknown);
                (factor * self.weight[k].sqrt(), rest * self.weight[k].sqrt())
            })
            .collect();
        let mut da = DMatrix::zeros(2 * lines, point.beta.len());
        for i in 0..point.beta.len() {
            da.set_column(i, &stacked(lines, |k| derivative[k].0 * self.basis[k][i]));
        }
        let rest = stacked(lines, |k| derivative[k].1);
        let change = &da * &point.beta + rest;
        (da, change)
    }

    /// The Jacobian of the projected residual.
    fn projected(&self, point: &Point) -> Option<DMatrix<f64>> {
        let mut jacobian = DMatrix::zeros(point.residuals.len(), self.unknowns.len());
        for (j, unknown) in self.unknowns.iter().enumerate() {
            let (da, change) = self.columns(point, *unknown);
            if point.beta.is_empty() {
                jacobian.set_column(j, &change);
                continue;
            }
            let apart = &change - &point.q * point.q.tr_mul(&change);
            let back = point.r.tr_solve_upper_triangular(&da.tr_mul(&point.residuals))?;
            jacobian.set_column(j, &(apart - &point.q * back));
        }
        Some(jacobian)
    }

    /// The Jacobian of the residual by β and φ, none of them eliminated.
    pub(super) fn full(&self, point: &Point) -> DMatrix<f64> {
        let size = point.beta.len();
        let mut jacobian = DMatrix::zeros(point.residuals.len(), size + self.unknowns.len());
        jacobian.columns_mut(0, size).copy_from(&point.a);
        for (j, unknown) in self.unknowns.iter().enumerate() {
            jacobian.set_column(size + j, &self.columns(point, *unknown).1);
        }
        jacobian
    }
}

impl LeastSquares for Projection<'_> {
    fn unknowns(&self) -> usize {
        self.unknowns.len()
    }

    fn equations(&self) -> usize {
        2 * self.problem.lines().len()
    }

    fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool {
        let Some(point) = self.point(x) else { return false };
        if let Some(jacobian) = jacobian {
            let Some(projected) = self.projected(&point) else { return false };
            *jacobian = projected;
        }
        *residuals = point.residuals;
        true
    }

    fn bounds(&self) -> Vec<[f64; 2]> {
        self.unknowns
            .iter()
            .map(|unknown| match unknown {
                Unknown::FeedbackDelay => self.feedback_delay_range,
                Unknown::FeedforwardDelay => self.feedforward_delay_range,
                _ => [f64::NEG_INFINITY, f64::INFINITY],
            })
            .collect()
    }

    fn inequalities(&self) -> usize {
        self.margins.iter().map(Margin::len).sum()
    }

    fn constrain(&self, x: &[f64], values: &mut DVector<f64>, mut jacobian: Option<&mut DMatrix<f64>>) {
        let mut row = 0;
        for margin in &self.margins {
            let (own, slope) = margin.evaluate(x, jacobian.is_some());
            values.rows_mut(row, own.len()).copy_from_slice(&own);
            if let (Some(jacobian), Some(slope)) = (&mut jacobian, slope) {
                jacobian.rows_mut(row, own.len()).copy_from(&slope);
            }
            row += own.len();
        }
    }

    fn is_feasible(&self, x: &[f64]) -> bool {
        self.margins.iter().all(|margin| margin.holds(x))
            && self.delayed_loop.as_ref().is_none_or(|test| test(&self.parts(x)))
    }
}

#[cfg(test)]
mod tests;
