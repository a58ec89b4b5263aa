//! A simulated human subject, for demonstrations and tests.
//!
//! What it does is chosen, not measured: plausible numbers for a person at a joystick, so that every station of the
//! product has something to work on whose truth is known. The laws lie outside the model class that SSID fits (a delay,
//! a preview), so a fit has honest misfit.

use super::inverse_dynamics::{ApproximateInverse, InverseError};
use crate::control::bode::log_grid;
use crate::control::conversion::{self, ConversionError};
use crate::control::discretise::{self, DiscretiseError};
use crate::control::simulate::SimulationError;
use crate::control::time_base::BadSampleTime;
use crate::control::{Continuous, Discrete, StateSpace, TransferFunction};
use crate::num::linalg::NoConvergence;
use crate::num::rng;
use crate::trial::{Signals, Trial, TrialError};
use nalgebra::DVector;
use num_complex::Complex64;
use rand::RngExt;
use rand_distr::StandardNormal;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where in the band of usual commands (0 – 0.5 Hz) the preview makes up for the delay of mirrored zeros, rad/s.
const PREVIEW_OMEGA_RAD_S: f64 = 2.0;

/// Time over which the preview fades in at the start of a trial, s.
const FADE_IN_S: f64 = 1.0;

/// Poles with a real part above this fraction of their magnitude are unstable; the rest counts as rounding.
const POLE_ROUNDING: f64 = 1e-9;

/// Who a simulated subject is. Drawn from a seed by [`SubjectParameters::draw`], or given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SubjectParameters {
    /// Reaction delay of the feedback, s.
    pub delay_s: f64,
    /// Time constant of the neuromuscular lag in the feedback, s.
    pub lag_s: f64,
    /// How hard the subject corrects: the peak of the sensitivity `|1/(1 + G Gfb)|` that it lets happen (above 1).
    pub sensitivity_peak: f64,
    /// The untaught feedforward gain, as a fraction of 1/|G| at 1 rad/s.
    pub initial_gain: f64,
    /// Time constant with which the inverse dynamics are smoothed, s.
    pub smoothing_s: f64,
    /// Fraction of the delay of nonminimum-phase zeros that the subject learns to anticipate.
    pub preview_fraction: f64,
    /// Share of the inverse dynamics in the feedforward after endless practice, 0 to 1.
    pub learning_limit: f64,
    /// Trials after which the subject has gone 63 % of the way there.
    pub learning_trials: f64,
    /// Standard deviation of the share from trial to trial.
    pub learning_scatter: f64,
    /// Standard deviation of the remnant, as a fraction of the rms of the ideal control.
    pub remnant: f64,
    /// Time constant that colours the remnant, s.
    pub remnant_lag_s: f64,
}

impl SubjectParameters {
    /// The parameters of the subject with this seed, uniform over ranges usual for manual tracking (delays and lags as
    /// in McRuer and Jex 1967); nonminimum-phase inverse dynamics are learned more slowly and less far.
    #[must_use]
    pub fn draw(seed: u64, nonminimum_phase: bool) -> Self {
        let mut stream = rng::stream(seed, "subject parameters");
        let mut between = |low: f64, high: f64| low + (high - low) * stream.random::<f64>();
        Self {
            delay_s: between(0.14, 0.24),
            lag_s: between(0.08, 0.14),
            sensitivity_peak: between(1.25, 1.5),
            initial_gain: between(0.25, 0.6),
            smoothing_s: between(0.04, 0.08),
            preview_fraction: between(0.6, 0.9),
            learning_limit: if nonminimum_phase { between(0.5, 0.75) } else { between(0.85, 0.97) },
            learning_trials: if nonminimum_phase { between(10.0, 18.0) } else { between(6.0, 12.0) },
            learning_scatter: between(0.01, 0.03),
            remnant: between(0.04, 0.1),
            remnant_lag_s: between(0.15, 0.3),
        }
    }

    fn check(&self) -> Result<(), SubjectError> {
        let wanted = [
            ("delay_s", self.delay_s, 0.0, 2.0),
            ("lag_s", self.lag_s, 1e-3, 2.0),
            ("sensitivity_peak", self.sensitivity_peak, 1.01, 5.0),
            ("initial_gain", self.initial_gain, 0.0, 10.0),
            ("smoothing_s", self.smoothing_s, 1e-3, 2.0),
            ("preview_fraction", self.preview_fraction, 0.0, 1.0),
            ("learning_limit", self.learning_limit, 0.0, 1.0),
            ("learning_trials", self.learning_trials, 1e-3, 1e6),
            ("learning_scatter", self.learning_scatter, 0.0, 1.0),
            ("remnant", self.remnant, 0.0, 10.0),
            ("remnant_lag_s", self.remnant_lag_s, 1e-3, 10.0),
        ];
        match wanted.into_iter().find(|(_, value, low, high)| !(low..=high).contains(&value)) {
            Some((name, value, low, high)) => Err(SubjectError::Parameter { name, value, low, high }),
            None => Ok(()),
        }
    }
}

/// Why there is no such subject, or no such trial.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SubjectError {
    /// A parameter is out of range.
    #[error("{name} is {value}, and must lie between {low} and {high}")]
    Parameter {
        /// Which one.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Smallest value allowed.
        low: f64,
        /// Largest value allowed.
        high: f64,
    },
    /// The plant runs away, which the simulated subject cannot stabilise.
    #[error(
        "the plant has an unstable pole at {re} + {im}j, or more than one integrator; a simulated subject cannot hold \
         it"
    )]
    UnstablePlant {
        /// Real part of the pole.
        re: f64,
        /// Imaginary part.
        im: f64,
    },
    /// Not even the smallest feedback keeps the sensitivity below its peak.
    #[error("no feedback gain keeps the peak of the sensitivity below {0}")]
    NoFeedback(f64),
    /// Fewer than two samples make no trial.
    #[error("a command of {0} samples is no trial")]
    ShortCommand(usize),
    /// The plant has no approximate inverse.
    #[error(transparent)]
    Inverse(#[from] InverseError),
    /// The plant could not be sampled.
    #[error(transparent)]
    Discretise(#[from] DiscretiseError),
    /// The plant has no state space form.
    #[error(transparent)]
    Conversion(#[from] ConversionError),
    /// The signals differ in length, or the trial overflowed.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// The sample time is not positive.
    #[error(transparent)]
    SampleTime(#[from] BadSampleTime),
    /// The signals make no trial.
    #[error(transparent)]
    Trial(#[from] TrialError),
    /// The poles of the plant could not be found.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
}

/// A simulated subject in front of a plant G.
///
/// In trial n the control is `u = u_ff + u_fb + remnant`, held between samples, and `y = G (u + d)`:
///
/// - `u_fb` is the error `r − y`, delayed, through `K (T s + 1)/(lag s + 1)`. T cancels the slowest other pole of a
///   plant with an integrator (the subject's lead, as in McRuer's crossover model) and is 0 otherwise. K is the largest
///   gain for which the sampled loop, delay included, keeps `|1/(1 + G Gfb)|` below the subject's peak for itself and
///   every smaller gain; as the plant has no unstable pole, the loop is then stable by continuity.
/// - `u_ff = (1 − λ) g r + λ F r(t + preview)`, where F is the [`ApproximateInverse`] and the share λ approaches its
///   limit exponentially over the trials, with scatter.
/// - the remnant is white noise through a first-order lag.
#[derive(Debug, Clone)]
pub struct SimulatedSubject {
    parameters: SubjectParameters,
    seed: u64,
    time: Discrete,
    plant: StateSpace<Discrete>,
    /// Gain g of the untaught feedforward.
    plain_gain: f64,
    /// F of the learned feedforward, for an input that goes straight from sample to sample.
    inverse: StateSpace<Discrete>,
    preview_samples: usize,
    feedback: Feedback,
}

/// The feedback of a simulated subject on its sample grid.
#[derive(Debug, Clone, PartialEq)]
struct Feedback {
    gain: f64,
    delay_samples: usize,
    /// `(T s + 1)/(lag s + 1)` by Tustin: `(b[0] z + b[1])/(z + a)`.
    b: [f64; 2],
    a: f64,
}

impl Feedback {
    /// The law with gain 1 at the angular frequency `omega_rad_s`.
    fn unit_response(&self, omega_rad_s: f64, time: Discrete) -> Complex64 {
        let angle = omega_rad_s * time.period_s();
        let z = Complex64::from_polar(1.0, angle);
        Complex64::from_polar(1.0, -angle * self.delay_samples as f64) * (self.b[0] * z + self.b[1]) / (z + self.a)
    }
}

impl SimulatedSubject {
    /// The subject with this seed in front of `plant`, its parameters drawn from the seed.
    ///
    /// # Errors
    /// [`SubjectError`].
    pub fn new(plant: &TransferFunction<Continuous>, sample_time_s: f64, seed: u64) -> Result<Self, SubjectError> {
        let nonminimum_phase = plant.zeros()?.iter().any(|z| z.re > 0.0);
        Self::with_parameters(plant, sample_time_s, seed, SubjectParameters::draw(seed, nonminimum_phase))
    }

    /// A subject with these parameters; the seed decides its scatter and remnant.
    ///
    /// # Errors
    /// [`SubjectError`].
    pub fn with_parameters(
        plant: &TransferFunction<Continuous>,
        sample_time_s: f64,
        seed: u64,
        parameters: SubjectParameters,
    ) -> Result<Self, SubjectError> {
        parameters.check()?;
        let time = Discrete::new(sample_time_s)?;
        let poles = plant.poles()?;
        let integrators = poles.iter().filter(|p| p.norm() == 0.0).count();
        let is_unstable = |p: &&Complex64| p.re >= -POLE_ROUNDING * p.norm() && (p.norm() > 0.0 || integrators > 1);
        if let Some(pole) = poles.iter().find(is_unstable) {
            return Err(SubjectError::UnstablePlant { re: pole.re, im: pole.im });
        }
        let inverse = ApproximateInverse::new(plant, parameters.smoothing_s)?;
        let sampled = discretise::zero_order_hold_state_space(&conversion::to_state_space(plant)?.balanced(), time)?;

        let slowest = poles.iter().map(|p| p.norm()).filter(|p| *p > 0.0).fold(f64::INFINITY, f64::min);
        let lead_s = if integrators > 0 && slowest.is_finite() { 1.0 / slowest } else { 0.0 };
        let sign = low_frequency_sign(plant);
        let feedback = design_feedback(&sampled, lead_s, sign, &parameters)?;
        let preview_s =
            inverse.smoothing_delay_s + parameters.preview_fraction * inverse.all_pass_delay_s(PREVIEW_OMEGA_RAD_S);
        Ok(Self {
            plain_gain: sign * parameters.initial_gain / plant.response(1.0).norm(),
            inverse: discretise::first_order_hold_state_space(
                &conversion::to_state_space(&inverse.filter)?.balanced(),
                time,
            )?,
            preview_samples: (preview_s / sample_time_s).round() as usize,
            parameters,
            seed,
            time,
            plant: sampled,
            feedback,
        })
    }

    /// Who the subject is.
    #[must_use]
    pub fn parameters(&self) -> &SubjectParameters {
        &self.parameters
    }

    /// The feedback gain K.
    #[must_use]
    pub fn feedback_gain(&self) -> f64 {
        self.feedback.gain
    }

    /// The feedback Gfb of the subject, as sampled, at the angular frequency `omega_rad_s`.
    #[must_use]
    pub fn feedback_response(&self, omega_rad_s: f64) -> Complex64 {
        self.feedback.gain * self.feedback.unit_response(omega_rad_s, self.time)
    }

    /// The feedforward Gff of trial `number` (from 1) at the angular frequency `omega_rad_s`, preview included.
    #[must_use]
    pub fn feedforward_response(&self, number: u32, omega_rad_s: f64) -> Complex64 {
        let share = self.inverse_share(number);
        let preview = omega_rad_s * self.time.period_s() * self.preview_samples as f64;
        // F is stable, so no pole lies on the frequency axis.
        let inverse = self.inverse.response(omega_rad_s).map_or(Complex64::new(0.0, 0.0), |m| m[(0, 0)]);
        (1.0 - share) * self.plain_gain + share * inverse * Complex64::from_polar(1.0, preview)
    }

    /// The plant as sampled, at the angular frequency `omega_rad_s`; not finite at a pole.
    #[must_use]
    pub fn plant_response(&self, omega_rad_s: f64) -> Complex64 {
        self.plant.response(omega_rad_s).map_or(Complex64::new(f64::INFINITY, 0.0), |m| m[(0, 0)])
    }

    /// Share λ of the inverse dynamics in the feedforward of trial `number` (from 1), 0 to 1.
    #[must_use]
    pub fn inverse_share(&self, number: u32) -> f64 {
        let p = &self.parameters;
        let scatter: f64 = rng::stream(self.seed, &format!("learning of trial {number}")).sample(StandardNormal);
        let practised = p.learning_limit * (1.0 - (-f64::from(number) / p.learning_trials).exp());
        (practised + p.learning_scatter * scatter).clamp(0.0, 1.0)
    }

    /// The trial with this number (from 1): the subject follows `command`, sampled at the sample time, while
    /// `disturbance` (if any, as long as the command) is added to its control. The same seed, number and command give
    /// the same trial.
    ///
    /// # Errors
    /// [`SubjectError`] for a command of fewer than two samples, a disturbance of another length, or values that
    /// overflow.
    pub fn trial(&self, number: u32, command: &[f64], disturbance: Option<&[f64]>) -> Result<Trial, SubjectError> {
        let samples = command.len();
        if samples < 2 {
            return Err(SubjectError::ShortCommand(samples));
        }
        if let Some(d) = disturbance
            && d.len() != samples
        {
            let (signal, expected) = ("disturbance", samples);
            return Err(SimulationError::Length { signal, samples: d.len(), expected }.into());
        }
        let ideal = self.ideal_control(command);
        let share = self.inverse_share(number);
        let remnant = self.remnant(number, &ideal);

        let Feedback { gain, delay_samples, b, a } = self.feedback.clone();
        let mut state = DVector::<f64>::zeros(self.plant.states());
        let mut next = state.clone();
        let (mut control, mut output) = (Vec::with_capacity(samples), Vec::with_capacity(samples));
        let (mut error_before, mut fed_back) = (0.0, 0.0);
        for k in 0..samples {
            let error = k.checked_sub(delay_samples).map_or(0.0, |i: usize| command[i] - output[i]);
            fed_back = b[0] * error + b[1] * error_before - a * fed_back;
            error_before = error;
            let forward = (1.0 - share) * self.plain_gain * command[k] + share * ideal[k];
            let u = forward + gain * fed_back + remnant[k];
            let input = u + disturbance.map_or(0.0, |d| d[k]);
            let y = self.plant.c().row(0).tr_dot(&state) + self.plant.d()[(0, 0)] * input;
            if !(u.is_finite() && y.is_finite()) {
                return Err(SimulationError::Overflow { sample: k }.into());
            }
            next.gemv(1.0, self.plant.a(), &state, 0.0);
            next.axpy(input, &self.plant.b().column(0), 1.0);
            std::mem::swap(&mut state, &mut next);
            control.push(u);
            output.push(y);
        }
        let sample_time_s = self.time.period_s();
        let signals = Signals {
            time_s: Some((0..samples).map(|k| k as f64 * sample_time_s).collect()),
            command: command.to_vec(),
            control,
            output,
            disturbance: disturbance.map(<[f64]>::to_vec),
        };
        Ok(Trial::new(sample_time_s, signals)?)
    }

    /// The ideal control `F r(t + preview)`.
    ///
    /// Over the first second the preview fades in (nobody acts before the trial begins); beyond its end the command
    /// goes on as its mirror image through the last point, so that there is no kink for F to differentiate.
    fn ideal_control(&self, command: &[f64]) -> Vec<f64> {
        let last = command.len() - 1;
        let ahead = |k: usize| match k.checked_sub(last) {
            None => command[k],
            Some(beyond) => 2.0 * command[last] - command[last - beyond.min(last)],
        };
        let fade = |k: usize| {
            let part = (k as f64 * self.time.period_s() / FADE_IN_S).min(1.0);
            part * part * (3.0 - 2.0 * part)
        };
        let (mut state, mut next) = (DVector::zeros(self.inverse.states()), DVector::zeros(self.inverse.states()));
        (0..=last)
            .map(|k| {
                let input = fade(k) * ahead(k + self.preview_samples);
                let output = self.inverse.c().row(0).tr_dot(&state) + self.inverse.d()[(0, 0)] * input;
                next.gemv(1.0, self.inverse.a(), &state, 0.0);
                next.axpy(input, &self.inverse.b().column(0), 1.0);
                std::mem::swap(&mut state, &mut next);
                output
            })
            .collect()
    }

    /// Coloured noise with a standard deviation relative to the rms of the ideal control, stationary from the start.
    fn remnant(&self, number: u32, ideal: &[f64]) -> Vec<f64> {
        let rms = (ideal.iter().map(|u| u * u).sum::<f64>() / ideal.len() as f64).sqrt();
        let deviation = self.parameters.remnant * rms;
        let keep = (-self.time.period_s() / self.parameters.remnant_lag_s).exp();
        let fresh = deviation * (1.0 - keep * keep).sqrt();
        let mut stream = rng::stream(self.seed, &format!("remnant of trial {number}"));
        let mut white = || -> f64 { stream.sample(StandardNormal) };
        let mut value = deviation * white();
        let mut step = || {
            let now = value;
            value = keep * value + fresh * white();
            now
        };
        ideal.iter().map(|_| step()).collect()
    }
}

/// The sign of the plant's answer at low frequency, its integrators aside.
fn low_frequency_sign(plant: &TransferFunction<Continuous>) -> f64 {
    let lowest = |coefficients: &[f64]| coefficients.iter().rev().find(|c| **c != 0.0).copied().unwrap_or(1.0);
    (lowest(plant.num().coefficients()) * lowest(plant.den().coefficients())).signum()
}

/// The largest feedback gain that keeps the sensitivity of the sampled loop below the subject's peak; see
/// [`SimulatedSubject`].
fn design_feedback(
    plant: &StateSpace<Discrete>,
    lead_s: f64,
    sign: f64,
    parameters: &SubjectParameters,
) -> Result<Feedback, SubjectError> {
    /// Gains tried per decade.
    const STEPS_PER_DECADE: i32 = 100;
    /// The smallest and largest loop gain at 1 rad/s that are tried, as powers of ten.
    const DECADES: std::ops::Range<i32> = -4..3;
    const LINES: usize = 500;

    let time = plant.time();
    let rate = 2.0 / time.period_s();
    let scale = 1.0 + parameters.lag_s * rate;
    let mut feedback = Feedback {
        gain: 0.0,
        // At least one sample, so that the loop has no algebraic part.
        delay_samples: ((parameters.delay_s / time.period_s()).round() as usize).max(1),
        b: [(1.0 + lead_s * rate) / scale, (1.0 - lead_s * rate) / scale],
        a: (1.0 - parameters.lag_s * rate) / scale,
    };
    let nyquist = std::f64::consts::PI / time.period_s();
    let response = |omega: f64| {
        let g = plant.response(omega).map(|m| m[(0, 0)])?;
        Some(sign * g * feedback.unit_response(omega, time))
    };
    let unit_loop: Vec<Complex64> =
        log_grid(1e-2_f64.min(1e-3 * nyquist), nyquist, LINES).into_iter().filter_map(response).collect();
    let reference = response(1.0_f64.min(0.1 * nyquist)).map_or(1.0, |h| h.norm());
    let peak = |gain: f64| unit_loop.iter().map(|h| 1.0 / (1.0 + gain * h).norm()).fold(0.0, f64::max);

    let mut largest = None;
    for step in DECADES.start * STEPS_PER_DECADE..DECADES.end * STEPS_PER_DECADE {
        let gain = 10.0_f64.powf(f64::from(step) / f64::from(STEPS_PER_DECADE)) / reference;
        if peak(gain) > parameters.sensitivity_peak {
            break;
        }
        largest = Some(gain);
    }
    let gain = largest.ok_or(SubjectError::NoFeedback(parameters.sensitivity_peak))?;
    feedback.gain = sign * gain;
    Ok(feedback)
}
