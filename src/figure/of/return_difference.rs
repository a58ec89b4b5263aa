//! Kalman's inequality over frequency.

use super::bode::Unreadable;
use super::document::{matrix, number};
use super::provenance::ReportOrigin;
use crate::analysis::{Analysis as _, Report, gain_fit, inverse_lqr};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::num::Complex64;
use nalgebra::DMatrix;
use serde_json::Value;
use std::f64::consts::TAU;

/// The name of the figure in addresses.
pub const NAME: &str = "return_difference";

/// Frequencies.
const POINTS: usize = 240;

/// How many decades below the slowest and above the fastest pole are shown.
const DECADES: f64 = 1.5;

/// `|1 + K(jωI − A)⁻¹B|` of a gain of one input, in decibels, with the line below which no gain is optimal: 0 dB, in
/// sampled time `det(A − BK)/det A`.
///
/// # Errors
/// [`Unreadable`] where the kind has no gain, or one of several inputs.
pub fn return_difference(report: &Report, inputs: &Value, subject: &str) -> Result<Figure, Unreadable> {
    let source = if report.kind == inverse_lqr::Plan::KIND {
        inputs
    } else if report.kind == gain_fit::Plan::KIND {
        report.result.get("inverse_lqr_inputs").unwrap_or(&Value::Null)
    } else {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    };
    let (a, b, k) = (matrix(source, "/a")?, matrix(source, "/b")?, matrix(source, "/k")?);
    if b.ncols() != 1 || k.nrows() != 1 || a.nrows() != b.nrows() || k.ncols() != a.nrows() {
        return Err(Unreadable::Nothing("the return difference of several inputs is a matrix".to_owned()));
    }
    let sample_time_s = number(source, "/sample_time_s");
    let closed = &a - &b * &k;
    let rates: Vec<f64> = [&a, &closed]
        .into_iter()
        .flat_map(|matrix| matrix.complex_eigenvalues().iter().copied().collect::<Vec<_>>())
        .map(|pole| sample_time_s.map_or(pole.norm(), |period| pole.ln().norm() / period))
        .filter(|rate| rate.is_finite() && *rate > 1e-9)
        .collect();
    let slowest = rates.iter().copied().fold(f64::INFINITY, f64::min);
    let fastest = rates.iter().copied().fold(0.0, f64::max);
    if fastest <= 0.0 {
        return Err(Unreadable::Nothing("the plant has no time scale of its own".to_owned()));
    }
    let nyquist = sample_time_s.map_or(f64::INFINITY, |period| std::f64::consts::PI / period);
    let ends = [slowest / 10f64.powf(DECADES), (fastest * 10f64.powf(DECADES)).min(nyquist)];
    let omega = crate::control::bode::log_grid(ends[0].min(0.1 * ends[1]), ends[1], POINTS);
    let level = sample_time_s.map(|_| (closed.determinant() / a.determinant()).abs());
    let border = level.map_or(0.0, |level| 10.0 * level.log10());
    let gain: Vec<Option<f64>> = omega
        .iter()
        .map(|omega| {
            let z = match sample_time_s {
                Some(period) => Complex64::from_polar(1.0, omega * period),
                None => Complex64::new(0.0, *omega),
            };
            difference(&a, &b, &k, z).map(|value| 20.0 * value.norm().log10())
        })
        .collect();
    let least = gain.iter().zip(&omega).filter_map(|(gain, omega)| Some(((*gain)?, *omega)));
    let least = least.min_by(|x, y| x.0.total_cmp(&y.0));
    let hz: Vec<f64> = omega.iter().map(|omega| omega / TAU).collect();
    let line = Series::values("|1 + K(jωI − A)⁻¹B|", (Mark::Line, Ink::First, Weight::Thick), hz, gain);
    let panel = Panel::new("", Axis::linear("return difference", "dB").including(&[border]), vec![line]).with_rule(
        border,
        "Kalman's inequality: no optimal gain lies below",
        RuleKind::Limit,
    );
    let finding = least.map_or_else(
        || "The return difference has no finite value.".to_owned(),
        |(least, omega)| {
            let word = if least < border - 1e-6 { "below" } else { "above" };
            format!(
                "The least value, {} dB at {} Hz, lies {word} the line at {} dB.",
                three(least),
                three(omega / TAU),
                three(border)
            )
        },
    );
    let origin = ReportOrigin { subject: subject.to_owned() };
    Ok(Figure {
        name: NAME.to_owned(),
        title: format!("{subject}: return difference"),
        description: finding,
        caption: format!(
            "Loop opened at the input. Red: 0 dB, in sampled time R/(R + BᵀPB) = det(A − BK)/det A. {}",
            origin.caption(report)
        ),
        sampling: String::new(),
        x: Axis::logarithmic("frequency", "Hz"),
        panels: vec![panel],
    })
}

/// `1 + K(zI − A)⁻¹B`; `None` at a pole.
fn difference(a: &DMatrix<f64>, b: &DMatrix<f64>, k: &DMatrix<f64>, z: Complex64) -> Option<Complex64> {
    let n = a.nrows();
    let own = DMatrix::from_fn(n, n, |i, j| {
        let diagonal = if i == j { z } else { Complex64::new(0.0, 0.0) };
        diagonal - a[(i, j)]
    });
    let solved = own.lu().solve(&b.map(|own| Complex64::new(own, 0.0)))?;
    let value = (k.map(|own| Complex64::new(own, 0.0)) * solved)[(0, 0)] + 1.0;
    value.is_finite().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn figure(k: [f64; 2]) -> Figure {
        let report: Report = serde_json::from_value(json!({
            "kind": "inverse_lqr", "schema": "s", "result": {}, "warnings": [],
            "provenance": {"product_version": "0", "spec": {}, "spec_sha256": "", "inputs_sha256": {}, "seed": null,
                "result_sha256": "", "wall_time_s": null, "cpu_time_s": null, "effort": null}
        }))
        .unwrap();
        let inputs = json!({"a": [[0.0, 1.0], [0.0, 0.0]], "b": [[0.0], [1.0]], "k": [k], "sample_time_s": null});
        return_difference(&report, &inputs, "S").unwrap()
    }

    /// Of the double integrator `|1 + (k₂ s + k₁)/s²|² ω⁴ = (k₁ − ω²)² + k₂² ω²`; it is 1 or more where k₂² ≥ 2 k₁.
    #[test]
    fn the_line_is_that_of_the_formula_and_tells_which_gain_is_optimal() {
        let found = figure([1.0, 2f64.sqrt()]);
        let line = &found.panels[0].series[0];
        for (hz, gain) in line.x.iter().zip(&line.y) {
            let w = hz * TAU;
            let expected = 10.0 * (((1.0 - w * w).powi(2) + 2.0 * w * w) / w.powi(4)).log10();
            assert!((gain.unwrap() - expected).abs() < 1e-9, "{hz}");
        }
        assert!(found.description.contains("above the line at 0"), "{}", found.description);
        assert!(figure([1.0, 0.5]).description.contains("below the line"));
    }
}
