//! What every climb of a design needs.

use super::checked_spec::CheckedSpec;
use super::model::Model;
use super::refusal::wrong;
use crate::analysis::problem::{Code, Problem};
use crate::control::Discrete;
use crate::control::parametric::Differentiated;
use crate::excite::design::{Climb, Information, Limits, OutputLimit, Response, Responses};

/// Everything that a climb needs.
pub(super) struct Task<'a> {
    pub model: &'a Model,
    pub spec: &'a CheckedSpec,
    pub theta: Vec<f64>,
    /// The model at θ with its derivatives, sampled.
    pub at: Differentiated<Discrete>,
    pub time: Discrete,
    pub responses: Responses,
    pub information: Information,
    pub limits: Limits,
}

/// A climb that came to something.
pub(super) struct Reached {
    /// The place of its start.
    pub place: usize,
    pub start: Vec<f64>,
    pub limits: Limits,
    pub climb: Climb,
    pub value: f64,
}

/// A model whose numbers overflow.
pub(super) fn overflow(error: impl std::fmt::Display) -> Problem {
    Problem::new(Code::Numerical, "the model leaves the finite numbers", error.to_string())
        .at("/inputs/model")
        .mend("Shorten the record, or mend the model: it may be unstable.")
}

impl<'a> Task<'a> {
    pub(super) fn new(model: &'a Model, spec: &'a CheckedSpec) -> Result<Self, Problem> {
        let theta = model.nominal();
        let time = Discrete::new(spec.sample_time_s).map_err(overflow)?;
        let at = model.sampled(&theta, time).map_err(overflow)?;
        let responses = Responses::of_record(&at, spec.used.input, spec.used.samples).map_err(overflow)?;
        let information = Information::new(&responses, &spec.measured, &spec.covariance, &spec.scales)
            .ok_or_else(|| wrong("the covariance of the noise is not positive definite", "/spec/noise_covariance"))?;
        let place = |name: &String| model.outputs.iter().position(|known| known == name).unwrap_or(0);
        let written = &spec.used.limits;
        let mut outputs: Vec<OutputLimit> = written
            .outputs
            .iter()
            .map(|(name, limit)| OutputLimit {
                name: name.clone(),
                response: responses.outputs[place(name)].clone(),
                range: limit.range(),
            })
            .collect();
        outputs.extend(written.differences.iter().map(|difference| {
            let of = [&difference.of[0], &difference.of[1]].map(|name| responses.outputs[place(name)].clone());
            OutputLimit {
                name: format!("{} - {}", difference.of[0], difference.of[1]),
                response: Response::combined(&[1.0, -1.0], &of),
                range: difference.limit.range(),
            }
        }));
        for output in &outputs {
            let [lower, upper] = output.range;
            if let Some((k, y)) = output.response.free.iter().enumerate().find(|(_, y)| !(lower..=upper).contains(*y)) {
                let detail = format!(
                    "from its initial state alone, without any input, {} is {y} at sample {k}, beyond its limit of \
                     {lower} to {upper}",
                    output.name
                );
                return Err(wrong(detail, "/spec/limits").mend("Widen the limit, or begin nearer to rest."));
            }
        }
        if !written.input.range().iter().zip([1.0, -1.0]).all(|(end, sign)| end * sign <= 0.0) {
            return Err(wrong("the range of the input does not hold zero", "/spec/limits/input")
                .mend("Give a range around zero; a constant offset belongs to the initial state."));
        }
        let limits =
            Limits { input: written.input.range(), change: written.input_change, outputs, autocorrelation: None };
        Ok(Self { model, spec, theta, at, time, responses, information, limits })
    }

    /// What a combination of parameters weighs, by their names.
    pub(super) fn combination(&self, weights: &[f64]) -> Vec<(String, f64)> {
        self.model.names().into_iter().zip(weights.iter().copied()).filter(|(_, w)| w.abs() > 1e-3).collect()
    }
}
