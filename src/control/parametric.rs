//! Linear models whose matrices depend on named parameters, with their derivatives: what a fit and a Fisher information
//! need.
//!
//! ```text
//! x⁺ = A(θ) x + B(θ) u,   y = C(θ) x + D(θ) u,   x(0) = x₀(θ)
//! ```
//! A [`ParametricModel`] writes its matrices once, for any [`Real`]: with numbers they are the model, with [dual
//! numbers](Dual) their exact derivatives as well. [`Differentiated::sampled`] carries those through the zero-order
//! hold and [`Differentiated::respond`] through a simulation, so that no step needs a difference quotient.

use super::discretise::{DiscretiseError, zero_order_hold_state_space};
use super::exponential::matrix_exponential;
use super::simulate::SimulationError;
use super::state_space::{StateSpace, StateSpaceError};
use super::time_base::{Continuous, Discrete, TimeBase};
use crate::num::dual::{Dual, Real};
use nalgebra::{DMatrix, DVector};

/// The matrices of a model as functions of its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Matrices<S: Real> {
    /// A, n×n.
    pub a: DMatrix<S>,
    /// B, n×m.
    pub b: DMatrix<S>,
    /// C, p×n.
    pub c: DMatrix<S>,
    /// D, p×m.
    pub d: DMatrix<S>,
    /// x₀, n.
    pub initial: DVector<S>,
}

impl<S: Real> Matrices<S> {
    /// All zero, with n states, m inputs and p outputs.
    #[must_use]
    pub(crate) fn zeros(states: usize, inputs: usize, outputs: usize) -> Self {
        let zero = S::from(0.0);
        Self {
            a: DMatrix::from_element(states, states, zero),
            b: DMatrix::from_element(states, inputs, zero),
            c: DMatrix::from_element(outputs, states, zero),
            d: DMatrix::from_element(outputs, inputs, zero),
            initial: DVector::from_element(states, zero),
        }
    }
}

/// Why there is no model for these parameters.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ParametricError {
    /// The wrong number of parameters.
    #[error("{found} parameters are given and the model has {expected}")]
    Count {
        /// How many are given.
        found: usize,
        /// How many there are.
        expected: usize,
    },
    /// A parameter for which the model is not defined.
    #[error("the parameter {name} is {value}, and must lie between {lower} and {upper}")]
    Parameter {
        /// Its name.
        name: String,
        /// Its value.
        value: f64,
        /// Least value for which the model is defined.
        lower: f64,
        /// Largest value.
        upper: f64,
    },
    /// The matrices are not those of a model: an entry overflows.
    #[error(transparent)]
    StateSpace(#[from] StateSpaceError),
    /// The initial state or a derivative overflows.
    #[error("the initial state, or the derivative with respect to {name}, is not finite")]
    NotFinite {
        /// The parameter.
        name: String,
    },
}

/// A linear model with named parameters θ.
pub trait ParametricModel {
    /// Whether time is continuous or sampled.
    type Time: TimeBase;

    /// The time base.
    fn time(&self) -> Self::Time;

    /// The names of the parameters, in the order of θ.
    fn names(&self) -> Vec<String>;

    /// For each parameter the least and the largest value for which the model is defined; infinite where there is no
    /// limit.
    fn limits(&self) -> Vec<[f64; 2]>;

    /// The matrices at θ, which has as many entries as there are names and lies within the limits.
    fn matrices<S: Real>(&self, theta: &[S]) -> Matrices<S>;

    /// The model at θ.
    ///
    /// # Errors
    /// [`ParametricError`] where θ has the wrong length or lies outside the limits, or an entry overflows.
    fn realise(&self, theta: &[f64]) -> Result<Realisation<Self::Time>, ParametricError> {
        check(self, theta)?;
        let Matrices { a, b, c, d, initial } = self.matrices(theta);
        if initial.iter().any(|v| !v.is_finite()) {
            return Err(ParametricError::NotFinite { name: String::new() });
        }
        Ok(Realisation { model: StateSpace::new(a, b, c, d, self.time())?, initial })
    }

    /// The model at θ with its derivative with respect to every parameter, by dual numbers.
    ///
    /// # Errors
    /// As [`ParametricModel::realise`].
    fn differentiate(&self, theta: &[f64]) -> Result<Differentiated<Self::Time>, ParametricError> {
        let value = self.realise(theta)?;
        let mut duals: Vec<Dual> = theta.iter().map(|v| Dual::from(*v)).collect();
        let mut slopes = Vec::with_capacity(theta.len());
        for (i, name) in self.names().into_iter().enumerate() {
            duals[i].slope = 1.0;
            let Matrices { a, b, c, d, initial } = self.matrices(&duals);
            duals[i].slope = 0.0;
            let part = |m: &DMatrix<Dual>| DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)].slope);
            let slope = Slope {
                a: part(&a),
                b: part(&b),
                c: part(&c),
                d: part(&d),
                initial: DVector::from_fn(initial.len(), |i, _| initial[i].slope),
            };
            if !slope.is_finite() {
                return Err(ParametricError::NotFinite { name });
            }
            slopes.push(slope);
        }
        Ok(Differentiated { value, slopes })
    }
}

fn check<M: ParametricModel + ?Sized>(model: &M, theta: &[f64]) -> Result<(), ParametricError> {
    let names = model.names();
    if names.len() != theta.len() {
        return Err(ParametricError::Count { found: theta.len(), expected: names.len() });
    }
    for ((name, value), [lower, upper]) in names.into_iter().zip(theta).zip(model.limits()) {
        if !(lower..=upper).contains(value) || !value.is_finite() {
            return Err(ParametricError::Parameter { name, value: *value, lower, upper });
        }
    }
    Ok(())
}

/// A model with the state that it starts from.
#[derive(Debug, Clone, PartialEq)]
pub struct Realisation<T> {
    /// A, B, C and D.
    pub model: StateSpace<T>,
    /// x₀.
    pub initial: DVector<f64>,
}

/// The derivative of a model with respect to one parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Slope {
    /// ∂A/∂θᵢ.
    pub a: DMatrix<f64>,
    /// ∂B/∂θᵢ.
    pub b: DMatrix<f64>,
    /// ∂C/∂θᵢ.
    pub c: DMatrix<f64>,
    /// ∂D/∂θᵢ.
    pub d: DMatrix<f64>,
    /// ∂x₀/∂θᵢ.
    pub initial: DVector<f64>,
}

impl Slope {
    fn is_finite(&self) -> bool {
        [&self.a, &self.b, &self.c, &self.d].into_iter().all(|m| m.iter().all(|v| v.is_finite()))
            && self.initial.iter().all(|v| v.is_finite())
    }
}

/// A model with its derivatives.
#[derive(Debug, Clone, PartialEq)]
pub struct Differentiated<T> {
    /// The model.
    pub value: Realisation<T>,
    /// Its derivatives, one for each parameter.
    pub slopes: Vec<Slope>,
}

/// A response with its derivatives.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensitivities {
    /// y, samples × p.
    pub output: DMatrix<f64>,
    /// ∂y/∂θᵢ, samples × p each.
    pub slopes: Vec<DMatrix<f64>>,
}

impl Realisation<Continuous> {
    /// The exact samples for inputs held between samples; the initial state stays.
    ///
    /// # Errors
    /// [`DiscretiseError::Overflow`].
    pub fn sampled(&self, time: Discrete) -> Result<Realisation<Discrete>, DiscretiseError> {
        let model = zero_order_hold_state_space(&self.model, time)?;
        Ok(Realisation { model, initial: self.initial.clone() })
    }
}

impl Differentiated<Continuous> {
    /// The exact samples for inputs held between samples, and their derivatives.
    ///
    /// With `X = [A B; 0 0] T` and `E = [∂A ∂B; 0 0] T` the derivative of `e^X` in the direction E is the upper right
    /// block of `exp [X E; 0 X]` (Van Loan 1978).
    ///
    /// # Errors
    /// [`DiscretiseError::Overflow`].
    pub fn sampled(&self, time: Discrete) -> Result<Differentiated<Discrete>, DiscretiseError> {
        let value = self.value.sampled(time)?;
        let (n, m) = (value.model.states(), value.model.inputs());
        let size = n + m;
        let period = time.period_s();
        let augmented = |a: &DMatrix<f64>, b: &DMatrix<f64>| {
            let mut x = DMatrix::zeros(size, size);
            x.view_mut((0, 0), (n, n)).copy_from(&(a * period));
            x.view_mut((0, n), (n, m)).copy_from(&(b * period));
            x
        };
        let x = augmented(self.value.model.a(), self.value.model.b());
        let mut slopes = Vec::with_capacity(self.slopes.len());
        for slope in &self.slopes {
            let mut e = augmented(&slope.a, &slope.b);
            // Linear in E, whose size must not decide how often the exponential is squared.
            let unit = if e.norm() > 0.0 { x.norm().max(f64::MIN_POSITIVE) / e.norm() } else { 0.0 };
            let mut sampled = Slope { a: DMatrix::zeros(n, n), b: DMatrix::zeros(n, m), ..slope.clone() };
            if unit > 0.0 {
                e *= unit;
                let mut block = DMatrix::zeros(2 * size, 2 * size);
                block.view_mut((0, 0), (size, size)).copy_from(&x);
                block.view_mut((size, size), (size, size)).copy_from(&x);
                block.view_mut((0, size), (size, size)).copy_from(&e);
                let exponential =
                    matrix_exponential(&block).ok_or(DiscretiseError::Overflow { sample_time_s: time.period_s() })?;
                sampled.a = exponential.view((0, size), (n, n)) / unit;
                sampled.b = exponential.view((0, size + n), (n, m)) / unit;
            }
            slopes.push(sampled);
        }
        Ok(Differentiated { value, slopes })
    }
}

impl Realisation<Discrete> {
    /// The response to inputs (samples × m), samples × p.
    ///
    /// # Errors
    /// [`SimulationError::Overflow`] where an unstable model leaves the finite numbers.
    ///
    /// # Panics
    /// If the inputs do not have m columns, which is a mistake of the caller.
    pub fn respond(&self, input: &DMatrix<f64>) -> Result<DMatrix<f64>, SimulationError> {
        Differentiated { value: self.clone(), slopes: Vec::new() }.respond(input).map(|found| found.output)
    }
}

impl Differentiated<Discrete> {
    /// The response to inputs (samples × m) with its sensitivities, by the sensitivity equations
    /// `∂x⁺ = A ∂x + (∂A) x + (∂B) u`, `∂y = C ∂x + (∂C) x + (∂D) u`.
    ///
    /// # Errors
    /// [`SimulationError::Overflow`] where an unstable model leaves the finite numbers.
    ///
    /// # Panics
    /// If the inputs do not have m columns, which is a mistake of the caller.
    pub fn respond(&self, input: &DMatrix<f64>) -> Result<Sensitivities, SimulationError> {
        let model = &self.value.model;
        let (n, p, count, samples) = (model.states(), model.outputs(), self.slopes.len(), input.nrows());
        assert_eq!(input.ncols(), model.inputs(), "inputs of the simulation");
        let mut output = DMatrix::zeros(samples, p);
        let mut slopes = vec![DMatrix::zeros(samples, p); count];
        let mut state = self.value.initial.clone();
        let mut sensitivity = DMatrix::zeros(n, count);
        for (column, slope) in self.slopes.iter().enumerate() {
            sensitivity.set_column(column, &slope.initial);
        }
        let mut next_state = DVector::zeros(n);
        let mut next = DMatrix::zeros(n, count);
        let mut y = DVector::zeros(p);
        let mut u = DVector::zeros(model.inputs());
        // A derivative that is zero all over, of C and D mostly, need not be multiplied.
        let speaks = |m: &DMatrix<f64>| m.iter().any(|v| *v != 0.0);
        let live: Vec<[bool; 4]> =
            self.slopes.iter().map(|s| [speaks(&s.a), speaks(&s.b), speaks(&s.c), speaks(&s.d)]).collect();
        for sample in 0..samples {
            u.copy_from(&input.row(sample).transpose());
            y.gemv(1.0, model.c(), &state, 0.0);
            y.gemv(1.0, model.d(), &u, 1.0);
            if y.iter().any(|v| !v.is_finite()) {
                return Err(SimulationError::Overflow { sample });
            }
            output.row_mut(sample).tr_copy_from(&y);
            for (i, slope) in self.slopes.iter().enumerate() {
                y.gemv(1.0, model.c(), &sensitivity.column(i), 0.0);
                if live[i][2] {
                    y.gemv(1.0, &slope.c, &state, 1.0);
                }
                if live[i][3] {
                    y.gemv(1.0, &slope.d, &u, 1.0);
                }
                if y.iter().any(|v| !v.is_finite()) {
                    return Err(SimulationError::Overflow { sample });
                }
                slopes[i].row_mut(sample).tr_copy_from(&y);
            }
            next.gemm(1.0, model.a(), &sensitivity, 0.0);
            for (i, slope) in self.slopes.iter().enumerate() {
                let mut column = next.column_mut(i);
                if live[i][0] {
                    column.gemv(1.0, &slope.a, &state, 1.0);
                }
                if live[i][1] {
                    column.gemv(1.0, &slope.b, &u, 1.0);
                }
            }
            next_state.gemv(1.0, model.a(), &state, 0.0);
            next_state.gemv(1.0, model.b(), &u, 1.0);
            std::mem::swap(&mut state, &mut next_state);
            std::mem::swap(&mut sensitivity, &mut next);
        }
        Ok(Sensitivities { output, slopes })
    }
}
