//! Fast Fourier transforms of real signals.

use num_complex::Complex64;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Transforms of one length, prepared once: the preparation costs as much as some transforms.
#[derive(Clone)]
pub(crate) struct RealTransform {
    forward: Arc<dyn Fft<f64>>,
}

impl std::fmt::Debug for RealTransform {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RealTransform").field("samples", &self.forward.len()).finish()
    }
}

impl RealTransform {
    /// For signals of `samples` samples, one at least.
    pub(crate) fn new(samples: usize) -> Self {
        Self { forward: FftPlanner::new().plan_fft_forward(samples.max(1)) }
    }

    /// `X_k = Σᵢ xᵢ e^{−2πj k i/N}`, `k = 0 … ⌊N/2⌋`.
    ///
    /// # Panics
    /// If the signal has another length, which is a mistake of the caller.
    pub(crate) fn of(&self, values: &[f64]) -> Vec<Complex64> {
        assert_eq!(values.len(), self.forward.len(), "samples of a transform");
        let mut buffer: Vec<Complex64> = values.iter().map(|x| Complex64::new(*x, 0.0)).collect();
        self.forward.process(&mut buffer);
        buffer.truncate(values.len() / 2 + 1);
        buffer
    }
}

/// `X_k = Σᵢ xᵢ e^{−2πj k i/N}`, `k = 0 … ⌊N/2⌋`; nothing of nothing.
#[must_use]
pub(crate) fn real_transform(values: &[f64]) -> Vec<Complex64> {
    if values.is_empty() { Vec::new() } else { RealTransform::new(values.len()).of(values) }
}

/// The real signal of `n` samples with this transform: the inverse of [`real_transform`].
///
/// # Panics
/// If there are not ⌊n/2⌋ + 1 lines, which is a mistake of the caller.
#[must_use]
pub(crate) fn inverse_real(lines: &[Complex64], n: usize) -> Vec<f64> {
    assert_eq!(lines.len(), n / 2 + 1, "lines of {n} samples");
    let mut buffer = vec![Complex64::new(0.0, 0.0); n];
    for (k, line) in lines.iter().enumerate().take(n) {
        buffer[k] = *line;
        let mirrored = (n - k) % n;
        if mirrored > k {
            buffer[mirrored] = line.conj();
        }
    }
    if n > 0 {
        FftPlanner::new().plan_fft_inverse(n).process(&mut buffer);
    }
    buffer.into_iter().map(|x| x.re / n as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_brings_the_signal_back() {
        for n in [1_usize, 2, 3, 8, 127, 242, 1200] {
            let x: Vec<f64> = (0..n).map(|i| ((i * i) as f64 * 0.37).sin() + 0.2).collect();
            let back = inverse_real(&real_transform(&x), n);
            assert!(x.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-13), "{n}");
        }
        assert!(real_transform(&[]).is_empty());
    }
}
