//! What a checked pool is made of, before a plant decides which candidates are stable.

use super::factor::Factor;
use super::feedback::FeedbackTable;
use super::feedback_lists::{FeedbackLists, MappedPlant, Normalisation};
use super::hidden::hidden_modes;
use super::roots::RootPair;
use super::routh::{self, LARGEST_DEGREE};
use super::spec::PoolSpecError;
use super::unfold::refuse;
use super::{Pool, Position};
use crate::control::System;
use crate::ctl::{Ctl, Stopped};
use crate::identify::held::Held;
use crate::identify::identifiability::Structure;
use crate::identify::time::{Region, Time};
use crate::num::linalg::NoConvergence;
use num_complex::Complex64;

/// The most combinations of denominator, numerator and gain whose stability is tested.
const LARGEST_TABLE: u128 = 200_000_000_000;

/// The polynomials of a list.
#[derive(Debug, Clone, PartialEq)]
pub enum Ingredients {
    /// `x^n`: in sampled time the denominator of an FIR filter; 1 for n = 0.
    Power(usize),
    /// Monic polynomials with these roots.
    Roots(Vec<RootPair>),
    /// Coefficients in descending powers, equally long.
    Coefficients(Vec<Vec<f64>>),
}

impl Ingredients {
    /// How many polynomials.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Power(_) => 1,
            Self::Roots(roots) => roots.len(),
            Self::Coefficients(rows) => rows.len(),
        }
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The degree that all of them have.
    #[must_use]
    pub fn degree(&self) -> usize {
        match self {
            Self::Power(n) => *n,
            Self::Roots(roots) => roots.first().map_or(0, |r| r.degree()),
            Self::Coefficients(rows) => rows.first().map_or(0, |row| row.len() - 1),
        }
    }

    fn factors(&self, region: Region, degree: usize) -> Vec<Factor> {
        match self {
            Self::Power(n) => {
                let mut coefficients = vec![0.0; n + 1];
                coefficients[0] = 1.0;
                vec![Factor::from_coefficients(coefficients, region, degree, 0)]
            }
            Self::Roots(roots) => {
                roots.iter().enumerate().map(|(i, r)| Factor::from_roots(*r, region, degree, i)).collect()
            }
            Self::Coefficients(rows) => rows
                .iter()
                .enumerate()
                .map(|(i, row)| Factor::from_coefficients(row.clone(), region, degree, i))
                .collect(),
        }
    }

    /// Which of the listed numbers of an element are the smallest or largest of their list.
    fn edges(&self, element: usize, name: &str) -> Vec<String> {
        let end = |value: f64, all: &[f64]| {
            let low = all.iter().copied().fold(f64::INFINITY, f64::min);
            let high = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            if low == high {
                None
            } else if value == low {
                Some("smallest")
            } else if value == high {
                Some("largest")
            } else {
                None
            }
        };
        let mut edges = Vec::new();
        match self {
            Self::Power(_) => {}
            Self::Coefficients(rows) => {
                for (i, value) in rows[element].iter().enumerate() {
                    let all: Vec<f64> = rows.iter().map(|row| row[i]).collect();
                    if let Some(end) = end(*value, &all) {
                        edges.push(format!("coefficient {i} of the {name}, {value}, is the {end} one"));
                    }
                }
            }
            Self::Roots(roots) => {
                let reals: Vec<f64> = roots.iter().flat_map(|r| r.real().into_iter().flatten()).collect();
                let (frequencies, dampings): (Vec<f64>, Vec<f64>) = roots.iter().filter_map(|r| r.complex()).unzip();
                let mut seen = None;
                for root in roots[element].real().into_iter().flatten() {
                    if let Some(end) = end(root, &reals).filter(|_| seen != Some(root)) {
                        edges.push(format!("the real root {root} rad/s of the {name} is the {end} one"));
                    }
                    seen = Some(root);
                }
                if let Some((frequency, damping)) = roots[element].complex() {
                    // A small natural frequency is no edge: the list goes down to the origin.
                    if end(frequency, &frequencies) == Some("largest") {
                        edges.push(format!("the natural frequency {frequency} rad/s of the {name} is the largest one"));
                    }
                    if let Some(end) = end(damping, &dampings) {
                        edges.push(format!("the damping ratio {damping} of the {name} is the {end} one"));
                    }
                }
            }
        }
        edges
    }

    /// `|P|²` of each as a quadratic in ω² or 1 − cos ωT, and whether P vanishes on the band.
    fn squares(&self, time: Time, band: [f64; 2]) -> Vec<([f64; 3], bool)> {
        let square = |pair: &RootPair| {
            let quadratic = match time {
                Time::Continuous => pair.square(),
                Time::Sampled(t) => pair.matched_square(t.period_s()),
            };
            (quadratic, pair.vanishes_on(band[0], band[1]))
        };
        match self {
            Self::Roots(roots) => roots.iter().map(square).collect(),
            // Only lists of roots have peak gains.
            Self::Power(_) | Self::Coefficients(_) => vec![([1.0, 0.0, 0.0], false); self.len()],
        }
    }
}

/// A checked pool without a plant.
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    /// Whether it is sampled; `None`: as the plant.
    pub sampled: Option<bool>,
    /// Denominators of the feedforward controller.
    pub feedforward: Ingredients,
    /// Degree of the feedforward numerator.
    pub feedforward_numerator_degree: usize,
    /// Degree of the feedforward denominator.
    pub feedforward_denominator_degree: usize,
    /// Numerators of the feedback controller at gain one.
    pub feedback_numerators: Ingredients,
    /// Denominators of the feedback controller.
    pub feedback_denominators: Ingredients,
    /// Gains other than zero, with their signs, without repeats.
    pub gains: Vec<f64>,
    /// Whether no feedback belongs to the pool.
    pub zero_gain: bool,
    /// The band over which gains are peaks, in rad/s; `None`: gains multiply the numerators as they are.
    pub band_rad_s: Option<[f64; 2]>,
    /// Stability margin in 1/s.
    pub margin: f64,
    /// The controller that is held at zero, see [`Recipe::holding`].
    pub held: Option<Held>,
}

/// Why a recipe and a plant make no pool.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoolError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// The pool is continuous and the plant sampled.
    #[error("the pool is continuous and the plant sampled ({sample_time_s} s)")]
    ContinuousPoolSampledPlant {
        /// The plant's sample time.
        sample_time_s: f64,
    },
    /// The pool is sampled and the plant continuous: it has to be discretised first.
    #[error("the pool is sampled and the plant continuous")]
    SampledPoolContinuousPlant,
    /// G Gfb is not strictly proper (assumption A2.2 of Zhang 2015).
    #[error(
        "the loop G Gfb must be strictly proper: plant {plant_numerator}/{plant_denominator} with feedback \
         {feedback_numerator}/{feedback_denominator} (degrees of numerator/denominator) is not"
    )]
    NotStrictlyProper {
        /// Degree of the plant's numerator.
        plant_numerator: usize,
        /// Degree of the plant's denominator.
        plant_denominator: usize,
        /// Degree of the feedback numerator.
        feedback_numerator: usize,
        /// Degree of the feedback denominator.
        feedback_denominator: usize,
    },
    /// The plant is zero.
    #[error("the plant is zero")]
    ZeroPlant,
    /// The closed loop has too high a degree.
    #[error("the closed loop has degree {degree}, and at most {limit} is taken")]
    DegreeTooHigh {
        /// Its degree.
        degree: usize,
        /// The limit.
        limit: usize,
    },
    /// A sampled system would act before its input.
    #[error(
        "the {part} has a numerator of degree {numerator} over degree {denominator}: it would act before its input"
    )]
    Noncausal {
        /// `plant`, `feedback` or `feedforward`.
        part: &'static str,
        /// Degree of the numerator.
        numerator: usize,
        /// Degree of the denominator.
        denominator: usize,
    },
    /// A continuous feedforward without denominator was given one's degree.
    #[error("a continuous feedforward without listed denominators has denominator degree 0, not {0}")]
    NoDenominators(usize),
    /// The peak gain is meant over frequencies that a sampled controller does not have.
    #[error("the band of the peak gain ends at {band} rad/s, above the Nyquist frequency {nyquist} rad/s")]
    AboveNyquist {
        /// Upper end of the band.
        band: f64,
        /// π over the sample time.
        nyquist: f64,
    },
    /// More combinations than can be tested for stability.
    #[error(
        "{combinations} combinations of feedback denominator, numerator and gain, and at most {LARGEST_TABLE} are \
         tested"
    )]
    TooLarge {
        /// How many.
        combinations: u128,
    },
    /// The roots of the plant's denominator were not found.
    #[error(transparent)]
    NoConvergence(NoConvergence),
    /// More candidates than 64 bits can number.
    #[error("more than 2^64 candidates")]
    Overflow,
    /// Numerator and denominator of the plant share roots that no feedback moves.
    #[error(
        "numerator and denominator of the plant share the root{} {}, on or beyond the boundary of the stable region: a \
         hidden mode, which no feedback from the output moves, so that no pool can hold a stable candidate",
        if .modes.len() == 1 { "" } else { "s" },
        roots_text(.modes, *.sampled)
    )]
    HiddenMode {
        /// The roots.
        modes: Vec<Complex64>,
        /// Whether they are in the z-plane.
        sampled: bool,
    },
    /// No feedforward denominator is stable within the margin.
    #[error("none of the {0} feedforward denominators is stable within the margin")]
    NoFeedforward(usize),
    /// The plant alone, which a loop without feedback is, is not stable within the margin.
    #[error("the plant alone is not stable within the margin, and so no loop is without feedback")]
    UnstablePlant,
    /// No feedback controller makes the loop stable within the margin.
    #[error(
        "none of the {0} combinations of feedback denominator, numerator and gain makes the loop stable within the \
         margin"
    )]
    NoFeedback(u128),
}

fn roots_text(roots: &[Complex64], sampled: bool) -> String {
    let name = if sampled { "z" } else { "s" };
    let one = |root: &Complex64| match (root.re, root.im) {
        (re, 0.0) => format!("{name} = {re}"),
        (re, im) => format!("{name} = {re:.6} ± {:.6}j", im.abs()),
    };
    roots.iter().map(one).collect::<Vec<_>>().join(", ")
}

impl Recipe {
    pub(super) fn checked(self) -> Result<Self, PoolSpecError> {
        if self.gains.is_empty() && !self.zero_gain {
            return Err(refuse("pool", "the pool has no gain".to_owned()));
        }
        for (field, degree) in [
            ("feedforward_numerator_degree", self.feedforward_numerator_degree),
            ("feedforward_denominator_degree", self.feedforward_denominator_degree),
        ] {
            if degree > LARGEST_DEGREE {
                return Err(refuse(field, format!("the degree is {degree}, and at most {LARGEST_DEGREE} is taken")));
            }
        }
        Ok(self)
    }

    /// The same pool with a controller held at zero, of whose lists the one that is zero is left.
    #[must_use]
    pub fn holding(self, held: Held) -> Self {
        match held {
            Held::Feedback => Self {
                feedback_numerators: Ingredients::Power(0),
                feedback_denominators: Ingredients::Power(0),
                gains: Vec::new(),
                zero_gain: true,
                band_rad_s: None,
                held: Some(held),
                ..self
            },
            Held::Feedforward => Self {
                feedforward: Ingredients::Power(0),
                feedforward_numerator_degree: 0,
                feedforward_denominator_degree: 0,
                held: Some(held),
                ..self
            },
        }
    }

    /// The degrees of the controllers.
    #[must_use]
    pub fn structure(&self) -> Structure {
        Structure {
            feedforward_numerator: self.feedforward_numerator_degree,
            feedforward_denominator_is_free: !matches!(self.feedforward, Ingredients::Power(_)),
            feedforward_denominator: self.feedforward_denominator_degree,
            feedback_numerator: self.feedback_numerators.degree(),
            feedback_denominator: self.feedback_denominators.degree(),
            held: self.held,
        }
    }

    /// The lists at whose ends a candidate lies, in words.
    #[must_use]
    pub fn edges(&self, pool: &Pool, position: Position) -> Vec<String> {
        let feedback = position.feedback;
        let mut edges = Vec::new();
        let feedforward = &pool.feedforward()[position.feedforward];
        edges.extend(self.feedforward.edges(feedforward.listed, "feedforward denominator"));
        // Without feedback, its poles and zeros mean nothing.
        if let Some(numerator) = feedback.numerator {
            let table = pool.feedback();
            let denominator = table.denominators()[feedback.denominator].listed;
            edges.extend(self.feedback_denominators.edges(denominator, "feedback denominator"));
            edges.extend(self.feedback_numerators.edges(table.numerators()[numerator].listed, "feedback numerator"));
            let largest = self.gains.iter().map(|g| g.abs()).fold(0.0, f64::max);
            if let Some(gain) = feedback.gain_position.map(|i| self.gains[i])
                && self.band_rad_s.is_some()
                && gain.abs() == largest
            {
                edges.push(format!("the peak gain {gain} is the largest one"));
            }
        }
        edges
    }

    /// The combinations of feedback denominator, numerator and gain before any is tested for stability.
    #[must_use]
    pub fn combinations(&self) -> u128 {
        let per_denominator =
            self.feedback_numerators.len() as u128 * self.gains.len() as u128 + u128::from(self.zero_gain);
        self.feedback_denominators.len() as u128 * per_denominator
    }

    /// Makes the pool on a plant of its own time base: tests every controller for stability and counts.
    ///
    /// Runs on the rayon pool that it is called in. Progress is not reported; the stop flag is looked at.
    ///
    /// # Errors
    /// [`PoolError`].
    pub fn build(&self, plant: &System, ctl: &Ctl) -> Result<Pool, PoolError> {
        self.build_counted(plant, None, ctl)
    }

    /// [`Recipe::build`] without testing every controller, where [`FeedbackTable::counts`] of an earlier pool of this
    /// recipe on this plant are known. Counts that cannot be right are not used; those of another pool must not be
    /// given.
    ///
    /// # Errors
    /// [`PoolError`].
    pub fn build_counted(&self, plant: &System, counts: Option<&[u64]>, ctl: &Ctl) -> Result<Pool, PoolError> {
        let time = Time::of(plant);
        match (self.sampled, time) {
            (Some(false), Time::Sampled(t)) => {
                return Err(PoolError::ContinuousPoolSampledPlant { sample_time_s: t.period_s() });
            }
            (Some(true), Time::Continuous) => return Err(PoolError::SampledPoolContinuousPlant),
            _ => {}
        }
        let (num, den) = match plant {
            System::Continuous(tf) => (tf.num(), tf.den()),
            System::Discrete(tf) => (tf.num(), tf.den()),
        };
        if num.is_zero() {
            return Err(PoolError::ZeroPlant);
        }
        let (np, dp) = (num.degree(), den.degree());
        let (nfb, dfb) = (self.feedback_numerators.degree(), self.feedback_denominators.degree());
        // Without feedback there is no loop that could be improper.
        if self.held != Some(Held::Feedback) && dp + dfb <= np + nfb {
            return Err(PoolError::NotStrictlyProper {
                plant_numerator: np,
                plant_denominator: dp,
                feedback_numerator: nfb,
                feedback_denominator: dfb,
            });
        }
        if time != Time::Continuous {
            for (part, numerator, denominator) in [
                ("plant", np, dp),
                ("feedback", nfb, dfb),
                ("feedforward", self.feedforward_numerator_degree, self.feedforward_denominator_degree),
            ] {
                if numerator > denominator {
                    return Err(PoolError::Noncausal { part, numerator, denominator });
                }
            }
        }
        // In continuous time one of plant and feedback may be improper; their polynomials are then padded with zeros.
        let (plant_degree, feedback_degree) = (dp.max(np), dfb.max(nfb));
        if plant_degree + feedback_degree > LARGEST_DEGREE {
            return Err(PoolError::DegreeTooHigh { degree: plant_degree + feedback_degree, limit: LARGEST_DEGREE });
        }
        if let (Time::Continuous, Ingredients::Power(n @ 1..)) = (time, &self.feedforward) {
            return Err(PoolError::NoDenominators(*n));
        }
        let combinations = self.combinations();
        if combinations > LARGEST_TABLE {
            return Err(PoolError::TooLarge { combinations });
        }

        let region = Region { time, margin: self.margin };
        let modes = hidden_modes(num, den, region)?;
        if !modes.is_empty() {
            return Err(PoolError::HiddenMode { modes, sampled: time != Time::Continuous });
        }
        let feedforward: Vec<Factor> = self
            .feedforward
            .factors(region, self.feedforward_denominator_degree)
            .into_iter()
            .filter(|factor| routh::stable(&factor.mapped))
            .collect();
        if feedforward.is_empty() {
            return Err(PoolError::NoFeedforward(self.feedforward.len()));
        }
        let normalisation = match self.band_rad_s {
            None => Normalisation::None,
            Some(band) => Normalisation::Peak {
                denominators: self.feedback_denominators.squares(time, band),
                numerators: self.feedback_numerators.squares(time, band).into_iter().map(|(q, _)| q).collect(),
                band: match time {
                    Time::Continuous => band.map(|w| w * w),
                    Time::Sampled(t) => {
                        let nyquist = std::f64::consts::PI / t.period_s();
                        if band[1] > nyquist {
                            return Err(PoolError::AboveNyquist { band: band[1], nyquist });
                        }
                        band.map(|w| 2.0 * (0.5 * w * t.period_s()).sin().powi(2))
                    }
                },
            },
        };
        let mapped = |p: &crate::num::Polynomial| region.map(p.coefficients(), plant_degree);
        let lists = FeedbackLists {
            denominators: self.feedback_denominators.factors(region, feedback_degree),
            numerators: self.feedback_numerators.factors(region, feedback_degree),
            gains: self.gains.clone(),
            zero: self.zero_gain,
            normalisation,
        };
        let padding = (plant_degree + feedback_degree) - (dp + dfb);
        let plant = MappedPlant { denominator: mapped(den), numerator: mapped(num), padding };
        let feedback = FeedbackTable::new(lists, plant, counts, ctl)?;
        if feedback.is_empty() {
            if self.held == Some(Held::Feedback) {
                return Err(PoolError::UnstablePlant);
            }
            return Err(PoolError::NoFeedback(combinations));
        }
        let size = feedback.len().checked_mul(feedforward.len() as u64).ok_or(PoolError::Overflow)?;
        Ok(Pool {
            region,
            feedforward_numerator_degree: self.feedforward_numerator_degree,
            feedforward,
            feedback,
            size,
        })
    }
}
