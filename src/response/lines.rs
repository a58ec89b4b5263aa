//! Which lines can be asked for: below the Nyquist frequency, and as far apart as the window tells them.

use super::error::FrequencyError;
use super::job::GRID_TOLERANCE;
use super::segments::Segment;
use super::settings::{CheckedSettings, Lines, Window};
use crate::trial::Trial;

/// Lines in increasing order that every segment tells apart.
///
/// A window of half width w spreads a sinusoid over w lines of the grid to each side, so that two lines must be w + 1
/// of its steps apart.
pub(super) fn check(
    frequency_hz: &[f64],
    trials: &[&Trial],
    segments: &[(usize, Segment)],
    settings: &CheckedSettings,
) -> Result<(), FrequencyError> {
    for trial in trials {
        let nyquist_hz = 0.5 / trial.sample_time_s;
        // A line printed as half a rounded sampling rate is the Nyquist line.
        if let Some(line) = frequency_hz.iter().position(|line| *line >= nyquist_hz * (1.0 - 1e-9)) {
            let (frequency_hz, sample_time_s) = (frequency_hz[line], trial.sample_time_s);
            return Err(FrequencyError::LineAboveNyquist { line, frequency_hz, nyquist_hz, sample_time_s });
        }
    }
    let lengths = segments.iter().map(|(trial, segment)| segment.period as f64 * trials[*trial].sample_time_s);
    let length_s = lengths.fold(f64::INFINITY, f64::min);
    let window = settings.settings().window;
    let least_hz = (window.half_width() + 1) as f64 / length_s;
    // Zhang's end sample makes the grid finer by one sample; lines off by rounding are on the grid.
    let close = frequency_hz.windows(2).position(|pair| pair[1] - pair[0] < (1.0 - GRID_TOLERANCE) * least_hz);
    match close {
        None => Ok(()),
        Some(i) => Err(FrequencyError::LinesTooClose {
            line: i + 1,
            named: matches!(settings.settings().lines, Lines::FrequencyHz(_)),
            below_hz: frequency_hz[i],
            frequency_hz: frequency_hz[i + 1],
            least_hz,
            length_s,
            windowed: window != Window::Rectangular,
        }),
    }
}
