//! Discrete Fourier transforms: direct at any frequency, fast on the grid of a segment.

use super::settings::{Detrend, Window};
/// The transform on the grid `k/(N T)`, `k = 0 … ⌊N/2⌋`, by the fast algorithm.
pub(super) use crate::num::fourier::real_transform as grid_transform;
use num_complex::Complex64;
use std::f64::consts::PI;

/// `Σᵢ xᵢ e^{−j2πfiT}` for each of the columns `x`, where `cycles = fT` is the frequency in cycles per sample.
///
/// The sums are compensated (Neumaier), so their error does not grow with the number of samples. All columns share the
/// exponentials.
#[must_use]
pub fn direct_transform(columns: &[&[f64]], cycles: f64) -> Vec<Complex64> {
    let samples = columns.iter().map(|column| column.len()).max().unwrap_or(0);
    let mut sums = vec![[Compensated::default(); 2]; columns.len()];
    for i in 0..samples {
        // Whole turns are taken off before the sine, which keeps its argument small and exact.
        let turns = cycles * i as f64;
        let (sin, cos) = (2.0 * PI * (turns - turns.round())).sin_cos();
        for (sum, column) in sums.iter_mut().zip(columns) {
            if let Some(x) = column.get(i) {
                sum[0].add(x * cos);
                sum[1].add(-x * sin);
            }
        }
    }
    sums.into_iter().map(|[re, im]| Complex64::new(re.value(), im.value())).collect()
}

/// A running sum with the rounding errors of its additions (Neumaier 1974).
#[derive(Debug, Clone, Copy, Default)]
struct Compensated {
    sum: f64,
    lost: f64,
}

impl Compensated {
    fn add(&mut self, x: f64) {
        let total = self.sum + x;
        self.lost += if self.sum.abs() >= x.abs() { (self.sum - total) + x } else { (x - total) + self.sum };
        self.sum = total;
    }

    fn value(self) -> f64 {
        self.sum + self.lost
    }
}

/// A column without its trend, times the window.
pub(super) fn prepare(column: &[f64], detrend: Detrend, window: Window) -> Vec<f64> {
    let n = column.len();
    // Measured from the middle, so that the mean and the slope are found independently of each other.
    let middle = (n as f64 - 1.0) / 2.0;
    let mean = column.iter().sum::<f64>() / n as f64;
    let slope = {
        let moment: f64 = column.iter().enumerate().map(|(i, x)| (i as f64 - middle) * (x - mean)).sum();
        let spread: f64 = (0..n).map(|i| (i as f64 - middle).powi(2)).sum();
        if spread > 0.0 { moment / spread } else { 0.0 }
    };
    let value = |(i, x): (usize, &f64)| {
        let level = match detrend {
            Detrend::None => *x,
            Detrend::Mean => x - mean,
            Detrend::Line => x - mean - slope * (i as f64 - middle),
        };
        level * window.value(i, n)
    };
    column.iter().enumerate().map(value).collect()
}

/// The mean square of the sinusoid that a line stands for: `2|X|²/(Σw)²`, at 0 Hz `|X|²/(Σw)²`.
pub(super) fn line_power(transform: Complex64, window_sum: f64, at_zero: bool) -> f64 {
    (if at_zero { 1.0 } else { 2.0 }) * transform.norm_sqr() / (window_sum * window_sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::rng::stream;
    use rand::RngExt;

    #[test]
    fn the_direct_and_the_fast_transform_agree_on_the_grid() {
        // Even, odd, prime and highly composite lengths take different roads through the fast algorithm.
        for n in [4_usize, 9, 127, 1200, 3001] {
            let mut random = stream(1, "transforms");
            let x: Vec<f64> = (0..n).map(|_| random.random::<f64>() - 0.5).collect();
            let fast = grid_transform(&x);
            assert_eq!(fast.len(), n / 2 + 1);
            for (k, fast) in fast.iter().enumerate() {
                let direct = direct_transform(&[&x], k as f64 / n as f64)[0];
                assert!((direct - fast).norm() < 1e-12 * n as f64, "{n} {k}: {direct} {fast}");
            }
        }
    }

    #[test]
    fn a_sinusoid_has_the_power_of_its_line() {
        let x: Vec<f64> = (0..100).map(|i| 3.0 * (2.0 * PI * 7.0 * f64::from(i) / 100.0 + 0.4).cos() + 2.0).collect();
        for window in [Window::Rectangular, Window::Hann, Window::Hamming, Window::Blackman] {
            let prepared = prepare(&x, Detrend::None, window);
            let sum: f64 = (0..100).map(|i| window.value(i, 100)).sum();
            let line = line_power(direct_transform(&[&prepared], 0.07)[0], sum, false);
            let zero = line_power(direct_transform(&[&prepared], 0.0)[0], sum, true);
            assert!((line - 4.5).abs() < 1e-12 && (zero - 4.0).abs() < 1e-12, "{window:?} {line} {zero}");
        }
    }

    #[test]
    fn the_stated_noise_bandwidths_are_those_of_the_windows() {
        for window in [Window::Rectangular, Window::Hann, Window::Hamming, Window::Blackman] {
            let w: Vec<f64> = (0..64).map(|i| window.value(i, 64)).collect();
            let lines = 64.0 * w.iter().map(|v| v * v).sum::<f64>() / w.iter().sum::<f64>().powi(2);
            assert!((lines - window.noise_bandwidth_lines()).abs() < 1e-12, "{window:?} {lines}");
        }
    }

    #[test]
    fn trends_are_taken_off() {
        let x: Vec<f64> = (0..50).map(|i| 2.0 - 0.3 * f64::from(i)).collect();
        let line = prepare(&x, Detrend::Line, Window::Rectangular);
        assert!(line.iter().all(|v| v.abs() < 1e-13));
        let mean = prepare(&x, Detrend::Mean, Window::Rectangular);
        assert!(mean.iter().sum::<f64>().abs() < 1e-12 && (mean[0] - 7.35).abs() < 1e-13);
    }

    #[test]
    fn compensation_keeps_what_plain_sums_lose() {
        let mut sum = Compensated::default();
        for x in [1.0, 1e100, 1.0, -1e100] {
            sum.add(x);
        }
        assert_eq!(sum.value(), 2.0);
    }
}
