//! The closed-loop frequency response of trials: kind `frequency_response`.
//!
//! ```json
//! {"kind": "frequency_response", "inputs": {"trials": ["ID", "ID"]},
//!  "spec": {"lines": "excited", "segments": [{"start_s": 5, "end_s": 25}, {"start_s": 25, "end_s": 45}]}}
//! ```
//! Inputs are those of [`trials`](super::inputs::trials); a plant is not needed. The formulas are those of
//! [`response`](crate::response).

use super::contract::{Analysis, Failure, Outcome, Part};
use super::inputs::frequency_problem;
use super::inputs::library::Library;
use super::inputs::trials::{ResolvedTrial, TrialInputs};
use super::kind::Kind;
use super::problem::Problem;
use super::reading;
use super::report::Warning;
use crate::ctl::Ctl;
use crate::response::{
    Channels, CheckedSettings, Estimate, EstimateWarning, FrequencyError, FrequencySettings, Response, Stimulus,
    VarianceSource, estimate_between,
};
use crate::trial::Trial;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The spec: from which signal to which, and how.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FrequencyResponseSpec {
    /// The input. Default: the command.
    #[serde(default)]
    pub input: Stimulus,
    /// The output. Default: the output y.
    #[serde(default)]
    pub output: Response,
    /// How the response is estimated.
    #[serde(flatten)]
    pub settings: FrequencySettings,
}

/// A segment that was transformed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SegmentResult {
    /// The trial, by its place in the request: `/inputs/trials/0`.
    pub trial: String,
    /// Where it starts, in seconds from the trial's first sample.
    pub start_s: f64,
    /// Its length; lines at multiples of `1/length_s` are on its grid.
    pub length_s: f64,
    /// Samples that were summed.
    pub samples: usize,
    /// The slope that was taken off the output, in its units a second; null where there was none to take off.
    #[serde(default)]
    pub slope_per_s: Option<f64>,
}

/// The result; arrays are equally long, in increasing frequency. What does not exist is null, and a warning says why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FrequencyResponseResult {
    /// Frequencies in Hz.
    pub frequency_hz: Vec<f64>,
    /// Angular frequencies in rad/s.
    pub omega_rad_s: Vec<f64>,
    /// The complex response as `[re, im]`; null where the input has no power.
    pub h: Vec<Option<[f64; 2]>>,
    /// Its gain, `20 log₁₀|h|`; null also where the response is zero.
    pub gain_db: Vec<Option<f64>>,
    /// Its phase in degrees, principal value in (−180, 180].
    pub phase_deg: Vec<Option<f64>>,
    /// Variance of the complex response, `E|h − E h|²` (both parts together), in squared units of h; of local
    /// polynomials the mean square error, with what of transients is left.
    pub variance: Vec<Option<f64>>,
    /// `repetition` (scatter of the segments), `nearby_lines` (output power between the stimuli's lines),
    /// `local_polynomial` (response and transient estimated together), or null.
    pub variance_source: Option<String>,
    /// What transients, slopes and the window leave in h, root mean square, in units of h; 0 where nothing stands above
    /// the noise, null where it cannot be told.
    #[serde(default)]
    pub leakage: Vec<Option<f64>>,
    /// Whether the error (variance and leakage) is at most a fifth of |h|, or of the median |h| where that is larger,
    /// and the data tell the response from the transient; identification leaves other lines out where local polynomials
    /// found them.
    #[serde(default)]
    pub usable: Vec<bool>,
    /// Whether transients were removed from h.
    #[serde(default)]
    pub transients_removed: bool,
    /// Real degrees of freedom of the variances of local polynomials, the fewest of all lines; null of others.
    #[serde(default)]
    pub variance_degrees_of_freedom: Option<f64>,
    /// Mean square of the input's sinusoid on the line, averaged over segments, in squared units of the input.
    pub command_power: Vec<f64>,
    /// The same of the segment in which it is weakest.
    pub command_power_minimum: Vec<f64>,
    /// Share of the output's power that the averaged response explains, `|Σ R̄Y|²/(Σ|R|² Σ|Y|²)`, times
    /// `|h|²/(|h|² + leakage²)`: what leaks into every segment alike is coherent, and no response; null of one segment.
    pub coherence: Vec<Option<f64>>,
    /// Segments averaged.
    pub averages: Vec<usize>,
    /// Step of the grid of the shortest segment, in Hz.
    pub resolution_hz: f64,
    /// Equivalent noise bandwidth of the window on that grid, in Hz.
    pub noise_bandwidth_hz: f64,
    /// The segments.
    pub segments: Vec<SegmentResult>,
}

impl FrequencyResponseResult {
    /// The result of an estimate from these trials.
    #[must_use]
    pub fn new(estimate: &Estimate, trials: &[ResolvedTrial]) -> Self {
        Self {
            frequency_hz: estimate.frequency_hz.clone(),
            omega_rad_s: estimate.omega_rad_s.clone(),
            h: estimate.h.iter().map(|h| h.map(|h| [h.re, h.im])).collect(),
            gain_db: estimate
                .h
                .iter()
                .map(|h| h.map(|h| 20.0 * h.norm().log10()).filter(|gain| gain.is_finite()))
                .collect(),
            phase_deg: estimate.h.iter().map(|h| h.filter(|h| h.norm() > 0.0).map(|h| h.arg().to_degrees())).collect(),
            variance: estimate.variance.clone(),
            variance_source: estimate.variance_source.map(|source| {
                let name = match source {
                    VarianceSource::Repetition => "repetition",
                    VarianceSource::NearbyLines => "nearby_lines",
                    VarianceSource::LocalPolynomial => "local_polynomial",
                };
                name.to_owned()
            }),
            leakage: estimate.leakage.clone(),
            usable: estimate.usable.clone(),
            transients_removed: estimate.transients_removed,
            variance_degrees_of_freedom: estimate.degrees_of_freedom,
            command_power: estimate.input_power.clone(),
            command_power_minimum: estimate.input_power_minimum.clone(),
            coherence: estimate.coherence.clone(),
            averages: estimate.averages.clone(),
            resolution_hz: estimate.resolution_hz,
            noise_bandwidth_hz: estimate.noise_bandwidth_hz,
            segments: estimate
                .segments
                .iter()
                .map(|segment| SegmentResult {
                    trial: trials[segment.trial].name.clone(),
                    start_s: segment.start_s,
                    length_s: segment.length_s,
                    samples: segment.samples,
                    slope_per_s: segment.slope_per_s,
                })
                .collect(),
        }
    }
}

impl Part for FrequencyResponseSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        let mut members = match value {
            Value::Object(members) => members.clone(),
            _ => return Err(reading::wrong_spec("the spec is no object", at)),
        };
        let mut channel = |name: &str| members.remove(name).map(|value| (format!("{at}/{name}"), value));
        let (input, output) = (channel("input"), channel("output"));
        Ok(Self {
            input: input.map_or_else(|| Ok(Stimulus::default()), |(at, value)| reading::setting(&value, &at))?,
            output: output.map_or_else(|| Ok(Response::default()), |(at, value)| reading::setting(&value, &at))?,
            settings: frequency_problem::read_settings(&members, at)?,
        })
    }
}

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: TrialInputs,
    spec: FrequencyResponseSpec,
    settings: CheckedSettings,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("frequency_response");
    const TITLE: &'static str = "Frequency response";
    const SUMMARY: &'static str = "The closed loop's frequency response from the command (or the disturbance) to the \
                                   output (or the control), from the segments of one trial or of several, at the lines \
                                   where the stimulus carries power, with the variance and the coherence of each line \
                                   (Zhang 2015, sections 3.5.1 and 5.6.1).";
    const RESULT_VERSION: u32 = 2;
    const EXAMPLE: &'static str = include_str!("example.json");
    const TAKES_TRIALS: bool = true;

    type Inputs = TrialInputs;
    type Spec = FrequencyResponseSpec;
    type Result = FrequencyResponseResult;

    fn check(inputs: TrialInputs, spec: FrequencyResponseSpec) -> Result<Self, Problem> {
        let settings = frequency_problem::check_settings(&spec.settings, "/spec")?;
        let spec = FrequencyResponseSpec { settings: settings.settings().clone(), ..spec };
        Ok(Self { inputs, spec, settings })
    }

    fn inputs(&self) -> &TrialInputs {
        &self.inputs
    }

    fn spec(&self) -> &FrequencyResponseSpec {
        &self.spec
    }

    /// Progress counts segments.
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Outcome<FrequencyResponseResult>, Failure> {
        let resolved = self.inputs.resolve(library)?;
        let trials: Vec<&Trial> = resolved.iter().map(ResolvedTrial::trial).collect();
        let channels = Channels { input: self.spec.input, output: self.spec.output };
        let estimate = estimate_between(&trials, &self.settings, channels, ctl).map_err(|error| match error {
            FrequencyError::Stopped(stopped) => Failure::Stopped(stopped),
            error => Failure::Problem(frequency_problem::problem(&error, &resolved, "/spec")),
        })?;
        let mut warnings: Vec<Warning> = left_out_warnings(&resolved);
        warnings.extend(estimate.warnings.iter().map(Warning::from));
        Ok(Outcome::new(FrequencyResponseResult::new(&estimate, &resolved), warnings))
    }
}

impl From<&EstimateWarning> for Warning {
    fn from(warning: &EstimateWarning) -> Self {
        Self::new(warning.code, warning.message.clone())
    }
}

/// Warnings that name the divergent trials among these, and the excluded ones with the reason, if there are any.
#[must_use]
pub fn left_out_warnings(trials: &[ResolvedTrial]) -> Vec<Warning> {
    let excluded: Vec<String> =
        trials.iter().filter_map(|trial| Some(format!("{} ({})", trial.name, trial.excluded()?))).collect();
    let excluded = (!excluded.is_empty()).then(|| {
        let message = format!("used all the same, though somebody excluded it: {}", excluded.join(", "));
        Warning::new("excluded_trial", message)
    });
    divergent_warning(trials).into_iter().chain(excluded).collect()
}

fn divergent_warning(trials: &[ResolvedTrial]) -> Option<Warning> {
    let divergent: Vec<&str> =
        trials.iter().filter(|trial| trial.divergent()).map(|trial| trial.name.as_str()).collect();
    (!divergent.is_empty()).then(|| {
        let message = format!(
            "|y| passed the study's display limit in {}: the person lost the object, and no linear time-invariant law \
             may describe that",
            divergent.join(", ")
        );
        Warning::new("divergent_trial", message)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::{Code, Plan, Request};
    use crate::ctl::StopReason;
    use serde_json::json;

    fn request(spec: Value) -> Request {
        // Period 8 samples; y is r delayed by one sample, so the response is e^{−jωT}.
        let r: Vec<f64> = (0..16).map(|i| (std::f64::consts::PI * f64::from(i) / 4.0).sin() + 1.0).collect();
        let y: Vec<f64> = (0..16).map(|i| r[(i + 15) % 16]).collect();
        let inputs = json!({"trial": {"sample_time_s": 0.5, "r": r, "u": vec![0.0; 16], "y": y}});
        Request { kind: "frequency_response".to_owned(), inputs, spec }
    }

    #[test]
    fn a_delay_has_its_gain_and_phase() {
        let spec = json!({"segments": {"count": 2}, "lines": {"frequency_hz": [0.0, 0.25]}});
        let plan = Plan::parse(&request(spec)).unwrap();
        let report = plan.run(&Library::default(), &Ctl::new()).unwrap();
        let result: FrequencyResponseResult = serde_json::from_value(report.result).unwrap();
        for (phase, expected) in result.phase_deg.iter().zip([0.0, -45.0]) {
            assert!((phase.unwrap() - expected).abs() < 1e-9, "{phase:?}");
        }
        assert!(result.gain_db.iter().all(|gain| gain.unwrap().abs() < 1e-9));
        assert_eq!(result.averages, [2, 2]);
        assert_eq!(report.schema, "volition.frequency_response/2");
        assert_eq!(report.provenance.inputs_sha256.len(), 1);
    }

    #[test]
    fn the_canonical_request_parses_to_an_equal_plan() {
        for spec in [
            json!({}),
            json!({"lines": "zhang2015_chapter_3", "output": "control"}),
            json!({"lines": "zhang2015_chapter_5", "segments": {"length_s": 3}, "end_sample": "excluded"}),
            json!({"segments": [{"start_s": 0, "end_s": 4}], "band_hz": [0.1, 0.3], "average": "cross_spectra"}),
        ] {
            let plan = Plan::parse(&request(spec)).unwrap();
            let again = Plan::parse(&plan.request()).unwrap();
            assert_eq!(again.request(), plan.request());
        }
    }

    #[test]
    fn every_refusal_names_its_field() {
        for (spec, location) in [
            (json!(3), "/spec"),
            (json!({"input": "speed"}), "/spec/input"),
            (json!({"lines": "all"}), "/spec/lines"),
            (json!({"lines": {"frequency_hz": [0.1, "x"]}}), "/spec/lines"),
            (json!({"lines": {"frequency_hz": [0.2, 0.1, 0.2]}}), "/spec/lines/frequency_hz/2"),
            (json!({"lines": {"frequency_hz": []}}), "/spec/lines/frequency_hz"),
            (json!({"lines": {"frequency_hz": [0.1]}, "band_hz": [0.0, 1.0]}), "/spec/band_hz"),
            (json!({"lines": {"frequency_hz": [0.0]}, "detrend": "mean"}), "/spec/detrend"),
            (json!({"band_hz": [1.0, 0.5]}), "/spec/band_hz"),
            (json!({"segments": {"count": 0}}), "/spec/segments/count"),
            (json!({"segments": {"cuont": 1}}), "/spec/segments"),
            (json!({"segments": [{"start_s": 2.0, "end_s": 1.0}]}), "/spec/segments/0"),
            (json!({"end_sample": "included"}), "/spec/end_sample"),
            (json!({"window": "hann", "transients": "remove"}), "/spec/transients"),
            (json!({"power_threshold": 0.0}), "/spec/power_threshold"),
            (json!({"floor_ratio": 0.5}), "/spec/floor_ratio"),
            (json!({"widnow": "hann"}), "/spec/widnow"),
        ] {
            let problem = Plan::parse(&request(spec.clone())).unwrap_err();
            assert_eq!(
                (problem.code, problem.location.as_deref()),
                (Code::Invalid, Some(location)),
                "{spec}: {problem}"
            );
        }
    }

    #[test]
    fn what_the_data_cannot_answer_is_a_problem() {
        for (spec, code, location, words) in [
            (json!({"lines": {"frequency_hz": [1.0]}}), Code::Invalid, "/spec/lines/frequency_hz/0", "Nyquist"),
            (json!({"segments": [{"start_s": 0, "end_s": 9}]}), Code::Invalid, "/spec/segments/0", "ends at 8 s"),
            (json!({"segments": {"count": 5}}), Code::Invalid, "/spec/segments", "at least 4"),
            (json!({"input": "disturbance"}), Code::Invalid, "/inputs/trial", "no disturbance"),
            (json!({"lines": {"frequency_hz": [0.3, 0.2]}}), Code::Invalid, "/spec/lines/frequency_hz/1", "nearer"),
            (json!({"band_hz": [0.3, 0.4]}), Code::NotIdentifiable, "/spec/lines", "excites no line from 0.3"),
        ] {
            let plan = Plan::parse(&request(spec.clone())).unwrap();
            let Failure::Problem(problem) = plan.run(&Library::default(), &Ctl::new()).unwrap_err() else {
                panic!("{spec} was stopped")
            };
            assert_eq!((problem.code, problem.location.as_deref()), (code, Some(location)), "{spec}: {problem}");
            assert!(problem.detail.contains(words), "{spec}: {problem}");
        }
    }

    #[test]
    fn it_stops_when_asked() {
        let plan = Plan::parse(&request(json!({}))).unwrap();
        let ctl = Ctl::new();
        ctl.stop(StopReason::Cancelled);
        assert!(matches!(plan.run(&Library::default(), &ctl), Err(Failure::Stopped(_))));
    }
}
