//! How smooth a movement is.
//!
//! The dimensionless squared jerk of a movement x that takes the time D and covers the range A = max x − min x,
//!
//! `D⁵/A² ∫ (d³x/dt³)² dt`
//!
//! (Hogan and Sternad, J. Mot. Behav. 41, 529–534, 2009), as its negative logarithm (Balasubramanian,
//! Melendez-Calderon, Roby-Brami and Burdet, J. NeuroEng. Rehabil. 12:112, 2015): greater is smoother. The smoothest
//! reach from rest to rest has −ln 720 = −6.58, a sinusoid of angular frequency ω has −ln((ω D)⁶/8). So trials are
//! compared that take equally long and follow one command.
//!
//! Third differences of recorded samples would be noise alone. The jerk is that of a cubic fitted to each 0.2 s of the
//! record by least squares (Savitzky and Golay, Anal. Chem. 36, 1627–1639, 1964), after means over 0.01 s where samples
//! come faster: what is quicker than about 5 Hz, and no voluntary movement, counts less and less.

/// Half of the window of a cubic, s.
const HALF_WINDOW_S: f64 = 0.1;

/// Samples are averaged to about this far apart, s.
const BLOCK_S: f64 = 0.01;

/// Samples on each side of the middle of a window at least: a cubic through fewer fits their noise.
const FEWEST: usize = 3;

/// `−ln(D⁵/A² ∫ (d³x/dt³)² dt)` of samples `sample_time_s` apart.
///
/// # Errors
/// Why there is none: x does not move, or is shorter than three windows.
pub(crate) fn log_dimensionless_jerk(x: &[f64], sample_time_s: f64) -> Result<f64, String> {
    let block = (BLOCK_S / sample_time_s).round().clamp(1.0, x.len().max(1) as f64) as usize;
    let (low, high) = x.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    // The half of a difference does not overflow.
    let half_range = 0.5 * high - 0.5 * low;
    if !(half_range.is_normal() && half_range > 0.0) {
        return Err("it does not move".to_owned());
    }
    let step_s = sample_time_s * block as f64;
    // In shares of its range.
    let scaled =
        |part: &[f64]| part.iter().map(|v| (0.5 * v - 0.5 * low) / half_range).sum::<f64>() / part.len() as f64;
    let means: Vec<f64> = x.chunks_exact(block).map(scaled).collect();
    let half = ((HALF_WINDOW_S / step_s).round() as usize).max(FEWEST);
    let window = 2 * half + 1;
    if means.len() < 3 * window {
        return Err(format!("it is shorter than {} s", (3 * window) as f64 * step_s));
    }
    // The third discrete orthogonal polynomial of 2 half + 1 points.
    let m = half as f64;
    let weights: Vec<f64> =
        (0..window).map(|i| i as f64 - m).map(|i| i * (i * i - (3.0 * m * m + 3.0 * m - 1.0) / 5.0)).collect();
    let norm: f64 = weights.iter().map(|w| w * w).sum();
    let cubic = |part: &[f64]| part.iter().zip(&weights).map(|(v, w)| v * w).sum::<f64>() / norm;
    let squares: Vec<f64> = means.windows(window).map(|part| (6.0 * cubic(part)).powi(2)).collect();
    let mean_square = squares.iter().sum::<f64>() / squares.len() as f64;
    if mean_square == 0.0 {
        return Err("it has no jerk".to_owned());
    }
    let duration = x.len() as f64 * sample_time_s / step_s;
    Ok(-(6.0 * duration.ln() + mean_square.ln()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn movements_with_known_jerk_have_it() {
        // The minimum-jerk reach of 4 s: D⁵/A² ∫ jerk² = 720 (Flash and Hogan 1985).
        let reach = |t: f64| {
            let s = (t / 4.0).clamp(0.0, 1.0);
            s * s * s * (10.0 + s * (6.0 * s - 15.0))
        };
        for step in [0.001, 0.002, 0.01, 0.02] {
            let n = (4.0 / step) as usize;
            let x: Vec<f64> = (0..n).map(|k| 3.0 * reach(k as f64 * step) - 7.0).collect();
            let found = log_dimensionless_jerk(&x, step).unwrap();
            // The ends, where the jerk is largest, hold no window: some of it is not seen.
            assert!((found + 720.0_f64.ln()).abs() < 0.2, "{step}: {found}");
        }
        for omega in [1.0, 3.0] {
            let x: Vec<f64> = (0..3000).map(|k| 0.4 * (omega * 0.02 * f64::from(k)).sin()).collect();
            let expected = -((omega * 60.0_f64).powi(6) / 8.0).ln();
            let found = log_dimensionless_jerk(&x, 0.02).unwrap();
            assert!((found - expected).abs() < 0.03, "{omega}: {found} {expected}");
        }
    }

    #[test]
    fn it_does_not_depend_on_units_and_falls_with_tremor() {
        let x = |tremor: f64| -> Vec<f64> {
            (0..3000)
                .map(|k| {
                    let t = 0.02 * f64::from(k);
                    (1.3 * t).sin() + tremor * (16.0 * t).sin()
                })
                .collect()
        };
        let scaled = |values: Vec<f64>, factor: f64| values.iter().map(|v| factor * v).collect::<Vec<f64>>();
        let of = |values: &[f64]| log_dimensionless_jerk(values, 0.02).unwrap();
        let smooth = of(&x(0.0));
        for factor in [-1.0, 1e-200, 1e200, f64::MAX / 1.1] {
            assert!((of(&scaled(x(0.0), factor)) - smooth).abs() < 1e-9, "{factor}");
        }
        assert!(of(&x(0.02)) < smooth - 1.0 && of(&x(0.1)) < of(&x(0.02)) - 1.0);
    }

    #[test]
    fn what_has_none_says_why() {
        for (x, words) in
            [(vec![2.0; 3000], "does not move"), (vec![0.0, 1.0, 0.0], "shorter"), (Vec::new(), "does not move")]
        {
            assert!(log_dimensionless_jerk(&x, 0.02).unwrap_err().contains(words));
        }
    }
}
