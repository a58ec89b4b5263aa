//! What reports of each kind say about controllers.

use super::{At, Estimate, Response, grid, hertz};
use crate::analysis::prediction_error::{ControllerRegion, PredictionErrorResult};
use crate::analysis::ssid::SsidResult;
use crate::analysis::two_stimulus::{ControllerAtLine, FittedAtLine, TwoStimulusResult};
use crate::analysis::{Analysis as _, Report, prediction_error, ssid, two_stimulus};
use crate::control::discretise::zero_order_hold;
use crate::control::{Discrete, Model, System};
use crate::figure::Ink;
use crate::figure::text::three;
use crate::num::Complex64;
use serde::de::DeserializeOwned;
use std::f64::consts::TAU;

/// What a report is about, as far as it does not say so itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Origin<'a> {
    /// The trial, or the trials, in words.
    pub subject: &'a str,
    /// The names of the trials, in the order of the request.
    pub trials: &'a [String],
    /// The plant that they were recorded on; `None` where it is not known.
    pub plant: Option<&'a Model>,
    /// The sample time of the trials in seconds, where it is known.
    pub sample_time_s: Option<f64>,
}

/// Why a report is not drawn.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unreadable {
    /// Its kind has nothing of that sort.
    #[error("a report of {kind} has no such figure")]
    Kind {
        /// The kind.
        kind: String,
    },
    /// Its result is not of the form that this version writes.
    #[error("the result is not of the form that this version knows: {0}")]
    Form(String),
    /// It holds nothing that could be drawn.
    #[error("the report holds nothing to draw: {0}")]
    Nothing(String),
}

/// What a report holds.
pub(super) struct Found {
    pub responses: Vec<Response>,
    /// What was found, in a sentence.
    pub finding: String,
    /// What the bands are, in a sentence.
    pub bands: String,
    pub band_hz: [f64; 2],
}

/// The result of a report.
pub(in crate::figure::of) fn result<T: DeserializeOwned>(report: &Report) -> Result<T, Unreadable> {
    serde_json::from_value(report.result.clone()).map_err(|error| Unreadable::Form(error.to_string()))
}

pub(super) fn responses(report: &Report, about: &Origin<'_>) -> Result<Found, Unreadable> {
    if report.kind == ssid::Plan::KIND {
        return of_ssid(&result(report)?, about);
    }
    if report.kind == two_stimulus::Plan::KIND {
        return of_two_stimulus(&result(report)?, about);
    }
    if report.kind == prediction_error::Plan::KIND {
        return of_prediction_error(&result(report)?, about);
    }
    Err(Unreadable::Kind { kind: report.kind.to_string() })
}

/// The three responses of which each estimate has some; without those that none has.
fn assembled(estimates: [Vec<Estimate>; 3]) -> Vec<Response> {
    let [feedforward, feedback, product] = estimates;
    [("Gff", feedforward, false), ("Gfb", feedback, false), ("Gff·G", product, true)]
        .into_iter()
        .map(|(symbol, estimates, reference)| Response { symbol, reference, doubt: String::new(), estimates })
        .filter(|response| response.estimates.iter().any(|estimate| !estimate.at.is_empty()))
        .collect()
}

/// The plant's response with its delay; `None` where there is no such plant.
fn plant_response(plant: Option<&Model>) -> Option<impl Fn(f64) -> Complex64> {
    let (system, delay_s) = plant?.check_delayed().ok()?;
    Some(move |omega: f64| system.response(omega) * Complex64::from_polar(1.0, -omega * delay_s))
}

fn system(model: &Model) -> Result<System, Unreadable> {
    model.check().map_err(|error| Unreadable::Form(error.to_string()))
}

/// A value with the bands of a line, where the line has them.
fn at(omega: f64, value: Complex64, bands: Option<([f64; 2], [f64; 2])>) -> At {
    let value = Some(value).filter(|value| value.is_finite() && value.norm() > 0.0);
    let (magnitude, phase_deg) = bands.unzip();
    At { frequency_hz: hertz(omega), value, magnitude, phase_deg, is_line: true }
}

fn of_ssid(result: &SsidResult, about: &Origin<'_>) -> Result<Found, Unreadable> {
    let lines: Vec<f64> = result.fit.iter().map(|line| line.omega_rad_s).collect();
    let omegas = grid(&lines);
    let (Some(first), Some(last)) = (omegas.first(), omegas.last()) else {
        return Err(Unreadable::Nothing("the report has no lines".to_owned()));
    };
    let plant = system(&result.plant)?;
    // A continuous plant's delay is not part of its transfer function.
    let delay_s = match (&plant, about.plant.map(Model::check_delayed)) {
        (System::Discrete(_), _) => Some(0.0),
        (System::Continuous(_), Some(Ok((_, delay_s)))) => Some(delay_s),
        _ => None,
    };
    let mut estimates: [Vec<Estimate>; 3] = Default::default();
    let delayed = |system: &System, omega: f64, delay_s: f64| {
        system.response(omega) * Complex64::from_polar(1.0, -omega * delay_s)
    };
    let named = |name: &str, ink| Estimate { name: name.to_owned(), ink, is_by_lines: false, at: Vec::new() };
    let mut push = |name: &str,
                    ink,
                    controllers: [(&System, f64); 2],
                    bands: &dyn Fn(usize, f64) -> Option<([f64; 2], [f64; 2])>| {
        for (of, estimates) in estimates.iter_mut().enumerate() {
            let (system, own_s) = controllers[usize::from(of == 1)];
            let values = omegas.iter().filter_map(|omega| {
                let value = delayed(system, *omega, own_s);
                let value = if of == 2 { value * delayed(&plant, *omega, delay_s?) } else { value };
                Some(At { is_line: lines.contains(omega), ..at(*omega, value, bands(of, *omega)) })
            });
            estimates.push(Estimate { at: values.collect(), ..named(name, ink) });
        }
    };
    let (feedforward, feedback) = (system(&result.feedforward)?, system(&result.feedback)?);
    push("pool", Ink::First, [(&feedforward, 0.0), (&feedback, 0.0)], &|_, _| None);
    let mut bands = "The pool's best candidate has no interval: others that fit as well may differ.".to_owned();
    if let Some(refined) = &result.refined {
        let (feedforward, feedback) = (system(&refined.feedforward)?, system(&refined.feedback)?);
        let uncertainty = refined.uncertainty.as_ref();
        let known = |of: usize, omega: f64| {
            let uncertainty = uncertainty?;
            let all = [&uncertainty.feedforward, &uncertainty.feedback, &uncertainty.feedforward_plant][of];
            let band = all.iter().find(|band| band.omega_rad_s == omega)?;
            Some((band.magnitude_band?, band.phase_band_deg?))
        };
        let delays = [(&feedforward, refined.feedforward_delay_s), (&feedback, refined.feedback_delay_s)];
        push("refined", Ink::Second, delays, &known);
        bands = match (&refined.uncertainty, &refined.uncertainty_reason) {
            (Some(uncertainty), _) if uncertainty.unavailable.is_none() => {
                "Bands: pointwise 95 % of the refined controllers; the pool's best candidate has none.".to_owned()
            }
            (Some(_), _) => format!("{bands} The refined controllers have no bands."),
            (None, Some(reason)) => format!("{bands} The refined controllers have no bands: {reason}."),
            (None, None) => bands,
        };
    }
    let norms = &result.metrics;
    let number = |value: Option<f64>| value.map_or_else(|| "none".to_owned(), three);
    Ok(Found {
        responses: assembled(estimates),
        finding: format!(
            "Best candidate of the pool: ‖Gfb‖ {}, ‖Gff G − 1‖ {}.",
            number(norms.norm_feedback),
            number(norms.norm_feedforward_plant_minus_one)
        ),
        bands,
        band_hz: [hertz(*first), hertz(*last)],
    })
}

/// The plant's response to a value with bands: a known factor moves a value and its bands alike.
fn times_plant(own: &At, plant: Complex64) -> At {
    let size = plant.norm();
    let turn = plant.arg().to_degrees();
    let product = own.value.map(|value| value * plant);
    // Bands stay as far from the phase as they were, and the phase of the product is within half a turn.
    let shift = own.value.zip(product).map(|(a, b)| b.arg().to_degrees() - a.arg().to_degrees()).unwrap_or(turn);
    At {
        value: product.filter(|value| value.is_finite() && value.norm() > 0.0),
        magnitude: own.magnitude.map(|ends| ends.map(|end| end * size)),
        phase_deg: own.phase_deg.map(|ends| ends.map(|end| end + shift)),
        ..*own
    }
}

/// An estimate of Gff·G from one of Gff; empty where the plant is not known.
fn product(feedforward: &Estimate, plant: Option<&dyn Fn(f64) -> Complex64>) -> Estimate {
    let at = plant.map_or_else(Vec::new, |plant| {
        feedforward.at.iter().map(|own| times_plant(own, plant(TAU * own.frequency_hz))).collect()
    });
    Estimate { at, ..feedforward.clone() }
}

fn of_two_stimulus(result: &TwoStimulusResult, about: &Origin<'_>) -> Result<Found, Unreadable> {
    let degrees = |value: [f64; 2], half: Option<f64>| {
        let phase = value[1].atan2(value[0]).to_degrees();
        half.map(|half| [phase - half.to_degrees(), phase + half.to_degrees()])
    };
    let of_line = |frequency_hz: f64, own: &ControllerAtLine| At {
        phase_deg: degrees(own.value, own.phase_half_width_95_rad),
        magnitude: own.magnitude_95,
        ..at(TAU * frequency_hz, Complex64::new(own.value[0], own.value[1]), None)
    };
    let of_fit = |frequency_hz: f64, own: &FittedAtLine| At {
        phase_deg: degrees(own.value, own.phase_half_width_95_rad),
        magnitude: own.magnitude_95,
        ..at(TAU * frequency_hz, Complex64::new(own.value[0], own.value[1]), None)
    };
    let free = |pick: fn(&two_stimulus::TwoStimulusLine) -> Option<&ControllerAtLine>| Estimate {
        name: "line by line".to_owned(),
        ink: Ink::First,
        is_by_lines: true,
        at: result.lines.iter().filter_map(|line| Some(of_line(line.frequency_hz, pick(line)?))).collect(),
    };
    let mut all = [free(|line| line.feedforward.as_ref()), free(|line| line.feedback.as_ref())].map(|own| vec![own]);
    if let Some(best) = result.best.and_then(|best| result.fits.get(best)) {
        let fitted = |pick: fn(&two_stimulus::FittedLine) -> &FittedAtLine| Estimate {
            name: "structure".to_owned(),
            ink: Ink::Second,
            is_by_lines: false,
            at: best.lines.iter().map(|line| of_fit(line.frequency_hz, pick(line))).collect(),
        };
        all[0].push(fitted(|line| &line.feedforward));
        all[1].push(fitted(|line| &line.feedback));
    }
    let plant = plant_response(about.plant);
    let plant = plant.as_ref().map(|plant| plant as &dyn Fn(f64) -> Complex64);
    let products = all[0].iter().map(|own| product(own, plant)).collect();
    let [feedforward, feedback] = all;
    let places = || feedforward.iter().chain(&feedback).flat_map(|own| &own.at).map(|at| at.frequency_hz);
    let band_hz = [places().fold(f64::INFINITY, f64::min), places().fold(0.0, f64::max)];
    if !band_hz[0].is_finite() {
        return Err(Unreadable::Nothing("none of its lines determines a controller".to_owned()));
    }
    let distance = result.inverse_distance.map_or_else(String::new, |distance| {
        format!("Root mean square of Gff G − 1 over the lines: {}.", three(distance))
    });
    Ok(Found {
        responses: assembled([feedforward, feedback, products]),
        finding: distance,
        bands: "Whiskers: 95 % of each line without any structure; band: 95 % of the structure with the smallest \
                Akaike criterion."
            .to_owned(),
        band_hz,
    })
}

fn of_prediction_error(result: &PredictionErrorResult, about: &Origin<'_>) -> Result<Found, Unreadable> {
    let region = |own: &ControllerRegion| At {
        magnitude: Some(own.magnitude),
        phase_deg: own.phase_rad.map(|ends| ends.map(f64::to_degrees)),
        ..at(TAU * own.frequency_hz, Complex64::new(own.value[0], own.value[1]), None)
    };
    let estimate = |name: &str, ink, lines: &[ControllerRegion]| Estimate {
        name: name.to_owned(),
        ink,
        is_by_lines: false,
        at: lines.iter().filter(|own| own.frequency_hz > 0.0).map(region).collect(),
    };
    let last = result.trials.len().saturating_sub(1);
    let mut shown = vec![0, last];
    shown.dedup();
    let name = |at: usize| about.trials.get(at).map_or_else(|| format!("trial {at}"), Clone::clone);
    let mut all: [Vec<Estimate>; 2] = Default::default();
    for (place, at) in shown.iter().enumerate() {
        let Some(trial) = result.trials.get(*at) else { continue };
        let ink = Ink::of_group(place);
        all[0].push(estimate(&name(*at), ink, &trial.feedforward.lines));
        if let Some(feedback) = &trial.feedback {
            all[1].push(estimate(&name(*at), ink, &feedback.lines));
        }
    }
    if let Some(feedback) = &result.feedback {
        let name = if last > 0 { "all trials" } else { "feedback" };
        all[1].push(estimate(name, Ink::Third, &feedback.lines));
    }
    // As the norms of the report have it: behind a hold at the trials' sample time.
    let held = about.plant.and_then(|plant| {
        let own = plant.check().ok()?;
        let time = about.sample_time_s.and_then(|period| Discrete::new(period).ok());
        match (&own, time) {
            (System::Continuous(continuous), Some(time)) => {
                Some(zero_order_hold(continuous, time).map_or(own.clone(), System::Discrete))
            }
            _ => Some(own),
        }
    });
    let response = held.map(|plant| move |omega: f64| plant.response(omega));
    let response = response.as_ref().map(|plant| plant as &dyn Fn(f64) -> Complex64);
    let products = all[0].iter().map(|own| product(own, response)).collect();
    let [feedforward, feedback] = all;
    let number = |at: usize, pick: fn(&prediction_error::PredictionErrorNorms) -> &prediction_error::NormResult| {
        let norm = result.trials.get(at).map(|trial| pick(&trial.metrics));
        let interval = norm.and_then(|norm| norm.interval_95);
        let interval = interval.map_or_else(String::new, |[low, high]| format!(" [{}, {}]", three(low), three(high)));
        format!("{}{interval}", norm.and_then(|norm| norm.value).map_or_else(|| "none".to_owned(), three))
    };
    let finding = shown.iter().map(|at| {
        format!(
            "{}: ‖Gfb‖ {}, ‖Gff G − 1‖ {}.",
            name(*at),
            number(*at, |norms| &norms.norm_feedback),
            number(*at, |norms| &norms.norm_feedforward_plant_minus_one)
        )
    });
    let which = if last > 1 { " First and last trial." } else { "" };
    Ok(Found {
        responses: assembled([feedforward, feedback, products]),
        finding: finding.collect::<Vec<_>>().join(" "),
        bands: format!("Bands: magnitudes and phases within regions of about 95 % in the complex plane.{which}"),
        band_hz: result.band_hz,
    })
}
