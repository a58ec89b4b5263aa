//! The design: climbs from every start, and the proof of the best.

use super::findings::of_climbs;
use super::model::Model;
use super::monte_carlo::monte_carlo;
use super::result::{
    DesignProof, InformationResult, InputDesignResult, LimitResult, MonteCarloResult, ParameterResult, SignalResult,
    StartResult,
};
use super::spec::CheckedSpec;
use super::starts::Starts;
use super::wrong;
use crate::analysis::plan::Failure;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::report::Warning;
use crate::control::Discrete;
use crate::control::parametric::Differentiated;
use crate::ctl::Ctl;
use crate::excite::design::limits::autocorrelation;
use crate::excite::design::{
    Autocorrelation, Climb, ClimbError, Criterion, Fisher, Information, Limits, OutputLimit, Response, Responses,
    Settings, Stop, climb,
};
use nalgebra::DMatrix;

/// The trust region is halved until it is this share of what it begins with.
const LEAST_RADIUS: f64 = 1.0 / 64.0;

/// Everything that a climb needs.
pub(super) struct Task<'a> {
    pub model: &'a Model,
    pub spec: &'a CheckedSpec,
    pub theta: Vec<f64>,
    at: Differentiated<Discrete>,
    pub time: Discrete,
    pub responses: Responses,
    pub information: Information,
    limits: Limits,
}

/// A climb that came to something.
pub(super) struct Reached {
    place: usize,
    pub start: Vec<f64>,
    limits: Limits,
    pub climb: Climb,
    pub value: f64,
}

pub(super) fn run(
    model: &Model,
    starts: &Starts,
    spec: &CheckedSpec,
    ctl: &Ctl,
) -> Result<(InputDesignResult, Vec<Warning>), Failure> {
    let task = Task::new(model, spec)?;
    let starts = starts.sampled(spec.written.samples, ctl)?;
    let records = spec.written.monte_carlo.as_ref().map_or(0, |m| 2 * m.replicates as u64);
    ctl.set_total((starts.len() * spec.written.max_steps) as u64 + records);
    let mut warnings = Vec::new();
    let mut results = Vec::new();
    let mut best: Option<Reached> = None;
    for (place, start) in starts.iter().enumerate() {
        let before = ctl.progress().done;
        let (result, reached) = task.climb(place, start, ctl)?;
        // A climb that ends early leaves the steps that it did not need.
        ctl.advance(spec.written.max_steps as u64 - (ctl.progress().done - before).min(spec.written.max_steps as u64));
        results.push(result);
        if let Some(reached) = reached
            && best.as_ref().is_none_or(|best| reached.value > best.value)
        {
            best = Some(reached);
        }
    }
    let Some(best) = best else { return Err(task.nothing(&starts, &results).into()) };
    of_climbs(&task, &results, &best, &mut warnings);
    let monte_carlo = monte_carlo(&task, &best, &mut warnings, ctl)?;
    Ok((task.result(results, best, monte_carlo, &mut warnings)?, warnings))
}

pub(super) fn overflow(error: impl std::fmt::Display) -> Problem {
    Problem::new(Code::Numerical, "the model leaves the finite numbers", error.to_string())
        .at("/inputs/model")
        .mend("Shorten the record, or mend the model: it may be unstable.")
}

impl<'a> Task<'a> {
    fn new(model: &'a Model, spec: &'a CheckedSpec) -> Result<Self, Problem> {
        let theta = model.nominal();
        let time = Discrete::new(spec.sample_time_s).map_err(overflow)?;
        let at = model.sampled(&theta, time).map_err(overflow)?;
        let responses = Responses::new(&at, spec.written.input, spec.written.samples).map_err(overflow)?;
        let information = Information::new(&responses, &spec.measured, &spec.covariance, &spec.scales)
            .ok_or_else(|| wrong("the covariance of the noise is not positive definite", "/spec/noise_covariance"))?;
        let place = |name: &String| model.outputs.iter().position(|known| known == name).unwrap_or(0);
        let written = &spec.written.limits;
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
                    "from its initial state alone, without any input, {} is {y} at sample {k}, beyond its limit of {lower} to {upper}",
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

    /// The limits of a climb, whose autocorrelation may be that of its start.
    fn limits_for(&self, start: &[f64]) -> Option<Limits> {
        let mut limits = self.limits.clone();
        if let Some(wanted) = &self.spec.written.limits.autocorrelation {
            let lags = wanted.lags.unwrap_or(1);
            let reference = match &wanted.reference {
                Some(reference) => reference.clone(),
                None => autocorrelation(start, lags)?,
            };
            let margin = wanted.margin.unwrap_or(0.0);
            limits.autocorrelation = Some(Autocorrelation { reference, tolerance: wanted.tolerance, margin });
        }
        Some(limits)
    }

    fn settings(&self) -> Settings {
        Settings {
            criterion: self.spec.written.criterion,
            radius: self.spec.radius,
            tolerance: self.spec.written.tolerance,
            least_radius: LEAST_RADIUS,
            max_steps: self.spec.written.max_steps,
        }
    }

    fn climb(&self, place: usize, start: &[f64], ctl: &Ctl) -> Result<(StartResult, Option<Reached>), Failure> {
        let mut result = StartResult {
            scale: 1.0,
            refused: None,
            value: None,
            reached: None,
            factor: None,
            steps: 0,
            programs: 0,
            stop: None,
        };
        if start.iter().all(|u| *u == 0.0) {
            result.refused = Some("the start is zero throughout".to_owned());
            return Ok((result, None));
        }
        let mut start = start.to_vec();
        if self.spec.written.scale_to_fit {
            match self.limits.largest_scale(&start) {
                Some(scale) if scale > 0.0 => {
                    result.scale = scale;
                    start.iter_mut().for_each(|u| *u *= scale);
                }
                _ => {
                    result.refused = Some("no scale makes it keep to the limits".to_owned());
                    return Ok((result, None));
                }
            }
        }
        let Some(limits) = self.limits_for(&start) else {
            result.refused = Some("the start is too small to have an autocorrelation".to_owned());
            return Ok((result, None));
        };
        let criterion = self.spec.written.criterion;
        match climb(&self.information, &limits, &start, &self.settings(), ctl) {
            Ok(found) => {
                let value = self.information.fisher(&found.input).value(criterion);
                result.value = self.information.fisher(&start).value(criterion);
                result.reached = value;
                result.factor = Some(found.factor).filter(|f| f.is_finite());
                (result.steps, result.programs) = (found.steps, found.programs);
                result.stop = Some(match found.stop {
                    Stop::Converged => "converged",
                    Stop::SmallestRegion => "smallest_region",
                    Stop::StepLimit => "step_limit",
                });
                let reached = value.map(|value| Reached { place, start, limits, climb: found, value });
                Ok((result, reached))
            }
            Err(ClimbError::Stopped(stopped)) => Err(stopped.into()),
            Err(error) => {
                result.refused = Some(error.to_string());
                Ok((result, None))
            }
        }
    }

    /// Why no start came to anything.
    fn nothing(&self, starts: &[Vec<f64>], results: &[StartResult]) -> Problem {
        let reasons: Vec<String> = results
            .iter()
            .enumerate()
            .filter_map(|(i, result)| Some(format!("start {i}: {}", result.refused.as_ref()?)))
            .collect();
        let undetermined = starts.iter().find_map(|start| self.information.fisher(start).undetermined()).filter(|_| {
            self.spec.written.criterion.needs_inverse() && reasons.iter().all(|r| r.contains("no information"))
        });
        if let Some(undetermined) = undetermined {
            let combination = self.combination(&undetermined.weights);
            let words: Vec<String> = combination.iter().map(|(name, w)| format!("{w:+.3} {name}")).collect();
            return Problem::new(
                Code::NotIdentifiable,
                "a combination of parameters is not determined",
                format!("no start tells anything about {} (in units of their scales)", words.join(" ")),
            )
            .at("/inputs/model")
            .mend("Free fewer parameters, measure more outputs, give other starts, or ask for t or scaled_t.");
        }
        let fits = starts.iter().find_map(|start| self.limits.largest_scale(start).filter(|scale| *scale < 1.0));
        let mut problem = wrong(format!("no start can be used: {}", reasons.join("; ")), "/inputs/starts");
        problem = match fits {
            Some(scale) if !self.spec.written.scale_to_fit => {
                problem.mend(format!("Scale the start by {scale:.6} or less, or set scale_to_fit."))
            }
            _ => problem.mend("Give a start that keeps to every limit."),
        };
        problem
    }

    fn combination(&self, weights: &[f64]) -> Vec<(String, f64)> {
        self.model.names().into_iter().zip(weights.iter().copied()).filter(|(_, w)| w.abs() > 1e-3).collect()
    }

    fn information(&self, fisher: &Fisher) -> InformationResult {
        let matrix = fisher.matrix();
        InformationResult {
            matrix: matrix.row_iter().map(|row| row.iter().copied().collect()).collect(),
            condition: Some(fisher.condition()).filter(|c| c.is_finite()),
            undetermined: fisher.undetermined().map(|u| self.combination(&u.weights)),
            value: fisher.value(self.spec.written.criterion).filter(|v| v.is_finite()),
        }
    }

    /// Outputs by the recursion of the model, from the first sample of the record on.
    fn recursion(&self, u: &[f64]) -> Result<DMatrix<f64>, Problem> {
        let mut input = DMatrix::zeros(u.len() + self.responses.first, self.model.inputs);
        for (k, u) in u.iter().enumerate() {
            input[(k, self.spec.written.input)] = *u;
        }
        let all = self.at.value.respond(&input).map_err(overflow)?;
        Ok(all.rows(self.responses.first, u.len()).into_owned())
    }

    fn limit_results(&self, best: &Reached, outputs: &DMatrix<f64>) -> Vec<LimitResult> {
        let u = &best.climb.input;
        let one = |name: String, range: [f64; 2], values: &mut dyn Iterator<Item = (usize, f64)>| {
            let mut reached = [f64::INFINITY, f64::NEG_INFINITY];
            let (mut slack, mut at) = (f64::INFINITY, 0);
            for (k, value) in values {
                reached = [reached[0].min(value), reached[1].max(value)];
                let left = (value - range[0]).min(range[1] - value);
                if left < slack {
                    (slack, at) = (left, k);
                }
            }
            LimitResult { name, range, reached, slack, at }
        };
        let mut results = vec![one("input".to_owned(), best.limits.input, &mut u.iter().copied().enumerate())];
        if let Some(limit) = best.limits.change {
            let changes = u.windows(2).map(|pair| pair[1] - pair[0]);
            let mut changes = changes.enumerate().map(|(i, change)| (i + 1, change));
            results.push(one("input_change".to_owned(), [-limit, limit], &mut changes));
        }
        let place = |name: &str| self.model.outputs.iter().position(|known| known == name).unwrap_or(0);
        for (name, limit) in &self.spec.written.limits.outputs {
            let column = outputs.column(place(name));
            results.push(one(name.clone(), limit.range(), &mut column.iter().copied().enumerate()));
        }
        for difference in &self.spec.written.limits.differences {
            let of = difference.of.each_ref().map(|name| outputs.column(place(name)));
            let mut values = of[0].iter().zip(of[1].iter()).map(|(a, b)| a - b).enumerate();
            let name = format!("{} - {}", difference.of[0], difference.of[1]);
            results.push(one(name, difference.limit.range(), &mut values));
        }
        if let Some(wanted) = &best.limits.autocorrelation {
            let power: f64 = u.iter().map(|u| u * u).sum();
            let mut deviations = wanted.reference.iter().enumerate().map(|(i, reference)| {
                let lag = i + 1;
                let sum: f64 = (lag..u.len()).map(|k| u[k] * u[k - lag]).sum();
                (lag, sum / power - reference)
            });
            let range = [-wanted.tolerance, wanted.tolerance];
            results.push(one("autocorrelation_deviation".to_owned(), range, &mut deviations));
        }
        results
    }

    fn result(
        &self,
        starts: Vec<StartResult>,
        best: Reached,
        monte_carlo: Option<MonteCarloResult>,
        warnings: &mut Vec<Warning>,
    ) -> Result<InputDesignResult, Problem> {
        let [before, after] = [&best.start, &best.climb.input].map(|u| self.information.fisher(u));
        let [outputs_before, outputs_after] = [self.recursion(&best.start)?, self.recursion(&best.climb.input)?];
        let limits = self.limit_results(&best, &outputs_after);
        if let Some(broken) =
            limits.iter().find(|limit| limit.slack.is_nan() || limit.slack < -1e-12 * (limit.range[1] - limit.range[0]))
        {
            // The recursion and the convolution differ by more than rounding: the model's own numbers are not to be trusted.
            let detail =
                format!("recomputed from the model's recursion, {} breaks its limit by {}", broken.name, -broken.slack);
            return Err(
                Problem::new(Code::Numerical, "the design does not stand its proof", detail).at("/inputs/model")
            );
        }
        let deviations = before.deviations().zip(after.deviations());
        let (matrix_before, matrix_after) = (before.matrix(), after.matrix());
        let trace = matrix_after.trace();
        let parameters = self
            .model
            .names()
            .into_iter()
            .zip(&self.theta)
            .enumerate()
            .map(|(i, (name, value))| ParameterResult {
                name,
                value: *value,
                information: [matrix_before[(i, i)], matrix_after[(i, i)]],
                trace_share: if trace > 0.0 { matrix_after[(i, i)] / trace } else { 0.0 },
                standard_deviation: deviations.as_ref().map(|(before, after)| [before[i], after[i]]),
                variance_ratio: deviations.as_ref().map(|(before, after)| (after[i] / before[i]).powi(2)),
            })
            .collect();
        let peak_rms = |values: &mut dyn Iterator<Item = f64>| {
            let (mut peak, mut sum, mut count) = (0.0_f64, 0.0, 0);
            for value in values {
                (peak, sum, count) = (peak.max(value.abs()), sum + value * value, count + 1);
            }
            (peak, (sum / f64::from(count.max(1))).sqrt())
        };
        let signal = |name: &str, pair: [(f64, f64); 2]| SignalResult {
            name: name.to_owned(),
            peak: [pair[0].0, pair[1].0],
            rms: [pair[0].1, pair[1].1],
        };
        let mut signals = vec![signal(
            "input",
            [peak_rms(&mut best.start.iter().copied()), peak_rms(&mut best.climb.input.iter().copied())],
        )];
        for (i, name) in self.model.outputs.iter().enumerate() {
            let of = |outputs: &DMatrix<f64>| peak_rms(&mut outputs.column(i).iter().copied());
            signals.push(signal(name, [of(&outputs_before), of(&outputs_after)]));
        }
        let criterion = self.spec.written.criterion;
        let last = &best.climb.last;
        let size = if criterion == Criterion::D { 1.0 } else { best.value.abs() };
        let proof = DesignProof {
            first_order_gain: last.gain,
            first_order_bound: last.bound,
            duality_gap: (last.bound - last.gain).abs() / last.bound.abs().max(f64::MIN_POSITIVE),
            stationarity: last.bound / size,
            trust_region: best.climb.radius,
            rows: last.rows,
        };
        let information = [self.information(&before), self.information(&after)];
        if let Some(undetermined) = &information[1].undetermined {
            let words: Vec<String> = undetermined.iter().map(|(name, w)| format!("{w:+.3} {name}")).collect();
            warnings.push(Warning::new(
                "not_determined",
                format!(
                    "the experiment does not determine {} (in units of their scales); there are no standard deviations",
                    words.join(" ")
                ),
            ));
        }
        Ok(InputDesignResult {
            criterion,
            sample_time_s: self.spec.sample_time_s,
            factor: best.climb.factor,
            history: best.climb.history,
            starts,
            best_start: best.place,
            parameters,
            information,
            limits,
            signals,
            proof,
            monte_carlo,
            start_input: best.start,
            input: best.climb.input,
        })
    }
}
