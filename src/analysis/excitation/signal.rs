//! The signal of a request: a sequence to be made, a recorded trial, or samples.
//!
//! ```json
//! {"generator": {"kind": "prts", "order": 5, "chip_s": 0.2}, "sample_time_s": 0.001}
//! {"trial": "ID", "channel": "y", "generator": {"kind": "prts", "order": 5, "chip_s": 0.2}}
//! {"trial": "ID", "channel": "r", "to": "y", "period_s": 48.4, "start_s": 48.4}
//! {"samples": [..], "sample_time_s": 0.02, "period_s": 20}
//! ```
//! With a recording, `generator` says what was played: its period and its lines are then those of the signal.

use super::{members, only, problems, read};
use crate::analysis::inputs::{Library, References};
use crate::analysis::plan::Failure;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::report::sha256_json;
use crate::analysis::trial_input::{PlantNeed, TrialInputs};
use crate::ctl::Ctl;
use crate::excite::sequence::{
    CheckedSequence, Chirp, FilteredNoise, Generator, Multisine, Sequence, SequenceSpec, ShiftRegister,
};
use crate::trial::Channel;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Samples in a request at most.
const MAX_SAMPLES: usize = crate::excite::sequence::MAX_SAMPLES;

/// The title of everything that is wrong with a signal.
const TITLE: &str = "unusable signal";

/// A column of a trial, by the letter that it has in files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
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

/// Which part of a recording, and what was played.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Excerpt {
    /// Length of a period in seconds, a whole number of samples. Default: that of the generator, or the whole excerpt.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub period_s: Option<f64>,
    /// Where the excerpt starts, in seconds from the first sample. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_s: Option<f64>,
    /// Where it ends. Default: the end of the record.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_s: Option<f64>,
    /// What was played.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub generator: Option<Generator>,
}

/// A checked signal.
#[derive(Debug, Clone, PartialEq)]
pub enum SignalInput {
    /// To be made.
    Sequence(Box<CheckedSequence>),
    /// A column of a trial, and the column that it is compared with.
    Trial {
        /// The trial.
        trial: TrialInputs,
        /// The column.
        channel: Column,
        /// The column that answers to it.
        to: Option<Column>,
        /// Which part.
        excerpt: Box<Excerpt>,
    },
    /// In the request.
    Samples {
        /// The samples.
        values: Vec<f64>,
        /// Time between them, s.
        sample_time_s: f64,
        /// Which part.
        excerpt: Box<Excerpt>,
    },
}

/// A signal at hand.
#[derive(Debug, Clone)]
pub struct Signal {
    /// The samples: whole periods where there is a period, and possibly a part of one more.
    pub values: Vec<f64>,
    /// The column that answers to it, sample by sample.
    pub answer: Option<Vec<f64>>,
    /// Time between samples, s.
    pub sample_time_s: f64,
    /// Samples of a period; `None` where none is known, and the record stands for one.
    pub period: Option<usize>,
    /// Multiples of 1/period that carry power by construction.
    pub harmonics: Option<Vec<usize>>,
    /// Length of a chip, s.
    pub chip_s: Option<f64>,
    /// What was chosen or drawn in making it.
    pub details: BTreeMap<&'static str, Value>,
    /// The period in continuous time, where the sample time does not divide it.
    pub uneven_period_s: Option<f64>,
    /// Whether it was made rather than recorded.
    pub is_made: bool,
    /// SHA-256 of what it came from.
    pub sha256: String,
}

fn wrong(detail: impl Into<String>, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, TITLE, detail).at(at)
}

/// A generator, with the pointer of the member that is wrong.
fn generator(value: &Value, at: &str) -> Result<Generator, Problem> {
    const KINDS: &str = "Use one of: prts, prbs, multisine, chirp, filtered_noise.";
    let mut members = members(value, "a generator", at)?.clone();
    let kind = members.remove("kind").unwrap_or(Value::Null);
    let rest = Value::Object(members);
    Ok(match kind.as_str() {
        Some("prts") => Generator::Prts(read::<ShiftRegister>(&rest, at, TITLE)?),
        Some("prbs") => Generator::Prbs(read::<ShiftRegister>(&rest, at, TITLE)?),
        Some("multisine") => Generator::Multisine(read::<Multisine>(&rest, at, TITLE)?),
        Some("chirp") => Generator::Chirp(read::<Chirp>(&rest, at, TITLE)?),
        Some("filtered_noise") => Generator::FilteredNoise(read::<FilteredNoise>(&rest, at, TITLE)?),
        Some(other) => return Err(wrong(format!("there is no generator {other:?}"), format!("{at}/kind")).mend(KINDS)),
        None => return Err(wrong("the generator has no kind", format!("{at}/kind")).mend(KINDS)),
    })
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
        let written = members(value, "the signal", at).map_err(|problem| problem.mend(FORMS))?;
        match (written.get("trial"), written.get("samples")) {
            (Some(_), Some(_)) => Err(wrong("there are both a trial and samples", at).mend(FORMS)),
            (Some(trial), None) => Self::parse_trial(trial, written, at),
            (None, Some(samples)) => Self::parse_samples(samples, written, at),
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

    fn parse_trial(trial: &Value, written: &Map<String, Value>, at: &str) -> Result<Self, Problem> {
        only(written, &["trial", "channel", "to", "period_s", "start_s", "end_s", "generator"], at)?;
        let inputs = Value::Object(Map::from_iter([("trial".to_owned(), trial.clone())]));
        let trial = TrialInputs::parse(&inputs, PlantNeed::Optional).map_err(|problem| {
            let inner = problem.location.clone().unwrap_or_default();
            let rest = inner.strip_prefix("/inputs").unwrap_or_default().to_owned();
            problem.at(format!("{at}{rest}"))
        })?;
        let column = |name: &str| -> Result<Option<Column>, Problem> {
            written.get(name).map(|value| read(value, &format!("{at}/{name}"), TITLE)).transpose()
        };
        let channel = column("channel")?.ok_or_else(|| {
            wrong("there is no channel", format!("{at}/channel")).mend("Name the column of the trial: r, u, y or d.")
        })?;
        let to = column("to")?;
        if to == Some(channel) {
            return Err(wrong("a column is compared with itself", format!("{at}/to")));
        }
        Ok(Self::Trial { trial, channel, to, excerpt: Box::new(excerpt(written, at)?) })
    }

    fn parse_samples(samples: &Value, written: &Map<String, Value>, at: &str) -> Result<Self, Problem> {
        only(written, &["samples", "sample_time_s", "period_s", "start_s", "end_s", "generator"], at)?;
        let values: Vec<f64> = read(samples, &format!("{at}/samples"), TITLE)?;
        if !(4..=MAX_SAMPLES).contains(&values.len()) {
            let detail = format!("there are {} samples; 4 to {MAX_SAMPLES} are taken", values.len());
            return Err(wrong(detail, format!("{at}/samples")));
        }
        let sample_time = written.get("sample_time_s").unwrap_or(&Value::Null);
        let sample_time_s = sample_time.as_f64().filter(|t| *t > 0.0 && t.is_finite()).ok_or_else(|| {
            wrong(
                format!("the sample time {sample_time} is no positive number of seconds"),
                format!("{at}/sample_time_s"),
            )
        })?;
        Ok(Self::Samples { values, sample_time_s, excerpt: Box::new(excerpt(written, at)?) })
    }

    /// The stored things that it needs.
    #[must_use]
    pub fn references(&self) -> References {
        if let Self::Trial { trial, .. } = self { trial.references() } else { References::default() }
    }

    /// The sample time, where it is known without the recording.
    #[must_use]
    pub fn sample_time_s(&self) -> Option<f64> {
        match self {
            Self::Sequence(sequence) => Some(sequence.spec().sample_time_s),
            Self::Samples { sample_time_s, .. } => Some(*sample_time_s),
            Self::Trial { .. } => None,
        }
    }

    /// The seed of what is drawn.
    #[must_use]
    pub fn seed(&self) -> Option<u64> {
        if let Self::Sequence(sequence) = self { sequence.seed() } else { None }
    }

    /// As in the request, with defaults filled in.
    #[must_use]
    pub fn to_value(&self) -> Value {
        let with = |excerpt: &Excerpt, more: Vec<(&str, Value)>| {
            let mut members = json!(excerpt).as_object().cloned().unwrap_or_default();
            members.extend(more.into_iter().map(|(name, value)| (name.to_owned(), value)));
            Value::Object(members)
        };
        match self {
            Self::Sequence(sequence) => json!(sequence.spec()),
            Self::Trial { trial, channel, to, excerpt } => {
                let inner = trial.to_value();
                let mut more = vec![("trial", inner["trial"].clone()), ("channel", json!(channel))];
                more.extend(to.map(|to| ("to", json!(to))));
                with(excerpt, more)
            }
            Self::Samples { values, sample_time_s, excerpt } => {
                with(excerpt, vec![("samples", json!(values)), ("sample_time_s", json!(sample_time_s))])
            }
        }
    }

    /// The samples.
    ///
    /// # Errors
    /// [`Failure`]: a stored trial that is gone, a column that it does not have, an excerpt outside the record, a period that is no whole
    /// number of samples, or having been stopped.
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
                Ok(Signal::made(made, sha256_json(&self.to_value())))
            }
            Self::Samples { values, sample_time_s, excerpt } => {
                let sha256 = sha256_json(&json!([values, sample_time_s]));
                Signal::recorded(values, None, *sample_time_s, excerpt, sha256, at, ctl)
            }
            Self::Trial { trial, channel, to, excerpt } => {
                let resolved = trial.resolve(library).map_err(|problem| problem.at(format!("{at}/trial")))?;
                let Some(recording) = resolved.first() else {
                    return Err(wrong("there is no trial", format!("{at}/trial")).into());
                };
                let column = |column: Column, name: &str| {
                    recording
                        .trial()
                        .signals
                        .channel(column.channel())
                        .ok_or_else(|| wrong("no disturbance was recorded in this trial", format!("{at}/{name}")))
                };
                let values = column(*channel, "channel")?;
                let answer = to.map(|to| column(to, "to")).transpose()?;
                let sha256 = recording.sha256.clone();
                Signal::recorded(values, answer, recording.trial().sample_time_s, excerpt, sha256, at, ctl)
            }
        }
    }
}

fn excerpt(written: &Map<String, Value>, at: &str) -> Result<Excerpt, Problem> {
    let mut members = Map::new();
    for name in ["period_s", "start_s", "end_s"] {
        members.extend(written.get(name).map(|value| (name.to_owned(), value.clone())));
    }
    let mut excerpt: Excerpt = read(&Value::Object(members), at, TITLE)?;
    for (name, value) in [("period_s", excerpt.period_s), ("end_s", excerpt.end_s)] {
        if let Some(value) = value.filter(|v| !(*v > 0.0 && v.is_finite())) {
            return Err(wrong(format!("{name} is {value}, and must be positive"), format!("{at}/{name}")));
        }
    }
    let start_s = excerpt.start_s.unwrap_or(0.0);
    if !(start_s >= 0.0 && start_s < excerpt.end_s.unwrap_or(f64::INFINITY)) {
        return Err(wrong(format!("the excerpt starts at {start_s} s"), format!("{at}/start_s"))
            .mend("Start at 0 s or later, and before end_s."));
    }
    excerpt.generator =
        written.get("generator").map(|value| generator(value, &format!("{at}/generator"))).transpose()?;
    Ok(excerpt)
}

impl Signal {
    fn made(made: Sequence, sha256: String) -> Self {
        let (period, uneven) = match made.period {
            Some(period) => {
                (period.samples.filter(|n| *n <= made.values.len()), period.samples.is_none().then_some(period.seconds))
            }
            None => (None, None),
        };
        Self {
            answer: None,
            sample_time_s: made.sample_time_s,
            harmonics: period.and(made.harmonics),
            period,
            chip_s: made.chip_s,
            details: made.details,
            uneven_period_s: uneven,
            is_made: true,
            values: made.values,
            sha256,
        }
    }

    fn recorded(
        values: &[f64],
        answer: Option<&[f64]>,
        sample_time_s: f64,
        excerpt: &Excerpt,
        sha256: String,
        at: &str,
        ctl: &Ctl,
    ) -> Result<Self, Failure> {
        let record_s = values.len() as f64 * sample_time_s;
        let index = |seconds: f64| (seconds / sample_time_s).round() as usize;
        let start = index(excerpt.start_s.unwrap_or(0.0));
        let end = excerpt.end_s.map_or(values.len(), index);
        if start >= end || end > values.len() {
            let (field, detail) = if end > values.len() {
                ("end_s", format!("the excerpt ends after the record, which has {record_s} s"))
            } else {
                ("start_s", format!("the excerpt starts after its end, in a record of {record_s} s"))
            };
            return Err(wrong(detail, format!("{at}/{field}")).into());
        }
        // What was played, at the recording's own rate; only its period and lines are used.
        let played = match &excerpt.generator {
            None => None,
            Some(made_by) => {
                let spec = SequenceSpec::new(made_by.clone(), sample_time_s);
                let sequence = spec.check().map_err(|error| problems::sequence(&error, at))?;
                Some(sequence.sample(ctl).map_err(|error| problems::sequence(&error, at))?)
            }
        };
        let generated = played.as_ref().and_then(|played| played.period);
        let period_s = excerpt.period_s.or(generated.map(|period| period.seconds));
        let period = match period_s {
            None => None,
            Some(period_s) => {
                let field = if excerpt.period_s.is_some() { "period_s" } else { "generator" };
                let samples = period_s / sample_time_s;
                let whole = samples.round();
                if (samples - whole).abs() > 1e-6 * whole || whole < 4.0 {
                    let detail = format!(
                        "a period of {period_s} s is {samples} samples of {sample_time_s} s, which is no whole number from 4 on"
                    );
                    return Err(wrong(detail, format!("{at}/{field}")).into());
                }
                if whole as usize > end - start {
                    let detail = format!("a period has {whole} samples, and the excerpt of {} holds none", end - start);
                    return Err(wrong(detail, format!("{at}/{field}")).into());
                }
                Some(whole as usize)
            }
        };
        if end - start < 4 {
            return Err(wrong("the excerpt has fewer than 4 samples", format!("{at}/start_s")).into());
        }
        // Given both, the generator's lines count where its period is the one given.
        let same = generated.is_some_and(|g| period_s.is_some_and(|p| (p / g.seconds - 1.0).abs() < 1e-9));
        let (harmonics, chip_s, details) = match played {
            Some(played) => (played.harmonics.filter(|_| same), played.chip_s, played.details),
            None => (None, None, BTreeMap::new()),
        };
        Ok(Self {
            values: values[start..end].to_vec(),
            answer: answer.map(|answer| answer[start..end].to_vec()),
            sample_time_s,
            period,
            harmonics,
            chip_s,
            details,
            uneven_period_s: None,
            is_made: false,
            sha256: hexadecimal_of(&sha256, excerpt),
        })
    }

    /// Whole periods of the signal, or all of it, and the samples of one.
    #[must_use]
    pub fn periods(&self) -> (&[f64], usize) {
        match self.period {
            Some(n) => (&self.values[..self.values.len() / n * n], n),
            None => (&self.values, self.values.len()),
        }
    }
}

/// The content's hash where all of it is used, and one of content and excerpt otherwise.
fn hexadecimal_of(content: &str, excerpt: &Excerpt) -> String {
    if *excerpt == Excerpt::default() { content.to_owned() } else { sha256_json(&json!([content, excerpt])) }
}
