//! What an input asks of a device and of a body: position, velocity, acceleration, force and power, against limits.

use super::path::{PIECE, PathError, SampledPlant};
use crate::control::discretise::{DiscretiseError, zero_order_hold_state_space};
use crate::ctl::Ctl;
use nalgebra::DVector;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Peak and root mean square of one quantity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "MotionExtent")]
pub struct Extent {
    /// The largest magnitude, in the unit of the quantity.
    pub peak: f64,
    /// Root mean square, in the unit of the quantity.
    pub rms: f64,
    /// The limit of the peak, in the unit of the quantity; null where none was given.
    #[serde(default)]
    pub limit: Option<f64>,
    /// Whether the peak keeps the limit; null without one.
    #[serde(default)]
    pub within_limit: Option<bool>,
}

/// Limits on peaks, in the units of the signals.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MotionLimits {
    /// Of the position, in its unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<f64>,
    /// Of the velocity, in the unit of the position per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<f64>,
    /// Of the acceleration, in the unit of the position per second squared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceleration: Option<f64>,
    /// Of the force or torque at the plant's input, in its unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force: Option<f64>,
    /// Of force times velocity, in their units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub power: Option<f64>,
}

impl MotionLimits {
    /// The first limit that is not a positive, finite number, with its name.
    #[must_use]
    pub fn unusable(&self) -> Option<(&'static str, f64)> {
        self.named()
            .into_iter()
            .find_map(|(name, limit)| limit.filter(|l| !(*l > 0.0 && l.is_finite())).map(|l| (name, l)))
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.named().iter().all(|(_, limit)| limit.is_none())
    }

    fn named(&self) -> [(&'static str, Option<f64>); 5] {
        [
            ("position", self.position),
            ("velocity", self.velocity),
            ("acceleration", self.acceleration),
            ("force", self.force),
            ("power", self.power),
        ]
    }
}

/// How velocity and acceleration were found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Derivatives {
    /// From the states of the plant in continuous time, exact at the samples, with the jumps of the acceleration from
    /// both sides.
    States,
    /// Differences over one sample: means over that time, whose peaks may be higher in between.
    Differences,
}

/// Peaks and root mean squares of a motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MotionSummary {
    /// Of the position; null where only a force is known, as are velocity and acceleration.
    pub position: Option<Extent>,
    /// Of the velocity, in the unit of the position per second.
    pub velocity: Option<Extent>,
    /// Of the acceleration, in the unit of the position per second squared.
    pub acceleration: Option<Extent>,
    /// Of the force or torque at the plant's input; null where none is known.
    pub force: Option<Extent>,
    /// Of force times velocity, the mechanical power; null where no force is known.
    pub power: Option<Extent>,
    /// How velocity and acceleration were found; null where they are not known.
    pub derivatives: Option<Derivatives>,
    /// Whether every limit that was given is kept; null without limits, or where a limited quantity is not known.
    pub within_limits: Option<bool>,
}

/// A motion, sample by sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    position: Vec<f64>,
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
    force: Option<Vec<f64>>,
    derivatives: Option<Derivatives>,
}

impl MotionSummary {
    /// The limited quantities of which nothing is known, by name.
    #[must_use]
    pub fn unjudged(&self, limits: &MotionLimits) -> Vec<&'static str> {
        let known = [self.position, self.velocity, self.acceleration, self.force, self.power];
        let missing =
            |((_, limit), extent): &((&'static str, Option<f64>), Option<Extent>)| limit.is_some() && extent.is_none();
        limits.named().into_iter().zip(known).filter(missing).map(|((name, _), _)| name).collect()
    }
}

impl Motion {
    /// A force of which nothing is known but its samples.
    #[must_use]
    pub fn of_force(force: &[f64]) -> Self {
        let none = Vec::new;
        Self {
            position: none(),
            velocity: none(),
            acceleration: none(),
            force: Some(force.to_vec()),
            derivatives: None,
        }
    }

    /// The motion of a position that is known by its samples: velocity `(x_{k+1} − x_k)/T`, acceleration the difference
    /// of velocities.
    ///
    /// # Panics
    /// If there is a force of another length, which is a mistake of the caller.
    #[must_use]
    pub fn of_samples(position: &[f64], force: Option<&[f64]>, sample_time_s: f64) -> Self {
        assert!(force.is_none_or(|force| force.len() == position.len()), "position and force");
        let difference =
            |values: &[f64]| values.windows(2).map(|pair| (pair[1] - pair[0]) / sample_time_s).collect::<Vec<f64>>();
        let velocity = difference(position);
        let acceleration = difference(&velocity);
        Self {
            position: position.to_vec(),
            velocity,
            acceleration,
            force: force.map(<[f64]>::to_vec),
            derivatives: Some(Derivatives::Differences),
        }
    }

    /// The motion of a plant's output from rest when this force is held between samples: `y`, `ẏ = C A x + C B u` and
    /// `ÿ = C A² x + C A B u`, where the plant is known in continuous time and its output cannot jump (`D = 0`; for the
    /// acceleration `C B = 0` too); by [`Motion::of_samples`] of `position` otherwise.
    ///
    /// # Errors
    /// [`DiscretiseError::Overflow`] or [`PathError::Stopped`].
    pub fn of_plant(plant: &SampledPlant, position: &[f64], force: &[f64], ctl: &Ctl) -> Result<Self, PathError> {
        let time = plant.time();
        let Some(model) = plant.smooth() else {
            return Ok(Self::of_samples(position, Some(force), time.period_s()));
        };
        let sampled = zero_order_hold_state_space(model, time)?;
        let first = model.c() * model.a();
        let second = &first * model.a();
        let direct = (&first * model.b())[(0, 0)];
        let (c, first, second) = (model.c().transpose(), first.transpose(), second.transpose());
        let held: DVector<f64> = sampled.b().column(0).into_owned();
        let mut state = DVector::zeros(model.states());
        let mut next = state.clone();
        let n = force.len();
        let mut motion = Self {
            position: Vec::with_capacity(n),
            velocity: Vec::with_capacity(n),
            acceleration: Vec::with_capacity(2 * n),
            force: Some(force.to_vec()),
            derivatives: Some(Derivatives::States),
        };
        for (k, u) in force.iter().enumerate() {
            if k % PIECE == 0 {
                ctl.check()?;
            }
            motion.position.push(c.column(0).dot(&state));
            motion.velocity.push(first.column(0).dot(&state));
            motion.acceleration.push(second.column(0).dot(&state) + direct * u);
            next.gemv(1.0, sampled.a(), &state, 0.0);
            next.axpy(*u, &held, 1.0);
            std::mem::swap(&mut state, &mut next);
            // Just before the force changes.
            motion.acceleration.push(second.column(0).dot(&state) + direct * u);
        }
        if motion.acceleration.iter().any(|a| !a.is_finite()) {
            return Err(DiscretiseError::Overflow { sample_time_s: time.period_s() }.into());
        }
        Ok(motion)
    }

    /// Its peaks and root mean squares, against limits.
    #[must_use]
    pub fn summary(&self, limits: &MotionLimits) -> MotionSummary {
        let known = |values: &[f64], limit| self.derivatives.map(|_| extent(values, limit));
        let position = known(&self.position, limits.position);
        let velocity = known(&self.velocity, limits.velocity);
        let acceleration = known(&self.acceleration, limits.acceleration);
        let force = self.force.as_ref().map(|force| extent(force, limits.force));
        let power = self.force.as_ref().and_then(|force| {
            let power: Vec<f64> = force.iter().zip(&self.velocity).map(|(f, v)| f * v).collect();
            known(&power, limits.power)
        });
        let judged = [position, velocity, acceleration, force, power];
        let unknown =
            limits.named().iter().zip(&judged).any(|((_, limit), extent)| limit.is_some() && extent.is_none());
        let broken = judged.iter().flatten().any(|extent| extent.within_limit == Some(false));
        let within_limits = if broken {
            Some(false)
        } else if limits.is_empty() || unknown {
            None
        } else {
            Some(true)
        };
        MotionSummary { position, velocity, acceleration, force, power, derivatives: self.derivatives, within_limits }
    }
}

/// Peak and root mean square of some values; zero of none.
#[must_use]
pub fn extent(values: &[f64], limit: Option<f64>) -> Extent {
    let peak = values.iter().fold(0.0_f64, |peak, x| peak.max(x.abs()));
    // Relative to the peak, so that squares neither overflow nor vanish.
    let mean =
        if peak > 0.0 { values.iter().map(|x| (x / peak).powi(2)).sum::<f64>() / values.len() as f64 } else { 0.0 };
    // A limit that was scaled to, to rounding, is kept.
    let within_limit = limit.map(|limit| peak <= limit * (1.0 + 1e-12));
    Extent { peak, rms: peak * mean.sqrt(), limit, within_limit }
}
