//! What must be said of a recording that is not, or not quite, what it is declared to be.

use crate::analysis::excitation::signal::Signal;
use crate::analysis::report::Warning;
use crate::excite::recording::Comparison;

/// The warnings of a comparison.
pub(super) fn warnings(compared: &Comparison, signal: &Signal) -> Vec<Warning> {
    let mut warnings = Vec::new();
    if !compared.is_declared {
        let message = format!(
            "the recording is not the declared sequence, or hardly follows it: the best correlation at any delay is \
             {:.3}, and a short response to the sequence explains {:.1} % of the recording where chance would explain \
             {:.1} %; what is said of its lines is said of the wrong ones",
            compared.correlation,
            100.0 * compared.explained,
            100.0 * compared.by_chance
        );
        warnings.push(Warning::new("not_the_declared_sequence", message));
        return warnings;
    }
    if compared.clock_is_off(signal.values.len())
        && let Some([rate, error]) = compared.clock
    {
        let drift_s = rate * signal.values.len() as f64 * signal.sample_time_s;
        let message = format!(
            "the recording gains {:.1} ppm of delay on the declared sequence (standard error {:.1}), {drift_s:.4} s \
             from its start to its end: player and recorder have different clocks, or the sample time is not the one \
             given; lines leak where the drift is no small part of a sample",
            1e6 * rate,
            1e6 * error
        );
        warnings.push(Warning::new("clock_differs", message));
    }
    if !compared.jumps.is_empty() {
        let places: Vec<String> = compared
            .jumps
            .iter()
            .take(5)
            .map(|jump| format!("{} near {:.2} s", jump.missing, jump.near as f64 * signal.sample_time_s))
            .collect();
        let total: i64 = compared.jumps.iter().map(|jump| jump.missing).sum();
        let message = format!(
            "the recording jumps against the declared sequence: {total} samples are missing in all ({}; negative where \
             there are too many)",
            places.join(", ")
        );
        warnings.push(Warning::new("samples_missing", message));
    }
    warnings
}
