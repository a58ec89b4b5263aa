//! How frequency data are computed: as written (unchecked), and checked.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Lines of one estimate at most.
const MAX_LINES: usize = 10_000;

/// Segments of one trial at most.
const MAX_SEGMENTS: usize = 10_000;

/// The frequencies at which the response is estimated.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Lines {
    /// All lines of the segment's grid, 0 Hz excepted, on which the input carries power (see `power_threshold`,
    /// `floor_ratio`), within `band_hz` where that is given.
    #[default]
    Excited,
    /// Zhang (2015), section 3.5.1: 0.1, 0.125, … 0.4 Hz (13 lines) from two segments of 40 s.
    #[serde(rename = "zhang2015_chapter_3")]
    Zhang2015Chapter3,
    /// Zhang (2015), section 5.6.1: 0, 1/60, … 0.5 Hz (31 lines) from one segment of 60 s.
    #[serde(rename = "zhang2015_chapter_5")]
    Zhang2015Chapter5,
    /// These frequencies in Hz; they are sorted.
    FrequencyHz(Vec<f64>),
}

/// A piece of the record, in seconds from its first sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Bounds {
    /// Where it starts.
    pub start_s: f64,
    /// Where it ends.
    pub end_s: f64,
}

/// The pieces of each trial that are transformed one by one and averaged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "segments are a list of {\"start_s\", \"end_s\"}, or {\"count\": number of equal parts of the whole \
                 record}, or {\"length_s\": seconds, \"start_s\": seconds}"
)]
pub enum Segments {
    /// Named pieces. They may overlap, and are then not independent.
    Bounds(Vec<Bounds>),
    /// Equal parts of the whole record.
    Count(CountSegments),
    /// As many whole pieces of one length as fit.
    Length(LengthSegments),
}

/// Equal parts of the whole record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CountSegments {
    /// How many.
    pub count: usize,
}

/// As many whole pieces of one length as fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LengthSegments {
    /// Their length in seconds.
    pub length_s: f64,
    /// Where the first starts, in seconds from the first sample.
    #[serde(default)]
    pub start_s: f64,
}

/// What is taken off every segment before it is transformed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Detrend {
    /// Nothing.
    None,
    /// The mean of the segment, of every channel.
    Mean,
    /// The mean, and the output's slope. Where transients are removed it is estimated beside the response, so that it
    /// takes nothing of the stimulus' own sinusoids, and taken off if it is 4 standard errors from zero. Where they are
    /// kept it is the straight line that fits the segment best (least squares), of every channel.
    #[serde(alias = "linear")]
    Line,
}

/// What becomes of transients: of what a segment's start and end, where the record is not in a periodic steady state,
/// add to every line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Transients {
    /// They are estimated with the response, by local polynomials on the lines of the grid, and removed: from segments
    /// that are whole periods of the stimulus if they stand above the noise, from others always.
    Remove,
    /// They stay in the response, and `leakage` says how much they are.
    Keep,
}

/// The window of a segment of `N` samples, in its periodic form.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Window {
    /// `wᵢ = 1`; equivalent noise bandwidth 1 line.
    #[default]
    Rectangular,
    /// `wᵢ = 0.5 − 0.5 cos(2πi/N)`; 1.5 lines.
    Hann,
    /// `wᵢ = 0.54 − 0.46 cos(2πi/N)`; 1.36 lines.
    Hamming,
    /// `wᵢ = 0.42 − 0.5 cos(2πi/N) + 0.08 cos(4πi/N)`; 1.73 lines.
    Blackman,
}

impl Window {
    /// The window's value at sample `i` of `samples`.
    #[must_use]
    pub fn value(self, i: usize, samples: usize) -> f64 {
        let angle = 2.0 * PI * i as f64 / samples as f64;
        match self {
            Self::Rectangular => 1.0,
            Self::Hann => 0.5 - 0.5 * angle.cos(),
            Self::Hamming => 0.54 - 0.46 * angle.cos(),
            Self::Blackman => 0.42 - 0.5 * angle.cos() + 0.08 * (2.0 * angle).cos(),
        }
    }

    /// How many lines to each side a pure line spreads over.
    pub(super) fn half_width(self) -> usize {
        match self {
            Self::Rectangular => 0,
            Self::Hann | Self::Hamming => 1,
            Self::Blackman => 2,
        }
    }

    /// Equivalent noise bandwidth in lines: `N Σw² / (Σw)²`.
    #[must_use]
    pub fn noise_bandwidth_lines(self) -> f64 {
        match self {
            Self::Rectangular => 1.0,
            Self::Hann => 1.5,
            Self::Hamming => (0.54 * 0.54 + 0.5 * 0.46 * 0.46) / (0.54 * 0.54),
            Self::Blackman => (0.42 * 0.42 + 0.5 * (0.5 * 0.5 + 0.08 * 0.08)) / (0.42 * 0.42),
        }
    }
}

/// How segments are averaged; the formulas are those of this module's description.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Average {
    /// The mean of the ratios output/input, as Zhang (2015) does.
    #[default]
    Ratios,
    /// The ratio of the summed cross spectrum to the summed input spectrum (H1): segments count by their input's power.
    CrossSpectra,
}

/// Whether a segment's end sample belongs to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EndSample {
    /// `N` samples: one period of a periodic signal.
    Excluded,
    /// `N + 1` samples, as in the sums of Zhang (2015).
    Included,
}

/// How frequency data are computed, as people write it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FrequencySettings {
    /// The frequencies: `"excited"` (default), `"zhang2015_chapter_3"`, `"zhang2015_chapter_5"`, or
    /// `{"frequency_hz": [..]}`.
    pub lines: Lines,
    /// The segments: `[{"start_s", "end_s"}, ..]`, `{"count": 2}` or `{"length_s": 20, "start_s": 5}`.
    /// Default: those of the preset; for other lines one segment with all samples of the record.
    pub segments: Option<Segments>,
    /// What is taken off every segment. Default: `line` where transients are removed, `mean` where they are kept;
    /// nothing for the presets and where the line 0 Hz is named.
    pub detrend: Option<Detrend>,
    /// What becomes of transients. Default: `remove`; `keep` for the presets and with a window.
    pub transients: Option<Transients>,
    /// The window. Default: rectangular.
    pub window: Window,
    /// How segments are averaged; has no effect where transients are removed from segments that are no whole periods,
    /// which are combined by least squares. Default: ratios.
    pub average: Average,
    /// Whether the end sample of a segment belongs to it. Default: included for the presets, excluded otherwise.
    pub end_sample: Option<EndSample>,
    /// Only for excited lines: the lowest and the highest frequency, in Hz. Default: all up to the Nyquist frequency.
    pub band_hz: Option<[f64; 2]>,
    /// A line carries power if it has this fraction of the power of the strongest line (0 Hz excepted). Weaker lines
    /// are not excited; if they were named, a warning says so. Default: 0.001.
    pub power_threshold: f64,
    /// An excited line must stand above the noise floor around it by this factor, in power. The floor is the median of
    /// those of the 64 nearest lines that are below `power_threshold`; where there are none, there is no floor.
    /// Default: 10.
    pub floor_ratio: f64,
}

impl Default for FrequencySettings {
    fn default() -> Self {
        Self {
            lines: Lines::default(),
            segments: None,
            detrend: None,
            transients: None,
            window: Window::default(),
            average: Average::default(),
            end_sample: None,
            band_hz: None,
            power_threshold: 1e-3,
            floor_ratio: 10.0,
        }
    }
}

/// What drives the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stimulus {
    /// The command r.
    #[default]
    Command,
    /// The disturbance d at the plant's input.
    Disturbance,
}

/// What answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Response {
    /// The output y.
    #[default]
    Output,
    /// The control u.
    Control,
    /// The error r − y.
    Error,
}

/// From which signal to which.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Channels {
    /// The input.
    pub input: Stimulus,
    /// The output.
    pub output: Response,
}

/// A setting that cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{reason}")]
pub struct SettingsError {
    /// The field, as a JSON pointer within the settings: `/lines/frequency_hz/3`.
    pub field: String,
    /// What is wrong with it, with its value.
    pub reason: String,
}

fn wrong(field: impl Into<String>, reason: impl Into<String>) -> SettingsError {
    SettingsError { field: field.into(), reason: reason.into() }
}

/// Settings that have been checked, with every default filled in.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckedSettings {
    settings: FrequencySettings,
    pub(super) segments: Segments,
    pub(super) end_sample: EndSample,
    pub(super) detrend: Detrend,
    pub(super) transients: Transients,
    /// `None` for the excited lines.
    pub(super) frequency_hz: Option<Vec<f64>>,
}

impl CheckedSettings {
    /// The settings with every default filled in; checking them again gives equal ones.
    #[must_use]
    pub fn settings(&self) -> &FrequencySettings {
        &self.settings
    }
}

impl FrequencySettings {
    /// Checks all that can be checked without a trial.
    ///
    /// # Errors
    /// [`SettingsError`] with the field.
    pub fn check(&self) -> Result<CheckedSettings, SettingsError> {
        let preset = matches!(self.lines, Lines::Zhang2015Chapter3 | Lines::Zhang2015Chapter5);
        let end_sample = self.end_sample.unwrap_or(if preset { EndSample::Included } else { EndSample::Excluded });
        let segments = self.segments.clone().unwrap_or_else(|| match self.lines {
            Lines::Zhang2015Chapter3 => {
                Segments::Bounds(vec![Bounds { start_s: 0.0, end_s: 40.0 }, Bounds { start_s: 40.0, end_s: 80.0 }])
            }
            Lines::Zhang2015Chapter5 => Segments::Bounds(vec![Bounds { start_s: 0.0, end_s: 60.0 }]),
            Lines::Excited | Lines::FrequencyHz(_) => Segments::Count(CountSegments { count: 1 }),
        });
        check_segments(&segments)?;
        let frequency_hz = match &self.lines {
            Lines::Excited => None,
            // Divided, not multiplied by a rounded step, so that the last line is 0.4 Hz and not next to it.
            Lines::Zhang2015Chapter3 => Some((0..13).map(|k| f64::from(4 + k) / 40.0).collect()),
            Lines::Zhang2015Chapter5 => Some((0..31).map(|k| f64::from(k) / 60.0).collect()),
            Lines::FrequencyHz(lines) => Some(sorted_lines(lines)?),
        };
        let names_zero = frequency_hz.as_ref().is_some_and(|lines: &Vec<f64>| lines.contains(&0.0));
        let is_windowed = self.window != Window::Rectangular;
        let transients =
            self.transients.unwrap_or(if preset || is_windowed { Transients::Keep } else { Transients::Remove });
        let detrend = self.detrend.unwrap_or(match transients {
            _ if preset || names_zero => Detrend::None,
            Transients::Remove => Detrend::Line,
            Transients::Keep => Detrend::Mean,
        });
        if detrend != Detrend::None && names_zero {
            return Err(wrong("/detrend", "taking off the mean or a trend leaves nothing at the line 0 Hz"));
        }
        if transients == Transients::Remove && is_windowed {
            return Err(wrong(
                "/transients",
                "transients are removed from the lines of a rectangular window; leave the window out, or keep them",
            ));
        }
        if let Some([low, high]) = self.band_hz {
            if frequency_hz.is_some() {
                return Err(wrong("/band_hz", "a band chooses among the excited lines, and here the lines are named"));
            }
            if !(low >= 0.0 && high > low && high.is_finite()) {
                return Err(wrong("/band_hz", format!("the band from {low} to {high} Hz is none")));
            }
        }
        if frequency_hz.is_none() && end_sample == EndSample::Included {
            return Err(wrong(
                "/end_sample",
                "excited lines are those of a periodic segment, which its end sample does not belong to",
            ));
        }
        if !(self.power_threshold > 0.0 && self.power_threshold < 1.0) {
            return Err(wrong(
                "/power_threshold",
                format!("the threshold is {}, and must be between 0 and 1", self.power_threshold),
            ));
        }
        if !(self.floor_ratio >= 1.0 && self.floor_ratio.is_finite()) {
            return Err(wrong("/floor_ratio", format!("the ratio is {}, and must be 1 or more", self.floor_ratio)));
        }
        let lines = match (&self.lines, &frequency_hz) {
            (Lines::FrequencyHz(_), Some(sorted)) => Lines::FrequencyHz(sorted.clone()),
            (lines, _) => lines.clone(),
        };
        let settings = Self {
            lines,
            segments: Some(segments.clone()),
            end_sample: Some(end_sample),
            detrend: Some(detrend),
            transients: Some(transients),
            ..self.clone()
        };
        Ok(CheckedSettings { settings, segments, end_sample, detrend, transients, frequency_hz })
    }
}

/// The lines in increasing order; the same line twice is named.
fn sorted_lines(lines: &[f64]) -> Result<Vec<f64>, SettingsError> {
    const FIELD: &str = "/lines/frequency_hz";
    if lines.is_empty() {
        return Err(wrong(FIELD, "there is no frequency"));
    }
    if lines.len() > MAX_LINES {
        return Err(wrong(FIELD, format!("there are {} frequencies, {MAX_LINES} at most", lines.len())));
    }
    if let Some(i) = lines.iter().position(|line| !(line.is_finite() && *line >= 0.0)) {
        return Err(wrong(format!("{FIELD}/{i}"), format!("the frequency {} Hz is none", lines[i])));
    }
    let mut order: Vec<usize> = (0..lines.len()).collect();
    order.sort_by(|a, b| lines[*a].total_cmp(&lines[*b]));
    if let Some(twins) = order.windows(2).find(|pair| lines[pair[0]] == lines[pair[1]]) {
        let reason = format!(
            "the frequency {} Hz is there twice, at the places {} and {}; leave one of them out",
            lines[twins[0]], twins[0], twins[1]
        );
        return Err(wrong(format!("{FIELD}/{}", twins[1]), reason));
    }
    Ok(order.into_iter().map(|i| lines[i]).collect())
}

fn check_segments(segments: &Segments) -> Result<(), SettingsError> {
    const FIELD: &str = "/segments";
    match segments {
        Segments::Bounds(bounds) => {
            if bounds.is_empty() {
                return Err(wrong(FIELD, "there is no segment"));
            }
            if bounds.len() > MAX_SEGMENTS {
                return Err(wrong(FIELD, format!("there are {} segments, {MAX_SEGMENTS} at most", bounds.len())));
            }
            for (i, Bounds { start_s, end_s }) in bounds.iter().enumerate() {
                if !(*start_s >= 0.0 && end_s > start_s && end_s.is_finite()) {
                    return Err(wrong(
                        format!("{FIELD}/{i}"),
                        format!("there is no segment from {start_s} s to {end_s} s"),
                    ));
                }
                if bounds[..i].contains(&bounds[i]) {
                    return Err(wrong(
                        format!("{FIELD}/{i}"),
                        format!("the segment from {start_s} s to {end_s} s is there twice"),
                    ));
                }
            }
        }
        Segments::Count(CountSegments { count }) => {
            if !(1..=MAX_SEGMENTS).contains(count) {
                return Err(wrong(
                    "/segments/count",
                    format!("there are {count} segments, 1 to {MAX_SEGMENTS} can be"),
                ));
            }
        }
        Segments::Length(LengthSegments { length_s, start_s }) => {
            if !(*length_s > 0.0 && length_s.is_finite()) {
                return Err(wrong("/segments/length_s", format!("the length {length_s} s is none")));
            }
            if !(*start_s >= 0.0 && start_s.is_finite()) {
                return Err(wrong("/segments/start_s", format!("no record has a sample at {start_s} s")));
            }
        }
    }
    Ok(())
}
