//! Chirps: sinusoids whose frequency sweeps.

use super::error::SequenceError;
use super::sampled::{Sequence, SequenceDetails};
use crate::simulate::reference_signals;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// A chirp of a published study.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum ChirpPreset {
    /// [`reference_signals::chirp80_at`]: 80 s, up from 0.1 Hz and down again with shrinking and growing amplitude.
    #[serde(rename = "zhang2015_section_3_2")]
    Zhang2015Section32,
    /// [`reference_signals::chirp60_at`]: 60 s, `2 sin(π t²/120)`, from 0 to 0.5 Hz (it is at t/120 Hz).
    #[serde(rename = "zhang2015_section_5_2")]
    Zhang2015Section52,
}

/// How the frequency goes from one end to the other.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "ChirpSweep")]
pub enum Sweep {
    /// In equal steps: `f(t) = f₀ + (f₁ − f₀) t/D`.
    #[default]
    Linear,
    /// In equal ratios: `f(t) = f₀ (f₁/f₀)^{t/D}`.
    Logarithmic,
}

/// A chirp as written in JSON: a preset, or `x(t) = A sin(2π ∫₀ᵗ f + φ)` for t in [0, D].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Chirp {
    /// A published chirp, in place of everything below.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preset: Option<ChirpPreset>,
    /// Frequency at the start, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_hz: Option<f64>,
    /// Frequency at the end, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_hz: Option<f64>,
    /// Length D, s; both ends are sampled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    /// Linear or logarithmic. Default: linear.
    #[serde(default)]
    pub sweep: Sweep,
    /// Amplitude in the unit of the signal; of a preset, a factor. Default: 1.
    #[serde(default = "one")]
    pub amplitude: f64,
    /// Phase at the start, rad. Default: 0.
    #[serde(default)]
    pub phase_rad: f64,
}

fn one() -> f64 {
    1.0
}

impl Chirp {
    pub(super) fn check(&self, sample_time_s: f64) -> Result<(), SequenceError> {
        if !(self.amplitude > 0.0 && self.amplitude.is_finite()) {
            return Err(SequenceError::NotPositive { field: "generator/amplitude", value: self.amplitude });
        }
        let parts = [
            ("generator/from_hz", self.from_hz),
            ("generator/to_hz", self.to_hz),
            ("generator/duration_s", self.duration_s),
        ];
        let nyquist_hz = 0.5 / sample_time_s;
        if self.preset.is_some() {
            if let Some((field, _)) = parts.iter().find(|(_, value)| value.is_some()) {
                return Err(SequenceError::Together { field, other: "preset" });
            }
            let frequency_hz = 0.7;
            return if frequency_hz < nyquist_hz {
                Ok(())
            } else {
                Err(SequenceError::AboveNyquist { field: "generator/preset", frequency_hz, nyquist_hz })
            };
        }
        for (field, value) in parts {
            // A linear sweep may start or end at 0 Hz.
            let value = value.unwrap_or(f64::NAN);
            let zero_is_fine = field != "generator/duration_s" && self.sweep == Sweep::Linear;
            if !(value.is_finite() && (value > 0.0 || (value == 0.0 && zero_is_fine))) {
                return Err(SequenceError::NotPositive { field, value });
            }
            if field != "generator/duration_s" && value >= nyquist_hz {
                return Err(SequenceError::AboveNyquist { field, frequency_hz: value, nyquist_hz });
            }
        }
        if !(-1e6..=1e6).contains(&self.phase_rad) {
            let (field, value) = ("generator/phase_rad", self.phase_rad);
            return Err(SequenceError::OutOfRange { field, value, least: -1e6, most: 1e6 });
        }
        Ok(())
    }

    /// Length in seconds.
    pub(super) fn duration_s(&self) -> f64 {
        match self.preset {
            Some(ChirpPreset::Zhang2015Section32) => reference_signals::CHIRP80_DURATION_S,
            Some(ChirpPreset::Zhang2015Section52) => reference_signals::CHIRP60_DURATION_S,
            None => self.duration_s.unwrap_or(f64::NAN),
        }
    }

    fn at(&self, t: f64) -> f64 {
        self.amplitude
            * match self.preset {
                Some(ChirpPreset::Zhang2015Section32) => reference_signals::chirp80_at(t),
                Some(ChirpPreset::Zhang2015Section52) => reference_signals::chirp60_at(t),
                None => {
                    let (f0, f1, length) =
                        (self.from_hz.unwrap_or(0.0), self.to_hz.unwrap_or(0.0), self.duration_s.unwrap_or(1.0));
                    let cycles = match self.sweep {
                        Sweep::Logarithmic if f0 != f1 => {
                            let rate = (f1 / f0).ln() / length;
                            f0 * (rate * t).exp_m1() / rate
                        }
                        _ => f0 * t + (f1 - f0) * t * t / (2.0 * length),
                    };
                    (2.0 * PI * cycles + self.phase_rad).sin()
                }
            }
    }

    pub(super) fn sample(&self, sample_time_s: f64) -> Sequence {
        let values = reference_signals::sampled(sample_time_s, self.duration_s(), |t| self.at(t));
        Sequence {
            sample_time_s,
            values,
            period: None,
            harmonics: None,
            chip_s: None,
            details: SequenceDetails::default(),
        }
    }
}
