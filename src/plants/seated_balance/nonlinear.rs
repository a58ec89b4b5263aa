//! The equations (5.1) and (5.2) of Priess 2015 as they stand, and their motion under the person's feedback.

use super::{Drive, Output, PLANT_STATES, Parameter, SeatedBalance, Values, mass, solve};
use crate::control::Discrete;
use crate::control::pade::pade;
use crate::control::simulate::SimulationError;
use crate::num::dual::{Dual, Real};
use nalgebra::DMatrix;

/// `ż` for `z = [α₁, α̇₁, α₂, α̇₂]` under the seat torque `seat` (all of it, springs included) and the person's torque
/// `person`, N m: (5.1) and (5.2) solved for the accelerations.
pub fn rate<S: Real>(values: &Values<S>, z: [S; 4], seat: S, person: S) -> [S; 4] {
    use Parameter as P;
    let v = |p| values.get(p);
    let [lower, lower_rate, upper, upper_rate] = z;
    let (sine, cosine) = ((lower - upper).sin(), (lower - upper).cos());
    let coupling = v(P::UpperMass) * v(P::LumbarHeight) * v(P::UpperCentre);
    let back = v(P::BackDamping) * (lower_rate - upper_rate) + v(P::BackStiffness) * (lower - upper);
    let lower_weight = v(P::LowerMass) * v(P::LowerCentre) + v(P::UpperMass) * v(P::LumbarHeight);
    let right = [
        seat - person - upper_rate * upper_rate * coupling * sine - back + lower_weight * v(P::Gravity) * lower.sin(),
        person
            + lower_rate * lower_rate * coupling * sine
            + back
            + v(P::UpperMass) * v(P::UpperCentre) * v(P::Gravity) * upper.sin(),
    ];
    let [lower_acceleration, upper_acceleration] = solve(&mass(values, cosine), right);
    [lower_rate, lower_acceleration, upper_rate, upper_acceleration]
}

/// Kinetic and potential energy in J, the springs k_r and k_h included: constant where nothing damps and nobody pushes.
#[must_use]
pub fn energy(values: &Values<f64>, z: [f64; 4]) -> f64 {
    use Parameter as P;
    let v = |p| values.get(p);
    let [lower, lower_rate, upper, upper_rate] = z;
    let m = mass(values, (lower - upper).cos());
    let kinetic =
        0.5 * m[0][0] * lower_rate.powi(2) + m[0][1] * lower_rate * upper_rate + 0.5 * m[1][1] * upper_rate.powi(2);
    let weight = v(P::Gravity)
        * ((v(P::LowerMass) * v(P::LowerCentre) + v(P::UpperMass) * v(P::LumbarHeight)) * lower.cos()
            + v(P::UpperMass) * v(P::UpperCentre) * upper.cos());
    let springs = 0.5 * v(P::SeatStiffness) * lower.powi(2) + 0.5 * v(P::BackStiffness) * (lower - upper).powi(2);
    kinetic + weight + springs
}

/// The derivatives of [`rate`] at a point with respect to the state (4×4), the seat's torque (4) and the person's
/// torque (4); the virtual spring and damper of the seat belong to the state's.
#[must_use]
pub fn linearise(values: &Values<f64>, z: [f64; 4], seat: f64, person: f64) -> (DMatrix<f64>, [f64; 4], [f64; 4]) {
    let duals = Values(values.0.map(Dual::from));
    let along = |direction: usize| {
        let mut point = z.map(Dual::from);
        let (mut seat, mut person) = (Dual::from(seat), Dual::from(person));
        match direction {
            0..4 => point[direction].slope = 1.0,
            4 => seat.slope = 1.0,
            _ => person.slope = 1.0,
        }
        let seat = seat + springs(&duals, point);
        rate(&duals, point, seat, person).map(|v| v.slope)
    };
    let columns: Vec<[f64; 4]> = (0..4).map(along).collect();
    (DMatrix::from_fn(4, 4, |i, j| columns[j][i]), along(4), along(5))
}

/// The torque of the seat's spring and damper.
fn springs<S: Real>(values: &Values<S>, z: [S; 4]) -> S {
    -values.get(Parameter::SeatStiffness) * z[0] - values.get(Parameter::SeatDamping) * z[1]
}

impl SeatedBalance {
    /// The motion of the nonlinear model at θ, samples × outputs, under inputs held between samples (samples × inputs),
    /// by the classical Runge-Kutta method of order 4 with `steps` steps a sample.
    ///
    /// # Errors
    /// [`SimulationError::Overflow`] where the person falls beyond every number.
    ///
    /// # Panics
    /// If `input` has another number of columns than the drive has inputs, or θ another length.
    pub fn simulate_nonlinear(
        &self,
        theta: &[f64],
        input: &DMatrix<f64>,
        time: Discrete,
        steps: usize,
    ) -> Result<DMatrix<f64>, SimulationError> {
        let values = self.values_at(theta);
        let inputs = if self.structure().drive == Drive::Torque { 1 } else { 2 };
        assert_eq!(input.ncols(), inputs, "inputs of the drive");
        let gains = Parameter::GAINS.map(|p| values.get(p));
        let path = self.path(theta);
        let delay = path.delay.map(|(order, tau)| (pade(order), tau));
        let delay_states = path.delay.map_or(0, |(order, _)| order);
        let states = PLANT_STATES + delay_states + usize::from(path.lag.is_some());
        let torque_of = |x: &[f64]| -> (f64, f64) {
            // −Kz, and what comes out of the delay.
            let wanted: f64 = -gains.iter().zip(x).map(|(k, z)| k * z).sum::<f64>();
            let delayed = delay.as_ref().map_or(wanted, |((_, _, c, d), _)| {
                d * wanted + c.iter().zip(&x[PLANT_STATES..]).map(|(c, x)| c * x).sum::<f64>()
            });
            (wanted, delayed)
        };
        let person_of = |x: &[f64]| if path.lag.is_some() { x[states - 1] } else { torque_of(x).1 };
        let slope = |x: &[f64], u: &[f64]| -> Vec<f64> {
            let z = [x[0], x[1], x[2], x[3]];
            let push = match self.structure().drive {
                Drive::Torque => u[0],
                Drive::Rotation => {
                    values.get(Parameter::SeatStiffness) * u[0] + values.get(Parameter::SeatDamping) * u[1]
                }
            };
            let (wanted, delayed) = torque_of(x);
            let mut slope = rate(&values, z, push + springs(&values, z), person_of(x)).to_vec();
            if let Some(((a, b, _, _), tau)) = &delay {
                for i in 0..delay_states {
                    let inner: f64 = (0..delay_states).map(|j| a[(i, j)] * x[PLANT_STATES + j]).sum();
                    slope.push((inner + b[i] * wanted) / tau);
                }
            }
            if let Some(lag) = path.lag {
                slope.push((delayed - x[states - 1]) / lag);
            }
            slope
        };
        let mut x = vec![0.0; states];
        for (x, start) in x.iter_mut().zip(self.plant(theta).initial) {
            *x = start;
        }
        let step = time.period_s() / steps.max(1) as f64;
        let moved =
            |x: &[f64], by: f64, slope: &[f64]| -> Vec<f64> { x.iter().zip(slope).map(|(x, s)| x + by * s).collect() };
        let mut output = DMatrix::zeros(input.nrows(), self.structure().outputs.len());
        for sample in 0..input.nrows() {
            let u: Vec<f64> = input.row(sample).iter().copied().collect();
            if x.iter().any(|v| !v.is_finite()) {
                return Err(SimulationError::Overflow { sample });
            }
            for (column, kind) in self.structure().outputs.iter().enumerate() {
                output[(sample, column)] = match kind {
                    Output::LowerAngle => x[0],
                    Output::LowerRate => x[1],
                    Output::UpperAngle => x[2],
                    Output::UpperRate => x[3],
                    Output::Bend => x[2] - x[0],
                    Output::Torque => person_of(&x),
                };
            }
            for _ in 0..steps.max(1) {
                let k1 = slope(&x, &u);
                let k2 = slope(&moved(&x, 0.5 * step, &k1), &u);
                let k3 = slope(&moved(&x, 0.5 * step, &k2), &u);
                let k4 = slope(&moved(&x, step, &k3), &u);
                for (i, x) in x.iter_mut().enumerate() {
                    *x += step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
                }
            }
        }
        Ok(output)
    }
}
