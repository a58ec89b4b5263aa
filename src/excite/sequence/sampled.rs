//! A sequence as samples.

use std::collections::BTreeMap;

/// After how long a sequence repeats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    /// In seconds: that of the sequence in continuous time.
    pub seconds: f64,
    /// In samples, where it is a whole number of them.
    pub samples: Option<usize>,
}

/// Samples with what is known of their spectrum.
#[derive(Debug, Clone, PartialEq)]
pub struct Sequence {
    /// Time between samples, s.
    pub sample_time_s: f64,
    /// The samples, from time 0.
    pub values: Vec<f64>,
    /// The period, where there is one.
    pub period: Option<Period>,
    /// The multiples of 1/period below the Nyquist frequency that carry power, increasing and without 0 Hz; `None` where structure
    /// does not tell (every line may). Known by construction, never by the size of a computed number.
    pub harmonics: Option<Vec<usize>>,
    /// Length of the pieces in which the signal is constant or straight, s: of pseudorandom sequences.
    pub chip_s: Option<f64>,
    /// What was chosen or drawn on the way (polynomial, phase, filter order), for reports.
    pub details: BTreeMap<&'static str, serde_json::Value>,
}

impl Sequence {
    /// The frequencies of [`Sequence::harmonics`] in Hz.
    #[must_use]
    pub fn lines_hz(&self) -> Option<Vec<f64>> {
        let period = self.period?;
        Some(self.harmonics.as_ref()?.iter().map(|n| *n as f64 / period.seconds).collect())
    }

    /// One period of the samples, where it is a whole number of samples and the record holds it.
    #[must_use]
    pub fn one_period(&self) -> Option<&[f64]> {
        self.values.get(..self.period?.samples?)
    }
}

/// A ratio that is a whole number up to the rounding of decimal inputs.
pub(super) fn whole(ratio: f64) -> Option<usize> {
    let rounded = ratio.round();
    ((1.0..1e15).contains(&rounded) && (ratio - rounded).abs() <= 1e-9 * rounded).then_some(rounded as usize)
}
