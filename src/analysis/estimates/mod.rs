//! What reports of each estimator say about a trial: the numbers that people take from them, and how far each may be
//! used.

mod answers;
mod evidence;
mod kept;
mod quantities;
mod regression;

pub use evidence::evidence;
pub use kept::{Kept, KeptEstimate, kept};
pub use quantities::{QuantityTrust, quantities};

use super::Report;
use crate::control::discretise::zero_order_hold;
use crate::control::{Discrete, Model, System};
use crate::learning::frequency_domain::{ControllerMetrics, UndefinedNorm, controller_metrics_of};
use crate::learning::inputs::{Estimator, Identification, IdentifiedControllers, NormIntervals, StandardErrors};
use crate::num::Complex64;
use crate::num::distributions::student_t;
use serde_json::Value;

/// Probability of intervals.
const PROBABILITY: f64 = 0.95;

/// Said where a plant is needed and not known.
const NO_PLANT: &str = "its plant is not known";

/// Names of the norms, as reports have them.
const NORMS: [&str; 3] = ["norm_feedback", "norm_feedforward_minus_inverse", "norm_feedforward_plant_minus_one"];

/// A report about a trial.
#[derive(Debug, Clone, Copy)]
pub struct About<'a> {
    /// The id of the analysis.
    pub analysis: &'a str,
    /// SHA-256 of its spec.
    pub spec_sha256: &'a str,
    /// The trial's place among those of the analysis, from 0.
    pub position: usize,
    /// The report.
    pub report: &'a Report,
}

/// What a report says about its trial on `plant`; `None` where it has no answer of this estimator. The plant is needed
/// where the report has none itself.
///
/// # Errors
/// What cannot be read, in words.
pub fn identification(
    estimator: Estimator,
    about: About<'_>,
    plant: Option<&Model>,
) -> Result<Option<Identification>, String> {
    let result = &about.report.result;
    let told = evidence(about.report, estimator, about.position);
    let mut found = Identification::unread(about.analysis, about.spec_sha256, estimator, told);
    match estimator {
        Estimator::Ssid => {
            found.controllers = Some(controllers(result, result, plant)?);
            found.metrics = metrics(result)?;
            found.variance_accounted_for = result.get("variance_accounted_for").and_then(Value::as_f64);
            found.cost = result.get("cost").and_then(Value::as_f64);
            found.intervals.reason = Some(
                "the pool's best candidate has no interval: others that fit as well may have other norms".to_owned(),
            );
        }
        Estimator::SsidRefined => {
            let Some(refined) = result.get("refined").filter(|refined| !refined.is_null()) else { return Ok(None) };
            let both = controllers(result, refined, plant)?;
            let number = |name: &str| refined.get(name).and_then(Value::as_f64);
            let delay = |name: &str| number(name).unwrap_or(0.0);
            let delays = [delay("feedforward_delay_s"), delay("feedback_delay_s")];
            found.metrics = match metrics(refined)? {
                Some(own) => Some(own),
                None => refined_metrics(&both, delays, metrics(result)?)?,
            };
            found.cost = number("cost");
            if delays == [0.0; 2] {
                found.controllers = Some(both);
            }
            found.intervals.reason =
                Some("the refinement has bands of its responses, but no interval of their norms".to_owned());
        }
        Estimator::TwoStimulus => two_stimulus(result, plant, &mut found)?,
        Estimator::PredictionError => {
            let Some(trial) = result.get("trials").and_then(|trials| trials.get(about.position)) else {
                // A trial that was only held out.
                return Ok(None);
            };
            prediction_error(result, trial, &mut found)?;
            found.controllers = regression::controllers(result, trial, plant);
        }
    }
    Ok(Some(found))
}

fn system(object: &Value, field: &str) -> Result<System, String> {
    let value = object.get(field).ok_or_else(|| format!("it has no {field}"))?;
    let model: Model = serde_json::from_value(value.clone()).map_err(|error| format!("its {field}: {error}"))?;
    model.check().map_err(|error| format!("its {field}: {error}"))
}

/// The controllers of `part`, with the plant of `result` in their time base.
fn controllers(result: &Value, part: &Value, plant: Option<&Model>) -> Result<IdentifiedControllers, String> {
    let (feedforward, feedback) = (system(part, "feedforward")?, system(part, "feedback")?);
    let plant = match result.get("plant") {
        Some(_) => system(result, "plant")?,
        None => in_time_base(plant.ok_or(NO_PLANT)?.check().map_err(|error| error.to_string())?, &feedback)?,
    };
    Ok(IdentifiedControllers { plant, feedforward, feedback })
}

/// A continuous plant as the sampled controllers meet it, behind a zero-order hold.
fn in_time_base(plant: System, controller: &System) -> Result<System, String> {
    match (&plant, controller.sample_time_s()) {
        (System::Continuous(continuous), Some(period)) => {
            let time = Discrete::new(period).map_err(|error| error.to_string())?;
            zero_order_hold(continuous, time).map(System::Discrete).map_err(|error| error.to_string())
        }
        _ => Ok(plant),
    }
}

fn metrics(object: &Value) -> Result<Option<ControllerMetrics>, String> {
    match object.get("metrics") {
        None | Some(Value::Null) => Ok(None),
        Some(value) => serde_json::from_value(value.clone()).map(Some).map_err(|error| format!("its metrics: {error}")),
    }
}

/// The norms of refined controllers over the band of the pool's.
fn refined_metrics(
    both: &IdentifiedControllers,
    [feedforward_s, feedback_s]: [f64; 2],
    pool: Option<ControllerMetrics>,
) -> Result<Option<ControllerMetrics>, String> {
    let Some(pool) = pool else { return Ok(None) };
    let delayed =
        |system: &System, omega: f64, delay: f64| system.response(omega) * Complex64::from_polar(1.0, -omega * delay);
    let found = controller_metrics_of(
        |omega| (both.plant.response(omega), Complex64::from(1.0)),
        |omega| delayed(&both.feedforward, omega, feedforward_s),
        |omega| delayed(&both.feedback, omega, feedback_s),
        (pool.band_rad_s[0], pool.band_rad_s[1]),
    );
    found.map(Some).map_err(|error| error.to_string())
}

fn prediction_error(result: &Value, trial: &Value, found: &mut Identification) -> Result<(), String> {
    let norms = trial.get("metrics").ok_or("a trial of it has no metrics")?;
    let number = |norm: &str, field: &str| norms.get(norm)?.get(field)?.as_f64();
    let mut undefined = Vec::new();
    let mut reasons = Vec::new();
    for name in NORMS {
        let reason = norms.get(name).and_then(|n| n.get("reason")).and_then(Value::as_str);
        let Some(reason) = reason else { continue };
        if number(name, "value").is_none() {
            undefined.push(UndefinedNorm { field: name.to_owned(), reason: reason.to_owned() });
        }
        reasons.push(format!("{name}: {reason}"));
    }
    let band = result.get("band_hz").and_then(|band| serde_json::from_value::<[f64; 2]>(band.clone()).ok());
    let band = band.ok_or("it has no band_hz")?;
    let value = NORMS.map(|name| number(name, "value"));
    let error = NORMS.map(|name| number(name, "standard_error"));
    let interval = NORMS.map(|name| {
        norms
            .get(name)
            .and_then(|n| n.get("interval_95"))
            .and_then(|i| serde_json::from_value::<[f64; 2]>(i.clone()).ok())
    });
    found.metrics = Some(ControllerMetrics {
        norm_feedback: value[0],
        norm_feedforward_minus_inverse: value[1],
        norm_feedforward_plant_minus_one: value[2],
        band_rad_s: band.map(|f| 2.0 * std::f64::consts::PI * f),
        undefined,
    });
    found.standard_errors = errors(error);
    found.intervals = intervals(interval, (!reasons.is_empty()).then(|| reasons.join("; ")));
    found.variance_accounted_for = trial.pointer("/accounted_for/simulated_y").and_then(Value::as_f64);
    Ok(())
}

fn errors(
    [norm_feedback, norm_feedforward_minus_inverse, norm_feedforward_plant_minus_one]: [Option<f64>; 3],
) -> StandardErrors {
    StandardErrors { norm_feedback, norm_feedforward_minus_inverse, norm_feedforward_plant_minus_one }
}

fn intervals(of: [Option<[f64; 2]>; 3], reason: Option<String>) -> NormIntervals {
    let [norm_feedback, norm_feedforward_minus_inverse, norm_feedforward_plant_minus_one] = of;
    NormIntervals { norm_feedback, norm_feedforward_minus_inverse, norm_feedforward_plant_minus_one, reason }
}

/// A response at a line: ω, the value and the variance `E|δ|²` of its noise.
struct Line {
    omega_rad_s: f64,
    value: Complex64,
    variance: Option<f64>,
}

/// The average magnitude over lines by the trapezoidal rule, its standard error from independent noise of the lines;
/// the average is `None` of fewer than two lines.
fn average(lines: &[Line]) -> (Option<f64>, Option<f64>) {
    let (Some(first), Some(last)) = (lines.first(), lines.last()) else { return (None, None) };
    let width = last.omega_rad_s - first.omega_rad_s;
    if width <= 0.0 {
        return (None, None);
    }
    let (mut value, mut variance) = (0.0, Some(0.0));
    for (i, line) in lines.iter().enumerate() {
        let before = lines[i.saturating_sub(1)].omega_rad_s;
        let after = lines[(i + 1).min(lines.len() - 1)].omega_rad_s;
        let weight = 0.5 * (after - before) / width;
        value += weight * line.value.norm();
        // Of a complex error half its variance lies along the value.
        variance = variance.zip(line.variance).map(|(sum, v)| sum + 0.5 * weight * weight * v);
    }
    (Some(value), variance.map(f64::sqrt))
}

fn two_stimulus(result: &Value, plant: Option<&Model>, found: &mut Identification) -> Result<(), String> {
    let plant = plant.ok_or(NO_PLANT)?.check().map_err(|error| error.to_string())?;
    let written = result.get("lines").and_then(Value::as_array).ok_or("it has no lines")?;
    let (mut feedback, mut inverse, mut one) = (Vec::new(), Vec::new(), Vec::new());
    let mut interpolated = false;
    let mut degrees = f64::INFINITY;
    for line in written {
        let omega_rad_s = line.get("omega_rad_s").and_then(Value::as_f64).ok_or("a line has no omega_rad_s")?;
        let part = |name: &str| {
            let part = line.get(name).filter(|part| !part.is_null())?;
            let [re, im] = serde_json::from_value::<[f64; 2]>(part.get("value")?.clone()).ok()?;
            let is_interpolated = part.get("interpolated").and_then(Value::as_bool).unwrap_or(false);
            let variance = part.get("variance").and_then(Value::as_f64).filter(|_| !is_interpolated);
            Some((Complex64::new(re, im), variance, is_interpolated))
        };
        if let Some(freedom) = line.get("degrees_of_freedom").and_then(Value::as_f64) {
            degrees = degrees.min(2.0 * freedom);
        }
        if let Some((value, variance, is_interpolated)) = part("feedback") {
            interpolated |= is_interpolated;
            feedback.push(Line { omega_rad_s, value, variance });
        }
        if let Some((value, variance, is_interpolated)) = part("feedforward") {
            interpolated |= is_interpolated;
            let g = plant.response(omega_rad_s);
            inverse.push(Line { omega_rad_s, value: value - 1.0 / g, variance });
            let scaled = variance.map(|v| v * g.norm_sqr());
            one.push(Line { omega_rad_s, value: value * g - 1.0, variance: scaled });
        }
    }
    let all = [&feedback, &inverse, &one].map(|lines| average(lines));
    let quantile = student_t(PROBABILITY, degrees.max(1.0));
    let interval =
        all.map(|(value, error)| value.zip(error).map(|(v, e)| [(v - quantile * e).max(0.0), v + quantile * e]));
    let undefined = NORMS
        .iter()
        .zip(&all)
        .filter(|(_, (value, _))| value.is_none())
        .map(|(name, _)| UndefinedNorm {
            field: (*name).to_owned(),
            reason: "fewer than two lines determine the controller".to_owned(),
        })
        .collect();
    let ends = |lines: &[Line]| lines.first().zip(lines.last()).map(|(a, b)| [a.omega_rad_s, b.omega_rad_s]);
    found.metrics = Some(ControllerMetrics {
        norm_feedback: all[0].0,
        norm_feedforward_minus_inverse: all[1].0,
        norm_feedforward_plant_minus_one: all[2].0,
        band_rad_s: ends(&feedback).or_else(|| ends(&one)).ok_or("none of its lines determines a controller")?,
        undefined,
    });
    found.standard_errors = errors(all.map(|(_, error)| error));
    let reason = if interval.iter().all(Option::is_some) {
        None
    } else if interpolated {
        Some("the feedback is interpolated between lines, with an error that is not noise".to_owned())
    } else {
        Some("the noise of some lines is not known".to_owned())
    };
    found.intervals = intervals(interval, reason);
    found.variance_accounted_for = result
        .get("best")
        .and_then(Value::as_u64)
        .and_then(|best| result.get("fits")?.get(best as usize)?.pointer("/simulated_vaf/y")?.as_f64());
    Ok(())
}
