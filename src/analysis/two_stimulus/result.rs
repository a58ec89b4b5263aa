//! The result of a two-stimulus estimate.

use super::pool::PoolResult;
use super::prediction::{Ceiling, RegularisedResult};
use super::shares::Shares;
use crate::two_stimulus::controllers::{Controllers, Estimated, LineControllers};
use crate::two_stimulus::fit::{Band, Fitted};
use crate::two_stimulus::responses::NoiseSource;
use crate::two_stimulus::structure::Structure;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Probability of every band.
pub(super) const PROBABILITY: f64 = 0.95;

pub(super) fn pair(z: Complex64) -> [f64; 2] {
    [z.re, z.im]
}

/// A controller's response at a line, with its 95 % bands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControllerAtLine {
    /// The value as `[re, im]`.
    pub value: [f64; 2],
    /// Band of its magnitude; null where the noise (or the error of interpolation) is not known.
    pub magnitude_95: Option<[f64; 2]>,
    /// Half-width of the band of its phase in rad.
    pub phase_half_width_95_rad: Option<f64>,
    /// `E|δ|²` from noise.
    pub variance: Option<f64>,
    /// Whether the feedback was interpolated between neighbouring lines of the disturbance.
    pub interpolated: bool,
    /// The relative error that interpolation may have, by divided differences; null where it cannot be told.
    pub interpolation_error: Option<f64>,
}

impl From<&Estimated> for ControllerAtLine {
    fn from(estimated: &Estimated) -> Self {
        let size = estimated.value.norm();
        let width = estimated.half_width(PROBABILITY).filter(|w| w.is_finite());
        Self {
            value: pair(estimated.value),
            magnitude_95: width.map(|w| [size * (-w).exp(), size * w.exp()]).filter(|b| b[1].is_finite()),
            phase_half_width_95_rad: width.map(|w| w.min(std::f64::consts::PI)),
            variance: estimated.variance,
            interpolated: estimated.interpolated,
            interpolation_error: estimated.interpolation_error.filter(|e| e.is_finite()),
        }
    }
}

/// A line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TwoStimulusLine {
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// From command to control as `[re, im]`; null where the command does not excite the line.
    pub h_ur: Option<[f64; 2]>,
    /// From command to output.
    pub h_yr: Option<[f64; 2]>,
    /// From disturbance to control; null where the disturbance does not excite the line.
    pub h_ud: Option<[f64; 2]>,
    /// From disturbance to output.
    pub h_yd: Option<[f64; 2]>,
    /// Gfb without any assumption about its structure.
    pub feedback: Option<ControllerAtLine>,
    /// Gff likewise.
    pub feedforward: Option<ControllerAtLine>,
    /// Where the noise is taken from.
    pub noise_source: Option<NoiseSource>,
    /// Complex degrees of freedom behind it; null where it was given.
    pub degrees_of_freedom: Option<f64>,
    /// Trials that excite the line with the command.
    pub command_trials: usize,
    /// Trials that excite it with the disturbance.
    pub disturbance_trials: usize,
}

impl From<&LineControllers> for TwoStimulusLine {
    fn from(line: &LineControllers) -> Self {
        let response = &line.response;
        Self {
            frequency_hz: response.frequency_hz,
            omega_rad_s: response.omega_rad_s,
            h_ur: response.command.map(|h| pair(h[0])),
            h_yr: response.command.map(|h| pair(h[1])),
            h_ud: response.disturbance.map(|h| pair(h[0])),
            h_yd: response.disturbance.map(|h| pair(h[1])),
            feedback: line.feedback.as_ref().map(Into::into),
            feedforward: line.feedforward.as_ref().map(Into::into),
            noise_source: response.source,
            degrees_of_freedom: response.source.map(|_| response.freedoms).filter(|f| f.is_finite()),
            command_trials: response.trials[0],
            disturbance_trials: response.trials[1],
        }
    }
}

/// A fitted parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FittedParameter {
    /// Its name, with its unit.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its 95 % interval; null at an edge of its range, or where the lines do not determine it.
    pub interval_95: Option<[f64; 2]>,
    /// Whether it lies on the edge of its range.
    pub at_edge: bool,
}

/// A fitted controller at a line, with its 95 % bands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FittedAtLine {
    /// The value as `[re, im]`.
    pub value: [f64; 2],
    /// Band of its magnitude.
    pub magnitude_95: Option<[f64; 2]>,
    /// Half-width of the band of its phase in rad.
    pub phase_half_width_95_rad: Option<f64>,
}

/// Both controllers of a fit at a line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FittedLine {
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// Gfb.
    pub feedback: FittedAtLine,
    /// Gff.
    pub feedforward: FittedAtLine,
}

/// How far the fit and the estimate without structure agree.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Agreement {
    /// Magnitudes and phases compared.
    pub compared: usize,
    /// Those that differ by less than both 95 % half-widths, added in squares.
    pub within: usize,
}

/// A structure and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StructureFit {
    /// The structure.
    pub structure: Structure,
    /// Why it could not be fitted; everything else is null then.
    pub reason: Option<String>,
    /// Its parameters.
    pub parameters: Vec<FittedParameter>,
    /// `J = Σ e* C⁻¹ e`, or the plain sum of squares where the noise is not known.
    pub cost: Option<f64>,
    /// `2 J` over its degrees of freedom: 1 for a structure and a noise that are right.
    pub reduced_chi_square: Option<f64>,
    /// The probability of a larger one.
    pub p_value: Option<f64>,
    /// `2 J + 2 p`; smaller is better.
    pub akaike: Option<f64>,
    /// Starts of the search that came to the same cost, of all.
    pub starts_agreeing: Option<[usize; 2]>,
    /// Line by line.
    pub lines: Vec<FittedLine>,
    /// Whether it agrees with the estimate without structure.
    pub agreement: Option<Agreement>,
    /// On the trials that it was fitted to.
    pub simulated_vaf: Option<Shares>,
    /// On the trials of `validate_on`.
    pub held_out_vaf: Option<Shares>,
}

/// The result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TwoStimulusResult {
    /// Line by line, without any assumption about structure.
    pub lines: Vec<TwoStimulusLine>,
    /// Root mean square of `Gff G − 1` over the lines that have it: 0 for a feedforward that is the plant's inverse.
    pub inverse_distance: Option<f64>,
    /// Structure by structure, in the order of the spec.
    pub fits: Vec<StructureFit>,
    /// The best candidate of the pool; null where the spec has none.
    pub pool: Option<PoolResult>,
    /// How much of the trials' variation a linear response to the stimuli could account for; null with responses in the
    /// request.
    #[serde(default)]
    pub ceiling: Option<Ceiling>,
    /// The estimate shrunk towards the best structure; null unless the spec asks for it.
    #[serde(default)]
    pub regularised: Option<RegularisedResult>,
    /// Position of the structure with the smallest `akaike`; null where none has one.
    pub best: Option<usize>,
}

pub(super) fn fitted_at_line(band: &Band, quantile: f64) -> FittedAtLine {
    let size = band.value.norm();
    let width = band.deviation.map(|d| d.map(|d| quantile * d)).filter(|d| d.iter().all(|d| d.is_finite()));
    FittedAtLine {
        value: pair(band.value),
        magnitude_95: width.map(|[w, _]| [size * (-w).exp(), size * w.exp()]).filter(|b| b[1].is_finite()),
        phase_half_width_95_rad: width.map(|[_, w]| w.min(std::f64::consts::PI)),
    }
}

impl StructureFit {
    pub(super) fn failed(structure: Structure, reason: String) -> Self {
        Self {
            structure,
            reason: Some(reason),
            parameters: Vec::new(),
            cost: None,
            reduced_chi_square: None,
            p_value: None,
            akaike: None,
            starts_agreeing: None,
            lines: Vec::new(),
            agreement: None,
            simulated_vaf: None,
            held_out_vaf: None,
        }
    }

    pub(super) fn new(
        fitted: &Fitted,
        free: &Controllers,
        simulated_vaf: Option<Shares>,
        held_out_vaf: Option<Shares>,
    ) -> Self {
        let quantile = fitted.quantile(PROBABILITY);
        let parameters = fitted
            .parameters
            .iter()
            .map(|p| FittedParameter {
                name: p.name.clone(),
                value: p.value,
                interval_95: p
                    .half_width
                    .map(|h| {
                        if p.logarithmic {
                            [p.value * (-h).exp(), p.value * h.exp()]
                        } else {
                            [p.value - h, p.value + h]
                        }
                    })
                    .filter(|i| i.iter().all(|v| v.is_finite())),
                at_edge: p.at_edge,
            })
            .collect();
        let lines = free
            .lines
            .iter()
            .map(|line| {
                let bands = fitted.bands(line.response.omega_rad_s);
                FittedLine {
                    frequency_hz: line.response.frequency_hz,
                    feedback: fitted_at_line(&bands[0], quantile),
                    feedforward: fitted_at_line(&bands[1], quantile),
                }
            })
            .collect();
        Self {
            structure: fitted.person.structure(),
            reason: None,
            parameters,
            cost: Some(fitted.cost),
            reduced_chi_square: fitted.reduced_chi_square,
            p_value: fitted.p_value,
            akaike: fitted.akaike,
            starts_agreeing: Some([fitted.starts_agreeing, fitted.starts]),
            lines,
            agreement: agreement(fitted, free),
            simulated_vaf,
            held_out_vaf,
        }
    }
}

/// Compares magnitudes and phases at the lines where both have bands; `None` where none has.
pub(super) fn agreement(fitted: &Fitted, free: &Controllers) -> Option<Agreement> {
    let quantile = fitted.quantile(PROBABILITY);
    let (mut compared, mut within) = (0, 0);
    for line in &free.lines {
        let bands = fitted.bands(line.response.omega_rad_s);
        for (estimate, band) in [(line.feedback, bands[0]), (line.feedforward, bands[1])] {
            let Some((estimate, [size, phase])) = estimate.zip(band.deviation) else { continue };
            let Some(width) = estimate.half_width(PROBABILITY) else { continue };
            let ratio = (estimate.value / band.value).ln();
            compared += 2;
            within += usize::from(ratio.re.abs() <= width.hypot(quantile * size));
            within += usize::from(ratio.im.abs() <= width.hypot(quantile * phase));
        }
    }
    (compared > 0).then_some(Agreement { compared, within })
}
