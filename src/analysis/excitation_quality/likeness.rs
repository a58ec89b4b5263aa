//! How a signal resembles itself, and how well its past predicts it.

use super::result::{AutocorrelationResult, CorrelationKind, PredictabilityResult};
use crate::analysis::contract::Failure;
use crate::analysis::excitation::signal::Signal;
use crate::analysis::problem::{Code, Problem};
use crate::ctl::{Ctl, Stopped};
use crate::excite::sequence::correlation;

/// Lags of the autocorrelation that are given.
const LAGS: usize = 200;
/// A signal has left its own likeness behind when its autocorrelation has fallen to this.
const FORGOTTEN: f64 = 0.1;

/// How well the past predicts the signal, for each horizon that its period is long enough for.
pub(super) fn predictability(
    signal: &Signal,
    horizons_s: &[f64],
    ctl: &Ctl,
) -> Result<Vec<PredictabilityResult>, Failure> {
    let (record, samples) = signal.periods();
    let mean = record.iter().sum::<f64>() / record.len() as f64;
    let level: Vec<f64> = record.iter().map(|x| x - mean).collect();
    let mut results = Vec::new();
    let mut around = Vec::new();
    for horizon_s in horizons_s {
        let horizon = ((horizon_s / signal.sample_time_s).round() as usize).max(1);
        let spacing = horizon.div_ceil(4);
        let lags = correlation::lags_needed(horizon, spacing);
        if lags > samples {
            continue;
        }
        if around.is_empty() {
            around = match signal.period {
                Some(n) => correlation::periodic_autocorrelation(&level[..n], n, ctl)?,
                None => correlation::autocorrelation(&level, level.len(), ctl)?,
            };
        }
        let share = correlation::predictability(&around, horizon, spacing).map_err(|error| {
            Problem::new(Code::Numerical, "no prediction", error.to_string()).at("/spec/horizons_s")
        })?;
        results.push(PredictabilityResult {
            horizon_s: horizon as f64 * signal.sample_time_s,
            spacing_s: spacing as f64 * signal.sample_time_s,
            r_squared: share,
        });
    }
    Ok(results)
}

/// How the signal resembles itself later.
pub(super) fn autocorrelation(signal: &Signal, ctl: &Ctl) -> Result<AutocorrelationResult, Stopped> {
    let (record, samples) = signal.periods();
    let (values, kind) = match signal.period {
        Some(n) => (correlation::periodic_autocorrelation(&record[..n], n / 2 + 1, ctl)?, CorrelationKind::Periodic),
        None => (correlation::autocorrelation(record, samples / 2 + 1, ctl)?, CorrelationKind::Record),
    };
    let scale = if values[0] > 0.0 { values[0] } else { 1.0 };
    let values: Vec<f64> = values.iter().map(|r| r / scale).collect();
    // Its likeness to itself a moment ago is no repetition.
    let own = values.iter().position(|r| *r < FORGOTTEN).unwrap_or(values.len());
    let sidelobe = (own..values.len()).max_by(|a, b| values[*a].abs().total_cmp(&values[*b].abs()));
    let chip = signal.chip_s.map_or(1, |chip_s| ((chip_s / signal.sample_time_s).round() as usize).max(1));
    let step = chip.max(1);
    let shown: Vec<usize> = (0..values.len()).step_by(step).take(LAGS).collect();
    Ok(AutocorrelationResult {
        kind,
        lag_s: shown.iter().map(|j| *j as f64 * signal.sample_time_s).collect(),
        value: shown.iter().map(|j| values[*j]).collect(),
        largest_sidelobe: sidelobe.map(|j| values[j]),
        sidelobe_lag_s: sidelobe.map(|j| j as f64 * signal.sample_time_s),
    })
}
