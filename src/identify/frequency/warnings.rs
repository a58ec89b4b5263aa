//! What a scientist must read before using frequency data.

use super::segments::Segment;

/// A finding about an estimate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EstimateWarning {
    /// A stable name, in `snake_case`.
    pub code: &'static str,
    /// The finding, in words and numbers.
    pub message: String,
}

impl EstimateWarning {
    pub(super) fn new(code: &'static str, message: impl Into<String>) -> Self {
        Self { code, message: message.into() }
    }
}

/// Difference from the neighbouring period, as a fraction of the signal's spread, from which a signal is not periodic.
const PERIOD_MISMATCH: f64 = 0.01;

/// How much more than anywhere within the segment a periodic signal may bend where its end meets its start.
const SEAM_BEND: f64 = 1.5;

/// Whether the input is periodic with the segment's period, as far as the record shows.
///
/// Where the record goes on for a quarter of a period before or after the segment, one of the two must repeat it.
/// Otherwise the end must meet the start as smoothly as the signal runs elsewhere (second differences).
pub(super) fn is_periodic(column: &[f64], segment: &Segment) -> bool {
    let Segment { start, period, .. } = *segment;
    let inside = &column[start..start + period];
    let mean = inside.iter().sum::<f64>() / period as f64;
    let spread = (inside.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / period as f64).sqrt();
    let mismatch = |pairs: &mut dyn Iterator<Item = (f64, f64)>| {
        let (mut sum, mut count) = (0.0, 0_usize);
        for (a, b) in pairs {
            sum += (a - b) * (a - b);
            count += 1;
        }
        (sum / count as f64).sqrt()
    };
    let before = start.min(period);
    let after = (column.len() - start - period).min(period);
    let mut neighbours = Vec::new();
    if before * 4 >= period {
        let pairs = (1..=before).map(|i| (column[start - i], column[start + period - i]));
        neighbours.push(mismatch(&mut { pairs }));
    }
    if after * 4 >= period {
        let pairs = (0..after).map(|i| (column[start + period + i], column[start + i]));
        neighbours.push(mismatch(&mut { pairs }));
    }
    if !neighbours.is_empty() {
        return neighbours.iter().any(|difference| *difference <= PERIOD_MISMATCH * spread);
    }
    let bend = |a: f64, b: f64, c: f64| (a - 2.0 * b + c).abs();
    let within = inside.windows(3).map(|w| bend(w[0], w[1], w[2])).fold(0.0, f64::max);
    let (first, second) = (inside[0], inside[1]);
    let (last, last_but_one) = (inside[period - 1], inside[period - 2]);
    bend(last_but_one, last, first).max(bend(last, first, second)) <= SEAM_BEND * within
}

/// At most eight frequencies, in words.
pub(super) fn hertz(frequency_hz: &[f64]) -> String {
    const NAMED: usize = 8;
    let named: Vec<String> = frequency_hz.iter().take(NAMED).map(|f| format!("{}", (f * 1e6).round() / 1e6)).collect();
    let more = frequency_hz.len().saturating_sub(NAMED);
    if more > 0 { format!("{} Hz and {more} more", named.join(", ")) } else { format!("{} Hz", named.join(", ")) }
}
