//! A sequence as written, and checked.

use super::MAX_SAMPLES;
use super::chips::ShiftRegister;
use super::chirp::Chirp;
use super::error::SequenceError;
use super::field::Base;
use super::multisine::Multisine;
use super::noise::{FilteredNoise, tukey};
use super::sampled::{Sequence, whole};
use crate::ctl::Ctl;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize, Serializer};

/// What makes a sequence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[schemars(rename = "SequenceGenerator")]
pub enum Generator {
    /// Pseudorandom ternary sequence of maximum length.
    #[schemars(title = "PrtsGenerator")]
    Prts(ShiftRegister),
    /// Pseudorandom binary sequence of maximum length.
    #[schemars(title = "PrbsGenerator")]
    Prbs(ShiftRegister),
    /// Sum of sinusoids.
    #[schemars(title = "MultisineGenerator")]
    Multisine(Multisine),
    /// Swept sinusoid.
    #[schemars(title = "ChirpGenerator")]
    Chirp(Chirp),
    /// White noise through a low-pass.
    #[schemars(title = "FilteredNoiseGenerator")]
    FilteredNoise(FilteredNoise),
}

/// A size that the samples are brought to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "SequenceScale")]
pub enum Scale {
    /// The largest magnitude of a sample, in the unit of the signal.
    #[schemars(title = "PeakScale")]
    Peak(f64),
    /// The root mean square of the samples, in the unit of the signal.
    #[schemars(title = "RmsScale")]
    Rms(f64),
}

/// A sampled sequence as written in JSON.
///
/// In this order: the generator, `scale`, `offset`, `clip`, `taper`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SequenceSpec {
    /// What makes it.
    pub generator: Generator,
    /// Time between samples in seconds.
    pub sample_time_s: f64,
    /// Periods, of a periodic sequence. Default: 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub periods: Option<u32>,
    /// Length in seconds in place of periods: `duration_s / sample_time_s` samples, the end excluded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    /// `{"peak": x}` or `{"rms": x}`. Default: as generated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<Scale>,
    /// Added to every sample, in the unit of the signal. Default: 0.
    #[serde(default)]
    pub offset: f64,
    /// Least and largest value in the unit of the signal; what is beyond is cut. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clip: Option<[f64; 2]>,
    /// Share of the record at each end over which a Tukey window brings it to zero, dimensionless. Default: 0.
    #[serde(default)]
    pub taper: f64,
}

/// A [`SequenceSpec`] whose every field has been checked.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckedSequence {
    spec: SequenceSpec,
    samples: usize,
}

impl SequenceSpec {
    /// One period of a generator, as it comes.
    #[must_use]
    pub fn new(generator: Generator, sample_time_s: f64) -> Self {
        Self {
            generator,
            sample_time_s,
            periods: None,
            duration_s: None,
            scale: None,
            offset: 0.0,
            clip: None,
            taper: 0.0,
        }
    }

    /// Checks it.
    ///
    /// # Errors
    /// [`SequenceError`], which names the field.
    pub fn check(self) -> Result<CheckedSequence, SequenceError> {
        let t = self.sample_time_s;
        if !(t > 0.0 && t.is_finite()) {
            return Err(SequenceError::NotPositive { field: "sample_time_s", value: t });
        }
        match &self.generator {
            Generator::Prts(register) => register.check(Base::Three, t)?,
            Generator::Prbs(register) => register.check(Base::Two, t)?,
            Generator::Multisine(multisine) => multisine.check(t)?,
            Generator::Chirp(chirp) => chirp.check(t)?,
            Generator::FilteredNoise(noise) => noise.check(t)?,
        }
        match self.scale {
            Some(Scale::Peak(value)) if !(value > 0.0 && value.is_finite()) => {
                return Err(SequenceError::NotPositive { field: "scale/peak", value });
            }
            Some(Scale::Rms(value)) if !(value > 0.0 && value.is_finite()) => {
                return Err(SequenceError::NotPositive { field: "scale/rms", value });
            }
            _ => {}
        }
        if !self.offset.is_finite() {
            return Err(SequenceError::OutOfRange {
                field: "offset",
                value: self.offset,
                least: f64::MIN,
                most: f64::MAX,
            });
        }
        if let Some([from, to]) = self.clip
            && !(from < to && from.is_finite() && to.is_finite())
        {
            return Err(SequenceError::Empty { field: "clip", from, to });
        }
        if !(0.0..=0.5).contains(&self.taper) {
            return Err(SequenceError::OutOfRange { field: "taper", value: self.taper, least: 0.0, most: 0.5 });
        }
        let samples = self.count()?;
        Ok(CheckedSequence { spec: self, samples })
    }

    /// Length of a period in seconds, of a generator that has one.
    #[must_use]
    pub fn period_s(&self) -> Option<f64> {
        match &self.generator {
            Generator::Prts(register) => Some(register.period_s(Base::Three)),
            Generator::Prbs(register) => Some(register.period_s(Base::Two)),
            Generator::Multisine(multisine) => Some(multisine.base_hz.recip()),
            Generator::Chirp(_) | Generator::FilteredNoise(_) => None,
        }
    }

    fn count(&self) -> Result<usize, SequenceError> {
        let t = self.sample_time_s;
        if let (Some(_), Some(_)) = (self.periods, self.duration_s) {
            return Err(SequenceError::Together { field: "duration_s", other: "periods" });
        }
        if let Some(value) = self.duration_s.filter(|d| !(*d > 0.0 && d.is_finite())) {
            return Err(SequenceError::NotPositive { field: "duration_s", value });
        }
        if self.periods == Some(0) {
            return Err(SequenceError::NotPositive { field: "periods", value: 0.0 });
        }
        let intervals = |seconds: f64| whole(seconds / t).map_or((seconds / t).floor(), |n| n as f64);
        let own = match &self.generator {
            // Sampled at both ends.
            Generator::Chirp(chirp) => Some(intervals(chirp.duration_s()) + 1.0),
            Generator::FilteredNoise(noise) => Some(intervals(noise.duration_s)),
            _ => None,
        };
        let samples = match (self.period_s(), own) {
            (Some(period_s), _) => match self.duration_s {
                Some(duration_s) => intervals(duration_s),
                // Of a period that is no whole number of samples, those that begin in it.
                None => {
                    let seconds = f64::from(self.periods.unwrap_or(1)) * period_s;
                    whole(seconds / t).map_or((seconds / t).ceil(), |n| n as f64)
                }
            },
            (None, _) if self.periods.is_some() => return Err(SequenceError::NoPeriod),
            (None, _) if self.duration_s.is_some() => {
                return Err(SequenceError::Together { field: "duration_s", other: "the generator's own length" });
            }
            (None, Some(samples)) => samples,
            (None, None) => f64::NAN,
        };
        if samples >= 2.0 && samples <= MAX_SAMPLES as f64 {
            Ok(samples as usize)
        } else {
            Err(SequenceError::Length { samples, most: MAX_SAMPLES })
        }
    }
}

impl Serialize for CheckedSequence {
    /// As [`CheckedSequence::spec`].
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.spec.serialize(serializer)
    }
}

impl CheckedSequence {
    /// As written, with defaults filled in.
    #[must_use]
    pub fn spec(&self) -> &SequenceSpec {
        &self.spec
    }

    /// How many samples it has.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Whether anything is drawn at random, and with which seed.
    #[must_use]
    pub fn seed(&self) -> Option<u64> {
        match &self.spec.generator {
            Generator::Prts(register) | Generator::Prbs(register) => register.seed,
            Generator::Multisine(multisine) => Some(multisine.seed),
            Generator::FilteredNoise(noise) => Some(noise.seed),
            Generator::Chirp(_) => None,
        }
    }

    /// The samples.
    ///
    /// # Errors
    /// [`SequenceError::Stopped`], [`SequenceError::Zero`], or what only the search for a polynomial can tell.
    pub fn sample(&self, ctl: &Ctl) -> Result<Sequence, SequenceError> {
        let (t, n) = (self.spec.sample_time_s, self.samples);
        let mut sequence = match &self.spec.generator {
            Generator::Prts(register) => register.sample(Base::Three, t, n, ctl)?,
            Generator::Prbs(register) => register.sample(Base::Two, t, n, ctl)?,
            Generator::Multisine(multisine) => multisine.sample(t, n, ctl)?,
            Generator::Chirp(chirp) => chirp.sample(t),
            Generator::FilteredNoise(noise) => noise.sample(t, n, ctl)?,
        };
        let values = &mut sequence.values;
        values.truncate(n);
        if let Some(scale) = self.spec.scale {
            let peak = values.iter().fold(0.0_f64, |peak, x| peak.max(x.abs()));
            let factor = match scale {
                Scale::Peak(wanted) => wanted / peak,
                // Scaled by the peak first, so that squares neither overflow nor vanish.
                Scale::Rms(wanted) => {
                    let mean_square = values.iter().map(|x| (x / peak).powi(2)).sum::<f64>() / n as f64;
                    wanted / peak / mean_square.sqrt()
                }
            };
            if !(factor.is_finite() && peak > 0.0) {
                return Err(SequenceError::Zero);
            }
            values.iter_mut().for_each(|x| *x *= factor);
        }
        if self.spec.offset != 0.0 {
            sequence.details.continuous_crest_factor = None;
            values.iter_mut().for_each(|x| *x += self.spec.offset);
        }
        if let Some([least, most]) = self.spec.clip
            && values.iter().any(|x| *x < least || *x > most)
        {
            values.iter_mut().for_each(|x| *x = x.clamp(least, most));
            // What is cut off appears on lines of its own.
            sequence.harmonics = None;
            sequence.details.continuous_crest_factor = None;
        }
        if self.spec.taper > 0.0 {
            let taper = self.spec.taper;
            values.iter_mut().enumerate().for_each(|(k, x)| *x *= tukey(k, n, taper));
            (sequence.period, sequence.harmonics) = (None, None);
            sequence.details.continuous_crest_factor = None;
        }
        Ok(sequence)
    }
}
