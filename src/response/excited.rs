//! Which lines of a grid carry power.

use super::settings::FrequencySettings;

/// How many lines to each side the noise floor is taken from.
const FLOOR_REACH: usize = 32;

/// The largest power beside 0 Hz.
pub(super) fn strongest(power: &[f64]) -> f64 {
    power.iter().skip(1).copied().fold(0.0, f64::max)
}

/// The lines `k ≥ 1` below the Nyquist line `N/2` that carry power, in increasing order.
///
/// A line does if it has `power_threshold` of the strongest line's power and `floor_ratio` times the noise floor: the
/// median of the lines below that threshold among the [`FLOOR_REACH`] nearest to each side.
pub(super) fn excited_lines(power: &[f64], samples: usize, settings: &FrequencySettings) -> Vec<usize> {
    let threshold = settings.power_threshold * strongest(power);
    if threshold <= 0.0 {
        return Vec::new();
    }
    let carries = |k: usize| {
        if power[k] < threshold {
            return false;
        }
        let mut floor: Vec<f64> = (k.saturating_sub(FLOOR_REACH).max(1)..=(k + FLOOR_REACH).min(power.len() - 1))
            .map(|other| power[other])
            .filter(|other| *other < threshold)
            .collect();
        floor.sort_by(f64::total_cmp);
        floor.is_empty() || power[k] >= settings.floor_ratio * floor[floor.len() / 2]
    };
    (1..power.len()).filter(|k| 2 * k < samples && carries(*k)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_above_threshold_and_floor_are_found() {
        let settings = FrequencySettings::default();
        let mut power = vec![1e-9; 51];
        power[0] = 50.0;
        power[3] = 1.0;
        power[7] = 2e-3;
        power[9] = 0.9e-3;
        assert_eq!(excited_lines(&power, 100, &settings), [3, 7]);
        // The Nyquist line is no sinusoid of known phase.
        power[50] = 1.0;
        assert_eq!(excited_lines(&power, 100, &settings), [3, 7]);
        // A floor of 5e-4 hides the line of 2e-3.
        let noisy: Vec<f64> = power.iter().map(|p| if *p < 1e-3 { 5e-4 } else { *p }).collect();
        assert_eq!(excited_lines(&noisy, 100, &settings), [3]);
        // Where every line carries power there is no floor to stand above.
        assert_eq!(excited_lines(&[1.0; 11], 21, &settings).len(), 10);
        assert!(excited_lines(&[1.0, 0.0, 0.0], 5, &settings).is_empty());
    }
}
