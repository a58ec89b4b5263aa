//! What an experiment costs with one subject: how far fits are from the truth, and how far the motion goes beyond the
//! limits.

use crate::control::Discrete;
use crate::control::parametric::{Differentiated, ParametricModel};
use crate::ctl::{Ctl, Stopped};
use crate::excite::sequence::{FilteredNoise, Generator, Screen, SequenceError, SequenceSpec};
use crate::num::least_squares::{LeastSquares, LeastSquaresError, Options, minimise};
use crate::num::rng::stream;
use crate::plants::head_neck::{COUNT, Drive, HeadNeck, Population};
use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use rand::RngExt;
use rayon::prelude::*;

/// States of the loop, and its inputs: the target as seen, and the muscle's noise.
const STATES: usize = 5;

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
    body: [f64; 3],
    /// Muscle noise in units of T_v.
    noise: Vec<f64>,
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

    fn body(&self, factors: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| self.population.body[i] * factors[i])
    }
}

/// The target as seen: straight between samples, zero before the first, `r(t_k − τ)`, and its derivative with respect
/// to τ.
fn seen(target: &[f64], tau: f64, period_s: f64) -> (Vec<f64>, Vec<f64>) {
    let back = tau / period_s;
    let at = |k: isize| usize::try_from(k).ok().and_then(|k| target.get(k)).copied().unwrap_or(0.0);
    (0..target.len())
        .map(|k| {
            let place = k as f64 - back;
            let low = place.floor();
            let (left, right) = (at(low as isize), at(low as isize + 1));
            (left + (place - low) * (right - left), -(right - left) / period_s)
        })
        .unzip()
}

/// The sampled loop with sizes known at compile time.
struct Loop {
    a: SMatrix<f64, STATES, STATES>,
    b: [SVector<f64, STATES>; 2],
    c: SMatrix<f64, 3, STATES>,
    noise_to_acceleration: f64,
}

impl Loop {
    fn new(model: &Differentiated<Discrete>) -> Self {
        let m = &model.value.model;
        Self {
            a: SMatrix::from_fn(|i, j| m.a()[(i, j)]),
            b: std::array::from_fn(|j| SVector::from_fn(|i, _| m.b()[(i, j)])),
            c: SMatrix::from_fn(|i, j| m.c()[(i, j)]),
            noise_to_acceleration: m.d()[(2, 1)],
        }
    }
}

/// The motion `[y, M, ÿ]` at every sample.
fn motion(model: &Loop, seen: &[f64], noise: &[f64]) -> Vec<[f64; 3]> {
    let mut x = SVector::<f64, STATES>::zeros();
    seen.iter()
        .zip(noise)
        .map(|(r, w)| {
            let y = model.c * x;
            let found = [y[0], y[1], y[2] + model.noise_to_acceleration * w];
            x = model.a * x + model.b[0] * *r + model.b[1] * *w;
            found
        })
        .collect()
}

/// The fit of one record: `min_{θ̂ ∈ Θ} Σ_k (ŷ_k − y_k)²` with the mean body and without noise.
struct Fit<'a> {
    setting: &'a Setting,
    target: &'a [f64],
    record: DVector<f64>,
}

impl LeastSquares for Fit<'_> {
    fn unknowns(&self) -> usize {
        4
    }

    fn equations(&self) -> usize {
        self.record.len()
    }

    fn bounds(&self) -> Vec<[f64; 2]> {
        self.setting.population.controller.to_vec()
    }

    fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool {
        let body = self.setting.population.body;
        let Some(model) = self.setting.model(x, body, jacobian.is_some()) else { return false };
        let (seen, turned) = seen(self.target, x[3], self.setting.time.period_s());
        let fixed = Loop::new(&model);
        let slopes: Vec<(SMatrix<f64, STATES, STATES>, SVector<f64, STATES>)> = model
            .slopes
            .iter()
            .map(|s| (SMatrix::from_fn(|i, j| s.a[(i, j)]), SVector::from_fn(|i, _| s.b[(i, 0)])))
            .collect();
        let mut state = SVector::<f64, STATES>::zeros();
        // ∂x/∂K_p, ∂x/∂K_d, ∂x/∂K_i and ∂x/∂τ; the angle is a state, so that C has no derivative.
        let mut moved = [SVector::<f64, STATES>::zeros(); 4];
        let mut jacobian = jacobian;
        for k in 0..self.record.len() {
            residuals[k] = state[0] - self.record[k];
            if let Some(jacobian) = jacobian.as_deref_mut() {
                for (j, dx) in moved.iter_mut().enumerate() {
                    jacobian[(k, j)] = dx[0];
                    *dx = fixed.a * *dx
                        + match slopes.get(j) {
                            Some((a, b)) => a * state + b * seen[k],
                            None => fixed.b[0] * turned[k],
                        };
                }
            }
            state = fixed.a * state + fixed.b[0] * seen[k];
        }
        residuals.iter().all(|r| r.is_finite())
    }
}

/// The cost of every draw for one subject and one target, on all threads of the pool.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub fn costs(
    setting: &Setting,
    theta: [f64; 4],
    target: &[f64],
    draws: &[Draw],
    ctl: &Ctl,
) -> Result<Vec<DrawCost>, Stopped> {
    draws.par_iter().map(|draw| cost(setting, theta, target, draw, ctl)).collect()
}

fn cost(setting: &Setting, theta: [f64; 4], target: &[f64], draw: &Draw, ctl: &Ctl) -> Result<DrawCost, Stopped> {
    ctl.check()?;
    let population = &setting.population;
    let out = DrawCost { error: f64::MAX, excursions: [0.0; 3], converged: false };
    let Some(model) = setting.model(&theta, setting.body(draw.body), false) else { return Ok(out) };
    let (seen, _) = seen(target, theta[3], setting.time.period_s());
    let noise: Vec<f64> = draw.noise.iter().map(|w| w * population.noise_nm).collect();
    let motion = motion(&Loop::new(&model), &seen, &noise);
    let record = DVector::from_iterator(motion.len(), motion.iter().map(|m| m[0]));
    let fit = Fit { setting, target, record };
    let options = Options { gradient_tolerance: 1e-5, max_evaluations: 60, ..Options::default() };
    let (found, converged) = match minimise(&fit, &theta, &options, ctl) {
        Ok(found) => (found.x, found.stop.is_converged()),
        Err(LeastSquaresError::Stopped(stopped)) => return Err(stopped),
        Err(_) => return Ok(out),
    };
    let error = found.iter().zip(theta).map(|(found, theta)| ((found - theta) / theta).powi(2)).sum();
    // Acceleration, torque and angle, in the order of the weights.
    let limits = [(2, population.acceleration_rad_s2), (1, population.torque_nm), (0, population.angle_rad)];
    let excursions = std::array::from_fn(|i| {
        let (column, limit) = limits[i];
        population.weights[i] / limit * motion.iter().map(|m| (m[column].abs() - limit).max(0.0)).sum::<f64>()
    });
    Ok(DrawCost { error, excursions, converged })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plants::head_neck::{Axis, DERIVATIVE_FILTER_S, MUSCLE_LAG_S};

    fn setting() -> Setting {
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
    fn the_derivatives_of_a_fit_are_those_of_its_residuals() {
        let setting = setting();
        let target = setting.target([0.8, 0.6], &Ctl::new()).unwrap();
        let fit = Fit { setting: &setting, target: &target, record: DVector::zeros(target.len()) };
        // No delay on a sample, where the seen target has a corner.
        let theta = [2.5, 0.25, 16.0, 0.2715];
        let (mut r, mut jacobian) = (DVector::zeros(target.len()), DMatrix::zeros(target.len(), 4));
        assert!(fit.evaluate(&theta, &mut r, Some(&mut jacobian)));
        for j in 0..4 {
            let h = 1e-5 * theta[j];
            let moved = |sign: f64| {
                let mut theta = theta;
                theta[j] += sign * h;
                let mut r = DVector::zeros(target.len());
                fit.evaluate(&theta, &mut r, None);
                r
            };
            let difference = (moved(1.0) - moved(-1.0)) / (2.0 * h);
            let error = (difference - jacobian.column(j)).norm() / jacobian.column(j).norm();
            assert!(error < 1e-6, "{j}: {error}");
        }
    }

    #[test]
    fn without_noise_and_spread_the_truth_is_found() {
        let mut setting = setting();
        setting.population.noise_nm = 0.0;
        let target = setting.target([0.8, 0.2], &Ctl::new()).unwrap();
        let draw = draws(&setting, 1, 1, "test");
        let found = costs(&setting, [2.5, 0.25, 16.0, 0.27], &target, &draw, &Ctl::new()).unwrap();
        assert!(found[0].converged && found[0].error < 1e-12, "{found:?}");
        // The excursions of a motion that is computed here anew.
        let wide = setting.target([0.8, 2.0], &Ctl::new()).unwrap();
        let found = costs(&setting, [2.5, 0.25, 16.0, 0.27], &wide, &draw, &Ctl::new()).unwrap()[0];
        let model = setting.model(&[2.5, 0.25, 16.0, 0.27], setting.population.body, false).unwrap();
        let (seen, _) = seen(&wide, 0.27, 0.02);
        let input = DMatrix::from_fn(wide.len(), 2, |k, j| if j == 0 { seen[k] } else { 0.0 });
        let output = model.respond(&input).unwrap().output;
        for (i, (column, limit, weight)) in [(2, 6.36, 70.0), (1, 7.87, 63.6), (0, 0.218, 21.8)].into_iter().enumerate()
        {
            let sum: f64 = output.column(column).iter().filter(|y| y.abs() > limit).map(|y| y.abs() - limit).sum();
            assert!((found.excursions[i] - weight * sum / limit).abs() < 1e-9 * (1.0 + sum), "{i} {found:?}");
        }
        assert!(found.excursions[2] > 0.0);
    }

    #[test]
    fn the_seen_target_is_late() {
        let (late, slope) = seen(&[0.0, 1.0, 3.0, 3.0], 0.05, 0.1);
        assert_eq!(late, [0.0, 0.5, 2.0, 3.0]);
        assert_eq!(slope[2], -20.0);
        assert_eq!(seen(&[1.0, 2.0], 1.0, 0.1).0, [0.0, 0.0]);
    }
}
