//! What an experiment costs with one subject: how far fits are from the truth, and how far the motion goes beyond the
//! limits.

use super::fit::{Fitted, fits};
use super::motion::{Excursions, motions};
use crate::control::Discrete;
use crate::control::parametric::{Differentiated, ParametricModel};
use crate::ctl::{Ctl, Stopped};
use crate::excite::sequence::{FilteredNoise, Generator, Screen, SequenceError, SequenceSpec};
use crate::num::rng::stream;
use crate::plants::head_neck::{COUNT, Drive, HeadNeck, Population};
use rand::RngExt;
use rayon::prelude::*;

/// The cosine between residual and derivatives at which a fit has converged, while experiments are compared and in the
/// figures that are reported.
pub const TOLERANCE: [f64; 2] = [1e-3, 1e-5];
/// Subjects whose mean response the average subject is fitted to: as many as the thesis has.
pub const AVERAGED: usize = 8;
/// Draws that one thread simulates and fits together, at least and at most: enough to fill the lanes of a processor,
/// and few enough for a stop to be seen in time.
const LEAST_TOGETHER: usize = 8;
const MOST_TOGETHER: usize = 64;
/// Delays this near to a whole number of samples are one.
const WHOLE: f64 = 1e-9;
/// Between two steps of the target that the average subject is fitted with, s.
const STEP_S: f64 = 2.5;

/// Everything but θ and γ.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// Who takes part.
    pub population: Population,
    /// Bodies are drawn uniformly within this share of their mean, each part on its own.
    pub body_spread: f64,
    /// T_m, s: declared.
    pub muscle_lag_s: f64,
    /// T_f, s: declared.
    pub derivative_filter_s: f64,
    /// Time between samples; the muscle's noise is held over a sample.
    pub time: Discrete,
    /// Length of the record, s.
    pub duration_s: f64,
    /// Distance of the person from the screen, m.
    pub distance_m: f64,
    /// Standard deviation of the target's noise before it is cut to ±0.5 and shown on the screen.
    pub noise_rms: f64,
    /// Seed of the target's noise.
    pub target_seed: u64,
}

/// What is drawn at random for one simulated record.
#[derive(Debug, Clone, PartialEq)]
pub struct Draw {
    /// Factors on I, b and k.
    pub(super) body: [f64; 3],
    /// Muscle noise in units of T_v.
    pub(super) noise: Vec<f64>,
}

/// The parts of the cost in one draw.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DrawCost {
    /// `Σ ((θ̂ − θ)/θ)²`.
    pub error: f64,
    /// L_a, L_T and L_n of this draw.
    pub excursions: [f64; 3],
    /// Whether the fit converged; where it did not, the best that it found counts.
    pub converged: bool,
}

impl DrawCost {
    /// Their sum.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.error + self.excursions.iter().sum::<f64>()
    }
}

/// Draws number 0 to `count` − 1 of a seed and a purpose.
#[must_use]
pub fn draws(setting: &Setting, count: usize, seed: u64, purpose: &str) -> Vec<Draw> {
    let samples = setting.samples();
    (0..count)
        .map(|j| {
            let mut random = stream(seed, &format!("excite/robust/{purpose}/{j}"));
            let spread = setting.body_spread;
            let body = std::array::from_fn(|_| 1.0 + spread * (2.0 * random.random::<f64>() - 1.0));
            let noise = (0..samples).map(|_| 2.0 * random.random::<f64>() - 1.0).collect();
            Draw { body, noise }
        })
        .collect()
}

impl Setting {
    /// Samples of a record.
    #[must_use]
    pub fn samples(&self) -> usize {
        (self.duration_s / self.time.period_s()).round() as usize
    }

    /// The target of an experiment, as a sequence.
    #[must_use]
    pub fn target_spec(&self, gamma: [f64; 2]) -> SequenceSpec {
        let noise = FilteredNoise {
            edge_hz: gamma[0],
            transition_hz: 0.5,
            ripple_db: 3.0,
            attenuation_db: 40.0,
            duration_s: self.duration_s,
            rms: self.noise_rms,
            limit: Some(0.5),
            screen: Some(Screen { width_m: gamma[1], distance_m: self.distance_m }),
            taper: 0.1,
            seed: self.target_seed,
        };
        SequenceSpec::new(Generator::FilteredNoise(noise), self.time.period_s())
    }

    /// Its samples, rad.
    ///
    /// # Errors
    /// [`SequenceError`], for edges beyond the Nyquist frequency and the like.
    pub fn target(&self, gamma: [f64; 2], ctl: &Ctl) -> Result<Vec<f64>, SequenceError> {
        Ok(self.target_spec(gamma).check()?.sample(ctl)?.values)
    }

    /// The loop with a controller and a body, sampled; with derivatives with respect to K_p, K_d and K_i if asked.
    #[must_use]
    pub fn model(&self, theta: &[f64], body: [f64; 3], slopes: bool) -> Option<Differentiated<Discrete>> {
        let [inertia, damping, stiffness] = body;
        let values: [f64; COUNT] = [
            theta[0],
            theta[1],
            theta[2],
            theta[3],
            inertia,
            damping,
            stiffness,
            self.muscle_lag_s,
            self.derivative_filter_s,
        ];
        let free = if slopes { vec![0, 1, 2] } else { Vec::new() };
        let model = HeadNeck::new(values, free, Drive::SeenTargetAndNoise).ok()?;
        model.differentiate(&model.nominal()).ok()?.sampled(self.time).ok()
    }

    /// T_m and T_f.
    pub(super) fn times(&self) -> [f64; 2] {
        [self.muscle_lag_s, self.derivative_filter_s]
    }

    /// The angle of a subject with a draw's body and noise.
    pub(super) fn angle(&self, theta: [f64; 4], target: &[f64], draw: &Draw) -> Option<Vec<f64>> {
        motions(self, theta, target, std::slice::from_ref(draw)).pop()?.map(|(angle, _)| angle)
    }

    /// θ_A: the subject whose response fits the mean response of [`AVERAGED`] subjects best, as the thesis has it of
    /// its preliminary trials (§2.2.3), in which the target steps. The subjects are drawn uniformly from the
    /// population, bodies and muscle noise with them. The middle of the population where no fit is possible.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn average_subject(&self, seed: u64, ctl: &Ctl) -> Result<[f64; 4], Stopped> {
        let boxes = self.population.controller;
        let middle = boxes.map(|[lower, upper]| 0.5 * (lower + upper));
        let period = (STEP_S / self.time.period_s()).max(1.0);
        let size = 0.5 * self.population.angle_rad;
        let target: Vec<f64> =
            (0..self.samples()).map(|k| if (k as f64 / period) as usize % 2 == 1 { size } else { 0.0 }).collect();
        let mut mean = vec![0.0; target.len()];
        let mut random = stream(seed, "excite/robust/average");
        for draw in draws(self, AVERAGED, seed, "average") {
            let theta = boxes.map(|[lower, upper]| lower + (upper - lower) * random.random::<f64>());
            let Some(angle) = self.angle(theta, &target, &draw) else { return Ok(middle) };
            for (sum, y) in mean.iter_mut().zip(angle) {
                *sum += y / AVERAGED as f64;
            }
        }
        let fitted = fits(self, &target, &[&mean], middle, TOLERANCE[1], ctl)?.pop().flatten();
        Ok(fitted.map_or(middle, |found| found.theta))
    }

    /// The body of a draw.
    pub(super) fn body(&self, factors: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| self.population.body[i] * factors[i])
    }
}

/// The target as seen: straight between samples, zero before the first, `r(t_k − τ)`.
pub(super) fn seen(target: &[f64], tau: f64, period_s: f64) -> Vec<f64> {
    let (whole, share) = delay(tau, period_s);
    let at = |k: Option<usize>| k.and_then(|k| target.get(k)).copied().unwrap_or(0.0);
    (0..target.len())
        .map(|k| {
            let (left, right) = (at(k.checked_sub(whole)), at((k + 1).checked_sub(whole)));
            left + share * (right - left)
        })
        .collect()
}

/// The delay τ = (D − f) T as whole samples D and the share f of one.
pub(super) fn delay(tau: f64, period_s: f64) -> (usize, f64) {
    let back = tau / period_s;
    // A whole number but for rounding is one: the target's slope is that after the corner.
    let near = back.round();
    let whole = if (back - near).abs() < WHOLE { near } else { back.ceil() };
    (whole as usize, (whole - back).max(0.0))
}

/// A record, and how far its motion went beyond the limits.
type Moved = (Vec<f64>, Excursions);

/// The cost of every draw for one subject and one target, on all threads of the pool. Where the excursions alone, which
/// need no fit, cost `enough` on average, their costs are returned without errors: a lower bound.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub fn costs(
    setting: &Setting,
    theta: [f64; 4],
    target: &[f64],
    draws: &[Draw],
    tolerance: f64,
    enough: f64,
    ctl: &Ctl,
) -> Result<Vec<DrawCost>, Stopped> {
    // As many at once as keep every thread busy; whatever their number, each draw's cost is the same.
    let together = draws.len().div_ceil(rayon::current_num_threads()).clamp(LEAST_TOGETHER, MOST_TOGETHER);
    let moved: Vec<Vec<Option<Moved>>> = draws
        .par_chunks(together)
        .map(|draws| {
            ctl.check()?;
            Ok(motions(setting, theta, target, draws))
        })
        .collect::<Result<_, Stopped>>()?;
    let moved: Vec<Option<(Vec<f64>, DrawCost)>> = moved
        .into_iter()
        .flatten()
        .map(|found| {
            let (record, excursions) = found?;
            Some((record, DrawCost { error: 0.0, excursions, converged: false }))
        })
        .collect();
    let out = DrawCost { error: f64::MAX, excursions: [0.0; 3], converged: false };
    let known: f64 = moved.iter().map(|found| found.as_ref().map_or(f64::MAX, |(_, cost)| cost.total())).sum();
    if known >= enough * draws.len() as f64 {
        return Ok(moved.into_iter().map(|found| found.map_or(out, |(_, cost)| cost)).collect());
    }
    let found: Vec<Vec<DrawCost>> = moved
        .par_chunks(together)
        .map(|moved| {
            let records: Vec<&[f64]> = moved.iter().flatten().map(|(record, _)| record.as_slice()).collect();
            let mut fitted = fits(setting, target, &records, theta, tolerance, ctl)?.into_iter();
            let cost = |(_, cost): &(Vec<f64>, DrawCost), fitted: Option<Fitted>| {
                let Some(fitted) = fitted else { return out };
                let error =
                    fitted.theta.iter().zip(theta).map(|(found, theta)| ((found - theta) / theta).powi(2)).sum();
                DrawCost { error, converged: fitted.converged, ..*cost }
            };
            let each =
                moved.iter().map(|moved| moved.as_ref().map_or(out, |moved| cost(moved, fitted.next().flatten())));
            Ok(each.collect())
        })
        .collect::<Result<_, Stopped>>()?;
    Ok(found.into_iter().flatten().collect())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::plants::head_neck::{Axis, DERIVATIVE_FILTER_S, MUSCLE_LAG_S};
    use nalgebra::DMatrix;

    pub(in crate::excite::robust) fn setting() -> Setting {
        Setting {
            population: Axis::FlexionExtension.population(),
            body_spread: 0.0,
            muscle_lag_s: MUSCLE_LAG_S,
            derivative_filter_s: DERIVATIVE_FILTER_S,
            time: Discrete::new(0.02).unwrap(),
            duration_s: 8.0,
            distance_m: 3.0,
            noise_rms: 0.25,
            target_seed: 1,
        }
    }

    #[test]
    fn without_noise_and_spread_the_truth_is_found() {
        let mut setting = setting();
        setting.population.noise_nm = 0.0;
        let target = setting.target([0.8, 0.2], &Ctl::new()).unwrap();
        let draw = draws(&setting, 1, 1, "test");
        let found = costs(&setting, [2.5, 0.25, 16.0, 0.27], &target, &draw, 1e-5, f64::INFINITY, &Ctl::new()).unwrap();
        assert!(found[0].converged && found[0].error < 1e-12, "{found:?}");
        // The excursions of a motion that is computed here anew.
        let wide = setting.target([0.8, 2.0], &Ctl::new()).unwrap();
        let found =
            costs(&setting, [2.5, 0.25, 16.0, 0.27], &wide, &draw, 1e-5, f64::INFINITY, &Ctl::new()).unwrap()[0];
        let model = setting.model(&[2.5, 0.25, 16.0, 0.27], setting.population.body, false).unwrap();
        let seen = seen(&wide, 0.27, 0.02);
        let input = DMatrix::from_fn(wide.len(), 2, |k, j| if j == 0 { seen[k] } else { 0.0 });
        let output = model.respond(&input).unwrap().output;
        for (i, (column, limit, weight)) in [(2, 6.36, 70.0), (1, 7.87, 63.6), (0, 0.218, 21.8)].into_iter().enumerate()
        {
            let sum: f64 = output.column(column).iter().filter(|y| y.abs() > limit).map(|y| y.abs() - limit).sum();
            assert!((found.excursions[i] - weight * sum / limit).abs() < 1e-9 * (1.0 + sum), "{i} {found:?}");
        }
        assert!(found.excursions[2] > 0.0);
        // Excursions alone are a lower bound, and need no fit.
        let bound = costs(&setting, [2.5, 0.25, 16.0, 0.27], &wide, &draw, 1e-5, 1e-9, &Ctl::new()).unwrap()[0];
        assert_eq!((bound.error, bound.excursions), (0.0, found.excursions));
    }

    #[test]
    fn the_average_subject_is_found_where_all_are_alike() {
        let mut alike = setting();
        let one = [2.5, 0.25, 16.0, 0.27];
        alike.population.noise_nm = 0.0;
        alike.population.controller = one.map(|v| [v * (1.0 - 1e-9), v * (1.0 + 1e-9)]);
        let found = alike.average_subject(3, &Ctl::new()).unwrap();
        assert!(found.iter().zip(one).all(|(found, one)| (found / one - 1.0).abs() < 1e-8), "{found:?}");
        // Of unlike subjects it is within the population, and no element-wise mean.
        let setting = setting();
        let found = setting.average_subject(3, &Ctl::new()).unwrap();
        for (value, [lower, upper]) in found.into_iter().zip(setting.population.controller) {
            assert!((lower..=upper).contains(&value));
        }
        assert_ne!(found, setting.population.controller.map(|[lower, upper]| 0.5 * (lower + upper)));
    }

    #[test]
    fn the_seen_target_is_late() {
        assert_eq!(seen(&[0.0, 1.0, 3.0, 3.0], 0.05, 0.1), [0.0, 0.5, 2.0, 3.0]);
        assert_eq!(seen(&[1.0, 2.0, 4.0], 0.1, 0.1), [0.0, 1.0, 2.0]);
        assert_eq!(seen(&[1.0, 2.0], 1.0, 0.1), [0.0, 0.0]);
        // A whole number of samples but for rounding.
        assert_eq!(delay(0.24, 0.02), (12, 0.0));
        assert_eq!(delay(0.3 - 0.06 + 1e-13, 0.02).0, 12);
        let (whole, share) = delay(0.237, 0.02);
        assert!(whole == 12 && (share - 0.15).abs() < 1e-12);
    }
}
