//! The way of a signal through a plant, or through a position loop around it.
//!
//! ```text
//! open     y = P r                      the signal is the plant's input
//! closed   y = C P/(1 + C P) r          the signal is the position asked for; the effort is C/(1 + C P) r,
//!                                       and a person's force reaches the position through S P = P/(1 + C P)
//! ```

use crate::control::conversion::ConversionError;
use crate::control::discretise::{self, DiscretiseError};
use crate::control::simulate::{DelayLine, SimulationError};
use crate::control::{
    Continuous, Discrete, StateSpace, System, TimeBase as _, TransferFunction, conversion, stability,
};
use crate::ctl::{Ctl, Stopped};
use crate::num::linalg::NoConvergence;
use crate::num::{Complex64, Polynomial};
use crate::person::two_degrees_of_freedom::{LoopError, TwoDegreesOfFreedom};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The longest delay of a plant, samples: each is a root of the loop's polynomial, whose stability is proven.
pub const LONGEST_DELAY: usize = 60;
/// A part of a sample below this is rounding of a delay in decimals.
const WHOLE: f64 = 1e-9;

/// Samples between two looks at whether to go on.
pub(super) const PIECE: usize = 1 << 14;

/// How a plant in continuous time is seen by sampled signals.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Discretisation {
    /// Its input is held between samples: what a digital controller's output does.
    #[default]
    ZeroOrderHold,
    /// Tustin's substitution: how a filter in continuous time is often programmed.
    Tustin,
    /// Its own frequency response at the lines, as if signals were continuous. Open paths only.
    Continuous,
}

/// Why a signal has no way through.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PathError {
    /// The sample times differ.
    #[error("the {part} is sampled every {own_s} s and the signal every {signal_s} s")]
    SampleTime {
        /// `plant` or `controller`.
        part: &'static str,
        /// Its sample time.
        own_s: f64,
        /// The signal's.
        signal_s: f64,
    },
    /// Without stability there is no steady state to judge.
    #[error("the {what} is not stable (largest pole: {largest})")]
    Unstable {
        /// `plant` or `closed loop`.
        what: &'static str,
        /// The pole farthest out, for people.
        largest: String,
    },
    /// The mass or the damping is no such thing.
    #[error("{field} is {value}, and must be {range} and finite")]
    MassDamper {
        /// `mass_kg` or `damping_ns_per_m`.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        range: &'static str,
    },
    /// A delay that the plant cannot have.
    #[error(
        "a delay of {delay_s} s is {samples} samples; 0 to {LONGEST_DELAY} are taken, and of a plant that is not known \
         in continuous time with its input held, whole ones"
    )]
    Delay {
        /// As asked for.
        delay_s: f64,
        /// In samples.
        samples: f64,
    },
    /// A loop of continuous parts would need another kind of analysis.
    #[error("a loop is judged in sampled time: its plant is sampled by zero_order_hold or tustin")]
    ContinuousLoop,
    /// Numerator of higher degree than the denominator.
    #[error("the {part} is improper: its output would need samples of the future")]
    Improper {
        /// `plant` or `controller`.
        part: &'static str,
    },
    /// It cannot be sampled.
    #[error(transparent)]
    Discretise(#[from] DiscretiseError),
    /// The loop has no solution.
    #[error(transparent)]
    Loop(#[from] LoopError),
    /// Simulation failed.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// Poles cannot be found.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

/// A plant as sampled signals see it.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledPlant {
    time: Discrete,
    /// In continuous time, where it is known so and its input is held.
    held: Option<StateSpace<Continuous>>,
    /// Of a plant whose own response is taken.
    own: Option<TransferFunction<Continuous>>,
    /// Delay of the response of its own, s.
    own_delay_s: f64,
    sampled: TransferFunction<Discrete>,
}

/// β₁ and β₂ of the linear drive `1/(m s² + c s)` behind a zero-order hold, `P₀(z) = (β₁ z + β₂)/((z − 1)(z −
/// e^{−bT}))` with b = c/m (Qiu 2021, equations 17–18).
///
/// ```text
/// β₁ = (T²/m) (e^{−x} − 1 + x)/x²        β₂ = (T²/m) (1 − e^{−x} − x e^{−x})/x²        x = bT
/// ```
/// The printed forms cancel for small x; here the series is summed for x < 1/2.
#[must_use]
pub fn mass_damper_pulse(mass_kg: f64, damping_ns_per_m: f64, sample_time_s: f64) -> [f64; 2] {
    let x = damping_ns_per_m * sample_time_s / mass_kg;
    let scale = sample_time_s * sample_time_s / mass_kg;
    let [first, second] = if x < 0.5 {
        // (e^{−x} − 1 + x)/x² = Σ (−x)^k/(k+2)!, and (1 − e^{−x} − x e^{−x})/x² = Σ (−x)^k (k+1)/(k+2)!.
        let (mut term, mut sums) = (0.5, [0.0; 2]);
        for k in 0..24 {
            sums[0] += term;
            sums[1] += term * f64::from(k + 1);
            term *= -x / f64::from(k + 3);
        }
        sums
    } else {
        [((-x).exp_m1() + x) / (x * x), (-(-x).exp_m1() - x * (-x).exp()) / (x * x)]
    };
    [scale * first, scale * second]
}

impl SampledPlant {
    /// The linear drive `P(s) = 1/(m s² + c s)` from force to position, its force held between samples (Qiu 2021,
    /// section IV.B).
    ///
    /// # Errors
    /// [`PathError::MassDamper`] for a mass that is not positive or a damping that is negative.
    pub fn mass_damper(mass_kg: f64, damping_ns_per_m: f64, time: Discrete) -> Result<Self, PathError> {
        let refuse = |field, value, range| PathError::MassDamper { field, value, range };
        if !(mass_kg > 0.0 && mass_kg.is_finite()) {
            return Err(refuse("mass_kg", mass_kg, "positive"));
        }
        if !(damping_ns_per_m >= 0.0 && damping_ns_per_m.is_finite()) {
            return Err(refuse("damping_ns_per_m", damping_ns_per_m, "zero or more"));
        }
        let [b1, b2] = mass_damper_pulse(mass_kg, damping_ns_per_m, time.period_s());
        let decay = (-damping_ns_per_m / mass_kg * time.period_s()).exp();
        let unusable = |_| refuse("mass_kg", mass_kg, "of moderate size");
        let sampled = TransferFunction::new(&[b1, b2], &[1.0, -(1.0 + decay), decay], time).map_err(unusable)?;
        let own = TransferFunction::new(&[1.0], &[mass_kg, damping_ns_per_m, 0.0], Continuous).map_err(unusable)?;
        let held = conversion::to_state_space(&own).map_err(DiscretiseError::from)?;
        Ok(Self { time, held: Some(held), own: None, own_delay_s: 0.0, sampled })
    }

    /// Any plant with one input and one output.
    ///
    /// # Errors
    /// [`PathError`] where it has another sample time, is improper, or cannot be sampled.
    pub fn new(system: &System, how: Discretisation, time: Discrete) -> Result<Self, PathError> {
        if system.relative_degree() < 0 {
            return Err(PathError::Improper { part: "plant" });
        }
        match system {
            System::Discrete(sampled) => {
                same_time("plant", sampled.time(), time)?;
                let sampled = retimed(sampled, time);
                Ok(Self { time, held: None, own: None, own_delay_s: 0.0, sampled })
            }
            System::Continuous(own) => {
                let sampled = match how {
                    Discretisation::Tustin => discretise::tustin(own, time)?,
                    _ => discretise::zero_order_hold(own, time)?,
                };
                let held = match how {
                    Discretisation::ZeroOrderHold => {
                        Some(conversion::to_state_space(own).map_err(DiscretiseError::from)?.balanced())
                    }
                    _ => None,
                };
                let own = (how == Discretisation::Continuous).then(|| own.clone());
                Ok(Self { time, held, own, own_delay_s: 0.0, sampled })
            }
        }
    }

    /// The same plant, which answers to its input later: exactly, for any delay, where the input is held between
    /// samples (Åström and Wittenmark 1997, section 2.3: with τ = (d + f) T, `x⁺ = Φ x + Γ₁ u_{k−d−1} + Γ₀ u_{k−d}`,
    /// `Γ₀ = ∫₀^{(1−f)T} e^{As} ds B`, `Γ₁ = e^{A(1−f)T} ∫₀^{fT} e^{As} ds B`). Velocity and acceleration are
    /// differences then.
    ///
    /// # Errors
    /// [`PathError::Delay`].
    pub fn delayed(mut self, delay_s: f64) -> Result<Self, PathError> {
        let samples = delay_s / self.time.period_s();
        let refused = || PathError::Delay { delay_s, samples };
        if !(0.0..=LONGEST_DELAY as f64).contains(&samples) {
            return Err(refused());
        }
        let mut whole = samples.floor();
        let mut part = samples - whole;
        if !(WHOLE..=1.0 - WHOLE).contains(&part) {
            (whole, part) = (samples.round(), 0.0);
        }
        let shifted = |num: &[f64], den: &[f64], by: usize| {
            let den = [den, &vec![0.0; by]].concat();
            TransferFunction::new(num, &den, self.time).map_err(|error| PathError::Discretise(error.into()))
        };
        let sampled = if part == 0.0 {
            shifted(self.sampled.num().coefficients(), self.sampled.den().coefficients(), whole as usize)?
        } else {
            let model = self.held.as_ref().ok_or_else(refused)?;
            let within = |share: f64| {
                let time = Discrete::new(share * self.time.period_s()).map_err(|_| refused())?;
                Ok::<_, PathError>(discretise::zero_order_hold_state_space(model, time)?)
            };
            let (late, early) = (within(1.0 - part)?, within(part)?);
            let transition = late.a() * early.a();
            // The output at a sample sees the input of the sample before last, where it sees it at once.
            let pulse = |input: DMatrix<f64>, direct: DMatrix<f64>| {
                let state = StateSpace::new(transition.clone(), input, model.c().clone(), direct, self.time);
                let state = state.map_err(|error| PathError::Discretise(ConversionError::from(error).into()))?;
                Ok::<_, PathError>(conversion::to_transfer_function(&state).map_err(DiscretiseError::from)?)
            };
            let direct = model.d().clone();
            let newer = pulse(late.b().clone(), DMatrix::zeros(1, 1))?;
            let older = pulse(late.a() * early.b(), direct)?;
            if newer.den() != older.den() {
                // Both have the poles of one matrix.
                return Err(ConversionError::IllConditioned { mismatch: 1.0 })
                    .map_err(|e| DiscretiseError::from(e).into());
            }
            let num = newer.num().mul(&Polynomial::new(vec![1.0, 0.0])).add(older.num());
            shifted(num.coefficients(), newer.den().coefficients(), whole as usize + 1)?
        };
        (self.sampled, self.held) = (sampled, None);
        self.own_delay_s += delay_s;
        Ok(self)
    }

    /// The pulse transfer function.
    #[must_use]
    pub fn sampled(&self) -> &TransferFunction<Discrete> {
        &self.sampled
    }

    /// Whether its response is that of its pulse transfer function, and not its own in continuous time.
    #[must_use]
    pub fn is_sampled(&self) -> bool {
        self.own.is_none()
    }

    /// The state space model in continuous time, where it is known and the plant's input is held between samples.
    #[must_use]
    pub fn held(&self) -> Option<&StateSpace<Continuous>> {
        self.held.as_ref()
    }

    /// That model, where its output moves smoothly: two states at least, `D = 0` and `C B = 0`, so that position and
    /// velocity cannot jump.
    #[must_use]
    pub(crate) fn smooth(&self) -> Option<&StateSpace<Continuous>> {
        self.held().filter(|model| {
            let jump = (model.c() * model.b())[(0, 0)];
            let is_still = jump.abs() <= 1e-12 * model.c().norm() * model.b().norm();
            model.states() >= 2 && model.d()[(0, 0)] == 0.0 && is_still
        })
    }

    /// The sample time.
    #[must_use]
    pub fn time(&self) -> Discrete {
        self.time
    }

    /// The response at an angular frequency.
    #[must_use]
    pub fn response(&self, omega_rad_s: f64) -> Complex64 {
        self.own.as_ref().map_or_else(
            || self.sampled.response(omega_rad_s),
            |own| own.response(omega_rad_s) * Complex64::from_polar(1.0, -omega_rad_s * self.own_delay_s),
        )
    }
}

fn same_time(part: &'static str, own: Discrete, signal: Discrete) -> Result<(), PathError> {
    let (own_s, signal_s) = (own.period_s(), signal.period_s());
    if (own_s - signal_s).abs() <= 1e-9 * signal_s {
        Ok(())
    } else {
        Err(PathError::SampleTime { part, own_s, signal_s })
    }
}

/// The same coefficients with exactly this sample time, which theirs equals up to rounding.
fn retimed(system: &TransferFunction<Discrete>, time: Discrete) -> TransferFunction<Discrete> {
    TransferFunction::new(system.num().coefficients(), system.den().coefficients(), time)
        .unwrap_or_else(|_| system.clone())
}

/// A way through.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    plant: SampledPlant,
    closed: Option<TwoDegreesOfFreedom<Discrete>>,
}

/// What goes through.
#[derive(Debug, Clone, PartialEq)]
pub struct Carried {
    /// The plant's output.
    pub output: Vec<f64>,
    /// The plant's input.
    pub effort: Vec<f64>,
}

impl Path {
    /// Straight through a stable plant.
    ///
    /// # Errors
    /// [`PathError::Unstable`].
    pub fn open(plant: SampledPlant) -> Result<Self, PathError> {
        let stable = match &plant.own {
            Some(own) => stability::is_stable(own.den(), &Continuous, 0.0),
            None => stability::is_stable(plant.sampled.den(), &plant.time, 0.0),
        };
        if stable { Ok(Self { plant, closed: None }) } else { Err(unstable("plant", plant.sampled.den())) }
    }

    /// Through a loop of unit feedback.
    ///
    /// A controller in continuous time is taken by Tustin's substitution.
    ///
    /// # Errors
    /// [`PathError`], of which [`PathError::Unstable`] where Jury's test does not prove the loop stable.
    pub fn closed(plant: SampledPlant, controller: &System) -> Result<Self, PathError> {
        if plant.own.is_some() {
            return Err(PathError::ContinuousLoop);
        }
        if controller.relative_degree() < 0 {
            return Err(PathError::Improper { part: "controller" });
        }
        let controller = match controller {
            System::Continuous(own) => discretise::tustin(own, plant.time)?,
            System::Discrete(sampled) => {
                same_time("controller", sampled.time(), plant.time)?;
                retimed(sampled, plant.time)
            }
        };
        let none = TransferFunction::new(&[0.0], &[1.0], plant.time).map_err(DiscretiseError::from)?;
        let closed = TwoDegreesOfFreedom::new(plant.sampled.clone(), none, controller)?;
        if !closed.is_stable(0.0) {
            return Err(unstable("closed loop", &closed.loop_polynomial()));
        }
        Ok(Self { plant, closed: Some(closed) })
    }

    /// The plant.
    #[must_use]
    pub fn plant(&self) -> &SampledPlant {
        &self.plant
    }

    /// The loop, of a closed path.
    #[must_use]
    pub fn loop_(&self) -> Option<&TwoDegreesOfFreedom<Discrete>> {
        self.closed.as_ref()
    }

    /// From the signal to the plant's output.
    #[must_use]
    pub fn response(&self, omega_rad_s: f64) -> Complex64 {
        self.closed
            .as_ref()
            .map_or_else(|| self.plant.response(omega_rad_s), |closed| closed.command_to_output(omega_rad_s))
    }

    /// The output and the plant's input for a signal, from rest.
    ///
    /// # Errors
    /// [`PathError::Simulation`] and [`PathError::Stopped`].
    pub fn carry(&self, signal: &[f64], ctl: &Ctl) -> Result<Carried, PathError> {
        let Some(closed) = &self.closed else {
            return Ok(Carried { output: filtered(&self.plant.sampled, signal, ctl)?, effort: signal.to_vec() });
        };
        let overflow = |error: crate::control::transfer_function::TransferFunctionError| DiscretiseError::from(error);
        let output = filtered(&closed.command_to_output_transfer_function().map_err(overflow)?, signal, ctl)?;
        let effort = filtered(&closed.command_to_control_transfer_function().map_err(overflow)?, signal, ctl)?;
        Ok(Carried { output, effort })
    }

    /// Angular frequencies and decay rates (rad/s, 1/s) of the poles, where a response may peak.
    #[must_use]
    pub fn pole_hints(&self) -> Vec<[f64; 2]> {
        let polynomial = self.closed.as_ref().map_or_else(|| self.plant.sampled.den().clone(), |c| c.loop_polynomial());
        pole_hints(&polynomial, self.plant.time)
    }
}

/// A system at rest, driven by a signal: [`simulate::filter`](crate::control::simulate::filter) in pieces.
fn filtered(system: &TransferFunction<Discrete>, signal: &[f64], ctl: &Ctl) -> Result<Vec<f64>, PathError> {
    let mut line = DelayLine::new(system, "transfer function")?;
    let mut out = Vec::with_capacity(signal.len());
    for (sample, x) in signal.iter().enumerate() {
        if sample % PIECE == 0 {
            ctl.check()?;
        }
        let y = line.step((*x).into()).value();
        if !y.is_finite() {
            return Err(SimulationError::Overflow { sample }.into());
        }
        out.push(y);
    }
    Ok(out)
}

/// Angular frequency and decay rate of each root in the upper half plane.
pub(super) fn pole_hints(polynomial: &Polynomial, time: Discrete) -> Vec<[f64; 2]> {
    let exponents = polynomial.roots().unwrap_or_default().into_iter().map(|z| time.exponent(z));
    exponents.filter(|l| l.im > 0.0 && l.is_finite()).map(|l| [l.im, l.re.abs()]).collect()
}

fn unstable(what: &'static str, polynomial: &Polynomial) -> PathError {
    let roots = polynomial.roots().unwrap_or_default();
    let largest = roots.into_iter().max_by(|a, b| a.norm().total_cmp(&b.norm()));
    let largest = largest.map_or_else(|| "not found".to_owned(), |z| format!("|z| = {:.9}", z.norm()));
    PathError::Unstable { what, largest }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::exponential::matrix_exponential;

    #[test]
    fn the_pulse_coefficients_are_those_of_the_block_exponential() {
        for (m, c, t) in [(10.0, 50.0, 1e-3), (2.0, 0.0, 0.01), (1.0, 40.0, 0.01), (1.0, 60.0, 0.01), (3.0, 1e-6, 0.1)]
        {
            let block = DMatrix::from_row_slice(3, 3, &[0.0, 1.0, 0.0, 0.0, -c / m, 1.0 / m, 0.0, 0.0, 0.0]) * t;
            let e = matrix_exponential(&block).unwrap();
            // Position and velocity of a unit force held once: β₁ is the position, and β₂ = φ₁₂ γ₂ − φ₂₂ γ₁.
            let (b1, b2) = (e[(0, 2)], e[(0, 1)] * e[(1, 2)] - e[(1, 1)] * e[(0, 2)]);
            let found = mass_damper_pulse(m, c, t);
            assert!((found[0] / b1 - 1.0).abs() < 1e-13, "{m} {c} {t} {found:?} {b1}");
            assert!((found[1] / b2 - 1.0).abs() < 1e-10, "{m} {c} {t} {found:?} {b2}");
        }
    }

    #[test]
    fn a_delay_is_that_of_a_finer_clock() {
        // At a tenth of the sample time every delay in tenths is whole: the held input of the coarse clock, delayed
        // there, gives the same samples.
        let (coarse, fine) = (Discrete::new(0.01).unwrap(), Discrete::new(0.001).unwrap());
        let force: Vec<f64> = (0..60).map(|k| ((k * k) as f64 * 0.7).sin()).collect();
        let held: Vec<f64> = force.iter().flat_map(|u| [*u; 10]).collect();
        for tenths in [0_usize, 3, 7, 10, 25, 40] {
            let delay_s = tenths as f64 * 0.001;
            let plant = SampledPlant::mass_damper(10.0, 50.0, coarse).unwrap().delayed(delay_s).unwrap();
            let exact = SampledPlant::mass_damper(10.0, 50.0, fine).unwrap().delayed(delay_s).unwrap();
            let found = crate::control::simulate::filter(plant.sampled(), &force).unwrap();
            let expected = crate::control::simulate::filter(exact.sampled(), &held).unwrap();
            let size = expected.iter().fold(0.0_f64, |most, y| most.max(y.abs()));
            for (k, y) in found.iter().enumerate() {
                assert!((y - expected[10 * k]).abs() < 1e-9 * size, "{tenths} {k}: {y} {}", expected[10 * k]);
            }
        }
        let plant = || SampledPlant::mass_damper(10.0, 50.0, coarse).unwrap();
        for bad in [-0.01, f64::NAN, 0.7] {
            assert!(matches!(plant().delayed(bad), Err(PathError::Delay { .. })), "{bad}");
        }
    }
}
