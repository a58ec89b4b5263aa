//! The controllers of a regression as ratios of polynomials, so that they can be drawn at any frequency.

use crate::control::discretise::zero_order_hold;
use crate::control::{Discrete, Model, System, TransferFunction};
use crate::learning::inputs::IdentifiedControllers;
use serde_json::Value;

/// Coefficients of one controller at most: more would make the rows that curves are drawn from as heavy as reports.
const MOST_COEFFICIENTS: usize = 400;

fn numbers(value: &Value, pointer: &str) -> Option<Vec<f64>> {
    value.pointer(pointer)?.as_array()?.iter().map(Value::as_f64).collect()
}

/// The product of two polynomials in q⁻¹, in ascending powers.
fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; (a.len() + b.len()).saturating_sub(1)];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            out[i + j] += x * y;
        }
    }
    out
}

/// `q^ahead N(q⁻¹)/D(q⁻¹)` in z; N and D in ascending powers of q⁻¹. It is not proper where it looks ahead.
fn system(numerator: &[f64], denominator: &[f64], ahead: usize, period_s: f64) -> Option<System> {
    let order = numerator.len().saturating_sub(ahead).max(denominator.len());
    if order + ahead > MOST_COEFFICIENTS {
        return None;
    }
    let padded = |values: &[f64], length: usize| {
        let mut out = values.to_vec();
        out.resize(length.max(values.len()), 0.0);
        out
    };
    let (num, den) = (padded(numerator, order + ahead), padded(denominator, order));
    TransferFunction::new(&num, &den, Discrete::new(period_s).ok()?).ok().map(System::Discrete)
}

/// The plant as the norms of the report have it: behind a hold at the sample time of the trials.
fn held(plant: &Model, period_s: f64) -> Option<System> {
    let plant = plant.check().ok()?;
    match &plant {
        System::Continuous(own) => zero_order_hold(own, Discrete::new(period_s).ok()?).ok().map(System::Discrete),
        System::Discrete(_) => Some(plant),
    }
}

/// `Gfb = E/A` and `Gff = (W + V/Z)/A` of a trial, with W looking ahead, and the plant; `None` where the command does
/// not determine the feedforward, the plant has no sampled form, or the report is of a version that lacks a part.
pub(super) fn controllers(result: &Value, trial: &Value, plant: Option<&Model>) -> Option<IdentifiedControllers> {
    // Of the trial by itself, or of all trials where they share it.
    let own = |name: &str| [trial, result].into_iter().filter_map(|of| of.get(name)).find(|part| !part.is_null());
    let period_s = result.pointer("/lags/sample_time_s")?.as_f64()?;
    let step = result.pointer("/lags/step")?.as_u64()?.max(1);
    let ahead = usize::try_from(result.pointer("/lags/ahead")?.as_u64()?).ok()?;
    let zeros = numbers(result, "/lags/slow_zeros").filter(|zeros| !zeros.is_empty()).unwrap_or_else(|| vec![1.0]);
    let past = numbers(own("noise")?, "/autoregressive")?;
    let a: Vec<f64> = std::iter::once(1.0).chain(past.iter().map(|value| -value)).collect();

    let feedback = own("feedback")?;
    let (delays, weights) = (numbers(feedback, "/delay_s")?, numbers(feedback, "/weights")?);
    let mut e = Vec::new();
    for (delay, weight) in delays.iter().zip(&weights) {
        let lag = (delay / period_s).round() as usize;
        if lag >= MOST_COEFFICIENTS {
            return None;
        }
        e.resize(e.len().max(lag + 1), 0.0);
        e[lag] += weight;
    }

    let feedforward = trial.get("feedforward")?;
    if feedforward.get("lines")?.as_array()?.is_empty() {
        return None;
    }
    let (window, slow) = (numbers(feedforward, "/weights")?, numbers(feedforward, "/slow_weights")?);
    let mut numerator = product(&window, &zeros);
    numerator.resize(numerator.len().max(ahead + slow.len()), 0.0);
    for (k, weight) in slow.iter().enumerate() {
        numerator[ahead + k] += weight;
    }
    Some(IdentifiedControllers {
        plant: held(plant?, period_s / step as f64)?,
        feedforward: system(&numerator, &product(&a, &zeros), ahead, period_s)?,
        feedback: system(&e, &a, 0, period_s)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::Complex64;
    use serde_json::json;

    /// Against the sums of the definition, term by term.
    #[test]
    fn the_ratios_are_the_sums_over_lags() {
        let (a, e, w, v, z) =
            ([0.4, -0.1], [0.5, 0.3, -0.2], [0.1, 0.7, -0.4, 0.2, 0.05], [0.03, -0.01], [1.0, -1.8, 0.81]);
        let result = json!({
            "lags": {"sample_time_s": 0.04, "step": 2, "ahead": 2, "slow_zeros": z},
            "noise": {"autoregressive": a},
            "feedback": {"delay_s": [0.12, 0.16, 0.2], "weights": e},
        });
        let trial = json!({"feedforward": {"weights": w, "slow_weights": v, "lines": [{}]}, "feedback": null});
        let plant: Model = serde_json::from_value(json!({"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0]})).unwrap();
        let found = controllers(&result, &trial, Some(&plant)).unwrap();
        assert_eq!(found.plant.sample_time_s(), Some(0.02));
        for omega in [0.1, 1.0, 7.0, 40.0] {
            let turn = |lag: f64| Complex64::from_polar(1.0, -omega * 0.04 * lag);
            let sum = |values: &[f64], from: f64| -> Complex64 {
                values.iter().enumerate().map(|(k, value)| *value * turn(from + k as f64)).sum()
            };
            let common = Complex64::from(1.0) - sum(&a, 1.0);
            let feedback = sum(&e, 3.0) / common;
            let feedforward = (sum(&w, -2.0) + sum(&v, 0.0) / sum(&z, 0.0)) / common;
            assert!((found.feedback.response(omega) - feedback).norm() < 1e-12 * feedback.norm(), "{omega}");
            assert!((found.feedforward.response(omega) - feedforward).norm() < 1e-9 * feedforward.norm(), "{omega}");
        }
        let undetermined = json!({"feedforward": {"weights": w, "slow_weights": v, "lines": []}, "feedback": null});
        assert_eq!(controllers(&result, &undetermined, Some(&plant)), None);
        assert_eq!(controllers(&result, &trial, None), None);
    }
}
