//! How the design is put, checked against the model.

use super::model::Model;
use super::refusal::wrong;
use super::spec::{InputDesignSpec, Limit};
use crate::analysis::inputs::matrix::dense;
use crate::analysis::problem::{Code, Problem};
use crate::excite::design::Criterion;
use crate::trial::pointer;
use nalgebra::DMatrix;

/// Samples at most.
const MAX_SAMPLES: usize = 2_000;
/// Records simulated and fitted at most.
const MAX_REPLICATES: usize = 2_000;
/// Steps at most.
const MAX_STEPS: usize = 2_000;

/// A checked spec.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CheckedSpec {
    /// With every default filled in.
    pub used: InputDesignSpec,
    pub sample_time_s: f64,
    /// Places of the measured outputs.
    pub measured: Vec<usize>,
    pub covariance: DMatrix<f64>,
    pub scales: Vec<f64>,
    pub radius: f64,
}

impl CheckedSpec {
    /// Checks a spec against the model; what is left out is filled in.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub(super) fn new(mut written: InputDesignSpec, model: &Model) -> Result<Self, Problem> {
        let wrong = |detail: String, field: &str| wrong(detail, format!("/spec/{field}"));
        if !(10..=MAX_SAMPLES).contains(&written.samples) {
            return Err(wrong(
                format!("there are {} samples; 10 to {MAX_SAMPLES} are taken", written.samples),
                "samples",
            ));
        }
        let sample_time_s = match (written.sample_time_s, model.sample_time_s()) {
            (Some(own), Some(models)) if own != models => {
                return Err(wrong(
                    format!("the sample time is {own} s, and that of the model {models} s"),
                    "sample_time_s",
                )
                .mend("Leave it out: a sampled model has its own."));
            }
            (None, None) => {
                return Err(wrong("the model is continuous, and no sample time is given".to_owned(), "sample_time_s")
                    .mend("Give the time between samples in seconds."));
            }
            (own, models) => models.or(own).unwrap_or_default(),
        };
        if !(sample_time_s > 0.0 && sample_time_s.is_finite()) {
            return Err(wrong(format!("{sample_time_s} is no positive number of seconds"), "sample_time_s"));
        }
        written.sample_time_s = Some(sample_time_s);
        if written.input >= model.inputs {
            return Err(wrong(format!("there is no input {}: the model has {}", written.input, model.inputs), "input"));
        }
        let place = |name: &str, field: String| {
            model.outputs.iter().position(|known| known == name).ok_or_else(|| {
                wrong(format!("the model has no output {name:?}"), &field)
                    .mend(format!("Its outputs are {}.", model.outputs.join(", ")))
            })
        };
        let names = written.measured.get_or_insert_with(|| model.measured.clone());
        let measured: Vec<usize> =
            names.iter().enumerate().map(|(i, name)| place(name, format!("measured/{i}"))).collect::<Result<_, _>>()?;
        if measured.is_empty() || (0..measured.len()).any(|i| measured[..i].contains(&measured[i])) {
            return Err(wrong("no output is measured, or one of them twice".to_owned(), "measured"));
        }
        let p = measured.len();
        let covariance = match &written.noise_covariance {
            None => DMatrix::identity(p, p),
            Some(rows) => {
                let found = dense(rows, "the covariance", "/spec/noise_covariance")?;
                if found.shape() != (p, p) {
                    return Err(wrong(
                        format!("the covariance is {}x{} and must be {p}x{p}", found.nrows(), found.ncols()),
                        "noise_covariance",
                    ));
                }
                let asymmetric = (&found - found.transpose()).norm() > 1e-10 * found.norm();
                let factor = if asymmetric { None } else { found.clone().cholesky() };
                if !factor.is_some_and(|f| f.l_dirty().diagonal().iter().all(|d| d.is_normal())) {
                    return Err(wrong(
                        "the covariance is not symmetric and positive definite".to_owned(),
                        "noise_covariance",
                    ));
                }
                found
            }
        };
        let parameters = model.names();
        if let Some(name) = written.scales.keys().find(|name| !parameters.contains(name)) {
            return Err(wrong(format!("there is no free parameter {name:?}"), &pointer::member("scales", name))
                .mend(format!("The free parameters are {}.", parameters.join(", "))));
        }
        let scaled = matches!(written.criterion, Criterion::ScaledT | Criterion::ScaledA);
        let mut scales = Vec::new();
        for (name, value) in parameters.iter().zip(model.nominal()) {
            let scale = written.scales.get(name).copied().unwrap_or(value.abs());
            let matters = written.scales.contains_key(name) || (scaled && scale == 0.0);
            if matters && !(scale > 0.0 && scale < 1e60) {
                return Err(wrong(format!("the scale of {name} is {scale}, and must be positive"), "scales")
                    .mend("Give a scale for every parameter that is zero."));
            }
            scales.push(if scale > 0.0 { scale } else { 1.0 });
        }
        let range = |limit: Limit, field: &str| -> Result<[f64; 2], Problem> {
            let [lower, upper] = limit.range();
            if lower < upper && lower.abs() < 1e60 && upper.abs() < 1e60 {
                Ok([lower, upper])
            } else {
                Err(wrong(format!("from {lower} to {upper} there is nothing: the limit contradicts itself"), field)
                    .mend("Give a positive magnitude, or a range [least, largest]."))
            }
        };
        let [lower, upper] = range(written.limits.input, "limits/input")?;
        if let Some(change) = written.limits.input_change
            && !(change > 0.0 && change < 1e60)
        {
            return Err(wrong(format!("the largest change is {change}, and must be positive"), "limits/input_change"));
        }
        for (name, limit) in &written.limits.outputs {
            let field = pointer::member("limits/outputs", name);
            place(name, field.clone())?;
            range(*limit, &field)?;
        }
        for (i, difference) in written.limits.differences.iter().enumerate() {
            for (j, name) in difference.of.iter().enumerate() {
                place(name, format!("limits/differences/{i}/of/{j}"))?;
            }
            if difference.of[0] == difference.of[1] {
                return Err(wrong(
                    "the difference of an output to itself is zero".to_owned(),
                    &format!("limits/differences/{i}/of"),
                ));
            }
            range(difference.limit, &format!("limits/differences/{i}/limit"))?;
        }
        if let Some(correlation) = &mut written.limits.autocorrelation {
            let field = "limits/autocorrelation";
            let beta = correlation.tolerance;
            if !(beta > 0.0 && beta < 2.0) {
                return Err(wrong(
                    format!("the tolerance is {beta}, and must lie between 0 and 2"),
                    &format!("{field}/tolerance"),
                ));
            }
            let margin = *correlation.margin.get_or_insert(beta / 8.0);
            if !(margin >= 0.0 && margin < beta) {
                return Err(wrong(
                    format!("the margin is {margin}, and must be from 0 to below the tolerance {beta}"),
                    &format!("{field}/margin"),
                ));
            }
            let given = correlation.reference.as_ref().map(Vec::len);
            let lags = *correlation.lags.get_or_insert(given.unwrap_or(written.samples / 2 - 1));
            if lags == 0 || lags >= written.samples {
                return Err(wrong(
                    format!("lags up to {lags} of {} samples; 1 to {} are taken", written.samples, written.samples - 1),
                    &format!("{field}/lags"),
                ));
            }
            if let Some(reference) = &correlation.reference
                && (reference.len() != lags || !reference.iter().all(|r| r.abs() <= 1.0))
            {
                return Err(wrong(
                    format!("the reference has {} numbers, and must have {lags} between −1 and 1", reference.len()),
                    &format!("{field}/reference"),
                ));
            }
        }
        let radius = *written.trust_region.get_or_insert(lower.abs().max(upper.abs()) / 40.0);
        if !(radius > 0.0 && radius < 1e60) {
            return Err(wrong(format!("the trust region is {radius}, and must be positive"), "trust_region"));
        }
        if !(written.tolerance > 0.0 && written.tolerance < 1.0) {
            return Err(wrong(
                format!("the tolerance is {}, and must lie between 0 and 1", written.tolerance),
                "tolerance",
            ));
        }
        if !(1..=MAX_STEPS).contains(&written.max_steps) {
            return Err(wrong(
                format!("there are {} steps; 1 to {MAX_STEPS} are made", written.max_steps),
                "max_steps",
            ));
        }
        if let Some(monte_carlo) = &written.monte_carlo
            && !(10..=MAX_REPLICATES).contains(&monte_carlo.replicates)
        {
            let code = if monte_carlo.replicates > MAX_REPLICATES { Code::Unaffordable } else { Code::Invalid };
            return Err(Problem::new(
                code,
                "unusable number of records",
                format!("there are {} records; 10 to {MAX_REPLICATES} are simulated", monte_carlo.replicates),
            )
            .at("/spec/monte_carlo/replicates"));
        }
        Ok(Self { used: written, sample_time_s, measured, covariance, scales, radius })
    }
}
