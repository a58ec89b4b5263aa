//! Fast Fourier transforms of real signals.

use crate::ctl::{Ctl, Stopped};
use num_complex::Complex64;
use rustfft::{Fft, FftDirection, FftPlanner};
use std::f64::consts::PI;
use std::sync::Arc;

/// The longest transform that is done at once, some milliseconds; longer ones go in parts.
const AT_ONCE: usize = 1 << 16;

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

/// [`real_transform`], which stops within some milliseconds of being told.
///
/// # Errors
/// [`Stopped`].
pub(crate) fn real_transform_in_parts(values: &[f64], ctl: &Ctl) -> Result<Vec<Complex64>, Stopped> {
    if values.len() <= AT_ONCE {
        ctl.check()?;
        return Ok(real_transform(values));
    }
    let buffer = values.iter().map(|x| Complex64::new(*x, 0.0)).collect();
    let mut found = in_parts(buffer, FftDirection::Forward, ctl)?;
    found.truncate(values.len() / 2 + 1);
    Ok(found)
}

/// [`inverse_real`], which stops within some milliseconds of being told.
///
/// # Errors
/// [`Stopped`].
///
/// # Panics
/// If there are not ⌊n/2⌋ + 1 lines, which is a mistake of the caller.
pub(crate) fn inverse_real_in_parts(lines: &[Complex64], n: usize, ctl: &Ctl) -> Result<Vec<f64>, Stopped> {
    if n <= AT_ONCE {
        ctl.check()?;
        return Ok(inverse_real(lines, n));
    }
    assert_eq!(lines.len(), n / 2 + 1, "lines of {n} samples");
    let whole = (0..n).map(|k| if k < lines.len() { lines[k] } else { lines[n - k].conj() }).collect();
    Ok(in_parts(whole, FftDirection::Inverse, ctl)?.into_iter().map(|x| x.re / n as f64).collect())
}

/// `e^{∓2πj part/n}`, the part reduced exactly.
fn turn(part: u128, n: u128, direction: FftDirection) -> Complex64 {
    let angle = 2.0 * PI * (part % n) as f64 / n as f64;
    Complex64::from_polar(1.0, if direction == FftDirection::Forward { -angle } else { angle })
}

/// A transform of any length from short ones: with N = N₁ N₂, j = N₂ j₁ + j₂ and k = k₁ + N₁ k₂ it is transforms of
/// length N₁ over j₁, twiddle factors, and transforms of length N₂ over j₂ (Bailey 1990); a length without such
/// factors is a convolution of a power of two (Bluestein 1970).
fn in_parts(values: Vec<Complex64>, direction: FftDirection, ctl: &Ctl) -> Result<Vec<Complex64>, Stopped> {
    let n = values.len();
    let mut planner = FftPlanner::new();
    if n <= AT_ONCE {
        ctl.check()?;
        let mut values = values;
        planner.plan_fft(n, direction).process(&mut values);
        return Ok(values);
    }
    let root = (n as f64).sqrt() as usize;
    let Some(first) = (n.div_ceil(AT_ONCE)..=root).rev().find(|d| n.is_multiple_of(*d)) else {
        return by_convolution(&values, direction, ctl);
    };
    let second = n / first;
    let (outer, inner) = (planner.plan_fft(first, direction), planner.plan_fft(second, direction));
    let mut turned = vec![Complex64::new(0.0, 0.0); n];
    let mut column = vec![Complex64::new(0.0, 0.0); first];
    for j in 0..second {
        ctl.check()?;
        for (i, into) in column.iter_mut().enumerate() {
            *into = values[second * i + j];
        }
        outer.process(&mut column);
        for (k, x) in column.iter().enumerate() {
            turned[k * second + j] = x * turn(j as u128 * k as u128, n as u128, direction);
        }
    }
    let mut found = values;
    for (k, row) in turned.chunks_exact_mut(second).enumerate() {
        ctl.check()?;
        inner.process(row);
        for (i, x) in row.iter().enumerate() {
            found[k + first * i] = *x;
        }
    }
    Ok(found)
}

/// `X_k = w_k Σ_j (x_j w_j) w̄_{k−j}` with `w_j = e^{∓πj j²/N}`.
fn by_convolution(values: &[Complex64], direction: FftDirection, ctl: &Ctl) -> Result<Vec<Complex64>, Stopped> {
    let n = values.len();
    let length = (2 * n - 1).next_power_of_two();
    let mut chirp = Vec::with_capacity(n);
    let mut left = vec![Complex64::new(0.0, 0.0); length];
    let mut right = left.clone();
    for (j, x) in values.iter().enumerate() {
        if j % AT_ONCE == 0 {
            ctl.check()?;
        }
        let w = turn(j as u128 * j as u128, 2 * n as u128, direction);
        chirp.push(w);
        left[j] = x * w;
        right[j] = w.conj();
        right[(length - j) % length] = w.conj();
    }
    let mut product = in_parts(left, FftDirection::Forward, ctl)?;
    for (x, y) in product.iter_mut().zip(in_parts(right, FftDirection::Forward, ctl)?) {
        *x *= y / length as f64;
    }
    ctl.check()?;
    let sums = in_parts(product, FftDirection::Inverse, ctl)?;
    Ok(sums.iter().zip(&chirp).map(|(x, w)| x * w).collect())
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

    #[test]
    fn a_transform_in_parts_is_the_transform() {
        // Composite, prime and twice a prime, all above the length that is done at once.
        for n in [3 * AT_ONCE / 2, 65_537 + 2 * 17, 70_001, 2 * 35_023] {
            let x: Vec<f64> = (0..n).map(|i| ((i * i % 1009) as f64 * 0.37).sin() + 0.2).collect();
            let (parts, whole) = (real_transform_in_parts(&x, &Ctl::new()).unwrap(), real_transform(&x));
            let largest = whole.iter().map(|v| v.norm()).fold(0.0, f64::max);
            assert_eq!(parts.len(), whole.len());
            assert!(parts.iter().zip(&whole).all(|(a, b)| (a - b).norm() < 1e-12 * largest), "{n}");
            let back = inverse_real_in_parts(&parts, n, &Ctl::new()).unwrap();
            assert!(x.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-11), "{n}");
        }
        let ctl = Ctl::new();
        ctl.stop(crate::ctl::StopReason::Cancelled);
        assert!(real_transform_in_parts(&vec![1.0; 2 * AT_ONCE], &ctl).is_err());
    }
}
