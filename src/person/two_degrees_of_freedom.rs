//! The closed loop of a person with feedforward and feedback around a known plant.

use crate::control::simulate::{self, DelayLine, Hold, SimulationError};
use crate::control::stability;
use crate::control::time_base::{Continuous, Discrete, TimeBase};
use crate::control::transfer_function::{TransferFunction, TransferFunctionError};
use crate::num::Polynomial;
use crate::num::linalg::NoConvergence;
use num_complex::Complex64;

/// Two degrees of freedom (Zhang 2015, equations 3.4 and 5.8):
/// `u = Gff r + Gfb (r − y)`, `y = G (u + d)`.
///
/// With `G = N/D`, `Gff = Nff/Dff`, `Gfb = Nfb/Dfb` and the loop polynomial `L = D Dfb + N Nfb`:
///
/// - command to output `G (Gff + Gfb)/(1 + G Gfb) = N (Nff Dfb + Nfb Dff)/(Dff L)`,
/// - command to error `(1 − G Gff)/(1 + G Gfb) = Dfb (D Dff − N Nff)/(Dff L)`,
/// - sensitivity `1/(1 + G Gfb) = D Dfb/L`,
/// - disturbance to output `G/(1 + G Gfb) = N Dfb/L`.
///
/// All are evaluated as the quotients of polynomials on the right, so a plant pole on the frequency axis (an integrator
/// at ω = 0) does no harm. Common factors are not cancelled.
#[derive(Debug, Clone, PartialEq)]
pub struct TwoDegreesOfFreedom<T> {
    plant: TransferFunction<T>,
    feedforward: TransferFunction<T>,
    feedback: TransferFunction<T>,
}

/// Three systems that make no closed loop.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LoopError {
    /// A controller is sampled at another rate than the plant.
    #[error("the {part} has a sample time of {sample_time_s:?} s and the plant of {plant_sample_time_s:?} s")]
    TimeBase {
        /// `feedforward` or `feedback`.
        part: &'static str,
        /// Its sample time.
        sample_time_s: Option<f64>,
        /// That of the plant.
        plant_sample_time_s: Option<f64>,
    },
    /// `1 + G Gfb` is zero everywhere.
    #[error("the loop 1 + G Gfb vanishes at every frequency")]
    Vanishing,
}

/// The signals of a simulated closed loop.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopResponse {
    /// Control u; `None` where the transfer function from the command to the control is improper, so that u has no
    /// samples (a continuous feedforward with more zeros than poles differentiates the command).
    pub control: Option<Vec<f64>>,
    /// Output y.
    pub output: Vec<f64>,
}

impl<T: TimeBase> TwoDegreesOfFreedom<T> {
    /// From plant G, feedforward Gff and feedback Gfb.
    ///
    /// # Errors
    /// [`LoopError`] where the sample times differ or `1 + G Gfb` is identically zero.
    pub fn new(
        plant: TransferFunction<T>,
        feedforward: TransferFunction<T>,
        feedback: TransferFunction<T>,
    ) -> Result<Self, LoopError> {
        for (part, system) in [("feedforward", &feedforward), ("feedback", &feedback)] {
            if system.time() != plant.time() {
                return Err(LoopError::TimeBase {
                    part,
                    sample_time_s: system.time().sample_time_s(),
                    plant_sample_time_s: plant.time().sample_time_s(),
                });
            }
        }
        let closed = Self { plant, feedforward, feedback };
        if closed.loop_polynomial().is_zero() { Err(LoopError::Vanishing) } else { Ok(closed) }
    }

    /// The plant G.
    #[must_use]
    pub fn plant(&self) -> &TransferFunction<T> {
        &self.plant
    }

    /// The feedforward Gff.
    #[must_use]
    pub fn feedforward(&self) -> &TransferFunction<T> {
        &self.feedforward
    }

    /// The feedback Gfb.
    #[must_use]
    pub fn feedback(&self) -> &TransferFunction<T> {
        &self.feedback
    }

    /// The time base that all three share.
    #[must_use]
    pub fn time(&self) -> T {
        self.plant.time()
    }

    /// `D Dfb + N Nfb`, whose roots are the poles of the feedback loop.
    #[must_use]
    pub fn loop_polynomial(&self) -> Polynomial {
        let (plant, feedback) = (&self.plant, &self.feedback);
        plant.den().mul(feedback.den()).add(&plant.num().mul(feedback.num()))
    }

    /// `Dff (D Dfb + N Nfb)`, whose roots are the poles of the closed loop.
    #[must_use]
    pub fn characteristic_polynomial(&self) -> Polynomial {
        self.feedforward.den().mul(&self.loop_polynomial())
    }

    /// The poles of the closed loop: those of the feedforward, then those of the feedback loop.
    ///
    /// The two are found apart, which is more accurate than from their product.
    ///
    /// # Errors
    /// [`NoConvergence`] if the eigenvalue iteration fails.
    pub fn poles(&self) -> Result<Vec<Complex64>, NoConvergence> {
        let mut poles = self.feedforward.poles()?;
        poles.extend(self.loop_polynomial().roots()?);
        Ok(poles)
    }

    /// Whether the closed loop is well posed and every pole decays faster than `margin` (1/s): `Re λ < −margin` of the
    /// exponents λ, strictly; see [`stability::is_stable`]. Poles that cancel against zeros count.
    ///
    /// A loop polynomial of lower degree than `D Dfb` (where `1 + G Gfb` vanishes at infinity) is not well posed.
    #[must_use]
    pub fn is_stable(&self, margin: f64) -> bool {
        let polynomial = self.loop_polynomial();
        polynomial.degree() >= self.plant.den().degree() + self.feedback.den().degree()
            && stability::is_stable(self.feedforward.den(), &self.time(), margin)
            && stability::is_stable(&polynomial, &self.time(), margin)
    }

    fn values(&self, omega_rad_s: f64) -> Values {
        let x = self.time().point(omega_rad_s);
        let pair = |system: &TransferFunction<T>| (system.num().eval(x), system.den().eval(x));
        let ((n, d), (n_ff, d_ff), (n_fb, d_fb)) = (pair(&self.plant), pair(&self.feedforward), pair(&self.feedback));
        Values { n, d, n_ff, d_ff, n_fb, d_fb, closed: d * d_fb + n * n_fb }
    }

    /// `G (Gff + Gfb)/(1 + G Gfb)` at the angular frequency `omega_rad_s`; not finite at a closed-loop pole.
    #[must_use]
    pub fn command_to_output(&self, omega_rad_s: f64) -> Complex64 {
        let v = self.values(omega_rad_s);
        v.n * (v.n_ff * v.d_fb + v.n_fb * v.d_ff) / (v.d_ff * v.closed)
    }

    /// `(1 − G Gff)/(1 + G Gfb)`, from the command to the error `r − y` (Zhang 2015, equation 3.5).
    #[must_use]
    pub fn command_to_error(&self, omega_rad_s: f64) -> Complex64 {
        let v = self.values(omega_rad_s);
        v.d_fb * (v.d * v.d_ff - v.n * v.n_ff) / (v.d_ff * v.closed)
    }

    /// `(Gff + Gfb)/(1 + G Gfb)`.
    #[must_use]
    pub fn command_to_control(&self, omega_rad_s: f64) -> Complex64 {
        let v = self.values(omega_rad_s);
        v.d * (v.n_ff * v.d_fb + v.n_fb * v.d_ff) / (v.d_ff * v.closed)
    }

    /// `1/(1 + G Gfb)`.
    #[must_use]
    pub fn sensitivity(&self, omega_rad_s: f64) -> Complex64 {
        let v = self.values(omega_rad_s);
        v.d * v.d_fb / v.closed
    }

    /// `G/(1 + G Gfb)`, from a disturbance at the plant's input.
    #[must_use]
    pub fn disturbance_to_output(&self, omega_rad_s: f64) -> Complex64 {
        let v = self.values(omega_rad_s);
        v.n * v.d_fb / v.closed
    }

    fn quotient(&self, num: &Polynomial, den: &Polynomial) -> Result<TransferFunction<T>, TransferFunctionError> {
        TransferFunction::new(num.coefficients(), den.coefficients(), self.time())
    }

    /// `Nff Dfb + Nfb Dff`, the numerator of the sum of both controllers.
    fn controllers_numerator(&self) -> Polynomial {
        let (ff, fb) = (&self.feedforward, &self.feedback);
        ff.num().mul(fb.den()).add(&fb.num().mul(ff.den()))
    }

    /// The transfer function from command to output; see the type for its polynomials.
    ///
    /// # Errors
    /// [`TransferFunctionError::NotFinite`] where a coefficient overflows.
    pub fn command_to_output_transfer_function(&self) -> Result<TransferFunction<T>, TransferFunctionError> {
        self.quotient(&self.plant.num().mul(&self.controllers_numerator()), &self.characteristic_polynomial())
    }

    /// The transfer function from command to control.
    ///
    /// # Errors
    /// [`TransferFunctionError::NotFinite`] where a coefficient overflows.
    pub fn command_to_control_transfer_function(&self) -> Result<TransferFunction<T>, TransferFunctionError> {
        self.quotient(&self.plant.den().mul(&self.controllers_numerator()), &self.characteristic_polynomial())
    }

    /// The transfer function `1/(1 + G Gfb)`.
    ///
    /// # Errors
    /// [`TransferFunctionError::NotFinite`] where a coefficient overflows.
    pub fn sensitivity_transfer_function(&self) -> Result<TransferFunction<T>, TransferFunctionError> {
        self.quotient(&self.plant.den().mul(self.feedback.den()), &self.loop_polynomial())
    }

    /// The transfer function from a disturbance at the plant's input to the output.
    ///
    /// # Errors
    /// [`TransferFunctionError::NotFinite`] where a coefficient overflows.
    pub fn disturbance_to_output_transfer_function(&self) -> Result<TransferFunction<T>, TransferFunctionError> {
        self.quotient(&self.plant.num().mul(self.feedback.den()), &self.loop_polynomial())
    }

    /// The transfer function from a disturbance at the plant's input to the control, `−G Gfb/(1 + G Gfb)`.
    ///
    /// # Errors
    /// [`TransferFunctionError::NotFinite`] where a coefficient overflows.
    pub fn disturbance_to_control_transfer_function(&self) -> Result<TransferFunction<T>, TransferFunctionError> {
        self.quotient(&self.plant.num().mul(self.feedback.num()).scale(-1.0), &self.loop_polynomial())
    }
}

/// Numerators and denominators at one point of the complex plane.
struct Values {
    n: Complex64,
    d: Complex64,
    n_ff: Complex64,
    d_ff: Complex64,
    n_fb: Complex64,
    d_fb: Complex64,
    /// `d d_fb + n n_fb`.
    closed: Complex64,
}

fn check_length(command: &[f64], disturbance: Option<&[f64]>) -> Result<(), SimulationError> {
    match disturbance {
        Some(d) if d.len() != command.len() => {
            Err(SimulationError::Length { signal: "disturbance", samples: d.len(), expected: command.len() })
        }
        _ => Ok(()),
    }
}

impl TwoDegreesOfFreedom<Discrete> {
    /// Control and output, sample by sample and from rest, for a command r and a disturbance d at the plant's input.
    ///
    /// The three systems run as filters in doubled precision (see [`simulate::filter`]); direct paths that close a loop
    /// within one sample are solved for.
    ///
    /// # Errors
    /// [`SimulationError`] where a part is improper, the algebraic loop has no solution, the signals differ in length,
    /// or the response of an unstable loop overflows.
    pub fn simulate(&self, command: &[f64], disturbance: Option<&[f64]>) -> Result<LoopResponse, SimulationError> {
        check_length(command, disturbance)?;
        let mut plant = DelayLine::new(&self.plant, "plant")?;
        let mut feedforward = DelayLine::new(&self.feedforward, "feedforward")?;
        let mut feedback = DelayLine::new(&self.feedback, "feedback")?;
        let (plant_gain, feedback_gain) = (plant.feedthrough(), feedback.feedthrough());
        let return_difference = 1.0 + plant_gain * feedback_gain;
        if return_difference == 0.0 {
            return Err(SimulationError::AlgebraicLoop { plant: plant_gain, feedback: feedback_gain });
        }
        let mut control = Vec::with_capacity(command.len());
        let mut output = Vec::with_capacity(command.len());
        for (sample, r) in command.iter().enumerate() {
            let r = (*r).into();
            let d = disturbance.map_or(0.0, |d| d[sample]).into();
            let forward = feedforward.step(r);
            // y = pending + g (forward + pending_fb + k (r − y) + d), solved for y.
            let known = forward.add(feedback.pending()).add(r.mul(feedback_gain)).add(d);
            let y = plant.pending().add(known.mul(plant_gain)).div(return_difference);
            let u = forward.add(feedback.step(r.sub(y)));
            plant.step(u.add(d));
            if !y.value().is_finite() || !u.value().is_finite() {
                return Err(SimulationError::Overflow { sample });
            }
            control.push(u.value());
            output.push(y.value());
        }
        Ok(LoopResponse { control: Some(control), output })
    }
}

impl TwoDegreesOfFreedom<Continuous> {
    /// Control and output at the samples, from rest, for a command and a disturbance that go straight from sample to
    /// sample.
    ///
    /// The *closed-loop* transfer functions are realised and propagated exactly for such inputs
    /// ([`simulate::sampled_response`]); plant and controllers are not discretised apart, so sampling changes no pole.
    /// An improper feedforward (Zhang 2015, section 3.5 has degree 4 over degree 2) is no obstacle as long as the
    /// product with the plant is proper; the control is then `None`.
    ///
    /// # Errors
    /// [`SimulationError`] where command to output or disturbance to output is improper, the signals differ in length,
    /// the sample time is not positive, or the response of an unstable loop overflows.
    pub fn simulate(
        &self,
        command: &[f64],
        disturbance: Option<&[f64]>,
        sample_time_s: f64,
    ) -> Result<LoopResponse, SimulationError> {
        check_length(command, disturbance)?;
        let time = Discrete::new(sample_time_s)?;
        let respond = |system: Result<TransferFunction<Continuous>, TransferFunctionError>, input: &[f64]| {
            let system = system.map_err(|_| SimulationError::Overflow { sample: 0 })?;
            if system.relative_degree() < 0 {
                return Err(SimulationError::Improper {
                    system: "closed loop",
                    num_degree: system.num().degree(),
                    den_degree: system.den().degree(),
                });
            }
            simulate::sampled_response(&system, input, time, Hold::First)
        };
        let both = |to_command: Result<_, _>, to_disturbance: Result<_, _>| {
            let mut signal = respond(to_command, command)?;
            if let Some(d) = disturbance {
                for (s, extra) in signal.iter_mut().zip(respond(to_disturbance, d)?) {
                    *s += extra;
                }
            }
            Ok(signal)
        };
        let output = both(self.command_to_output_transfer_function(), self.disturbance_to_output_transfer_function())?;
        let control =
            match both(self.command_to_control_transfer_function(), self.disturbance_to_control_transfer_function()) {
                Ok(control) => Some(control),
                Err(SimulationError::Improper { .. }) => None,
                Err(other) => return Err(other),
            };
        Ok(LoopResponse { control, output })
    }
}
