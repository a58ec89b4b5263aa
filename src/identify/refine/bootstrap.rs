//! Parametric bootstrap: the refinement repeated on responses drawn around the refined model.
//!
//! `H* = G̃(θ̂) + ε*` with circular complex normal noise of the lines' variances (real where the response is), refined
//! from θ̂. It does without the linearisation behind the bands, and so checks it.

use super::projection::Projection;
use super::refinement::Refinement;
use super::uncertainty::Noise;
use crate::ctl::{Ctl, Stopped};
use crate::num::least_squares::{self, LeastSquaresError, Options};
use crate::num::rng;
use num_complex::Complex64;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Draws that must have converged for quantiles at 2.5 and 97.5 %.
const FEWEST: usize = 40;

/// Draws at one line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BootstrapBand {
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// The middle 95 % of the drawn magnitudes.
    pub magnitude_band: [f64; 2],
    /// The middle 95 % of the drawn phases in degrees, around the estimate's.
    pub phase_band_deg: [f64; 2],
}

/// What the draws gave.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Bootstrap {
    /// Draws asked for.
    pub draws: usize,
    /// The seed.
    pub seed: u64,
    /// Draws whose refinement converged without a constraint; only these are counted.
    pub converged: usize,
    /// Draws that a constraint held.
    pub on_constraint: usize,
    /// Gff; empty where fewer than 40 draws converged.
    pub feedforward: Vec<BootstrapBand>,
    /// Gfb; empty where fewer than 40 draws converged, or the estimate is zero.
    pub feedback: Vec<BootstrapBand>,
}

/// The drawn controllers at the lines, relative to the estimate: `ln (G*/Ĝ)` of feedforward and feedback.
struct Draw {
    feedforward: Vec<Complex64>,
    feedback: Vec<Complex64>,
    is_held: bool,
}

/// The quantile of sorted numbers, interpolated (Hyndman and Fan 1996, type 7).
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let at = share * (sorted.len() - 1) as f64;
    let (low, part) = (at.floor() as usize, at.fract());
    sorted[low] + part * (sorted[(low + 1).min(sorted.len() - 1)] - sorted[low])
}

impl Refinement<'_> {
    /// Draws and refines again; the same seed gives the same result however many threads there are.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    ///
    /// # Panics
    /// If there is not one variance for each line used, which is a mistake of the caller.
    pub fn bootstrap(&self, noise: &Noise, draws: usize, seed: u64, ctl: &Ctl) -> Result<Bootstrap, Stopped> {
        let lines = self.lines().len();
        assert_eq!(lines, noise.variance.len(), "a variance for every line");
        let own = self.controllers_at_lines(&self.projection, &self.minimum.x);
        ctl.set_total(draws as u64);
        let drawn: Vec<Option<Draw>> = (0..draws)
            .into_par_iter()
            .map(|draw| {
                let drawn = self.drawn(noise, &own, seed, draw, ctl)?;
                ctl.advance(1);
                Ok(drawn)
            })
            .collect::<Result<_, Stopped>>()?;
        let free: Vec<&Draw> = drawn.iter().flatten().filter(|d| !d.is_held).collect();
        let bands = |of: fn(&Draw) -> &Vec<Complex64>, own: &[Complex64]| -> Vec<BootstrapBand> {
            if free.len() < FEWEST || own.iter().any(|g| !g.norm().is_normal()) {
                return Vec::new();
            }
            (0..lines)
                .map(|k| {
                    let ends = |part: fn(&Complex64) -> f64| {
                        let mut values: Vec<f64> = free.iter().map(|draw| part(&of(draw)[k])).collect();
                        values.sort_by(f64::total_cmp);
                        [quantile(&values, 0.025), quantile(&values, 0.975)]
                    };
                    BootstrapBand {
                        omega_rad_s: self.lines()[k].omega_rad_s,
                        magnitude_band: ends(|z| z.re).map(|log| own[k].norm() * log.exp()),
                        phase_band_deg: ends(|z| z.im).map(|angle| (own[k].arg() + angle).to_degrees()),
                    }
                })
                .collect()
        };
        Ok(Bootstrap {
            draws,
            seed,
            converged: free.len(),
            on_constraint: drawn.iter().flatten().filter(|d| d.is_held).count(),
            feedforward: bands(|draw| &draw.feedforward, &own.0),
            feedback: bands(|draw| &draw.feedback, &own.1),
        })
    }

    fn drawn(
        &self,
        noise: &Noise,
        own: &(Vec<Complex64>, Vec<Complex64>),
        seed: u64,
        draw: usize,
        ctl: &Ctl,
    ) -> Result<Option<Draw>, Stopped> {
        let mut random = rng::stream(seed, &format!("bootstrap {draw}"));
        let mut projection = self.projection.clone();
        let Some(point) = self.projection.point(&self.minimum.x) else { return Ok(None) };
        let lines = self.lines().len();
        for (k, response) in projection.response.iter_mut().enumerate() {
            let root = self.projection.weight[k].sqrt();
            let model = *response + Complex64::new(point.residuals[k], point.residuals[k + lines]) / root;
            let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
            let deviation = noise.variance[k].sqrt();
            let drawn = if self.is_real(k) {
                Complex64::new(deviation * normal(), 0.0)
            } else {
                Complex64::new(normal(), normal()) * (deviation * std::f64::consts::FRAC_1_SQRT_2)
            };
            *response = model + drawn;
        }
        let options = Options { max_evaluations: 200, ..Options::default() };
        match least_squares::minimise(&projection, &self.minimum.x, &options, ctl) {
            Err(LeastSquaresError::Stopped(stopped)) => Err(stopped),
            Ok(found) if found.stop.is_converged() => {
                let (feedforward, feedback) = self.controllers_at_lines(&projection, &found.x);
                let relative = |drawn: Vec<Complex64>, own: &[Complex64]| {
                    drawn.iter().zip(own).map(|(drawn, own)| (drawn / own).ln()).collect()
                };
                Ok(Some(Draw {
                    feedforward: relative(feedforward, &own.0),
                    feedback: relative(feedback, &own.1),
                    is_held: !found.active.is_empty(),
                }))
            }
            _ => Ok(None),
        }
    }

    /// Gff and Gfb at the lines.
    fn controllers_at_lines(&self, projection: &Projection<'_>, phi: &[f64]) -> (Vec<Complex64>, Vec<Complex64>) {
        let Some(point) = projection.point(phi) else { return (Vec::new(), Vec::new()) };
        (0..self.lines().len())
            .map(|k| {
                let values = point.values[k];
                let numerator: Complex64 =
                    projection.basis_at(k).iter().zip(point.beta.iter()).map(|(b, c)| b * c).sum();
                (numerator * values.turn / values.dff, values.nfb / values.dfb)
            })
            .unzip()
    }
}
