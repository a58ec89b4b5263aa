//! Seated balance: a torso on a wobble chair, under the person's feedback (Priess 2015, chapter 5).
//!
//! The lower body with the seat (angle α₁ from the vertical) and the upper body (α₂) meet at the fourth lumbar
//! vertebra, about which the person applies the torque `u_h`; a robot turns the seat with the torque `u_r = u − k_r α₁
//! − c_r α̇₁`. The [nonlinear] equations are (5.1) and (5.2); linearised about the upright they are
//!
//! ```text
//! M q̈ + D q̇ + S q = [1; 0] u + [−1; 1] u_h,      q = [α₁, α₂]
//! M = [J₁ + M₁l₁² + M₂l₁₂²   M₂l₁₂l₂; M₂l₁₂l₂   J₂ + M₂l₂²],   D = [c_h + c_r   −c_h; −c_h   c_h],
//! S = [k_h + k_r − M₁gl₁ − M₂gl₁₂   −k_h; −k_h   k_h − M₂gl₂]
//! ```
//! which is the plant of appendix B. The person's torque is `u_h = 1/(T_w s + 1) · Padé(e^{−τs}) · (−K z)`, `z = [α₁,
//! α̇₁, α₂, α̇₂]`; the lag is missing in the print of the appendix. With both the loop has 10 states.
//!
//! Chapter 3 drives the seat by its angle β instead: the torque is then `k_b (β − α₁) + c_b (β̇ − α̇₁)` with the
//! stiffness and damping of soft tissue ([`Drive::Rotation`]), and there is neither delay nor lag.

pub mod nonlinear;
mod parameter;

pub use parameter::Parameter;

use crate::control::parametric::{Matrices, ParametricModel};
use crate::control::{Continuous, StateSpace};
use crate::num::dual::Real;
use crate::person::state_feedback::{Path, Plant, PlantModel, close};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What moves the seat.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "SeatedBalanceDrive")]
#[serde(rename_all = "snake_case")]
pub enum Drive {
    /// A torque u in N m about the pivot, beside the virtual spring k_r and damper c_r (chapter 5). One input.
    Torque,
    /// An angle β in rad and its rate β̇ in rad/s, through the stiffness k_b and damping c_b (chapter 3). Two inputs.
    Rotation,
}

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "SeatedBalanceOutput")]
#[serde(rename_all = "snake_case")]
pub enum Output {
    /// α₁, rad.
    LowerAngle,
    /// α̇₁, rad/s.
    LowerRate,
    /// α₂, rad.
    UpperAngle,
    /// α̇₂, rad/s.
    UpperRate,
    /// α₂ − α₁, rad: how far the back is bent.
    Bend,
    /// u_h, N m.
    Torque,
}

/// Which model it is, numbers apart.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Structure {
    /// What moves the seat. Default: a torque.
    pub drive: Drive,
    /// Order of the Padé approximation of the delay, 0 for no delay. Default: 5.
    pub delay_order: usize,
    /// Whether the muscle lags. Default: true.
    pub muscle_lag: bool,
    /// What is measured. Default: both angles.
    pub outputs: Vec<Output>,
}

impl Default for Structure {
    fn default() -> Self {
        Self {
            drive: Drive::Torque,
            delay_order: 5,
            muscle_lag: true,
            outputs: vec![Output::LowerAngle, Output::UpperAngle],
        }
    }
}

impl Structure {
    /// The model of chapter 3: the seat turned by its angle, neither delay nor lag, all four states measured.
    #[must_use]
    pub fn chapter_three() -> Self {
        Self {
            drive: Drive::Rotation,
            delay_order: 0,
            muscle_lag: false,
            outputs: vec![Output::LowerAngle, Output::LowerRate, Output::UpperAngle, Output::UpperRate],
        }
    }

    /// Whether the model depends on a parameter.
    #[must_use]
    pub fn uses(&self, parameter: Parameter) -> bool {
        match parameter {
            Parameter::Delay => self.delay_order > 0,
            Parameter::MuscleLag => self.muscle_lag,
            _ => true,
        }
    }
}

/// The parameters of the model, all of one kind of number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Values<S>(pub(crate) [S; Parameter::COUNT]);

impl Values<f64> {
    /// Table 5.1 of Priess 2015, and standard gravity as the thesis has it (9.81 m/s²).
    #[must_use]
    pub fn table_5_1() -> Self {
        Self(std::array::from_fn(|i| Parameter::ALL[i].nominal()))
    }

    /// The same with another value.
    #[must_use]
    pub fn with(mut self, parameter: Parameter, value: f64) -> Self {
        self.0[parameter as usize] = value;
        self
    }
}

impl<S: Copy> Values<S> {
    /// One of them.
    pub fn get(&self, parameter: Parameter) -> S {
        self.0[parameter as usize]
    }
}

/// Seated balance with values for all parameters, some of which are free.
#[derive(Debug, Clone, PartialEq)]
pub struct SeatedBalance {
    structure: Structure,
    values: Values<f64>,
    free: Vec<Parameter>,
    initial: [f64; 4],
}

/// The loop of [`SeatedBalance`] has at least the four states of the plant.
pub const PLANT_STATES: usize = 4;

/// Why there is no such model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SeatedBalanceError {
    /// A value that the model is not defined for.
    #[error("{name} is {value}, and must lie between {lower} and {upper}")]
    Value {
        /// The parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Least value.
        lower: f64,
        /// Largest value.
        upper: f64,
    },
    /// A parameter is free twice, or free though the structure does not use it.
    #[error("the parameter {name} {why}")]
    Free {
        /// The parameter.
        name: &'static str,
        /// What is wrong.
        why: &'static str,
    },
    /// Nothing is measured.
    #[error("no output is measured")]
    NoOutput,
    /// The approximation of the delay is of too high an order.
    #[error("the Padé approximation has order {order}; at most {MAX_DELAY_ORDER} is taken")]
    DelayOrder {
        /// The order.
        order: usize,
    },
    /// The initial state is not finite.
    #[error("the initial state is not finite")]
    Initial,
}

/// Orders of the Padé approximation at most.
pub const MAX_DELAY_ORDER: usize = 10;

impl SeatedBalance {
    /// The model with these values, of which those named are free, at rest to begin with.
    ///
    /// # Errors
    /// [`SeatedBalanceError`].
    pub fn new(structure: Structure, values: Values<f64>, free: Vec<Parameter>) -> Result<Self, SeatedBalanceError> {
        if structure.outputs.is_empty() {
            return Err(SeatedBalanceError::NoOutput);
        }
        if structure.delay_order > MAX_DELAY_ORDER {
            return Err(SeatedBalanceError::DelayOrder { order: structure.delay_order });
        }
        for parameter in Parameter::ALL {
            let ([lower, upper], value) = (parameter.limits(), values.get(parameter));
            if structure.uses(parameter) && !(lower..=upper).contains(&value) {
                return Err(SeatedBalanceError::Value { name: parameter.name(), value, lower, upper });
            }
        }
        for (i, parameter) in free.iter().enumerate() {
            if free[..i].contains(parameter) {
                return Err(SeatedBalanceError::Free { name: parameter.name(), why: "is free twice" });
            }
            if !structure.uses(*parameter) {
                let why = "is free, and the structure does not use it";
                return Err(SeatedBalanceError::Free { name: parameter.name(), why });
            }
        }
        Ok(Self { structure, values, free, initial: [0.0; 4] })
    }

    /// The model of chapter 5 at Table 5.1 with the eleven parameters of §5.2 free.
    #[must_use]
    pub fn chapter_five() -> Self {
        let free = Parameter::ALL[..11].to_vec();
        Self { structure: Structure::default(), values: Values::table_5_1(), free, initial: [0.0; 4] }
    }

    /// The same from another initial state `[α₁, α̇₁, α₂, α̇₂]`; delay and muscle start at rest.
    ///
    /// # Errors
    /// [`SeatedBalanceError::Initial`] for a state that is not finite.
    pub fn starting_from(mut self, initial: [f64; 4]) -> Result<Self, SeatedBalanceError> {
        if initial.iter().any(|v| !v.is_finite()) {
            return Err(SeatedBalanceError::Initial);
        }
        self.initial = initial;
        Ok(self)
    }

    /// Which model it is.
    #[must_use]
    pub fn structure(&self) -> &Structure {
        &self.structure
    }

    /// The values, at which free parameters are nominal.
    #[must_use]
    pub fn values(&self) -> &Values<f64> {
        &self.values
    }

    /// The free parameters, in the order of θ.
    #[must_use]
    pub fn free(&self) -> &[Parameter] {
        &self.free
    }

    /// The values of the free parameters, θ.
    #[must_use]
    pub fn nominal(&self) -> Vec<f64> {
        self.free.iter().map(|p| self.values.get(*p)).collect()
    }

    /// All values, with θ in the place of the free ones.
    ///
    /// # Panics
    /// If θ has another length than the list of free parameters.
    pub fn values_at<S: Real>(&self, theta: &[S]) -> Values<S> {
        assert_eq!(theta.len(), self.free.len(), "parameters");
        let mut values = Values(self.values.0.map(S::from));
        for (parameter, value) in self.free.iter().zip(theta) {
            values.0[*parameter as usize] = *value;
        }
        values
    }

    /// The plant without the person at θ, of the states `[α₁, α̇₁, α₂, α̇₂]`.
    pub fn plant<S: Real>(&self, theta: &[S]) -> Plant<S> {
        let mut plant = linearised(&self.values_at(theta), &self.structure);
        plant.initial = self.initial.iter().map(|v| S::from(*v)).collect();
        plant
    }

    /// A and B of the plant without the person (control: the torque u_h) at θ.
    #[must_use]
    pub fn plant_matrices(&self, theta: &[f64]) -> (DMatrix<f64>, DMatrix<f64>) {
        let plant = self.plant(theta);
        (plant.a, plant.b)
    }

    /// K at θ, 1×4.
    #[must_use]
    pub fn gain(&self, theta: &[f64]) -> DMatrix<f64> {
        let values = self.values_at(theta);
        DMatrix::from_fn(1, PLANT_STATES, |_, j| values.get(Parameter::GAINS[j]))
    }

    /// Delay and lag at θ.
    pub fn path<S: Real>(&self, theta: &[S]) -> Path<S> {
        let values = self.values_at(theta);
        Path {
            delay: (self.structure.delay_order > 0).then(|| (self.structure.delay_order, values.get(Parameter::Delay))),
            lag: self.structure.muscle_lag.then(|| values.get(Parameter::MuscleLag)),
        }
    }

    /// The loop at the nominal values.
    ///
    /// # Errors
    /// [`ParametricError`](crate::control::parametric::ParametricError) where an entry overflows.
    pub fn closed_loop(&self) -> Result<StateSpace<Continuous>, crate::control::parametric::ParametricError> {
        Ok(self.realise(&self.nominal())?.model)
    }
}

impl ParametricModel for SeatedBalance {
    type Time = Continuous;

    fn time(&self) -> Continuous {
        Continuous
    }

    fn names(&self) -> Vec<String> {
        self.free.iter().map(|p| p.name().to_owned()).collect()
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        self.free.iter().map(|p| p.limits()).collect()
    }

    fn matrices<S: Real>(&self, theta: &[S]) -> Matrices<S> {
        let values = self.values_at(theta);
        let k = DMatrix::from_fn(1, PLANT_STATES, |_, j| values.get(Parameter::GAINS[j]));
        close(&self.plant(theta), &k, &self.path(theta))
    }
}

/// The plant without the person: free gains, delay and lag have no effect on it.
impl PlantModel for SeatedBalance {
    fn names(&self) -> Vec<String> {
        ParametricModel::names(self)
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        ParametricModel::limits(self)
    }

    fn nominal(&self) -> Vec<f64> {
        SeatedBalance::nominal(self)
    }

    fn plant<S: Real>(&self, theta: &[S]) -> Plant<S> {
        SeatedBalance::plant(self, theta)
    }
}

/// The mass matrix M at the relative angle α₁ − α₂ of cosine `cosine`.
fn mass<S: Real>(values: &Values<S>, cosine: S) -> [[S; 2]; 2] {
    use Parameter as P;
    let v = |p| values.get(p);
    let coupling = v(P::UpperMass) * v(P::LumbarHeight) * v(P::UpperCentre) * cosine;
    [
        [
            v(P::LowerInertia)
                + v(P::LowerMass) * v(P::LowerCentre) * v(P::LowerCentre)
                + v(P::UpperMass) * v(P::LumbarHeight) * v(P::LumbarHeight),
            coupling,
        ],
        [coupling, v(P::UpperInertia) + v(P::UpperMass) * v(P::UpperCentre) * v(P::UpperCentre)],
    ]
}

/// `M⁻¹ right`.
fn solve<S: Real>(m: &[[S; 2]; 2], right: [S; 2]) -> [S; 2] {
    let determinant = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    [(m[1][1] * right[0] - m[0][1] * right[1]) / determinant, (m[0][0] * right[1] - m[1][0] * right[0]) / determinant]
}

fn linearised<S: Real>(values: &Values<S>, structure: &Structure) -> Plant<S> {
    use Parameter as P;
    let v = |p| values.get(p);
    let (zero, one) = (S::from(0.0), S::from(1.0));
    let m = mass(values, one);
    let (k_h, c_h, k_r, c_r, g) =
        (v(P::BackStiffness), v(P::BackDamping), v(P::SeatStiffness), v(P::SeatDamping), v(P::Gravity));
    let lower_weight = v(P::LowerMass) * g * v(P::LowerCentre) + v(P::UpperMass) * g * v(P::LumbarHeight);
    let upper_weight = v(P::UpperMass) * g * v(P::UpperCentre);
    // −[S D] by columns α₁, α̇₁, α₂, α̇₂.
    let columns = [[lower_weight - k_h - k_r, k_h], [-c_h - c_r, c_h], [k_h, upper_weight - k_h], [c_h, -c_h]];
    let mut a = DMatrix::from_element(4, 4, zero);
    (a[(0, 1)], a[(2, 3)]) = (one, one);
    for (j, column) in columns.into_iter().enumerate() {
        let [lower, upper] = solve(&m, column);
        (a[(1, j)], a[(3, j)]) = (lower, upper);
    }
    let input = |forces: &[[S; 2]]| {
        let mut b = DMatrix::from_element(4, forces.len(), zero);
        for (j, force) in forces.iter().enumerate() {
            let [lower, upper] = solve(&m, *force);
            (b[(1, j)], b[(3, j)]) = (lower, upper);
        }
        b
    };
    let e = match structure.drive {
        Drive::Torque => input(&[[one, zero]]),
        Drive::Rotation => input(&[[k_r, zero], [c_r, zero]]),
    };
    let (outputs, inputs) = (structure.outputs.len(), e.ncols());
    let mut c = DMatrix::from_element(outputs, 4, zero);
    let mut d = DMatrix::from_element(outputs, 1, zero);
    for (i, output) in structure.outputs.iter().enumerate() {
        match output {
            Output::LowerAngle => c[(i, 0)] = one,
            Output::LowerRate => c[(i, 1)] = one,
            Output::UpperAngle => c[(i, 2)] = one,
            Output::UpperRate => c[(i, 3)] = one,
            Output::Bend => (c[(i, 0)], c[(i, 2)]) = (-one, one),
            Output::Torque => d[(i, 0)] = one,
        }
    }
    let f = DMatrix::from_element(outputs, inputs, zero);
    Plant { a, b: input(&[[-one, one]]), e, c, d, f, initial: vec![zero; 4] }
}
