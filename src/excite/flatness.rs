//! Spectral flatness (Qiu 2021, equations 1–16).
//!
//! ```text
//! γ²       = exp(mean ln S_n) / mean S_n                     (2), over the lines n that carry power
//! γ²(f_ub) = the same over the lines of a band               (15)
//! SFG      = γ_y²/γ_x² = η_G² R_xx(0)/R_yy(0)                  (7), (16)
//! η_G²     = b_m² Π max(1, |z_i|²) over the whole circle       (13), with the zeros outside of it that (13) leaves out
//! V_n      = ln(S_n/σ²),   μ = −mean V_n = −ln γ²              (21), (24), (25)
//! ```
//! Which lines carry power is known from how a signal was made, never from the size of a computed number; lines without
//! any (0 Hz and the even ones of a ternary sequence, say) do not count. A band reaches up to and including the first
//! line at or above its upper end, which is what reproduces the printed γ_r²(5 Hz) = 0.3896 and γ_r²(10 Hz) = 0.1921.

use super::spectrum::Spectrum;
use crate::control::{Discrete, TransferFunction};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Frequencies that differ by less than this share are one.
const SAME: f64 = 1e-9;

/// A frequency band: its upper end (from 0 Hz), or both ends, in Hz.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "FrequencyBand")]
pub enum Band {
    /// From 0 Hz to this, in Hz.
    #[schemars(title = "BandUpTo")]
    UpTo(f64),
    /// From the one to the other, in Hz.
    #[schemars(title = "BandBetween")]
    Between([f64; 2]),
}

/// Why a band cannot be judged.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum BandError {
    /// An end that is no frequency, or both the wrong way round.
    #[error("the band from {from_hz} to {to_hz} Hz is empty")]
    Empty {
        /// Lower end.
        from_hz: f64,
        /// Upper end.
        to_hz: f64,
    },
    /// Above what the sample time can represent.
    #[error("the band ends at {to_hz} Hz, above the Nyquist frequency of {nyquist_hz} Hz")]
    AboveNyquist {
        /// Upper end.
        to_hz: f64,
        /// Half the sampling frequency.
        nyquist_hz: f64,
    },
    /// Fewer than two lines: one is always flat.
    #[error("the band from {from_hz} to {to_hz} Hz holds {lines} of the signal's lines, and flatness takes two")]
    TooFewLines {
        /// Lower end.
        from_hz: f64,
        /// Upper end.
        to_hz: f64,
        /// Lines in it.
        lines: usize,
    },
}

impl Band {
    /// Lower and upper end, Hz.
    #[must_use]
    pub fn ends(self) -> [f64; 2] {
        match self {
            Self::UpTo(to) => [0.0, to],
            Self::Between(ends) => ends,
        }
    }

    /// Checks the ends by themselves, and against the sample time where it is known.
    ///
    /// # Errors
    /// [`BandError::Empty`] or [`BandError::AboveNyquist`].
    pub fn check(self, sample_time_s: Option<f64>) -> Result<(), BandError> {
        let [from_hz, to_hz] = self.ends();
        if !(from_hz >= 0.0 && to_hz > from_hz && to_hz.is_finite()) {
            return Err(BandError::Empty { from_hz, to_hz });
        }
        let nyquist_hz = sample_time_s.map_or(f64::INFINITY, |t| 0.5 / t);
        if to_hz > nyquist_hz * (1.0 + SAME) {
            return Err(BandError::AboveNyquist { to_hz, nyquist_hz });
        }
        Ok(())
    }

    /// The part of `lines` (multiples of `spacing_hz`, increasing) that lies in the band: from its lower end, included,
    /// up to and including the first line at or above its upper end.
    ///
    /// # Errors
    /// [`BandError::TooFewLines`].
    pub fn of(self, lines: &[usize], spacing_hz: f64) -> Result<&[usize], BandError> {
        let [from_hz, to_hz] = self.ends();
        let first = lines.partition_point(|n| (*n as f64) * spacing_hz < from_hz * (1.0 - SAME));
        let below = lines.partition_point(|n| (*n as f64) * spacing_hz < to_hz * (1.0 - SAME));
        let end = (below + 1).min(lines.len());
        let inside = &lines[first.min(end)..end];
        if inside.len() < 2 {
            return Err(BandError::TooFewLines { from_hz, to_hz, lines: inside.len() });
        }
        Ok(inside)
    }
}

/// The spectral flatness of some powers: geometric over arithmetic mean, from 0 to 1. 0 where one of them is zero, or
/// there are none.
#[must_use]
pub fn flatness(powers: impl Iterator<Item = f64> + Clone) -> f64 {
    let (mut count, mut logs, mut sum) = (0.0, 0.0, 0.0);
    let largest = powers.clone().fold(0.0, f64::max);
    if !(largest > 0.0 && largest.is_finite()) {
        return 0.0;
    }
    for power in powers {
        let relative = power / largest;
        count += 1.0;
        logs += relative.ln();
        sum += relative;
    }
    (logs / count).exp() * count / sum
}

/// `b_m² Π max(1, |z_i|²)`: the geometric mean of `|G(e^{jθ})|²` over the whole circle for a stable G with the monic
/// denominator that (11) has, and its factors b_m² and Π max(1, |z_i|²). Equation (13) has the first alone, which is
/// all of it where every zero lies inside the circle (Jensen's formula). `None` where the zeros cannot be found.
#[must_use]
pub fn circle_mean(system: &TransferFunction<Discrete>) -> Option<[f64; 2]> {
    let zeros = system.zeros().ok()?;
    let outside: f64 = zeros.iter().map(|z| z.norm_sqr().max(1.0)).product();
    Some([(system.num().leading() / system.den().leading()).powi(2), outside])
}

/// The flatness of a signal in a band, and how much of the signal is there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BandFlatness {
    /// γ²(band) = η²/σ².
    pub sfm: f64,
    /// η²: the geometric mean of the lines' mean squares.
    pub geometric_mean: f64,
    /// σ²: their arithmetic mean; times their number it is R(0), the power of the band.
    pub arithmetic_mean: f64,
    /// Power of the same lines over power of the whole signal without 0 Hz.
    pub energy_fraction: f64,
    /// Lines in the band.
    pub lines: usize,
    /// The highest of them, Hz.
    pub highest_hz: f64,
}

/// The flatness of a spectrum's lines in a band; `None` for all of its lines.
///
/// # Errors
/// [`BandError`].
pub fn band_flatness(spectrum: &Spectrum, lines: &[usize], band: Option<Band>) -> Result<BandFlatness, BandError> {
    let inside = match band {
        Some(band) => {
            band.check(Some(spectrum.sample_time_s))?;
            band.of(lines, spectrum.spacing_hz())?
        }
        None if lines.len() < 2 => {
            let to_hz = 0.5 / spectrum.sample_time_s;
            return Err(BandError::TooFewLines { from_hz: 0.0, to_hz, lines: lines.len() });
        }
        None => lines,
    };
    let power = |n: &usize| spectrum.power[*n];
    let whole: f64 = (1..spectrum.power.len()).map(|n| spectrum.share(n)).sum();
    let part: f64 = inside.iter().map(|n| spectrum.share(*n)).sum();
    let sfm = flatness(inside.iter().map(power));
    let arithmetic_mean = part / inside.len() as f64;
    Ok(BandFlatness {
        sfm,
        geometric_mean: sfm * arithmetic_mean,
        arithmetic_mean,
        energy_fraction: if whole > 0.0 { part / whole } else { 0.0 },
        lines: inside.len(),
        highest_hz: inside.last().map_or(0.0, |n| *n as f64 * spectrum.spacing_hz()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_band_ends_with_the_first_line_at_or_above_its_end() {
        let lines = [1, 3, 5, 7];
        for (band, expected) in [
            (Band::UpTo(0.4), &lines[..3]),
            (Band::UpTo(0.5), &lines[..3]),
            (Band::UpTo(0.500_000_000_1), &lines[..3]),
            (Band::UpTo(0.51), &lines[..4]),
            (Band::UpTo(90.0), &lines[..]),
            (Band::Between([0.3, 0.5]), &lines[1..3]),
        ] {
            assert_eq!(band.of(&lines, 0.1).unwrap(), expected, "{band:?}");
        }
        assert!(matches!(Band::UpTo(0.1).of(&lines, 0.1), Err(BandError::TooFewLines { lines: 1, .. })));
        assert!(matches!(Band::Between([0.8, 2.0]).of(&lines, 0.1), Err(BandError::TooFewLines { lines: 0, .. })));
        assert!(matches!(Band::UpTo(6.0).check(Some(0.1)), Err(BandError::AboveNyquist { .. })));
        for bad in [Band::UpTo(0.0), Band::UpTo(f64::NAN), Band::Between([2.0, 1.0]), Band::Between([-1.0, 1.0])] {
            assert!(matches!(bad.check(None), Err(BandError::Empty { .. })));
        }
    }

    #[test]
    fn flatness_is_one_of_equals_and_less_of_others() {
        assert_eq!(flatness([3.0; 5].into_iter()), 1.0);
        assert!((flatness([1.0, 4.0].into_iter()) - 0.8).abs() < 1e-15);
        assert_eq!((flatness([1.0, 0.0].into_iter()), flatness(std::iter::empty())), (0.0, 0.0));
        let huge = flatness([1e300, 4e300].into_iter());
        assert!((huge - 0.8).abs() < 1e-15);
    }
}
