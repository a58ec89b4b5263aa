//! The loop of an estimate with the plant: whether it is stable, and what it accounts for of a record.

use super::estimate::Estimate;
use super::feedforward::recursion;
use super::record::Record;
use crate::control::conversion::{to_state_space, to_transfer_function};
use crate::control::discretise::zero_order_hold;
use crate::control::simulate::DelayLine;
use crate::control::stability::is_schur_within;
use crate::control::{Discrete, StateSpace, System, TransferFunction};
use crate::num::Polynomial;
use nalgebra::DMatrix;

/// Sample times that differ by less than this share are the same.
const SAME_SAMPLE_TIME: f64 = 1e-5;

/// A simulated output beyond this multiple of the record's largest is no simulation any more.
const RUNAWAY: f64 = 1e6;

/// The plant as it answers a control that is held between the samples of the working grid.
///
/// # Errors
/// Why it cannot be sampled, in words.
pub fn sampled_plant(plant: &System, sample_time_s: f64) -> Result<TransferFunction<Discrete>, String> {
    let time = Discrete::new(sample_time_s).map_err(|error| error.to_string())?;
    match plant {
        System::Continuous(continuous) => zero_order_hold(continuous, time).map_err(|error| error.to_string()),
        System::Discrete(sampled) => {
            let ratio = sample_time_s / sampled.time().period_s();
            let step = ratio.round();
            if (ratio - step).abs() > SAME_SAMPLE_TIME * ratio || step < 1.0 {
                return Err(format!("the plant is sampled every {} s", sampled.time().period_s()));
            }
            held(sampled, step as usize, time)
        }
    }
}

/// A sampled plant at every `step`-th sample, its input held in between.
fn held(plant: &TransferFunction<Discrete>, step: usize, time: Discrete) -> Result<TransferFunction<Discrete>, String> {
    if step == 1 {
        return Ok(plant.clone());
    }
    let model = to_state_space(plant).map_err(|error| error.to_string())?;
    let states = model.states();
    let mut power = DMatrix::identity(states, states);
    let mut sum = DMatrix::zeros(states, states);
    for _ in 0..step {
        sum += &power;
        power = &power * model.a();
    }
    let slower = StateSpace::new(power, sum * model.b(), model.c().clone(), model.d().clone(), time);
    to_transfer_function(&slower.map_err(|error| error.to_string())?).map_err(|error| error.to_string())
}

/// Both controllers as weights of lags: `A u = Σ w_k r(t + ahead − k) + Σ v_k r_Z(t − k) + Σ c_k e(t − k)`.
#[derive(Debug, Clone, PartialEq)]
pub struct Law {
    /// a₁, a₂, ….
    autoregressive: Vec<f64>,
    /// Of the command, from the sample furthest ahead.
    window: Vec<f64>,
    ahead: usize,
    /// Of the command divided by Z.
    slow: Vec<f64>,
    zeros: Vec<f64>,
    /// Of the error, from the least lag.
    feedback: Vec<f64>,
    least: usize,
}

/// Shares of the variation that a law accounts for; `None` where there is no variation or the loop runs away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accounted {
    /// Of the control, predicted one sample ahead from everything recorded before.
    pub one_step: Option<f64>,
    /// Of the control, simulated from the stimuli and from rest.
    pub control: Option<f64>,
    /// Of the output, likewise.
    pub output: Option<f64>,
}

impl Estimate {
    /// The law of a record.
    #[must_use]
    pub fn law(&self, record: usize) -> Law {
        self.law_of(record, &self.feedforward_coefficients(record))
    }

    /// The law for records that were not fitted: the mean feedforward of those that were.
    #[must_use]
    pub fn mean_law(&self) -> Law {
        let count = self.records.len() as f64;
        let mut laws = (0..self.records.len()).map(|i| self.law(i));
        let Some(mut mean) = laws.next() else { return self.law_of(0, &[]) };
        for law in laws {
            for (sum, more) in [
                (&mut mean.autoregressive, law.autoregressive),
                (&mut mean.window, law.window),
                (&mut mean.slow, law.slow),
                (&mut mean.feedback, law.feedback),
            ] {
                sum.iter_mut().zip(more).for_each(|(a, b)| *a += b);
            }
        }
        for part in [&mut mean.autoregressive, &mut mean.window, &mut mean.slow, &mut mean.feedback] {
            part.iter_mut().for_each(|x| *x /= count);
        }
        mean
    }

    fn law_of(&self, record: usize, feedforward: &[f64]) -> Law {
        let (window, slow) = self.basis.lag_weights(feedforward);
        Law {
            autoregressive: self.autoregressive(record),
            window,
            ahead: self.basis.ahead(),
            slow,
            zeros: self.basis.zeros().to_vec(),
            feedback: self.feedback_weights(record),
            least: self.lags().feedback[0],
        }
    }
}

impl Law {
    /// The largest modulus of the closed loop's poles with a plant, and whether all lie inside the unit circle (by
    /// Schur and Cohn, not by that modulus).
    #[must_use]
    pub fn stability(&self, plant: &TransferFunction<Discrete>) -> (Option<f64>, bool) {
        // Coefficients in ascending powers of q⁻¹ are those in descending powers of z.
        let mut a = vec![1.0];
        a.extend(self.autoregressive.iter().map(|a| -a));
        let mut e = vec![0.0; self.least];
        e.extend(&self.feedback);
        let mut b = vec![0.0; plant.den().degree() - plant.num().degree().min(plant.den().degree())];
        b.extend(plant.num().coefficients());
        let product = |x: &[f64], y: &[f64]| {
            let mut out = vec![0.0; x.len() + y.len() - 1];
            for (i, x) in x.iter().enumerate() {
                for (j, y) in y.iter().enumerate() {
                    out[i + j] += x * y;
                }
            }
            out
        };
        let (own, loops) = (product(&a, plant.den().coefficients()), product(&e, &b));
        let length = own.len().max(loops.len());
        let characteristic: Vec<f64> =
            (0..length).map(|k| own.get(k).copied().unwrap_or(0.0) + loops.get(k).copied().unwrap_or(0.0)).collect();
        let stable = is_schur_within(&characteristic, 1.0);
        let roots = Polynomial::new(characteristic).roots().ok();
        (roots.map(|roots| roots.iter().map(|z| z.norm()).fold(0.0, f64::max)), stable)
    }

    /// What the feedforward puts into the regression at each sample; before its first sample the command is zero, after
    /// its last one it stays.
    fn feedforward(&self, command: &[f64]) -> Vec<f64> {
        let slow = recursion(&self.zeros, command);
        let last = command.len().saturating_sub(1);
        (0..command.len())
            .map(|t| {
                let window = self.window.iter().enumerate().filter_map(|(k, w)| {
                    let at = (t + self.ahead).checked_sub(k)?;
                    Some(w * command[at.min(last)])
                });
                let slow = self.slow.iter().enumerate().filter_map(|(k, v)| Some(v * slow[t.checked_sub(k)?]));
                window.sum::<f64>() + slow.sum::<f64>()
            })
            .collect()
    }

    fn next(&self, t: usize, feedforward: &[f64], control: &[f64], error: &[f64]) -> f64 {
        let past = |x: &[f64], weights: &[f64], first: usize| -> f64 {
            weights.iter().enumerate().filter_map(|(k, w)| Some(w * x[t.checked_sub(first + k)?])).sum()
        };
        feedforward[t] + past(control, &self.autoregressive, 1) + past(error, &self.feedback, self.least)
    }

    /// Control and output simulated from command, disturbance and noise w, from rest; `None` where they run away.
    #[must_use]
    pub fn simulate(
        &self,
        record: &Record,
        plant: &TransferFunction<Discrete>,
        noise: Option<&[f64]>,
    ) -> Option<[Vec<f64>; 2]> {
        let feedforward = self.feedforward(&record.command);
        let mut line = DelayLine::new(plant, "plant").ok()?;
        let largest = record.output.iter().fold(0.0_f64, |a, y| a.max(y.abs()));
        let (mut u, mut y, mut e) = (Vec::new(), Vec::new(), Vec::new());
        for (t, r) in record.command.iter().enumerate() {
            let control = self.next(t, &feedforward, &u, &e) + noise.map_or(0.0, |w| w[t]);
            let input = control + record.disturbance.as_ref().map_or(0.0, |d| d[t]);
            let output = line.step(input.into()).value();
            let is_bounded = output.abs() <= RUNAWAY * largest;
            if !is_bounded {
                return None;
            }
            u.push(control);
            y.push(output);
            e.push(r - output);
        }
        Some([u, y])
    }

    /// What the law accounts for of a record; without a plant only one sample ahead.
    #[must_use]
    pub fn accounts_for(&self, record: &Record, plant: Option<&TransferFunction<Discrete>>) -> Accounted {
        let first = self.window.len().saturating_sub(self.ahead + 1).max(self.least + self.feedback.len());
        let last = record.samples().saturating_sub(self.ahead).max(first);
        let feedforward = self.feedforward(&record.command);
        let predicted: Vec<f64> =
            (first..last).map(|t| self.next(t, &feedforward, &record.control, &record.error)).collect();
        let one_step = record.control.get(first..last).and_then(|u| share(u, &predicted));
        let simulated = plant.and_then(|plant| self.simulate(record, plant, None));
        let [control, output] = match &simulated {
            Some([u, y]) => [share(&record.control, u), share(&record.output, y)],
            None => [None, None],
        };
        Accounted { one_step, control, output }
    }
}

/// `1 − Σ (x − x̂)²/Σ (x − mean x)²`.
fn share(recorded: &[f64], computed: &[f64]) -> Option<f64> {
    let mean = crate::num::stats::mean(recorded)?;
    let variation: f64 = recorded.iter().map(|x| (x - mean).powi(2)).sum();
    let missed: f64 = recorded.iter().zip(computed).map(|(x, y)| (x - y).powi(2)).sum();
    let share = 1.0 - missed / variation;
    (variation > 0.0 && share.is_finite()).then_some(share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Continuous;

    #[test]
    fn a_sampled_plant_at_every_other_sample_is_that_of_the_longer_hold() {
        let continuous = TransferFunction::new(&[2.0, 4.4], &[1.0, 3.6, 4.0], Continuous).unwrap();
        let at = |t: f64| zero_order_hold(&continuous, Discrete::new(t).unwrap()).unwrap();
        let slower = sampled_plant(&System::Discrete(at(0.01)), 0.02).unwrap();
        for omega in [0.1, 1.0, 7.0] {
            let (found, expected) = (slower.response(omega), at(0.02).response(omega));
            assert!((found - expected).norm() < 1e-9 * expected.norm(), "{omega}: {found} {expected}");
        }
        assert!(sampled_plant(&System::Discrete(at(0.01)), 0.025).is_err());
    }

    /// u(t) = −c y(t − 1) on y(t) = u(t − 1): poles z² = −c.
    #[test]
    fn the_loop_is_stable_exactly_for_gains_below_one() {
        let plant = TransferFunction::new(&[1.0], &[1.0, 0.0], Discrete::new(1.0).unwrap()).unwrap();
        let law = |c: f64| Law {
            autoregressive: vec![],
            window: vec![0.0],
            ahead: 0,
            slow: vec![],
            zeros: vec![1.0],
            feedback: vec![c],
            least: 1,
        };
        for (c, stable) in [(0.81, true), (0.999, true), (1.01, false)] {
            let (modulus, is_stable) = law(c).stability(&plant);
            assert!(is_stable == stable && (modulus.unwrap() - c.sqrt()).abs() < 1e-9, "{c}");
        }
    }
}
