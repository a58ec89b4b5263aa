//! How the question is put.

use crate::analysis::contract::Part;
use crate::analysis::excitation::problems;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{read, wrong_spec as wrong};
use crate::excite::flatness::Band;
use crate::excite::motion::MotionLimits;
use crate::excite::path::Discretisation;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Bands and horizons at most.
const MOST: usize = 100;
/// Lines that a table may have.
const MOST_LINES: usize = 100_000;

/// A rule by which lines are chosen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "ExcitationLineName")]
pub enum LineName {
    /// Those that the generator is known to excite; of other signals the excited ones.
    #[default]
    Auto,
    /// Those whose power passes the threshold, and, of several periods, the noise.
    Excited,
    /// Every one.
    All,
    /// The odd ones.
    Odd,
}

/// Which lines of the signal's period are judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "ExcitationLines")]
pub enum LineChoice {
    /// `auto`, `excited`, `all` or `odd`.
    #[schemars(title = "LineName")]
    Name(LineName),
    /// These multiples of 1/period, increasing.
    #[schemars(title = "GivenHarmonics")]
    Harmonics {
        /// The multiples of 1/period, from 1 on.
        harmonics: Vec<usize>,
    },
}

/// What the signal is a signal of.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "ExcitationQuantity")]
pub enum Quantity {
    /// A position, whose derivatives are velocity and acceleration.
    #[default]
    Position,
    /// A force or torque.
    Force,
}

/// The spec of `excitation_quality`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ExcitationQualitySpec {
    /// The bands, each by its upper end in Hz, or as `[from, to]`. Default: none; the whole band is always judged.
    pub band_hz: Vec<Band>,
    /// `auto`, `excited`, `all`, `odd` or `{"harmonics": [..]}`. Default: auto.
    pub lines: LineChoice,
    /// Share of the strongest line's power from which a recorded line counts as excited, dimensionless. Default: 1e-6.
    pub power_threshold: f64,
    /// How a plant in continuous time is sampled. Default: zero_order_hold.
    pub discretisation: Discretisation,
    /// What the signal is, where no plant says so. Default: position; with a plant and without a controller it is the
    /// plant's input.
    pub quantity: Quantity,
    /// Limits on the peaks of the motion. Default: none.
    pub limits: MotionLimits,
    /// How far ahead the signal is predicted from its past, in seconds. Default: 0.1, 0.2 and 0.5.
    pub horizons_s: Vec<f64>,
    /// Lines in the table at most, the lowest ones. Default: 500.
    pub max_lines: usize,
    /// Whether the samples are part of the report. Default: false.
    pub include_samples: bool,
}

impl Default for ExcitationQualitySpec {
    fn default() -> Self {
        Self {
            band_hz: Vec::new(),
            lines: LineChoice::Name(LineName::Auto),
            power_threshold: 1e-6,
            discretisation: Discretisation::ZeroOrderHold,
            quantity: Quantity::Position,
            limits: MotionLimits::default(),
            horizons_s: vec![0.1, 0.2, 0.5],
            max_lines: 500,
            include_samples: false,
        }
    }
}

impl Part for ExcitationQualitySpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        read(value, at, "unusable spec")
    }
}

impl ExcitationQualitySpec {
    /// Checks it for a signal of this sample time, where it is known, and for what the signal passes through.
    pub(super) fn checked(
        self,
        sample_time_s: Option<f64>,
        has_plant: bool,
        has_controller: bool,
    ) -> Result<Self, Problem> {
        let mut spec = self;
        if spec.band_hz.len() > MOST {
            return Err(wrong(
                format!("there are {} bands; at most {MOST} are judged", spec.band_hz.len()),
                "/spec/band_hz",
            ));
        }
        for (i, band) in spec.band_hz.iter().enumerate() {
            band.check(sample_time_s).map_err(|error| problems::band(&error, &format!("/spec/band_hz/{i}")))?;
        }
        if let LineChoice::Harmonics { harmonics } = &spec.lines {
            let rising = harmonics.windows(2).all(|pair| pair[0] < pair[1]);
            if harmonics.len() < 2 || harmonics[0] == 0 || !rising {
                return Err(wrong(
                    "harmonics must be two or more increasing multiples from 1 on",
                    "/spec/lines/harmonics",
                ));
            }
        }
        if !(spec.power_threshold > 0.0 && spec.power_threshold < 1.0) {
            let detail = format!("the threshold is {}, and must be between 0 and 1", spec.power_threshold);
            return Err(wrong(detail, "/spec/power_threshold"));
        }
        if let Some((name, value)) = spec.limits.unusable() {
            let detail = format!("the limit of the {name} is {value}, and must be positive and finite");
            return Err(wrong(detail, format!("/spec/limits/{name}")));
        }
        if spec.horizons_s.len() > MOST || spec.horizons_s.iter().any(|h| !(*h > 0.0 && h.is_finite())) {
            return Err(wrong(
                format!("horizons must be up to {MOST} positive numbers of seconds"),
                "/spec/horizons_s",
            ));
        }
        if spec.max_lines > MOST_LINES {
            return Err(wrong(format!("a table has at most {MOST_LINES} lines"), "/spec/max_lines"));
        }
        if spec.discretisation == Discretisation::Continuous && has_controller {
            return Err(wrong("a loop is judged in sampled time", "/spec/discretisation")
                .mend("Choose zero_order_hold or tustin."));
        }
        if has_plant && !has_controller {
            spec.quantity = Quantity::Force;
        } else if has_controller && spec.quantity == Quantity::Force {
            return Err(wrong("the signal of a position loop is the position asked for", "/spec/quantity"));
        }
        Ok(spec)
    }
}
