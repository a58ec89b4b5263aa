//! Commands that subjects follow, as functions of time and sampled.

use std::f64::consts::PI;

/// Length of [`chirp80`] in seconds.
pub const CHIRP80_DURATION_S: f64 = 80.0;

/// Length of [`chirp60`] in seconds.
pub const CHIRP60_DURATION_S: f64 = 60.0;

/// The chirp of Zhang 2015, section 3.2, at time t in [0, 80] s:
///
/// `(2 − 0.035 t) sin(0.2π t + 0.015π t²)` for t ≤ 40, then `(0.8 − 0.035 t) sin(0.2π (80 − t) + 0.015π (80 − t)²)`.
///
/// The second half is the first backwards with its sign changed. Taken as printed: its instantaneous frequency rises
/// from 0.1 to 0.7 Hz and falls again, although the text there speaks of content between 0.1 and 0.4 Hz.
#[must_use]
pub fn chirp80_at(time_s: f64) -> f64 {
    if time_s <= 40.0 {
        (2.0 - 0.035 * time_s) * (0.2 * PI * time_s + 0.015 * PI * time_s * time_s).sin()
    } else {
        let left = 80.0 - time_s;
        (0.8 - 0.035 * time_s) * (0.2 * PI * left + 0.015 * PI * left * left).sin()
    }
}

/// The chirp of Zhang 2015, section 5.2, at time t in [0, 60] s: `2 sin(π t²/120)`, from 0 to 0.5 Hz.
#[must_use]
pub fn chirp60_at(time_s: f64) -> f64 {
    2.0 * (PI / 120.0 * time_s * time_s).sin()
}

/// [`chirp80_at`] sampled from 0 s to 80 s, both included (40,001 samples at the study's 0.002 s).
#[must_use]
pub fn chirp80(sample_time_s: f64) -> Vec<f64> {
    sampled(sample_time_s, CHIRP80_DURATION_S, chirp80_at)
}

/// [`chirp60_at`] sampled from 0 s to 60 s, both included (3,001 samples at the study's 0.02 s).
#[must_use]
pub fn chirp60(sample_time_s: f64) -> Vec<f64> {
    sampled(sample_time_s, CHIRP60_DURATION_S, chirp60_at)
}

/// One sinusoid `amplitude · sin(omega t + phase)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sine {
    /// Amplitude, in the unit of the command.
    pub amplitude: f64,
    /// Angular frequency, rad/s.
    pub omega_rad_s: f64,
    /// Phase at t = 0, rad.
    pub phase_rad: f64,
}

/// A sum of sinusoids, sampled from 0 s to `duration_s`, both included.
#[must_use]
pub fn sum_of_sines(sines: &[Sine], sample_time_s: f64, duration_s: f64) -> Vec<f64> {
    let at = |t: f64| sines.iter().map(|s| s.amplitude * (s.omega_rad_s * t + s.phase_rad).sin()).sum();
    sampled(sample_time_s, duration_s, at)
}

/// A function of time at 0, T, 2T, … up to the duration (included where it is a multiple of T to rounding).
///
/// # Panics
/// If the sample time is not positive, which is a mistake of the caller.
#[must_use]
pub fn sampled(sample_time_s: f64, duration_s: f64, at: impl Fn(f64) -> f64) -> Vec<f64> {
    assert!(sample_time_s > 0.0, "a sample time of {sample_time_s} s");
    let intervals = (duration_s / sample_time_s * (1.0 + 1e-12)).floor() as usize;
    (0..=intervals).map(|i| at(i as f64 * sample_time_s)).collect()
}
