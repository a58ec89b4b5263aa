//! What the question is answered with.

use crate::analysis::excitation::plant::PlantFit;
use crate::control::model::TransferFunctionModel;
use crate::excite::compensator::{Compensator, Curve, Design, DesignLimits, Edge, Found, Judged, Section};
use crate::excite::flatness::{Band, circle_mean};
use crate::excite::motion::MotionSummary;
use crate::excite::path::PathError;
use schemars::JsonSchema;
use serde::Serialize;
use std::f64::consts::PI;

/// The best proportional control of the same plant, signal, band and limits.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "CompensatorBaseline")]
pub struct BaselineResult {
    /// K, in units of force over those of the position.
    pub gain: f64,
    /// SFG_xr, the spectral flatness gain, dimensionless.
    pub blsfg: f64,
    /// The resonance, Hz; null without one.
    pub resonance_hz: Option<f64>,
    /// ‖S P‖∞, in units of the position over those of the force.
    pub disturbance_norm: f64,
    /// The answer's flatness gain over this one's, dimensionless.
    pub improvement: f64,
}

/// The best compensator of a climb that ended elsewhere.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "CompensatorRunnerUp")]
pub struct RunnerUpResult {
    /// K, in units of force over those of the position.
    pub gain: f64,
    /// f_z, Hz; null for proportional control, and of several sections.
    pub zero_hz: Option<f64>,
    /// f_p, Hz; null for proportional control, and of several sections.
    pub pole_hz: Option<f64>,
    /// The sections.
    pub sections: Vec<SectionResult>,
    /// SFG_xr, the spectral flatness gain, dimensionless.
    pub blsfg: f64,
}

/// A section: `(s + 2πf_z)/(s + 2πf_p)`, or, with damping ratios, `(s² + 2ζ_z ω_z s + ω_z²)/(s² + 2ζ_p ω_p s + ω_p²)`
/// with ω = 2πf.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "CompensatorSection")]
pub struct SectionResult {
    /// f_z, Hz.
    pub zero_hz: f64,
    /// ζ_z, dimensionless; null of first order.
    pub zero_damping: Option<f64>,
    /// f_p, Hz.
    pub pole_hz: f64,
    /// ζ_p, dimensionless; null of first order.
    pub pole_damping: Option<f64>,
}

impl From<&Section> for SectionResult {
    fn from(section: &Section) -> Self {
        match *section {
            Section::First { zero_hz, pole_hz } => Self { zero_hz, zero_damping: None, pole_hz, pole_damping: None },
            Section::Second { zero_hz, zero_damping, pole_hz, pole_damping } => {
                Self { zero_hz, zero_damping: Some(zero_damping), pole_hz, pole_damping: Some(pole_damping) }
            }
        }
    }
}

/// What was searched.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "CompensatorSearch")]
pub struct SearchResult {
    /// Points of the grid over the box.
    pub points: usize,
    /// Those whose loop Jury's test proves stable.
    pub stable: usize,
    /// Climbs from local maxima of the grid.
    pub climbs: usize,
    /// Those that ended in the answer.
    pub agreeing: usize,
    /// The best of the others; null where all agree.
    pub runner_up: Option<RunnerUpResult>,
    /// Edges of the box that hold the answer.
    pub edges: Vec<Edge>,
}

/// A curve over the gain; arrays are equally long, and null where the loop is not stable.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "CompensatorCurve")]
pub struct CurveResult {
    /// f_z, Hz; null for proportional control.
    pub zero_hz: Option<f64>,
    /// f_p, Hz; null for proportional control.
    pub pole_hz: Option<f64>,
    /// K, in units of force over those of the position.
    pub gain: Vec<f64>,
    /// SFG_xr, the spectral flatness gain, dimensionless.
    pub blsfg: Vec<Option<f64>>,
    /// The resonance, Hz; null also where there is none.
    pub resonance_hz: Vec<Option<f64>>,
    /// ‖S P‖∞, in units of the position over those of the force.
    pub disturbance_norm: Vec<Option<f64>>,
}

impl CurveResult {
    pub(super) fn new(curve: &Curve) -> Self {
        Self {
            zero_hz: curve.corners.map(|c| c[0]),
            pole_hz: curve.corners.map(|c| c[1]),
            gain: curve.gain.clone(),
            blsfg: curve.blsfg.clone(),
            resonance_hz: curve.resonance_rad_s.iter().map(|w| w.map(hz)).collect(),
            disturbance_norm: curve.disturbance_norm.clone(),
        }
    }
}

/// What a flatness gain is made of (Qiu 2021): over the lines of the band, powers being mean squares.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "CompensatorFlatness")]
pub struct FlatnessParts {
    /// η_r², the geometric mean of the reference's powers, in squared units of the position.
    pub reference_geometric_mean: f64,
    /// σ_r², their arithmetic mean, in the same unit.
    pub reference_arithmetic_mean: f64,
    /// μ_r = −ln γ_r² (equation 24, whose value is never negative), dimensionless.
    pub reference_mu: f64,
    /// η_x² of the position, in squared units of it.
    pub output_geometric_mean: f64,
    /// σ_x² of the position, in squared units of it.
    pub output_arithmetic_mean: f64,
    /// μ_x, dimensionless.
    pub output_mu: f64,
    /// η_G² = η_x²/η_r² (equation 5), dimensionless.
    pub system_geometric_mean: f64,
    /// R_rr(0)/R_xx(0) of the band, dimensionless: times η_G² it is the flatness gain (equation 7).
    pub power_ratio: f64,
    /// b_m²: the squared leading coefficient of the closed loop's numerator over a monic denominator (equation 13),
    /// dimensionless; null where its zeros cannot be found.
    pub leading_coefficient_squared: Option<f64>,
    /// Π max(1, |z_i|²) over its zeros: times b_m² it is η_G² over all frequencies, dimensionless; null as b_m².
    pub zeros_outside_factor: Option<f64>,
}

/// What a compensator does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "CompensatorAction")]
pub enum Action {
    /// `C = K`.
    Proportional,
    /// f_z < f_p.
    Lead,
    /// f_z > f_p.
    Lag,
    /// Several sections, or one of second order.
    Several,
}

/// The result of `compensator_design`.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct CompensatorDesignResult {
    /// K, the gain at high frequency, in units of force over those of the position.
    pub gain: f64,
    /// f_z, Hz; null for proportional control, and of several sections.
    pub zero_hz: Option<f64>,
    /// f_p, Hz; null for proportional control, and of several sections.
    pub pole_hz: Option<f64>,
    /// The sections, those left out that are 1 at every frequency.
    pub sections: Vec<SectionResult>,
    /// What it does.
    pub action: Action,
    /// The band in Hz, as asked for.
    pub band_hz: Band,
    /// SFG_xr of the band: `output_sfm / reference_sfm` (equation 16), dimensionless.
    pub blsfg: f64,
    /// γ_r², the flatness of the signal, dimensionless.
    pub reference_sfm: f64,
    /// γ_x², the flatness of the position, dimensionless.
    pub output_sfm: f64,
    /// What the flatness is made of.
    pub flatness: FlatnessParts,
    /// Where the gain from reference to position is largest, Hz; null where it nowhere exceeds that at 0 Hz.
    pub resonance_hz: Option<f64>,
    /// The gain there, dimensionless; null without one.
    pub resonance_gain: Option<f64>,
    /// ‖S P‖∞: the largest gain from a person's force to the position, in their units.
    pub disturbance_norm: f64,
    /// Where it is reached, Hz.
    pub disturbance_norm_hz: f64,
    /// Natural frequency of the least damped pair of poles, Hz; null without one.
    pub natural_hz: Option<f64>,
    /// Its damping ratio, dimensionless; null without one.
    pub damping_ratio: Option<f64>,
    /// The closed-loop poles in z as `[re, im]`, dimensionless.
    pub poles: Vec<[f64; 2]>,
    /// The largest magnitude of a pole, dimensionless; that it is below 1 was proven by Jury's test, with rounding
    /// bounded.
    pub spectral_radius: f64,
    /// The decay of the slowest pole, 1/s.
    pub slowest_decay_per_s: f64,
    /// The decay that was asked of every pole, or taken by default.
    pub required_decay_per_s: f64,
    /// The controller in z, from position error to force.
    pub controller: TransferFunctionModel,
    /// From reference to position in z, dimensionless.
    pub closed_loop: TransferFunctionModel,
    /// Motion and force while the loop follows the signal from rest: two periods, or the record.
    pub motion: MotionSummary,
    /// The best proportional control; null where it is the answer itself, or where none keeps the limits.
    pub proportional: Option<BaselineResult>,
    /// How it was found.
    pub search: SearchResult,
    /// Curves; empty unless asked for.
    pub sweep: Vec<CurveResult>,
    /// The model of a measured plant; null of others.
    pub plant_fit: Option<PlantFit>,
}

fn hz(omega_rad_s: f64) -> f64 {
    omega_rad_s / (2.0 * PI)
}

/// f_z and f_p of a single section of first order.
fn corners(compensator: &Compensator) -> Option<[f64; 2]> {
    let mut active = compensator.active();
    match (active.next(), active.next()) {
        (Some(Section::First { zero_hz, pole_hz }), None) => Some([*zero_hz, *pole_hz]),
        _ => None,
    }
}

impl CompensatorDesignResult {
    #[expect(clippy::too_many_arguments, reason = "one call, of what the run has at hand")]
    pub(super) fn new(
        plant_fit: Option<PlantFit>,
        band_hz: Band,
        limits: &DesignLimits,
        design: &Design,
        found: &Found,
        judged: &Judged,
        baseline: Option<&Judged>,
        sweep: Vec<CurveResult>,
    ) -> Result<Self, PathError> {
        let compensator = &judged.compensator;
        let path = design.path(compensator)?;
        let controller = compensator.sampled(design.plant().time())?;
        let closed = path
            .loop_()
            .map(|closed| closed.command_to_output_transfer_function())
            .transpose()
            .map_err(|error| PathError::Discretise(error.into()))?;
        let own = corners(compensator);
        let sections: Vec<SectionResult> = compensator.active().map(Into::into).collect();
        let action = match own {
            None if sections.is_empty() => Action::Proportional,
            None => Action::Several,
            Some([zero, pole]) if zero < pole => Action::Lead,
            Some(_) => Action::Lag,
        };
        let summary = &found.summary;
        let circle = closed.as_ref().and_then(circle_mean);
        let (reference_mean, output_mean) = (design.reference_mean(), judged.output_mean);
        let (reference_sfm, output_sfm) = (design.reference_sfm(), judged.output_sfm);
        let flatness = FlatnessParts {
            reference_geometric_mean: reference_sfm * reference_mean,
            reference_arithmetic_mean: reference_mean,
            reference_mu: -reference_sfm.ln(),
            output_geometric_mean: output_sfm * output_mean,
            output_arithmetic_mean: output_mean,
            output_mu: -output_sfm.ln(),
            system_geometric_mean: output_sfm * output_mean / (reference_sfm * reference_mean),
            power_ratio: reference_mean / output_mean,
            leading_coefficient_squared: circle.map(|c| c[0]),
            zeros_outside_factor: circle.map(|c| c[1]),
        };
        Ok(Self {
            gain: compensator.gain,
            zero_hz: own.map(|c| c[0]),
            pole_hz: own.map(|c| c[1]),
            sections,
            action,
            band_hz,
            blsfg: judged.blsfg,
            reference_sfm: design.reference_sfm(),
            output_sfm: judged.output_sfm,
            flatness,
            resonance_hz: judged.resonance.map(|peak| hz(peak.at)),
            resonance_gain: judged.resonance.map(|peak| peak.value),
            disturbance_norm: judged.disturbance.value,
            disturbance_norm_hz: hz(judged.disturbance.at),
            natural_hz: judged.oscillation.map(|pair| hz(pair[0])),
            damping_ratio: judged.oscillation.map(|pair| pair[1]),
            poles: judged.poles.iter().map(|z| [z.re, z.im]).collect(),
            spectral_radius: judged.poles.iter().map(|z| z.norm()).fold(0.0, f64::max),
            slowest_decay_per_s: judged
                .poles
                .iter()
                .map(|z| -z.norm().ln() / design.plant().time().period_s())
                .fold(f64::INFINITY, f64::min)
                .min(f64::MAX),
            required_decay_per_s: limits.decay_per_s.unwrap_or(0.0),
            closed_loop: closed.as_ref().map_or_else(|| (&controller).into(), Into::into),
            controller: (&controller).into(),
            motion: judged.motion.clone(),
            proportional: baseline.map(|baseline| BaselineResult {
                gain: baseline.compensator.gain,
                blsfg: baseline.blsfg,
                resonance_hz: baseline.resonance.map(|peak| hz(peak.at)),
                disturbance_norm: baseline.disturbance.value,
                improvement: judged.blsfg / baseline.blsfg,
            }),
            search: SearchResult {
                points: summary.points,
                stable: summary.stable,
                climbs: summary.climbs,
                agreeing: summary.agreeing,
                runner_up: summary.runner_up.as_ref().map(|(compensator, blsfg)| {
                    let corners = corners(compensator);
                    RunnerUpResult {
                        gain: compensator.gain,
                        zero_hz: corners.map(|c| c[0]),
                        pole_hz: corners.map(|c| c[1]),
                        sections: compensator.active().map(Into::into).collect(),
                        blsfg: *blsfg,
                    }
                }),
                edges: summary.edges.clone(),
            },
            sweep,
            plant_fit,
        })
    }
}
