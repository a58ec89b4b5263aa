//! The same response estimated from parts of the data, each part left out in turn: what cross-validation over trials or
//! segments compares.

use super::error::FrequencyError;
use super::estimate::estimate_between;
use super::result::Estimate;
use super::settings::{Bounds, Channels, CheckedSettings, FrequencySettings, Lines, Segments};
use crate::ctl::Ctl;
use crate::trial::Trial;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parts that are left out one after the other at most; more trials or segments than these are left out several at a
/// time.
pub const MOST_FOLDS: usize = 10;

/// What is left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RepeatKind {
    /// Whole trials.
    Trials,
    /// Segments of the only trial.
    Segments,
}

/// The responses without a part and of that part, line by line as in the estimate of all data.
#[derive(Debug, Clone, PartialEq)]
pub struct Fold {
    /// Angular frequencies in rad/s.
    pub omega_rad_s: Vec<f64>,
    /// Without the part.
    pub rest: Vec<Complex64>,
    /// Of the part.
    pub part: Vec<Complex64>,
}

/// Data divided into parts that repeat one another.
#[derive(Debug, Clone, PartialEq)]
pub struct Repeats {
    /// What the parts are made of.
    pub kind: RepeatKind,
    /// Every part left out once.
    pub folds: Vec<Fold>,
}

/// Divides the data of an estimate: trials where there are two or more, segments otherwise. `None` for a single
/// segment, or where a part has no response at some line.
///
/// # Errors
/// [`FrequencyError`], as of the estimate itself.
pub fn repeats(
    trials: &[&Trial],
    settings: &CheckedSettings,
    estimate: &Estimate,
    channels: Channels,
    ctl: &Ctl,
) -> Result<Option<Repeats>, FrequencyError> {
    let data = estimate.data();
    let hz: Vec<f64> = data.omega_rad_s.iter().map(|w| w / std::f64::consts::TAU).collect();
    let named = |segments: Option<Segments>| -> Option<CheckedSettings> {
        let own = settings.settings().clone();
        let segments = Some(segments.unwrap_or_else(|| settings.segments.clone()));
        let (lines, end_sample) = (Lines::FrequencyHz(hz.clone()), Some(settings.end_sample));
        FrequencySettings { lines, segments, end_sample, band_hz: None, ..own }.check().ok()
    };
    let of = |trials: &[&Trial], settings: &CheckedSettings| -> Result<Option<Vec<Complex64>>, FrequencyError> {
        Ok(estimate_between(trials, settings, channels, ctl)?.h.into_iter().collect())
    };
    let kind = if trials.len() >= 2 { RepeatKind::Trials } else { RepeatKind::Segments };
    let count = if kind == RepeatKind::Trials { trials.len() } else { estimate.segments.len() };
    let mut folds = Vec::new();
    if count < 2 {
        return Ok(None);
    }
    for fold in 0..count.min(MOST_FOLDS) {
        let is_out = |i: usize| i % MOST_FOLDS.min(count) == fold;
        let halves = [false, true].map(|out| -> Result<Option<Vec<Complex64>>, FrequencyError> {
            match kind {
                RepeatKind::Trials => {
                    let own: Vec<&Trial> =
                        trials.iter().enumerate().filter(|(i, _)| is_out(*i) == out).map(|(_, t)| *t).collect();
                    named(None).map_or(Ok(None), |settings| of(&own, &settings))
                }
                RepeatKind::Segments => {
                    let segments = estimate.segments.iter().enumerate().filter(|(i, _)| is_out(*i) == out);
                    let bounds = segments.map(|(_, s)| Bounds { start_s: s.start_s, end_s: s.start_s + s.length_s });
                    named(Some(Segments::Bounds(bounds.collect()))).map_or(Ok(None), |settings| of(trials, &settings))
                }
            }
        });
        let [rest, part] = halves;
        let (Some(rest), Some(part)) = (rest?, part?) else { return Ok(None) };
        folds.push(Fold { omega_rad_s: data.omega_rad_s.clone(), rest, part });
    }
    Ok(Some(Repeats { kind, folds }))
}
