//! Responses without structure, shrunk towards a parametric law: kernel-regularised deviations.
//!
//! With the parametric prediction `U₀` of the control, the control of trial i at line k is
//!
//! `U_ik − U₀_ik = δ_r(ω_k, g, i) H⁰_ur R_ik + δ_d(ω_k, g, i) H⁰_ud D_ik + N_ik`,
//!
//! where the relative deviations δ are circular Gaussian processes over `ln ω` (Pillonetto et al. 2014, section 4, in
//! the frequency domain): one shared by all trials, one for each group g of trials (the types of a protocol), and one
//! for each trial, all with the kernel `exp(−½ (Δ ln ω/ℓ)²)`. The posterior mean of the first two predicts a new trial.
//! Their sizes and ℓ are those of a grid with the smallest leave-one-trial-out error *within the trials given*. As ℓ
//! and the sizes grow this is the estimate without structure, group by group; as the sizes vanish it is the parametric
//! law.
//!
//! What is known of both deviations at a frequency is Gaussian too, given the law and the sizes: a mean and a 2×2
//! covariance, those of `H_ur` and `H_ud` of a group, or of all trials (without the part of any group). The controllers
//! follow, `Gfb = −H_ud/(G (1 + H_ud))`, `Gff = H_ur/(1 + H_ud) − Gfb`, with variances to first order. They are
//! analytic in the responses, so that a circular error stays circular.

use super::fit::{Band, Fitted};
use super::responses::{UD, UR};
use crate::ctl::{Ctl, Stopped};
use crate::response::stimuli::StimulusLines;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use rayon::prelude::*;

/// Excited lines of all trials at most: the work grows with the third power.
pub const MOST_SAMPLES: usize = 1000;

/// Lines nearer than this in ln ω are the same.
const SAME_LINE: f64 = 1e-9;

/// Sizes of the deviations, relative to the parametric responses, and the reach of their kernel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sizes {
    /// Reach ℓ in `ln ω`.
    pub reach: f64,
    /// Standard deviation shared by all trials.
    pub shared: f64,
    /// Of each group.
    pub group: f64,
    /// Of each trial.
    pub trial: f64,
}

/// The grid that [`Regularised::new`] chooses from.
#[must_use]
pub fn default_sizes() -> Vec<Sizes> {
    let mut grid = Vec::new();
    for reach in [0.2, 0.4, 0.8] {
        for shared in [0.1, 0.2, 0.4] {
            for group in [0.05, 0.1, 0.2, 0.4] {
                for trial in [0.1, 0.2] {
                    grid.push(Sizes { reach, shared, group, trial });
                }
            }
        }
    }
    grid
}

/// One line of one trial.
#[derive(Debug, Clone, Copy)]
struct Sample {
    trial: usize,
    /// Position of the line.
    line: usize,
    group: usize,
    log_omega: f64,
    /// `H⁰_ur R` and `H⁰_ud D`.
    drive: [Complex64; 2],
    misfit: Complex64,
    /// Variance of the noise of the mean over segments.
    noise: f64,
    /// Of that of one segment.
    segment_noise: f64,
    /// What a squared error counts in leave-one-trial-out: `1/P_u + |G|²/P_y`.
    weight: f64,
}

/// Why there is no such estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RegularisedError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// A line has no dark neighbours that tell its noise.
    #[error("the noise beside line {line} of trial {trial} is not known, and a regularised estimate needs it")]
    NoNoise {
        /// Position of the line.
        line: usize,
        /// The trial.
        trial: usize,
    },
    /// Too many trials and lines for a dense kernel matrix.
    #[error("{samples} lines of trials are too many for a kernel matrix, which takes {MOST_SAMPLES}")]
    TooMany {
        /// Excited lines of all trials.
        samples: usize,
    },
    /// No sizes of the grid gave a solvable system.
    #[error("the kernel matrix is singular")]
    Singular,
}

/// Deviations learned from trials.
#[derive(Debug, Clone)]
pub struct Regularised {
    fitted: Fitted,
    sizes: Sizes,
    samples: Vec<Sample>,
    /// `(K + noise)⁻¹ misfit`.
    weights: Vec<Complex64>,
    /// `(K + noise)⁻¹`.
    inverse: DMatrix<Complex64>,
    /// Errors of the samples predicted from the other trials.
    left_out: Vec<Complex64>,
}

/// Responses of the control and both controllers at a frequency, with what is not known of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Posterior {
    /// H_ur and H_ud.
    pub responses: [Complex64; 2],
    /// Their variances, `E|δ|²`.
    pub response_variances: [f64; 2],
    /// Gfb and Gff.
    pub controllers: [Band; 2],
}

/// The control of a trial as it is predicted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Predicted {
    /// The value.
    pub value: Complex64,
    /// Variance of the response of a new trial of the group about it, `E|δ|²`, without the noise of the line.
    pub variance: f64,
    /// Variance of the noise of the line in a segment, as in trials of the group that excite it; `None` where none
    /// does.
    pub noise: Option<f64>,
}

impl Sizes {
    fn covariance(&self, a: &Sample, b: &Sample, with_trials: bool) -> Complex64 {
        let distance = (a.log_omega - b.log_omega) / self.reach;
        let mut size = self.shared.powi(2);
        // What is asked of all trials is of no group.
        if a.group == b.group && a.group != usize::MAX {
            size += self.group.powi(2);
        }
        if with_trials && a.trial == b.trial {
            size += self.trial.powi(2);
        }
        let drives = a.drive[0] * b.drive[0].conj() + a.drive[1] * b.drive[1].conj();
        drives * (size * (-0.5 * distance * distance).exp())
    }
}

impl Regularised {
    /// Learns deviations from a fitted law; `groups` has the group of each trial, `sizes` the grid.
    ///
    /// # Errors
    /// [`RegularisedError`].
    ///
    /// # Panics
    /// If there is not a group for every trial, which is a mistake of the caller.
    pub fn new(
        lines: &StimulusLines,
        groups: &[usize],
        fitted: &Fitted,
        sizes: &[Sizes],
        ctl: &Ctl,
    ) -> Result<Self, RegularisedError> {
        assert_eq!(groups.len(), lines.trials, "a group for every trial");
        let samples = samples(lines, groups, fitted)?;
        if samples.len() > MOST_SAMPLES {
            return Err(RegularisedError::TooMany { samples: samples.len() });
        }
        let solve = |sizes: &Sizes| {
            let n = samples.len();
            let matrix = DMatrix::from_fn(n, n, |i, j| {
                let own = if i == j { samples[i].noise } else { 0.0 };
                sizes.covariance(&samples[i], &samples[j], true) + own
            });
            let inverse = matrix.cholesky()?.inverse();
            let misfit = DVector::from_iterator(n, samples.iter().map(|s| s.misfit));
            let weights = &inverse * misfit;
            let errors = left_out(&samples, &inverse, &weights)?;
            let cost: f64 = errors.iter().zip(&samples).map(|(e, sample)| sample.weight * e.norm_sqr()).sum();
            Some((cost, weights, errors, inverse))
        };
        let best = sizes
            .par_iter()
            .map(|sizes| {
                ctl.check()?;
                // One inverse at a time is kept, not one for each of the grid.
                Ok(solve(sizes).map(|(cost, ..)| (cost, *sizes)))
            })
            .collect::<Result<Vec<_>, Stopped>>()?
            .into_iter()
            .flatten()
            .filter(|(cost, ..)| cost.is_finite())
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let (_, sizes) = best.ok_or(RegularisedError::Singular)?;
        ctl.check()?;
        let (_, weights, left_out, inverse) = solve(&sizes).ok_or(RegularisedError::Singular)?;
        let (fitted, weights) = (fitted.clone(), weights.as_slice().to_vec());
        Ok(Self { fitted, sizes, samples, weights, inverse, left_out })
    }

    /// The sizes chosen.
    #[must_use]
    pub fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// By how much the control of a trial at a line, a mean of its segments, differs from what the other trials predict
    /// of it. The sizes were chosen by these errors, so they flatter a little.
    #[must_use]
    pub fn left_out_error(&self, trial: usize, line: usize) -> Option<Complex64> {
        self.samples.iter().position(|s| s.trial == trial && s.line == line).map(|i| self.left_out[i])
    }

    /// The control that is predicted of a trial of a group at a line, from its command and disturbance there.
    #[must_use]
    pub fn control(&self, omega_rad_s: f64, group: usize, command: Complex64, disturbance: Complex64) -> Complex64 {
        let h = self.fitted.closed_loop(omega_rad_s);
        let drive = [h[UR] * command, h[UD] * disturbance];
        let own = query(omega_rad_s, Some(group), drive);
        drive[0] + drive[1] + self.mean(&self.covariances(&own))
    }

    /// [`Regularised::control`] with how far a new trial of the group may be from it.
    #[must_use]
    pub fn predicted(&self, omega_rad_s: f64, group: usize, command: Complex64, disturbance: Complex64) -> Predicted {
        let h = self.fitted.closed_loop(omega_rad_s);
        let drive = [h[UR] * command, h[UD] * disturbance];
        let own = query(omega_rad_s, Some(group), drive);
        let known = self.covariances(&own);
        let own_trial = self.sizes.trial.powi(2) * (drive[0].norm_sqr() + drive[1].norm_sqr());
        let prior = self.sizes.covariance(&own, &own, false).re;
        let log_omega = omega_rad_s.ln();
        let like = self.samples.iter().find(|s| s.group == group && (s.log_omega - log_omega).abs() < SAME_LINE);
        Predicted {
            value: drive[0] + drive[1] + self.mean(&known),
            variance: (prior - self.explained(&known, &known).re).max(0.0) + own_trial,
            noise: like.map(|sample| sample.segment_noise),
        }
    }

    /// The responses and both controllers at a frequency, of a group of trials, or of all with `None`: the part of the
    /// groups is then an unknown that has no mean.
    #[must_use]
    pub fn posterior(&self, omega_rad_s: f64, group: Option<usize>) -> Posterior {
        let h = self.fitted.closed_loop(omega_rad_s);
        let zero = Complex64::default();
        let queries = [[h[UR], zero], [zero, h[UD]]].map(|drive| query(omega_rad_s, group, drive));
        let known = [self.covariances(&queries[0]), self.covariances(&queries[1])];
        let responses = [h[UR] + self.mean(&known[0]), h[UD] + self.mean(&known[1])];
        let covariance = |a: usize, b: usize| {
            self.sizes.covariance(&queries[a], &queries[b], false) - self.explained(&known[a], &known[b])
        };
        let variances = [covariance(0, 0).re.max(0.0), covariance(1, 1).re.max(0.0)];
        let cross = covariance(0, 1);
        let g = self.fitted.person.plant().response(omega_rad_s);
        let sensitivity = 1.0 + responses[1];
        let feedback = -responses[1] / (g * sensitivity);
        let feedforward = responses[0] / sensitivity - feedback;
        // Derivatives by H_ur and H_ud.
        let of_feedback = [zero, -1.0 / (g * sensitivity * sensitivity)];
        let of_feedforward = [1.0 / sensitivity, -responses[0] / (sensitivity * sensitivity) - of_feedback[1]];
        let band = |value: Complex64, slope: [Complex64; 2]| {
            let variance = slope[0].norm_sqr() * variances[0]
                + slope[1].norm_sqr() * variances[1]
                + 2.0 * (slope[0] * slope[1].conj() * cross).re;
            let deviation = (0.5 * variance.max(0.0)).sqrt() / value.norm();
            Band { value, deviation: deviation.is_finite().then_some([deviation; 2]) }
        };
        Posterior {
            responses,
            response_variances: variances,
            controllers: [band(feedback, of_feedback), band(feedforward, of_feedforward)],
        }
    }

    fn covariances(&self, own: &Sample) -> Vec<Complex64> {
        self.samples.iter().map(|s| self.sizes.covariance(own, s, false)).collect()
    }

    fn mean(&self, known: &[Complex64]) -> Complex64 {
        known.iter().zip(&self.weights).map(|(c, w)| c * w).sum()
    }

    /// `a (K + noise)⁻¹ b*`: how much the samples tell of two unknowns with these covariances.
    fn explained(&self, a: &[Complex64], b: &[Complex64]) -> Complex64 {
        let mut sum = Complex64::default();
        for (j, b) in b.iter().enumerate() {
            let column: Complex64 = self.inverse.column(j).iter().zip(a).map(|(m, a)| a * m).sum();
            sum += column * b.conj();
        }
        sum
    }
}

/// An unknown with this drive, of a group or of all.
fn query(omega_rad_s: f64, group: Option<usize>, drive: [Complex64; 2]) -> Sample {
    Sample {
        trial: usize::MAX,
        line: 0,
        group: group.unwrap_or(usize::MAX),
        log_omega: omega_rad_s.ln(),
        drive,
        misfit: Complex64::default(),
        noise: 0.0,
        segment_noise: 0.0,
        weight: 0.0,
    }
}

/// The mean of the segments of every trial at every line that is excited.
fn samples(lines: &StimulusLines, groups: &[usize], fitted: &Fitted) -> Result<Vec<Sample>, RegularisedError> {
    let mut samples = Vec::new();
    for (trial, group) in groups.iter().enumerate() {
        let own: Vec<_> = lines.segments.iter().filter(|s| s.trial == trial).collect();
        let power = |pick: &dyn Fn(&crate::response::stimuli::SegmentLines) -> f64| -> f64 {
            own.iter().map(|s| pick(s)).sum::<f64>() / own.len() as f64
        };
        let total_u = power(&|s| s.control.iter().map(Complex64::norm_sqr).sum());
        let total_y = power(&|s| s.output.iter().map(Complex64::norm_sqr).sum());
        for (k, omega) in lines.omega_rad_s.iter().enumerate() {
            let count = own.len() as f64;
            let mean = |pick: &dyn Fn(&crate::response::stimuli::SegmentLines) -> Complex64| -> Complex64 {
                own.iter().map(|s| pick(s)).sum::<Complex64>() / count
            };
            let (r, d, u) = (mean(&|s| s.command[k]), mean(&|s| s.disturbance[k]), mean(&|s| s.control[k]));
            if r.norm_sqr() + d.norm_sqr() == 0.0 {
                continue;
            }
            let h = fitted.closed_loop(*omega);
            let drive = [h[UR] * r, h[UD] * d];
            let mut noise = 0.0;
            for s in &own {
                noise += s.noise[k].ok_or(RegularisedError::NoNoise { line: k, trial })?.control / (count * count);
            }
            let g = fitted.person.plant().response(*omega).norm_sqr();
            samples.push(Sample {
                trial,
                line: k,
                group: *group,
                log_omega: omega.ln(),
                drive,
                misfit: u - drive[0] - drive[1],
                noise,
                segment_noise: noise * count,
                weight: 1.0 / total_u + g / total_y,
            });
        }
    }
    smooth_noise(&mut samples);
    Ok(samples)
}

/// Noise of a line: the mean over the trials of a group, since that of one trial rests on few lines.
fn smooth_noise(samples: &mut [Sample]) {
    let before = samples.to_vec();
    for sample in samples {
        let mean = |of: fn(&Sample) -> f64| {
            let alike = before.iter().filter(|s| s.group == sample.group && s.log_omega == sample.log_omega);
            let values: Vec<f64> = alike.map(of).collect();
            values.iter().sum::<f64>() / values.len() as f64
        };
        (sample.noise, sample.segment_noise) = (mean(|s| s.noise), mean(|s| s.segment_noise));
    }
}

/// The error of every trial predicted from the others.
fn left_out(samples: &[Sample], inverse: &DMatrix<Complex64>, weights: &DVector<Complex64>) -> Option<Vec<Complex64>> {
    let mut errors = Vec::with_capacity(samples.len());
    let mut start = 0;
    while start < samples.len() {
        let end = start + samples[start..].iter().take_while(|s| s.trial == samples[start].trial).count();
        let n = end - start;
        let block = inverse.view((start, start), (n, n)).into_owned();
        errors.extend(block.cholesky()?.solve(&weights.rows(start, n).into_owned()).iter());
        start = end;
    }
    Some(errors)
}
