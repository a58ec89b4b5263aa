//! The parts of the result that belong to the answer itself.

use super::plant_response;
use super::result::{
    AccountedShares, ControllerRegion, FeedbackResult, FeedforwardResult, NoiseResult, NormResult,
    PredictionErrorNorms, PredictionErrorTrial, RationalReduction, RegressionLags, ResidualTestResults, TestResult,
};
use super::spec::Resolved;
use crate::control::model::TransferFunctionModel;
use crate::control::{Discrete, Model, System, TransferFunction};
use crate::ctl::{Ctl, Stopped};
use crate::prediction_error::controllers::{Controllers, Norm};
use crate::prediction_error::estimate::Estimate;
use crate::prediction_error::loops::{Accounted, Law, sampled_plant};
use crate::prediction_error::record::Record;
use crate::prediction_error::reduction::{Reduction, reduce};
use crate::prediction_error::residuals::{ResidualTests, Whiteness};
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Frequencies of the band that responses are given at.
const LINES: usize = 30;

/// Delays that a reduction tries in a sample.
const DELAYS_A_SAMPLE: usize = 2;

/// The answer with what it was computed from.
pub(super) struct Assembly<'a> {
    pub resolved: &'a Resolved,
    pub records: &'a [Record],
    pub found: &'a Estimate,
    pub tests: ResidualTests,
    /// The response of the plant at ω in rad/s.
    pub plant: Box<dyn Fn(f64) -> Complex64>,
    /// The plant at the working sample time, or why it has none.
    pub sampled: Result<TransferFunction<Discrete>, String>,
}

/// Why an interval is none of 95 %: residuals that are not white.
pub(super) fn doubt(white: &Whiteness) -> Option<String> {
    (!white.is_white()).then(|| {
        let p = white.ljung_box.p_value.min(white.serial.p_value);
        format!("the residuals are not white (p = {p:.1e}), so the interval may miss the truth more often")
    })
}

impl<'a> Assembly<'a> {
    pub(super) fn new(
        plant: &System,
        own_sample_time_s: f64,
        resolved: &'a Resolved,
        records: &'a [Record],
        found: &'a Estimate,
        ctl: &Ctl,
    ) -> Result<Self, Stopped> {
        Ok(Self {
            resolved,
            records,
            found,
            tests: found.residual_tests(records, ctl)?,
            plant: Box::new(plant_response(plant, own_sample_time_s)),
            sampled: sampled_plant(plant, resolved.sample_time_s),
        })
    }

    pub(super) fn lags(&self) -> RegressionLags {
        let lags = self.found.lags();
        RegressionLags {
            sample_time_s: self.resolved.sample_time_s,
            step: self.resolved.step,
            autoregressive: lags.autoregressive,
            moving_average: lags.moving_average,
            feedback: lags.feedback,
            ahead: lags.ahead,
            behind: lags.behind,
            terms: lags.terms,
            slow_zeros: self.found.basis.zeros().to_vec(),
        }
    }

    /// The test that the intervals of a trial's feedback rest on: of all trials where they share it.
    pub(super) fn white_of_feedback(&self, trial: usize) -> &Whiteness {
        if self.found.sharing().feedback { &self.tests.all_white } else { &self.tests.whiteness[trial] }
    }

    /// A norm of a trial.
    pub(super) fn norm(&self, found: &Estimate, trial: usize, norm: Norm, white: &Whiteness) -> NormResult {
        if norm != Norm::Feedback && found.undetermined(trial) > 0 {
            let detail = format!(
                "the command does not determine {} of the {} columns of the feedforward",
                found.undetermined(trial),
                found.basis.columns()
            );
            return NormResult::none(detail);
        }
        match found.norm(trial, norm, &*self.plant, self.resolved.band_rad_s) {
            Some(value) => NormResult::new(&value, doubt(white)),
            None => NormResult::none("the plant has a pole or a zero in the band, where it is infinite"),
        }
    }

    fn norms(&self, trial: usize) -> PredictionErrorNorms {
        let own = &self.tests.whiteness[trial];
        let of = |norm, white| self.norm(self.found, trial, norm, white);
        PredictionErrorNorms {
            norm_feedback: of(Norm::Feedback, self.white_of_feedback(trial)),
            norm_feedforward_minus_inverse: of(Norm::FeedforwardMinusInverse, own),
            norm_feedforward_plant_minus_one: of(Norm::FeedforwardPlantMinusOne, own),
        }
    }

    fn omegas(&self) -> Vec<f64> {
        let [from, to] = self.resolved.band_rad_s;
        (0..LINES).map(|k| from + (to - from) * k as f64 / (LINES - 1) as f64).collect()
    }

    fn responses(&self, trial: usize) -> Vec<Controllers> {
        self.omegas().iter().map(|omega| self.found.controllers(trial, *omega)).collect()
    }

    /// The feedback of a trial, or of all.
    pub(super) fn feedback(&self, trial: usize) -> FeedbackResult {
        let omegas = self.omegas();
        let responses = self.responses(trial);
        let [least, largest] = self.found.lags().feedback;
        let time = self.resolved.sample_time_s;
        let delays: Vec<f64> = (least * DELAYS_A_SAMPLE..=largest * DELAYS_A_SAMPLE)
            .map(|k| k as f64 * time / DELAYS_A_SAMPLE as f64)
            .collect();
        let values: Vec<Complex64> = responses.iter().map(|r| r.feedback.value).collect();
        FeedbackResult {
            delay_s: (least..=largest).map(|k| k as f64 * time).collect(),
            weights: self.found.feedback_weights(trial),
            lines: omegas
                .iter()
                .zip(&responses)
                .map(|(w, r)| ControllerRegion::new(w / TAU, &r.feedback, &self.found.region(trial, &r.feedback)))
                .collect(),
            rational: reduce(&omegas, &values, [1, 1], &delays).map(rational),
        }
    }

    fn feedforward(&self, trial: usize) -> FeedforwardResult {
        let (weights, slow_weights) = self.found.basis.lag_weights(&self.found.feedforward_coefficients(trial));
        if self.found.undetermined(trial) > 0 {
            return FeedforwardResult { weights, slow_weights, lines: Vec::new(), rational: None };
        }
        let omegas = self.omegas();
        let responses = self.responses(trial);
        let values: Vec<Complex64> = responses.iter().map(|r| r.feedforward.value).collect();
        FeedforwardResult {
            weights,
            slow_weights,
            lines: omegas
                .iter()
                .zip(&responses)
                .map(|(w, r)| ControllerRegion::new(w / TAU, &r.feedforward, &self.found.region(trial, &r.feedforward)))
                .collect(),
            rational: reduce(&omegas, &values, [2, 2], &[0.0]).map(rational),
        }
    }

    /// The shape of a trial's noise, or of all.
    pub(super) fn noise(&self, trial: usize) -> NoiseResult {
        noise(self.found, trial)
    }

    /// A trial of the answer.
    pub(super) fn trial(&self, i: usize, name: &str) -> PredictionErrorTrial {
        let law = self.found.law(i);
        let stability = self.sampled.as_ref().ok().map(|plant| law.stability(plant));
        let sharing = self.found.sharing();
        PredictionErrorTrial {
            trial: name.to_owned(),
            metrics: self.norms(i),
            feedforward: self.feedforward(i),
            feedback: (!sharing.feedback).then(|| self.feedback(i)),
            noise: (!sharing.noise).then(|| self.noise(i)),
            noise_variance: self.found.records[i].variance,
            whiteness: self.tests.whiteness[i].into(),
            stable: stability.map(|(_, stable)| stable),
            largest_pole_modulus: stability.and_then(|(modulus, _)| modulus),
            accounted_for: self.accounted_for(&law, &self.records[i], name),
        }
    }

    fn accounted_for(&self, law: &Law, record: &Record, name: &str) -> AccountedShares {
        let stable = self.sampled.as_ref().ok().filter(|plant| law.stability(plant).1);
        let Accounted { one_step, control, output } = law.accounts_for(record, stable);
        AccountedShares { trial: name.to_owned(), one_step_u: one_step, simulated_u: control, simulated_y: output }
    }

    /// Trials that were not fitted.
    pub(super) fn held_out(&self, records: &[Record], names: &[&str]) -> Vec<AccountedShares> {
        let law = self.found.mean_law();
        records.iter().zip(names).map(|(record, name)| self.accounted_for(&law, record, name)).collect()
    }

    pub(super) fn residual_tests(&self) -> ResidualTestResults {
        let of = TestResult::from;
        ResidualTestResults {
            whiteness: self.tests.all_white.into(),
            later_command: of(self.tests.later_command),
            later_error: of(self.tests.later_error),
        }
    }
}

/// The shape of a trial's noise.
pub(super) fn noise(found: &Estimate, trial: usize) -> NoiseResult {
    NoiseResult { autoregressive: found.autoregressive(trial), moving_average: found.moving_average(trial) }
}

fn rational(found: Reduction) -> RationalReduction {
    let model = TransferFunctionModel { num: found.num, den: found.den, sample_time_s: None, delay_s: None };
    RationalReduction { model: Model::TransferFunction(model), delay_s: found.delay_s, relative_misfit: found.misfit }
}
