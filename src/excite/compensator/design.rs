//! The loop that a compensator is chosen for, and how good it is with one.

use super::controller::Compensator;
use super::following::{Following, Limited};
use super::norm::NormGrid;
use crate::control::{System, TimeBase as _, stability};
use crate::ctl::Ctl;
use crate::excite::flatness::flatness;
use crate::excite::motion::{Motion, MotionLimits, MotionSummary};
use crate::excite::path::{Path, PathError, SampledPlant};
use crate::excite::peak::{Peak, resonance};
use crate::num::{Complex64, Polynomial};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Peaks are held this share below their limits while compensators are compared, so that what is kept there is kept by
/// the simulation that is reported: its transfer function in powers of z is rounded, which moves a peak by some 1e-8.
const WITHIN: f64 = 1.0 - 1e-7;

/// What a design must keep beside stability.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(rename = "CompensatorLimits")]
pub struct DesignLimits {
    /// Peak of the position, in its unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<f64>,
    /// Peak of the velocity, in the unit of the position per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<f64>,
    /// Peak of the acceleration, in the unit of the position per second squared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceleration: Option<f64>,
    /// Peak of the force that the controller asks for, in N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force: Option<f64>,
    /// Peak of the mechanical power, in W where the position is in m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub power: Option<f64>,
    /// ‖S P‖∞, in position per force: how far a person's force may push the device aside.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub disturbance_norm: Option<f64>,
    /// The slowest decay of the closed loop, 1/s; 0 for stability alone. Default: π times the distance of neighbouring
    /// lines in Hz, so that no resonance is narrower than that and hides between lines, and the loop settles within a
    /// period.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decay_per_s: Option<f64>,
}

impl DesignLimits {
    /// Those on the motion.
    #[must_use]
    pub fn motion(&self) -> MotionLimits {
        MotionLimits {
            position: self.position,
            velocity: self.velocity,
            acceleration: self.acceleration,
            force: self.force,
            power: self.power,
        }
    }

    /// The first that is not a positive, finite number, with its name.
    #[must_use]
    pub fn unusable(&self) -> Option<(&'static str, f64)> {
        let norm = self.disturbance_norm.filter(|l| !(*l > 0.0 && l.is_finite())).map(|l| ("disturbance_norm", l));
        let decay = self.decay_per_s.filter(|l| !(*l >= 0.0 && l.is_finite())).map(|l| ("decay_per_s", l));
        let bad = norm.or(decay);
        self.motion().unusable().or(bad)
    }
}

/// The loop that a compensator is chosen for: a plant, the lines of the reference in the band, and the reference
/// itself.
#[derive(Debug, Clone)]
pub struct Design {
    plant: SampledPlant,
    /// Per line: z, P(z) and the reference's power.
    lines: Vec<(Complex64, Complex64, f64)>,
    /// Two periods of the reference, or the record: what the device follows from rest.
    reference: Vec<f64>,
    reference_sfm: f64,
    following: Option<Following>,
    norm: NormGrid,
}

/// A compensator with its findings.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    /// The compensator.
    pub compensator: Compensator,
    /// SFG_xr of the band (16).
    pub blsfg: f64,
    /// γ_x² of the band.
    pub output_sfm: f64,
    /// σ_x²: the mean of the position's powers over the lines of the band.
    pub output_mean: f64,
    /// The resonance of `X/R`, at its angular frequency; none where the gain nowhere exceeds that at 0 Hz.
    pub resonance: Option<Peak>,
    /// ‖S P‖∞ and the angular frequency where it is reached.
    pub disturbance: Peak,
    /// The closed-loop poles in z.
    pub poles: Vec<Complex64>,
    /// Natural frequency (rad/s) and damping ratio of the least damped pair of them.
    pub oscillation: Option<[f64; 2]>,
    /// The motion of the plant from rest over the reference.
    pub motion: MotionSummary,
}

impl Design {
    /// A plant and the reference's lines in the band: angular frequencies and powers (mean squares).
    ///
    /// # Panics
    /// If there are no lines, or of different number, which is a mistake of the caller.
    #[must_use]
    pub fn new(plant: SampledPlant, omegas: &[f64], powers: &[f64], reference: Vec<f64>) -> Self {
        assert!(!omegas.is_empty() && omegas.len() == powers.len(), "the lines of a band");
        let time = plant.time();
        let lines =
            omegas.iter().zip(powers).map(|(w, s)| (time.point(*w), plant.response(*w), *s)).collect::<Vec<_>>();
        let reference_sfm = flatness(powers.iter().copied());
        let following = Following::new(&plant, reference.clone());
        let norm = NormGrid::new(&plant);
        Self { plant, lines, reference, reference_sfm, following, norm }
    }

    /// What the device follows from rest.
    #[must_use]
    pub fn reference(&self) -> &[f64] {
        &self.reference
    }

    /// σ_r²: the mean of the reference's powers over the lines of the band.
    #[must_use]
    pub fn reference_mean(&self) -> f64 {
        self.lines.iter().map(|(_, _, s)| s).sum::<f64>() / self.lines.len() as f64
    }

    /// The position's powers at the lines of the band.
    fn output_powers(&self, compensator: &Compensator) -> Vec<f64> {
        let (num, den) = compensator.coefficients(self.plant.time());
        let horner = |p: &[f64], z: Complex64| p.iter().fold(Complex64::new(0.0, 0.0), |sum, c| sum * z + c);
        let power = |(z, p, s): &(Complex64, Complex64, f64)| {
            // C P/(1 + C P), with one division.
            let (above, below) = (p * horner(num.coefficients(), *z), horner(den.coefficients(), *z));
            above.norm_sqr() / (above + below).norm_sqr() * s
        };
        self.lines.iter().map(power).collect()
    }

    /// γ_r² of the band.
    #[must_use]
    pub fn reference_sfm(&self) -> f64 {
        self.reference_sfm
    }

    /// The plant.
    #[must_use]
    pub fn plant(&self) -> &SampledPlant {
        &self.plant
    }

    /// The gain at which the loop gain is 1 at the upper end of the band.
    #[must_use]
    pub fn typical_gain(&self) -> f64 {
        self.lines.last().map_or(1.0, |(_, p, _)| p.norm().recip())
    }

    fn loop_polynomial(&self, compensator: &Compensator) -> Polynomial {
        let (num, den) = compensator.coefficients(self.plant.time());
        let plant = self.plant.sampled();
        plant.den().mul(&den).add(&plant.num().mul(&num))
    }

    /// Whether Jury's test proves every root of the loop inside the circle of this decay rate.
    #[must_use]
    pub fn is_stable(&self, compensator: &Compensator, decay_per_s: f64) -> bool {
        let polynomial = self.loop_polynomial(compensator);
        let (_, den) = compensator.coefficients(self.plant.time());
        // A degree that is lost is an algebraic loop without solution.
        polynomial.degree() == self.plant.sampled().den().degree() + den.degree()
            && stability::is_stable(&polynomial, &self.plant.time(), decay_per_s)
    }

    /// SFG_xr of the band; nothing is checked.
    #[must_use]
    pub fn blsfg(&self, compensator: &Compensator) -> f64 {
        flatness(self.output_powers(compensator).into_iter()) / self.reference_sfm
    }

    /// ‖S P‖∞ of a stable loop.
    #[must_use]
    pub fn disturbance_norm(&self, compensator: &Compensator) -> Peak {
        self.norm_up_to(compensator, f64::INFINITY)
    }

    /// The same, or some gain that exceeds `enough`.
    fn norm_up_to(&self, compensator: &Compensator, enough: f64) -> Peak {
        let (_, den) = compensator.coefficients(self.plant.time());
        let closed = self.loop_polynomial(compensator);
        self.norm.supremum(&self.plant, &den, &closed, enough)
    }

    /// The motion from rest over the reference.
    ///
    /// # Errors
    /// [`PathError`].
    pub fn motion(&self, path: &Path, limits: &MotionLimits, ctl: &Ctl) -> Result<MotionSummary, PathError> {
        let carried = path.carry(&self.reference, ctl)?;
        Ok(Motion::of_plant(&self.plant, &carried.output, &carried.effort, ctl)?.summary(limits))
    }

    /// The path of a compensator.
    ///
    /// # Errors
    /// [`PathError`], of which [`PathError::Unstable`].
    pub fn path(&self, compensator: &Compensator) -> Result<Path, PathError> {
        Path::closed(self.plant.clone(), &System::Discrete(compensator.sampled(self.plant.time())?))
    }

    /// Everything about one compensator.
    ///
    /// # Errors
    /// [`PathError`], of which [`PathError::Unstable`].
    pub fn judge(&self, compensator: &Compensator, limits: &DesignLimits, ctl: &Ctl) -> Result<Judged, PathError> {
        let path = self.path(compensator)?;
        let time = self.plant.time();
        let blsfg = self.blsfg(compensator);
        let hints = path.pole_hints();
        let gain = |w: f64| path.response(w).norm();
        let poles = self.loop_polynomial(compensator).roots()?;
        let oscillation = poles
            .iter()
            .map(|z| time.exponent(*z))
            .filter(|l| l.im > 0.0 && l.is_finite())
            .map(|l| [l.norm(), -l.re / l.norm()])
            .min_by(|a, b| a[1].total_cmp(&b[1]));
        Ok(Judged {
            compensator: compensator.clone(),
            blsfg,
            output_sfm: blsfg * self.reference_sfm,
            output_mean: self.output_powers(compensator).iter().sum::<f64>() / self.lines.len() as f64,
            resonance: resonance(gain, PI / time.period_s(), &hints),
            disturbance: self.disturbance_norm(compensator),
            poles,
            oscillation,
            motion: self.motion(&path, &limits.motion(), ctl)?,
        })
    }

    /// By how much a stable loop breaks its limits: the largest logarithm of what is reached over what is allowed, no
    /// larger than zero where all are kept, and infinite where a pole decays too slowly. With `is_enough` the first
    /// that is broken ends it.
    pub(super) fn excess(&self, compensator: &Compensator, limits: &DesignLimits, is_enough: bool) -> f64 {
        if limits.decay_per_s.is_some_and(|decay| decay > 0.0 && !self.is_stable(compensator, decay)) {
            return f64::INFINITY;
        }
        let mut most = f64::NEG_INFINITY;
        let mut over = |reached: f64, limit: f64| {
            most = most.max((reached / (limit * WITHIN)).ln());
            is_enough && most > 0.0
        };
        let quick = self.quick(limits);
        let enough = |limit: f64| if is_enough { limit * WITHIN } else { f64::INFINITY };
        // The norm takes the least time.
        if let Some(limit) = limits.disturbance_norm
            && over(self.norm_up_to(compensator, enough(limit)).value, limit)
        {
            return most;
        }
        if !quick.is_empty() {
            let Some(following) = self.following.as_ref().and_then(|following| following.with(compensator)) else {
                return f64::INFINITY;
            };
            for (_, limited, limit) in &quick {
                if over(following.peak(*limited, enough(*limit)), *limit) {
                    return most;
                }
            }
        }
        for (_, reached, limit) in self.slow(compensator, limits) {
            over(reached, limit);
        }
        most
    }

    /// Whether a stable loop keeps all limits.
    pub(super) fn keeps(&self, compensator: &Compensator, limits: &DesignLimits) -> bool {
        self.excess(compensator, limits, true) <= 0.0
    }

    /// Each limited quantity of a stable loop by name: what it reaches, and its limit.
    pub(super) fn reached(&self, compensator: &Compensator, limits: &DesignLimits) -> Vec<(&'static str, f64, f64)> {
        let mut found = self.slow(compensator, limits);
        if let Some(limit) = limits.disturbance_norm {
            found.push(("disturbance_norm", self.disturbance_norm(compensator).value, limit));
        }
        if let Some(following) = self.following.as_ref().and_then(|following| following.with(compensator)) {
            let peak = |limited| following.peak(limited, f64::INFINITY);
            found.extend(self.quick(limits).into_iter().map(|(name, limited, limit)| (name, peak(limited), limit)));
        }
        found
    }

    /// Limited quantities that the states tell.
    fn quick(&self, limits: &DesignLimits) -> Vec<(&'static str, Limited, f64)> {
        let all = [
            ("force", Limited::Force, limits.force),
            ("position", Limited::Position, limits.position),
            ("velocity", Limited::Velocity, limits.velocity),
            ("acceleration", Limited::Acceleration, limits.acceleration),
            ("power", Limited::Power, limits.power),
        ];
        let known = |limited| self.following.as_ref().is_some_and(|following| following.knows(limited));
        all.into_iter()
            .filter(|(_, limited, _)| known(*limited))
            .filter_map(|(n, l, limit)| Some((n, l, limit?)))
            .collect()
    }

    /// Those for which the motion must be simulated: velocity, acceleration and power as differences of samples, and
    /// all of a plant without a state space form.
    fn slow(&self, compensator: &Compensator, limits: &DesignLimits) -> Vec<(&'static str, f64, f64)> {
        let unknown = |limited: Limited, limit: Option<f64>| {
            limit.filter(|_| !self.following.as_ref().is_some_and(|following| following.knows(limited)))
        };
        let motion = MotionLimits {
            position: unknown(Limited::Position, limits.position),
            velocity: unknown(Limited::Velocity, limits.velocity),
            acceleration: unknown(Limited::Acceleration, limits.acceleration),
            force: unknown(Limited::Force, limits.force),
            power: unknown(Limited::Power, limits.power),
        };
        if motion.is_empty() {
            return Vec::new();
        }
        let Ok(summary) = self.path(compensator).and_then(|path| self.motion(&path, &motion, &Ctl::new())) else {
            return vec![("motion", f64::INFINITY, 1.0)];
        };
        let named = [
            ("position", summary.position),
            ("velocity", summary.velocity),
            ("acceleration", summary.acceleration),
            ("force", summary.force),
            ("power", summary.power),
        ];
        let limited = |(name, extent): (&'static str, Option<crate::excite::motion::Extent>)| {
            let extent = extent?;
            Some((name, extent.peak, extent.limit?))
        };
        named.into_iter().filter_map(limited).collect()
    }
}
