//! Responses of the controllers with regions, and norms with intervals.
//!
//! A norm is the average of a magnitude over a band, `φ = 1/(ω₂ − ω₁) ∫ |X(ω)| dω`, as in
//! [`learning`](crate::learning). Its standard error is linearised, `σ_φ² = ∇φᵀ Cov ∇φ`, and multiplied by
//! [`NORM_FACTOR`]; its bias follows from `E|X̂|`, the mean magnitude of a complex normal number with the estimate's
//! covariance: about `|X| + (variance across X)/(2|X|)`.

use super::estimate::Estimate;
use nalgebra::{DVector, Matrix2};
use num_complex::Complex64;
use std::f64::consts::PI;

/// Standard errors of norms are multiplied by this: linearised ones covered 90 – 93 % where 95 % was meant, on people
/// outside the model class (docs/limits.md).
pub const NORM_FACTOR: f64 = 1.15;

/// Likewise of the regions of responses, whose covariance misses more.
pub const REGION_FACTOR: f64 = 1.4;

/// The two-sided 95 % bound of a normal number, and of a chi-square with two degrees of freedom.
pub const NORMAL_95: f64 = 1.959_963_984_540_054;
const CHI_SQUARE_2_95: f64 = 5.991_464_547_107_979;

/// Panels of the quadrature over the band, with three Gauss–Legendre nodes each.
const PANELS: usize = 40;

/// Points on the boundary of a region that its ranges are taken from.
const BOUNDARY: usize = 720;

/// A complex response and its derivatives by the parameters of its record.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    /// The value.
    pub value: Complex64,
    pub(super) slope: DVector<Complex64>,
}

/// Both controllers at a frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct Controllers {
    /// Gff.
    pub feedforward: Response,
    /// Gfb, its delay included.
    pub feedback: Response,
}

/// An ellipse in the complex plane that holds the response with a probability of about 95 %.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// Its half axes, the longer first.
    pub half_axes: [f64; 2],
    /// The angle of the longer one to the real axis in rad.
    pub angle_rad: f64,
    /// Magnitudes in it: from 0 where it holds 0.
    pub magnitude: [f64; 2],
    /// Phases in it in rad, around that of the value; `None` where it holds 0.
    pub phase_rad: Option<[f64; 2]>,
}

/// Which magnitude is averaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Norm {
    /// ‖Gfb‖.
    Feedback,
    /// ‖Gff − G⁻¹‖.
    FeedforwardMinusInverse,
    /// ‖Gff G − 1‖.
    FeedforwardPlantMinusOne,
}

/// A norm of an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct NormEstimate {
    /// Its plain value, around which the interval lies.
    pub value: f64,
    /// Its value less its bias.
    pub corrected: f64,
    /// Its standard error, [`NORM_FACTOR`] included.
    pub standard_error: f64,
}

impl NormEstimate {
    /// The 95 % interval; a norm is not negative.
    #[must_use]
    pub fn interval(&self) -> [f64; 2] {
        let half = NORMAL_95 * self.standard_error;
        [(self.value - half).max(0.0), self.value + half]
    }
}

impl Estimate {
    /// Both controllers of a record at ω in rad/s.
    #[must_use]
    pub fn controllers(&self, record: usize, omega_rad_s: f64) -> Controllers {
        let omega_t = omega_rad_s * self.sample_time_s;
        let turn = |lag: usize| Complex64::from_polar(1.0, -omega_t * lag as f64);
        let (layout, p) = (&self.layout, &self.records[record].parameters);
        let mut a = Complex64::from(1.0);
        for (k, j) in layout.autoregressive.clone().enumerate() {
            a -= p[j] * turn(k + 1);
        }
        let columns = self.basis.responses(omega_t);
        let zero = DVector::from_element(layout.all, Complex64::default());
        let (mut ff, mut fb) = (zero.clone(), zero);
        let (mut feedforward, mut feedback) = (Complex64::default(), Complex64::default());
        for (k, j) in layout.feedforward.clone().enumerate() {
            ff[j] = columns[k] / a;
            feedforward += p[j] * ff[j];
        }
        for (k, j) in layout.feedback.clone().enumerate() {
            fb[j] = turn(self.lags.feedback[0] + k) / a;
            feedback += p[j] * fb[j];
        }
        for (k, j) in layout.autoregressive.clone().enumerate() {
            // d(1/A)/da = q⁻ᵏ/A².
            ff[j] = feedforward * turn(k + 1) / a;
            fb[j] = feedback * turn(k + 1) / a;
        }
        Controllers {
            feedforward: Response { value: feedforward, slope: ff },
            feedback: Response { value: feedback, slope: fb },
        }
    }

    /// The covariance of the two parts of a response, without a factor.
    #[must_use]
    pub(super) fn spread(&self, record: usize, slope: &DVector<Complex64>) -> Matrix2<f64> {
        let covariance = &self.records[record].covariance;
        let (re, im) = (slope.map(|z| z.re), slope.map(|z| z.im));
        let (of_re, of_im) = (covariance * &re, covariance * &im);
        Matrix2::new(re.dot(&of_re), re.dot(&of_im), im.dot(&of_re), im.dot(&of_im))
    }

    /// The 95 % region of a response.
    #[must_use]
    pub fn region(&self, record: usize, response: &Response) -> Region {
        let spread = self.spread(record, &response.slope) * (REGION_FACTOR * REGION_FACTOR * CHI_SQUARE_2_95);
        region(response.value, &spread)
    }

    /// A norm of a record over a band in rad/s, with the plant's response; `None` where the plant is zero or infinite
    /// in the band and the norm with it.
    #[must_use]
    pub fn norm(
        &self,
        record: usize,
        norm: Norm,
        plant: &dyn Fn(f64) -> Complex64,
        band_rad_s: [f64; 2],
    ) -> Option<NormEstimate> {
        let (value, gradient, mean) = self.average(record, norm, plant, band_rad_s)?;
        let variance = gradient.dot(&(&self.records[record].covariance * &gradient));
        let standard_error = NORM_FACTOR * variance.max(0.0).sqrt();
        let found = NormEstimate { value, corrected: (2.0 * value - mean).max(0.0), standard_error };
        [found.value, found.corrected, found.standard_error].iter().all(|v| v.is_finite()).then_some(found)
    }

    /// The average magnitude, its gradient, and the average of the mean magnitudes of noisy estimates.
    fn average(
        &self,
        record: usize,
        norm: Norm,
        plant: &dyn Fn(f64) -> Complex64,
        band_rad_s: [f64; 2],
    ) -> Option<(f64, DVector<f64>, f64)> {
        let (mut value, mut mean) = (0.0, 0.0);
        let mut gradient = DVector::zeros(self.layout.all);
        for (omega, weight) in nodes(band_rad_s) {
            let both = self.controllers(record, omega);
            let g = plant(omega);
            let (x, slope) = match norm {
                Norm::Feedback => (both.feedback.value, both.feedback.slope),
                Norm::FeedforwardMinusInverse => (both.feedforward.value - 1.0 / g, both.feedforward.slope),
                Norm::FeedforwardPlantMinusOne => (both.feedforward.value * g - 1.0, both.feedforward.slope * g),
            };
            let size = x.norm();
            if !size.is_finite() {
                return None;
            }
            value += weight * size;
            if size > 0.0 {
                let direction = x.conj() / size;
                gradient += slope.map(|s| weight * (direction * s).re);
            }
            mean += weight * mean_magnitude(x, &self.spread(record, &slope));
        }
        Some((value, gradient, mean))
    }
}

/// Nodes and weights of the average over a band: three Gauss–Legendre nodes in each of [`PANELS`] panels.
fn nodes([from, to]: [f64; 2]) -> impl Iterator<Item = (f64, f64)> {
    let width = (to - from) / PANELS as f64;
    let outer = 0.6_f64.sqrt();
    (0..PANELS).flat_map(move |k| {
        let middle = from + width * (k as f64 + 0.5);
        [(-outer, 5.0 / 18.0), (0.0, 8.0 / 18.0), (outer, 5.0 / 18.0)]
            .map(|(x, w)| (middle + 0.5 * width * x, w / PANELS as f64))
    })
}

/// Eigenvalues (the larger first) of a symmetric 2 × 2 matrix and the angle of the first eigenvector.
fn axes(m: &Matrix2<f64>) -> ([f64; 2], f64) {
    let (a, b, c) = (m[(0, 0)], m[(0, 1)], m[(1, 1)]);
    let (middle, half) = (0.5 * (a + c), (0.5 * (a - c)).hypot(b));
    ([middle + half, (middle - half).max(0.0)], 0.5 * (2.0 * b).atan2(a - c))
}

fn region(value: Complex64, scaled: &Matrix2<f64>) -> Region {
    let (eigenvalues, angle_rad) = axes(scaled);
    let half_axes = eigenvalues.map(|v| v.max(0.0).sqrt());
    let turn = Complex64::from_polar(1.0, angle_rad);
    // The origin in the coordinates of the ellipse.
    let origin = -value * turn.conj();
    let holds_zero =
        half_axes[1] > 0.0 && (origin.re / half_axes[0]).powi(2) + (origin.im / half_axes[1]).powi(2) <= 1.0;
    let (mut magnitude, mut phase) = ([f64::INFINITY, 0.0_f64], [0.0_f64; 2]);
    for k in 0..BOUNDARY {
        let t = 2.0 * PI * k as f64 / BOUNDARY as f64;
        let z = value + turn * Complex64::new(half_axes[0] * t.cos(), half_axes[1] * t.sin());
        magnitude = [magnitude[0].min(z.norm()), magnitude[1].max(z.norm())];
        let off = (z / value).arg();
        phase = [phase[0].min(off), phase[1].max(off)];
    }
    if holds_zero {
        magnitude[0] = 0.0;
    }
    let phase_rad = (!holds_zero).then(|| phase.map(|off| value.arg() + off));
    Region { half_axes, angle_rad, magnitude, phase_rad }
}

/// Positive nodes of the Gauss–Hermite rule of order 8 for a standard normal number, with the weights of ± each
/// (Abramowitz and Stegun, table 25.10, nodes times √2, weights over √π).
const HERMITE: [(f64, f64); 4] = [
    (0.539_079_811_351_375_2, 0.373_012_257_679_077),
    (1.636_519_042_435_108, 0.117_239_907_661_759),
    (2.802_485_861_287_542, 0.009_635_220_120_788_3),
    (4.144_547_186_125_894, 0.000_112_614_538_375_37),
];

/// `E|Z|` of a complex normal number with this mean and covariance of its parts.
fn mean_magnitude(mean: Complex64, covariance: &Matrix2<f64>) -> f64 {
    let (eigenvalues, angle) = axes(covariance);
    let turn = Complex64::from_polar(1.0, angle);
    let half = eigenvalues.map(|v| v.max(0.0).sqrt());
    let signed = || HERMITE.iter().flat_map(|(x, w)| [(*x, *w), (-*x, *w)]);
    signed()
        .flat_map(|(x, wx)| signed().map(move |(y, wy)| (x, y, wx * wy)))
        .map(|(x, y, weight)| weight * (mean + turn * Complex64::new(half[0] * x, half[1] * y)).norm())
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_average_of_a_known_function_is_its_integral() {
        let average: f64 = nodes([1.0, 3.0]).map(|(x, w)| w * x.powi(5)).sum();
        assert!((average - (3.0_f64.powi(6) - 1.0) / 12.0).abs() < 1e-12);
    }

    /// Rayleigh: √(π/2) σ at mean 0; far away |m| + σ²/(2|m|).
    #[test]
    fn mean_magnitudes_are_those_of_rice() {
        let one = Matrix2::identity();
        assert!((mean_magnitude(Complex64::default(), &one) / (PI / 2.0).sqrt() - 1.0).abs() < 0.02);
        let far = Complex64::from_polar(8.0, 0.7);
        assert!((mean_magnitude(far, &one) - (8.0 + 1.0 / 16.0 + 1.0 / (8.0 * 512.0))).abs() < 1e-5);
        // Only the variance across counts: along the mean there is none of it.
        let along = Matrix2::new(1.0, 0.0, 0.0, 0.0);
        assert!((mean_magnitude(Complex64::new(9.0, 0.0), &along) - 9.0).abs() < 1e-9);
        assert!((mean_magnitude(Complex64::new(0.0, 9.0), &along) - (9.0 + 1.0 / 18.0)).abs() < 1e-3);
    }

    #[test]
    fn a_region_that_holds_zero_has_no_phase() {
        let wide = region(Complex64::new(1.0, 0.0), &Matrix2::new(4.0, 0.0, 0.0, 1.0));
        assert!(wide.phase_rad.is_none() && wide.magnitude == [0.0, 3.0], "{wide:?}");
        let narrow = region(Complex64::new(0.0, 2.0), &Matrix2::new(1.0, 0.0, 0.0, 1.0));
        assert!((narrow.magnitude[0] - 1.0).abs() < 1e-9 && (narrow.magnitude[1] - 3.0).abs() < 1e-9);
        let [low, high] = narrow.phase_rad.unwrap();
        // A circle of radius 1 around 2j is seen from 0 within ± 30°.
        assert!((low - PI / 3.0).abs() < 1e-4 && (high - 2.0 * PI / 3.0).abs() < 1e-4, "{low} {high}");
    }
}
