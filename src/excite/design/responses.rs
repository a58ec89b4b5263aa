//! Responses of a sampled model to one input, and of its derivatives, as convolutions.

use crate::control::Discrete;
use crate::control::parametric::Differentiated;
use crate::control::simulate::SimulationError;
use nalgebra::{DMatrix, DVector};

/// One output over a record: `y_k = free_k + Σ_{i ≤ k} impulse_{k−i} u_i`, `k = 0 … N−1`.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    /// What u contributes.
    pub impulse: Vec<f64>,
    /// What the initial state contributes.
    pub free: Vec<f64>,
}

impl Response {
    /// Samples, N.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.free.len()
    }

    /// `Σ_{i ≤ k} impulse_{k−i} u_i`, without what the initial state contributes.
    #[must_use]
    pub fn forced(&self, u: &[f64]) -> Vec<f64> {
        let mut y = vec![0.0; u.len()];
        for (i, u) in u.iter().enumerate().filter(|(_, u)| **u != 0.0) {
            for (y, h) in y[i..].iter_mut().zip(&self.impulse) {
                *y += h * u;
            }
        }
        y
    }

    /// The whole response.
    #[must_use]
    pub fn to(&self, u: &[f64]) -> Vec<f64> {
        let mut y = self.forced(u);
        for (y, free) in y.iter_mut().zip(&self.free) {
            *y += free;
        }
        y
    }

    /// Adds the adjoint of [`Response::forced`]: `into_i += Σ_{k ≥ i} impulse_{k−i} v_k`.
    pub fn add_adjoint(&self, v: &[f64], into: &mut [f64]) {
        for (i, sum) in into.iter_mut().enumerate() {
            *sum += self.impulse.iter().zip(&v[i..]).map(|(h, v)| h * v).sum::<f64>();
        }
    }

    /// `self + factor · other`.
    fn plus(&mut self, factor: f64, other: &Self) {
        for (a, b) in self.impulse.iter_mut().zip(&other.impulse) {
            *a += factor * b;
        }
        for (a, b) in self.free.iter_mut().zip(&other.free) {
            *a += factor * b;
        }
    }

    /// A combination of responses.
    ///
    /// # Panics
    /// If there are none, which is a mistake of the caller.
    #[must_use]
    pub fn combined(weights: &[f64], of: &[Self]) -> Self {
        let n = of[0].samples();
        let mut sum = Self { impulse: vec![0.0; n], free: vec![0.0; n] };
        for (weight, response) in weights.iter().zip(of) {
            sum.plus(*weight, response);
        }
        sum
    }
}

/// All outputs of a model, with their derivatives with respect to every parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Responses {
    /// One for each output.
    pub outputs: Vec<Response>,
    /// One for each parameter and output.
    pub slopes: Vec<Vec<Response>>,
    /// 1 where the first sample is y₁, as the thesis counts a strictly proper model; 0 where it is y₀.
    pub first: usize,
}

impl Responses {
    /// Over N samples, of a model that starts from its initial state, to the input in the column `channel`; the other
    /// inputs are zero.
    ///
    /// Of a model without feedthrough the record is y₁ … y_N (Priess 2015, §5.3.1), one sample beyond the last of the
    /// input; otherwise y₀ … y_{N−1}. What a device records together with its N input samples is
    /// [`Responses::of_record`].
    ///
    /// # Errors
    /// [`SimulationError::Overflow`] for an unstable model.
    ///
    /// # Panics
    /// If there is no such input, which is a mistake of the caller.
    pub fn new(model: &Differentiated<Discrete>, channel: usize, samples: usize) -> Result<Self, SimulationError> {
        let direct = model.value.model.d().column(channel).iter().any(|d| *d != 0.0)
            || model.slopes.iter().any(|slope| slope.d.column(channel).iter().any(|d| *d != 0.0));
        Self::from(model, channel, samples, usize::from(!direct))
    }

    /// Of the N samples y₀ … y_{N−1} that are recorded beside u₀ … u_{N−1}.
    ///
    /// # Errors
    /// [`SimulationError::Overflow`] for an unstable model.
    ///
    /// # Panics
    /// If there is no such input, which is a mistake of the caller.
    pub fn of_record(
        model: &Differentiated<Discrete>,
        channel: usize,
        samples: usize,
    ) -> Result<Self, SimulationError> {
        Self::from(model, channel, samples, 0)
    }

    fn from(
        model: &Differentiated<Discrete>,
        channel: usize,
        samples: usize,
        first: usize,
    ) -> Result<Self, SimulationError> {
        let inputs = model.value.model.inputs();
        assert!(channel < inputs, "an input of the model");
        let mut input = DMatrix::zeros(samples + first, inputs);
        let free = model.respond(&input)?;
        let mut resting = model.clone();
        resting.value.initial = DVector::zeros(model.value.initial.len());
        for slope in &mut resting.slopes {
            slope.initial = DVector::zeros(slope.initial.len());
        }
        input[(0, channel)] = 1.0;
        let forced = resting.respond(&input)?;
        let response = |forced: &DMatrix<f64>, free: &DMatrix<f64>, output: usize| Response {
            impulse: forced.column(output).iter().skip(first).copied().collect(),
            free: free.column(output).iter().skip(first).copied().collect(),
        };
        let count = model.value.model.outputs();
        Ok(Self {
            outputs: (0..count).map(|o| response(&forced.output, &free.output, o)).collect(),
            slopes: forced
                .slopes
                .iter()
                .zip(&free.slopes)
                .map(|(forced, free)| (0..count).map(|o| response(forced, free, o)).collect())
                .collect(),
            first,
        })
    }
}
