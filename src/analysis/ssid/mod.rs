//! Subsystem identification: kind `ssid`.
//!
//! `example.json` beside this file is a request of the kind.
//!
//! Trials are those of [`trials`](super::inputs::trials), or frequency data come with the request. The method is that
//! of [`identify::ssid`](crate::identify::ssid).

mod delay_spec;
mod delayed;
mod equivalent;
mod family;
mod held;
mod inputs;
mod refined;
mod restricted_fit;
mod restrictions;
mod result;
mod shares;
mod spec;
mod structures;

use super::contract::{Analysis, Failure, Incumbent, Outcome};
use super::frequency_response::left_out_warnings;
use super::inputs::data::{PlantAndResponses, TrialsOrResponses};
use super::inputs::fitted::Resolved;
use super::inputs::frequency_problem;
use super::inputs::library::Library;
use super::inputs::plant::check_delayed_plant;
use super::inputs::pool_problem;
use super::inputs::trials::ResolvedTrial;
use super::kind::Kind;
use super::problem::{Code, Problem};
use super::report::{Effort, Warning};
use crate::control::{System, TransferFunction};
use crate::ctl::{Ctl, Phase};
use crate::identify::held::Held;
use crate::identify::refine::{Delay, Delays, Refined};
use crate::identify::search::Automatic;
use crate::identify::ssid::{Identified, Settings, SsidError, Weights, identify_searched};
use crate::identify::validation::simulated_vaf;
use crate::learning::frequency_domain::{ControllerMetrics, controller_metrics_delayed};
use crate::response::{Channels, Estimate, FrequencyError, Repeats, VarianceSource, estimate_between, repeats};
use crate::trial::Trial;
pub use delay_spec::{DelayRange, DelaySpec, DelayValueSpec};
pub use delayed::{DelayedPoint, DelayedPool};
pub use equivalent::{EquivalentMember, EquivalentRange, EquivalentSet, EquivalentSpec};
pub use family::{FamilySpread, NearCandidate, NearOptimal, SpreadAtLine};
pub use inputs::{SsidInputs, SsidResponses};
pub use refined::{BootstrapSpec, RefinedResult, RefinementStop};
use refined::{KnownNoise, Questions};
pub use restricted_fit::RestrictedFit;
use restrictions::Comparison;
pub use result::{Certificate, Fit, HeldOut, SimulatedVafResult, SsidResult, Stability, TrialVaf};
use shares::{DATA, Shares};
use spec::CheckedSpec;
pub use spec::SsidSpec;
pub use structures::{Likelihood, StructureComparison, StructureRow, StructureSpec};

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: SsidInputs,
    /// Boxed: it is much larger than the plans of other kinds.
    spec: Box<CheckedSpec>,
}

/// What the inputs give the identification.
struct Material {
    plant: System,
    /// The delay behind a continuous plant.
    plant_delay_s: f64,
    data: crate::response::FrequencyData,
    trials: Vec<ResolvedTrial>,
    /// Trials that are only simulated.
    held_out: Vec<ResolvedTrial>,
    /// The trials or segments, each left out in turn; only where structures are compared.
    repeats: Option<Repeats>,
    /// The noise of the response, where it is known at all.
    noise: Option<KnownNoise>,
    warnings: Vec<Warning>,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("ssid");
    const TITLE: &'static str = "Subsystem identification";
    const SUMMARY: &'static str = "The person's feedforward and feedback controllers from trials of command tracking, \
                                   or from frequency data of the closed loop: the exact optimum over a pool of \
                                   candidates whose loop is stable, with its certificate, the candidates that fit \
                                   nearly as well, and a refinement with bands (Zhang 2015, algorithms 2.1, 3.1 and \
                                   5.1).";
    const RESULT_VERSION: u32 = 7;
    const EXAMPLE: &'static str = include_str!("example.json");
    const TAKES_TRIALS: bool = true;

    type Inputs = SsidInputs;
    type Spec = SsidSpec;
    type Result = SsidResult;

    fn check(inputs: SsidInputs, spec: SsidSpec) -> Result<Self, Problem> {
        let spec = Box::new(CheckedSpec::new(spec, inputs.is_responses())?);
        if let Some(plant) = inputs.inline_plant() {
            check_delayed_plant(plant, "/inputs/plant")?;
        }
        Ok(Self { inputs, spec })
    }

    fn inputs(&self) -> &SsidInputs {
        &self.inputs
    }

    fn spec(&self) -> &SsidSpec {
        &self.spec.used
    }

    /// Progress counts candidates.
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Outcome<SsidResult>, Failure> {
        ctl.enter(Phase::Data, DATA);
        let Material { plant, plant_delay_s, data, trials, held_out, noise, repeats, mut warnings } =
            self.material(library, ctl)?;
        let used = &self.spec.used;
        if plant_delay_s > 0.0 {
            self.refuse_beside_plant_delay(plant_delay_s)?;
        }
        let settings = Settings {
            recipe: self.spec.recipe.clone(),
            weights: self.spec.weights,
            sample_time_s: used.sample_time_s.or(trials.first().map(|t| t.trial().sample_time_s)),
            max_candidates: self.spec.max_candidates,
        };
        let search = Automatic { method: self.spec.search, pools: &*library.pools };
        let shares = Shares::of(&self.spec);
        let in_search = ctl.scope(shares.search);
        let (found, searched) =
            identify_searched(&plant, plant_delay_s, &data, &settings, &search, ctl).map_err(|error| match error {
                SsidError::Stopped(stopped) => Failure::Stopped(stopped),
                SsidError::Interrupted(interrupted) => Failure::Interrupted {
                    stopped: interrupted.stopped,
                    incumbent: Box::new(Incumbent {
                        feedforward: interrupted.feedforward.to_model(),
                        feedback: interrupted.feedback.to_model(),
                    }),
                },
                error => Failure::Problem(pool_problem::problem(&error)),
            })?;
        drop(in_search);
        warnings.extend(found.findings.iter().map(|f| Warning::new(f.code, f.message.clone())));
        let metrics = self.metrics(&found)?;
        let band_rad_s = metrics.band_rad_s;
        let vaf =
            validate(&found, [&found.feedforward, &found.feedback], &trials, metrics.band_rad_s, Some(&mut warnings));
        let mut result = SsidResult::new(&found, metrics, vaf, trials.is_empty());
        result.near_optimal.warn(&mut warnings);
        let in_set = ctl.scope(shares.equivalent);
        let asked = used.equivalent.unwrap_or_default();
        match equivalent::find(&found, &searched, asked, band_rad_s, &mut warnings, ctl).map_err(Failure::Stopped)? {
            Ok(set) => result.equivalent = Some(set),
            Err(reason) => result.equivalent_reason = Some(reason),
        }
        drop(in_set);
        drop(searched);
        if let (Some(delays), Some(period)) = (self.spec.delays.as_ref(), found.plant.sample_time_s()) {
            delay_spec::check_sampled(delays, period)?;
        }
        let mut delayed = None;
        let pairs = used.delay.as_ref().map(DelaySpec::pairs).unwrap_or_default();
        if !pairs.is_empty() {
            let _with_delays = ctl.scope(shares.delays);
            let (searched, best) = delayed::searched(&plant, &data, &settings, &pairs, &search, ctl)?;
            delayed::warn(&searched, &mut warnings);
            result.delayed = Some(searched);
            delayed = best;
        }
        let mut held = (!held_out.is_empty()).then(|| HeldOut {
            pool: SimulatedVafResult::of(validate(
                &found,
                [&found.feedforward, &found.feedback],
                &held_out,
                band_rad_s,
                Some(&mut warnings),
            )),
            refined: None,
        });
        if self.spec.refine {
            // The plant's delay is one of both controllers to whatever comes after them; of a feedback that is none,
            // there is none.
            let of_feedback = if used.held_at_zero == Some(Held::Feedback) { 0.0 } else { found.plant_delay_s };
            let own_delays = (found.plant_delay_s > 0.0).then(|| Delays {
                feedback: Delay::Grid(vec![of_feedback]),
                feedforward: Delay::Grid(vec![found.plant_delay_s]),
            });
            let questions = Questions {
                structure: self.spec.recipe.structure(),
                noise: noise.as_ref(),
                is_weighted_by_noise: self.spec.weights == Weights::InverseVariance,
                bootstrap: used.bootstrap,
                band_rad_s,
                delays: own_delays.as_ref().or(self.spec.delays.as_ref()),
                start: delayed.as_ref(),
            };
            let _refining = ctl.scope(shares.refinement);
            match refined::refine(&found, &questions, &mut warnings, ctl).map_err(Failure::Stopped)? {
                Ok((controllers, mut refined)) => {
                    let simulated = |trials: &[ResolvedTrial]| match with_delays(&controllers) {
                        Ok([feedforward, feedback]) => {
                            validate(&found, [&feedforward, &feedback], trials, band_rad_s, None)
                        }
                        Err(reason) => not_simulated(trials, reason),
                    };
                    refined.simulated_vaf = simulated(&trials);
                    if let Some(held) = &mut held {
                        held.refined = Some(SimulatedVafResult::of(simulated(&held_out)));
                    }
                    result.refined = Some(refined);
                }
                Err(reason) => {
                    warnings.push(Warning::new("not_refined", reason.clone()));
                    result.refined_reason = Some(reason);
                }
            }
        } else {
            result.refined_reason = Some("the spec asks for none".to_owned());
        }
        result.held_out = held;
        if !self.spec.structures.is_empty() {
            let _comparing = ctl.scope(shares.structures);
            let compared = structures::compare(
                &self.spec,
                &plant,
                &data,
                noise.as_ref(),
                repeats.as_ref(),
                settings.sample_time_s,
                &*library.pools,
                ctl,
            )?;
            let own = settings.recipe.structure();
            let degrees = [
                own.feedforward_numerator,
                own.feedforward_denominator,
                own.feedback_numerator,
                own.feedback_denominator,
            ];
            structures::warn(&compared, degrees, &mut warnings);
            result.structures = Some(compared);
        }
        if !self.spec.restrictions.is_empty() {
            let _restricting = ctl.scope(shares.restrictions);
            let comparison = Comparison {
                spec: &self.spec,
                plant: &plant,
                data: &data,
                settings: &settings,
                full: &found,
                refined_cost: result.refined.as_ref().map(|refined| refined.cost),
                pools: &*library.pools,
            };
            let fits = comparison.fits(ctl)?;
            restricted_fit::warn(&fits, &mut warnings);
            result.restrictions = Some(fits);
        }
        let effort = Effort {
            pairs_bounded: found.optimum.bounded,
            candidates_evaluated: found.optimum.evaluated,
            candidates_decided_by_qr: found.optimum.decided_by_qr,
        };
        Ok(Outcome { result, warnings, effort: Some(effort) })
    }
}

impl Plan {
    fn material(&self, library: &Library, ctl: &Ctl) -> Result<Material, Failure> {
        match &self.inputs {
            TrialsOrResponses::Responses(PlantAndResponses { plant, frequency_response: data }) => {
                let (system, plant_delay_s) = check_delayed_plant(plant, "/inputs/plant")?;
                let noise = data.variance.as_ref().map(|variance| KnownNoise {
                    variance: data.omega_rad_s.iter().copied().zip(variance.iter().copied()).collect(),
                    degrees_of_freedom: data.averages.map_or(f64::INFINITY, |n| 2.0 * (f64::from(n) - 1.0)),
                    are_independent: true,
                });
                let (trials, held_out, warnings) = (Vec::new(), Vec::new(), Vec::new());
                Ok(Material {
                    plant: system,
                    plant_delay_s,
                    data: data.data(),
                    trials,
                    held_out,
                    noise,
                    repeats: None,
                    warnings,
                })
            }
            TrialsOrResponses::Trials(inputs) => {
                let Resolved { plant, plant_delay_s, fitted: resolved, held_out } = inputs.resolve(library)?;
                let trials: Vec<&Trial> = resolved.iter().map(ResolvedTrial::trial).collect();
                let Some(settings) = &self.spec.frequency else {
                    // The spec of trials always has settings; see `CheckedSpec::new`.
                    return Err(Problem::new(
                        Code::Internal,
                        "no frequency settings",
                        "the spec was checked for frequency data",
                    )
                    .into());
                };
                let failed = |error| match error {
                    FrequencyError::Stopped(stopped) => Failure::Stopped(stopped),
                    error => Failure::Problem(frequency_problem::problem(&error, &resolved, "/spec/frequency")),
                };
                let estimate = estimate_between(&trials, settings, Channels::default(), ctl).map_err(failed)?;
                let repeats = if self.spec.structures.is_empty() {
                    None
                } else {
                    repeats(&trials, settings, &estimate, Channels::default(), ctl).map_err(failed)?
                };
                let mut warnings: Vec<Warning> = left_out_warnings(&resolved);
                warnings.extend(estimate.warnings.iter().map(Warning::from));
                warnings.extend(left_out_warnings(&held_out));
                let (data, noise) = (estimate.data(), noise_of(&estimate));
                Ok(Material { plant, plant_delay_s, data, trials: resolved, held_out, noise, repeats, warnings })
            }
        }
    }

    /// What a plant with a delay in continuous time is not answered with.
    fn refuse_beside_plant_delay(&self, delay_s: f64) -> Result<(), Problem> {
        if self.spec.recipe.sampled == Some(true) {
            return Ok(());
        }
        let used = &self.spec.used;
        for (is_asked, at) in [
            (used.delay.is_some(), "/spec/delay"),
            (used.structures.is_some(), "/spec/structures"),
            (used.restrictions.is_some(), "/spec/restrictions"),
        ] {
            if is_asked {
                let detail = format!("the plant has a delay of {delay_s} s itself, which this is not computed with");
                return Err(Problem::new(Code::Invalid, "delays of plant and person", detail).at(at).mend(
                    "Leave it out; or give the plant without delay_s, with its delay added to those of feedback and \
                     feedforward in spec.delay.",
                ));
            }
        }
        Ok(())
    }

    /// Norms over the band of the spec, or of the lines.
    fn metrics(&self, found: &Identified) -> Result<ControllerMetrics, Problem> {
        let band = self.spec.used.band_hz.map_or_else(
            || {
                let low = found.lines.iter().map(|(line, _)| line.omega_rad_s).fold(f64::INFINITY, f64::min);
                let high = found.lines.iter().map(|(line, _)| line.omega_rad_s).fold(0.0, f64::max);
                (low, high)
            },
            |[low, high]| (low * std::f64::consts::TAU, high * std::f64::consts::TAU),
        );
        let (plant, delay_s) = (&found.plant, found.plant_delay_s);
        controller_metrics_delayed(plant, delay_s, &found.feedforward, &found.feedback, band).map_err(|error| {
            Problem::new(Code::Invalid, "unusable band", error.to_string())
                .at("/spec/band_hz")
                .mend("Give a band within the lines, below the Nyquist frequency.")
        })
    }
}

/// Real degrees of freedom of a variance read from nearby lines: twice the fewest such lines that are used.
const NEARBY_DEGREES: f64 = 8.0;

/// What an estimate knows of its noise.
fn noise_of(estimate: &Estimate) -> Option<KnownNoise> {
    let (degrees_of_freedom, are_independent) = match estimate.variance_source? {
        VarianceSource::Repetition => {
            let fewest = estimate.averages.iter().copied().filter(|n| *n >= 2).min()?;
            (2.0 * (fewest as f64 - 1.0), true)
        }
        VarianceSource::NearbyLines => (NEARBY_DEGREES, false),
        // Neighbouring lines share data: their estimates are not independent.
        VarianceSource::LocalPolynomial => (estimate.degrees_of_freedom?, false),
    };
    let lines = estimate.omega_rad_s.iter().zip(&estimate.variance);
    let variance = lines.filter_map(|(omega, variance)| variance.map(|v| (*omega, v))).collect();
    Some(KnownNoise { variance, degrees_of_freedom, are_independent })
}

/// Controllers with their delays as part of them, where that is possible: in sampled time, `z^{−d}`.
fn with_delays(refined: &Refined) -> Result<[System; 2], &'static str> {
    let delayed = |system: &System, delay_s: f64| match system {
        _ if delay_s == 0.0 => Ok(system.clone()),
        System::Continuous(_) => {
            Err("a continuous controller with a delay is no transfer function, and is not simulated")
        }
        System::Discrete(tf) => {
            let samples = (delay_s / tf.time().period_s()).round() as usize;
            let den = [tf.den().coefficients(), &vec![0.0; samples]].concat();
            TransferFunction::new(tf.num().coefficients(), &den, tf.time())
                .map(System::Discrete)
                .map_err(|_| "the delayed controller is no transfer function")
        }
    };
    Ok([
        delayed(&refined.feedforward, refined.feedforward_delay_s)?,
        delayed(&refined.feedback, refined.feedback_delay_s)?,
    ])
}

fn not_simulated(trials: &[ResolvedTrial], reason: &str) -> Vec<TrialVaf> {
    let of = |trial: &ResolvedTrial| TrialVaf {
        trial: trial.name.clone(),
        y: None,
        u: None,
        y_in_band: None,
        u_in_band: None,
        reason: Some(reason.to_owned()),
    };
    trials.iter().map(of).collect()
}

/// Simulates a loop (feedforward, feedback) on each trial; what cannot be simulated becomes a warning where warnings
/// are wanted.
fn validate(
    found: &Identified,
    [feedforward, feedback]: [&System; 2],
    trials: &[ResolvedTrial],
    band_rad_s: [f64; 2],
    mut warnings: Option<&mut Vec<Warning>>,
) -> Vec<TrialVaf> {
    if found.plant_delay_s > 0.0 {
        return not_simulated(trials, "a continuous plant with a delay is not simulated");
    }
    let mut warn = |code: &'static str, message: String| {
        if let Some(warnings) = &mut warnings {
            warnings.push(Warning::new(code, message));
        }
    };
    trials
        .iter()
        .map(|trial| {
            let name = trial.name.clone();
            match simulated_vaf(trial.trial(), &found.plant, feedforward, feedback, band_rad_s) {
                Ok(vaf) => {
                    if vaf.output_in_band.unwrap_or(vaf.output) < 0.0 {
                        warn(
                            "simulation_fails",
                            format!(
                                "the identified loop, simulated from the command of {name}, explains none of the \
                                 recorded output within the identified band (variance accounted for {:.3}), although \
                                 it fits the frequency data",
                                vaf.output_in_band.unwrap_or(vaf.output)
                            ),
                        );
                    }
                    TrialVaf {
                        trial: name,
                        y: Some(vaf.output),
                        u: vaf.control,
                        y_in_band: vaf.output_in_band,
                        u_in_band: vaf.control_in_band,
                        reason: vaf.control_unavailable,
                    }
                }
                Err(error) => {
                    warn("not_simulated", format!("{name}: {error}"));
                    TrialVaf {
                        trial: name,
                        y: None,
                        u: None,
                        y_in_band: None,
                        u_in_band: None,
                        reason: Some(error.to_string()),
                    }
                }
            }
        })
        .collect()
}

#[cfg(test)]
mod tests;
