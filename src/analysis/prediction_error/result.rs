//! The result of prediction error.

use crate::control::Model;
use crate::prediction_error::controllers::{NormEstimate, Region, Response};
use crate::prediction_error::residuals::{Test, Whiteness};
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

fn pair(z: Complex64) -> [f64; 2] {
    [z.re, z.im]
}

/// A norm: the average of a magnitude over the band.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NormResult {
    /// Its plain value: in units of u per unit of the error for ‖Gfb‖, without unit for ‖Gff G − 1‖; null where it is
    /// infinite or not determined.
    pub value: Option<f64>,
    /// Its value less its bias, which noise gives every average of magnitudes.
    pub bias_corrected: Option<f64>,
    /// Its standard error (sandwich, times 1.15).
    pub standard_error: Option<f64>,
    /// Its 95 % interval, around the plain value; null where the residuals are not white or the norm has no value.
    pub interval_95: Option<[f64; 2]>,
    /// What the same formula gives whether the residuals are white or not: it is no 95 % interval where
    /// `interval_95` is null.
    pub nominal_interval: Option<[f64; 2]>,
    /// Why `interval_95` is null.
    pub reason: Option<String>,
}

impl NormResult {
    /// Of an estimate; `doubt` says why its interval is none of 95 %.
    pub(super) fn new(found: &NormEstimate, doubt: Option<String>) -> Self {
        let interval = found.interval();
        Self {
            value: Some(found.value),
            bias_corrected: Some(found.corrected),
            standard_error: Some(found.standard_error),
            interval_95: doubt.is_none().then_some(interval),
            nominal_interval: Some(interval),
            reason: doubt,
        }
    }

    /// Of a norm that has no value.
    pub(super) fn none(reason: impl Into<String>) -> Self {
        Self {
            value: None,
            bias_corrected: None,
            standard_error: None,
            interval_95: None,
            nominal_interval: None,
            reason: Some(reason.into()),
        }
    }
}

/// The three norms of a trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PredictionErrorNorms {
    /// ‖Gfb‖.
    pub norm_feedback: NormResult,
    /// ‖Gff − G⁻¹‖.
    pub norm_feedforward_minus_inverse: NormResult,
    /// ‖Gff G − 1‖.
    pub norm_feedforward_plant_minus_one: NormResult,
}

/// A controller at a frequency, with a region of about 95 % in the complex plane: of the regions of people outside the
/// model class 85 – 95 % hold the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControllerRegion {
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// The value as `[re, im]`.
    pub value: [f64; 2],
    /// Half axes of the ellipse, the longer first.
    pub half_axes: [f64; 2],
    /// The angle of the longer half axis to the real axis in rad.
    pub angle_rad: f64,
    /// Magnitudes in the ellipse.
    pub magnitude: [f64; 2],
    /// Phases in the ellipse in rad; null where it holds 0, and any phase is possible.
    pub phase_rad: Option<[f64; 2]>,
}

impl ControllerRegion {
    pub(super) fn new(frequency_hz: f64, response: &Response, region: &Region) -> Self {
        Self {
            frequency_hz,
            value: pair(response.value),
            half_axes: region.half_axes,
            angle_rad: region.angle_rad,
            magnitude: region.magnitude,
            phase_rad: region.phase_rad,
        }
    }
}

/// A rational function with a delay, near an estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RationalReduction {
    /// The function without its delay, in continuous time.
    pub model: Model,
    /// The delay in seconds.
    pub delay_s: f64,
    /// Root mean square of its difference from the estimate over the band, relative to the estimate's: an error of its
    /// own, beside that of the estimate.
    pub relative_misfit: f64,
}

/// A feedback.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FeedbackResult {
    /// The delays of the lags of the error in seconds.
    pub delay_s: Vec<f64>,
    /// The weight of each: `E`, of `Gfb = E/A`.
    pub weights: Vec<f64>,
    /// Over the band, 30 frequencies.
    pub lines: Vec<ControllerRegion>,
    /// `(b₁ s + b₀)/(a₁ s + 1) e^{−τs}` near it; null where no stable one was found.
    pub rational: Option<RationalReduction>,
}

/// A feedforward: `A u = Σ w_k r(t − k) + Σ v_k r_Z(t − k)`, with `r_Z = r/Z`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FeedforwardResult {
    /// The weights w of the command, from the sample furthest ahead to the oldest one, one sample time apart.
    pub weights: Vec<f64>,
    /// The weights v of the command divided by Z, from the present sample on.
    pub slow_weights: Vec<f64>,
    /// Over the band, 30 frequencies; empty where the command does not determine it.
    pub lines: Vec<ControllerRegion>,
    /// A ratio of two polynomials of second degree near it; null where no stable one was found.
    pub rational: Option<RationalReduction>,
}

/// The noise `H = C/A`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NoiseResult {
    /// a₁, a₂, … of `A = 1 − a₁q⁻¹ − a₂q⁻² − …`.
    pub autoregressive: Vec<f64>,
    /// c₁, c₂, … of `C = 1 + c₁q⁻¹ + …`; empty for C = 1.
    pub moving_average: Vec<f64>,
}

/// A test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TestResult {
    /// The statistic, chi-square where the hypothesis holds.
    pub statistic: f64,
    /// Its degrees of freedom.
    pub degrees_of_freedom: f64,
    /// The probability of a larger one where the hypothesis holds.
    pub p_value: f64,
}

impl From<Test> for TestResult {
    fn from(test: Test) -> Self {
        Self { statistic: test.statistic, degrees_of_freedom: test.degrees, p_value: test.p_value }
    }
}

/// Whether residuals are white.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WhitenessResult {
    /// Whether neither test refuses at 5 %: only then is an interval one of 95 %.
    pub white: bool,
    /// The test of Ljung and Box, 25 lags.
    pub ljung_box: TestResult,
    /// The score test of serial correlation (Breusch and Godfrey), 4 lags.
    pub serial_correlation: TestResult,
}

impl From<Whiteness> for WhitenessResult {
    fn from(white: Whiteness) -> Self {
        Self { white: white.is_white(), ljung_box: white.ljung_box.into(), serial_correlation: white.serial.into() }
    }
}

/// What the residuals of all trials say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ResidualTestResults {
    /// Whether they are white.
    pub whiteness: WhitenessResult,
    /// Whether later lags of the command explain nothing.
    pub later_command: TestResult,
    /// Whether later lags of the error explain nothing.
    pub later_error: TestResult,
}

/// Whether a feedforward is needed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FeedforwardTestResult {
    /// The likelihood ratio of the form with against the form without.
    pub test: TestResult,
    /// `k ln n`, which the ratio must pass besides.
    pub penalty: f64,
    /// Lags of the error in both forms.
    pub error_lags: usize,
    /// Whether both conditions hold. If not, no feedforward is needed to explain the trials, which is not the same as
    /// that there is none.
    pub needed: bool,
}

/// Tests of hypotheses; sizes and powers that were measured are in `docs/limits.md`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HypothesisResults {
    /// Gfb = 0.
    pub no_feedback: TestResult,
    /// Gff = 0; null where the command does not determine a feedforward, or the trials are too short for its lags.
    pub no_feedforward: Option<FeedforwardTestResult>,
    /// The feedback of the first half of the trials is that of the second; null for one trial.
    pub unchanged_feedback: Option<TestResult>,
}

/// How much the feedback changed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FeedbackChange {
    /// Trials in each of both blocks: the first and the last ones of the request.
    pub trials: usize,
    /// ‖Gfb‖ of the first block.
    pub first: NormResult,
    /// Of the last block.
    pub last: NormResult,
    /// Last less first.
    pub change: f64,
    /// Its 95 % interval; null where the residuals of a block are not white.
    pub interval_95: Option<[f64; 2]>,
    /// What the same formula gives whether they are or not.
    pub nominal_interval: [f64; 2],
    /// Why `interval_95` is null.
    pub reason: Option<String>,
}

/// The answer of a neighbouring form.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProfileEntry {
    /// What differs from the form of the answer.
    pub form: String,
    /// ‖Gfb‖, mean over the trials; null where the form cannot be estimated.
    pub norm_feedback: Option<f64>,
    /// ‖Gff G − 1‖, mean over the trials.
    pub norm_feedforward_plant_minus_one: Option<f64>,
}

/// Whether the negative inverse of the plant passes for a feedback.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InverseTrap {
    /// The cosine of Gfb and −1/G over the band: 1 for the inverse itself.
    pub cosine: Option<f64>,
    /// ‖Gfb‖ over that of the default lags; null where these are the default lags.
    pub ratio_to_default: Option<f64>,
    /// Whether the largest weight is that of the least delay.
    pub largest_at_least_delay: bool,
}

/// Shares of a trial's variation that the estimate accounts for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AccountedShares {
    /// The trial, by its place in the request.
    pub trial: String,
    /// Of the control, predicted one sample ahead.
    pub one_step_u: Option<f64>,
    /// Of the control, simulated from the stimuli and from rest; null where the loop is not stable.
    pub simulated_u: Option<f64>,
    /// Of the output, likewise.
    pub simulated_y: Option<f64>,
}

/// The norms with a moving average of second order in the noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MovingAverageAnswer {
    /// The noise.
    pub noise: NoiseResult,
    /// Whiteness of the residuals of all trials.
    pub whiteness: WhitenessResult,
    /// Whether the iterations came to rest.
    pub settled: bool,
    /// ‖Gfb‖ of each trial.
    pub norm_feedback: Vec<NormResult>,
    /// ‖Gff G − 1‖ of each trial.
    pub norm_feedforward_plant_minus_one: Vec<NormResult>,
}

/// A trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PredictionErrorTrial {
    /// The trial, by its place in the request.
    pub trial: String,
    /// Its norms.
    pub metrics: PredictionErrorNorms,
    /// Its feedforward.
    pub feedforward: FeedforwardResult,
    /// Its feedback; null where all trials share one.
    pub feedback: Option<FeedbackResult>,
    /// The noise's shape; null where all trials share one.
    pub noise: Option<NoiseResult>,
    /// Mean square of the residuals w, in squared units of u.
    pub noise_variance: f64,
    /// Whiteness of its residuals.
    pub whiteness: WhitenessResult,
    /// Whether the loop with the plant is stable; null where the plant cannot be sampled.
    pub stable: Option<bool>,
    /// The largest modulus of the sampled loop's poles.
    pub largest_pole_modulus: Option<f64>,
    /// What the estimate accounts for of the trial.
    pub accounted_for: AccountedShares,
}

/// The lags of the regression, in samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RegressionLags {
    /// The sample time that was worked at, in seconds.
    pub sample_time_s: f64,
    /// Each how-manieth sample of the trials that is.
    pub step: usize,
    /// Lags of the control.
    pub autoregressive: usize,
    /// Order of the moving average.
    pub moving_average: usize,
    /// Least and largest lag of the error.
    pub feedback: [usize; 2],
    /// Samples that the feedforward's window lies ahead.
    pub ahead: usize,
    /// Samples that it reaches back, the present one included.
    pub behind: usize,
    /// Polynomials of the window's weights.
    pub terms: usize,
    /// Z of the plant's slow zeros, in ascending powers of q⁻¹.
    pub slow_zeros: Vec<f64>,
}

/// The result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PredictionErrorResult {
    /// The band of the norms in Hz.
    pub band_hz: [f64; 2],
    /// The lags of the regression.
    pub lags: RegressionLags,
    /// The feedback that all trials share; null where they share none.
    pub feedback: Option<FeedbackResult>,
    /// The noise's shape that all trials share; null where they share none.
    pub noise: Option<NoiseResult>,
    /// Trial by trial, in the order of the request.
    pub trials: Vec<PredictionErrorTrial>,
    /// What the residuals say.
    pub residual_tests: ResidualTestResults,
    /// Tests of hypotheses.
    pub hypotheses: HypothesisResults,
    /// How much the feedback changed from first to last trials; null for fewer than two trials, or where a block cannot
    /// be estimated.
    pub change: Option<FeedbackChange>,
    /// How the answer moves over neighbouring forms.
    pub profile: Vec<ProfileEntry>,
    /// Whether the negative inverse of the plant passes for a feedback.
    pub inverse_trap: InverseTrap,
    /// The answer with a moving average; null where the residuals are white, or the spec has one.
    pub moving_average_answer: Option<MovingAverageAnswer>,
    /// Trials of `validate_on`, with the mean feedforward of the fitted ones.
    pub held_out: Vec<AccountedShares>,
}
