//! What the question is answered with.

use crate::analysis::excitation::plant::PlantFit;
use crate::analysis::excitation::signal::Signal;
use crate::excite::flatness::{Band, BandFlatness};
use crate::excite::motion::{MotionSummary, extent};
use crate::excite::recording::{Comparison, Jump};
use crate::excite::sequence::SequenceDetails;
use crate::excite::spectrum::Spectrum;
use crate::num::distributions::student_t;
use schemars::JsonSchema;
use serde::Serialize;

/// The signal as it is.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "ExcitationQualitySignal")]
pub struct SignalResult {
    /// Time between samples, s.
    pub sample_time_s: f64,
    /// Samples, all of them.
    pub samples: usize,
    /// The period, s; null where none is known, and the record stands for one.
    pub period_s: Option<f64>,
    /// Samples of a period, or of the record.
    pub period_samples: usize,
    /// Whole periods that were averaged.
    pub periods: usize,
    /// Length of a chip, s; null without chips.
    pub chip_s: Option<f64>,
    /// The largest magnitude, in the unit of the signal.
    pub peak: f64,
    /// Root mean square, in the unit of the signal.
    pub rms: f64,
    /// Mean, in the unit of the signal.
    pub mean: f64,
    /// Peak over root mean square of the samples, dimensionless; null of zero. That of a multisine in continuous time
    /// is `continuous_crest_factor` under `details`.
    pub crest_factor: Option<f64>,
    /// What was chosen or drawn in making it, or what was played; empty of other signals.
    pub details: SequenceDetails,
}

impl SignalResult {
    pub(super) fn new(signal: &Signal, period_samples: usize, periods: usize) -> Self {
        let whole = extent(&signal.values, None);
        Self {
            sample_time_s: signal.sample_time_s,
            samples: signal.values.len(),
            period_s: signal.period.map(|n| n as f64 * signal.sample_time_s),
            period_samples,
            periods,
            chip_s: signal.chip_s,
            peak: whole.peak,
            rms: whole.rms,
            mean: signal.values.iter().sum::<f64>() / signal.values.len() as f64,
            crest_factor: (whole.rms > 0.0).then(|| whole.peak / whole.rms),
            details: signal.details.clone(),
        }
    }
}

/// A step in a recording's delay.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "ExcitationQualityJump")]
pub struct JumpResult {
    /// Near where, s from the start of the excerpt.
    pub near_s: f64,
    /// Samples that are missing there; negative where there are too many.
    pub missing: i64,
}

/// A recording beside the sequence that it is declared to be.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "ExcitationQualityDeclared")]
pub struct DeclaredResult {
    /// Whether it is: whether a short response to the sequence explains a quarter of the recording, and three times
    /// what chance would.
    pub is_declared: bool,
    /// The correlation coefficient of recording and sequence, windows put at their own delays; −1 to 1.
    pub correlation: f64,
    /// By how much the recording is behind the sequence at its first sample, s; of a periodic one within a period.
    pub delay_s: f64,
    /// Share of the recording's variance that a response to the sequence some pieces (chips) long explains,
    /// dimensionless.
    pub explained: f64,
    /// What such a response explains of anything else on average, dimensionless.
    pub explained_by_chance: f64,
    /// Delay gained for each second, in ppm: positive where the recording has too many samples for the sequence; null
    /// with fewer than three windows that follow it.
    pub clock_error_ppm: Option<f64>,
    /// Its 95 % interval, ppm: of a line through the delays of windows, by their scatter; null as it.
    pub clock_error_interval_ppm: Option<[f64; 2]>,
    /// Samples missing in all, at the steps of the delay.
    pub missing_samples: i64,
    /// The steps.
    pub jumps: Vec<JumpResult>,
    /// Windows that were compared.
    pub windows: usize,
    /// Those that follow the sequence, with a correlation of 0.5 at least.
    pub clear_windows: usize,
}

impl DeclaredResult {
    pub(super) fn new(compared: &Comparison, sample_time_s: f64) -> Self {
        let jump = |jump: &Jump| JumpResult { near_s: jump.near as f64 * sample_time_s, missing: jump.missing };
        let quantile = student_t(0.95, (compared.windows[1] as f64 - 2.0).max(1.0));
        Self {
            is_declared: compared.is_declared,
            correlation: compared.correlation,
            delay_s: compared.delay * sample_time_s,
            explained: compared.explained,
            explained_by_chance: compared.by_chance,
            clock_error_ppm: compared.clock.map(|[rate, _]| 1e6 * rate),
            clock_error_interval_ppm: compared
                .clock
                .map(|[rate, error]| [rate - quantile * error, rate + quantile * error].map(|v| 1e6 * v)),
            missing_samples: compared.jumps.iter().map(|jump| jump.missing).sum(),
            jumps: compared.jumps.iter().map(jump).collect(),
            windows: compared.windows[0],
            clear_windows: compared.windows[1],
        }
    }
}

/// Flatness in one band (Qiu 2021, equations 15 and 16).
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "ExcitationQualityFlatness")]
pub struct FlatnessResult {
    /// The band in Hz, as asked for.
    pub band_hz: Band,
    /// γ² of the signal, dimensionless, from 0 to 1.
    pub sfm: f64,
    /// η²: the geometric mean of the lines' powers (mean squares), in squared units of the signal.
    pub geometric_mean: f64,
    /// σ²: their arithmetic mean, in the same unit; times `lines` it is R_xx(0) of the band.
    pub arithmetic_mean: f64,
    /// μ = −ln γ² (equation 24, whose value is never negative), dimensionless; null where a line has no power.
    pub mu: Option<f64>,
    /// The power of the same lines over the signal's power without 0 Hz, dimensionless.
    pub energy_fraction: f64,
    /// Lines in the band.
    pub lines: usize,
    /// The highest of them, Hz: the first at or above the band's upper end.
    pub highest_line_hz: f64,
    /// γ² behind the plant or loop, or of the answering column, dimensionless; null without.
    pub output_sfm: Option<f64>,
    /// η² of it, in squared units of the output.
    pub output_geometric_mean: Option<f64>,
    /// σ² of it, in squared units of the output.
    pub output_arithmetic_mean: Option<f64>,
    /// μ of it, dimensionless.
    pub output_mu: Option<f64>,
    /// The power of the same lines over its power without 0 Hz, dimensionless.
    pub output_energy_fraction: Option<f64>,
    /// η_G² = η_y²/η_x²: the geometric mean of the squared gain at the lines (equation 5), in squared units of output
    /// over signal; null without an output.
    pub system_geometric_mean: Option<f64>,
    /// R_xx(0)/R_yy(0) of the band, in squared units of signal over output; null without an output.
    pub power_ratio: Option<f64>,
    /// `output_sfm / sfm = system_geometric_mean · power_ratio`: the (band-limited) spectral flatness gain (equations 7
    /// and 16), dimensionless; null without, and of a signal without flatness.
    pub blsfg: Option<f64>,
}

impl FlatnessResult {
    pub(super) fn new(band_hz: Band, own: BandFlatness, output: Option<BandFlatness>) -> Self {
        Self {
            band_hz,
            sfm: own.sfm,
            geometric_mean: own.geometric_mean,
            arithmetic_mean: own.arithmetic_mean,
            mu: mu(own),
            energy_fraction: own.energy_fraction,
            lines: own.lines,
            highest_line_hz: own.highest_hz,
            output_sfm: output.map(|output| output.sfm),
            output_geometric_mean: output.map(|output| output.geometric_mean),
            output_arithmetic_mean: output.map(|output| output.arithmetic_mean),
            output_mu: output.and_then(mu),
            system_geometric_mean: output
                .filter(|_| own.geometric_mean > 0.0)
                .map(|output| output.geometric_mean / own.geometric_mean),
            power_ratio: output
                .filter(|output| output.arithmetic_mean > 0.0)
                .map(|output| own.arithmetic_mean / output.arithmetic_mean),
            output_energy_fraction: output.map(|output| output.energy_fraction),
            blsfg: output.filter(|_| own.sfm > 0.0).map(|output| output.sfm / own.sfm),
        }
    }
}

/// `−ln γ²`.
fn mu(found: BandFlatness) -> Option<f64> {
    (found.sfm > 0.0).then(|| (-found.sfm.ln()).max(0.0))
}

/// How the lines that are judged were chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "ExcitationQualityLineRule")]
pub enum LineRule {
    /// Known from the generator.
    Sequence,
    /// Those whose power passes the threshold, and, of several periods, the noise.
    Excited,
    /// Every one.
    All,
    /// The odd ones.
    Odd,
    /// As asked for.
    Given,
}

/// The lines; arrays are equally long.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "ExcitationQualityLines")]
pub struct LinesResult {
    /// How they were chosen.
    pub rule: LineRule,
    /// How many there are.
    pub count: usize,
    /// Distance of neighbouring multiples of 1/period, Hz.
    pub spacing_hz: f64,
    /// Lines above those in the table.
    pub left_off: usize,
    /// The multiples of 1/period.
    pub harmonic: Vec<usize>,
    /// Frequencies, Hz.
    pub frequency_hz: Vec<f64>,
    /// Mean square of the line's sinusoid, in squared units of the signal.
    pub power: Vec<f64>,
    /// V = ln(S/σ²): the logarithm of the line's power over the mean of all lines (equation 21), dimensionless; null
    /// where the line has no power.
    pub normalised_log_power: Vec<Option<f64>>,
    /// Mean square of the noise at the line in one period, from the scatter over periods, in squared units of the
    /// signal; null of a single one.
    pub noise_power: Option<Vec<f64>>,
    /// `10 log₁₀(power/noise_power)` in dB; null of a single period, and where there is no noise or no power.
    pub snr_db: Option<Vec<Option<f64>>>,
    /// Mean square of the sinusoid that comes out, in squared units of the output; null without a plant or an answering
    /// column.
    pub output_power: Option<Vec<f64>>,
    /// V of what comes out, dimensionless; null as `output_power`.
    pub output_normalised_log_power: Option<Vec<Option<f64>>>,
    /// `10 log₁₀` of its power over that of its own noise in dB; null as `snr_db`, and without an answering column.
    pub output_snr_db: Option<Vec<Option<f64>>>,
}

impl LinesResult {
    pub(super) fn new(
        rule: LineRule,
        spectrum: &Spectrum,
        output: Option<&Spectrum>,
        lines: &[usize],
        max_lines: usize,
    ) -> Self {
        let shown = &lines[..lines.len().min(max_lines)];
        let snr = |spectrum: &Spectrum| {
            spectrum.noise.as_ref().map(|noise| {
                shown
                    .iter()
                    .map(|n| Some(10.0 * (spectrum.power[*n] / noise[*n]).log10()).filter(|db| db.is_finite()))
                    .collect()
            })
        };
        let normalised = |spectrum: &Spectrum| -> Vec<Option<f64>> {
            let mean = lines.iter().map(|n| spectrum.share(*n)).sum::<f64>() / lines.len() as f64;
            shown.iter().map(|n| Some((spectrum.share(*n) / mean).ln()).filter(|v| v.is_finite())).collect()
        };
        let squares = 0.5 * (spectrum.samples as f64).powi(2);
        Self {
            rule,
            count: lines.len(),
            spacing_hz: spectrum.spacing_hz(),
            left_off: lines.len() - shown.len(),
            harmonic: shown.to_vec(),
            frequency_hz: shown.iter().map(|n| *n as f64 * spectrum.spacing_hz()).collect(),
            power: shown.iter().map(|n| spectrum.share(*n)).collect(),
            normalised_log_power: normalised(spectrum),
            output_normalised_log_power: output.map(normalised),
            noise_power: spectrum.noise.as_ref().map(|noise| shown.iter().map(|n| noise[*n] / squares).collect()),
            snr_db: snr(spectrum),
            output_power: output.map(|output| shown.iter().map(|n| output.share(*n)).collect()),
            output_snr_db: output.and_then(snr),
        }
    }
}

/// What an autocorrelation is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "ExcitationQualityCorrelation")]
pub enum CorrelationKind {
    /// Of one period, which runs around.
    Periodic,
    /// Of the record.
    Record,
}

/// How the signal resembles itself later.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "ExcitationQualityAutocorrelation")]
pub struct AutocorrelationResult {
    /// Of what.
    pub kind: CorrelationKind,
    /// Lags, s: multiples of the chip, or of the sample time.
    pub lag_s: Vec<f64>,
    /// `R(lag)/R(0)`, dimensionless.
    pub value: Vec<f64>,
    /// The value of the largest magnitude (dimensionless) between the first lag at which it falls below 0.1 and half a
    /// period or record; null where it never does.
    pub largest_sidelobe: Option<f64>,
    /// Its lag, s.
    pub sidelobe_lag_s: Option<f64>,
}

/// How well the past predicts the signal.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "ExcitationQualityPredictability")]
pub struct PredictabilityResult {
    /// How far ahead, s.
    pub horizon_s: f64,
    /// Distance of the 24 past values that the best linear predictor uses, s.
    pub spacing_s: f64,
    /// The share of the variance that it explains, dimensionless: 0 of a signal that nothing predicts.
    pub r_squared: f64,
}

/// The plant or the loop.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "ExcitationQualityPath")]
pub struct PathResult {
    /// Whether there is a controller.
    pub is_loop: bool,
    /// Its sample time, s.
    pub sample_time_s: f64,
    /// Where its gain is largest, if that is above the gain at 0 Hz, in Hz; null without one.
    pub resonance_hz: Option<f64>,
    /// The gain there, in units of the output over those of the signal; null without a resonance.
    pub resonance_gain: Option<f64>,
    /// ‖S P‖∞ of a loop: the largest gain from a force at the plant's input to its output, in their units; null of a
    /// plant alone.
    pub disturbance_norm: Option<f64>,
    /// Where it is reached, in Hz; null of a plant alone.
    pub disturbance_norm_hz: Option<f64>,
    /// The largest magnitude of a pole in z, dimensionless.
    pub spectral_radius: f64,
    /// b_m²: the squared leading coefficient of the numerator over a monic denominator in z (equation 13), in squared
    /// units of output over signal; null of a plant in continuous time.
    pub leading_coefficient_squared: Option<f64>,
    /// Π max(1, |z_i|²) over the zeros, which equation 13 takes as 1: times b_m² it is η_G² over all frequencies,
    /// dimensionless; null as b_m².
    pub zeros_outside_factor: Option<f64>,
}

/// Samples, for downloading (`text/csv` at `/v1/analyses/{analysis}/samples`).
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "ExcitationQualitySamples")]
pub struct SamplesResult {
    /// Time between samples, s.
    pub sample_time_s: f64,
    /// The signal, in its unit.
    pub signal: Vec<f64>,
    /// What comes out of the plant or loop, from rest, in its unit; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub output: Option<Vec<f64>>,
    /// The force at the plant's input, of a loop, in its unit; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force: Option<Vec<f64>>,
}

/// The result of `excitation_quality`.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ExcitationQualityResult {
    /// The signal.
    pub signal: SignalResult,
    /// A recording beside its declared generator; null of a made signal, without a generator, and of a constant.
    pub declared: Option<DeclaredResult>,
    /// Flatness in each band that was asked for.
    pub flatness: Vec<FlatnessResult>,
    /// Flatness over all lines below the Nyquist frequency (equations 2 and 7).
    pub whole_band: FlatnessResult,
    /// The lines that carry power.
    pub lines: LinesResult,
    /// The order of persistent excitation: frequencies in (−f_N, f_N] that carry power, whichever lines are judged; of
    /// a recording those that pass the threshold and the noise, whatever was played.
    pub persistent_excitation_order: usize,
    /// Autocorrelation.
    pub autocorrelation: AutocorrelationResult,
    /// Predictability; horizons that the period is too short for are left out.
    pub predictability: Vec<PredictabilityResult>,
    /// The plant or loop; null without.
    pub path: Option<PathResult>,
    /// The model of a measured plant; null of others.
    pub plant_fit: Option<PlantFit>,
    /// What is asked of the device and of the body: of the plant's output and input over two periods from rest, or of
    /// the signal itself.
    pub motion: MotionSummary,
    /// Samples; absent unless asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples: Option<SamplesResult>,
}
