//! The signal of a request: a sequence to be made, a recorded trial, or samples.
//!
//! ```json
//! {"generator": {"kind": "prts", "order": 5, "chip_s": 0.2}, "sample_time_s": 0.001}
//! {"trial": "ID", "channel": "y", "generator": {"kind": "prts", "order": 5, "chip_s": 0.2}}
//! {"trial": "ID", "channel": "r", "to": "y", "period_s": 48.4, "start_s": 48.4}
//! {"samples": [..], "sample_time_s": 0.02, "period_s": 20}
//! ```
//! With a recording, `generator` says what was played: its period and its lines are then those of the signal.

use super::excerpt::{Excerpt, TITLE, generator, wrong};
use super::problems;
use super::signal::Signal;
use crate::analysis::contract::{Failure, Inputs as _};
use crate::analysis::inputs::library::{Library, References};
use crate::analysis::inputs::trials::{PlantNeed, ResolvedTrial, TrialInput, TrialInputs};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::{object, only, read};
use crate::analysis::report::sha256_json;
use crate::ctl::Ctl;
use crate::excite::sequence::{CheckedSequence, MAX_SAMPLES, SequenceSpec};
use crate::trial::Channel;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

/// A column of a trial, by the letter that it has in files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "TrialColumn")]
pub enum Column {
    /// Command.
    R,
    /// Control.
    U,
    /// Output.
    Y,
    /// Disturbance.
    D,
}

impl Column {
    fn channel(self) -> Channel {
        match self {
            Self::R => Channel::Command,
            Self::U => Channel::Control,
            Self::Y => Channel::Output,
            Self::D => Channel::Disturbance,
        }
    }
}

/// A signal, checked as far as that goes without stored things.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum SignalInput {
    /// A sequence to be made.
    #[schemars(title = "MadeSignal", with = "SequenceSpec")]
    Sequence(Box<CheckedSequence>),
    /// A column of a trial, and the column that it is compared with.
    #[schemars(title = "TrialSignal")]
    Trial(Box<TrialSignal>),
    /// Samples in the request.
    #[schemars(title = "SampledSignal")]
    Samples(Box<SampledSignal>),
}

/// A column of a trial, and the column that it is compared with.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct TrialSignal {
    /// The trial: the id of a stored one, or the signals themselves.
    pub trial: TrialInput,
    /// The column that is judged.
    pub channel: Column,
    /// The column that answers to it, another one. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub to: Option<Column>,
    /// Which part.
    #[serde(flatten)]
    pub excerpt: Excerpt,
}

/// Samples in the request.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SampledSignal {
    /// The samples, at least 4, in any unit.
    pub samples: Vec<f64>,
    /// Time between samples in seconds.
    pub sample_time_s: f64,
    /// Which part.
    #[serde(flatten)]
    pub excerpt: Excerpt,
}

/// A problem without the possibility of having been stopped, for checks before anything runs.
fn checked(spec: SequenceSpec, at: &str) -> Result<CheckedSequence, Problem> {
    spec.check().map_err(|error| match problems::sequence(&error, at) {
        Failure::Problem(problem) => problem,
        Failure::Stopped(stopped) | Failure::Interrupted { stopped, .. } => {
            Problem::new(Code::Internal, "stopped", stopped.to_string()).at(at)
        }
    })
}

impl SignalInput {
    /// Checks a sequence or a signal.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(value: &Value, at: &str) -> Result<Self, Problem> {
        const FORMS: &str =
            "Give {\"generator\", \"sample_time_s\"}, {\"trial\", \"channel\"} or {\"samples\", \"sample_time_s\"}.";
        let written = object(value, "the signal", at).map_err(|problem| problem.mend(FORMS))?;
        match (written.get("trial"), written.get("samples")) {
            (Some(_), Some(_)) => Err(wrong("there are both a trial and samples", at).mend(FORMS)),
            (Some(trial), None) => Ok(Self::Trial(Box::new(TrialSignal::parse(trial, written, at)?))),
            (None, Some(samples)) => Ok(Self::Samples(Box::new(SampledSignal::parse(samples, written, at)?))),
            (None, None) => {
                let Some(made_by) = written.get("generator") else {
                    return Err(wrong("there is no generator, no trial and there are no samples", at).mend(FORMS));
                };
                let made_by = generator(made_by, &format!("{at}/generator"))?;
                let mut rest = written.clone();
                // The generator has been read, and its place is named better than here.
                rest.insert("generator".to_owned(), json!(made_by));
                let spec: SequenceSpec = read(&Value::Object(rest), at, TITLE)?;
                Ok(Self::Sequence(Box::new(checked(spec, at)?)))
            }
        }
    }

    /// The stored things that it needs.
    #[must_use]
    pub fn references(&self) -> References {
        match self {
            Self::Trial(signal) => TrialInputs::one(signal.trial.clone()).references(),
            _ => References::default(),
        }
    }

    /// The sample time in seconds, where it is known without the recording.
    #[must_use]
    pub fn sample_time_s(&self) -> Option<f64> {
        match self {
            Self::Sequence(sequence) => Some(sequence.spec().sample_time_s),
            Self::Samples(signal) => Some(signal.sample_time_s),
            Self::Trial(_) => None,
        }
    }

    /// The seed of what is drawn.
    #[must_use]
    pub fn seed(&self) -> Option<u64> {
        if let Self::Sequence(sequence) = self { sequence.seed() } else { None }
    }

    /// SHA-256 of what the signal comes from: of a sequence its spec, of a recording its content, with the excerpt
    /// where that is a part.
    ///
    /// # Errors
    /// `not_found` for a stored trial that is gone.
    pub fn sha256(&self, library: &Library, at: &str) -> Result<String, Problem> {
        let (content, excerpt) = match self {
            Self::Sequence(sequence) => return Ok(sha256_json(&json!(sequence))),
            Self::Samples(signal) => (sha256_json(&json!([signal.samples, signal.sample_time_s])), &signal.excerpt),
            Self::Trial(signal) => (signal.recording(library, at)?.sha256, &signal.excerpt),
        };
        Ok(if *excerpt == Excerpt::default() { content } else { sha256_json(&json!([content, excerpt])) })
    }

    /// The samples.
    ///
    /// # Errors
    /// [`Failure`]: a stored trial that is gone, a column that it does not have, an excerpt outside the record, a
    /// period that is no whole number of samples, or having been stopped.
    pub fn resolve(&self, library: &Library, at: &str, ctl: &Ctl) -> Result<Signal, Failure> {
        let signal = self.resolved(library, at, ctl)?;
        // Squares of squares of these are still finite numbers.
        let of_moderate_size = |values: &[f64]| {
            let peak = values.iter().fold(0.0_f64, |peak, x| peak.max(x.abs()));
            peak == 0.0 || (1e-60..=1e60).contains(&peak)
        };
        if of_moderate_size(&signal.values) && signal.answer.as_deref().is_none_or(of_moderate_size) {
            return Ok(signal);
        }
        Err(wrong("the signal's peak is not between 1e-60 and 1e60", at)
            .mend("Choose units in which the numbers are of moderate size.")
            .into())
    }

    fn resolved(&self, library: &Library, at: &str, ctl: &Ctl) -> Result<Signal, Failure> {
        match self {
            Self::Sequence(sequence) => {
                let made = sequence.sample(ctl).map_err(|error| problems::sequence(&error, at))?;
                Ok(Signal::made(made))
            }
            Self::Samples(signal) => {
                Signal::recorded(&signal.samples, None, signal.sample_time_s, &signal.excerpt, at, ctl)
            }
            Self::Trial(signal) => {
                let recording = signal.recording(library, at)?;
                let column = |column: Column, name: &str| {
                    recording
                        .trial()
                        .signals
                        .channel(column.channel())
                        .ok_or_else(|| wrong("no disturbance was recorded in this trial", format!("{at}/{name}")))
                };
                let values = column(signal.channel, "channel")?;
                let answer = signal.to.map(|to| column(to, "to")).transpose()?;
                Signal::recorded(values, answer, recording.trial().sample_time_s, &signal.excerpt, at, ctl)
            }
        }
    }
}

impl TrialSignal {
    fn parse(trial: &Value, written: &Map<String, Value>, at: &str) -> Result<Self, Problem> {
        only(written, &["trial", "channel", "to", "period_s", "start_s", "end_s", "generator"], at)?;
        let column = |name: &str| -> Result<Option<Column>, Problem> {
            written.get(name).map(|value| read(value, &format!("{at}/{name}"), TITLE)).transpose()
        };
        let trial = trial_input(trial, at)?;
        let channel = column("channel")?.ok_or_else(|| {
            wrong("there is no channel", format!("{at}/channel")).mend("Name the column of the trial: r, u, y or d.")
        })?;
        let to = column("to")?;
        if to == Some(channel) {
            return Err(wrong("a column is compared with itself", format!("{at}/to")));
        }
        Ok(Self { trial, channel, to, excerpt: Excerpt::parse(written, at)? })
    }

    /// The command of a trial and the output that answers to it, of the whole record.
    pub(in crate::analysis) fn tracking(trial: TrialInput) -> Self {
        Self { trial, channel: Column::R, to: Some(Column::Y), excerpt: Excerpt::default() }
    }

    fn recording(&self, library: &Library, at: &str) -> Result<ResolvedTrial, Problem> {
        let place = format!("{at}/trial");
        let resolved = TrialInputs::one(self.trial.clone()).resolve(library);
        let first = resolved.map_err(|problem| problem.at(place.clone()))?.into_iter().next();
        first.ok_or_else(|| wrong("there is no trial", place))
    }
}

/// The trial of the object at `at`: an id, or signals.
pub(in crate::analysis) fn trial_input(trial: &Value, at: &str) -> Result<TrialInput, Problem> {
    let inputs = Value::Object(Map::from_iter([("trial".to_owned(), trial.clone())]));
    let parsed = TrialInputs::parse(&inputs, PlantNeed::Optional).map_err(|problem| {
        let inner = problem.location.clone().unwrap_or_default();
        let rest = inner.strip_prefix("/inputs").unwrap_or_default().to_owned();
        problem.at(format!("{at}{rest}"))
    })?;
    parsed.trials().first().cloned().ok_or_else(|| wrong("there is no trial", format!("{at}/trial")))
}

impl SampledSignal {
    fn parse(samples: &Value, written: &Map<String, Value>, at: &str) -> Result<Self, Problem> {
        only(written, &["samples", "sample_time_s", "period_s", "start_s", "end_s", "generator"], at)?;
        let samples: Vec<f64> = read(samples, &format!("{at}/samples"), TITLE)?;
        if !(4..=MAX_SAMPLES).contains(&samples.len()) {
            let detail = format!("there are {} samples; 4 to {MAX_SAMPLES} are taken", samples.len());
            return Err(wrong(detail, format!("{at}/samples")));
        }
        let sample_time = written.get("sample_time_s").unwrap_or(&Value::Null);
        let sample_time_s = sample_time.as_f64().filter(|t| *t > 0.0 && t.is_finite()).ok_or_else(|| {
            let detail = format!("the sample time {sample_time} is no positive number of seconds");
            wrong(detail, format!("{at}/sample_time_s"))
        })?;
        Ok(Self { samples, sample_time_s, excerpt: Excerpt::parse(written, at)? })
    }
}
