//! Where the climbs start, and the fit from all of them.
//!
//! The centre is the user's, where every parameter has a start; otherwise the gains of the free fit of
//! [`innovation`](crate::likelihood::innovation), where what was recorded allows one, turned into the costs that come
//! nearest to them, or else the likeliest of many draws around the natural scales of the plant. Where nothing but draws
//! is known the next likeliest draws that are apart from it are starts too; all others lie around the centre, by at
//! most [`SPREAD`] in each logarithm.

use super::climb::{Climbed, climb};
use super::design::{Design, Plant, Role};
use super::explanations::{coefficients_of_filter, coefficients_of_regulator};
use super::recursion::Problem;
use crate::ctl::{Ctl, Phase, Stopped};
use crate::num::rng;
use nalgebra::DMatrix;
use rand::RngExt;

/// Starts lie around the centre by at most this in each logarithm.
pub const SPREAD: f64 = 1.5;
/// Draws that the centre is chosen from.
const DRAWS: usize = 150;
/// Draws that starts are taken from at most.
const CENTRES: usize = 8;
/// Draws lie around the natural scale of a matrix by at most this in the logarithm, all its terms together.
const COMMON: f64 = 8.0;
/// Samples over which the natural scales are taken.
const HORIZON: usize = 20;
/// Bounds lie around the centre by this in each logarithm: a factor of a hundred million either way.
const REACH: f64 = 18.420_680_743_952_367;
/// Climbs that end within this of the best log likelihood have arrived there.
pub const ARRIVED: f64 = 1e-3;
/// Coefficients of gains below this share of the largest one are started there.
const LEAST_SHARE: f64 = 1e-3;

/// The matrices whose terms are drawn together.
const ROLES: [Role; 10] = [
    Role::StateWeight,
    Role::PerceivedProcessNoise,
    Role::ProcessNoise,
    Role::MeasurementNoise,
    Role::MotorNoise,
    Role::TerminalWeight,
    Role::ControlWeight,
    Role::PerceivedMeasurementNoise,
    Role::InitialCovariance,
    Role::ControlDependentNoise,
];
/// Where noise that grows with the control is started, as a share of it.
const GROWN: f64 = 0.3;

/// The most likely parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The best climb.
    pub best: Climbed,
    /// All climbs that came to an end, in the order of their starts.
    pub climbs: Vec<Climbed>,
    /// Starts, with those that no climb came from.
    pub starts: usize,
    /// Bounds of the parameters.
    pub bounds: Vec<[f64; 2]>,
}

/// Why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// Somebody asked to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// No start has a finite likelihood.
    #[error("none of {starts} starts has a finite likelihood")]
    NoStart {
        /// Starts and draws.
        starts: usize,
    },
}

/// Finds the most likely parameters from so many starts; `gains` are K (m×n) and the predictor's L (n×p) of a free fit,
/// where there is one.
///
/// # Errors
/// [`FitError`].
pub fn fit(
    problem: &Problem<'_>,
    gains: Option<[&DMatrix<f64>; 2]>,
    starts: usize,
    seed: u64,
    ctl: &Ctl,
) -> Result<Fit, FitError> {
    let design = problem.design();
    let mut stream = rng::stream(seed, "lqg fit starts");
    let natural = natural_scales(problem);
    let written: Option<Vec<f64>> = design.free().map(|term| term.start.map(f64::ln)).collect();
    let centres = match written {
        Some(written) => vec![written],
        None => {
            let mut base = natural.clone();
            if let Some([k, l]) = gains {
                for (role, found) in [
                    (Role::StateWeight, coefficients_of_regulator(design, k)),
                    (Role::PerceivedProcessNoise, coefficients_of_filter(design, l)),
                ] {
                    put(design, role, found.as_deref(), &mut base);
                }
            }
            let mut centres = drawn(problem, &natural, &base, gains.is_some(), &mut stream, ctl)?;
            if gains.is_some() {
                centres.truncate(1);
            }
            centres
        }
    };
    let centre = &centres[0];
    let bounds: Vec<[f64; 2]> = centre.iter().map(|v| [v - REACH, v + REACH]).collect();
    let free = vec![true; centre.len()];
    ctl.enter(Phase::Fit, 0.4);
    ctl.set_total(starts as u64);
    let mut climbs: Vec<Climbed> = Vec::new();
    for index in 0..starts {
        // Draws that are apart may lie on other hills.
        let is_drawn = index < centres.len();
        let mut around = |v: &f64| v + if is_drawn { 0.0 } else { SPREAD * (2.0 * stream.random::<f64>() - 1.0) };
        let from = &centres[if is_drawn { index } else { 0 }];
        let start: Vec<f64> = from.iter().map(&mut around).collect();
        climbs.extend(climb(problem, &start, &free, &bounds, ctl)?);
        ctl.advance(1);
    }
    let likelihood = |c: &Climbed| c.evaluation.log_likelihood;
    let best = climbs.iter().max_by(|x, y| likelihood(x).total_cmp(&likelihood(y))).cloned();
    let best = best.ok_or(FitError::NoStart { starts })?;
    Ok(Fit { best, climbs, starts, bounds })
}

impl Fit {
    /// Climbs that ended at this log likelihood or above.
    #[must_use]
    pub fn arrived(&self, log_likelihood: f64) -> usize {
        self.climbs.iter().filter(|c| c.evaluation.log_likelihood >= log_likelihood - ARRIVED).count()
    }
}

/// Writes the logarithms of the coefficients of a role's free terms, where there are any.
fn put(design: &Design, role: Role, found: Option<&[f64]>, into: &mut [f64]) {
    let Some(found) = found else { return };
    let largest = found.iter().copied().fold(0.0, f64::max);
    if largest <= 0.0 {
        return;
    }
    let places = design.free().enumerate().filter(|(_, term)| term.role == role);
    for ((at, _), value) in places.zip(found) {
        into[at] = value.max(LEAST_SHARE * largest).ln();
    }
}

/// The likeliest draws, apart from each other: around the base, in all roles that it does not know.
fn drawn(
    problem: &Problem<'_>,
    natural: &[f64],
    base: &[f64],
    knows_gains: bool,
    stream: &mut rng::Stream,
    ctl: &Ctl,
) -> Result<Vec<Vec<f64>>, FitError> {
    let design = problem.design();
    let of_gains = |role: Role| matches!(role, Role::StateWeight | Role::PerceivedProcessNoise);
    let mut all: Vec<(f64, Vec<f64>)> = Vec::new();
    ctl.set_total(DRAWS as u64);
    for index in 0..DRAWS {
        let roles = ROLES;
        let common = roles.map(|_| 2.0 * stream.random::<f64>() - 1.0);
        let own: Vec<f64> = base.iter().map(|_| 2.0 * stream.random::<f64>() - 1.0).collect();
        // Every third draw leaves the gains of a free fit alone, and varies the noises.
        let keeps = knows_gains && index % 3 != 2;
        let theta: Vec<f64> = design
            .free()
            .enumerate()
            .map(|(i, term)| {
                if let Some(start) = term.start {
                    return start.ln();
                }
                if keeps && of_gains(term.role) {
                    return base[i];
                }
                if index == 0 {
                    return natural[i];
                }
                let role = roles.iter().position(|role| *role == term.role).unwrap_or(0);
                natural[i] + COMMON * common[role] + own[i]
            })
            .collect();
        let found = problem.evaluate(&theta, false, ctl)?;
        ctl.advance(1);
        let Some(found) = found else { continue };
        all.push((found.log_likelihood, theta));
    }
    all.sort_by(|(x, _), (y, _)| y.total_cmp(x));
    let mut apart: Vec<Vec<f64>> = Vec::new();
    for (_, theta) in all {
        let is_near = |other: &Vec<f64>| other.iter().zip(&theta).all(|(x, y)| (x - y).abs() <= SPREAD);
        if apart.len() < CENTRES && !apart.iter().any(is_near) {
            apart.push(theta);
        }
    }
    if apart.is_empty() { Err(FitError::NoStart { starts: DRAWS }) } else { Ok(apart) }
}

/// Logarithms of coefficients of a natural size: of Q those for which 20 samples of the states that a control leaves
/// behind cost what it costs itself, of R the other way round, of W_p those for which the noise of 20 samples moves the
/// outputs as much as V_p does; V by the roughness of the recorded outputs, W and M by that of V as W_p by V_p.
fn natural_scales(problem: &Problem<'_>) -> Vec<f64> {
    let design = problem.design();
    let (plant, own) = (&design.plant, design.internal());
    let [_, m, p, _] = design.sizes();
    // Along Aᵏ, which may grow: what overflows is no scale.
    let gathered = |first: &DMatrix<f64>, shape: &DMatrix<f64>| {
        let mut x = first.clone();
        let mut sum = 0.0;
        for _ in 0..HORIZON {
            sum += (x.tr_mul(&(shape * &x))).trace();
            x = &own.a * x;
        }
        sum
    };
    let seen = |plant: &Plant, shape: &DMatrix<f64>| {
        let mut x = plant.c.transpose();
        let mut sum = 0.0;
        for _ in 0..HORIZON {
            sum += (x.tr_mul(&(shape * &x))).trace();
            x = plant.a.tr_mul(&x);
        }
        sum
    };
    let rough = problem.roughness();
    let mean_rough = rough.iter().sum::<f64>() / rough.len() as f64;
    let ratio = |x: f64, y: f64| if x > 0.0 && y > 0.0 { (x / y).ln() } else { 0.0 };
    // With coefficients of one where they are not known.
    let unit = vec![0.0; design.free().count()];
    let sum = |role: Role, base: &DMatrix<f64>| design.sum(&unit, role, base, false).matrix();
    let square = DMatrix::zeros(own.a.nrows(), own.a.nrows());
    let weight = sum(Role::StateWeight, &square) + sum(Role::TerminalWeight, &square);
    let effort = sum(Role::ControlWeight, &design.control_weight).trace() / m as f64;
    let perceived = sum(Role::PerceivedMeasurementNoise, &design.perceived_measurement_noise).trace();
    // An instrument apart shows other outputs than those that are sensed.
    let of_sensed = |shape: &DMatrix<f64>| {
        let weights = shape.diagonal();
        if weights.len() == rough.len() {
            let sum = weights.iter().zip(&rough).map(|(w, r)| w * r).sum::<f64>();
            ratio(sum, weights.norm_squared())
        } else {
            ratio(mean_rough, shape.trace())
        }
    };
    design
        .free()
        .map(|term| match term.role {
            Role::StateWeight | Role::TerminalWeight => ratio(effort, gathered(&own.b, &term.shape)),
            Role::ControlWeight => ratio(gathered(&own.b, &weight), term.shape.trace() / m as f64),
            Role::PerceivedProcessNoise | Role::InitialCovariance => ratio(perceived, seen(own, &term.shape)),
            Role::ProcessNoise => ratio(mean_rough * p as f64, seen(plant, &term.shape)),
            Role::MeasurementNoise | Role::PerceivedMeasurementNoise => of_sensed(&term.shape),
            Role::MotorNoise => {
                ratio(mean_rough * p as f64, seen(plant, &(&plant.b * &term.shape * plant.b.transpose())))
            }
            Role::ControlDependentNoise => GROWN.ln(),
        })
        .map(|v| if v.is_finite() { v } else { 0.0 })
        .collect()
}
