//! How far the refined controllers can be trusted: covariance and pointwise bands.
//!
//! Near the optimum `θ̂ − θ = −(√W J)⁺ √W ε` with the Jacobian J of the modelled response by all coefficients θ,
//! whatever the weights W are, so `cov θ̂ = P S Pᵀ` with `P = (√W J)⁺` and S the variances of the weighted noise (the
//! sandwich; for weights by inverse variance it is the inverse of Fisher's information). Noise is circular complex
//! Gaussian and independent between lines; where a response is real (0 Hz), so is its noise. A quantity f(θ) has the
//! influence `a = Pᵀ∇f` and the variance `Σ aᵢ² sᵢ` (delta method). Bands of magnitude and phase come from the two
//! parts of `∂ ln f`.
//!
//! Where each line's variance was estimated from n segments, with `ν = 2(n − 1)` degrees of freedom, Student's
//! distribution takes the place of the normal one, with Satterthwaite's degrees `V̂²/A − 2`, `A = Σ q̂_k²/(ν + 2)` of
//! the sum `V̂ = Σ q̂_k` over lines (both moments unbiased).
//!
//! No number is given where this reasoning does not hold: see [`Unavailable`].

mod coefficients;

use super::projection::{Point, Unknown, Values};
use super::refinement::Refinement;
use crate::num::distributions::student_t;
use crate::num::linalg;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Probability that bands and intervals hold.
pub const LEVEL: f64 = 0.95;

/// Singular values of the scaled Jacobian below this share of the largest one count as zero.
const SINGULAR: f64 = 1e-10;

/// A quantity that moves by more than this share of its gradient in undetermined directions is not identifiable.
const UNDETERMINED: f64 = 1e-6;

/// Standard deviations between the optimum and the edge of the stability margin below which the normal approximation
/// fails.
const NEAR_EDGE: f64 = 2.0;

/// Standard deviation of a log magnitude or phase (rad) above which the delta method fails.
const LARGEST_DEVIATION: f64 = 0.3;

/// Step of numerical differences, relative to the size of a coefficient.
const DIFFERENCE: f64 = 1e-4;

/// The noise of the response at the lines used.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    /// `E|h − E h|²` at each line.
    pub variance: Vec<f64>,
    /// Real degrees of freedom behind each variance, `2(n − 1)` of n segments; infinite if it is known.
    pub degrees_of_freedom: f64,
    /// Whether the lines' variances are independent estimates, as the scatter of segments is; if not (noise read from
    /// nearby lines that several lines share), sums over lines keep the degrees of a single one.
    pub are_independent: bool,
}

/// Why there is no interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Unavailable {
    /// The refinement did not converge.
    NotConverged,
    /// A constraint holds the optimum: the estimate is not normally distributed.
    OnConstraint,
    /// The edge of the stability margin is within two standard deviations.
    NearStabilityMargin,
    /// The lines do not determine it.
    NotIdentifiable,
    /// Its standard deviation is too large for a first-order approximation: above a factor of e^0.3 in magnitude or 0.3
    /// rad in phase.
    TooUncertain,
    /// The quantity is zero and has no logarithm.
    Zero,
}

/// An estimated coefficient or delay.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Parameter {
    /// For instance `feedback_denominator[1]`: coefficients in descending powers from 0, or `feedback_delay_s`.
    pub name: String,
    /// The estimate.
    pub value: f64,
    /// Its standard deviation.
    pub standard_deviation: Option<f64>,
    /// 95 % interval.
    pub interval: Option<[f64; 2]>,
    /// Why there is none.
    pub unavailable: Option<Unavailable>,
}

/// A frequency response at one line with its pointwise 95 % band.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Band {
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// Magnitude.
    pub magnitude: f64,
    /// Its band.
    pub magnitude_band: Option<[f64; 2]>,
    /// Phase in degrees, in (−180, 180].
    pub phase_deg: f64,
    /// Its band, around the phase given; it may reach past 180.
    pub phase_band_deg: Option<[f64; 2]>,
    /// Why there is none.
    pub unavailable: Option<Unavailable>,
}

/// Covariance and bands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Uncertainty {
    /// Probability that an interval or a band at one line holds, 0.95.
    pub level: f64,
    /// Real degrees of freedom of each line's variance; null if it is known.
    pub degrees_of_freedom_per_line: Option<f64>,
    /// The coefficients.
    pub parameters: Vec<Parameter>,
    /// Their covariance in that order, in products of their units; null where one of them has no standard deviation.
    #[serde(default)]
    pub covariance: Option<Vec<Vec<f64>>>,
    /// Gff.
    pub feedforward: Vec<Band>,
    /// Gfb.
    pub feedback: Vec<Band>,
    /// Gff·G; 1 where feedforward is the inverse of the plant.
    pub feedforward_plant: Vec<Band>,
    /// The closed loop from command to output.
    pub closed_loop: Vec<Band>,
    /// Standard deviations between the optimum and the nearest edge of the stability margin; null where a constraint is
    /// active.
    pub deviations_to_margin: Option<f64>,
    /// Why all intervals are missing, where they are.
    pub unavailable: Option<Unavailable>,
}

/// The linearised estimator at an optimum.
pub(super) struct Linearised {
    /// `P`: noise to coefficients, p × 2K.
    estimator: DMatrix<f64>,
    /// Directions of scaled coefficients that are not determined, as columns, and the scale of each coefficient.
    undetermined: DMatrix<f64>,
    scale: DVector<f64>,
    /// Variances of the weighted noise's parts, 2K.
    pub variance: DVector<f64>,
    /// An orthonormal basis of what coefficients can do to the residual.
    pub range: DMatrix<f64>,
    degrees: f64,
    are_independent: bool,
    /// The quantile of a normal distribution.
    normal: f64,
}

/// Standard deviation and the quantile that belongs to it.
pub(super) struct Deviation {
    pub standard: f64,
    pub quantile: f64,
}

impl Linearised {
    pub(super) fn new(jacobian: &DMatrix<f64>, variance: DVector<f64>, noise: &Noise) -> Option<Self> {
        let scale = DVector::from_fn(jacobian.ncols(), |j, _| {
            let norm = jacobian.column(j).norm();
            if norm > 0.0 { norm } else { 1.0 }
        });
        let scaled = DMatrix::from_fn(jacobian.nrows(), jacobian.ncols(), |i, j| jacobian[(i, j)] / scale[j]);
        let (u, sigma, v) = linalg::svd(&scaled).ok()?;
        let largest = sigma.first().copied().unwrap_or(0.0);
        let determined: Vec<usize> = (0..sigma.len()).filter(|i| sigma[*i] > SINGULAR * largest).collect();
        let range = u.select_columns(&determined);
        let mut turned = v.select_columns(&determined);
        for (column, i) in determined.iter().enumerate() {
            turned.column_mut(column).unscale_mut(sigma[*i]);
        }
        let mut estimator = turned * range.transpose();
        for (j, mut row) in estimator.row_iter_mut().enumerate() {
            row.unscale_mut(scale[j]);
        }
        let missing: Vec<usize> = (0..v.ncols()).filter(|i| !determined.contains(i)).collect();
        Some(Self {
            estimator,
            undetermined: v.select_columns(&missing),
            scale,
            variance,
            range,
            degrees: noise.degrees_of_freedom,
            are_independent: noise.are_independent,
            normal: student_t(LEVEL, f64::INFINITY),
        })
    }

    /// The deviation of a quantity with this gradient.
    pub(super) fn deviation(&self, gradient: &DVector<f64>) -> Result<Deviation, Unavailable> {
        let scaled = gradient.component_div(&self.scale);
        if self.undetermined.ncols() > 0 && self.undetermined.tr_mul(&scaled).norm() > UNDETERMINED * scaled.norm() {
            return Err(Unavailable::NotIdentifiable);
        }
        let influence = self.estimator.tr_mul(gradient);
        let parts = influence.component_mul(&influence).component_mul(&self.variance);
        let lines = parts.len() / 2;
        let per_line: Vec<f64> = (0..lines).map(|k| parts[k] + parts[k + lines]).collect();
        let total: f64 = per_line.iter().sum();
        let degrees = self.degrees_of(&per_line);
        let quantile = if degrees.is_infinite() { self.normal } else { student_t(LEVEL, degrees) };
        Ok(Deviation { standard: total.sqrt(), quantile })
    }

    /// The covariance of quantities with these gradients, `aᵢᵀ S aⱼ`.
    fn covariance(&self, gradients: &[DVector<f64>]) -> Vec<Vec<f64>> {
        let influences: Vec<DVector<f64>> = gradients.iter().map(|gradient| self.estimator.tr_mul(gradient)).collect();
        let entry = |a: &DVector<f64>, b: &DVector<f64>| a.component_mul(b).dot(&self.variance);
        influences.iter().map(|a| influences.iter().map(|b| entry(a, b)).collect()).collect()
    }

    /// Degrees of freedom of a sum of parts that are proportional to the lines' variances.
    pub(super) fn degrees_of(&self, per_line: &[f64]) -> f64 {
        if self.are_independent { effective_degrees(per_line, self.degrees) } else { self.degrees }
    }
}

/// Satterthwaite's degrees of freedom of a sum of independent variance estimates with `degrees` each.
fn effective_degrees(parts: &[f64], degrees: f64) -> f64 {
    let total: f64 = parts.iter().sum();
    if degrees.is_infinite() || total == 0.0 {
        return f64::INFINITY;
    }
    let squares: f64 = parts.iter().map(|q| q * q).sum::<f64>() / (degrees + 2.0);
    f64::max(total * total / squares - 2.0, 1.0)
}

/// A frequency response at a line, and the derivative of its logarithm by the coefficients.
struct Response {
    value: Complex64,
    log_gradient: Vec<Complex64>,
}

impl Refinement<'_> {
    /// Covariance and bands, from the noise at the lines.
    ///
    /// `None` where the optimum cannot be linearised (a singular value iteration that fails).
    ///
    /// # Panics
    /// If there is not one variance for each line used, which is a mistake of the caller.
    #[must_use]
    pub fn uncertainty(&self, noise: &Noise) -> Option<Uncertainty> {
        let point = self.projection.point(&self.minimum.x)?;
        let linearised = self.linearised(&point, noise)?;
        let deviations_to_margin = self.deviations_to_margin(&linearised, point.beta.len());
        let unavailable = if !self.minimum.stop.is_converged() {
            Some(Unavailable::NotConverged)
        } else if !self.minimum.active.is_empty() {
            Some(Unavailable::OnConstraint)
        } else if deviations_to_margin.is_some_and(|d| d < NEAR_EDGE) {
            Some(Unavailable::NearStabilityMargin)
        } else {
            None
        };
        let mut bands: [Vec<Band>; 4] = Default::default();
        for k in 0..self.lines().len() {
            for (bands, response) in bands.iter_mut().zip(self.responses(&point, k)) {
                bands.push(self.band(&linearised, k, &response, unavailable));
            }
        }
        let [feedforward, feedback, feedforward_plant, closed_loop] = bands;
        let (parameters, covariance) = self.parameters(&point, &linearised, unavailable);
        Some(Uncertainty {
            level: LEVEL,
            degrees_of_freedom_per_line: noise.degrees_of_freedom.is_finite().then_some(noise.degrees_of_freedom),
            parameters,
            covariance,
            feedforward,
            feedback,
            feedforward_plant,
            closed_loop,
            deviations_to_margin,
            unavailable,
        })
    }

    pub(super) fn linearised(&self, point: &Point, noise: &Noise) -> Option<Linearised> {
        let lines = self.lines();
        assert_eq!(lines.len(), noise.variance.len(), "a variance for every line");
        let variance = DVector::from_fn(2 * lines.len(), |i, _| {
            let (k, is_imaginary) = (i % lines.len(), i >= lines.len());
            let share = match (self.is_real(k), is_imaginary) {
                (false, _) => 0.5,
                (true, false) => 1.0,
                (true, true) => 0.0,
            };
            share * self.projection.weight[k] * noise.variance[k]
        });
        Linearised::new(&self.projection.full(point), variance, noise)
    }

    /// Whether a response at a line is a real number.
    pub(super) fn is_real(&self, k: usize) -> bool {
        let omega = self.lines()[k].omega_rad_s;
        let theta = omega * self.setup.problem.time().sample_time_s().unwrap_or(0.0);
        omega == 0.0 || (theta > 1.0 && theta.sin().abs() < 1e-12)
    }

    fn deviations_to_margin(&self, linearised: &Linearised, beta: usize) -> Option<f64> {
        if !self.minimum.active.is_empty() {
            return None;
        }
        let mut nearest: Option<f64> = None;
        let mut measure = |value: f64, slope: &[f64]| {
            let gradient = DVector::from_fn(beta + slope.len(), |j, _| if j < beta { 0.0 } else { slope[j - beta] });
            if gradient.norm() > 0.0
                && let Ok(deviation) = linearised.deviation(&gradient)
                && deviation.standard > 0.0
            {
                let distance = value / deviation.standard;
                nearest = Some(nearest.map_or(distance, |n: f64| n.min(distance)));
            }
        };
        for margin in &self.projection.margins {
            let (values, slope) = margin.evaluate(&self.minimum.x, true);
            for (i, value) in values.iter().enumerate() {
                measure(*value, &slope.as_ref()?.row(i).iter().copied().collect::<Vec<_>>());
            }
        }
        if self.projection.delayed_loop.is_some() {
            let Some((value, slope)) = self.delayed_distance() else { return Some(0.0) };
            measure(value, &slope);
        }
        nearest
    }

    /// How far a loop with delay is inside its margin, in 1/s, and the derivatives of that by φ (central differences).
    ///
    /// `None` where a loop next to the optimum is already outside.
    fn delayed_distance(&self) -> Option<(f64, Vec<f64>)> {
        let distance = |phi: &[f64]| Some(-self.setup.margin_per_s - self.loop_exponent(phi)?);
        let own = distance(&self.minimum.x)?;
        let mut slope = Vec::with_capacity(self.minimum.x.len());
        for j in 0..self.minimum.x.len() {
            if matches!(self.projection.unknowns[j], Unknown::FeedforwardDenominator(_) | Unknown::FeedforwardDelay) {
                slope.push(0.0);
                continue;
            }
            let step = DIFFERENCE * (0.1 + self.minimum.x[j].abs());
            let moved = |by: f64| {
                let mut phi = self.minimum.x.clone();
                phi[j] = (phi[j] + by).max(if self.projection.unknowns[j] == Unknown::FeedbackDelay {
                    0.0
                } else {
                    f64::MIN
                });
                Some((distance(&phi)?, phi[j]))
            };
            let ((up, high), (down, low)) = (moved(step)?, moved(-step)?);
            slope.push((up - down) / (high - low));
        }
        Some((own, slope))
    }

    /// Gff, Gfb, Gff·G and the closed loop at a line.
    fn responses(&self, point: &Point, k: usize) -> [Response; 4] {
        let (projection, line) = (&self.projection, &self.lines()[k]);
        let values: Values = point.values[k];
        let basis = projection.basis_at(k);
        let numerator: Complex64 = basis.iter().zip(point.beta.iter()).map(|(b, c)| b * c).sum();
        let zero = Complex64::new(0.0, 0.0);
        let (factor, rest) = projection.model(&values, k);
        let closed = factor * numerator + rest;
        let mut gradients: [Vec<Complex64>; 3] = Default::default();
        for b in basis {
            gradients[0].push(b / numerator);
            gradients[1].push(zero);
            gradients[2].push(factor * b / closed);
        }
        for unknown in &projection.unknowns {
            let (by_factor, by_rest) = projection.derivative(&values, k, *unknown);
            gradients[0].push(projection.feedforward_log_derivative(&values, k, *unknown));
            gradients[1].push(projection.feedback_log_derivative(&values, k, *unknown));
            gradients[2].push((by_factor * numerator + by_rest) / closed);
        }
        let feedforward = numerator * values.turn / values.dff;
        let [by_feedforward, by_feedback, by_closed] = gradients;
        [
            Response { value: feedforward, log_gradient: by_feedforward.clone() },
            Response { value: values.nfb / values.dfb, log_gradient: by_feedback },
            Response { value: feedforward * line.plant, log_gradient: by_feedforward },
            Response { value: closed, log_gradient: by_closed },
        ]
    }

    fn band(&self, linearised: &Linearised, k: usize, response: &Response, general: Option<Unavailable>) -> Band {
        let (magnitude, phase) = (response.value.norm(), response.value.arg());
        let is_usable =
            magnitude.is_normal() && response.log_gradient.iter().all(|g| g.re.is_finite() && g.im.is_finite());
        let mut band = Band {
            omega_rad_s: self.lines()[k].omega_rad_s,
            magnitude: if magnitude.is_finite() { magnitude } else { f64::MAX },
            magnitude_band: None,
            phase_deg: if is_usable { phase.to_degrees() } else { 0.0 },
            phase_band_deg: None,
            unavailable: general,
        };
        if general.is_some() {
            return band;
        }
        if !is_usable {
            band.unavailable = Some(Unavailable::Zero);
            return band;
        }
        let part = |part: fn(&Complex64) -> f64| {
            let gradient = DVector::from_iterator(response.log_gradient.len(), response.log_gradient.iter().map(part));
            linearised.deviation(&gradient).and_then(|deviation| {
                let half = deviation.standard * deviation.quantile;
                if deviation.standard <= LARGEST_DEVIATION { Ok(half) } else { Err(Unavailable::TooUncertain) }
            })
        };
        match (part(|g| g.re), part(|g| g.im)) {
            (Ok(log), Ok(angle)) => {
                band.magnitude_band = Some([magnitude * (-log).exp(), magnitude * log.exp()]);
                band.phase_band_deg = Some([(phase - angle).to_degrees(), (phase + angle).to_degrees()]);
            }
            (Err(why), _) | (_, Err(why)) => band.unavailable = Some(why),
        }
        band
    }
}

#[cfg(test)]
mod tests;
