//! How it is estimated: as written, and as the trials make it.

use crate::analysis::contract::Part;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{self, wrong_spec as wrong};
use crate::control::System;
use crate::num::fourier::real_transform;
use crate::prediction_error::estimate::Settings;
use crate::prediction_error::feedforward::slow_zeros;
use crate::prediction_error::lags::{Lags, LagsError, MOST_AUTOREGRESSIVE, MOST_LAGS, MOST_MOVING_AVERAGE, Sharing};
use crate::trial::Trial;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The sample time that trials are brought near to, in seconds.
const WORKING_SAMPLE_TIME_S: f64 = 0.02;

/// Delays that a person can have, in seconds.
pub(super) const FEEDBACK_DELAY_S: [f64; 2] = [0.08, 0.34];

/// Lags of the control.
pub(super) const AUTOREGRESSIVE: usize = 2;

const PREVIEW_S: f64 = 0.2;
const MEMORY_S: f64 = 0.5;

/// The share of the command's power that lies in the default band.
const POWER_IN_BAND: f64 = 0.99;

/// Columns that the feedforward has beyond those that the phase over half its window asks for.
const SPARE_TERMS: usize = 6;

/// Trials in the first and in the last block.
const CHANGE_TRIALS: usize = 6;

/// What is the same for all trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Shared {
    /// The shape of the noise, and with it the poles of both controllers; variances are those of each trial.
    Noise,
    /// The feedback. Needs `noise`.
    Feedback,
    /// The feedforward. Needs `noise`.
    Feedforward,
}

/// How it is estimated.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PredictionErrorSpec {
    /// The sample time that is worked at, in seconds: a multiple of the trials' own. Samples between are left out.
    /// Default: the multiple nearest to 0.02 s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_time_s: Option<f64>,
    /// The least and the largest delay of the feedback in seconds: every lag of the error between them is free.
    /// Default:
    /// 0.08 to 0.34 s. A shorter least delay lets the negative inverse of the plant pass for a feedback.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedback_delay_s: Option<[f64; 2]>,
    /// How many lags of the control: the poles of both controllers and of the noise. Default: 2, or the least delay in
    /// samples where that is 1. More than the least delay in samples are refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub autoregressive_order: Option<usize>,
    /// Order of the noise's moving average, to 4. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moving_average_order: Option<usize>,
    /// How far ahead the feedforward may look, in seconds. How far a person does look cannot be told from a slow
    /// command, and is not claimed. Default: 0.2 s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preview_s: Option<f64>,
    /// How far back the feedforward's window reaches, in seconds; the plant's slow zeros reach beyond. Default: 0.5 s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedforward_memory_s: Option<f64>,
    /// How many polynomials the weights of the feedforward's lags are made of. Default: 6 and as many as the band's
    /// upper end turns in rad over half the window.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedforward_terms: Option<usize>,
    /// What all trials have in common; an empty list estimates each by itself. Default: feedback and noise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shared: Option<Vec<Shared>>,
    /// The band of the norms in Hz. Default: from one over the record's length to where 99 % of the command's power
    /// lies below.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub band_hz: Option<[f64; 2]>,
    /// How many first and last trials, in the order of the request, the change of the feedback is taken between; 0 for
    /// no change. Default: 6, or half of the trials.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change_trials: Option<usize>,
}

impl Part for PredictionErrorSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        reading::spec(value, at)
    }
}

/// A checked spec.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CheckedSpec {
    /// With every default filled in that does not depend on the trials.
    pub used: PredictionErrorSpec,
    sharing: Sharing,
    delay_s: [f64; 2],
    preview_s: f64,
    memory_s: f64,
    moving_average: usize,
}

/// How the trials at hand are estimated.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Resolved {
    /// The regression.
    pub settings: Settings,
    /// Each how-manieth sample is taken.
    pub step: usize,
    /// The sample time then, in seconds.
    pub sample_time_s: f64,
    /// The band of the norms in rad/s.
    pub band_rad_s: [f64; 2],
}

fn within(value: f64, least: f64, most: f64) -> bool {
    value.is_finite() && value >= least && value <= most
}

impl CheckedSpec {
    /// Checks what can be checked without trials.
    pub(super) fn new(written: PredictionErrorSpec) -> Result<Self, Problem> {
        if let Some(time) = written.sample_time_s.filter(|t| !within(*t, 1e-6, 10.0)) {
            return Err(wrong(format!("{time} s is no sample time from 1e-6 to 10 s"), "/spec/sample_time_s"));
        }
        let delay_s = written.feedback_delay_s.unwrap_or(FEEDBACK_DELAY_S);
        if !(within(delay_s[0], 0.0, 10.0) && within(delay_s[1], delay_s[0], 10.0)) {
            let detail = format!("delays from {} to {} s are no range within 0 to 10 s", delay_s[0], delay_s[1]);
            return Err(wrong(detail, "/spec/feedback_delay_s"));
        }
        let preview_s = written.preview_s.unwrap_or(PREVIEW_S);
        let memory_s = written.feedforward_memory_s.unwrap_or(MEMORY_S);
        for (name, value) in [("preview_s", preview_s), ("feedforward_memory_s", memory_s)] {
            if !within(value, 0.0, 10.0) {
                return Err(wrong(format!("{value} s does not lie within 0 to 10 s"), format!("/spec/{name}")));
            }
        }
        let moving_average = written.moving_average_order.unwrap_or(0);
        for (name, value, least, most) in [
            ("autoregressive_order", written.autoregressive_order, 0, MOST_AUTOREGRESSIVE),
            ("moving_average_order", written.moving_average_order, 0, MOST_MOVING_AVERAGE),
            ("feedforward_terms", written.feedforward_terms, 1, MOST_LAGS),
        ] {
            if let Some(value) = value.filter(|v| !(least..=most).contains(v)) {
                return Err(wrong(format!("{value} does not lie within {least} to {most}"), format!("/spec/{name}")));
            }
        }
        if let Some([from, to]) = written.band_hz.filter(|[from, to]| !(*from >= 0.0 && from < to && to.is_finite())) {
            return Err(wrong(format!("{from} to {to} Hz is no band"), "/spec/band_hz"));
        }
        let shared = written.shared.clone().unwrap_or_else(|| vec![Shared::Feedback, Shared::Noise]);
        let has = |what: Shared| shared.contains(&what);
        let sharing = Sharing {
            noise: has(Shared::Noise),
            feedback: has(Shared::Feedback),
            feedforward: has(Shared::Feedforward),
        };
        if !sharing.noise && (sharing.feedback || sharing.feedforward) {
            let detail = "a controller cannot be the same in all trials while its poles, which are the noise's, differ";
            return Err(wrong(detail, "/spec/shared").mend("Share the noise too."));
        }
        let used = PredictionErrorSpec {
            feedback_delay_s: Some(delay_s),
            moving_average_order: Some(moving_average),
            preview_s: Some(preview_s),
            feedforward_memory_s: Some(memory_s),
            shared: Some(shared),
            ..written
        };
        Ok(Self { used, sharing, delay_s, preview_s, memory_s, moving_average })
    }

    /// The trials of each block of a change; 0 for no change.
    pub(super) fn change_trials(&self, trials: usize) -> Result<usize, Problem> {
        let half = trials / 2;
        match self.used.change_trials {
            None => Ok(half.min(CHANGE_TRIALS)),
            Some(count) if count <= half => Ok(count),
            Some(count) => {
                let detail = format!("{count} first and {count} last of {trials} trials overlap");
                Err(wrong(detail, "/spec/change_trials"))
            }
        }
    }

    /// The lags of these trials.
    pub(super) fn resolve(&self, plant: &System, trials: &[&Trial]) -> Result<Resolved, Problem> {
        let own = trials.first().map_or(WORKING_SAMPLE_TIME_S, |trial| trial.sample_time_s);
        let step = self.step(own)?;
        let sample_time_s = own * step as f64;
        let nyquist = 0.5 / sample_time_s;
        let band_hz = match self.used.band_hz {
            Some(band) => band,
            None => default_band(trials),
        };
        if band_hz[1] > nyquist {
            let detail = format!("the band ends at {} Hz, above half the sample rate, {nyquist} Hz", band_hz[1]);
            return Err(wrong(detail, "/spec/band_hz"));
        }
        let band_rad_s = band_hz.map(|f| 2.0 * std::f64::consts::PI * f);
        let samples = |seconds: f64| (seconds / sample_time_s).round() as usize;
        // A delay of so many samples and a rounding error is one of so many samples.
        let least = ((self.delay_s[0] / sample_time_s - 1e-6).ceil().max(0.0) as usize).max(1);
        let largest = (self.delay_s[1] / sample_time_s + 1e-6).floor() as usize;
        let (ahead, behind) = (samples(self.preview_s), samples(self.memory_s).max(1));
        let window = ahead + behind;
        let turns = 0.5 * band_rad_s[1] * window as f64 * sample_time_s;
        let terms = self.used.feedforward_terms.unwrap_or((SPARE_TERMS + turns.ceil() as usize).min(window));
        let lags = Lags {
            autoregressive: self.used.autoregressive_order.unwrap_or(AUTOREGRESSIVE.min(least)),
            moving_average: self.moving_average,
            feedback: [least, largest.max(least)],
            ahead,
            behind,
            terms,
        };
        lags.check().map_err(|error| {
            let field = match error {
                LagsError::InverseOfThePlant { .. } => "autoregressive_order",
                LagsError::NoDelay | LagsError::Reversed { .. } => "feedback_delay_s",
                LagsError::NoFeedforward => "feedforward_terms",
                LagsError::TooMany { what: "lags of the error", .. } => "feedback_delay_s",
                LagsError::TooMany { .. } => "feedforward_terms",
            };
            wrong(error.to_string(), format!("/spec/{field}"))
        })?;
        let settings = Settings { lags, sharing: self.sharing, zeros: slow_zeros(plant, sample_time_s) };
        Ok(Resolved { settings, step, sample_time_s, band_rad_s })
    }

    fn step(&self, own: f64) -> Result<usize, Problem> {
        let Some(wanted) = self.used.sample_time_s else {
            return Ok((WORKING_SAMPLE_TIME_S / own).round().max(1.0) as usize);
        };
        let ratio = wanted / own;
        let step = ratio.round();
        if step < 1.0 || (ratio - step).abs() > 1e-5 * ratio {
            let detail = format!("{wanted} s is no multiple of the trials' sample time, {own} s");
            return Err(wrong(detail, "/spec/sample_time_s"));
        }
        Ok(step as usize)
    }
}

/// From one over the length of the shortest record to where most of the command's power (or, without one, the
/// disturbance's) lies below in every record.
fn default_band(trials: &[&Trial]) -> [f64; 2] {
    let mut band = [0.0_f64, f64::INFINITY];
    for trial in trials {
        let signals = &trial.signals;
        let length = trial.samples() as f64 * trial.sample_time_s;
        let of = |x: &[f64]| {
            let power: Vec<f64> = real_transform(x).iter().skip(1).map(|z| z.norm_sqr()).collect();
            let all: f64 = power.iter().sum();
            let mut sum = 0.0;
            let last = power.iter().position(|p| {
                sum += p;
                sum >= POWER_IN_BAND * all
            });
            last.filter(|_| all > 0.0).map(|k| (k + 1) as f64 / length)
        };
        let top = of(&signals.command).or_else(|| signals.disturbance.as_deref().and_then(of));
        band = [band[0].max(1.0 / length), band[1].min(top.unwrap_or(f64::INFINITY))];
    }
    if band[1] > band[0] && band[1].is_finite() { band } else { [band[0], 2.0 * band[0].max(1e-9)] }
}
