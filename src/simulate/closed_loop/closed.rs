//! Plant, controllers and delays of a loop: what makes one that can be simulated, and its frequency responses.

use crate::control::{System, TimeBase as _};
use num_complex::Complex64;

/// Delays of a loop in seconds, none of them negative.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Delays {
    /// Of the plant, θ.
    pub plant_s: f64,
    /// Of the feedforward, σ.
    pub feedforward_s: f64,
    /// Of the feedback, τ.
    pub feedback_s: f64,
    /// How far ahead the feedforward sees the command, p.
    pub preview_s: f64,
}

impl Delays {
    /// Once around the loop, θ + τ.
    #[must_use]
    pub fn around_s(&self) -> f64 {
        self.plant_s + self.feedback_s
    }
}

/// A part of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The plant G.
    Plant,
    /// The feedforward Gff.
    Feedforward,
    /// The feedback Gfb.
    Feedback,
}

impl Part {
    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Plant => "plant",
            Self::Feedforward => "feedforward",
            Self::Feedback => "feedback",
        }
    }
}

/// Why three systems and their delays make no loop that can be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LoopDefect {
    /// A controller in another time base than the plant.
    #[error("the {} has sample time {found:?} s and the plant {plant:?} s (None: continuous)", part.name())]
    TimeBase {
        /// Which.
        part: Part,
        /// Its sample time.
        found: Option<f64>,
        /// That of the plant.
        plant: Option<f64>,
    },
    /// More zeros than poles, where that cannot be.
    #[error("the {} has {num_degree} zeros and {den_degree} poles: {why}", part.name())]
    Improper {
        /// Which.
        part: Part,
        /// Degree of its numerator.
        num_degree: usize,
        /// Degree of its denominator.
        den_degree: usize,
        /// What that would ask for.
        why: &'static str,
    },
    /// A sampled feedforward that needs samples of the command that are still to come.
    #[error("the feedforward has {samples} more zeros than poles: it needs the command {samples} samples ahead")]
    NonCausal {
        /// How many.
        samples: usize,
    },
    /// `1 + G Gfb` vanishes at infinity.
    #[error("the direct gains of plant and feedback form an algebraic loop without solution")]
    Algebraic,
    /// A delayed loop that is not strictly proper.
    #[error(
        "the loop gain G Gfb has as many zeros as poles and a delay: every jump would come back undamped, and its \
         poles reach to infinity"
    )]
    Neutral,
}

/// Plant, controllers and delays, each proper as far as simulation needs it.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosedLoop {
    pub(super) plant: System,
    pub(super) feedforward: System,
    pub(super) feedback: System,
    pub(super) delays: Delays,
}

/// Responses of a loop at one frequency, delays included; not finite at a pole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopResponses {
    /// G.
    pub plant: Complex64,
    /// Gff.
    pub feedforward: Complex64,
    /// Gfb.
    pub feedback: Complex64,
    /// Gff G, which is 1 where the feedforward is the inverse of the plant.
    pub feedforward_plant: Complex64,
    /// The loop gain G Gfb.
    pub loop_gain: Complex64,
    /// From command to output, G (Gff + Gfb)/(1 + G Gfb).
    pub command_to_output: Complex64,
    /// From command to error, (1 − Gff G)/(1 + G Gfb) (Zhang 2015, equation 3.5).
    pub command_to_error: Complex64,
}

impl ClosedLoop {
    /// Checks time bases, and that everything simulated is proper: the plant; in sampled time both controllers; in
    /// continuous time the products Gff G and Gfb G, since a controller alone may differentiate.
    ///
    /// # Errors
    /// [`LoopDefect`].
    pub fn new(plant: System, feedforward: System, feedback: System, delays: Delays) -> Result<Self, LoopDefect> {
        for (part, system) in [(Part::Feedforward, &feedforward), (Part::Feedback, &feedback)] {
            if system.sample_time_s() != plant.sample_time_s() {
                let (found, plant) = (system.sample_time_s(), plant.sample_time_s());
                return Err(LoopDefect::TimeBase { part, found, plant });
            }
        }
        let degrees = |system: &System| (system.num().degree(), system.den().degree());
        let improper = |part: Part, system: &System, why: &'static str| {
            let (num_degree, den_degree) = degrees(system);
            Err(LoopDefect::Improper { part, num_degree, den_degree, why })
        };
        if plant.relative_degree() < 0 {
            return improper(Part::Plant, &plant, "its output would need the control of the future");
        }
        let closed = Self { plant, feedforward, feedback, delays };
        let Self { plant, feedforward, feedback, .. } = &closed;
        if plant.sample_time_s().is_some() {
            if feedforward.relative_degree() < 0 {
                let samples = feedforward.relative_degree().unsigned_abs() as usize;
                return Err(LoopDefect::NonCausal { samples });
            }
            if feedback.relative_degree() < 0 {
                return improper(Part::Feedback, feedback, "its control would need errors of the future");
            }
        }
        let with_plant = |system: &System| plant.relative_degree() + system.relative_degree();
        if with_plant(feedforward) < 0 && !feedforward.num().is_zero() {
            return improper(
                Part::Feedforward,
                feedforward,
                "behind the plant it would still differentiate the command",
            );
        }
        if with_plant(feedback) < 0 && !feedback.num().is_zero() {
            return improper(Part::Feedback, feedback, "the loop gain would grow without bound with frequency");
        }
        let loop_has_gain = !(feedback.num().is_zero() || plant.num().is_zero());
        if with_plant(feedback) == 0 && loop_has_gain {
            let direct = plant.num().leading() * feedback.num().leading();
            if direct + plant.den().leading() * feedback.den().leading() == 0.0 {
                return Err(LoopDefect::Algebraic);
            }
            if delays.around_s() > 0.0 && plant.sample_time_s().is_none() {
                return Err(LoopDefect::Neutral);
            }
        }
        Ok(closed)
    }

    /// The plant G, without its delay in continuous time.
    #[must_use]
    pub fn plant(&self) -> &System {
        &self.plant
    }

    /// The feedforward Gff, without its delay in continuous time.
    #[must_use]
    pub fn feedforward(&self) -> &System {
        &self.feedforward
    }

    /// The feedback Gfb, without its delay in continuous time.
    #[must_use]
    pub fn feedback(&self) -> &System {
        &self.feedback
    }

    /// The delays that are no poles.
    #[must_use]
    pub fn delays(&self) -> Delays {
        self.delays
    }

    /// Whether the control has samples: no controller differentiates.
    #[must_use]
    pub fn has_control(&self) -> bool {
        self.feedforward.relative_degree() >= 0 && self.feedback.relative_degree() >= 0
    }

    /// Numerator (with the delay) and denominator of the plant at the angular frequency `omega_rad_s`.
    #[must_use]
    pub fn plant_fraction(&self, omega_rad_s: f64) -> (Complex64, Complex64) {
        fraction(&self.plant, self.delays.plant_s, omega_rad_s)
    }

    /// The responses at the angular frequency `omega_rad_s`, as quotients of polynomials over common denominators, so
    /// that a pole of one part does no harm to the closed loop.
    #[must_use]
    pub fn responses(&self, omega_rad_s: f64) -> LoopResponses {
        let Delays { feedforward_s, feedback_s, preview_s, .. } = self.delays;
        let (n, d) = self.plant_fraction(omega_rad_s);
        let (n_ff, d_ff) = fraction(&self.feedforward, feedforward_s - preview_s, omega_rad_s);
        let (n_fb, d_fb) = fraction(&self.feedback, feedback_s, omega_rad_s);
        let closed = d * d_fb + n * n_fb;
        LoopResponses {
            plant: n / d,
            feedforward: n_ff / d_ff,
            feedback: n_fb / d_fb,
            feedforward_plant: n * n_ff / (d * d_ff),
            loop_gain: n * n_fb / (d * d_fb),
            command_to_output: n * (n_ff * d_fb + n_fb * d_ff) / (d_ff * closed),
            command_to_error: d_fb * (d * d_ff - n * n_ff) / (d_ff * closed),
        }
    }
}

fn fraction(system: &System, delay_s: f64, omega_rad_s: f64) -> (Complex64, Complex64) {
    let x = match system {
        System::Continuous(tf) => tf.time().point(omega_rad_s),
        System::Discrete(tf) => tf.time().point(omega_rad_s),
    };
    (system.num().eval(x) * Complex64::from_polar(1.0, -omega_rad_s * delay_s), system.den().eval(x))
}
