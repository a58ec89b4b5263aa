//! From recorded times to a checked trial.
//!
//! A time column comes in some unit, from some start; its samples may be rounded, missing, or of a rate that changes.
//! What can be told is brought to seconds; what cannot is refused with the rows, or, on request, brought to a uniform
//! grid ([`resample`]), which then stands with the trial.

mod resample;
mod uneven;

use super::options::{Options, TimeUnit};
use super::understood::Understood;
use crate::analysis::{Code, Problem, Warning};
use crate::trial::{Channel, Signals, TimeDefect, Trial, TrialError};

/// Seconds from 1970 to 2000 and to 2100: times in between are dates.
const DATES_S: std::ops::Range<f64> = 946_684_800.0..4_102_444_800.0;

/// Steps of a recorded person, in seconds.
const STEPS_S: std::ops::RangeInclusive<f64> = 1e-5..=0.5;

/// Columns as a file has them.
pub(super) struct Recorded {
    /// The columns; times as they stand there.
    pub(super) signals: Signals,
    /// The unit of time that the file gives, as it is written there.
    pub(super) written_unit: Option<String>,
    /// The sample time that the file gives, in seconds.
    pub(super) sample_time_s: Option<f64>,
}

/// Where samples stand in a file.
pub(super) struct Place<'a> {
    /// A sample of a signal, or the signal as a whole.
    pub(super) of: &'a dyn Fn(Option<usize>, Channel) -> String,
    /// The number of a sample's row.
    pub(super) row: &'a dyn Fn(usize) -> String,
    /// What rows are called.
    pub(super) rows: &'a str,
    /// A mapping that might be meant, where no column was taken for the time.
    pub(super) suggestion: Option<String>,
}

/// The trial that the columns are, with what was done to them.
pub(super) fn settle(
    recorded: Recorded,
    options: &Options,
    place: &Place<'_>,
    understood: &mut Understood,
) -> Result<(Trial, Vec<Warning>), Problem> {
    let Recorded { mut signals, written_unit, sample_time_s } = recorded;
    let given_s = settle_sample_time(sample_time_s, options, understood)?;
    let mut counted_s = None;
    if let Some(raw) = signals.time_s.take() {
        let (times, unit) = seconds(raw, written_unit.as_deref(), given_s, options, place, understood)?;
        understood.time_unit = Some(unit.name());
        counted_s = (unit == TimeUnit::Samples).then_some(given_s).flatten();
        signals.time_s = Some(times);
    } else if let Some(unit) = options.time_unit {
        understood.words.push(format!("There is no time column; {} says nothing here.", unit.name()));
    }
    let checked_s = if options.resample.is_some() || counted_s.is_some() { None } else { given_s };
    let signals_without_time = signals.time_s.is_none();
    match Trial::or_return(if signals_without_time { given_s } else { checked_s }, signals) {
        Ok(trial) => Ok((finished(trial, given_s, counted_s, options, understood)?, Vec::new())),
        Err((TrialError::Time(defect), signals)) => {
            if options.resample.is_some() {
                return resample::uneven(&signals, given_s, options, place, understood);
            }
            match given_s.filter(|_| counted_s.is_none()).and_then(|given_s| coarse(&signals, given_s)) {
                Some(unit_s) => {
                    let given_s = given_s.unwrap_or_default();
                    understood.words.push(format!(
                        "The times are rounded to {unit_s} s; no sample is further than that from the grid of the \
                         sample time given, {given_s} s, which stands in their place."
                    ));
                    let signals = Signals { time_s: None, ..signals };
                    let trial = Trial::new(given_s, signals).map_err(|error| refuse(&error, place))?;
                    Ok((trial, Vec::new()))
                }
                None => Err(uneven::problem(&defect, signals.time_s.as_deref().unwrap_or_default(), given_s, place)),
            }
        }
        Err((error, _)) => Err(refuse(&error, place)),
    }
}

/// A trial whose times are even, as it is kept.
fn finished(
    trial: Trial,
    given_s: Option<f64>,
    counted_s: Option<f64>,
    options: &Options,
    understood: &mut Understood,
) -> Result<Trial, Problem> {
    if options.resample.is_some() {
        let own = trial.sample_time_s;
        match given_s.filter(|given| (given - own).abs() > 1e-6 * own && trial.signals.time_s.is_some()) {
            Some(given) => {
                return Err(Problem::new(
                    Code::Invalid,
                    "two sample times",
                    format!("the times are even, {own} s apart, and {given} s is given to resample to"),
                )
                .at("sample_time_s")
                .mend("Leave resample and the sample time out: an even recording is kept as it is."));
            }
            None => understood.words.push("The times are even: nothing was resampled.".to_owned()),
        }
    }
    if let Some(counted_s) = counted_s {
        // The column counts steps of one sample time, or of several.
        let sample_time_s = (trial.sample_time_s / counted_s).round().max(1.0) * counted_s;
        let signals = Signals { time_s: None, ..trial.signals };
        return Trial::new(sample_time_s, signals).map_err(|error| Problem::from(&error));
    }
    Ok(trial)
}

fn settle_sample_time(
    own: Option<f64>,
    options: &Options,
    understood: &mut Understood,
) -> Result<Option<f64>, Problem> {
    match (own, options.sample_time_s) {
        (Some(own), Some(given)) if (own - given).abs() > 1e-6 * given => Err(Problem::new(
            Code::Invalid,
            "two sample times",
            format!("the file says that samples are {own} s apart, and {given} s is given"),
        )
        .at("sample_time_s")
        .mend("Correct it, or leave it out.")),
        (Some(own), None) => {
            understood.words.push(format!("The file says that samples are {own} s apart."));
            Ok(Some(own))
        }
        (_, given) => Ok(given),
    }
}

/// Times in seconds, and the unit that they were in.
fn seconds(
    raw: Vec<f64>,
    written: Option<&str>,
    given_s: Option<f64>,
    options: &Options,
    place: &Place<'_>,
    understood: &mut Understood,
) -> Result<(Vec<f64>, TimeUnit), Problem> {
    let from_file = written.and_then(TimeUnit::as_written);
    if let (Some(text), None, None) = (written, from_file, options.time_unit) {
        return Err(Problem::new(
            Code::Invalid,
            "unknown unit of time",
            format!("the time column is in {text:?}, which is no unit that is known here"),
        )
        .at((place.of)(None, Channel::Time))
        .mend("Say what it counts: time_unit=s, ms, us, ns or samples."));
    }
    if let (Some(own), Some(given)) = (from_file, options.time_unit)
        && own != given
    {
        understood.words.push(format!(
            "The file says that time is in {}; {} was given and used.",
            own.name(),
            given.name()
        ));
    }
    let dates = epoch(&raw);
    let unit = options.time_unit.or(from_file).or(dates).unwrap_or(TimeUnit::Seconds);
    let how = if options.time_unit.is_some() {
        "as was given"
    } else if from_file.is_some() {
        "as the file says"
    } else if dates.is_some() {
        "counted from 1970, as its size shows"
    } else {
        "as nothing says otherwise"
    };
    understood.words.push(format!("Time is in {}, {how}.", unit.name()));
    let start = raw.first().copied().unwrap_or_default();
    let is_date = dates == Some(unit);
    if is_date {
        understood.words.push("Times are kept from the first sample on, in seconds.".to_owned());
    }
    let scale = match (unit.per_second(), given_s) {
        (Some(scale), _) => scale,
        (None, Some(given_s)) => {
            // Counts that are whole multiples of one sample time, whatever they start from.
            return Ok((raw.into_iter().map(|count| (count - start) * given_s).collect(), unit));
        }
        (None, None) => {
            return Err(Problem::new(
                Code::BadSignal,
                "no sample time",
                "the time column counts samples, and nothing says how long one takes",
            )
            .at((place.of)(None, Channel::Time))
            .mend("Give the time between samples in seconds: sample_time_s=0.001 for 1 kHz."));
        }
    };
    if scale == 1.0 && !is_date {
        return Ok((raw, unit));
    }
    if is_date {
        // A double holds a date of today to a quarter of a microsecond.
        return Ok((raw.into_iter().map(|value| ((value - start) / scale * 1e6).round() / 1e6).collect(), unit));
    }
    // A decimal number of milliseconds, divided, is the double nearest to the decimal number of seconds.
    Ok((raw.into_iter().map(|value| value / scale).collect(), unit))
}

/// The unit in which a column counts the time since 1970, where it does.
fn epoch(raw: &[f64]) -> Option<TimeUnit> {
    let (first, last) = (*raw.first()?, *raw.last()?);
    [TimeUnit::Seconds, TimeUnit::Milliseconds, TimeUnit::Microseconds, TimeUnit::Nanoseconds].into_iter().find(
        |unit| {
            let scale = unit.per_second().unwrap_or(1.0);
            let is_date = DATES_S.contains(&(first / scale)) && DATES_S.contains(&(last / scale));
            let step = (last - first) / scale / (raw.len().max(2) - 1) as f64;
            is_date && STEPS_S.contains(&step)
        },
    )
}

/// Whether the times are those of an even grid of `given_s`, rounded; and if so, to what.
fn coarse(signals: &Signals, given_s: f64) -> Option<f64> {
    let times = signals.time_s.as_deref()?;
    let steps = || times.windows(2).map(|pair| pair[1] - pair[0]);
    if steps().any(|step| step < 0.0) {
        return None;
    }
    let unit = steps().filter(|step| *step > 0.0).fold(f64::INFINITY, f64::min);
    let off = |i: usize| times[i] - times[0] - i as f64 * given_s;
    let (low, high) = (0..times.len()).map(off).fold((0.0_f64, 0.0_f64), |(low, high), d| (low.min(d), high.max(d)));
    // Rounding to a unit, up, down or to the nearest, moves times by less than one unit against each other. A unit of
    // many samples would hide that some are missing.
    let rounding = 1e-6 * unit + 8.0 * f64::EPSILON * times.last().copied().unwrap_or_default().abs();
    (unit.is_finite() && high - low <= unit + rounding && unit <= 20.0 * given_s).then(|| (unit * 1e9).round() / 1e9)
}

/// A refusal by the trial itself, with its place in the file.
fn refuse(error: &TrialError, place: &Place<'_>) -> Problem {
    let problem = Problem::from(error);
    match error.place() {
        (Some(channel), sample) => problem.at((place.of)(sample, channel)),
        (None, _) if matches!(error, TrialError::NoSampleTime) => {
            let suggestion = place.suggestion.as_ref().map_or_else(String::new, |text| format!(", such as {text}"));
            problem.mend(format!(
                "Give the time between samples in seconds (sample_time_s), or say which column is the time{suggestion}."
            ))
        }
        (None, _) => problem,
    }
}

/// The median of at least one value.
fn median(mut values: Vec<f64>) -> f64 {
    let middle = (values.len() - 1) / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The usual step of times, to a nanosecond: a decimal number where they were printed as decimals.
fn usual_step(times: &[f64]) -> f64 {
    let step = median(times.windows(2).map(|pair| pair[1] - pair[0]).collect());
    if step > 1e-4 { (step * 1e9).round() / 1e9 } else { step }
}

/// Whether a defect can be mended by taking values in between.
fn is_resamplable(defect: &TimeDefect) -> bool {
    matches!(defect, TimeDefect::Gap { .. } | TimeDefect::Jitter { .. } | TimeDefect::Disagrees { .. })
}
