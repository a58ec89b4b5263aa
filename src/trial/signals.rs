//! The signals of a trial, checked.

use super::error::TrialError;
use super::sample_time;
use sha2::{Digest, Sha256};

/// A column of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Channel {
    /// Time, `t`, in seconds.
    Time,
    /// Command, `r`: the reference that the person follows.
    Command,
    /// Control, `u`: what the person does (the plant's input).
    Control,
    /// Output, `y`: the plant's output, which the person sees.
    Output,
    /// Disturbance, `d`: added to the control at the plant's input.
    Disturbance,
}

impl Channel {
    /// All channels, in the order in which they are written.
    pub const ALL: [Self; 5] = [Self::Time, Self::Command, Self::Control, Self::Output, Self::Disturbance];

    /// The one-letter name used in column headers and JSON.
    #[must_use]
    pub fn letter(self) -> &'static str {
        match self {
            Self::Time => "t",
            Self::Command => "r",
            Self::Control => "u",
            Self::Output => "y",
            Self::Disturbance => "d",
        }
    }
}

/// Equally long columns of finite numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Signals {
    /// The time column as recorded, in seconds; `None` where only a sample time was given.
    pub time_s: Option<Vec<f64>>,
    /// Command r.
    pub command: Vec<f64>,
    /// Control u.
    pub control: Vec<f64>,
    /// Output y.
    pub output: Vec<f64>,
    /// Disturbance d at the plant input; `None` where none was recorded.
    pub disturbance: Option<Vec<f64>>,
}

impl Signals {
    /// The column of a channel, where there is one.
    #[must_use]
    pub fn channel(&self, channel: Channel) -> Option<&[f64]> {
        match channel {
            Channel::Time => self.time_s.as_deref(),
            Channel::Command => Some(&self.command),
            Channel::Control => Some(&self.control),
            Channel::Output => Some(&self.output),
            Channel::Disturbance => self.disturbance.as_deref(),
        }
    }
}

/// Only this module can make one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Checked;

/// A recorded trial whose columns are equally long, finite and equally spaced in time.
///
/// Made by [`Trial::new`] and [`Trial::from_signals`] only, which refuse anything else.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Time between samples, in seconds.
    pub sample_time_s: f64,
    /// The columns.
    pub signals: Signals,
    /// Keeps struct literals, which check nothing, out of other modules.
    _checked: Checked,
}

impl Trial {
    /// The fewest samples that have a sample time. Analyses ask for more, each with its reason.
    pub(crate) const MINIMUM_SAMPLES: usize = 2;

    /// A trial with a known sample time, which a time column, where there is one, must agree with.
    ///
    /// # Errors
    /// [`TrialError`]: fewer than [`Trial::MINIMUM_SAMPLES`] samples, columns of unequal lengths, a value that is not
    /// finite, a sample time that is not positive and finite, or a time column that is not the grid of this sample time
    /// (see [`sample_time`]).
    pub fn new(sample_time_s: f64, signals: Signals) -> Result<Self, TrialError> {
        Self::checked(Some(sample_time_s), signals)
    }

    /// A trial whose sample time, unless it is given, comes from its time column.
    ///
    /// # Errors
    /// As [`Trial::new`], and [`TrialError::NoSampleTime`] where there is neither.
    pub fn from_signals(sample_time_s: Option<f64>, signals: Signals) -> Result<Self, TrialError> {
        Self::checked(sample_time_s, signals)
    }

    /// As [`Trial::from_signals`]; what is no trial comes back with the reason.
    ///
    /// # Errors
    /// The reason, and the signals.
    pub fn or_return(sample_time_s: Option<f64>, signals: Signals) -> Result<Self, (TrialError, Signals)> {
        match Self::sample_time_of(sample_time_s, &signals) {
            Ok(sample_time_s) => Ok(Self { sample_time_s, signals, _checked: Checked }),
            Err(error) => Err((error, signals)),
        }
    }

    fn checked(given_s: Option<f64>, signals: Signals) -> Result<Self, TrialError> {
        Self::or_return(given_s, signals).map_err(|(error, _)| error)
    }

    fn sample_time_of(given_s: Option<f64>, signals: &Signals) -> Result<f64, TrialError> {
        let samples = signals.output.len();
        for channel in Channel::ALL {
            let Some(column) = signals.channel(channel) else { continue };
            if column.len() != samples {
                return Err(TrialError::UnequalLengths { channel, samples: column.len(), expected: samples });
            }
        }
        if samples < Self::MINIMUM_SAMPLES {
            return Err(TrialError::TooFewSamples { samples, minimum: Self::MINIMUM_SAMPLES });
        }
        let first_bad = Channel::ALL
            .into_iter()
            .filter_map(|channel| {
                let column = signals.channel(channel)?;
                let sample = column.iter().position(|value| !value.is_finite())?;
                Some((sample, channel, column[sample]))
            })
            .min_by_key(|(sample, ..)| *sample);
        if let Some((sample, channel, value)) = first_bad {
            return Err(TrialError::NotFinite { channel, sample, value });
        }
        if let Some(bad) = given_s.filter(|value| !(value.is_normal() && *value > 0.0)) {
            return Err(TrialError::BadSampleTime(bad));
        }
        match (&signals.time_s, given_s) {
            (Some(time_s), _) => Ok(sample_time::check(time_s, given_s)?),
            (None, Some(given_s)) => Ok(given_s),
            (None, None) => Err(TrialError::NoSampleTime),
        }
    }

    /// The number of samples.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.signals.output.len()
    }

    /// The command-following error `e = r − y`, sample by sample.
    #[must_use]
    pub fn error(&self) -> Vec<f64> {
        self.signals.command.iter().zip(&self.signals.output).map(|(r, y)| r - y).collect()
    }

    /// SHA-256 of command, control, output and disturbance alone, each number by its bits: the same for a recording
    /// with a time column and for one with a sample time.
    #[must_use]
    pub fn signals_sha256(&self) -> [u8; 32] {
        let mut hasher = Sha256::new();
        for channel in Channel::ALL.into_iter().filter(|channel| *channel != Channel::Time) {
            self.hash_column(channel, &mut hasher);
        }
        hasher.finalize().into()
    }

    fn hash_column(&self, channel: Channel, hasher: &mut Sha256) {
        let Some(column) = self.signals.channel(channel) else { return };
        hasher.update(channel.letter());
        hasher.update((column.len() as u64).to_le_bytes());
        for value in column {
            hasher.update(value.to_le_bytes());
        }
    }

    /// SHA-256 of the sample time and of every column with its name, each number by its bits (little endian).
    ///
    /// The same recording has the same hash whether it came as CSV or JSON, compressed or not.
    #[must_use]
    pub fn content_sha256(&self) -> [u8; 32] {
        let mut hasher = Sha256::new();
        hasher.update(self.sample_time_s.to_le_bytes());
        for channel in Channel::ALL {
            self.hash_column(channel, &mut hasher);
        }
        hasher.finalize().into()
    }
}
