//! Filtered noise: white noise through a Butterworth low-pass, limited, and tapered by a Tukey window (Priess 2015,
//! section 2.2.2).

use super::error::SequenceError;
use super::sampled::{Sequence, SequenceDetails};
use crate::ctl::{Ctl, Stopped};
use crate::num::rng::stream;
use rand_distr::{Distribution as _, StandardNormal};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// The largest order of a filter.
const MAX_ORDER: usize = 200;
/// The filter runs for this many of its slowest time constants before the first sample is kept.
const SETTLING: f64 = 12.0;
/// Samples between two looks at the handle.
const BATCH: usize = 1 << 15;

/// A screen on which the signal is shown: `ρ = atan2(w x, d)` turns a place x on it into an angle in rad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "NoiseScreen")]
pub struct Screen {
    /// Width w of the screen, m.
    pub width_m: f64,
    /// Distance d of the person from it, m.
    pub distance_m: f64,
}

/// Filtered noise as written in JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FilteredNoise {
    /// The edge of the pass band, Hz.
    pub edge_hz: f64,
    /// From there to the edge of the stop band, Hz. Default: 0.5.
    #[serde(default = "transition")]
    pub transition_hz: f64,
    /// Attenuation at the edge of the pass band, dB. Default: 3.
    #[serde(default = "ripple")]
    pub ripple_db: f64,
    /// Attenuation at the edge of the stop band, dB. Default: 40.
    #[serde(default = "attenuation")]
    pub attenuation_db: f64,
    /// Length, s.
    pub duration_s: f64,
    /// Standard deviation after the filter, before the limit, in the unit of the signal. Default: 0.25.
    #[serde(default = "deviation")]
    pub rms: f64,
    /// What is larger is cut to this magnitude, in the unit of the signal; null for none. Default: 0.5.
    #[serde(default = "limit")]
    pub limit: Option<f64>,
    /// The screen that turns it into an angle; none by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub screen: Option<Screen>,
    /// Share of the record at each end over which a Tukey window brings it to zero, dimensionless. Default: 0.1.
    #[serde(default = "taper")]
    pub taper: f64,
    /// Seed of the noise. Default: 1.
    #[serde(default = "first_seed")]
    pub seed: u64,
}

fn transition() -> f64 {
    0.5
}
fn ripple() -> f64 {
    3.0
}
fn attenuation() -> f64 {
    40.0
}
fn deviation() -> f64 {
    0.25
}
#[expect(clippy::unnecessary_wraps, reason = "the default of an optional field")]
fn limit() -> Option<f64> {
    Some(0.5)
}
fn taper() -> f64 {
    0.1
}
fn first_seed() -> u64 {
    1
}

impl FilteredNoise {
    pub(super) fn check(&self, sample_time_s: f64) -> Result<(), SequenceError> {
        let positive = [
            ("generator/edge_hz", self.edge_hz),
            ("generator/transition_hz", self.transition_hz),
            ("generator/ripple_db", self.ripple_db),
            ("generator/attenuation_db", self.attenuation_db),
            ("generator/duration_s", self.duration_s),
            ("generator/rms", self.rms),
            ("generator/limit", self.limit.unwrap_or(1.0)),
            ("generator/screen/width_m", self.screen.map_or(1.0, |screen| screen.width_m)),
            ("generator/screen/distance_m", self.screen.map_or(1.0, |screen| screen.distance_m)),
        ];
        for (field, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(SequenceError::NotPositive { field, value });
            }
        }
        if !(0.0..=0.5).contains(&self.taper) {
            return Err(SequenceError::OutOfRange {
                field: "generator/taper",
                value: self.taper,
                least: 0.0,
                most: 0.5,
            });
        }
        self.filter(sample_time_s).map(|_| ())
    }

    /// The filter.
    ///
    /// # Errors
    /// [`SequenceError`] where the edges are no filter at this sample time.
    pub fn filter(&self, sample_time_s: f64) -> Result<Butterworth, SequenceError> {
        Butterworth::between(
            [self.edge_hz, self.edge_hz + self.transition_hz],
            [self.ripple_db, self.attenuation_db],
            sample_time_s,
        )
    }

    pub(super) fn sample(&self, sample_time_s: f64, samples: usize, ctl: &Ctl) -> Result<Sequence, SequenceError> {
        let filter = self.filter(sample_time_s)?;
        let gain = self.rms / filter.noise_gain(ctl)?;
        let settling = filter.settling_samples();
        let mut random = stream(self.seed, "excite/filtered_noise");
        let mut running = filter.clone();
        let mut values = Vec::with_capacity(samples);
        for k in 0..settling + samples {
            if k % BATCH == 0 {
                ctl.check()?;
            }
            let white: f64 = StandardNormal.sample(&mut random);
            let x = gain * running.step(white);
            if k >= settling {
                let x = self.limit.map_or(x, |limit| x.clamp(-limit, limit));
                values.push(self.screen.map_or(x, |screen| (screen.width_m * x).atan2(screen.distance_m)));
            }
        }
        for (k, value) in values.iter_mut().enumerate() {
            *value *= tukey(k, samples, self.taper);
        }
        let details = SequenceDetails {
            filter_order: Some(filter.order()),
            cutoff_hz: Some(filter.cutoff_hz),
            ..SequenceDetails::default()
        };
        Ok(Sequence { sample_time_s, values, period: None, harmonics: None, chip_s: None, details })
    }
}

/// The Tukey window of `samples` samples at sample `k`: half a cosine over the share `taper` at each end, one between.
#[must_use]
pub fn tukey(k: usize, samples: usize, taper: f64) -> f64 {
    let last = samples.saturating_sub(1) as f64;
    let edge = taper * last;
    let from_end = (k as f64).min(last - k as f64);
    if edge > 0.0 && from_end < edge { 0.5 * (1.0 - (PI * from_end / edge).cos()) } else { 1.0 }
}

/// A digital Butterworth low-pass as a chain of sections of second order, by Tustin's substitution with prewarped
/// edges.
#[derive(Debug, Clone, PartialEq)]
pub struct Butterworth {
    /// The frequency of −3 dB, Hz.
    pub cutoff_hz: f64,
    order: usize,
    /// `tan(π f_c T)`.
    warped: f64,
    sections: Vec<Section>,
}

/// `(b₀ + b₁ z⁻¹ + b₂ z⁻²)/(1 + a₁ z⁻¹ + a₂ z⁻²)`, transposed direct form II.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Section {
    b: [f64; 3],
    a: [f64; 2],
    state: [f64; 2],
}

impl Butterworth {
    /// The filter of least order that loses at most `ripple_db` at the first edge and at least `attenuation_db` at the
    /// second; it meets the latter exactly.
    ///
    /// # Errors
    /// [`SequenceError::AboveNyquist`], [`SequenceError::FilterOrder`], or an attenuation that is not above the ripple.
    pub fn between(edges_hz: [f64; 2], losses_db: [f64; 2], sample_time_s: f64) -> Result<Self, SequenceError> {
        let nyquist_hz = 0.5 / sample_time_s;
        if edges_hz[1] >= nyquist_hz {
            let (field, frequency_hz) = ("generator/edge_hz", edges_hz[1]);
            return Err(SequenceError::AboveNyquist { field, frequency_hz, nyquist_hz });
        }
        if losses_db[1] <= losses_db[0] || losses_db[1] > 200.0 {
            return Err(SequenceError::OutOfRange {
                field: "generator/attenuation_db",
                value: losses_db[1],
                least: losses_db[0],
                most: 200.0,
            });
        }
        let warp = |f: f64| (PI * f * sample_time_s).tan();
        let excess = |db: f64| (db * std::f64::consts::LN_10 / 10.0).exp_m1();
        let (pass, stop) = (excess(losses_db[0]), excess(losses_db[1]));
        let order = ((stop / pass).ln() / (2.0 * (warp(edges_hz[1]) / warp(edges_hz[0])).ln()) - 1e-9).ceil().max(1.0);
        let is_reliable = order <= MAX_ORDER as f64;
        if !is_reliable {
            return Err(SequenceError::FilterOrder { order, most: MAX_ORDER });
        }
        let warped = warp(edges_hz[1]) / stop.powf(0.5 / order);
        Ok(Self::new(order as usize, warped, sample_time_s))
    }

    fn new(order: usize, warped: f64, sample_time_s: f64) -> Self {
        let w = warped;
        let mut sections = Vec::new();
        for pair in 0..order / 2 {
            // s² + 2 sin θ w s + w², with θ from the imaginary axis.
            let damping = 2.0 * (PI * (2 * pair + 1) as f64 / (2 * order) as f64).sin();
            let leading = 1.0 + damping * w + w * w;
            let gain = w * w / leading;
            sections.push(Section {
                b: [gain, 2.0 * gain, gain],
                a: [2.0 * (w * w - 1.0) / leading, (1.0 - damping * w + w * w) / leading],
                state: [0.0; 2],
            });
        }
        if order % 2 == 1 {
            let gain = w / (1.0 + w);
            sections.push(Section { b: [gain, gain, 0.0], a: [(w - 1.0) / (1.0 + w), 0.0], state: [0.0; 2] });
        }
        Self { cutoff_hz: w.atan() / (PI * sample_time_s), order, warped, sections }
    }

    /// The order.
    #[must_use]
    pub fn order(&self) -> usize {
        self.order
    }

    /// `|H|²` at the frequency `f T` in cycles per sample: `1/(1 + (tan(πfT)/tan(πf_cT))^{2n})`.
    #[must_use]
    pub fn power_gain(&self, cycles: f64) -> f64 {
        (1.0 + ((PI * cycles).tan() / self.warped).powi(2 * self.order as i32)).recip()
    }

    /// Takes an input and gives the output of the same sample.
    pub fn step(&mut self, input: f64) -> f64 {
        self.sections.iter_mut().fold(input, |x, Section { b, a, state }| {
            let y = b[0] * x + state[0];
            *state = [b[1] * x - a[0] * y + state[1], b[2] * x - a[1] * y];
            y
        })
    }

    /// Samples after which what was before is forgotten.
    fn settling_samples(&self) -> usize {
        // The slowest analogue pole has the real part −w sin(π/2n), in units of 2/T.
        let slowest = 2.0 * self.warped * (PI / (2 * self.order) as f64).sin();
        ((SETTLING + 2.0 * (self.order as f64).sqrt()) / slowest).ceil().min(5e6) as usize
    }

    /// Standard deviation of the output for white noise of standard deviation 1: `√Σ h²`.
    fn noise_gain(&self, ctl: &Ctl) -> Result<f64, Stopped> {
        let mut impulse = self.clone();
        let mut sum = 0.0;
        for k in 0..self.settling_samples() {
            if k % BATCH == 0 {
                ctl.check()?;
            }
            sum += impulse.step(if k == 0 { 1.0 } else { 0.0 }).powi(2);
        }
        Ok(sum.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_filter_has_the_response_of_its_formula_and_meets_its_edges() {
        for edge in [0.4, 1.0, 3.0] {
            let filter = Butterworth::between([edge, edge + 0.5], [3.0, 40.0], 0.01).unwrap();
            assert!((10.0 * filter.power_gain((edge + 0.5) * 0.01).log10() + 40.0).abs() < 1e-9);
            assert!(10.0 * filter.power_gain(edge * 0.01).log10() >= -3.0 - 1e-9);
            // The transform of the impulse response.
            let mut running = filter.clone();
            let n = filter.settling_samples();
            let impulse: Vec<f64> = (0..n).map(|k| running.step(f64::from(u8::from(k == 0)))).collect();
            for cycles in [0.0, 0.5 * edge * 0.01, edge * 0.01, (edge + 0.3) * 0.01] {
                let sum: num_complex::Complex64 = impulse
                    .iter()
                    .enumerate()
                    .map(|(k, h)| num_complex::Complex64::from_polar(*h, -2.0 * PI * cycles * k as f64))
                    .sum();
                assert!((sum.norm_sqr() - filter.power_gain(cycles)).abs() < 1e-6, "{edge} {cycles}");
            }
        }
    }

    #[test]
    fn the_window_is_one_in_the_middle_and_zero_at_the_ends() {
        assert_eq!((tukey(0, 101, 0.1), tukey(100, 101, 0.1), tukey(50, 101, 0.1)), (0.0, 0.0, 1.0));
        assert!((tukey(5, 101, 0.1) - 0.5).abs() < 1e-15 && tukey(10, 101, 0.1) == 1.0 && tukey(0, 9, 0.0) == 1.0);
    }
}
