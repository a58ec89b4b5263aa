//! The plant or the loop that a signal passes through.

use super::result::PathResult;
use crate::analysis::excitation::signal::Signal;
use crate::analysis::report::Warning;
use crate::control::TimeBase as _;
use crate::excite::flatness::circle_mean;
use crate::excite::path::Path;
use crate::excite::peak::{resonance, supremum};
use crate::num::Complex64;

/// What a device that starts from rest is given: two periods, so that its settling and its steady state are both in it,
/// or the record.
pub(super) fn travelled(signal: &Signal) -> Vec<f64> {
    match signal.period {
        Some(n) if signal.values.len() < 2 * n => [&signal.values[..n], &signal.values[..n]].concat(),
        _ => signal.values.clone(),
    }
}

/// A warning where a mode decays so slowly that its resonance fits between two lines, which then say nothing about it.
pub(super) fn slow_decay(path: &Path, lines: &[usize], spacing_hz: f64) -> Option<Warning> {
    let gap = lines.windows(2).map(|pair| pair[1] - pair[0]).min()?;
    let time = path.plant().time();
    let radius = poles(path).iter().map(|z| z.norm()).fold(0.0, f64::max);
    let decay = -radius.ln() / time.period_s();
    let needed = std::f64::consts::PI * gap as f64 * spacing_hz;
    (decay < needed).then(|| {
        Warning::new(
            "slow_decay",
            format!(
                "the slowest mode decays with {decay:.3e} per second: its resonance is narrower than the distance of \
                 the lines, and has not settled within a period (both would take {needed:.3e} per second)"
            ),
        )
    })
}

/// The poles in z.
fn poles(path: &Path) -> Vec<Complex64> {
    let found = match path.loop_() {
        Some(closed) => closed.poles(),
        None => path.plant().sampled().poles(),
    };
    found.unwrap_or_default()
}

/// The plant or the loop, as it is written.
pub(super) fn path_result(path: &Path) -> PathResult {
    let time = path.plant().time();
    let nyquist = std::f64::consts::PI / time.period_s();
    let hints = path.pole_hints();
    let resonance = resonance(|w| path.response(w).norm(), nyquist, &hints);
    let disturbance = path.loop_().map(|closed| supremum(|w| closed.disturbance_to_output(w).norm(), nyquist, &hints));
    let sampled = match path.loop_() {
        Some(closed) => closed.command_to_output_transfer_function().ok(),
        None => path.plant().is_sampled().then(|| path.plant().sampled().clone()),
    };
    let circle = sampled.as_ref().and_then(circle_mean);
    let hz = |omega: f64| omega / (2.0 * std::f64::consts::PI);
    PathResult {
        is_loop: path.loop_().is_some(),
        sample_time_s: time.sample_time_s().unwrap_or_default(),
        resonance_hz: resonance.map(|peak| hz(peak.at)),
        resonance_gain: resonance.map(|peak| peak.value),
        disturbance_norm: disturbance.map(|peak| peak.value),
        disturbance_norm_hz: disturbance.map(|peak| hz(peak.at)),
        spectral_radius: poles(path).iter().map(|z| z.norm()).fold(0.0, f64::max),
        leading_coefficient_squared: circle.map(|c| c[0]),
        zeros_outside_factor: circle.map(|c| c[1]),
    }
}
