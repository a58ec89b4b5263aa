//! Which structure the data support: information criteria and cross-validation over lines.
//!
//! Every structure is refined as the others are, by weights of inverse variance where the variance is known (then it is
//! maximum likelihood) and uniform ones where it is not. With circular complex Gaussian noise, N real equations and p
//! coefficients:
//!
//! - variance known: `−2 ln L = Σ 2 |r_k|²/v_k` + constant (`Σ r²/v` where the response is real);
//! - not known, equal at all lines: `−2 ln L = N ln (J/N)` + constant, and the variance counts as one coefficient more;
//! - `AIC = −2 ln L + 2p`, `BIC = −2 ln L + p ln N`;
//! - cross-validation over lines: each line left out in turn, the rest refined from the optimum, and the line's
//!   weighted squared error summed;
//! - cross-validation over repeats: each trial (or segment) left out in turn, the response of the rest refined from the
//!   optimum, and the weighted squared error of the response that was left out averaged. Over lines it asks whether the
//!   structure interpolates, over repeats whether it would have predicted another trial.

use super::refinement::Refinement;
use super::setup::{RefineError, Setup, Start};
use super::uncertainty::Noise;
use crate::ctl::{Ctl, Stopped};
use crate::identify::identifiability::Structure;
use crate::identify::problem::{Line, Lines, Problem};
use crate::num::least_squares::{self, LeastSquaresError, Options};
use crate::response::Fold;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Lines this near (relative) are the same.
const SAME_LINE: f64 = 1e-9;

/// What a structure costs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Criteria {
    /// Free coefficients.
    pub unknowns: usize,
    /// Real equations.
    pub equations: usize,
    /// `Σ weight |G̃ − H|²` of the refined structure, in the weights that are compared.
    pub cost: f64,
    /// Akaike's criterion.
    pub aic: f64,
    /// The Bayesian criterion.
    pub bic: f64,
    /// Sum of the weighted squared errors of lines left out; null where a refinement without a line did not converge or
    /// has fewer equations than coefficients.
    pub cross_validation: Option<f64>,
    /// Mean over the trials (or segments) left out of `Σ weight |G̃ − H|²` at theirs; null where there are none to
    /// leave out, or where a refinement without one failed.
    #[serde(default)]
    pub cross_validation_over_repeats: Option<f64>,
    /// Whether the refinement converged with no constraint active: only then are the criteria what they are called.
    pub is_regular: bool,
}

impl Refinement<'_> {
    /// The criteria of this structure; the noise must be what the weights are the inverse of, and the folds have every
    /// line.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn criteria(&self, noise: Option<&Noise>, folds: &[Fold], ctl: &Ctl) -> Result<Criteria, Stopped> {
        let lines = self.lines().len();
        let equations: usize = (0..lines).map(|k| if self.is_real(k) { 1 } else { 2 }).sum();
        let unknowns = self.unknowns();
        let n = equations as f64;
        let (deviance, counted) = match noise {
            Some(noise) => {
                let deviance = (0..lines)
                    .map(|k| {
                        let r = &self.minimum.residuals;
                        let square = (r[k] * r[k] + r[k + lines] * r[k + lines]) / self.projection.weight[k];
                        (if self.is_real(k) { 1.0 } else { 2.0 }) * square / noise.variance[k]
                    })
                    .sum();
                (deviance, unknowns as f64)
            }
            None => (n * (self.minimum.cost / n).max(f64::MIN_POSITIVE).ln(), unknowns as f64 + 1.0),
        };
        Ok(Criteria {
            unknowns,
            equations,
            cost: self.minimum.cost,
            aic: deviance + 2.0 * counted,
            bic: deviance + counted * n.ln(),
            cross_validation: self.left_out(ctl)?,
            cross_validation_over_repeats: self.repeats_left_out(folds, ctl)?,
            is_regular: self.minimum.stop.is_converged() && self.minimum.active.is_empty(),
        })
    }

    /// Coefficients, the feedforward numerator's included.
    fn unknowns(&self) -> usize {
        self.projection.numerator_size() + self.projection.unknowns.len()
    }

    fn repeats_left_out(&self, folds: &[Fold], ctl: &Ctl) -> Result<Option<f64>, Stopped> {
        if folds.is_empty() {
            return Ok(None);
        }
        let Ok(whole) = self.refined() else { return Ok(None) };
        let start = Start::of(&whole.feedforward, &whole.feedback);
        let mut sum = 0.0;
        for fold in folds {
            let at = |line: &Line| {
                let same = |w: &f64| (w - line.omega_rad_s).abs() <= SAME_LINE * line.omega_rad_s.abs();
                fold.omega_rad_s.iter().position(same)
            };
            let own = self.setup.problem.lines();
            let Some(positions) = own.iter().map(at).collect::<Option<Vec<usize>>>() else { return Ok(None) };
            let used = own.iter().zip(&positions).map(|(line, i)| Line { response: fold.rest[*i], ..*line }).collect();
            let lines = Lines { time: self.setup.problem.time(), used, dropped: Vec::new() };
            let Structure { held, feedforward_numerator, .. } = self.setup.structure;
            let Ok(problem) = Problem::holding(held, &lines, feedforward_numerator) else { return Ok(None) };
            let model = match Refinement::new(Setup { problem: &problem, ..self.setup }, &start, ctl) {
                Err(RefineError::Stopped(stopped)) => return Err(stopped),
                Err(_) => return Ok(None),
                Ok(refinement) => match refinement.refined() {
                    Ok(refined) => refined.model,
                    Err(_) => return Ok(None),
                },
            };
            let errors = own.iter().zip(&positions).zip(&model);
            sum += errors.map(|((line, i), g)| line.weight * (g - fold.part[*i]).norm_sqr()).sum::<f64>();
        }
        Ok(Some(sum / folds.len() as f64).filter(|mean| mean.is_finite()))
    }

    fn left_out(&self, ctl: &Ctl) -> Result<Option<f64>, Stopped> {
        let lines = self.lines().len();
        if 2 * (lines - 1) < self.unknowns() {
            return Ok(None);
        }
        let mut sum = 0.0;
        for k in 0..lines {
            let mut projection = self.projection.clone();
            // A weight so small that the line has no say, and yet one that its error can be read with.
            let faint = 1e-16 * projection.weight[k];
            let weight = std::mem::replace(&mut projection.weight[k], faint);
            let options = Options { max_evaluations: 200, ..Options::default() };
            match least_squares::minimise(&projection, &self.minimum.x, &options, ctl) {
                Err(LeastSquaresError::Stopped(stopped)) => return Err(stopped),
                Err(_) => return Ok(None),
                Ok(found) if !found.stop.is_converged() => return Ok(None),
                Ok(found) => {
                    let r = &found.residuals;
                    sum += (r[k] * r[k] + r[k + lines] * r[k + lines]) / faint * weight;
                }
            }
        }
        Ok(sum.is_finite().then_some(sum))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Continuous, System, TransferFunction};
    use crate::num::rng;
    use num_complex::Complex64;
    use rand_distr::{Distribution, StandardNormal};

    fn tf(num: &[f64], den: &[f64]) -> System {
        System::Continuous(TransferFunction::new(num, den, Continuous).unwrap())
    }

    /// Data of a feedforward of degrees 1/1 and a feedback of 0/1: a poorer structure costs more, a richer one is
    /// charged for what it adds.
    #[test]
    fn the_structure_that_made_the_data_is_mostly_chosen() {
        let (plant, ff, fb) = (tf(&[4.0], &[1.0, 2.0]), tf(&[1.2, 2.0], &[1.0, 3.5]), tf(&[6.4], &[1.0, 3.1]));
        let omega: Vec<f64> = (1..=24).map(|k| 0.35 * f64::from(k)).collect();
        let structures = [(0, 1), (1, 1), (2, 1)];
        let mut chosen = [[0_usize; 3]; 4];
        for seed in 0..60 {
            let mut random = rng::stream(seed, "orders");
            let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
            let variance: Vec<f64> = omega.iter().map(|w| (0.01 + 0.003 * w).powi(2)).collect();
            // Four trials, each with four times the variance of their mean.
            let trials: Vec<Vec<Complex64>> = (0..4)
                .map(|_| {
                    omega
                        .iter()
                        .zip(&variance)
                        .map(|(w, v)| {
                            let (g, ff, fb) = (plant.response(*w), ff.response(*w), fb.response(*w));
                            g * (ff + fb) / (1.0 + g * fb) + (2.0 * v).sqrt() * Complex64::new(normal(), normal())
                        })
                        .collect()
                })
                .collect();
            let mean = |out: Option<usize>| -> Vec<Complex64> {
                let kept: Vec<&Vec<Complex64>> = (0..4).filter(|i| Some(*i) != out).map(|i| &trials[i]).collect();
                (0..omega.len()).map(|k| kept.iter().map(|h| h[k]).sum::<Complex64>() / kept.len() as f64).collect()
            };
            let h = mean(None);
            let fold = |i: usize| Fold { omega_rad_s: omega.clone(), rest: mean(Some(i)), part: trials[i].clone() };
            let folds: Vec<Fold> = (0..4).map(fold).collect();
            let weights: Vec<f64> = variance.iter().map(|v| 1e-4 / v).collect();
            let noise = Noise { variance, degrees_of_freedom: f64::INFINITY, are_independent: true };
            let criteria: Vec<Criteria> = structures
                .iter()
                .map(|(numerator, denominator)| {
                    let structure = Structure {
                        feedforward_numerator: *numerator,
                        feedforward_denominator_is_free: true,
                        feedforward_denominator: *denominator,
                        feedback_numerator: 0,
                        feedback_denominator: 1,
                        held: None,
                    };
                    let problem = Problem::new(&Lines::new(&plant, &omega, &h, Some(&weights)), *numerator).unwrap();
                    let setup = Setup { problem: &problem, plant: &plant, structure, margin_per_s: 0.0 };
                    let refinement = Refinement::new(setup, &Start::of(&ff, &fb), &Ctl::new()).unwrap();
                    refinement.criteria(Some(&noise), &folds, &Ctl::new()).unwrap()
                })
                .collect();
            let least = |of: fn(&Criteria) -> f64| {
                (0..3).min_by(|a, b| of(&criteria[*a]).total_cmp(&of(&criteria[*b]))).unwrap()
            };
            chosen[0][least(|c| c.aic)] += 1;
            chosen[1][least(|c| c.bic)] += 1;
            chosen[2][least(|c| c.cross_validation.unwrap_or(f64::INFINITY))] += 1;
            chosen[3][least(|c| c.cross_validation_over_repeats.unwrap_or(f64::INFINITY))] += 1;
            assert!(criteria[2].cost <= criteria[1].cost * (1.0 + 1e-6) && criteria[1].cost < criteria[0].cost);
            // Where the model is right, −2 ln L without its constant is chi-square with N − p degrees.
            let deviance = criteria[1].aic - 2.0 * 5.0;
            assert!((20.0..85.0).contains(&deviance), "{deviance}");
        }
        assert!(chosen.iter().all(|counts| counts[0] == 0), "{chosen:?}");
        assert!(chosen[0][1] > 35 && chosen[1][1] > 50 && chosen[2][1] > 30 && chosen[3][1] > 30, "{chosen:?}");
    }
}
