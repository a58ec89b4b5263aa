//! Time responses on a sample grid, from rest.

use super::conversion::{self, ConversionError};
use super::discretise::Propagation;
use super::double_double::DoubleDouble;
use super::state_space::StateSpace;
use super::time_base::{BadSampleTime, Continuous, Discrete};
use super::transfer_function::TransferFunction;
use nalgebra::DVector;

/// Why a response could not be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// The next sample would be needed before it is there.
    #[error(
        "the {system} is improper (numerator of degree {num_degree}, denominator of degree {den_degree}), so its \
         response would need samples of the future"
    )]
    Improper {
        /// Which system.
        system: &'static str,
        /// Degree of the numerator.
        num_degree: usize,
        /// Degree of the denominator.
        den_degree: usize,
    },
    /// The direct paths of plant and feedback form a loop without solution.
    #[error("the direct gains of plant ({plant}) and feedback ({feedback}) form an algebraic loop without solution")]
    AlgebraicLoop {
        /// Feedthrough of the plant.
        plant: f64,
        /// Feedthrough of the feedback.
        feedback: f64,
    },
    /// The signals grew beyond every finite number.
    #[error("the response overflows at sample {sample} (counted from 0): the system is unstable")]
    Overflow {
        /// The first sample that is not finite.
        sample: usize,
    },
    /// Signals of different length.
    #[error("the {signal} has {samples} samples and the command has {expected}")]
    Length {
        /// Which signal.
        signal: &'static str,
        /// Its length.
        samples: usize,
        /// The length of the command.
        expected: usize,
    },
    /// The sample time is not positive and finite.
    #[error(transparent)]
    SampleTime(#[from] BadSampleTime),
    /// The closed loop has no realisation.
    #[error(transparent)]
    Conversion(#[from] ConversionError),
}

/// What a continuous-time input does between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// It keeps the value of the earlier sample (as a digital controller's output does).
    Zero,
    /// It goes straight from sample to sample (as a smooth signal that was sampled nearly does).
    First,
}

/// The output of a sampled system at rest to an input, sample by sample.
///
/// Transposed direct form II with the delay line in double-double precision, so the result is that of the coefficients
/// as given; plain `f64` loses six digits on a plant of fourth order at 500 Hz.
///
/// # Errors
/// [`SimulationError::Improper`], or [`SimulationError::Overflow`] where an unstable system leaves the finite numbers.
pub fn filter(system: &TransferFunction<Discrete>, input: &[f64]) -> Result<Vec<f64>, SimulationError> {
    let mut line = DelayLine::new(system, "transfer function")?;
    input
        .iter()
        .enumerate()
        .map(|(sample, x)| {
            let y = line.step((*x).into()).value();
            if y.is_finite() { Ok(y) } else { Err(SimulationError::Overflow { sample }) }
        })
        .collect()
}

/// A filter between two samples.
#[derive(Debug, Clone)]
pub(crate) struct DelayLine {
    /// Numerator and denominator in descending powers, equally long.
    num: Vec<f64>,
    den: Vec<f64>,
    states: Vec<DoubleDouble>,
}

impl DelayLine {
    pub(crate) fn new(system: &TransferFunction<Discrete>, name: &'static str) -> Result<Self, SimulationError> {
        let (num, den) = (system.num(), system.den());
        if num.degree() > den.degree() {
            return Err(SimulationError::Improper { system: name, num_degree: num.degree(), den_degree: den.degree() });
        }
        let mut padded = vec![0.0; den.degree() - num.degree()];
        padded.extend_from_slice(num.coefficients());
        Ok(Self { num: padded, den: den.coefficients().to_vec(), states: vec![DoubleDouble::default(); den.degree()] })
    }

    /// A filter whose output, with no input, begins with these samples: at most as many as it has states, zeros after
    /// them.
    pub(crate) fn starting_with(mut self, free: &[f64]) -> Self {
        // With no input sᵢ(k + 1) = sᵢ₊₁(k) − aᵢ₊₁ y(k) and s₀(k) = a₀ y(k).
        for i in 0..self.states.len() {
            let mut state = DoubleDouble::default();
            for (y, a) in free.iter().take(i + 1).zip(self.den[..=i].iter().rev()) {
                state = state.add(DoubleDouble::from(*y).mul(*a));
            }
            self.states[i] = state;
        }
        self
    }

    /// The direct gain from input to output within a sample.
    pub(crate) fn feedthrough(&self) -> f64 {
        self.num[0] / self.den[0]
    }

    /// The part of the coming output that the past has fixed already.
    pub(crate) fn pending(&self) -> DoubleDouble {
        self.states.first().copied().unwrap_or_default().div(self.den[0])
    }

    /// Takes an input and gives the output of the same sample.
    pub(crate) fn step(&mut self, input: DoubleDouble) -> DoubleDouble {
        let first = self.states.first().copied().unwrap_or_default();
        let output = input.mul(self.num[0]).add(first).div(self.den[0]);
        for i in 0..self.states.len() {
            let next = self.states.get(i + 1).copied().unwrap_or_default();
            self.states[i] = next.add(input.mul(self.num[i + 1])).sub(output.mul(self.den[i + 1]));
        }
        output
    }
}

/// The samples of a continuous system's output, at rest before the first sample, when its input follows `hold` between
/// the samples of `input`.
///
/// Exact for such an input: `x⁺ = Φ x + Γ₀ u + Γ₁ (u⁺ − u)` from matrix exponentials (without Γ₁ for [`Hold::Zero`]).
///
/// # Errors
/// [`SimulationError::Overflow`] for an unstable system; [`ConversionError::NotSingle`] for several inputs or outputs.
pub fn sampled_output(
    model: &StateSpace<Continuous>,
    input: &[f64],
    time: Discrete,
    hold: Hold,
) -> Result<Vec<f64>, SimulationError> {
    if (model.inputs(), model.outputs()) != (1, 1) {
        return Err(ConversionError::NotSingle { inputs: model.inputs(), outputs: model.outputs() }.into());
    }
    let n = model.states();
    let Propagation { transition, held, slope } =
        Propagation::new(model, time).ok_or(SimulationError::Overflow { sample: 1 })?;
    let (held, slope): (DVector<f64>, DVector<f64>) = (held.column(0).into_owned(), slope.column(0).into_owned());

    let feedthrough = model.d()[(0, 0)];
    let mut state = DVector::zeros(n);
    let mut next = DVector::zeros(n);
    let mut output = Vec::with_capacity(input.len());
    for (sample, u) in input.iter().enumerate() {
        let y = model.c().row(0).tr_dot(&state) + feedthrough * u;
        if !y.is_finite() {
            return Err(SimulationError::Overflow { sample });
        }
        output.push(y);
        next.gemv(1.0, &transition, &state, 0.0);
        next.axpy(*u, &held, 1.0);
        if hold == Hold::First
            && let Some(after) = input.get(sample + 1)
        {
            next.axpy(after - u, &slope, 1.0);
        }
        std::mem::swap(&mut state, &mut next);
    }
    Ok(output)
}

/// [`sampled_output`] of a proper transfer function, by its balanced canonical form.
///
/// # Errors
/// [`SimulationError`], also for an improper transfer function.
pub fn sampled_response(
    system: &TransferFunction<Continuous>,
    input: &[f64],
    time: Discrete,
    hold: Hold,
) -> Result<Vec<f64>, SimulationError> {
    sampled_output(&conversion::to_state_space(system)?.balanced(), input, time, hold)
}
