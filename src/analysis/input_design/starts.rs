//! Inputs that a design begins with, checked.

use super::checked_spec::CheckedSpec;
use super::inputs::StartInput;
use super::refusal::wrong;
use crate::analysis::contract::Failure;
use crate::analysis::problem::Problem;
use crate::ctl::Ctl;
use crate::excite::sequence::{CheckedSequence, SequenceError};

#[derive(Debug, Clone, PartialEq)]
enum Start {
    Samples(Vec<f64>),
    Sequence(Box<CheckedSequence>),
}

/// Checked starts.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Starts(Vec<Start>);

impl Starts {
    /// Checks starts against the length and the sample time of the record.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub(super) fn new(starts: &[StartInput], spec: &CheckedSpec) -> Result<Self, Problem> {
        let samples = spec.used.samples;
        let starts = starts.iter().enumerate().map(|(i, start)| {
            let at = format!("/inputs/starts/{i}");
            let written = match start {
                StartInput::Samples(values) if values.len() == samples => return Ok(Start::Samples(values.clone())),
                StartInput::Samples(values) => {
                    let detail = format!("there are {} samples, and the record has {samples}", values.len());
                    return Err(wrong(detail, at));
                }
                StartInput::Sequence(written) => written,
            };
            if written.sample_time_s != spec.sample_time_s {
                return Err(wrong(
                    format!(
                        "the sequence is sampled every {} s, the record every {} s",
                        written.sample_time_s, spec.sample_time_s
                    ),
                    format!("{at}/sample_time_s"),
                ));
            }
            let checked = written.as_ref().clone().check().map_err(|error| sequence(&error, &at))?;
            if checked.samples() < samples && checked.spec().period_s().is_none() {
                return Err(wrong(
                    format!("the sequence has {} samples, and the record {samples}", checked.samples()),
                    at,
                )
                .mend("Make it longer."));
            }
            Ok(Start::Sequence(Box::new(checked)))
        });
        starts.collect::<Result<_, _>>().map(Self)
    }

    /// The samples of every start.
    pub(super) fn sampled(&self, samples: usize, ctl: &Ctl) -> Result<Vec<Vec<f64>>, Failure> {
        let mut all = Vec::new();
        for (i, start) in self.0.iter().enumerate() {
            all.push(match start {
                Start::Samples(values) => values.clone(),
                Start::Sequence(sequence_start) => {
                    let made = sequence_start.sample(ctl).map_err(|error| match error {
                        SequenceError::Stopped(stopped) => Failure::Stopped(stopped),
                        error => sequence(&error, &format!("/inputs/starts/{i}")).into(),
                    })?;
                    // Whole periods where there is one; of a period that is no whole number of samples, what there is.
                    let values = made.one_period().unwrap_or(&made.values);
                    values.iter().copied().cycle().take(samples).collect()
                }
            });
        }
        Ok(all)
    }
}

fn sequence(error: &SequenceError, at: &str) -> Problem {
    wrong(error.to_string(), error.field().map_or_else(|| at.to_owned(), |field| format!("{at}/{field}")))
}
