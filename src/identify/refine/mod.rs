//! Refinement: from the best candidate of a pool to a local optimum of all coefficients, the stability margin kept.
//!
//! ```text
//! minimise  J = Σ weight_k |G̃(jω_k) − H_k|²,   G̃ = G (Gff + Gfb)/(1 + G Gfb)
//! over      Nff, Dff (unless FIR), Nfb, Dfb (denominators monic), and delays where asked for
//! subject   every root of Dff and of Dp Dfb + Np Nfb inside the pool's region
//! ```
//! The numerator of the feedforward is projected out (Golub and Pereyra 1973); the others go by Levenberg-Marquardt with the
//! margins as smooth inequalities ([`least_squares`]). The pool's grids and gain limits do not bind the refined controllers, its
//! region does. A local optimum is what the equations say near one candidate; only the pool's optimum is a global one, and of the pool.

mod bootstrap;
mod projection;
mod region;
mod residuals;
mod uncertainty;
mod variable;

use super::identifiability::Structure;
use super::problem::{Line, Problem};
use super::time::{Time, multiply};
use crate::control::two_dof::TwoDegreesOfFreedom;
use crate::control::{Continuous, System, TransferFunction};
use crate::num::least_squares::{self, Active, LeastSquaresError, Minimum, Options, Stop};
use crate::num::{Ctl, Polynomial, Stopped};
pub use bootstrap::{Bootstrap, BootstrapBand};
use num_complex::Complex64;
use projection::{Layout, Parts, Projection};
use region::Margin;
pub use residuals::ResidualTests;
pub use uncertainty::{Band, LEVEL, Noise, Parameter, Unavailable, Uncertainty};
use variable::Variable;

/// A residual norm below this share of the data's is rounding.
const ROUNDING: f64 = 1e-14;

/// What is refined on.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    /// Lines and numerator basis.
    pub problem: &'a Problem,
    /// The plant, in the time base of the controllers.
    pub plant: &'a System,
    /// Degrees, and what is free.
    pub structure: Structure,
    /// Exponents of the closed loop keep real parts below minus this, in 1/s.
    pub margin_per_s: f64,
}

/// Controllers to start from, in descending powers of s or z; they must keep the margin.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// Denominator of the feedforward; monic.
    pub feedforward_denominator: Vec<f64>,
    /// Numerator of the feedback.
    pub feedback_numerator: Vec<f64>,
    /// Denominator of the feedback; monic.
    pub feedback_denominator: Vec<f64>,
}

impl Start {
    /// The denominators and the feedback of identified controllers.
    #[must_use]
    pub fn of(feedforward: &System, feedback: &System) -> Self {
        Self {
            feedforward_denominator: feedforward.den().coefficients().to_vec(),
            feedback_numerator: feedback.num().coefficients().to_vec(),
            feedback_denominator: feedback.den().coefficients().to_vec(),
        }
    }
}

/// Why nothing was refined.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RefineError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// The start does not keep the margin, or lies on its edge to working precision.
    #[error("the {0} of the start lies on the edge of the stability margin to working precision")]
    OnTheEdge(&'static str),
    /// A polynomial has another degree than the structure says.
    #[error("the {0} of the start has another degree than the structure")]
    Degree(&'static str),
    /// The residuals or the refined coefficients overflow, or the lines do not determine the numerator.
    #[error("the residuals or coefficients are not finite")]
    NotFinite,
}

/// A constraint that holds the optimum back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActiveConstraint {
    /// A pole of the feedforward lies on the stability margin.
    FeedforwardMargin,
    /// A pole of the feedback loop lies on the stability margin.
    LoopMargin,
    /// The feedback's delay is at its smallest or largest value.
    FeedbackDelay,
    /// The feedforward's delay is at its smallest or largest value.
    FeedforwardDelay,
}

/// A refined optimum, ready for questions about it.
pub struct Refinement<'a> {
    setup: Setup<'a>,
    projection: Projection<'a>,
    minimum: Minimum,
    start_cost: f64,
}

/// The refined controllers.
#[derive(Debug, Clone, PartialEq)]
pub struct Refined {
    /// Gff, without its delay.
    pub feedforward: System,
    /// Gfb, without its delay.
    pub feedback: System,
    /// J.
    pub cost: f64,
    /// J of the coefficients as written here.
    pub cost_of_coefficients: f64,
    /// J of the start.
    pub start_cost: f64,
    /// Poles of the closed loop: of the feedforward, then of the feedback loop.
    pub closed_loop_poles: Vec<Complex64>,
    /// Largest real part of their exponents in 1/s; `None` where there is no pole with a finite one.
    pub slowest_exponent: Option<f64>,
    /// The cosine that proves stationarity; see [`least_squares`].
    pub gradient_cosine: f64,
    /// Why it stopped.
    pub stop: Stop,
    /// What holds it back.
    pub active: Vec<ActiveConstraint>,
    /// Steps taken.
    pub iterations: usize,
    /// Evaluations of the residual.
    pub evaluations: usize,
    /// The modelled response at the lines.
    pub model: Vec<Complex64>,
}

fn padded(p: &[f64], degree: usize, what: &'static str) -> Result<Vec<f64>, RefineError> {
    let missing = (degree + 1).checked_sub(p.len()).ok_or(RefineError::Degree(what))?;
    Ok([vec![0.0; missing], p.to_vec()].concat())
}

/// A denominator in powers of x, monic, without its leading one.
fn lower_coefficients(
    variable: &Variable,
    p: &[f64],
    degree: usize,
    what: &'static str,
) -> Result<Vec<f64>, RefineError> {
    if p.len() != degree + 1 || p[0] == 0.0 {
        return Err(RefineError::Degree(what));
    }
    let entered = variable.enter(p);
    Ok(entered[1..].iter().map(|c| c / entered[0]).collect())
}

/// `x^power` as a polynomial.
fn power(power: usize) -> Vec<f64> {
    [vec![1.0], vec![0.0; power]].concat()
}

impl<'a> Refinement<'a> {
    /// Refines from a start.
    ///
    /// # Errors
    /// [`RefineError`].
    pub fn new(setup: Setup<'a>, start: &Start, ctl: &Ctl) -> Result<Self, RefineError> {
        let (projection, phi) = prepared(setup, start)?;
        let options = Options { residual_floor: ROUNDING * data_norm(&projection), ..Options::default() };
        let start_cost = projection.point(&phi).ok_or(RefineError::NotFinite)?.residuals.norm_squared();
        let minimum = least_squares::minimise(&projection, &phi, &options, ctl).map_err(|error| match error {
            LeastSquaresError::Stopped(stopped) => RefineError::Stopped(stopped),
            LeastSquaresError::InfeasibleStart => RefineError::OnTheEdge("loop"),
            LeastSquaresError::NotFinite => RefineError::NotFinite,
        })?;
        Ok(Self { setup, projection, minimum, start_cost })
    }

    /// The controllers, with their proof.
    ///
    /// # Errors
    /// [`RefineError::NotFinite`] where coefficients in powers of s or z overflow.
    pub fn refined(&self) -> Result<Refined, RefineError> {
        let (feedforward, feedback) = self.controllers()?;
        let (closed_loop_poles, model) = closed_loop(self.setup.plant, &feedforward, &feedback, self.lines())?;
        let cost_of_coefficients =
            self.lines().iter().zip(&model).map(|(line, model)| line.weight * (model - line.response).norm_sqr()).sum();
        let time = self.setup.problem.time();
        Ok(Refined {
            feedforward,
            feedback,
            cost: self.minimum.cost,
            cost_of_coefficients,
            start_cost: self.start_cost,
            slowest_exponent: time.slowest_exponent(&closed_loop_poles).filter(|e| e.is_finite()),
            closed_loop_poles,
            gradient_cosine: self.minimum.gradient_cosine,
            stop: self.minimum.stop,
            active: self.active(),
            iterations: self.minimum.iterations,
            evaluations: self.minimum.residual_evaluations,
            model,
        })
    }

    fn lines(&self) -> &[Line] {
        self.setup.problem.lines()
    }

    fn controllers(&self) -> Result<(System, System), RefineError> {
        let parts = self.projection.parts(&self.minimum.x);
        let point = self.projection.point(&self.minimum.x).ok_or(RefineError::NotFinite)?;
        written(&self.projection, &parts, point.beta.as_slice())
    }

    fn active(&self) -> Vec<ActiveConstraint> {
        let feedforward =
            if self.projection.layout.has_feedforward_margin() { self.projection.margins[0].len() } else { 0 };
        let mut active: Vec<ActiveConstraint> = self
            .minimum
            .active
            .iter()
            .map(|active| match *active {
                Active::Inequality(i) if i < feedforward => ActiveConstraint::FeedforwardMargin,
                Active::Inequality(_) => ActiveConstraint::LoopMargin,
                Active::Lower(i) | Active::Upper(i) => match self.projection.unknowns[i] {
                    projection::Unknown::FeedforwardDelay => ActiveConstraint::FeedforwardDelay,
                    _ => ActiveConstraint::FeedbackDelay,
                },
            })
            .collect();
        active.dedup();
        active
    }
}

/// The projection of a problem, with its margins around a start, and the start itself.
fn prepared<'a>(setup: Setup<'a>, start: &Start) -> Result<(Projection<'a>, Vec<f64>), RefineError> {
    let Setup { problem, plant, structure, margin_per_s } = setup;
    let variable = Variable::new(problem.time(), problem.lines());
    let layout = Layout {
        feedforward_degree: structure.feedforward_denominator,
        feedforward_is_free: structure.feedforward_denominator_is_free,
        feedback_numerator: structure.feedback_numerator,
        feedback_denominator: structure.feedback_denominator,
        feedback_delay_is_free: false,
        feedforward_delay_is_free: false,
    };
    let mut phi = Vec::new();
    if layout.feedforward_is_free {
        let what = "feedforward denominator";
        phi.extend(lower_coefficients(&variable, &start.feedforward_denominator, layout.feedforward_degree, what)?);
    }
    let unit = variable.unit.powi(layout.feedback_denominator as i32);
    let numerator = padded(&start.feedback_numerator, layout.feedback_numerator, "feedback numerator")?;
    phi.extend(variable.enter(&numerator).iter().map(|c| c / unit));
    let what = "feedback denominator";
    phi.extend(lower_coefficients(&variable, &start.feedback_denominator, layout.feedback_denominator, what)?);

    let mut margins = Vec::new();
    let unknowns = layout.unknowns();
    if layout.has_feedforward_margin() {
        let degree = layout.feedforward_degree;
        let terms: Vec<Option<Vec<f64>>> = unknowns.iter().map(|unknown| unknown.in_feedforward()).collect();
        let margin = Margin::new(&variable, margin_per_s, &power(degree), &terms, degree, &phi);
        margins.push(margin.ok_or(RefineError::OnTheEdge("feedforward"))?);
    }
    let (np, dp) = (variable.enter(plant.num().coefficients()), variable.enter(plant.den().coefficients()));
    let degree = plant.den().degree() + layout.feedback_denominator;
    let terms: Vec<Option<Vec<f64>>> = unknowns.iter().map(|unknown| unknown.in_loop(&np, &dp)).collect();
    let base = multiply(&dp, &power(layout.feedback_denominator));
    if degree > 0 {
        let margin = Margin::new(&variable, margin_per_s, &base, &terms, degree, &phi);
        margins.push(margin.ok_or(RefineError::OnTheEdge("feedback loop"))?);
    }
    Ok((Projection::new(problem, variable, layout, margins), phi))
}

fn data_norm(projection: &Projection<'_>) -> f64 {
    let squares = projection.response.iter().zip(&projection.weight).map(|(h, w)| w * h.norm_sqr());
    squares.sum::<f64>().sqrt()
}

/// The controllers in powers of s or z.
fn written(projection: &Projection<'_>, parts: &Parts, beta: &[f64]) -> Result<(System, System), RefineError> {
    let (variable, layout, basis) = (&projection.variable, &projection.layout, projection.problem.basis());
    let (even, odd) = beta.split_at(basis.even().len());
    let numerator = basis.numerator(even, odd);
    let monic = |p: &[f64]| {
        let mut left = variable.leave(p);
        let lead = left[0];
        left.iter_mut().for_each(|c| *c /= lead);
        left
    };
    let denominator =
        parts.feedforward_denominator.as_ref().map_or_else(|| power(layout.feedforward_degree), |p| monic(p));
    let unit = variable.unit.powi(layout.feedback_denominator as i32);
    let feedback: Vec<f64> = variable.leave(&parts.feedback_numerator).iter().map(|c| c * unit).collect();
    let time = projection.problem.time();
    Ok((system(time, &numerator, &denominator)?, system(time, &feedback, &monic(&parts.feedback_denominator))?))
}

fn system(time: Time, num: &[f64], den: &[f64]) -> Result<System, RefineError> {
    match time {
        Time::Continuous => TransferFunction::new(num, den, Continuous).map(System::Continuous),
        Time::Sampled(time) => TransferFunction::new(num, den, time).map(System::Discrete),
    }
    .map_err(|_| RefineError::NotFinite)
}

/// Poles, and the response from command to output at the lines.
fn closed_loop(
    plant: &System,
    feedforward: &System,
    feedback: &System,
    lines: &[Line],
) -> Result<(Vec<Complex64>, Vec<Complex64>), RefineError> {
    let lp = |a: &Polynomial, b: &Polynomial| a.mul(b);
    let loop_polynomial = lp(plant.den(), feedback.den()).add(&lp(plant.num(), feedback.num()));
    let mut poles = feedforward.den().roots().map_err(|_| RefineError::NotFinite)?;
    poles.extend(loop_polynomial.roots().map_err(|_| RefineError::NotFinite)?);
    let response = |omega: f64| match (plant, feedforward, feedback) {
        (System::Continuous(g), System::Continuous(ff), System::Continuous(fb)) => {
            TwoDegreesOfFreedom::new(g.clone(), ff.clone(), fb.clone()).ok().map(|l| l.command_to_output(omega))
        }
        (System::Discrete(g), System::Discrete(ff), System::Discrete(fb)) => {
            TwoDegreesOfFreedom::new(g.clone(), ff.clone(), fb.clone()).ok().map(|l| l.command_to_output(omega))
        }
        _ => None,
    };
    let model: Option<Vec<Complex64>> = lines.iter().map(|line| response(line.omega_rad_s)).collect();
    Ok((poles, model.ok_or(RefineError::NotFinite)?))
}

#[cfg(test)]
mod tests;
