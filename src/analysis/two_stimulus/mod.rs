//! The two-stimulus estimate: kind `two_stimulus`.
//!
//! `example.json` beside this file is a request of the kind.
//!
//! Trials carry r, u, y and, some of them at least, a disturbance d at the plant's input. The method is that of
//! [`two_stimulus`](crate::two_stimulus).

mod findings;
mod inputs;
mod pool;
mod prediction;
mod result;
mod shares;
mod spec;

use super::contract::{Analysis, Failure, Outcome};
use super::frequency_response::left_out_warnings;
use super::inputs::data::{PlantAndResponses, TrialsOrResponses};
use super::inputs::fitted::Resolved;
use super::inputs::frequency_problem;
use super::inputs::library::Library;
use super::inputs::plant::check_plant;
use super::inputs::trials::ResolvedTrial;
use super::kind::Kind;
use super::problem::{Code, Problem};
use super::report::Warning;
use crate::control::System;
use crate::ctl::{Ctl, Phase};
use crate::response::stimuli::{StimulusLines, stimulus_lines};
use crate::response::{FrequencyError, Stimulus};
use crate::trial::Trial;
use crate::two_stimulus::controllers::{Controllers, controllers};
use crate::two_stimulus::fit::{FitError, FitSettings, Fitted, fit};
use crate::two_stimulus::responses::{LineResponse, responses};
use crate::two_stimulus::simulate::{BEYOND_LINES, accounted_for, simulate};
use crate::two_stimulus::structure::{Person, Structure};
use inputs::no_disturbance;
pub use inputs::{TwoStimulusInputs, TwoStimulusResponses};
use num_complex::Complex64;
pub use pool::PoolResult;
pub use prediction::{
    Ceiling, MeanShare, PredictedLine, RegularisedControllers, RegularisedLine, RegularisedResult, TrialPrediction,
};
pub use result::{
    Agreement, ControllerAtLine, FittedAtLine, FittedLine, FittedParameter, StructureFit, TwoStimulusLine,
    TwoStimulusResult,
};
pub use shares::{Shares, TrialShare};
use spec::CheckedSpec;
pub use spec::TwoStimulusSpec;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: TwoStimulusInputs,
    /// Boxed: it is much larger than the plans of other kinds.
    spec: Box<CheckedSpec>,
}

/// What the inputs give the estimate.
struct Material {
    plant: System,
    lines: Vec<LineResponse>,
    /// What the responses were estimated from; `None` where the request carries them.
    stimuli: Option<StimulusLines>,
    /// Of the trials to validate on.
    held_out_stimuli: Option<StimulusLines>,
    trials: Vec<ResolvedTrial>,
    held_out: Vec<ResolvedTrial>,
    warnings: Vec<Warning>,
}

/// The share of the time that frequency data take.
const DATA: f64 = 0.05;

impl Analysis for Plan {
    const KIND: Kind = Kind::named("two_stimulus");
    const TITLE: &'static str = "Two-stimulus estimate";
    const SUMMARY: &'static str = "Feedforward and feedback from a command and a disturbance at the plant's input, \
                                   which tell them apart without assumed degrees: line by line with intervals, and by \
                                   structures such as McRuer's, with the shares of the trials that each accounts \
                                   for.";
    const RESULT_VERSION: u32 = 3;
    const EXAMPLE: &'static str = include_str!("example.json");
    const TAKES_TRIALS: bool = true;

    type Inputs = TwoStimulusInputs;
    type Spec = TwoStimulusSpec;
    type Result = TwoStimulusResult;

    fn check(inputs: TwoStimulusInputs, spec: TwoStimulusSpec) -> Result<Self, Problem> {
        let spec = Box::new(CheckedSpec::new(spec, inputs.is_responses())?);
        if let Some(plant) = inputs.inline_plant() {
            check_plant(plant, "/inputs/plant")?;
        }
        Ok(Self { inputs, spec })
    }

    fn inputs(&self) -> &TwoStimulusInputs {
        &self.inputs
    }

    fn spec(&self) -> &TwoStimulusSpec {
        &self.spec.used
    }

    fn seed(&self) -> Option<u64> {
        (!self.spec.structures.is_empty()).then_some(self.spec.seed)
    }

    /// Progress counts segments, then starts of each fit. Where the disturbance excites nothing the problem is
    /// `not_identifiable`, since the command alone does not determine the feedback.
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Outcome<TwoStimulusResult>, Failure> {
        // A pool takes longer than all fits.
        let has_pool = self.spec.pool().is_some();
        let fits_share = (1.0 - DATA) * if has_pool { 0.2 } else { 1.0 };
        ctl.enter(Phase::Data, DATA);
        let Material { plant, lines, stimuli, held_out_stimuli, trials, held_out, mut warnings } =
            self.material(library, ctl)?;
        if !lines.iter().any(|line| line.disturbance.is_some()) {
            return Err(no_disturbance(&lines).into());
        }
        let free = controllers(&lines);
        findings::of_estimate(&free, &plant, self.inputs.is_responses(), &mut warnings);
        let (mut fits, mut laws) = (Vec::new(), Vec::new());
        for (i, structure) in self.spec.structures.iter().enumerate() {
            ctl.enter(Phase::Fit, fits_share / self.spec.structures.len() as f64);
            let (fit, law) =
                self.fitted(i, *structure, &plant, &free, &lines, &trials, &held_out, &mut warnings, ctl)?;
            fits.push(fit);
            laws.push(law);
        }
        let best = (0..fits.len()).filter(|i| fits[*i].akaike.is_some()).min_by(|a, b| {
            fits[*a].akaike.unwrap_or(f64::INFINITY).total_cmp(&fits[*b].akaike.unwrap_or(f64::INFINITY))
        });
        if let Some(best) = best {
            findings::of_best(&fits[best], &mut warnings);
        }
        let sample_time_s = trials.first().map(|t| t.trial().sample_time_s);
        let pool = match self.spec.pool() {
            None => None,
            Some((recipe, limit)) => {
                let _in_the_pool = ctl.scope(0.99 - DATA - fits_share);
                Some(pool::best(recipe, &plant, sample_time_s, &lines, limit, ctl)?)
            }
        };
        ctl.enter(Phase::Verification, 1.0);
        let regularised = if self.spec.regularise {
            let law = best.and_then(|best| Some((best, laws[best].as_ref()?)));
            let both = [stimuli.as_ref(), held_out_stimuli.as_ref()];
            let found = prediction::regularised(law, both, [&trials, &held_out], ctl).map_err(Failure::Stopped)?;
            findings::of_regularised(&found, &mut warnings);
            Some(found)
        } else {
            None
        };
        let result = TwoStimulusResult {
            pool,
            ceiling: stimuli.as_ref().map(prediction::ceiling),
            regularised,
            lines: free.lines.iter().map(Into::into).collect(),
            inverse_distance: inverse_distance(&free, &plant),
            fits,
            best,
        };
        Ok(Outcome::new(result, warnings))
    }
}

impl Plan {
    #[expect(clippy::too_many_arguments, reason = "one call, of what the run has at hand")]
    fn fitted(
        &self,
        position: usize,
        structure: Structure,
        plant: &System,
        free: &Controllers,
        lines: &[LineResponse],
        trials: &[ResolvedTrial],
        held_out: &[ResolvedTrial],
        warnings: &mut Vec<Warning>,
        ctl: &Ctl,
    ) -> Result<(StructureFit, Option<Fitted>), Failure> {
        let spec = &self.spec;
        let logs: Vec<f64> = lines.iter().map(|line| line.omega_rad_s.ln()).collect();
        let scale = crate::num::stats::mean(&logs).map_or(1.0, f64::exp);
        let person = Person::new(plant, structure, spec.delay_s, scale);
        let person = person.map(|person| person.with_feedforward_delay(spec.feedforward_delay_s)).map_err(|error| {
            Problem::new(Code::Invalid, "unusable structure", error.to_string())
                .at(format!("/spec/structures/{position}/feedback"))
                .mend("Lower the degree of the feedback's numerator, or add a lag.")
        })?;
        let settings = FitSettings { channel: spec.channel, starts: spec.starts, seed: spec.seed };
        let fitted = match fit(lines, &person, &settings, ctl) {
            Ok(fitted) => fitted,
            Err(FitError::Stopped(stopped)) => return Err(stopped.into()),
            Err(error) => {
                if !matches!(error, FitError::NoCommand) {
                    warnings.push(Warning::new("structure_not_fitted", format!("structure {}: {error}", position + 1)));
                }
                return Ok((StructureFit::failed(structure, error.to_string()), None));
            }
        };
        let highest = lines.iter().map(|line| line.omega_rad_s).fold(0.0, f64::max);
        let shares = |trials: &[ResolvedTrial]| {
            (!trials.is_empty())
                .then(|| Shares::new(trials.iter().map(|trial| share(&fitted, trial, highest)).collect()))
        };
        let fit = StructureFit::new(&fitted, free, shares(trials), shares(held_out));
        Ok((fit, Some(fitted)))
    }

    fn material(&self, library: &Library, ctl: &Ctl) -> Result<Material, Failure> {
        match &self.inputs {
            TrialsOrResponses::Responses(PlantAndResponses { plant, frequency_response: data }) => {
                let system = check_plant(plant, "/inputs/plant")?;
                let mut lines = Vec::new();
                for (k, omega) in data.omega_rad_s.iter().enumerate() {
                    let response = system.response(*omega);
                    if !(response.norm() > 0.0 && response.norm().is_finite()) {
                        let detail = format!("the plant has a pole or a zero at {omega} rad/s");
                        return Err(Problem::new(Code::NotIdentifiable, "line on a pole or zero of the plant", detail)
                            .at(format!("/inputs/frequency_response/omega_rad_s/{k}"))
                            .mend("Leave the line out.")
                            .into());
                    }
                    let complex = |h: Option<[f64; 2]>| h.map(|[re, im]| Complex64::new(re, im));
                    let variance = data.variance_yr.as_ref().zip(data.variance_yd.as_ref()).map(|(r, d)| [r[k], d[k]]);
                    lines.push(LineResponse::from_output(
                        *omega,
                        response,
                        complex(data.h_yr[k]),
                        complex(data.h_yd[k]),
                        variance,
                    ));
                }
                let (trials, held_out, warnings) = (Vec::new(), Vec::new(), Vec::new());
                let (stimuli, held_out_stimuli) = (None, None);
                Ok(Material { plant: system, lines, stimuli, held_out_stimuli, trials, held_out, warnings })
            }
            TrialsOrResponses::Trials(inputs) => {
                let resolved = inputs.resolve(library)?;
                resolved.refuse_plant_delay()?;
                let Resolved { plant, fitted: trials, held_out, .. } = resolved;
                let refs: Vec<&Trial> = trials.iter().map(ResolvedTrial::trial).collect();
                let Some(settings) = &self.spec.frequency else {
                    // The spec of trials always has settings; see `CheckedSpec::new`.
                    let detail = "the spec was checked for responses in the request";
                    return Err(Problem::new(Code::Internal, "no frequency settings", detail).into());
                };
                let lines = stimulus_lines(&refs, settings, ctl).map_err(|error| match error {
                    FrequencyError::Stopped(stopped) => Failure::Stopped(stopped),
                    error => Failure::Problem(frequency_problem::problem(&error, &trials, "/spec/frequency")),
                })?;
                let mut warnings: Vec<Warning> = left_out_warnings(&trials);
                warnings.extend(left_out_warnings(&held_out));
                warnings.extend(lines.warnings.iter().map(Warning::from));
                if !lines.has(Stimulus::Disturbance) {
                    return Err(no_disturbance(&[]).into());
                }
                let held_refs: Vec<&Trial> = held_out.iter().map(ResolvedTrial::trial).collect();
                let held_out_stimuli = if held_refs.is_empty() || !self.spec.regularise {
                    None
                } else {
                    let found = stimulus_lines(&held_refs, settings, ctl).map_err(|error| match error {
                        FrequencyError::Stopped(stopped) => Failure::Stopped(stopped),
                        error => Failure::Problem(frequency_problem::problem(&error, &held_out, "/spec/frequency")),
                    })?;
                    Some(found)
                };
                let (responses, stimuli) = (responses(&lines), Some(lines));
                Ok(Material { plant, lines: responses, stimuli, held_out_stimuli, trials, held_out, warnings })
            }
        }
    }
}

/// The shares of a trial that the fitted loop accounts for, simulated from rest.
fn share(fitted: &Fitted, trial: &ResolvedTrial, highest_rad_s: f64) -> TrialShare {
    let recorded = trial.trial();
    let signals = &recorded.signals;
    let simulated = simulate(
        |omega| fitted.closed_loop(omega),
        &signals.command,
        signals.disturbance.as_deref(),
        recorded.sample_time_s,
        BEYOND_LINES * highest_rad_s,
    );
    let [u, y] = simulated.map_or([None, None], |simulated| accounted_for(recorded, &simulated));
    TrialShare { trial: trial.name.clone(), u, y }
}

/// Root mean square of `Gff G − 1`; `None` where the feedforward is known nowhere.
fn inverse_distance(free: &Controllers, plant: &System) -> Option<f64> {
    let squares: Vec<f64> = free
        .lines
        .iter()
        .filter_map(|line| {
            let distance = line.feedforward?.value * plant.response(line.response.omega_rad_s) - 1.0;
            Some(distance.norm_sqr()).filter(|d| d.is_finite())
        })
        .collect();
    crate::num::stats::mean(&squares).map(f64::sqrt)
}

#[cfg(test)]
mod tests;
