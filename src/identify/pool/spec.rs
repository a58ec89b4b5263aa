//! Pools as people write them; the module `unfold` checks them.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

/// The candidate pool: the name of a published one, a published one thinned, or one's own grid.
///
/// - `"zhang2015_appendix_b"` (continuous) or `"zhang2015_appendix_c"` (sampled, FIR feedforward), complete;
/// - `{"name": .., "thin": {..}}`: the same with every n-th element of its lists;
/// - `{"grid": {..}, "stability_margin": ..}`: coefficients on grids, as in Zhang 2015, examples 2.2 to 2.5 and 4.5;
/// - `{"roots": {..}, "stability_margin": ..}`: poles, zeros and peak gains on grids, as in its appendices.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum PoolSpec {
    /// A published pool, complete.
    Name(PoolName),
    /// A published pool with every n-th element of its lists.
    Thinned(ThinnedPool),
    /// Coefficients on grids.
    Grid(Box<GridPool>),
    /// Poles, zeros and peak gains on grids.
    Roots(Box<RootsPool>),
}

/// The published pools.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum PoolName {
    /// Zhang 2015, appendix B: continuous time, poles and zeros up to 25 rad/s, peak gains up to 30.5 over 0.1 to 0.4
    /// Hz, stability margin 0.1 1/s.
    ///
    /// The margin is strict: on the plant of its chapter 3, 3,359 feedback controllers whose zero at −0.1 cancels a
    /// pole there lie on the line and are left out; 31,062,226 remain. No other controller with a gain is so near that
    /// rounding could decide.
    #[serde(rename = "zhang2015_appendix_b")]
    Zhang2015AppendixB,
    /// Zhang 2015, appendix C: sampled time by zero-pole matching, FIR feedforward, poles and zeros up to 31.5 rad/s,
    /// peak gains up to 30.5 over 0 to 0.5 Hz, stability margin 0.1 1/s.
    #[serde(rename = "zhang2015_appendix_c")]
    Zhang2015AppendixC,
}

/// A published pool with every n-th element of its lists.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ThinnedPool {
    /// Which pool.
    pub name: PoolName,
    /// How it is thinned.
    #[serde(default)]
    pub thin: Thin,
}

/// How lists are thinned: every n-th element is kept, the first one always. Zero gain is always kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Thin {
    /// Real poles and natural frequencies of poles of the feedback controller, and of the feedforward controller where
    /// `feedforward_poles` does not say otherwise. Default 1.
    pub poles: usize,
    /// Real poles and natural frequencies of poles of the feedforward controller. Default: as `poles`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedforward_poles: Option<usize>,
    /// Real zeros and natural frequencies of zeros. Default 1.
    pub zeros: usize,
    /// Damping ratios of poles and zeros. Default 1.
    pub damping: usize,
    /// Magnitudes of the peak gain, without zero, smallest first. Default 1.
    pub gains: usize,
}

impl Default for Thin {
    fn default() -> Self {
        Self { poles: 1, feedforward_poles: None, zeros: 1, damping: 1, gains: 1 }
    }
}

/// Whether a pool's controllers are continuous or sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimeBaseName {
    /// Polynomials in `s`.
    Continuous,
    /// Polynomials in `z`; a continuous plant is discretised by a zero-order hold.
    Sampled,
}

/// Controllers whose coefficients lie on grids.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GridPool {
    /// The grids.
    pub grid: Grid,
    /// Closed-loop poles have exponents with real parts below minus this, in 1/s. Default 0.
    #[serde(default)]
    pub stability_margin: f64,
    /// Default: as the plant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<TimeBaseName>,
}

/// Grids of coefficients.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Coefficients of the monic feedforward denominator after the leading one. Default: no denominator, which is a
    /// polynomial in `s`, or an FIR filter in sampled time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedforward_denominator: Option<Coefficients>,
    /// Coefficients of the feedback numerator, leading one included.
    pub feedback_numerator: Coefficients,
    /// Coefficients of the monic feedback denominator after the leading one. Default: no denominator.
    #[serde(default = "Coefficients::none")]
    pub feedback_denominator: Coefficients,
}

/// Coefficients in descending powers: one axis for each (the first is outermost), or every combination written out.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Coefficients {
    /// One axis per coefficient.
    Axes(Vec<Axis>),
    /// Each combination of coefficients.
    Listed(ListedCoefficients),
}

/// Combinations of coefficients, written out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ListedCoefficients {
    /// Equally long rows of coefficients in descending powers.
    pub listed: Vec<Vec<f64>>,
}

/// Controllers whose poles, zeros and peak gains lie on grids.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RootsPool {
    /// The grids.
    pub roots: Roots,
    /// Closed-loop poles have exponents with real parts below minus this, in 1/s. Default 0.1.
    #[serde(default = "RootsPool::stability_margin")]
    pub stability_margin: f64,
    /// Default: as the plant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<TimeBaseName>,
}

impl RootsPool {
    fn stability_margin() -> f64 {
        0.1
    }
}

/// Grids of poles, zeros and peak gains. In sampled time poles and zeros are matched by `z = e^{λT}`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Roots {
    /// Poles of the feedforward controller. Default: none, which is a polynomial in `s`, or an FIR filter in sampled
    /// time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedforward_poles: Option<RootGrid>,
    /// Poles of the feedback controller.
    pub feedback_poles: RootGrid,
    /// Zeros of the feedback controller. Default: none.
    #[serde(default)]
    pub feedback_zeros: RootGrid,
    /// Magnitudes of the largest |Gfb| over the band, not negative. Zero, where listed, is no feedback.
    pub peak_gains: Axis,
    /// Whether each gain is taken with both signs. Default true.
    #[serde(default = "Roots::both_signs")]
    pub both_signs: bool,
    /// The band over which the peak gain is meant, in rad/s.
    pub band_rad_s: [f64; 2],
    /// Poles and zeros of larger modulus are left out, in rad/s. Default: none is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub largest_root_rad_s: Option<f64>,
}

impl Roots {
    fn both_signs() -> bool {
        true
    }
}

/// Real roots and conjugate pairs in rad/s, as continuous-time exponents.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RootGrid {
    /// Real roots. Default: none.
    #[serde(default)]
    pub real_rad_s: Axis,
    /// Natural frequencies of conjugate pairs, not negative. Default: none.
    #[serde(default)]
    pub natural_frequency_rad_s: Axis,
    /// Damping ratios of conjugate pairs, inside (−1, 1). Default: none.
    #[serde(default)]
    pub damping_ratio: Axis,
}

/// Numbers: written out, or as a range.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Axis {
    /// Written out.
    Values(Vec<f64>),
    /// Equally spaced.
    Range(Range),
}

impl Default for Axis {
    fn default() -> Self {
        Self::Values(Vec::new())
    }
}

/// Equally spaced numbers, both ends included. Values are rounded to 12 decimal digits of the largest, so that
/// `{"from": -8, "to": 8, "step": 0.1}` holds 5.4 and not 5.400000000000001.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// First value.
    pub from: f64,
    /// Last value; with a step that does not reach it, the last below it.
    pub to: f64,
    /// Distance between neighbours, positive; either this or `count`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step: Option<f64>,
    /// How many values, at least 2; either this or `step`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub count: Option<u64>,
}

// serde's own untagged enums answer "did not match any variant"; these say which field is wrong.
fn parse<'de, D: Deserializer<'de>, T: serde::de::DeserializeOwned>(value: serde_json::Value) -> Result<T, D::Error> {
    serde_json::from_value(value).map_err(serde::de::Error::custom)
}

impl<'de> Deserialize<'de> for Axis {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = serde_json::Value::deserialize(deserializer)?;
        if value.is_array() { parse::<D, _>(value).map(Self::Values) } else { parse::<D, _>(value).map(Self::Range) }
    }
}

impl<'de> Deserialize<'de> for Coefficients {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = serde_json::Value::deserialize(deserializer)?;
        if value.is_array() { parse::<D, _>(value).map(Self::Axes) } else { parse::<D, _>(value).map(Self::Listed) }
    }
}

impl<'de> Deserialize<'de> for PoolSpec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = serde_json::Value::deserialize(deserializer)?;
        if value.is_string() {
            parse::<D, _>(value).map(Self::Name)
        } else if value.get("grid").is_some() {
            parse::<D, _>(value).map(|pool| Self::Grid(Box::new(pool)))
        } else if value.get("roots").is_some() {
            parse::<D, _>(value).map(|pool| Self::Roots(Box::new(pool)))
        } else if value.get("name").is_some() {
            parse::<D, _>(value).map(Self::Thinned)
        } else {
            Err(serde::de::Error::custom(
                "a pool is a name, or an object with one of the fields `name`, `grid` and `roots`",
            ))
        }
    }
}

/// Degrees of the controllers' polynomials, where the request gives them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Degrees {
    /// Feedforward numerator.
    pub feedforward_numerator: Option<usize>,
    /// Feedforward denominator.
    pub feedforward_denominator: Option<usize>,
    /// Feedback numerator.
    pub feedback_numerator: Option<usize>,
    /// Feedback denominator.
    pub feedback_denominator: Option<usize>,
}

/// A pool spec that makes no pool.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}")]
pub struct PoolSpecError {
    /// The field, as a path inside the spec of the analysis (`pool/grid/feedback_numerator`).
    pub field: String,
    /// What is wrong with it, with the value.
    pub message: String,
    /// Whether it is merely too large.
    pub too_large: bool,
}
