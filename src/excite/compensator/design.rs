//! A compensator, and how good its loop is.

use crate::control::{Discrete, System, TimeBase as _, TransferFunction, stability};
use crate::excite::flatness::flatness;
use crate::excite::motion::{Motion, MotionLimits, MotionSummary};
use crate::excite::path::{Path, PathError, SampledPlant, pole_hints};
use crate::excite::peak::{Peak, resonance, supremum};
use crate::num::{Complex64, Polynomial};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// `C(s) = K (s + 2πf_z)/(s + 2πf_p)`: a lead where f_z < f_p, a lag where f_z > f_p, proportional where they are
/// equal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Compensator {
    /// K, in force per position: the gain at high frequency.
    pub gain: f64,
    /// f_z, Hz.
    pub zero_hz: f64,
    /// f_p, Hz.
    pub pole_hz: f64,
}

impl Compensator {
    /// Proportional control.
    #[must_use]
    pub fn proportional(gain: f64) -> Self {
        Self { gain, zero_hz: 1.0, pole_hz: 1.0 }
    }

    /// Numerator and denominator in z by Tustin's substitution (Qiu 2021, before equation 17); constants for equal
    /// corners.
    fn coefficients(&self, time: Discrete) -> (Vec<f64>, Vec<f64>) {
        if self.zero_hz == self.pole_hz {
            return (vec![self.gain], vec![1.0]);
        }
        let k = 2.0 / time.period_s();
        let (z, p) = (2.0 * PI * self.zero_hz, 2.0 * PI * self.pole_hz);
        let scale = self.gain / (k + p);
        (vec![scale * (k + z), scale * (z - k)], vec![1.0, (p - k) / (k + p)])
    }

    /// The controller in sampled time.
    ///
    /// # Errors
    /// [`PathError`] for coefficients that are not finite.
    pub fn sampled(&self, time: Discrete) -> Result<TransferFunction<Discrete>, PathError> {
        let (num, den) = self.coefficients(time);
        TransferFunction::new(&num, &den, time)
            .map_err(|error| PathError::Discretise(crate::control::discretise::DiscretiseError::from(error)))
    }
}

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
    /// A plant and the reference's lines in the band: angular frequencies and powers.
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
        Self { plant, lines, reference, reference_sfm }
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
        plant.den().mul(&Polynomial::new(den)).add(&plant.num().mul(&Polynomial::new(num)))
    }

    /// Whether Jury's test proves every root of the loop inside the circle of this decay rate.
    #[must_use]
    pub fn is_stable(&self, compensator: &Compensator, decay_per_s: f64) -> bool {
        let polynomial = self.loop_polynomial(compensator);
        let (_, den) = compensator.coefficients(self.plant.time());
        // A degree that is lost is an algebraic loop without solution.
        polynomial.degree() == self.plant.sampled().den().degree() + den.len() - 1
            && stability::is_stable(&polynomial, &self.plant.time(), decay_per_s)
    }

    /// SFG_xr of the band; nothing is checked.
    #[must_use]
    pub fn blsfg(&self, compensator: &Compensator) -> f64 {
        let (num, den) = compensator.coefficients(self.plant.time());
        let horner = |p: &[f64], z: Complex64| p.iter().fold(Complex64::new(0.0, 0.0), |sum, c| sum * z + c);
        let powers = self.lines.iter().map(|(z, p, s)| {
            let open = p * horner(&num, *z) / horner(&den, *z);
            (open / (1.0 + open)).norm_sqr() * s
        });
        flatness(powers) / self.reference_sfm
    }

    /// ‖S P‖∞ of a stable loop.
    #[must_use]
    pub fn disturbance_norm(&self, compensator: &Compensator) -> Peak {
        let time = self.plant.time();
        let (_, den) = compensator.coefficients(time);
        let closed = self.loop_polynomial(compensator);
        let (num, den) = (self.plant.sampled().num().clone(), Polynomial::new(den));
        let gain = |w: f64| {
            let z = time.point(w);
            (num.eval(z) * den.eval(z) / closed.eval(z)).norm()
        };
        supremum(gain, PI / time.period_s(), &pole_hints(&closed, time))
    }

    /// The motion from rest over the reference.
    ///
    /// # Errors
    /// [`PathError`].
    pub fn motion(&self, path: &Path, limits: &MotionLimits) -> Result<MotionSummary, PathError> {
        let carried = path.carry(&self.reference)?;
        Ok(Motion::of_plant(&self.plant, &carried.output, &carried.effort)?.summary(limits))
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
    pub fn judge(&self, compensator: &Compensator, limits: &DesignLimits) -> Result<Judged, PathError> {
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
            compensator: *compensator,
            blsfg,
            output_sfm: blsfg * self.reference_sfm,
            resonance: resonance(gain, PI / time.period_s(), &hints),
            disturbance: self.disturbance_norm(compensator),
            poles,
            oscillation,
            motion: self.motion(&path, &limits.motion())?,
        })
    }

    /// The peak force over the reference, or the first that exceeds `enough`, by a filter in plain arithmetic, for
    /// comparing many compensators; the answer's own is computed by [`Design::motion`].
    fn quick_force(&self, compensator: &Compensator, enough: f64) -> f64 {
        let (num, _) = compensator.coefficients(self.plant.time());
        let closed = self.loop_polynomial(compensator);
        let b = self.plant.sampled().den().mul(&Polynomial::new(num));
        let a = closed.coefficients();
        let mut padded = vec![0.0; a.len() - b.coefficients().len().min(a.len())];
        padded.extend_from_slice(b.coefficients());
        let mut state = vec![0.0; a.len()];
        let n = a.len() - 1;
        let mut peak = 0.0_f64;
        for r in &self.reference {
            let y = (padded[0] * r + state[0]) / a[0];
            for i in 0..n {
                state[i] = state[i + 1] + padded[i + 1] * r - a[i + 1] * y;
            }
            peak = peak.max(y.abs());
            if peak > enough {
                break;
            }
        }
        peak
    }

    /// Whether a stable loop keeps all limits.
    pub(super) fn keeps(&self, compensator: &Compensator, limits: &DesignLimits) -> bool {
        let decays = limits.decay_per_s.is_none_or(|decay| decay == 0.0 || self.is_stable(compensator, decay));
        decays
            && limits.disturbance_norm.is_none_or(|limit| self.disturbance_norm(compensator).value <= limit)
            && limits.force.is_none_or(|limit| self.quick_force(compensator, limit) <= limit)
            && self.limited_motion(compensator, limits).iter().all(|(_, reached, limit)| reached <= limit)
    }

    /// Each limited quantity of a stable loop by name: what it reaches, and its limit.
    pub(super) fn reached(&self, compensator: &Compensator, limits: &DesignLimits) -> Vec<(&'static str, f64, f64)> {
        let mut found = self.limited_motion(compensator, limits);
        if let Some(limit) = limits.disturbance_norm {
            found.push(("disturbance_norm", self.disturbance_norm(compensator).value, limit));
        }
        if let Some(limit) = limits.force {
            found.push(("force", self.quick_force(compensator, f64::INFINITY), limit));
        }
        found
    }

    /// Those of the limited quantities for which the motion must be simulated.
    fn limited_motion(&self, compensator: &Compensator, limits: &DesignLimits) -> Vec<(&'static str, f64, f64)> {
        let motion = MotionLimits { force: None, ..limits.motion() };
        if motion.is_empty() {
            return Vec::new();
        }
        let Ok(summary) = self.path(compensator).and_then(|path| self.motion(&path, &motion)) else {
            return vec![("motion", f64::INFINITY, 0.0)];
        };
        let named = [
            ("position", summary.position),
            ("velocity", summary.velocity),
            ("acceleration", summary.acceleration),
            ("power", summary.power),
        ];
        let limited = |(name, extent): (&'static str, Option<crate::excite::motion::Extent>)| {
            let extent = extent?;
            Some((name, extent.peak, extent.limit?))
        };
        named.into_iter().filter_map(limited).collect()
    }
}
