//! Noise of a person and of a sensor: Gaussian, white from sample to sample or coloured by one pole.

use crate::num::rng;
use rand::RngExt;
use rand_distr::StandardNormal;

/// `samples` values of `x[k+1] = a x[k] + s √(1 − a²) ε[k]`, stationary from the start, with the standard deviation s =
/// `sd`, `a = e^{−T/time_constant}` and white Gaussian ε; a = 0 (white noise) for a time constant of 0.
///
/// Values depend on the seed and the name alone, so that another use of noise moves none of them.
#[must_use]
pub fn coloured(seed: u64, name: &str, samples: usize, sd: f64, time_constant_s: f64, sample_time_s: f64) -> Vec<f64> {
    let mut stream = rng::stream(seed, name);
    let mut white = || -> f64 { stream.sample(StandardNormal) };
    let keep = if time_constant_s > 0.0 { (-sample_time_s / time_constant_s).exp() } else { 0.0 };
    let fresh = sd * (1.0 - keep * keep).sqrt();
    let mut value = sd * white();
    (0..samples)
        .map(|_| {
            let now = value;
            value = keep * value + fresh * white();
            now
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn its_deviation_and_correlation_are_those_declared() {
        for time_constant_s in [0.0, 0.1, 0.5] {
            let x = coloured(5, "test", 200_000, 2.0, time_constant_s, 0.02);
            let n = x.len() as f64;
            let covariance = |lag: usize| x.iter().zip(&x[lag..]).map(|(a, b)| a * b).sum::<f64>() / n;
            let keep: f64 = if time_constant_s > 0.0 { (-0.02 / time_constant_s).exp() } else { 0.0 };
            // Standard error of a covariance: at most √((1 + a²)/(1 − a²)/n) times √2 sd².
            let error = 4.0 * (2.0 * (1.0 + keep * keep) / (1.0 - keep * keep) / n).sqrt() * 4.0;
            for lag in [0, 1, 7] {
                let expected = 4.0 * keep.powi(lag as i32) * f64::from(u8::from(lag == 0 || keep > 0.0));
                assert!((covariance(lag) - expected).abs() < error, "{time_constant_s} {lag}: {}", covariance(lag));
            }
        }
    }

    #[test]
    fn equal_seeds_and_names_give_equal_noise() {
        let draw = |seed, name| coloured(seed, name, 4, 1.0, 0.2, 0.02);
        assert_eq!(draw(1, "a"), draw(1, "a"));
        assert_ne!(draw(1, "a"), draw(2, "a"));
        assert_ne!(draw(1, "a"), draw(1, "b"));
    }
}
