//! The models that can be fitted.

use super::starts;
use crate::control::lyapunov::Clock;
use crate::control::parametric::{Differentiated, ParametricModel};
use crate::control::{Continuous, Discrete};
use crate::num::rng::Stream;
use crate::person::state_feedback::{PlantModel, StateFeedback};
use nalgebra::DMatrix;

/// A loop with unknown parameters, sampled.
pub trait LoopModel: Sync {
    /// The names of the parameters θ.
    fn names(&self) -> Vec<String>;

    /// For each parameter the least and the largest value for which the model is defined.
    fn limits(&self) -> Vec<[f64; 2]>;

    /// The model at θ for samples at this rate, with derivatives if asked; `None` where it is not defined or overflows.
    fn sampled(&self, theta: &[f64], time: Discrete, slopes: bool) -> Option<Differentiated<Discrete>>;

    /// A value of θ within the bounds that may be far from the truth, but for which the loop is expected to be stable.
    /// `index` counts the draws: the first ones are the plainest.
    fn draw(&self, stream: &mut Stream, index: usize, time: Discrete, bounds: &[[f64; 2]]) -> Option<Vec<f64>>;

    /// Inputs and outputs of the model.
    fn ports(&self) -> (usize, usize);
}

impl<P: PlantModel> LoopModel for StateFeedback<P, Continuous> {
    fn names(&self) -> Vec<String> {
        ParametricModel::names(self)
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        ParametricModel::limits(self)
    }

    fn sampled(&self, theta: &[f64], time: Discrete, slopes: bool) -> Option<Differentiated<Discrete>> {
        if slopes {
            self.differentiate(theta).ok()?.sampled(time).ok()
        } else {
            let value = self.realise(theta).ok()?.sampled(time).ok()?;
            Some(Differentiated { value, slopes: Vec::new() })
        }
    }

    fn draw(&self, stream: &mut Stream, index: usize, _time: Discrete, bounds: &[[f64; 2]]) -> Option<Vec<f64>> {
        draw(self, Clock::Continuous, stream, index, bounds)
    }

    fn ports(&self) -> (usize, usize) {
        let [_, _, inputs, outputs] = self.plant.sizes();
        (inputs, outputs)
    }
}

/// A sampled plant: its sample time must be that of the trials.
impl<P: PlantModel> LoopModel for StateFeedback<P, Discrete> {
    fn names(&self) -> Vec<String> {
        ParametricModel::names(self)
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        ParametricModel::limits(self)
    }

    fn sampled(&self, theta: &[f64], _time: Discrete, slopes: bool) -> Option<Differentiated<Discrete>> {
        if slopes {
            self.differentiate(theta).ok()
        } else {
            Some(Differentiated { value: self.realise(theta).ok()?, slopes: Vec::new() })
        }
    }

    fn draw(&self, stream: &mut Stream, index: usize, _time: Discrete, bounds: &[[f64; 2]]) -> Option<Vec<f64>> {
        draw(self, Clock::Sampled, stream, index, bounds)
    }

    fn ports(&self) -> (usize, usize) {
        let [_, _, inputs, outputs] = self.plant.sizes();
        (inputs, outputs)
    }
}

fn draw<P: PlantModel, T: crate::control::TimeBase>(
    model: &StateFeedback<P, T>,
    clock: Clock,
    stream: &mut Stream,
    index: usize,
    bounds: &[[f64; 2]],
) -> Option<Vec<f64>> {
    let [n, m, ..] = model.plant.sizes();
    let gains = n * m;
    let mut theta = starts::around(&model.nominal(), bounds, stream, index);
    let plant = model.plant.plant::<f64>(&theta[gains..gains + model.plant.names().len()]);
    let k = starts::regulator(&plant.a, &plant.b, clock, stream, index)?;
    put(&k, &mut theta[..gains], &bounds[..gains]);
    Some(theta)
}

/// Writes a matrix row by row, within bounds.
pub(super) fn put(matrix: &DMatrix<f64>, into: &mut [f64], bounds: &[[f64; 2]]) {
    let columns = matrix.ncols();
    for (i, (value, [lower, upper])) in into.iter_mut().zip(bounds).enumerate() {
        *value = matrix[(i / columns, i % columns)].clamp(*lower, *upper);
    }
}
