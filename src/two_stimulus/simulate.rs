//! The loop simulated from its frequency responses, and the share of a recording that it accounts for.
//!
//! Command and disturbance are transformed with at least three times their length of zeros behind them, multiplied by
//! the responses of a stable loop, and transformed back: the exact answer from rest of a loop that acts on band-limited
//! signals, delays that are no whole number of samples and improper feedforward included, as long as the loop forgets
//! within the zeros.
//!
//! The responses are known where the lines are. Far above them they are extrapolated, and an inverse of the plant may
//! be boundless there, so what command and disturbance have beyond a highest frequency is left out: a cosine taper from
//! there to twice of it.

use super::responses::{UD, UR, YD, YR};
use crate::num::stats::accounted_for as accounted;
use crate::trial::Trial;
use num_complex::Complex64;
use rustfft::FftPlanner;
use std::f64::consts::TAU;

/// Record lengths that the transform holds at least.
const LENGTHS: usize = 4;

/// Simulated control and output.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// Control u.
    pub control: Vec<f64>,
    /// Output y.
    pub output: Vec<f64>,
}

/// The highest frequency in a simulation, in multiples of the highest line.
pub const BEYOND_LINES: f64 = 4.0;

/// Simulates the loop with the responses `[H_ur, H_yr, H_ud, H_yd]` of ω in rad/s, from rest; stimuli are tapered off
/// from `highest_rad_s` on.
///
/// `None` where a response is not finite. The loop must be stable, which is for the caller to know.
#[must_use]
pub fn simulate(
    responses: impl Fn(f64) -> [Complex64; 4],
    command: &[f64],
    disturbance: Option<&[f64]>,
    sample_time_s: f64,
    highest_rad_s: f64,
) -> Option<Simulated> {
    let samples = command.len();
    let length = (LENGTHS * samples).next_power_of_two();
    let mut planner = FftPlanner::new();
    let forward = planner.plan_fft_forward(length);
    let transform = |x: &[f64]| {
        let mut buffer: Vec<Complex64> = x.iter().map(|x| Complex64::from(*x)).collect();
        buffer.resize(length, Complex64::default());
        forward.process(&mut buffer);
        buffer
    };
    let r = transform(command);
    let d = disturbance.map(transform);
    let (mut u, mut y) = (vec![Complex64::default(); length], vec![Complex64::default(); length]);
    let step = TAU / (length as f64 * sample_time_s);
    for k in 0..=length / 2 {
        // Beside an integrator's pole at 0 the closed loop's limit is as good as its value.
        let omega = if k == 0 { 1e-6 * step } else { k as f64 * step };
        if omega >= 2.0 * highest_rad_s {
            break;
        }
        let taper = 0.5 + 0.5 * (std::f64::consts::PI * (omega / highest_rad_s - 1.0).max(0.0)).cos();
        let h = responses(omega).map(|h| h * taper);
        let d = d.as_ref().map_or(Complex64::default(), |d| d[k]);
        u[k] = h[UR] * r[k] + h[UD] * d;
        y[k] = h[YR] * r[k] + h[YD] * d;
        if !(u[k].re.is_finite() && u[k].im.is_finite() && y[k].re.is_finite() && y[k].im.is_finite()) {
            return None;
        }
        if k > 0 && k < length / 2 {
            (u[length - k], y[length - k]) = (u[k].conj(), y[k].conj());
        } else {
            (u[k], y[k]) = (u[k].re.into(), y[k].re.into());
        }
    }
    let inverse = planner.plan_fft_inverse(length);
    let back = |mut x: Vec<Complex64>| -> Vec<f64> {
        inverse.process(&mut x);
        x[..samples].iter().map(|x| x.re / length as f64).collect()
    };
    Some(Simulated { control: back(u), output: back(y) })
}

/// The shares `[u, y]` of a trial's variation that a simulation accounts for, `1 − Σ (x − x̂)²/Σ (x − mean x)²` over
/// all samples, as [`crate::identify::validation`] has it; `None` where the recording does not vary or nothing is
/// finite.
#[must_use]
pub fn accounted_for(trial: &Trial, simulated: &Simulated) -> [Option<f64>; 2] {
    let signals = &trial.signals;
    [accounted(&signals.control, &simulated.control), accounted(&signals.output, &simulated.output)]
}
