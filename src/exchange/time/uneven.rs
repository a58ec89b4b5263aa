//! What is wrong with uneven times, with the rows: a rate that changes, samples that are missing.

use super::resample::LONGEST_GAP_S;
use super::{Place, is_resamplable, usual_step};
use crate::analysis::{Code, Problem};
use crate::trial::{Channel, TimeDefect, TrialError};

/// Steps this much longer or shorter than the usual one are others.
const OTHER: f64 = 0.02;

/// A step of more than this many usual steps is a gap, unless many are.
const GAP: f64 = 1.5;

/// So many like steps in succession are another rate.
const RUN: usize = 5;

/// So many places are named.
const NAMED: usize = 5;

/// Rows of one other rate: the first and the last sample that follow at this step.
struct Run {
    first: usize,
    last: usize,
    step_s: f64,
}

/// A refusal of times that are not even.
pub(super) fn problem(defect: &TimeDefect, times: &[f64], given_s: Option<f64>, place: &Place<'_>) -> Problem {
    let plain = Problem::from(&TrialError::Time(*defect)).at((place.of)(defect.sample(), Channel::Time));
    match defect {
        TimeDefect::Gap { .. } | TimeDefect::Jitter { .. } => {}
        TimeDefect::Repeated { .. } | TimeDefect::TooCoarse { .. } => return repeated(plain, times, given_s),
        _ => return plain,
    }
    let step_s = usual_step(times);
    let (runs, gaps) = irregular(times, step_s);
    let mend = mend(defect, times);
    if !runs.is_empty() {
        let named: Vec<String> = runs
            .iter()
            .take(NAMED)
            .map(|run| {
                let rows = format!("{} {} to {}", place.rows, (place.row)(run.first), (place.row)(run.last));
                format!("{rows} follow each other by {} s ({})", rounded(run.step_s), rate(run.step_s))
            })
            .collect();
        let more = runs.len().saturating_sub(NAMED);
        let more = if more > 0 { format!(", and {more} more such stretches") } else { String::new() };
        let detail = format!(
            "the rate changes: {}{more}; the usual step is {} s ({}){}",
            named.join(", "),
            rounded(step_s),
            rate(step_s),
            gap_words(&gaps, place)
        );
        let at = (place.of)(Some(runs[0].first), Channel::Time);
        return Problem::new(Code::BadSignal, "changing sample rate", detail).at(at).mend(mend);
    }
    let detail =
        if gaps.len() > 1 { format!("{}{}", plain.detail, gap_words(&gaps, place)) } else { plain.detail.clone() };
    Problem { detail, ..plain }.mend(mend)
}

fn repeated(plain: Problem, times: &[f64], given_s: Option<f64>) -> Problem {
    let span_s = times.last().copied().unwrap_or_default() - times.first().copied().unwrap_or_default();
    let mean_s = span_s / (times.len().max(2) - 1) as f64;
    match given_s {
        None => plain.mend(format!(
            "If the samples are evenly spaced and only their times are rounded, give the sample time; over the whole \
             record they are {} s apart (sample_time_s). Otherwise cut the recording at the defect.",
            rounded(mean_s)
        )),
        Some(given_s) => {
            let detail = format!(
                "{}; nor are they the rounded times of samples {given_s} s apart: over the whole record they are {} s \
                 apart",
                plain.detail,
                rounded(mean_s)
            );
            Problem { detail, ..plain }.mend("Correct the sample time, or cut the recording at the defect.")
        }
    }
}

fn mend(defect: &TimeDefect, times: &[f64]) -> String {
    let longest = times.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    if is_resamplable(defect) && longest <= LONGEST_GAP_S {
        "Ask for resample=linear, which is then stated with the trial; or cut the recording at the defect; or, where \
         the samples are evenly spaced and only their times are wrong, leave the time column out and give the sample \
         time."
            .to_owned()
    } else {
        format!(
            "Cut the recording there: without samples for {} s nothing can be said of what lies between. Where the \
             samples are evenly spaced and only their times are wrong, leave the time column out and give the sample \
             time.",
            rounded(longest)
        )
    }
}

/// Stretches of another rate, and single samples after which others are missing, with how many.
fn irregular(times: &[f64], step_s: f64) -> (Vec<Run>, Vec<(usize, u64)>) {
    let step = |i: usize| times[i] - times[i - 1];
    let is_other = |i: usize| (step(i) - step_s).abs() > OTHER * step_s;
    let (mut runs, mut gaps) = (Vec::new(), Vec::new());
    let mut i = 1;
    while i < times.len() {
        if !is_other(i) {
            i += 1;
            continue;
        }
        let first = step(i);
        let mut end = i + 1;
        while end < times.len() && (step(end) - first).abs() <= OTHER * first {
            end += 1;
        }
        if end - i >= RUN {
            let step_s = (times[end - 1] - times[i - 1]) / (end - i) as f64;
            runs.push(Run { first: i, last: end - 1, step_s });
            i = end;
        } else {
            if first > GAP * step_s {
                gaps.push((i, ((first / step_s).round() as u64).saturating_sub(1).max(1)));
            }
            i += 1;
        }
    }
    (runs, gaps)
}

fn gap_words(gaps: &[(usize, u64)], place: &Place<'_>) -> String {
    if gaps.is_empty() {
        return String::new();
    }
    let named: Vec<String> =
        gaps.iter().take(NAMED).map(|(row, missing)| format!("{missing} before {}", (place.row)(*row))).collect();
    let more = gaps.len().saturating_sub(NAMED);
    let more = if more > 0 { format!(" and at {more} more places") } else { String::new() };
    format!("; missing samples: {} ({}){more}", named.join(", "), place.rows)
}

/// Four digits, which is what a person reads.
pub(super) fn rounded(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

fn rate(step_s: f64) -> String {
    format!("{} Hz", rounded(1.0 / step_s))
}
