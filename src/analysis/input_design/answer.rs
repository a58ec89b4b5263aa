//! What is written of the best climb, with its proof.

use super::result::{
    AutocorrelationCourse, CourseResult, DesignProof, InformationResult, InputDesignResult, LimitResult,
    MonteCarloResult, ParameterResult, SignalResult, StartResult,
};
use super::task::{Reached, Task, overflow};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::report::Warning;
use crate::excite::design::Fisher;
use nalgebra::DMatrix;

impl Task<'_> {
    fn information(&self, fisher: &Fisher) -> InformationResult {
        let matrix = fisher.matrix();
        InformationResult {
            matrix: matrix.row_iter().map(|row| row.iter().copied().collect()).collect(),
            condition: Some(fisher.condition()).filter(|c| c.is_finite()),
            undetermined: fisher.undetermined().map(|u| self.combination(&u.weights)),
            value: fisher.value(self.spec.used.criterion).filter(|v| v.is_finite()),
        }
    }

    /// Outputs by the recursion of the model, from the first sample of the record on.
    fn recursion(&self, u: &[f64]) -> Result<DMatrix<f64>, Problem> {
        let mut input = DMatrix::zeros(u.len() + self.responses.first, self.model.inputs);
        for (k, u) in u.iter().enumerate() {
            input[(k, self.spec.used.input)] = *u;
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
        for (name, limit) in &self.spec.used.limits.outputs {
            let column = outputs.column(place(name));
            results.push(one(name.clone(), limit.range(), &mut column.iter().copied().enumerate()));
        }
        for difference in &self.spec.used.limits.differences {
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

    /// Outputs, and differences that are limited, before and after.
    fn courses(&self, before: &DMatrix<f64>, after: &DMatrix<f64>) -> Vec<CourseResult> {
        let wanted = &self.spec.used.limits;
        let values = |outputs: &DMatrix<f64>, at: usize| outputs.column(at).iter().copied().collect::<Vec<f64>>();
        let outputs = self.model.outputs.iter().enumerate().map(|(at, name)| CourseResult {
            name: name.clone(),
            range: wanted.outputs.iter().find(|(own, _)| *own == name).map(|(_, limit)| limit.range()),
            before: values(before, at),
            after: values(after, at),
        });
        let place = |name: &str| self.model.outputs.iter().position(|known| known == name).unwrap_or(0);
        let differences = wanted.differences.iter().map(|difference| {
            let [first, second] = difference.of.each_ref().map(|name| place(name));
            let of =
                |outputs: &DMatrix<f64>| (outputs.column(first) - outputs.column(second)).iter().copied().collect();
            CourseResult {
                name: format!("{} - {}", difference.of[0], difference.of[1]),
                range: Some(difference.limit.range()),
                before: of(before),
                after: of(after),
            }
        });
        outputs.chain(differences).collect()
    }

    /// What the best climb came to; its limits are recomputed.
    pub(super) fn result(
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
            // The recursion and the convolution differ by more than rounding: the model's own numbers are not to be
            // trusted.
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
        let autocorrelation = best.limits.autocorrelation.as_ref().map(|wanted| {
            let of = |u: &[f64]| {
                let power: f64 = u.iter().map(|u| u * u).sum();
                let sum = |lag: usize| (lag..u.len()).map(|k| u[k] * u[k - lag]).sum::<f64>() / power;
                (1..=wanted.reference.len()).map(sum).collect::<Vec<f64>>()
            };
            AutocorrelationCourse {
                lag: (1..=wanted.reference.len()).collect(),
                before: of(&best.start),
                after: of(&best.climb.input),
                reference: wanted.reference.clone(),
                tolerance: wanted.tolerance,
            }
        });
        let criterion = self.spec.used.criterion;
        let last = &best.climb.last;
        let tolerance = self.spec.used.tolerance;
        let proof = DesignProof {
            first_order_gain: last.gain,
            first_order_bound: last.bound,
            duality_gap: (last.bound - last.gain).abs() / last.bound.abs().max(f64::MIN_POSITIVE),
            stationarity: best.climb.left,
            tolerance,
            is_stationary: best.climb.left <= tolerance,
            second_order_bound: self
                .information
                .second_order_bound(criterion, best.climb.radius)
                .map(|bound| bound / best.value.abs()),
            trust_region: best.climb.radius,
            last_trust_region: best.climb.used_radius,
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
            courses: self.courses(&outputs_before, &outputs_after),
            autocorrelation,
            proof,
            monte_carlo,
            start_input: best.start,
            input: best.climb.input,
        })
    }
}
