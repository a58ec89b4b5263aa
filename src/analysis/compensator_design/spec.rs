//! How the question is put.

use crate::analysis::contract::Part;
use crate::analysis::excitation::problems;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{read, wrong_spec as wrong};
use crate::excite::compensator::DesignLimits;
use crate::excite::flatness::Band;
use crate::excite::path::Discretisation;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Points of a curve, and curves, at most.
const MOST: usize = 2_000;

/// Sections of a cascade at most.
const MOST_SECTIONS: usize = 4;
/// The highest free order.
const MOST_ORDER: usize = 6;

/// The structure of the compensator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "CompensatorStructure")]
pub enum Structure {
    /// `C = K`.
    Proportional,
    /// `C(s) = K (s + 2πf_z)/(s + 2πf_p)`, with positive corners in either order unless `zero_below_pole` is set.
    Lead,
    /// Several leads or lags in series, `sections` of them.
    Cascade,
    /// Any zeros and poles in the left half plane, as many of each as `order` says: sections of second order, `(s² +
    /// 2ζ_z ω_z s + ω_z²)/(s² + 2ζ_p ω_p s + ω_p²)`, and one of first order where the order is odd.
    FreeOrder,
}

/// Curves over the gain, as in figure 5 of Qiu 2021.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "CompensatorSweepSpec")]
pub struct SweepSpec {
    /// Between which gains, in units of force over those of the position. Default: the range of the search.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<[f64; 2]>,
    /// How many, equally spaced on a logarithmic scale. Default: 100.
    #[serde(default = "hundred")]
    pub count: usize,
    /// A curve for each of these zeros, Hz; none for proportional control.
    #[serde(default)]
    pub zero_hz: Vec<f64>,
    /// The pole of all of them, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pole_hz: Option<f64>,
}

fn hundred() -> usize {
    100
}

/// The spec of `compensator_design`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CompensatorDesignSpec {
    /// What has free parameters.
    pub structure: Structure,
    /// Sections of a cascade, 2 to 4. Default: 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sections: Option<usize>,
    /// Order of a compensator of free order, 1 to 6. Default: 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub order: Option<usize>,
    /// The range of the damping ratios ζ of sections of second order, dimensionless. Default: 0.05 to 100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping_range: Option<[f64; 2]>,
    /// The band: its upper end in Hz, or `[from, to]`.
    pub band_hz: Band,
    /// A fixed gain K, in units of force over those of the position. Default: free.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
    /// The range of a free gain, in the same unit. Default: four decades to each side of the gain at which the loop
    /// gain is 1 at the end of the band.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain_range: Option<[f64; 2]>,
    /// A fixed zero f_z, Hz. Default: free.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zero_hz: Option<f64>,
    /// A fixed pole f_p, Hz. Default: free.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pole_hz: Option<f64>,
    /// The range of a free zero in Hz. Default: from a thousandth of the band's end to 0.9 of the Nyquist frequency.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zero_range_hz: Option<[f64; 2]>,
    /// The range of a free pole in Hz. Default: as for the zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pole_range_hz: Option<[f64; 2]>,
    /// Whether f_z ≤ f_p is asked for: a lead in the strict sense. Default: false, so that a lag may win.
    #[serde(default)]
    pub zero_below_pole: bool,
    /// Limits that the loop must keep while it follows the signal from rest. Default: stability alone.
    #[serde(default)]
    pub limits: DesignLimits,
    /// Curves beside the answer. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sweep: Option<SweepSpec>,
    /// How a plant in continuous time is sampled; not `continuous`. Default: zero_order_hold.
    #[serde(default)]
    pub discretisation: Discretisation,
    /// Share of the strongest line's power from which a line of a recorded signal counts, dimensionless. Default: 1e-6.
    #[serde(default = "threshold")]
    pub power_threshold: f64,
}

fn threshold() -> f64 {
    1e-6
}

impl Part for CompensatorDesignSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        read(value, at, "unusable spec").map_err(|problem| {
            problem.mend(
                "A spec has structure (\"proportional\", \"lead\", \"cascade\" or \"free_order\") and band_hz (a \
                 number), and may have more.",
            )
        })
    }
}

impl CompensatorDesignSpec {
    /// Checks it for a signal of this sample time, where it is known.
    pub(super) fn checked(self, sample_time_s: Option<f64>) -> Result<Self, Problem> {
        let spec = self;
        spec.band_hz.check(sample_time_s).map_err(|error| problems::band(&error, "/spec/band_hz"))?;
        let positive = |value: f64| value > 0.0 && value.is_finite();
        for (name, value) in [("gain", spec.gain), ("zero_hz", spec.zero_hz), ("pole_hz", spec.pole_hz)] {
            if let Some(value) = value.filter(|v| !positive(*v)) {
                return Err(wrong(format!("{name} is {value}, and must be positive"), format!("/spec/{name}")));
            }
        }
        let ranges = [
            ("gain_range", "gain", spec.gain_range, spec.gain),
            ("zero_range_hz", "zero_hz", spec.zero_range_hz, spec.zero_hz),
            ("pole_range_hz", "pole_hz", spec.pole_range_hz, spec.pole_hz),
            ("damping_range", "damping", spec.damping_range, None),
        ];
        for (name, other, range, fixed) in ranges {
            let Some([low, high]) = range else { continue };
            if !(positive(low) && positive(high) && low <= high) {
                return Err(wrong(format!("{name} from {low} to {high} is empty"), format!("/spec/{name}"))
                    .mend("Give two positive numbers, the smaller first."));
            }
            if fixed.is_some() {
                return Err(wrong(format!("{other} is fixed and has a range"), format!("/spec/{name}"))
                    .mend("Give one of the two."));
            }
        }
        if spec.structure == Structure::Proportional {
            let stray = [
                ("zero_hz", spec.zero_hz.is_some()),
                ("pole_hz", spec.pole_hz.is_some()),
                ("zero_range_hz", spec.zero_range_hz.is_some()),
                ("pole_range_hz", spec.pole_range_hz.is_some()),
                ("zero_below_pole", spec.zero_below_pole),
            ];
            if let Some((name, _)) = stray.iter().find(|(_, is_given)| *is_given) {
                return Err(wrong("proportional control has no zero and no pole", format!("/spec/{name}"))
                    .mend("Choose the structure lead, or leave it out."));
            }
        }
        spec.check_structure()?;
        if spec.zero_below_pole {
            let zero = spec.zero_hz.or(spec.zero_range_hz.map(|r| r[0]));
            let pole = spec.pole_hz.or(spec.pole_range_hz.map(|r| r[1]));
            if let Some((zero, pole)) = zero.zip(pole).filter(|(zero, pole)| zero > pole) {
                let detail = format!("the zero is at {zero} Hz at least and the pole at {pole} Hz at most");
                return Err(wrong(detail, "/spec/zero_below_pole").mend("Let the ranges overlap, or allow a lag."));
            }
        }
        if let Some((name, value)) = spec.limits.unusable() {
            let detail = format!("the limit {name} is {value}, and must be positive and finite");
            return Err(wrong(detail, format!("/spec/limits/{name}")));
        }
        if spec.discretisation == Discretisation::Continuous {
            return Err(wrong("a loop is designed in sampled time", "/spec/discretisation")
                .mend("Choose zero_order_hold or tustin."));
        }
        if !(spec.power_threshold > 0.0 && spec.power_threshold < 1.0) {
            let detail = format!("the threshold is {}, and must be between 0 and 1", spec.power_threshold);
            return Err(wrong(detail, "/spec/power_threshold"));
        }
        if let Some(sweep) = &spec.sweep {
            if !(2..=MOST).contains(&sweep.count) {
                return Err(wrong(format!("a curve has 2 to {MOST} points"), "/spec/sweep/count"));
            }
            if let Some([low, high]) = sweep.gain.filter(|[l, h]| !(positive(*l) && positive(*h) && l < h)) {
                return Err(wrong(format!("gains from {low} to {high} are none"), "/spec/sweep/gain"));
            }
            if sweep.zero_hz.len() > 50 || sweep.zero_hz.iter().chain(&sweep.pole_hz).any(|f| !positive(*f)) {
                return Err(wrong("a sweep has up to 50 zeros, and positive corners", "/spec/sweep/zero_hz"));
            }
            if sweep.zero_hz.is_empty() != sweep.pole_hz.is_none() {
                return Err(wrong("a sweep has both zeros and a pole, or neither", "/spec/sweep").mend(
                    "Give zero_hz (a list) and pole_hz (a number), or leave both out for proportional control.",
                ));
            }
        }
        Ok(spec)
    }

    /// What belongs to another structure.
    fn check_structure(&self) -> Result<(), Problem> {
        let of_structure = [
            ("sections", self.sections.is_some(), Structure::Cascade),
            ("order", self.order.is_some(), Structure::FreeOrder),
            ("damping_range", self.damping_range.is_some(), Structure::FreeOrder),
        ];
        if let Some((name, ..)) = of_structure.iter().find(|(_, given, owner)| *given && *owner != self.structure) {
            return Err(wrong(format!("{name} belongs to another structure"), format!("/spec/{name}"))
                .mend("sections goes with cascade; order and damping_range go with free_order."));
        }
        for (name, value, most) in [("sections", self.sections, MOST_SECTIONS), ("order", self.order, MOST_ORDER)] {
            let least = if name == "sections" { 2 } else { 1 };
            if let Some(value) = value.filter(|v| !(least..=most).contains(v)) {
                return Err(wrong(
                    format!("{name} is {value}, and must be {least} to {most}"),
                    format!("/spec/{name}"),
                ));
            }
        }
        if matches!(self.structure, Structure::Cascade | Structure::FreeOrder) {
            let fixed = [("zero_hz", self.zero_hz), ("pole_hz", self.pole_hz)];
            if let Some((name, _)) = fixed.iter().find(|(_, value)| value.is_some()) {
                let detail = "corners of several sections are not fixed one by one";
                return Err(wrong(detail, format!("/spec/{name}")).mend("Give zero_range_hz and pole_range_hz."));
            }
        }
        if self.structure == Structure::FreeOrder && self.zero_below_pole {
            return Err(wrong("zeros and poles of free order have no order", "/spec/zero_below_pole")
                .mend("Choose the structure cascade, or leave it out."));
        }
        Ok(())
    }
}
