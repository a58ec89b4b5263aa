//! A sequence as samples.

use schemars::JsonSchema;
use serde::Serialize;

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
    /// The multiples of 1/period below the Nyquist frequency that carry power, increasing and without 0 Hz; `None`
    /// where structure does not tell (every line may). Known by construction, never by the size of a computed number.
    pub harmonics: Option<Vec<usize>>,
    /// Length of the pieces in which the signal is constant or straight, s: of pseudorandom sequences.
    pub chip_s: Option<f64>,
    /// What was chosen or drawn on the way, for reports.
    pub details: SequenceDetails,
}

/// What was chosen or drawn in making a sequence; what its generator does not have is left out.
#[derive(Debug, Clone, Default, PartialEq, Serialize, JsonSchema)]
pub struct SequenceDetails {
    /// The coefficients c₀ … c_{n−1} of the recurrence `s[t+n] = Σ cᵢ s[t+i]` over GF(3) or GF(2), of a pseudorandom
    /// sequence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub polynomial: Option<Vec<u8>>,
    /// Chips that were skipped, of a pseudorandom sequence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phase_chips: Option<u64>,
    /// Chips of a period, of a pseudorandom sequence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chips: Option<usize>,
    /// The phase of every line in rad, of a multisine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phases_rad: Option<Vec<f64>>,
    /// Peak over root mean square of the sum of sinusoids in continuous time, between the samples too, dimensionless;
    /// of a multisine that is neither cut, tapered nor shifted. That of the samples is `crest_factor` of the signal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub continuous_crest_factor: Option<f64>,
    /// The order of the low-pass, of filtered noise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub filter_order: Option<usize>,
    /// Where the low-pass is 3 dB down in Hz, of filtered noise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cutoff_hz: Option<f64>,
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
