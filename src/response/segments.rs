//! Where the segments of a trial lie, in samples.

use super::error::FrequencyError;
use super::settings::{Bounds, CheckedSettings, CountSegments, EndSample, LengthSegments, Segments};
use crate::trial::Trial;

/// Samples of a segment at least: fewer have no line below the Nyquist frequency beside 0 Hz.
pub(super) const MIN_SAMPLES: usize = 4;

/// A segment in samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Segment {
    /// Position in the list of segments.
    pub number: usize,
    /// Its first sample.
    pub start: usize,
    /// Samples that are summed.
    pub samples: usize,
    /// Samples of one period: the grid's lines are `k/(period T)`.
    pub period: usize,
    /// Whether the end sample was asked for, and is not there.
    pub end_sample_missing: bool,
}

/// The segments of one trial, with how many samples at the end are in none of them because no whole segment fits.
pub(super) fn place(
    trial_index: usize,
    trial: &Trial,
    settings: &CheckedSettings,
) -> Result<(Vec<Segment>, usize), FrequencyError> {
    let (n, dt) = (trial.samples(), trial.sample_time_s);
    let included = settings.end_sample == EndSample::Included;
    let record_s = n as f64 * dt;
    let outside = |number: usize, start_s: f64, end_s: f64| FrequencyError::SegmentOutside {
        trial: trial_index,
        segment: number,
        start_s,
        end_s,
        record_s,
    };
    let segment = |number: usize, start: usize, period: usize| {
        let missing = included && start + period == n;
        Segment {
            number,
            start,
            samples: period + usize::from(included && !missing),
            period,
            end_sample_missing: missing,
        }
    };
    let segments: Vec<Segment> = match &settings.segments {
        Segments::Bounds(bounds) => {
            let placed = bounds.iter().enumerate().map(|(number, Bounds { start_s, end_s })| {
                let start = whole(*start_s / dt);
                let period = whole((end_s - start_s) / dt);
                match (start, period) {
                    (Some(start), Some(period)) if start + period <= n => Ok(segment(number, start, period)),
                    _ => Err(outside(number, *start_s, *end_s)),
                }
            });
            placed.collect::<Result<_, _>>()?
        }
        Segments::Count(CountSegments { count }) => {
            let period = (n - usize::from(included)) / count;
            (0..*count).map(|number| segment(number, number * period, period)).collect()
        }
        Segments::Length(LengthSegments { length_s, start_s }) => {
            let (start, period) = match (whole(start_s / dt), whole(length_s / dt)) {
                (Some(start), Some(period)) if start + period <= n => (start, period),
                _ => return Err(outside(0, *start_s, start_s + length_s)),
            };
            if period < MIN_SAMPLES {
                return Err(FrequencyError::SegmentTooShort { trial: trial_index, segment: 0, samples: period });
            }
            (0..(n - start) / period).map(|number| segment(number, start + number * period, period)).collect()
        }
    };
    if let Some(short) = segments.iter().find(|segment| segment.period < MIN_SAMPLES) {
        let (segment, samples) = (short.number, short.period);
        return Err(FrequencyError::SegmentTooShort { trial: trial_index, segment, samples });
    }
    let unused = match (&settings.segments, segments.last()) {
        (Segments::Length(_), Some(last)) => n - (last.start + last.samples),
        _ => 0,
    };
    Ok((segments, unused))
}

/// The nearest whole number of samples, where it is one that a record can have.
fn whole(samples: f64) -> Option<usize> {
    let rounded = samples.round();
    (0.0..1e15).contains(&rounded).then_some(rounded as usize)
}
