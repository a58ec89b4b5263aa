//! The climb: from an input that keeps to the limits to one that tells more, step by step.
//!
//! # Why every step climbs
//! The sensitivities `S(u)` are affine in u, and `M = SᵀS ⪰ S₀ᵀS + SᵀS₀ − S₀ᵀS₀ =: L(u)` with equality at u₀, where the
//! gradients are the same. All criteria grow with M, so that their value at `L(u)`, a concave function of u, is below
//! the criterion everywhere and touches it at u₀: a minorant. Of T it is linear, and [`step()`] maximises it over the
//! limits; of D and A the step maximises its tangent, and a search along the step finds the best share of it. Limits on
//! the input and on outputs are convex, and hold along the step. The autocorrelation is not, and a share of the step is
//! taken that keeps it; where none above a small one does, the trust region is halved.
//!
//! # When it ends
//! The bound of a step's linear program says what no step within the region gains more than, to first order. The climb
//! has converged where that is no more than the tolerance within the region that it began with, whatever regions it
//! used on its way; a step that happened to gain little is no reason to end.

use super::information::{Criterion, Information, factor};
use super::limits::{Broken, Limits};
use super::step::{Row, Step, step};
use crate::convex::box_lp::BoxLpError;
use crate::ctl::{Ctl, Stopped};
use nalgebra::DMatrix;
use std::collections::BTreeSet;

/// How the climb goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// What is made large.
    pub criterion: Criterion,
    /// δ_u: the largest change of a sample in a step, in units of the input.
    pub radius: f64,
    /// Relative growth that no step may gain more than where the climb has converged; where a step that was taken grows
    /// less, the trust region is halved.
    pub tolerance: f64,
    /// The trust region is not halved below this share of what it begins with.
    pub least_radius: f64,
    /// Steps at most, refused ones included.
    pub max_steps: usize,
}

/// Why it ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// No step within the whole trust region gains more than the tolerance, to first order.
    Converged,
    /// The trust region has become as small as it may.
    SmallestRegion,
    /// The steps ran out.
    StepLimit,
}

/// What it came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Climb {
    /// The input.
    pub input: Vec<f64>,
    /// The factor by which the criterion has grown; see [`factor`].
    pub factor: f64,
    /// That factor after each step taken.
    pub history: Vec<f64>,
    /// Steps taken.
    pub steps: usize,
    /// Linear programs solved.
    pub programs: usize,
    /// Steps of the interior-point method in all.
    pub iterations: usize,
    /// A step from the input over the whole trust region, not taken: its bound proves how much more is to be had, to
    /// first order.
    pub last: Step,
    /// That bound as relative growth: what [`factor`] of a step would exceed 1 by at most.
    pub left: f64,
    /// δ_u of that step: what the climb began with.
    pub radius: f64,
    /// The last trust region that was used, no larger.
    pub used_radius: f64,
    /// Why it ended.
    pub stop: Stop,
}

/// Why there is no climb.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ClimbError {
    /// The start has the wrong length.
    #[error("the start has {found} samples, and the record {expected}")]
    Length {
        /// Samples of the start.
        found: usize,
        /// Samples of the record.
        expected: usize,
    },
    /// The start breaks a limit.
    #[error("the start breaks a limit: {0}")]
    Broken(Broken),
    /// The start does not determine the parameters, so that no variance can be made smaller.
    #[error("the start carries no information about some combination of the parameters")]
    Undetermined,
    /// A linear program could not be set up: a number overflows.
    #[error("a step could not be computed: {0}")]
    Program(BoxLpError),
    /// Somebody asked to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

impl From<BoxLpError> for ClimbError {
    fn from(error: BoxLpError) -> Self {
        match error {
            BoxLpError::Stopped(stopped) => Self::Stopped(stopped),
            error => Self::Program(error),
        }
    }
}

/// Shares of a step below this are not worth taking: the trust region is halved.
const LEAST_SHARE: f64 = 0.05;
/// A step of which more than this share was taken lets the trust region grow again.
const LARGE_SHARE: f64 = 0.5;
/// By what a share is shortened until the limits hold.
const SHORTER: f64 = 0.8;
/// Points of the first look along a step.
const LOOKS: usize = 8;
/// Halvings of the interval around the best of them.
const NARROWINGS: usize = 30;

/// Climbs from a start that keeps to the limits. Progress advances by one for each step.
///
/// # Errors
/// [`ClimbError`].
pub fn climb(
    information: &Information,
    limits: &Limits,
    start: &[f64],
    settings: &Settings,
    ctl: &Ctl,
) -> Result<Climb, ClimbError> {
    if start.len() != information.samples() {
        return Err(ClimbError::Length { found: start.len(), expected: information.samples() });
    }
    if let Some(broken) = limits.broken(start) {
        return Err(ClimbError::Broken(broken));
    }
    let criterion = settings.criterion;
    let parameters = information.parameters();
    let mut u = start.to_vec();
    let mut sensitivities = information.sensitivities(&u);
    let first = information.of(&sensitivities).value(criterion).filter(|v| v.is_finite() && *v != 0.0);
    let first = first.ok_or(ClimbError::Undetermined)?;
    let mut value = first;
    let mut radius = settings.radius;
    let mut active: BTreeSet<Row> = BTreeSet::new();
    let (mut history, mut programs, mut iterations, mut tried) = (Vec::new(), 0, 0, 0);
    let growth = |bound: f64, value: f64| growth(criterion, bound, value, parameters);
    let stop = loop {
        ctl.check()?;
        let gradient = information.gradient(criterion, &sensitivities).ok_or(ClimbError::Undetermined)?;
        let found = step(limits, &u, &gradient, radius, &mut active, ctl)?;
        programs += found.rounds;
        iterations += found.iterations;
        if radius == settings.radius && growth(found.bound, value) <= settings.tolerance {
            break Stop::Converged;
        }
        tried += 1;
        ctl.advance(1);
        let change: Vec<f64> = found.direction.iter().map(|d| radius * d).collect();
        let forced = information.forced(&change);
        let along = information.along(&sensitivities, &forced);
        let mut share = best_share(information, criterion, &along);
        let next = |share: f64| -> Vec<f64> {
            let sample = |(u, d): (&f64, &f64)| (u + share * d).clamp(limits.input[0], limits.input[1]);
            u.iter().zip(&change).map(sample).collect()
        };
        let mut candidate = next(share);
        while share >= LEAST_SHARE && limits.broken(&candidate).is_some() {
            share *= SHORTER;
            candidate = next(share);
        }
        let grown = information.scaled(&along[0] + &along[1] * share + &along[2] * share * share).value(criterion);
        let grown = grown.filter(|grown| share >= LEAST_SHARE && *grown > value);
        let mut relative = 0.0;
        if let Some(grown) = grown {
            relative = factor(criterion, grown, value, parameters) - 1.0;
            u = candidate;
            sensitivities = information.sensitivities(&u);
            // Anew from the input: sums of changes would drift.
            value = information.of(&sensitivities).value(criterion).ok_or(ClimbError::Undetermined)?;
            history.push(factor(criterion, value, first, parameters));
        }
        if relative < settings.tolerance {
            radius *= 0.5;
        } else if share > LARGE_SHARE {
            radius = (2.0 * radius).min(settings.radius);
        }
        if radius < settings.least_radius * settings.radius {
            radius *= 2.0;
            break Stop::SmallestRegion;
        }
        if tried >= settings.max_steps {
            break Stop::StepLimit;
        }
    };
    let gradient = information.gradient(criterion, &sensitivities).ok_or(ClimbError::Undetermined)?;
    let last = step(limits, &u, &gradient, settings.radius, &mut active, ctl)?;
    programs += last.rounds;
    iterations += last.iterations;
    let left = growth(last.bound, value);
    let is_converged = left <= settings.tolerance;
    Ok(Climb {
        input: u,
        factor: factor(criterion, value, first, parameters),
        steps: history.len(),
        history,
        programs,
        iterations,
        last,
        left,
        radius: settings.radius,
        used_radius: radius,
        stop: if is_converged { Stop::Converged } else { stop },
    })
}

/// What a growth of the criterion is of it: the share by which [`factor`] then exceeds 1.
fn growth(criterion: Criterion, gain: f64, value: f64, parameters: usize) -> f64 {
    if criterion == Criterion::D { (gain / parameters as f64).exp_m1() } else { gain / value.abs() }
}

/// The share of a step at which the criterion is largest; 1 for T, which is convex.
fn best_share(information: &Information, criterion: Criterion, along: &[DMatrix<f64>; 3]) -> f64 {
    if !criterion.needs_inverse() {
        return 1.0;
    }
    let value = |share: f64| {
        let matrix = &along[0] + &along[1] * share + &along[2] * share * share;
        information.scaled(matrix).value(criterion).unwrap_or(f64::NEG_INFINITY)
    };
    let best = (1..=LOOKS)
        .map(|i| i as f64 / LOOKS as f64)
        .map(|share| (share, value(share)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(1.0, |(share, _)| share);
    let width = 1.0 / LOOKS as f64;
    let (mut low, mut high) = ((best - width).max(0.0), (best + width).min(1.0));
    for _ in 0..NARROWINGS {
        let (left, right) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if value(left) < value(right) { low = left } else { high = right }
    }
    let ends = [best, 0.5 * (low + high)];
    if value(ends[1]) > value(ends[0]) { ends[1] } else { ends[0] }
}
