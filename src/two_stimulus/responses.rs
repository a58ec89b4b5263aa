//! The loop's responses to command and disturbance, line by line, by least squares over trials.
//!
//! At every line `U = H_ur R + H_ud D + N_u` and `Y = H_yr R + H_yd D + N_y`. With the rows `x = (R, D)` of the
//! observations,
//!
//! `Ĥ = (Σ x̄ xᵀ)⁻¹ Σ x̄ (U, Y)`, `E δĤ_qj δĤ̄_q'j' = [(Σ x̄ xᵀ)⁻¹]_qq' Σ_jj'`,
//!
//! where Σ is the 2×2 covariance of the noise of (U, Y), assumed circular and the same in every observation. Trials
//! with one stimulus, with both on interleaved lines, and with both on the same line in changing proportion all enter
//! the same sums.
//!
//! Σ comes from the first of these that has two degrees of freedom or more:
//! 1. the residuals of whole trials (periods of a trial with equal stimuli averaged first), which hold the changes from
//!    trial to trial too,
//! 2. the residuals of segments,
//! 3. the power on nearby lines without a stimulus.

use crate::response::stimuli::StimulusLines;
use nalgebra::Matrix4;
use num_complex::Complex64;

/// Of command and disturbance on a line, at least this share of one must be independent of the other.
const INDEPENDENT: f64 = 1e-3;

/// Degrees of freedom that a covariance of residuals needs.
const FEWEST_FREEDOMS: f64 = 2.0;

/// Segments of a trial repeat each other if their stimuli differ by less than this share.
const REPEATS: f64 = 1e-3;

/// Where the covariance of the noise comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NoiseSource {
    /// Residuals of whole trials.
    Trials,
    /// Residuals of segments.
    Segments,
    /// Nearby lines without a stimulus.
    NearbyLines,
    /// It came with the data.
    Given,
}

/// Position of H_ur, H_yr, H_ud and H_yd in a [`LineResponse`].
pub const UR: usize = 0;
/// See [`UR`].
pub const YR: usize = 1;
/// See [`UR`].
pub const UD: usize = 2;
/// See [`UR`].
pub const YD: usize = 3;

/// The responses at a line.
#[derive(Debug, Clone, PartialEq)]
pub struct LineResponse {
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// `[H_ur, H_yr]`, where the command excites the line.
    pub command: Option<[Complex64; 2]>,
    /// `[H_ud, H_yd]`, where the disturbance excites the line.
    pub disturbance: Option<[Complex64; 2]>,
    /// `E δ δ*` of (H_ur, H_yr, H_ud, H_yd); entries of a missing response are 0. `None` where the noise is not known.
    pub covariance: Option<Matrix4<Complex64>>,
    /// Noise variances of U and Y in one observation, diagonal of Σ; `None` where unknown or given otherwise.
    pub noise: Option<[f64; 2]>,
    /// Where it comes from.
    pub source: Option<NoiseSource>,
    /// Complex degrees of freedom behind it; infinite where it was given.
    pub freedoms: f64,
    /// Trials that excite the line with the command, with the disturbance.
    pub trials: [usize; 2],
    /// Command and disturbance share the line in one proportion, and cannot be told apart.
    pub confounded: bool,
}

struct Observation {
    trial: usize,
    weight: f64,
    x: [Complex64; 2],
    z: [Complex64; 2],
}

/// `Σ w x̄ xᵀ` and `Σ w x̄ z`.
struct Sums {
    gram: [[Complex64; 2]; 2],
    right: [[Complex64; 2]; 2],
}

fn sums(observations: &[Observation]) -> Sums {
    let mut sums = Sums { gram: Default::default(), right: Default::default() };
    for Observation { weight, x, z, .. } in observations {
        for q in 0..2 {
            for i in 0..2 {
                sums.gram[q][i] += *weight * x[q].conj() * x[i];
                sums.right[q][i] += *weight * x[q].conj() * z[i];
            }
        }
    }
    sums
}

/// The inverse of the Gram matrix with zeros for stimuli that are silent; `None` where they are confounded.
pub(super) fn inverse(gram: &[[Complex64; 2]; 2]) -> Option<[[Complex64; 2]; 2]> {
    let zero = Complex64::default();
    let (a, b) = (gram[0][0].re, gram[1][1].re);
    match (a > 0.0, b > 0.0) {
        (true, true) => {
            let determinant = a * b - gram[0][1].norm_sqr();
            (determinant > INDEPENDENT * a * b).then(|| {
                [
                    [Complex64::from(b / determinant), -gram[0][1] / determinant],
                    [-gram[1][0] / determinant, Complex64::from(a / determinant)],
                ]
            })
        }
        (true, false) => Some([[Complex64::from(1.0 / a), zero], [zero; 2]]),
        (false, true) => Some([[zero; 2], [zero, Complex64::from(1.0 / b)]]),
        (false, false) => Some([[zero; 2]; 2]),
    }
}

/// The observations of a line: whole trials where their segments repeat each other, segments otherwise.
fn observations(lines: &StimulusLines, k: usize) -> (Vec<Observation>, Vec<Observation>) {
    let mut segments: Vec<Observation> = Vec::new();
    for s in &lines.segments {
        let x = [s.command[k], s.disturbance[k]];
        if x.iter().any(|x| x.norm_sqr() > 0.0) {
            segments.push(Observation { trial: s.trial, weight: 1.0, x, z: [s.control[k], s.output[k]] });
        }
    }
    let mut trials: Vec<Observation> = Vec::new();
    for s in &segments {
        let repeats = |other: &Observation| {
            other.trial == s.trial
                && (0..2).all(|i| (other.x[i] - s.x[i]).norm() <= REPEATS * (other.x[i].norm() + s.x[i].norm()) * 0.5)
        };
        match trials.iter_mut().find(|other| repeats(other)) {
            Some(twin) => {
                let total = twin.weight + 1.0;
                for i in 0..2 {
                    twin.x[i] += (s.x[i] - twin.x[i]) / total;
                    twin.z[i] += (s.z[i] - twin.z[i]) / total;
                }
                twin.weight = total;
            }
            None => trials.push(Observation { trial: s.trial, weight: 1.0, x: s.x, z: s.z }),
        }
    }
    (segments, trials)
}

/// Weighted residual covariance of (U, Y) for observations of weight 1, with its degrees of freedom.
fn residual_covariance(
    observations: &[Observation],
    h: &[[Complex64; 2]; 2],
    unknowns: usize,
) -> Option<([[Complex64; 2]; 2], f64)> {
    let freedoms = observations.len() as f64 - unknowns as f64;
    if freedoms < FEWEST_FREEDOMS {
        return None;
    }
    let mut sigma = [[Complex64::default(); 2]; 2];
    for Observation { weight, x, z, .. } in observations {
        let e: [Complex64; 2] = std::array::from_fn(|j| z[j] - x[0] * h[0][j] - x[1] * h[1][j]);
        for (i, row) in sigma.iter_mut().enumerate() {
            for (j, entry) in row.iter_mut().enumerate() {
                *entry += weight * e[i] * e[j].conj() / freedoms;
            }
        }
    }
    Some((sigma, freedoms))
}

fn nearby(lines: &StimulusLines, k: usize) -> Option<([[Complex64; 2]; 2], f64)> {
    let noises: Vec<_> = lines
        .segments
        .iter()
        .filter(|s| s.command[k].norm_sqr() + s.disturbance[k].norm_sqr() > 0.0)
        .map(|s| s.noise[k])
        .collect::<Option<_>>()?;
    let count = noises.len() as f64;
    let mut sigma = [[Complex64::default(); 2]; 2];
    let mut freedoms = 0.0;
    for noise in &noises {
        sigma[0][0] += noise.control / count;
        sigma[1][1] += noise.output / count;
        sigma[0][1] += noise.cross / count;
        sigma[1][0] += noise.cross.conj() / count;
        freedoms += noise.lines as f64;
    }
    (freedoms > 0.0).then_some((sigma, freedoms))
}

/// The responses at every line that a stimulus excites.
#[must_use]
pub fn responses(lines: &StimulusLines) -> Vec<LineResponse> {
    (0..lines.omega_rad_s.len()).filter_map(|k| line(lines, k)).collect()
}

fn line(lines: &StimulusLines, k: usize) -> Option<LineResponse> {
    let (segments, trials) = observations(lines, k);
    if segments.is_empty() {
        return None;
    }
    // Averaging repeated segments first leaves the sums as they are.
    let Sums { gram, right } = sums(&segments);
    let excited = [gram[0][0].re > 0.0, gram[1][1].re > 0.0];
    let counted = |which: usize| {
        let mut with: Vec<usize> = segments.iter().filter(|s| s.x[which].norm_sqr() > 0.0).map(|s| s.trial).collect();
        with.dedup();
        with.len()
    };
    let mut response = LineResponse {
        frequency_hz: lines.frequency_hz[k],
        omega_rad_s: lines.omega_rad_s[k],
        command: None,
        disturbance: None,
        covariance: None,
        noise: None,
        source: None,
        freedoms: 0.0,
        trials: [counted(0), counted(1)],
        confounded: false,
    };
    let Some(inverse) = inverse(&gram) else {
        response.confounded = true;
        return Some(response);
    };
    let h: [[Complex64; 2]; 2] =
        std::array::from_fn(|q| std::array::from_fn(|j| inverse[q][0] * right[0][j] + inverse[q][1] * right[1][j]));
    response.command = excited[0].then_some(h[0]);
    response.disturbance = excited[1].then_some(h[1]);
    let unknowns = excited.iter().filter(|e| **e).count();
    let found = residual_covariance(&trials, &h, unknowns)
        .map(|found| (found, NoiseSource::Trials))
        .or_else(|| residual_covariance(&segments, &h, unknowns).map(|found| (found, NoiseSource::Segments)))
        .or_else(|| nearby(lines, k).map(|found| (found, NoiseSource::NearbyLines)));
    if let Some(((sigma, freedoms), source)) = found {
        response.covariance = Some(Matrix4::from_fn(|a, b| inverse[a / 2][b / 2] * sigma[a % 2][b % 2]));
        response.noise = Some([sigma[0][0].re, sigma[1][1].re]);
        response.source = Some(source);
        response.freedoms = freedoms;
    }
    Some(response)
}

impl LineResponse {
    /// From `H_yr` and `H_yd` on a plant G that is known exactly: `H_ur = H_yr/G`, `H_ud = H_yd/G − 1`.
    ///
    /// `variance` is `E|δ|²` of each; the two are taken as independent.
    #[must_use]
    pub fn from_output(
        omega_rad_s: f64,
        plant: Complex64,
        h_yr: Option<Complex64>,
        h_yd: Option<Complex64>,
        variance: Option<[f64; 2]>,
    ) -> Self {
        let covariance = variance.map(|variance| {
            Matrix4::from_fn(|a, b| {
                if a / 2 != b / 2 || (a / 2 == 0 && h_yr.is_none()) || (a / 2 == 1 && h_yd.is_none()) {
                    return Complex64::default();
                }
                // δ_u = δ_y/G.
                let factor = |i: usize| if i.is_multiple_of(2) { plant.inv() } else { Complex64::from(1.0) };
                factor(a) * factor(b).conj() * variance[a / 2]
            })
        });
        Self {
            frequency_hz: omega_rad_s / std::f64::consts::TAU,
            omega_rad_s,
            command: h_yr.map(|h| [h / plant, h]),
            disturbance: h_yd.map(|h| [h / plant - 1.0, h]),
            noise: None,
            source: covariance.is_some().then_some(NoiseSource::Given),
            covariance,
            freedoms: f64::INFINITY,
            trials: [usize::from(h_yr.is_some()), usize::from(h_yd.is_some())],
            confounded: false,
        }
    }

    /// `E|Σ cᵢ δᵢ|²` of a linear combination of the four errors.
    #[must_use]
    pub fn variance_of(&self, c: &[Complex64; 4]) -> Option<f64> {
        let covariance = self.covariance.as_ref()?;
        let mut sum = Complex64::default();
        for a in 0..4 {
            for b in 0..4 {
                sum += c[a] * c[b].conj() * covariance[(a, b)];
            }
        }
        Some(sum.re.max(0.0))
    }
}
