//! Multisines: sums of sinusoids on multiples of a base line.

use super::crest;
use super::error::SequenceError;
use super::sampled::{Period, Sequence, SequenceDetails, whole};
use crate::ctl::Ctl;
use crate::num::rng::stream;
use rand::RngExt;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Lines of a multisine at most.
const MAX_LINES: usize = 1_000;
/// The largest multiple of the base line.
const MAX_HARMONIC: u64 = 100_000;
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

/// A line: its multiple of the base, and its amplitude.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Line {
    pub harmonic: u64,
    pub amplitude: f64,
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
            Phases::Schroeder => crest::schroeder(&lines),
            Phases::CrestOptimised => crest::optimised(&lines, |start| self.random_phases(&lines, start), ctl)?,
            Phases::Rad(phases) => phases.clone(),
        };
        let seconds = self.base_hz.recip();
        let period = Period { seconds, samples: whole(seconds / sample_time_s) };
        let values = match period.samples {
            // On the grid of one period, by the fast transform.
            Some(n) => {
                let one = crest::on_grid(&lines, &phases, n);
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
        let continuous_crest_factor = Some(crest::crest_factor(&lines, &phases));
        let details =
            SequenceDetails { phases_rad: Some(phases), continuous_crest_factor, ..SequenceDetails::default() };
        let harmonics = Some(lines.iter().map(|line| line.harmonic as usize).collect());
        Ok(Sequence { sample_time_s, values, period: Some(period), harmonics, chip_s: None, details })
    }

    fn random_phases(&self, lines: &[Line], start: usize) -> Vec<f64> {
        let mut random = stream(self.seed, &format!("excite/multisine/{start}"));
        lines.iter().map(|_| 2.0 * PI * random.random::<f64>()).collect()
    }
}

/// Whether a number is prime, by trial division.
fn is_prime(n: u64) -> bool {
    n >= 2 && (2..).take_while(|q| q * q <= n).all(|q| !n.is_multiple_of(q))
}
