//! Whether what the refined model leaves over looks like the noise.
//!
//! Linearised, the residual is `r = M ε` with `M = I − U Uᵀ`, U an orthonormal basis of what the coefficients can do,
//! and ε the weighted noise with variances S.
//!
//! - **Power.** `E‖r‖² = Σ sᵢ(1 − hᵢ)` with the leverages h; `var ‖r‖² = 2 tr (M S)²`. Their ratio to chi-square
//!   (Satterthwaite) gives a test of J against the noise, `F(h, ν)` where the variances themselves are estimates. With
//!   weights by inverse known variance it is the chi-square test.
//! - **Whiteness.** The lag-one correlation of neighbouring lines' normalised residuals, `|Σ e_k ē_{k+1}| / Σ |e_k|²`,
//!   against its distribution under `r = M ε`, by simulation with a fixed seed.

use super::refinement::Refinement;
use super::uncertainty::Noise;
use crate::num::distributions::f_cdf;
use crate::num::rng;
use nalgebra::DVector;
use num_complex::Complex64;
use rand_distr::{Distribution, StandardNormal};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Draws of the simulated distribution of the lag-one correlation.
const DRAWS: usize = 999;

/// Lines below which neighbours are too few.
const FEWEST_LINES: usize = 5;

/// The tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ResidualTests {
    /// J over what the noise leaves on average after the fit: above 1 where the model misses something.
    pub power_ratio: f64,
    /// Degrees of freedom of the residual power.
    pub degrees_of_freedom: f64,
    /// Degrees of freedom of the noise power that it is compared with; null where the variances are known.
    pub noise_degrees_of_freedom: Option<f64>,
    /// Probability of a larger power ratio if the model is right: small where the model misses something.
    pub power_p_value: f64,
    /// Correlation of neighbouring lines' residuals, from 0 to 1; null of fewer than five lines.
    pub neighbour_correlation: Option<f64>,
    /// Probability of a larger one if the model is right.
    pub whiteness_p_value: Option<f64>,
}

/// `|Σ e_k ē_{k+1}| / Σ |e_k|²`.
fn correlation(normalised: &[Complex64]) -> f64 {
    let cross: Complex64 = normalised.windows(2).map(|pair| pair[0] * pair[1].conj()).sum();
    let power: f64 = normalised.iter().map(Complex64::norm_sqr).sum();
    if power > 0.0 { cross.norm() / power } else { 0.0 }
}

impl Refinement<'_> {
    /// Tests of the residual against the noise; `None` where nothing is left to test (as many coefficients as
    /// equations).
    ///
    /// # Panics
    /// If there is not one variance for each line used, which is a mistake of the caller.
    #[must_use]
    pub fn residual_tests(&self, noise: &Noise) -> Option<ResidualTests> {
        let point = self.projection.point(&self.minimum.x)?;
        let linearised = self.linearised(&point, noise)?;
        let (s, u) = (&linearised.variance, &linearised.range);
        let lines = s.len() / 2;
        let leverage: Vec<f64> = u.row_iter().map(|row| row.norm_squared()).collect();
        let per_line: Vec<f64> =
            (0..lines).map(|k| s[k] * (1.0 - leverage[k]) + s[k + lines] * (1.0 - leverage[k + lines])).collect();
        let mean: f64 = per_line.iter().sum();
        // tr (MS)² = tr S² − 2 tr UᵀS²U + ‖UᵀSU‖².
        let squares: f64 = s.iter().map(|s| s * s).sum();
        let crossed: f64 = s.iter().zip(&leverage).map(|(s, h)| s * s * h).sum();
        let mut scaled = u.clone();
        scaled.row_iter_mut().zip(s.iter()).for_each(|(mut row, s)| row *= *s);
        let half_variance = squares - 2.0 * crossed + u.tr_mul(&scaled).norm_squared();
        if !(mean > 0.0 && half_variance > 1e-12 * squares) {
            return None;
        }
        let degrees = mean * mean / half_variance;
        let noise_degrees = linearised.degrees_of(&per_line);
        let ratio = self.minimum.cost / mean;
        let (neighbour_correlation, whiteness_p_value) = if lines < FEWEST_LINES {
            (None, None)
        } else {
            let roots = s.map(f64::sqrt);
            let normalised = |r: &DVector<f64>| -> Vec<Complex64> {
                let part = |i: usize| if roots[i] > 0.0 { r[i] / roots[i] } else { 0.0 };
                (0..lines).map(|k| Complex64::new(part(k), part(k + lines))).collect()
            };
            let own = correlation(&normalised(&point.residuals));
            let mut random = rng::stream(0, "whiteness of residuals");
            let larger = (0..DRAWS)
                .filter(|_| {
                    let drawn = DVector::from_fn(2 * lines, |i, _| {
                        let normal: f64 = StandardNormal.sample(&mut random);
                        roots[i] * normal
                    });
                    let left = &drawn - u * u.tr_mul(&drawn);
                    correlation(&normalised(&left)) >= own
                })
                .count();
            (Some(own), Some((larger + 1) as f64 / (DRAWS + 1) as f64))
        };
        Some(ResidualTests {
            power_ratio: ratio,
            degrees_of_freedom: degrees,
            noise_degrees_of_freedom: noise_degrees.is_finite().then_some(noise_degrees),
            power_p_value: 1.0 - f_cdf(ratio, degrees, noise_degrees),
            neighbour_correlation,
            whiteness_p_value,
        })
    }
}
