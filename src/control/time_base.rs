//! Continuous and sampled time, as types.

use num_complex::Complex64;
use std::fmt::Debug;

/// Where a transfer function's variable lives.
pub trait TimeBase: Debug + Copy + PartialEq + Send + Sync + 'static {
    /// The point of the complex plane that belongs to the angular frequency `omega_rad_s`:
    /// `jω` in continuous time, `e^{jωT}` in sampled time.
    fn point(&self, omega_rad_s: f64) -> Complex64;

    /// The sample time in seconds; `None` in continuous time.
    fn sample_time_s(&self) -> Option<f64>;

    /// The continuous-time exponent `λ` of a pole: the pole itself, or `ln(z)/T`. Its real part is the decay rate in
    /// 1/s, so one stability margin serves both time bases: a pole is within the margin `m` iff `Re λ < −m`.
    fn exponent(&self, pole: Complex64) -> Complex64;
}

/// Continuous time: the variable is the Laplace `s`, in rad/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Continuous;

/// Sampled time: the variable is the `z` of the z-transform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Discrete {
    sample_time_s: f64,
}

/// A sample time that is not a positive, finite number of seconds.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("the sample time is {0} s, and must be positive and finite")]
pub struct BadSampleTime(pub f64);

impl Discrete {
    /// Sampled time with this period.
    ///
    /// # Errors
    /// [`BadSampleTime`] unless the period is positive and finite.
    pub fn new(sample_time_s: f64) -> Result<Self, BadSampleTime> {
        if sample_time_s > 0.0 && sample_time_s.is_finite() {
            Ok(Self { sample_time_s })
        } else {
            Err(BadSampleTime(sample_time_s))
        }
    }

    /// The sample time in seconds.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        self.sample_time_s
    }
}

impl TimeBase for Continuous {
    fn point(&self, omega_rad_s: f64) -> Complex64 {
        Complex64::new(0.0, omega_rad_s)
    }

    fn sample_time_s(&self) -> Option<f64> {
        None
    }

    fn exponent(&self, pole: Complex64) -> Complex64 {
        pole
    }
}

impl TimeBase for Discrete {
    fn point(&self, omega_rad_s: f64) -> Complex64 {
        Complex64::from_polar(1.0, omega_rad_s * self.sample_time_s)
    }

    fn sample_time_s(&self) -> Option<f64> {
        Some(self.sample_time_s)
    }

    fn exponent(&self, pole: Complex64) -> Complex64 {
        pole.ln() / self.sample_time_s
    }
}
