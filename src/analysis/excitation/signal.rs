//! A signal at hand: what a request's signal is once it has been made or read.

use super::excerpt::{Excerpt, wrong};
use super::problems;

use crate::analysis::contract::Failure;
use crate::ctl::Ctl;
use crate::excite::recording::Declared;
use crate::excite::sequence::{ChirpPreset, Generator, Sequence, SequenceDetails, SequenceSpec};

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
    pub details: SequenceDetails,
    /// The period in continuous time, where the sample time does not divide it.
    pub uneven_period_s: Option<f64>,
    /// Whether it was made rather than recorded.
    pub is_made: bool,
    /// What a recording is said to be of.
    pub declared: Option<Declared>,
}

impl Signal {
    pub(super) fn made(made: Sequence) -> Self {
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
            declared: None,
            values: made.values,
        }
    }

    pub(super) fn recorded(
        values: &[f64],
        answer: Option<&[f64]>,
        sample_time_s: f64,
        excerpt: &Excerpt,
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
        let declared = played.as_ref().zip(excerpt.generator.as_ref()).and_then(|(p, g)| declared(p, g));
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
                        "a period of {period_s} s is {samples} samples of {sample_time_s} s, which is no whole number \
                         from 4 on"
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
            None => (None, None, SequenceDetails::default()),
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
            declared,
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

/// What is compared with a recording of this sequence.
fn declared(played: &Sequence, generator: &Generator) -> Option<Declared> {
    let highest_hz = match generator {
        Generator::Prts(_) | Generator::Prbs(_) => None,
        Generator::Multisine(_) => played.lines_hz()?.last().copied(),
        Generator::Chirp(chirp) => Some(match chirp.preset {
            Some(ChirpPreset::Zhang2015Section32 | ChirpPreset::Zhang2015Section52) => 0.7,
            None => chirp.from_hz?.max(chirp.to_hz?),
        }),
        Generator::FilteredNoise(noise) => Some(noise.edge_hz),
    };
    let piece_s = played.chip_s.or(highest_hz.map(|hz| 0.5 / hz))?;
    let values = match played.period {
        Some(_) => played.one_period()?.to_vec(),
        None => played.values.clone(),
    };
    Some(Declared { values, is_periodic: played.period.is_some(), piece: (piece_s / played.sample_time_s).max(1.0) })
}
