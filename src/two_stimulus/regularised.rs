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

use super::fit::Fitted;
use super::responses::{UD, UR};
use crate::ctl::{Ctl, Stopped};
use crate::response::stimuli::StimulusLines;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use rayon::prelude::*;

/// Excited lines of all trials at most: the work grows with the third power.
pub const MOST_SAMPLES: usize = 1000;

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
    /// Variance of the noise.
    noise: f64,
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
    /// Errors of the samples predicted from the other trials.
    left_out: Vec<Complex64>,
}

impl Sizes {
    fn covariance(&self, a: &Sample, b: &Sample, with_trials: bool) -> Complex64 {
        let distance = (a.log_omega - b.log_omega) / self.reach;
        let mut size = self.shared.powi(2);
        if a.group == b.group {
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
            Some((cost, weights, errors))
        };
        let best = sizes
            .par_iter()
            .map(|sizes| {
                ctl.check()?;
                Ok(solve(sizes).map(|(cost, weights, errors)| (cost, *sizes, weights, errors)))
            })
            .collect::<Result<Vec<_>, Stopped>>()?
            .into_iter()
            .flatten()
            .filter(|(cost, ..)| cost.is_finite())
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let (_, sizes, weights, left_out) = best.ok_or(RegularisedError::Singular)?;
        Ok(Self { fitted: fitted.clone(), sizes, samples, weights: weights.as_slice().to_vec(), left_out })
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
        let zero = Complex64::default();
        let log_omega = omega_rad_s.ln();
        let own = Sample { trial: usize::MAX, line: 0, group, log_omega, drive, misfit: zero, noise: 0.0, weight: 0.0 };
        let deviation: Complex64 =
            self.samples.iter().zip(&self.weights).map(|(s, w)| self.sizes.covariance(&own, s, false) * w).sum();
        drive[0] + drive[1] + deviation
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
        let alike: Vec<f64> = before
            .iter()
            .filter(|s| s.group == sample.group && s.log_omega == sample.log_omega)
            .map(|s| s.noise)
            .collect();
        sample.noise = alike.iter().sum::<f64>() / alike.len() as f64;
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
