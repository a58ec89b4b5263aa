//! Multisines: sums of sinusoids on multiples of a base line.

use super::error::SequenceError;
use super::sampled::{Period, Sequence, SequenceDetails, whole};
use crate::ctl::Ctl;
use crate::num::Complex64;
use crate::num::fourier;
use crate::num::least_squares::{LeastSquares, LeastSquaresError, Options, minimise};
use crate::num::rng::stream;
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Lines of a multisine at most.
const MAX_LINES: usize = 1_000;
/// The largest multiple of the base line.
const MAX_HARMONIC: u64 = 100_000;
/// Points per shortest wave on which a peak is looked for.
const OVERSAMPLING: usize = 16;
/// Random starts of the crest's optimisation, beside Schroeder's phases.
const STARTS: usize = 8;
/// Swaps between time and frequency from each start.
const SWAPS: usize = 150;
/// Lines up to which the best start is polished by Gauss-Newton steps on p-norms.
const POLISHED_LINES: usize = 64;
/// Halves of the exponents of those norms, in turn.
const EXPONENTS: [i32; 5] = [2, 4, 8, 16, 32];

/// Which multiples of the base line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "MultisineHarmonics")]
pub enum Harmonics {
    /// These, increasing.
    #[schemars(title = "ListedHarmonics")]
    List(Vec<u64>),
    /// The prime multiples within a band, so that few sums and multiples of lines fall on lines.
    #[schemars(title = "PrimeHarmonics")]
    Primes {
        /// The band in Hz, ends included.
        primes: [f64; 2],
    },
    /// The odd multiples within a band: even distortions of the system fall between them.
    #[schemars(title = "OddHarmonics")]
    Odd {
        /// The band in Hz, ends included.
        odd: [f64; 2],
    },
    /// All multiples within a band.
    #[schemars(title = "AllHarmonics")]
    All {
        /// The band in Hz, ends included.
        all: [f64; 2],
    },
}

/// A share of the lines, so that several stimuli can be told apart: every `of`-th of the chosen lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "MultisineInterleave")]
pub struct Interleave {
    /// Which stimulus, from 0.
    pub part: usize,
    /// How many stimuli share the lines.
    pub of: usize,
}

/// The phases of the lines.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "MultisinePhases")]
pub enum Phases {
    /// Uniform, from the seed.
    #[default]
    Random,
    /// Schroeder's, which sweep through the lines: `φ_k = −2π Σ_{j<k} (k − j) p_j` with the lines' shares p of the
    /// power.
    Schroeder,
    /// Those of the lowest crest factor that was found.
    CrestOptimised,
    /// These, in rad.
    #[schemars(title = "GivenPhases")]
    Rad(Vec<f64>),
}

/// How power is shared out among the lines.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "MultisinePower")]
pub enum PowerProfile {
    /// Alike.
    #[default]
    Flat,
    /// Full power up to a frequency and a part of it above ("reduced power"): the person answers as to a slow signal,
    /// and the fast lines can still be read.
    #[schemars(title = "ReducedPower")]
    Reduced(ReducedPower),
    /// Amplitude of each line in units of the multisine's `amplitude`.
    #[schemars(title = "GivenAmplitudes")]
    Amplitudes(Vec<f64>),
}

/// Full power up to a frequency and a part of it above.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "MultisineReducedPower")]
pub struct ReducedPower {
    /// The last frequency with full power, Hz.
    pub above_hz: f64,
    /// Power of the lines above, as a share of the others', dimensionless.
    pub power_ratio: f64,
}

/// A multisine as written in JSON: `x(t) = Σ a_k cos(2π n_k f₀ t + φ_k)`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Multisine {
    /// The base line f₀ in Hz; the period is 1/f₀.
    pub base_hz: f64,
    /// The multiples n_k: a list, or `{"primes": [from_hz, to_hz]}`, `{"odd": ..}`, `{"all": ..}`.
    pub harmonics: Harmonics,
    /// The share of them that this stimulus has. Default: all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interleave: Option<Interleave>,
    /// `random`, `schroeder`, `crest_optimised` or `{"rad": [..]}`. Default: random.
    #[serde(default)]
    pub phases: Phases,
    /// `flat`, `{"reduced": {"above_hz", "power_ratio"}}` or `{"amplitudes": [..]}`. Default: flat.
    #[serde(default)]
    pub power: PowerProfile,
    /// Amplitude of a line with full power, in the unit of the signal. Default: 1.
    #[serde(default = "one")]
    pub amplitude: f64,
    /// Seed of random phases, and of the starts of the crest's optimisation. Default: 1.
    #[serde(default = "first_seed")]
    pub seed: u64,
}

fn one() -> f64 {
    1.0
}

fn first_seed() -> u64 {
    1
}

/// A line: its multiple of the base, amplitude and phase.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Line {
    harmonic: u64,
    amplitude: f64,
}

impl Multisine {
    pub(super) fn check(&self, sample_time_s: f64) -> Result<(), SequenceError> {
        for (field, value) in [("generator/base_hz", self.base_hz), ("generator/amplitude", self.amplitude)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(SequenceError::NotPositive { field, value });
            }
        }
        if let Some(Interleave { part, of }) = self.interleave
            && part >= of
        {
            return Err(if of == 0 {
                SequenceError::NotPositive { field: "generator/interleave/of", value: 0.0 }
            } else {
                let (value, most) = (part as f64, of as f64 - 1.0);
                SequenceError::OutOfRange { field: "generator/interleave/part", value, least: 0.0, most }
            });
        }
        let lines = self.lines()?;
        let nyquist_hz = 0.5 / sample_time_s;
        let frequency_hz = lines.last().map_or(0.0, |line| line.harmonic as f64 * self.base_hz);
        if frequency_hz >= nyquist_hz * (1.0 - 1e-12) {
            return Err(SequenceError::AboveNyquist { field: "generator/harmonics", frequency_hz, nyquist_hz });
        }
        if let Phases::Rad(phases) = &self.phases {
            if phases.len() != lines.len() {
                let (found, expected) = (phases.len(), lines.len());
                return Err(SequenceError::Entries { field: "generator/phases/rad", found, expected });
            }
            if let Some(value) = phases.iter().find(|phase| !(-1e6..=1e6).contains(*phase)) {
                let field = "generator/phases/rad";
                return Err(SequenceError::OutOfRange { field, value: *value, least: -1e6, most: 1e6 });
            }
        }
        Ok(())
    }

    /// The lines with their amplitudes, increasing.
    fn lines(&self) -> Result<Vec<Line>, SequenceError> {
        const FIELD: &str = "generator/harmonics";
        let chosen: Vec<u64> = match &self.harmonics {
            Harmonics::List(list) => {
                if let Some(index) = list.windows(2).position(|pair| pair[0] >= pair[1]) {
                    return Err(SequenceError::NotIncreasing { field: FIELD, index: index + 1 });
                }
                if let Some(value) = list.iter().find(|n| !(1..=MAX_HARMONIC).contains(n)) {
                    let (value, most) = (*value as f64, MAX_HARMONIC as f64);
                    return Err(SequenceError::OutOfRange { field: FIELD, value, least: 1.0, most });
                }
                list.clone()
            }
            Harmonics::Primes { primes: band } => self.within(*band)?.filter(|n| is_prime(*n)).collect(),
            Harmonics::Odd { odd: band } => self.within(*band)?.filter(|n| n % 2 == 1).collect(),
            Harmonics::All { all: band } => self.within(*band)?.collect(),
        };
        let (part, of) = self.interleave.map_or((0, 1), |share| (share.part, share.of));
        let chosen: Vec<u64> = chosen.into_iter().skip(part).step_by(of).collect();
        if chosen.is_empty() {
            let why = format!("no chosen multiple of {} Hz is in it", self.base_hz);
            return Err(SequenceError::NoLines { field: FIELD, why });
        }
        if chosen.len() > MAX_LINES {
            let (value, most) = (chosen.len() as f64, MAX_LINES as f64);
            return Err(SequenceError::OutOfRange { field: FIELD, value, least: 1.0, most });
        }
        let amplitudes: Vec<f64> = match &self.power {
            PowerProfile::Flat => vec![1.0; chosen.len()],
            PowerProfile::Reduced(ReducedPower { above_hz, power_ratio }) => {
                if !(*power_ratio > 0.0 && *power_ratio <= 1.0) {
                    return Err(SequenceError::OutOfRange {
                        field: "generator/power/reduced/power_ratio",
                        value: *power_ratio,
                        least: 0.0,
                        most: 1.0,
                    });
                }
                let full = |n: &u64| *n as f64 * self.base_hz <= above_hz * (1.0 + 1e-12);
                if !chosen.iter().any(full) {
                    let why = format!("no line is at or below {above_hz} Hz, so that none has full power");
                    return Err(SequenceError::NoLines { field: "generator/power/reduced/above_hz", why });
                }
                chosen.iter().map(|n| if full(n) { 1.0 } else { power_ratio.sqrt() }).collect()
            }
            PowerProfile::Amplitudes(amplitudes) => {
                let field = "generator/power/amplitudes";
                if amplitudes.len() != chosen.len() {
                    let (found, expected) = (amplitudes.len(), chosen.len());
                    return Err(SequenceError::Entries { field, found, expected });
                }
                if let Some(value) = amplitudes.iter().find(|a| !(**a > 0.0 && a.is_finite())) {
                    return Err(SequenceError::NotPositive { field, value: *value });
                }
                amplitudes.clone()
            }
        };
        let scaled = |(harmonic, relative): (u64, f64)| Line { harmonic, amplitude: self.amplitude * relative };
        Ok(chosen.into_iter().zip(amplitudes).map(scaled).collect())
    }

    /// The multiples within a band.
    fn within(&self, [from, to]: [f64; 2]) -> Result<impl Iterator<Item = u64>, SequenceError> {
        const FIELD: &str = "generator/harmonics";
        if !(from >= 0.0 && to > from && to.is_finite()) {
            return Err(SequenceError::Empty { field: FIELD, from, to });
        }
        let most = (to / self.base_hz * (1.0 + 1e-12)).floor();
        if most > MAX_HARMONIC as f64 {
            return Err(SequenceError::OutOfRange { field: FIELD, value: most, least: 1.0, most: MAX_HARMONIC as f64 });
        }
        let least = (from / self.base_hz * (1.0 - 1e-12)).ceil().max(1.0);
        Ok(least as u64..=most as u64)
    }

    pub(super) fn sample(&self, sample_time_s: f64, samples: usize, ctl: &Ctl) -> Result<Sequence, SequenceError> {
        let lines = self.lines()?;
        let phases = match &self.phases {
            Phases::Random => self.random_phases(&lines, 0),
            Phases::Schroeder => schroeder(&lines),
            Phases::CrestOptimised => self.optimised(&lines, ctl)?,
            Phases::Rad(phases) => phases.clone(),
        };
        let seconds = self.base_hz.recip();
        let period = Period { seconds, samples: whole(seconds / sample_time_s) };
        let values = match period.samples {
            // On the grid of one period, by the fast transform.
            Some(n) => {
                let one = on_grid(&lines, &phases, n);
                (0..samples).map(|k| one[k % n]).collect()
            }
            None => {
                let mut values = vec![0.0; samples];
                for (line, phase) in lines.iter().zip(&phases) {
                    ctl.check()?;
                    let cycles = line.harmonic as f64 * self.base_hz * sample_time_s;
                    for (k, value) in values.iter_mut().enumerate() {
                        let turns = cycles * k as f64;
                        *value += line.amplitude * (2.0 * PI * (turns - turns.round()) + phase).cos();
                    }
                }
                values
            }
        };
        let crest_factor = Some(crest_factor(&lines, &phases));
        let details = SequenceDetails { phases_rad: Some(phases), crest_factor, ..SequenceDetails::default() };
        let harmonics = Some(lines.iter().map(|line| line.harmonic as usize).collect());
        Ok(Sequence { sample_time_s, values, period: Some(period), harmonics, chip_s: None, details })
    }

    fn random_phases(&self, lines: &[Line], start: usize) -> Vec<f64> {
        let mut random = stream(self.seed, &format!("excite/multisine/{start}"));
        lines.iter().map(|_| 2.0 * PI * random.random::<f64>()).collect()
    }

    /// The phases of the lowest crest factor found from Schroeder's and random starts: swaps between the clipped signal
    /// and its amplitudes (Van der Ouderaa, Schoukens and Renneboog 1988), and for few lines Gauss-Newton steps on
    /// p-norms of growing p after them (Guillaume, Schoukens, Pintelon and Kollár 1991).
    fn optimised(&self, lines: &[Line], ctl: &Ctl) -> Result<Vec<f64>, SequenceError> {
        let mut best: Option<(f64, Vec<f64>)> = None;
        for start in 0..=STARTS {
            let phases = if start == 0 { schroeder(lines) } else { self.random_phases(lines, start) };
            let phases = swapped(lines, phases, ctl)?;
            let crest = crest_factor(lines, &phases);
            if best.as_ref().is_none_or(|(least, _)| crest < *least) {
                best = Some((crest, phases));
            }
        }
        let (mut crest, mut phases) = best.unwrap_or_else(|| (f64::INFINITY, schroeder(lines)));
        if (2..=POLISHED_LINES).contains(&lines.len()) {
            let mut current = phases.clone();
            for exponent in EXPONENTS {
                let problem = Norm::new(lines, exponent);
                let options = Options { max_evaluations: 60, ..Options::default() };
                match minimise(&problem, &current, &options, ctl) {
                    Ok(found) => current = found.x,
                    Err(LeastSquaresError::Stopped(stopped)) => return Err(stopped.into()),
                    Err(_) => break,
                }
                let reached = crest_factor(lines, &current);
                if reached < crest {
                    crest = reached;
                    phases.clone_from(&current);
                }
            }
        }
        Ok(phases)
    }
}

/// Whether a number is prime, by trial division.
fn is_prime(n: u64) -> bool {
    n >= 2 && (2..).take_while(|q| q * q <= n).all(|q| !n.is_multiple_of(q))
}

fn schroeder(lines: &[Line]) -> Vec<f64> {
    let total: f64 = lines.iter().map(|line| line.amplitude.powi(2)).sum();
    let (mut turns, mut share) = (0.0, 0.0);
    lines
        .iter()
        .map(|line| {
            // Σ_{j<k} (k − j) p_j grows by Σ_{j<k} p_j from line to line.
            turns += share;
            share += line.amplitude.powi(2) / total;
            -2.0 * PI * turns
        })
        .collect()
}

/// One period on `n` points.
fn on_grid(lines: &[Line], phases: &[f64], n: usize) -> Vec<f64> {
    let mut spectrum = vec![Complex64::new(0.0, 0.0); n / 2 + 1];
    for (line, phase) in lines.iter().zip(phases) {
        spectrum[line.harmonic as usize] += Complex64::from_polar(0.5 * n as f64 * line.amplitude, *phase);
    }
    fourier::inverse_real(&spectrum, n)
}

/// Points that resolve the peaks between samples.
fn fine_grid(lines: &[Line]) -> usize {
    let highest = lines.last().map_or(1, |line| line.harmonic as usize);
    (OVERSAMPLING * highest).next_power_of_two()
}

/// Peak over rms of the continuous signal, the peak on a fine grid.
fn crest_factor(lines: &[Line], phases: &[f64]) -> f64 {
    let values = on_grid(lines, phases, fine_grid(lines));
    let peak = values.iter().fold(0.0_f64, |peak, x| peak.max(x.abs()));
    let power: f64 = lines.iter().map(|line| 0.5 * line.amplitude.powi(2)).sum();
    peak / power.sqrt()
}

/// Phases after swaps: the signal is clipped near its peak, and its lines are given their amplitudes back.
fn swapped(lines: &[Line], start: Vec<f64>, ctl: &Ctl) -> Result<Vec<f64>, SequenceError> {
    let n = fine_grid(lines).min(1 << 18).max(4 * (lines.last().map_or(1, |line| line.harmonic as usize) + 1));
    let mut phases = start.clone();
    let mut best = (f64::INFINITY, start);
    for swap in 0..SWAPS {
        ctl.check()?;
        let mut values = on_grid(lines, &phases, n);
        let peak = values.iter().fold(0.0_f64, |peak, x| peak.max(x.abs()));
        if peak < best.0 {
            best = (peak, phases.clone());
        }
        // Clip hard at first and hardly at the end.
        let level = peak * (0.8 + 0.19 * swap as f64 / SWAPS as f64);
        for x in &mut values {
            *x = x.clamp(-level, level);
        }
        let spectrum = fourier::real_transform(&values);
        for (phase, line) in phases.iter_mut().zip(lines) {
            let value = spectrum[line.harmonic as usize];
            if value.norm() > 0.0 {
                *phase = value.arg();
            }
        }
    }
    Ok(best.1)
}

/// `Σ (x_i/σ)^{2p}` as a sum of squares of `(x_i/σ)^p`.
struct Norm {
    lines: Vec<Line>,
    points: usize,
    exponent: i32,
    scale: f64,
}

impl Norm {
    fn new(lines: &[Line], exponent: i32) -> Self {
        let power: f64 = lines.iter().map(|line| 0.5 * line.amplitude.powi(2)).sum();
        let highest = lines.last().map_or(1, |line| line.harmonic as usize);
        // Few points per wave suffice for a norm; sparse lines of high multiples need no more than this many.
        let points = (6 * highest).clamp(16 * lines.len(), 4096);
        Self { lines: lines.to_vec(), points, exponent, scale: power.sqrt() }
    }
}

impl LeastSquares for Norm {
    fn unknowns(&self) -> usize {
        self.lines.len()
    }

    fn equations(&self) -> usize {
        self.points
    }

    fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool {
        let mut values = vec![0.0; self.points];
        let mut slopes = jacobian.is_some().then(|| DMatrix::zeros(self.points, self.lines.len()));
        for (j, (line, phase)) in self.lines.iter().zip(x).enumerate() {
            for (i, value) in values.iter_mut().enumerate() {
                // The whole turns in exact arithmetic.
                let part = (line.harmonic * i as u64 % self.points as u64) as f64 / self.points as f64;
                let (sin, cos) = (2.0 * PI * part + phase).sin_cos();
                *value += line.amplitude / self.scale * cos;
                if let Some(slopes) = &mut slopes {
                    slopes[(i, j)] = -line.amplitude / self.scale * sin;
                }
            }
        }
        for (i, value) in values.iter().enumerate() {
            residuals[i] = value.powi(self.exponent);
        }
        if let (Some(jacobian), Some(slopes)) = (jacobian, slopes) {
            for (i, value) in values.iter().enumerate() {
                let outer = f64::from(self.exponent) * value.powi(self.exponent - 1);
                for j in 0..self.lines.len() {
                    jacobian[(i, j)] = outer * slopes[(i, j)];
                }
            }
        }
        residuals.iter().all(|r| r.is_finite())
    }
}
