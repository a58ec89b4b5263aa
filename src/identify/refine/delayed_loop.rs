//! Stability of a feedback loop with delay.

use super::projection::{DelayedLoop, Parts};
use super::variable::Variable;
use crate::control::delay::{is_stable_continuous, is_stable_sampled, largest_real_part};
use crate::identify::time::{Time, multiply};
use std::sync::Arc;

/// The exact test of a loop with delay.
pub(super) fn delayed_loop<'a>(
    variable: Variable,
    time: Time,
    plant_numerator: Vec<f64>,
    plant_denominator: Vec<f64>,
    margin_per_s: f64,
) -> DelayedLoop<'a> {
    Arc::new(move |parts: &Parts| {
        let open = multiply(&plant_denominator, &parts.feedback_denominator);
        let gain = multiply(&plant_numerator, &parts.feedback_numerator);
        match time {
            Time::Continuous => {
                let margin = margin_per_s / variable.omega;
                is_stable_continuous(&open, &gain, parts.feedback_delay, margin).unwrap_or(false)
            }
            Time::Sampled(time) => {
                let samples = (parts.feedback_delay / variable.unit).round() as usize;
                let radius = (-margin_per_s * time.period_s()).exp();
                is_stable_sampled(&variable.leave(&open), &variable.leave(&gain), samples, radius).unwrap_or(false)
            }
        }
    })
}

/// Largest real part of the roots of `open + gain e^{−sτ}`, which is known to be below `−margin`.
pub(super) fn slowest_exponent(open: &[f64], gain: &[f64], delay_s: f64, margin_per_s: f64) -> Option<f64> {
    let mut reach = 1.0 / delay_s.max(1e-3);
    for _ in 0..8 {
        let lowest = -margin_per_s - reach;
        if let Some(found) = largest_real_part(open, gain, delay_s, [lowest, -margin_per_s], 1e-7 * (1.0 + reach)) {
            return Some(found);
        }
        reach *= 2.0;
    }
    None
}
