//! How it is simulated, and what is shown.

use crate::analysis::contract::Part;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{self, wrong_spec as wrong};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Seeds are exact in JSON.
const MOST_SEED: u64 = 1 << 53;

/// Realisations of the noise, by default and at most.
const REALISATIONS: usize = 100;
const MOST_REALISATIONS: usize = 10_000;

/// Frequencies at most.
const MOST_POINTS: usize = 2_000;

/// How it is simulated, and what is shown.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulateSpec {
    /// The seed of the noise, 0 to 2⁵³. Equal seeds draw equal noise.
    pub seed: u64,
    /// How often the noise is drawn anew for the spread of the metrics: 1 to 10000. The signals are those of the first
    /// time. Without noise it is not used. Default: 100.
    pub realisations: usize,
    /// How long step and free responses are shown, in seconds. Default: 10 s, or less where that is over 20000 samples.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub response_s: Option<f64>,
    /// The band of the frequency responses in Hz, its lower end positive. Default: 0.01 Hz to 10 Hz, or to half the
    /// rate of the samples where that is less.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub band_hz: Option<[f64; 2]>,
    /// How many frequencies, equally spaced on a logarithmic scale, 2 to 2000.
    pub points: usize,
    /// The band of the norms in Hz. Default: 0 to 0.5 Hz, that of Zhang 2015, chapter 5.
    pub norm_band_hz: [f64; 2],
    /// Which samples of the signals are shown: every so many-th. Metrics are of all of them. Default: 1, all.
    pub every: usize,
}

impl Default for SimulateSpec {
    fn default() -> Self {
        Self {
            seed: 1,
            realisations: REALISATIONS,
            response_s: None,
            band_hz: None,
            points: 100,
            norm_band_hz: [0.0, 0.5],
            every: 1,
        }
    }
}

impl Part for SimulateSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        reading::spec(value, at)
    }
}

impl SimulateSpec {
    /// Checks what can be checked without the signals.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub(super) fn check(&self) -> Result<(), Problem> {
        if self.seed > MOST_SEED {
            return Err(wrong(format!("{} is above 2^53", self.seed), "/spec/seed"));
        }
        for (name, value, least, most) in [
            ("realisations", self.realisations, 1, MOST_REALISATIONS),
            ("points", self.points, 2, MOST_POINTS),
            ("every", self.every, 1, usize::MAX),
        ] {
            if !(least..=most).contains(&value) {
                return Err(wrong(format!("{value} does not lie within {least} to {most}"), format!("/spec/{name}")));
            }
        }
        if let Some(seconds) = self.response_s.filter(|seconds| !(*seconds > 0.0 && seconds.is_finite())) {
            return Err(wrong(format!("{seconds} s is no length"), "/spec/response_s"));
        }
        if let Some([from, to]) = self.band_hz.filter(|[from, to]| !(*from > 0.0 && from < to && to.is_finite())) {
            return Err(wrong(format!("{from} to {to} Hz is no band on a logarithmic scale"), "/spec/band_hz"));
        }
        let [from, to] = self.norm_band_hz;
        if !(from >= 0.0 && from < to && to.is_finite()) {
            return Err(wrong(format!("{from} to {to} Hz is no band"), "/spec/norm_band_hz"));
        }
        Ok(())
    }
}
