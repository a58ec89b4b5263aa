//! Sample statistics.

/// The arithmetic mean; `None` of nothing.
#[must_use]
pub fn mean(values: &[f64]) -> Option<f64> {
    if values.is_empty() { None } else { Some(values.iter().sum::<f64>() / values.len() as f64) }
}

/// The sample standard deviation, with `n − 1` in the denominator; `None` of fewer than two values.
#[must_use]
pub(crate) fn standard_deviation(values: &[f64]) -> Option<f64> {
    let centre = mean(values)?;
    if values.len() < 2 {
        return None;
    }
    let squares: f64 = values.iter().map(|v| (v - centre).powi(2)).sum();
    Some((squares / (values.len() - 1) as f64).sqrt())
}

/// The share of a signal's variation that another accounts for, `1 − Σ (x − x̂)²/Σ (x − mean x)²` over the samples that
/// both have; `None` where x does not vary, or nothing is finite.
#[must_use]
pub fn accounted_for(recorded: &[f64], simulated: &[f64]) -> Option<f64> {
    let mean = mean(recorded)?;
    let variation: f64 = recorded.iter().map(|x| (x - mean).powi(2)).sum();
    let missed: f64 = recorded.iter().zip(simulated).map(|(x, y)| (x - y).powi(2)).sum();
    let share = 1.0 - missed / variation;
    (variation > 0.0 && share.is_finite()).then_some(share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_one_minus_missed_over_variation() {
        let x = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(accounted_for(&x, &x), Some(1.0));
        assert_eq!(accounted_for(&x, &[2.0, 2.0, 3.0, 4.0]), Some(1.0 - 1.0 / 5.0));
        assert_eq!(accounted_for(&[1.0, 2.0, 3.0], &[2.0, 2.0, 2.0]), Some(0.0));
        assert_eq!(accounted_for(&[2.0; 4], &x), None);
        // Squares of a wild simulation overflow: such a share is no number to report.
        assert_eq!(accounted_for(&[1.0, 2.0], &[f64::MAX, 0.0]), None);
        assert_eq!(accounted_for(&[], &[]), None);
    }

    #[test]
    fn mean_and_standard_deviation_of_a_known_sample() {
        let sample = [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0];
        assert_eq!(mean(&sample), Some(5.0));
        assert!((standard_deviation(&sample).unwrap() - (32.0_f64 / 7.0).sqrt()).abs() < 1e-15);
        assert_eq!(standard_deviation(&[1.0]), None);
        assert_eq!(mean(&[]), None);
    }
}
