//! The head on the neck, tracking a target (Priess 2015, chapter 2).
//!
//! The person sees the target late and turns the head by a PID law on the error, through a muscle that lags:
//!
//! ```text
//! e = r(t − τ) − y,   v = K_p e + K_i ∫e + K_d (e − ξ)/T_f,   T_f ξ̇ = e − ξ,
//! T_m Ṁ = v − M,   I ÿ + b ẏ + k y = M + w
//! ```
//! in rad, N m and s; w is the noise of the muscle's torque. The thesis prints neither the block of the muscle nor the
//! filter of the derivative, without which a PID law is no transfer function: the lag `T_m` and the filter `T_f` are
//! declared here, and are parameters.

use crate::control::Continuous;
use crate::control::pade::pade;
use crate::control::parametric::{Matrices, ParametricModel};
use crate::num::dual::Real;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// About which axis the head turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "HeadAxis")]
pub enum Axis {
    /// Nodding.
    FlexionExtension,
    /// Shaking.
    AxialRotation,
}

/// The parameters by name: K_p, K_d, K_i, τ (Tables 2.1 and 2.2), I, b, k (Table 2.3), T_m, T_f.
pub const PARAMETERS: [&str; 9] = ["k_p", "k_d", "k_i", "tau", "inertia", "damping", "stiffness", "t_m", "t_f"];

/// Their number.
pub const COUNT: usize = PARAMETERS.len();

/// The outputs by name: the angle y (rad), the muscle's torque M (N m), the angular acceleration ÿ (rad/s²).
pub const OUTPUTS: [&str; 3] = ["angle", "torque", "acceleration"];

/// The declared time constant of the muscle, s.
pub const MUSCLE_LAG_S: f64 = 0.05;
/// The declared time constant of the derivative's filter, s.
pub const DERIVATIVE_FILTER_S: f64 = 0.02;

/// What chapter 2 says of a population turning the head about one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Population {
    /// Least and largest K_p, K_d, K_i and τ (Tables 2.1 and 2.2).
    pub controller: [[f64; 2]; 4],
    /// Mean I (kg m²), b (N m s/rad) and k (N m/rad) (Table 2.3).
    pub body: [f64; 3],
    /// T_v: the muscle's torque noise is uniform between −T_v and T_v, N m (Table 2.4).
    pub noise_nm: f64,
    /// T_M: the largest torque, N m.
    pub torque_nm: f64,
    /// ρ_M: the largest angle of linear motion, rad.
    pub angle_rad: f64,
    /// ρ̈_M: the largest comfortable acceleration, rad/s².
    pub acceleration_rad_s2: f64,
    /// W_a, W_T and W_n: the weights of excursions beyond the limits of acceleration, torque and angle (§2.2.3).
    pub weights: [f64; 3],
}

impl Axis {
    /// Tables 2.1 to 2.4 and the weights of §2.2.3.
    #[must_use]
    pub fn population(self) -> Population {
        match self {
            Self::FlexionExtension => Population {
                controller: [[1.935, 3.640], [0.105, 0.420], [12.772, 20.012], [0.237, 0.307]],
                body: [0.0428, 0.452, 2.75],
                noise_nm: 0.16,
                torque_nm: 7.87,
                angle_rad: 0.218,
                acceleration_rad_s2: 6.36,
                weights: [70.0, 63.6, 21.8],
            },
            Self::AxialRotation => Population {
                controller: [[1.410, 2.555], [0.003, 0.220], [2.465, 3.983], [0.228, 0.308]],
                body: [0.016, 0.30, 0.605],
                noise_nm: 0.08,
                torque_nm: 5.9,
                angle_rad: 0.872,
                acceleration_rad_s2: 6.51,
                weights: [59.0, 63.6, 87.2],
            },
        }
    }

    /// Means of the tables, and the declared time constants.
    #[must_use]
    pub fn nominal(self) -> [f64; COUNT] {
        let population = self.population();
        let middle = population.controller.map(|[least, most]| 0.5 * (least + most));
        let [inertia, damping, stiffness] = population.body;
        [middle[0], middle[1], middle[2], middle[3], inertia, damping, stiffness, MUSCLE_LAG_S, DERIVATIVE_FILTER_S]
    }
}

/// What drives the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drive {
    /// One input: the target r, whose delay is a Padé approximation of this order.
    Target {
        /// The order; 0 for no delay.
        delay_order: usize,
    },
    /// Two inputs: the target as it is seen, `r(t − τ)`, and the muscle's noise w; whoever simulates delays the target.
    SeenTargetAndNoise,
}

/// The loop with values for all parameters, some of which are free.
#[derive(Debug, Clone, PartialEq)]
pub struct HeadNeck {
    values: [f64; COUNT],
    free: Vec<usize>,
    drive: Drive,
}

/// Why there is no such model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HeadNeckError {
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
    /// A parameter that is free twice, or does not exist.
    #[error("parameter {index} is free twice, or there is none")]
    Free {
        /// Its place in [`PARAMETERS`].
        index: usize,
    },
    /// The approximation of the delay is of too high an order.
    #[error("the Padé approximation has order {order}; at most 10 is taken")]
    DelayOrder {
        /// The order.
        order: usize,
    },
}

/// For each parameter the values for which the model is defined.
fn limits(index: usize) -> [f64; 2] {
    match index {
        // Inertia.
        4 => [1e-9, 1e6],
        // Delay and time constants: shorter ones are stiffer than working precision resolves.
        3 | 7 | 8 => [1e-6, 1e3],
        _ => [-1e6, 1e6],
    }
}

impl HeadNeck {
    /// The loop with these values, in the order of [`PARAMETERS`], of which those at the places `free` are free.
    ///
    /// # Errors
    /// [`HeadNeckError`].
    pub fn new(values: [f64; COUNT], free: Vec<usize>, drive: Drive) -> Result<Self, HeadNeckError> {
        for (index, value) in values.into_iter().enumerate() {
            let [lower, upper] = limits(index);
            if !(lower..=upper).contains(&value) {
                return Err(HeadNeckError::Value { name: PARAMETERS[index], value, lower, upper });
            }
        }
        for (i, index) in free.iter().enumerate() {
            if *index >= COUNT || free[..i].contains(index) {
                return Err(HeadNeckError::Free { index: *index });
            }
        }
        if let Drive::Target { delay_order } = drive
            && delay_order > 10
        {
            return Err(HeadNeckError::DelayOrder { order: delay_order });
        }
        Ok(Self { values, free, drive })
    }

    /// The values, at which free parameters are nominal.
    #[must_use]
    pub fn values(&self) -> &[f64; COUNT] {
        &self.values
    }

    /// The values of the free parameters, θ.
    #[must_use]
    pub fn nominal(&self) -> Vec<f64> {
        self.free.iter().map(|i| self.values[*i]).collect()
    }
}

impl ParametricModel for HeadNeck {
    type Time = Continuous;

    fn time(&self) -> Continuous {
        Continuous
    }

    fn names(&self) -> Vec<String> {
        self.free.iter().map(|i| PARAMETERS[*i].to_owned()).collect()
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        self.free.iter().map(|i| limits(*i)).collect()
    }

    /// States `[y, ẏ, M, ∫e, ξ]`, then those of the delay.
    fn matrices<S: Real>(&self, theta: &[S]) -> Matrices<S> {
        let mut v = self.values.map(S::from);
        for (index, value) in self.free.iter().zip(theta) {
            v[*index] = *value;
        }
        let [k_p, k_d, k_i, tau, inertia, damping, stiffness, t_m, t_f] = v;
        let (zero, one) = (S::from(0.0), S::from(1.0));
        let delay_order = if let Drive::Target { delay_order } = self.drive { delay_order } else { 0 };
        let inputs = if self.drive == Drive::SeenTargetAndNoise { 2 } else { 1 };
        let states = 5 + delay_order;
        let mut m = Matrices::zeros(states, inputs, OUTPUTS.len());
        // The seen target as a row over states and inputs.
        let mut seen = vec![zero; states];
        let mut direct = one;
        if delay_order > 0 {
            let (a, b, c, d) = pade(delay_order);
            for i in 0..delay_order {
                for j in 0..delay_order {
                    m.a[(5 + i, 5 + j)] = S::from(a[(i, j)]) / tau;
                }
                m.b[(5 + i, 0)] = S::from(b[i]) / tau;
                seen[5 + i] = S::from(c[i]);
            }
            direct = S::from(d);
        }
        seen[0] = seen[0] - one;
        let slope = k_p + k_d / t_f;
        m.a[(0, 1)] = one;
        m.a[(1, 0)] = -stiffness / inertia;
        m.a[(1, 1)] = -damping / inertia;
        m.a[(1, 2)] = one / inertia;
        for (j, e) in seen.iter().enumerate() {
            m.a[(2, j)] = slope * *e / t_m;
            m.a[(3, j)] = *e;
            m.a[(4, j)] = *e / t_f;
        }
        m.a[(2, 2)] = m.a[(2, 2)] - one / t_m;
        m.a[(2, 3)] = m.a[(2, 3)] + k_i / t_m;
        m.a[(2, 4)] = m.a[(2, 4)] - k_d / t_f / t_m;
        m.a[(4, 4)] = m.a[(4, 4)] - one / t_f;
        m.b[(2, 0)] = slope * direct / t_m;
        m.b[(3, 0)] = direct;
        m.b[(4, 0)] = direct / t_f;
        m.c[(0, 0)] = one;
        m.c[(1, 2)] = one;
        for j in 0..3 {
            m.c[(2, j)] = m.a[(1, j)];
        }
        if inputs == 2 {
            m.b[(1, 1)] = one / inertia;
            m.d[(2, 1)] = one / inertia;
        }
        m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex64;

    /// Against the loop written as transfer functions.
    #[test]
    fn the_loop_is_that_of_its_blocks() {
        for axis in [Axis::FlexionExtension, Axis::AxialRotation] {
            let values = axis.nominal();
            let [k_p, k_d, k_i, _, inertia, damping, stiffness, t_m, t_f] = values;
            let model = HeadNeck::new(values, vec![0, 1, 2], Drive::SeenTargetAndNoise).unwrap();
            let model = model.realise(&model.nominal()).unwrap().model;
            for omega in [0.3, 2.0, 9.0, 40.0] {
                let s = Complex64::new(0.0, omega);
                let law = k_p + k_i / s + k_d * s / (t_f * s + 1.0);
                let (muscle, plant) = ((t_m * s + 1.0).inv(), (inertia * s * s + damping * s + stiffness).inv());
                let open = law * muscle * plant;
                let found = model.eval(s).unwrap();
                let expected = [
                    [open / (1.0 + open), plant / (1.0 + open)],
                    [law * muscle / (1.0 + open), -law * muscle * plant / (1.0 + open)],
                    [s * s * open / (1.0 + open), s * s * plant / (1.0 + open)],
                ];
                for (i, row) in expected.iter().enumerate() {
                    for (j, expected) in row.iter().enumerate() {
                        assert!(
                            (found[(i, j)] - expected).norm() < 1e-11 * expected.norm().max(1.0),
                            "{i} {j} {omega}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn the_delay_is_that_of_its_approximation() {
        let values = Axis::AxialRotation.nominal();
        let with = HeadNeck::new(values, vec![], Drive::Target { delay_order: 5 }).unwrap().realise(&[]).unwrap().model;
        let without =
            HeadNeck::new(values, vec![], Drive::Target { delay_order: 0 }).unwrap().realise(&[]).unwrap().model;
        let s = Complex64::new(0.0, 5.0);
        let ratio = with.eval(s).unwrap()[(0, 0)] / without.eval(s).unwrap()[(0, 0)];
        assert!((ratio - (-s * values[3]).exp()).norm() < 1e-7);
    }

    #[test]
    fn everybody_of_a_population_is_stable() {
        for axis in [Axis::FlexionExtension, Axis::AxialRotation] {
            let population = axis.population();
            for corner in 0..64_usize {
                let mut values = axis.nominal();
                for (i, range) in population.controller.iter().take(3).enumerate() {
                    values[i] = range[corner >> i & 1];
                }
                for i in 0..3 {
                    values[4 + i] = population.body[i] * [0.8, 1.2][corner >> (3 + i) & 1];
                }
                let model =
                    HeadNeck::new(values, vec![], Drive::SeenTargetAndNoise).unwrap().realise(&[]).unwrap().model;
                assert!(model.poles().unwrap().iter().all(|p| p.re < 0.0), "{axis:?} {corner}");
            }
        }
    }

    #[test]
    fn impossible_values_are_named() {
        let mut values = Axis::FlexionExtension.nominal();
        values[4] = 0.0;
        let refused = HeadNeck::new(values, vec![], Drive::SeenTargetAndNoise);
        assert!(matches!(refused, Err(HeadNeckError::Value { name: "inertia", .. })));
        let values = Axis::FlexionExtension.nominal();
        assert!(matches!(
            HeadNeck::new(values, vec![1, 1], Drive::SeenTargetAndNoise),
            Err(HeadNeckError::Free { index: 1 })
        ));
    }
}
