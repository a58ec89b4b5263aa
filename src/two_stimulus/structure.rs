//! Parametric structures of the person, as functions of frequency.
//!
//! Feedback on the error and feedforward on the command, each with a delay of its own, both behind the same muscles
//! where there are any:
//!
//! - lead-lag (McRuer & Jex 1967): `Gfb = K (T_L s + 1)/(T_I s + 1) · e^{−τ s}`,
//! - inverse dynamics: `Gff = K_ff G⁻¹ · e^{−τ_ff s}/(T_ff s + 1)`,
//! - rational: `N(s)/D(s) · e^{−τ s}` of given degrees, D with all its roots in the left half plane,
//! - neuromuscular lag: `1/(T_n s + 1)`,
//! - neuromuscular system of second order: `ω_n²/(s² + 2 ζ ω_n s + ω_n²)`, an arm on a stick with its reflexes (McRuer
//!   & Jex 1967; van der El et al., IEEE Trans. Cybern. 46, 1496–1508, 2016).
//!
//! Controllers are continuous whatever the plant is; a sampled plant meets them at `s = jω`, `z = e^{jωT}`.

use super::stability::is_loop_stable;
use crate::control::System;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Degrees of a rational controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RationalLaw {
    /// Degree of the numerator.
    pub numerator_degree: usize,
    /// Degree of the denominator.
    pub denominator_degree: usize,
    /// Whether it has a pure delay.
    #[serde(default)]
    pub delay: bool,
}

/// The law of the feedback.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FeedbackLaw {
    /// Gain, lead, lag and delay.
    LeadLag,
    /// A rational function, with a delay or without.
    Rational(RationalLaw),
}

/// The law of the feedforward.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FeedforwardLaw {
    /// There is none.
    None,
    /// The plant's inverse with gain, lag and delay.
    InverseDynamics,
    /// A rational function, with a delay or without.
    Rational(RationalLaw),
}

/// A structure of the person.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Structure {
    /// Law of the feedback.
    pub feedback: FeedbackLaw,
    /// Law of the feedforward.
    pub feedforward: FeedforwardLaw,
    /// Whether a neuromuscular lag follows both.
    #[serde(default)]
    pub neuromuscular_lag: bool,
    /// Whether a neuromuscular system of second order follows both, in place of the lag.
    #[serde(default)]
    pub neuromuscular_second_order: bool,
}

/// What follows both controllers of McRuer's ladder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Muscles {
    /// Nothing.
    None,
    /// A lag.
    Lag,
    /// A system of second order.
    SecondOrder,
}

/// A parameter: its name, its unit, the range it is sought in, and whether by its logarithm.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Name, such as `feedback_delay_s`.
    pub name: String,
    /// The range, infinite where there is none.
    pub range: [f64; 2],
    /// Sought by its logarithm: a positive parameter of unknown order of magnitude.
    pub logarithmic: bool,
}

/// Highest degree of a rational law.
pub const LARGEST_DEGREE: usize = 8;

/// A structure that cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum StructureError {
    /// The loop gain would not fall off with frequency.
    #[error(
        "the loop of plant and feedback is not strictly proper (relative degree {0}), so its stability with a delay \
         cannot be kept"
    )]
    NotStrictlyProper(i64),
    /// Two sorts of muscles.
    #[error("a neuromuscular lag and a neuromuscular system of second order exclude each other")]
    TwoMuscles,
    /// A degree is too high.
    #[error("a degree of {0} is above the highest one, {LARGEST_DEGREE}")]
    DegreeTooHigh(usize),
}

/// A structure on a plant.
#[derive(Debug, Clone, PartialEq)]
pub struct Person {
    plant: System,
    structure: Structure,
    parameters: Vec<Parameter>,
    /// Frequencies of rational laws are relative to this one.
    scale_rad_s: f64,
}

/// Both controllers at a frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// Gfb.
    pub feedback: Complex64,
    /// Gff.
    pub feedforward: Complex64,
}

fn log(name: &str, range: [f64; 2]) -> Parameter {
    Parameter { name: name.to_owned(), range, logarithmic: true }
}

fn linear(name: &str, range: [f64; 2]) -> Parameter {
    Parameter { name: name.to_owned(), range, logarithmic: false }
}

fn rational(prefix: &str, law: RationalLaw, delay_s: [f64; 2], parameters: &mut Vec<Parameter>) {
    const ALL: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];
    parameters.extend((0..=law.numerator_degree).map(|i| linear(&format!("{prefix}_numerator_{i}"), ALL)));
    // (x² + a x + b) … (x + b), x = s/scale.
    parameters.extend((0..law.denominator_degree).map(|i| log(&format!("{prefix}_denominator_{i}"), [1e-4, 1e6])));
    if law.delay {
        parameters.push(linear(&format!("{prefix}_delay_s"), delay_s));
    }
}

impl Person {
    /// A structure on a plant; delays of feedback and feedforward are sought in `delay_s`, `scale_rad_s` is a frequency
    /// in the middle of the lines.
    ///
    /// # Errors
    /// [`StructureError`].
    pub fn new(
        plant: &System,
        structure: Structure,
        delay_s: [f64; 2],
        scale_rad_s: f64,
    ) -> Result<Self, StructureError> {
        let mut parameters = Vec::new();
        // Ten times the fastest and slowest that lines about the scale can tell from none.
        let time = [0.02 / scale_rad_s, 50.0 / scale_rad_s];
        if structure.neuromuscular_lag && structure.neuromuscular_second_order {
            return Err(StructureError::TwoMuscles);
        }
        let muscles = i64::from(structure.neuromuscular_lag) + 2 * i64::from(structure.neuromuscular_second_order);
        let mut excess = plant.relative_degree() + muscles;
        match structure.feedback {
            FeedbackLaw::LeadLag => parameters.extend([
                linear("feedback_gain", [-1e6, 1e6]),
                log("feedback_lead_s", time),
                log("feedback_lag_s", time),
                linear("feedback_delay_s", delay_s),
            ]),
            FeedbackLaw::Rational(law) => {
                excess += law.denominator_degree as i64 - law.numerator_degree as i64;
                rational("feedback", law, delay_s, &mut parameters);
            }
        }
        match structure.feedforward {
            FeedforwardLaw::None => {}
            FeedforwardLaw::InverseDynamics => parameters.extend([
                linear("feedforward_gain", [-1e6, 1e6]),
                log("feedforward_lag_s", time),
                linear("feedforward_delay_s", delay_s),
            ]),
            FeedforwardLaw::Rational(law) => rational("feedforward", law, delay_s, &mut parameters),
        }
        if structure.neuromuscular_lag {
            parameters.push(log("neuromuscular_lag_s", time));
        }
        if structure.neuromuscular_second_order {
            // From the slowest that lines about the scale see as a system of its own, to beyond what they see at all.
            parameters.push(log("neuromuscular_frequency_rad_s", [0.5 * scale_rad_s, 50.0 * scale_rad_s]));
            parameters.push(log("neuromuscular_damping", [0.05, 3.0]));
        }
        // A sampled plant may answer at once: its loop is closed by a person who does not.
        if excess < 1 && plant.sample_time_s().is_none() {
            return Err(StructureError::NotStrictlyProper(excess));
        }
        for law in [structure.feedback_rational(), structure.feedforward_rational()].into_iter().flatten() {
            let highest = law.numerator_degree.max(law.denominator_degree);
            if highest > LARGEST_DEGREE {
                return Err(StructureError::DegreeTooHigh(highest));
            }
        }
        Ok(Self { plant: plant.clone(), structure, parameters, scale_rad_s })
    }

    /// The same with the feedforward's delay sought in a range of its own, which may begin below zero: who sees the
    /// command coming, or continues it, looks ahead.
    #[must_use]
    pub fn with_feedforward_delay(mut self, delay_s: [f64; 2]) -> Self {
        for parameter in self.parameters.iter_mut().filter(|parameter| parameter.name == "feedforward_delay_s") {
            parameter.range = delay_s;
        }
        self
    }

    /// The parameters, in order.
    #[must_use]
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    /// The structure.
    #[must_use]
    pub fn structure(&self) -> Structure {
        self.structure
    }

    /// The plant.
    #[must_use]
    pub fn plant(&self) -> &System {
        &self.plant
    }

    /// The frequency that rational laws are relative to, in rad/s.
    #[must_use]
    pub fn scale_rad_s(&self) -> f64 {
        self.scale_rad_s
    }

    /// Both controllers at a frequency; `values` are those of the parameters.
    #[must_use]
    pub fn response(&self, values: &[f64], omega_rad_s: f64) -> Response {
        let s = Complex64::new(0.0, omega_rad_s);
        let delay = |tau: f64| Complex64::from_polar(1.0, -omega_rad_s * tau);
        let mut rest = values;
        let mut take = |count: usize| {
            let (own, after) = rest.split_at(count);
            rest = after;
            own
        };
        let mut feedback = match self.structure.feedback {
            FeedbackLaw::LeadLag => {
                let p = take(4);
                p[0] * (1.0 + p[1] * s) / (1.0 + p[2] * s) * delay(p[3])
            }
            FeedbackLaw::Rational(law) => self.rational_response(law, take(law.count()), s),
        };
        let mut feedforward = match self.structure.feedforward {
            FeedforwardLaw::None => Complex64::default(),
            FeedforwardLaw::InverseDynamics => {
                let p = take(3);
                p[0] / self.plant.response(omega_rad_s) / (1.0 + p[1] * s) * delay(p[2])
            }
            FeedforwardLaw::Rational(law) => self.rational_response(law, take(law.count()), s),
        };
        if self.structure.neuromuscular_lag {
            let lag = 1.0 / (1.0 + take(1)[0] * s);
            feedback *= lag;
            feedforward *= lag;
        }
        if self.structure.neuromuscular_second_order {
            let p = take(2);
            let x = s / p[0];
            let muscles = 1.0 / (x * x + 2.0 * p[1] * x + 1.0);
            feedback *= muscles;
            feedforward *= muscles;
        }
        Response { feedback, feedforward }
    }

    fn rational_response(&self, law: RationalLaw, p: &[f64], s: Complex64) -> Complex64 {
        let x = s / self.scale_rad_s;
        let (numerator, rest) = p.split_at(law.numerator_degree + 1);
        let (denominator, delay) = rest.split_at(law.denominator_degree);
        let n = numerator.iter().rev().fold(Complex64::default(), |sum, c| sum * x + c);
        let d: Complex64 =
            denominator.chunks(2).map(|c| if let [a, b] = c { x * x + *a * x + *b } else { x + c[0] }).product();
        n / d * delay.first().map_or(Complex64::from(1.0), |tau| (-s * *tau).exp())
    }

    /// The loop's responses `[H_ur, H_yr, H_ud, H_yd]` at a frequency.
    #[must_use]
    pub fn closed_loop(&self, values: &[f64], omega_rad_s: f64) -> [Complex64; 4] {
        let g = self.plant.response(omega_rad_s);
        let Response { feedback, feedforward } = self.response(values, omega_rad_s);
        let sensitivity = 1.0 / (1.0 + g * feedback);
        let h_ur = (feedforward + feedback) * sensitivity;
        [h_ur, g * h_ur, -g * feedback * sensitivity, g * sensitivity]
    }

    /// Whether the delayed loop is stable.
    #[must_use]
    pub fn is_stable(&self, values: &[f64]) -> bool {
        let delay_s = self
            .parameters
            .iter()
            .zip(values)
            .find(|(parameter, _)| parameter.name == "feedback_delay_s")
            .map_or(0.0, |(_, value)| *value);
        is_loop_stable(&self.plant, |omega| self.response(values, omega).feedback, delay_s, self.scale_rad_s)
    }
}

impl RationalLaw {
    fn count(self) -> usize {
        self.numerator_degree + 1 + self.denominator_degree + usize::from(self.delay)
    }
}

impl Structure {
    fn feedback_rational(self) -> Option<RationalLaw> {
        match self.feedback {
            FeedbackLaw::Rational(law) => Some(law),
            FeedbackLaw::LeadLag => None,
        }
    }

    fn feedforward_rational(self) -> Option<RationalLaw> {
        match self.feedforward {
            FeedforwardLaw::Rational(law) => Some(law),
            _ => None,
        }
    }

    /// McRuer's ladder: error feedback; with feedforward; with muscles too.
    #[must_use]
    pub fn mcruer(feedforward: bool, muscles: Muscles) -> Self {
        let feedforward = if feedforward { FeedforwardLaw::InverseDynamics } else { FeedforwardLaw::None };
        Self {
            feedback: FeedbackLaw::LeadLag,
            feedforward,
            neuromuscular_lag: muscles == Muscles::Lag,
            neuromuscular_second_order: muscles == Muscles::SecondOrder,
        }
    }

    /// The rungs of the ladder: error feedback; with feedforward; with a neuromuscular lag; with a neuromuscular system
    /// of second order in its place.
    #[must_use]
    pub fn ladder() -> [Self; 4] {
        [(false, Muscles::None), (true, Muscles::None), (true, Muscles::Lag), (true, Muscles::SecondOrder)]
            .map(|(feedforward, muscles)| Self::mcruer(feedforward, muscles))
    }
}
