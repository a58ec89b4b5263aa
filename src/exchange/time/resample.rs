//! Values on a uniform grid, on straight lines between those that were recorded.
//!
//! The grid begins with the first sample; its step is the sample time given, or the usual step. A line between two
//! samples `h` apart takes on average the share `(π f h)²/3` from a motion at the frequency `f`: 1 % at 5 Hz and 90 Hz.
//! Neither are gaps filled in which a person does something, nor is anything thrown away: a coarser grid would fold
//! what is fast onto what is slow.

use super::uneven::rounded;
use super::{Place, usual_step};
use crate::analysis::{Code, Problem, Warning};
use crate::exchange::options::Options;
use crate::exchange::understood::Understood;
use crate::trial::{Channel, ReadError, Signals, Trial, TrialError};

/// The longest time without a sample that is filled. Half a period of 5 Hz, beyond which people hardly act.
pub(super) const LONGEST_GAP_S: f64 = 0.1;

/// The coarsest grid, in usual steps.
const COARSEST: f64 = 1.25;

/// Brings uneven samples to a grid.
pub(super) fn uneven(
    signals: &Signals,
    given_s: Option<f64>,
    options: &Options,
    place: &Place<'_>,
    understood: &mut Understood,
) -> Result<(Trial, Vec<Warning>), Problem> {
    let times = signals.time_s.as_deref().unwrap_or_default();
    let at = |sample: usize| (place.of)(Some(sample), Channel::Time);
    if let Some(i) = (1..times.len()).find(|i| times[*i] <= times[i - 1]) {
        let what = if times[i] < times[i - 1] { "runs backwards" } else { "is there twice" };
        return Err(Problem::new(
            Code::BadSignal,
            "times in no order",
            format!("the time {} s {what}: between such samples there is no line", times[i]),
        )
        .at(at(i))
        .mend(
            "Leave resample out and give the sample time, if only the times are rounded; or cut the recording there.",
        ));
    }
    let gap = |i: &usize| times[*i] - times[i - 1];
    if let Some(i) = (1..times.len()).find(|i| gap(i) > LONGEST_GAP_S) {
        return Err(Problem::new(
            Code::BadSignal,
            "a gap too long to fill",
            format!("there is no sample for {} s, and no more than {LONGEST_GAP_S} s are filled", rounded(gap(&i))),
        )
        .at(at(i))
        .mend("Cut the recording there, and send its parts as trials of their own."));
    }
    let usual_s = usual_step(times);
    let step_s = given_s.unwrap_or(usual_s);
    if step_s > COARSEST * usual_s {
        return Err(Problem::new(
            Code::Invalid,
            "too coarse a grid",
            format!(
                "samples are mostly {} s apart, and every {step_s} s one is asked for: what is faster would be folded \
                 onto what is slower",
                rounded(usual_s)
            ),
        )
        .at("sample_time_s")
        .mend("Give a sample time that is no longer, or filter and resample the recording yourself."));
    }
    let start = times[0];
    let span = times[times.len() - 1] - start;
    let count = (span / step_s + 1e-9).floor() + 1.0;
    if !count.is_finite() || count > options.limits.max_rows as f64 {
        return Err(Problem::from(ReadError::TooManyRows { limit: options.limits.max_rows }));
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the limit of rows")]
    let count = count as usize;
    let on_grid = |values: &[f64]| -> Vec<f64> {
        let mut before = 0;
        (0..count)
            .map(|k| {
                let t = start + k as f64 * step_s;
                while before + 2 < times.len() && times[before + 1] <= t {
                    before += 1;
                }
                let (t0, t1) = (times[before], times[before + 1]);
                let share = ((t - t0) / (t1 - t0)).clamp(0.0, 1.0);
                // Exactly the sample where the grid meets it.
                values[before] * (1.0 - share) + values[before + 1] * share
            })
            .collect()
    };
    let resampled = Signals {
        time_s: None,
        command: on_grid(&signals.command),
        control: on_grid(&signals.control),
        output: on_grid(&signals.output),
        disturbance: signals.disturbance.as_deref().map(on_grid),
    };
    let longest = (1..times.len()).map(|i| gap(&i)).fold(0.0, f64::max);
    let message = format!(
        "the recording was resampled on straight lines between its samples: {} samples, mostly {} s and at most {} s \
         apart, became {count} samples {step_s} s apart",
        times.len(),
        rounded(usual_s),
        rounded(longest)
    );
    let trial = Trial::new(step_s, resampled).map_err(|error: TrialError| Problem::from(&error))?;
    understood.resampled = true;
    understood.words.push(format!("{}{}.", message[..1].to_uppercase(), &message[1..]));
    Ok((trial, vec![Warning::new("resampled", message)]))
}
