//! One refinement, and the controllers that it ends with.

use super::delayed_loop::{delayed_loop, slowest_exponent};
use super::projection::{Layout, Parts, Projection, Unknown};
use super::region::Margin;
use super::setup::{DelayValue, RefineError, Setup, Start};
use super::variable::{Variable, power};
use crate::control::{Continuous, System, TransferFunction};
use crate::ctl::Ctl;
use crate::identify::held::Held;
use crate::identify::problem::{Line, Problem};
use crate::identify::time::{Time, multiply};
use crate::num::Polynomial;
use crate::num::least_squares::{self, Active, LeastSquaresError, Minimum, Options, Stop};
use num_complex::Complex64;

/// A residual norm below this share of the data's is rounding.
const ROUNDING: f64 = 1e-14;

/// A constraint that holds the optimum back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
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
    pub(super) setup: Setup<'a>,
    pub(super) projection: Projection<'a>,
    pub(super) minimum: Minimum,
    pub(super) start_cost: f64,
}

/// The refined controllers.
#[derive(Debug, Clone, PartialEq)]
pub struct Refined {
    /// Gff, without its delay.
    pub feedforward: System,
    /// Gfb, without its delay.
    pub feedback: System,
    /// The feedback's delay in seconds.
    pub feedback_delay_s: f64,
    /// The feedforward's delay in seconds.
    pub feedforward_delay_s: f64,
    /// J.
    pub cost: f64,
    /// J of the coefficients as written here.
    pub cost_of_coefficients: f64,
    /// J of the start.
    pub start_cost: f64,
    /// Poles of the closed loop: of the feedforward, then of the feedback loop; in continuous time a loop with delay
    /// has infinitely many, and none of them is listed.
    pub closed_loop_poles: Vec<Complex64>,
    /// Largest real part of the exponents of all poles in 1/s, those of a loop with delay included; `None` where there
    /// is no pole with a finite one.
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

impl<'a> Refinement<'a> {
    /// Refines from a start, without delay.
    ///
    /// # Errors
    /// [`RefineError`].
    pub fn new(setup: Setup<'a>, start: &Start, ctl: &Ctl) -> Result<Self, RefineError> {
        Self::with_delays(setup, start, [DelayValue::NONE; 2], ctl)
    }

    /// Refines from a start with delays in feedback and feedforward, in this order.
    ///
    /// # Errors
    /// [`RefineError`].
    pub fn with_delays(
        setup: Setup<'a>,
        start: &Start,
        delays: [DelayValue; 2],
        ctl: &Ctl,
    ) -> Result<Self, RefineError> {
        let (projection, phi) = prepared(setup, start, delays)?;
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
        let parts = self.projection.parts(&self.minimum.x);
        let delays =
            [parts.feedback_delay, parts.feedforward_delay].map(|delay| delay / self.projection.variable.omega);
        let model = closed_loop(self.setup.problem, &feedforward, &feedback, delays)?;
        let (closed_loop_poles, slowest_exponent) = self.poles(&feedforward, &feedback, delays[0])?;
        let cost_of_coefficients =
            self.lines().iter().zip(&model).map(|(line, model)| line.weight * (model - line.response).norm_sqr()).sum();
        Ok(Refined {
            feedforward,
            feedback,
            feedback_delay_s: delays[0],
            feedforward_delay_s: delays[1],
            cost: self.minimum.cost,
            cost_of_coefficients,
            start_cost: self.start_cost,
            slowest_exponent,
            closed_loop_poles,
            gradient_cosine: self.minimum.gradient_cosine,
            stop: self.minimum.stop,
            active: self.active(),
            iterations: self.minimum.iterations,
            evaluations: self.minimum.residual_evaluations,
            model,
        })
    }

    pub(super) fn lines(&self) -> &[Line] {
        self.setup.problem.lines()
    }

    pub(super) fn controllers(&self) -> Result<(System, System), RefineError> {
        let parts = self.projection.parts(&self.minimum.x);
        let point = self.projection.point(&self.minimum.x).ok_or(RefineError::NotFinite)?;
        written(&self.projection, &parts, point.beta.as_slice())
    }

    /// Poles, and the largest real part of their exponents.
    fn poles(
        &self,
        feedforward: &System,
        feedback: &System,
        feedback_delay_s: f64,
    ) -> Result<(Vec<Complex64>, Option<f64>), RefineError> {
        let Setup { problem, plant, margin_per_s, .. } = self.setup;
        let time = problem.time();
        let mut poles = feedforward.den().roots().map_err(|_| RefineError::NotFinite)?;
        let (open, gain) = (plant.den().mul(feedback.den()), plant.num().mul(feedback.num()));
        let mut slowest = None;
        match time {
            Time::Continuous if feedback_delay_s > 0.0 => {
                slowest = slowest_exponent(open.coefficients(), gain.coefficients(), feedback_delay_s, margin_per_s);
            }
            _ => {
                let samples = time.sample_time_s().map_or(0, |t| (feedback_delay_s / t).round() as usize);
                let open = Polynomial::new([open.coefficients(), &vec![0.0; samples]].concat());
                poles.extend(open.add(&gain).roots().map_err(|_| RefineError::NotFinite)?);
            }
        }
        let listed = time.slowest_exponent(&poles).filter(|e| e.is_finite());
        Ok((poles, listed.into_iter().chain(slowest).reduce(f64::max)))
    }

    /// The largest real part of the feedback loop's exponents at a point, its delay included; `None` where it is
    /// outside the margin.
    pub(super) fn loop_exponent(&self, phi: &[f64]) -> Option<f64> {
        let parts = self.projection.parts(phi);
        let beta = vec![0.0; self.projection.numerator_size()];
        let (_, feedback) = written(&self.projection, &parts, &beta).ok()?;
        let Setup { problem, plant, margin_per_s, .. } = self.setup;
        let (open, gain) = (plant.den().mul(feedback.den()), plant.num().mul(feedback.num()));
        let delay_s = parts.feedback_delay / self.projection.variable.omega;
        match problem.time() {
            Time::Continuous if delay_s > 0.0 => {
                slowest_exponent(open.coefficients(), gain.coefficients(), delay_s, margin_per_s)
            }
            time => {
                let samples = time.sample_time_s().map_or(0, |t| (delay_s / t).round() as usize);
                let open = Polynomial::new([open.coefficients(), &vec![0.0; samples]].concat());
                time.slowest_exponent(&open.add(&gain).roots().ok()?)
            }
        }
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
                    Unknown::FeedforwardDelay => ActiveConstraint::FeedforwardDelay,
                    _ => ActiveConstraint::FeedbackDelay,
                },
            })
            .collect();
        if self.minimum.stop == Stop::Blocked {
            // Only the loop with delay is judged by a yes-or-no test.
            active.push(ActiveConstraint::LoopMargin);
        }
        active.dedup();
        active
    }
}

/// The projection of a problem, with its margins around a start, and the start itself.
pub(super) fn prepared<'a>(
    setup: Setup<'a>,
    start: &Start,
    [feedback_delay, feedforward_delay]: [DelayValue; 2],
) -> Result<(Projection<'a>, Vec<f64>), RefineError> {
    let Setup { problem, plant, structure, margin_per_s } = setup;
    let variable = Variable::new(problem.time(), problem.lines());
    let layout = Layout {
        feedforward_degree: structure.feedforward_denominator,
        feedforward_is_free: structure.feedforward_denominator_is_free,
        has_feedback: structure.held != Some(Held::Feedback),
        feedback_numerator: structure.feedback_numerator,
        feedback_denominator: structure.feedback_denominator,
        feedback_delay_is_free: feedback_delay.range_s.is_some(),
        feedforward_delay_is_free: feedforward_delay.range_s.is_some(),
    };
    let mut phi = Vec::new();
    if layout.feedforward_is_free {
        let what = "feedforward denominator";
        phi.extend(lower_coefficients(&variable, &start.feedforward_denominator, layout.feedforward_degree, what)?);
    }
    if layout.has_feedback {
        let unit = variable.unit.powi(layout.feedback_denominator as i32);
        let numerator = padded(&start.feedback_numerator, layout.feedback_numerator, "feedback numerator")?;
        phi.extend(variable.enter(&numerator).iter().map(|c| c / unit));
        let what = "feedback denominator";
        phi.extend(lower_coefficients(&variable, &start.feedback_denominator, layout.feedback_denominator, what)?);
    }

    let mut margins = Vec::new();
    let unknowns = layout.unknowns();
    if layout.has_feedforward_margin() {
        let degree = layout.feedforward_degree;
        let terms: Vec<Option<Vec<f64>>> = unknowns.iter().map(|unknown| unknown.in_feedforward()).collect();
        // Delays move no root of the feedforward's denominator.
        let mut start = phi.clone();
        start.resize(terms.len(), 0.0);
        let margin = Margin::new(&variable, margin_per_s, &power(degree), &terms, degree, &start);
        margins.push(margin.ok_or(RefineError::OnTheEdge("feedforward"))?);
    }
    let (np, dp) = (variable.enter(plant.num().coefficients()), variable.enter(plant.den().coefficients()));
    let in_units = |seconds: f64| seconds * variable.omega;
    if !feedback_delay.is_none() {
        phi.extend(feedback_delay.range_s.map(|_| in_units(feedback_delay.start_s)));
        phi.extend(feedforward_delay.range_s.map(|_| in_units(feedforward_delay.start_s)));
        let mut projection = Projection::new(problem, variable, layout, margins);
        projection.set_delays(feedback_delay, feedforward_delay);
        projection.delayed_loop = Some(delayed_loop(variable, problem.time(), np, dp, margin_per_s));
        return Ok((projection, phi));
    }
    let degree = plant.den().degree() + layout.feedback_denominator;
    let terms: Vec<Option<Vec<f64>>> = unknowns.iter().map(|unknown| unknown.in_loop(&np, &dp)).collect();
    let base = multiply(&dp, &power(layout.feedback_denominator));
    phi.extend(feedforward_delay.range_s.map(|_| in_units(feedforward_delay.start_s)));
    // Without feedback the loop is the plant, whose poles no unknown moves: the pool has seen to them.
    if degree > 0 && layout.has_feedback {
        let margin = Margin::new(&variable, margin_per_s, &base, &terms, degree, &phi);
        margins.push(margin.ok_or(RefineError::OnTheEdge("feedback loop"))?);
    }
    let mut projection = Projection::new(problem, variable, layout, margins);
    projection.set_delays(feedback_delay, feedforward_delay);
    Ok((projection, phi))
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

/// The response from command to output at the lines, with delays in feedback and feedforward.
fn closed_loop(
    problem: &Problem,
    feedforward: &System,
    feedback: &System,
    [feedback_delay_s, feedforward_delay_s]: [f64; 2],
) -> Result<Vec<Complex64>, RefineError> {
    let at = |p: &Polynomial| problem.at_lines(p.coefficients());
    let (nff, dff, nfb, dfb) = (at(feedforward.num()), at(feedforward.den()), at(feedback.num()), at(feedback.den()));
    let model: Vec<Complex64> = problem
        .lines()
        .iter()
        .enumerate()
        .map(|(k, line)| {
            let turned = |delay: f64| Complex64::from_polar(1.0, -delay * line.omega_rad_s);
            let delayed = nfb[k] * turned(feedback_delay_s);
            let top = nff[k] * turned(feedforward_delay_s) * dfb[k] + delayed * dff[k];
            line.plant * top / (dff[k] * (dfb[k] + line.plant * delayed))
        })
        .collect();
    if model.iter().all(|m| m.norm().is_finite()) { Ok(model) } else { Err(RefineError::NotFinite) }
}

#[cfg(test)]
mod tests;
