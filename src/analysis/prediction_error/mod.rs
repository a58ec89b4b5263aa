//! The prediction error estimate: kind `prediction_error`.
//!
//! `example.json` beside this file is a request of the kind. The method is that of
//! [`prediction_error`](crate::prediction_error).

mod around;
mod assembly;
mod findings;
mod result;
mod spec;

use super::contract::{Analysis, Failure, Outcome};
use super::frequency_response::left_out_warnings;
use super::inputs::fitted::{FittedTrials, Resolved as ResolvedInputs};
use super::inputs::library::Library;
use super::inputs::plant::check_plant;
use super::inputs::trials::ResolvedTrial;
use super::kind::Kind;
use super::problem::{Code, Problem};
use super::report::Warning;
use crate::control::System;
use crate::ctl::Ctl;
use crate::prediction_error::estimate::{EstimateError, estimate};
use crate::prediction_error::record::Record;
use crate::trial::Trial;
use assembly::Assembly;
pub use result::{
    AccountedShares, ControllerRegion, FeedbackChange, FeedbackResult, FeedforwardResult, FeedforwardTestResult,
    HypothesisResults, InverseTrap, MovingAverageAnswer, NoiseResult, NormResult, PredictionErrorNorms,
    PredictionErrorResult, PredictionErrorTrial, ProfileEntry, RationalReduction, RegressionLags, ResidualTestResults,
    TestResult, WhitenessResult,
};
use spec::{CheckedSpec, Resolved};
pub use spec::{PredictionErrorSpec, Shared};

/// Numbers in the regressions of one request at most: 300 MB of them.
const MOST_NUMBERS: usize = 40_000_000;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: FittedTrials,
    /// Boxed: it is much larger than the plans of other kinds.
    spec: Box<CheckedSpec>,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("prediction_error");
    const TITLE: &'static str = "Prediction error";
    const SUMMARY: &'static str = "Feedforward and feedback directly from command, control and output in the closed \
     loop, of one trial or of several together: the control as a regression on its own past, the command, and every \
     lag of the error that a human delay allows. Norms with intervals, regions of the responses, tests of residuals \
     and hypotheses, and the change of the feedback from first to last trials.";
    const RESULT_VERSION: u32 = 1;
    const EXAMPLE: &'static str = include_str!("example.json");
    const TAKES_TRIALS: bool = true;

    type Inputs = FittedTrials;
    type Spec = PredictionErrorSpec;
    type Result = PredictionErrorResult;

    fn check(inputs: FittedTrials, spec: PredictionErrorSpec) -> Result<Self, Problem> {
        let spec = Box::new(CheckedSpec::new(spec)?);
        if let Some(plant) = inputs.inline_plant() {
            check_plant(plant, "/inputs/plant")?;
        }
        Ok(Self { inputs, spec })
    }

    fn inputs(&self) -> &FittedTrials {
        &self.inputs
    }

    fn spec(&self) -> &PredictionErrorSpec {
        &self.spec.used
    }

    /// Progress counts estimates: that of the answer, and those around it.
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Outcome<PredictionErrorResult>, Failure> {
        let resolved_inputs = self.inputs.resolve(library)?;
        resolved_inputs.refuse_plant_delay()?;
        let ResolvedInputs { plant, fitted, held_out, .. } = resolved_inputs;
        let trials: Vec<&Trial> = fitted.iter().map(ResolvedTrial::trial).collect();
        let resolved = self.spec.resolve(&plant, &trials)?;
        let change_trials = self.spec.change_trials(fitted.len())?;
        let records = records(&fitted, &resolved)?;
        let held = records_of_held_out(&held_out, &resolved)?;
        affordable(&records, &resolved)?;
        ctl.set_total(around::ESTIMATES);
        let found = estimate(&records, &resolved.settings, ctl).map_err(|error| failure(error, &fitted))?;
        ctl.advance(1);
        let names: Vec<&str> = fitted.iter().map(|trial| trial.name.as_str()).collect();
        let mut warnings: Vec<Warning> = left_out_warnings(&fitted);
        warnings.extend(left_out_warnings(&held_out));
        let assembly = Assembly::new(&plant, trials[0].sample_time_s, &resolved, &records, &found, ctl)?;
        let fail = |error| failure(error, &fitted);
        let hypotheses = around::hypotheses(&assembly, ctl).map_err(fail)?;
        let change = around::change(&assembly, change_trials, ctl).map_err(fail)?;
        let profile = around::profile(&assembly, ctl).map_err(fail)?;
        let inverse_trap = around::inverse_trap(&assembly, ctl).map_err(fail)?;
        let moving_average_answer = around::moving_average(&assembly, ctl).map_err(fail)?;
        let held_names: Vec<&str> = held_out.iter().map(|trial| trial.name.as_str()).collect();
        let result = PredictionErrorResult {
            band_hz: resolved.band_rad_s.map(|w| w / (2.0 * std::f64::consts::PI)),
            lags: assembly.lags(),
            feedback: found.sharing().feedback.then(|| assembly.feedback(0)),
            noise: found.sharing().noise.then(|| assembly.noise(0)),
            trials: names.iter().enumerate().map(|(i, name)| assembly.trial(i, name)).collect(),
            residual_tests: assembly.residual_tests(),
            hypotheses,
            change,
            profile,
            inverse_trap,
            moving_average_answer,
            held_out: assembly.held_out(&held, &held_names),
        };
        findings::of(&result, &assembly, &mut warnings);
        Ok(Outcome::new(result, warnings))
    }
}

/// Trials at the working sample time.
fn records(trials: &[ResolvedTrial], resolved: &Resolved) -> Result<Vec<Record>, Problem> {
    let own = trials.first().map_or(0.0, |trial| trial.trial().sample_time_s);
    for trial in trials {
        let found = trial.trial().sample_time_s;
        if (found / own - 1.0).abs() > 1e-5 {
            let detail = format!("this trial is sampled every {found} s, the first one every {own} s");
            return Err(Problem::new(Code::Invalid, "different sample times", detail)
                .at(trial.name.clone())
                .mend("Estimate them apart, or resample them."));
        }
    }
    Ok(trials.iter().map(|trial| Record::new(trial.trial(), resolved.step)).collect())
}

fn records_of_held_out(trials: &[ResolvedTrial], resolved: &Resolved) -> Result<Vec<Record>, Problem> {
    let found = records(trials, resolved)?;
    if let Some((record, trial)) =
        found.iter().zip(trials).find(|(record, _)| (record.sample_time_s / resolved.sample_time_s - 1.0).abs() > 1e-5)
    {
        let detail = format!(
            "this trial is worked at every {} s, those that are fitted every {} s",
            record.sample_time_s, resolved.sample_time_s
        );
        return Err(Problem::new(Code::Invalid, "different sample times", detail).at(trial.name.clone()));
    }
    Ok(found)
}

fn affordable(records: &[Record], resolved: &Resolved) -> Result<(), Problem> {
    let lags = &resolved.settings.lags;
    let columns = lags.terms + resolved.settings.zeros.len() + lags.autoregressive + 2 * lags.errors();
    let numbers = records.iter().map(Record::samples).sum::<usize>().saturating_mul(columns);
    if numbers <= MOST_NUMBERS {
        return Ok(());
    }
    let detail = format!("the regressions have {numbers} numbers, and {MOST_NUMBERS} at most are held");
    Err(Problem::new(Code::Unaffordable, "too many samples", detail)
        .at("/inputs")
        .mend("Estimate the trials of one subject at a time, or work at a longer sample_time_s."))
}

/// Why there is no estimate, as a problem with the place of the trial.
fn failure(error: EstimateError, trials: &[ResolvedTrial]) -> Failure {
    let place = |record: &usize| trials.get(*record).map_or_else(|| "/inputs".to_owned(), |trial| trial.name.clone());
    let not_identifiable = |title: &str| Problem::new(Code::NotIdentifiable, title, error.to_string());
    let problem = match &error {
        EstimateError::Stopped(stopped) => return Failure::Stopped(*stopped),
        EstimateError::Lags(lags) => Problem::new(Code::Invalid, "unusable lags", lags.to_string()).at("/spec"),
        EstimateError::NoRecord => Problem::new(Code::Invalid, "no trial", error.to_string()).at("/inputs"),
        EstimateError::SampleTimes { record, .. } => {
            Problem::new(Code::Invalid, "different sample times", error.to_string()).at(place(record))
        }
        EstimateError::TooShort { record, .. } => not_identifiable("too short a trial")
            .at(place(record))
            .mend("Leave it out, or ask for fewer lags: a shorter feedforward_memory_s, fewer feedforward_terms."),
        EstimateError::NoNoise { record } => not_identifiable("nothing tells feedback from feedforward")
            .at(place(record))
            .mend("Use recorded trials: without a person's own noise only a disturbance tells them apart."),
        EstimateError::Dependent { .. } => not_identifiable("regressors depend on each other")
            .at("/inputs")
            .mend("Check that u and y are recorded signals and not constants, or ask for fewer lags."),
    };
    Failure::Problem(problem)
}

/// The plant that the norms are taken with: as sampled by the trials, where it can be.
fn plant_response(plant: &System, sample_time_s: f64) -> impl Fn(f64) -> num_complex::Complex64 + use<> {
    let sampled = crate::prediction_error::loops::sampled_plant(plant, sample_time_s).map(System::Discrete);
    let plant = sampled.unwrap_or_else(|_| plant.clone());
    move |omega| plant.response(omega)
}

#[cfg(test)]
mod tests;
