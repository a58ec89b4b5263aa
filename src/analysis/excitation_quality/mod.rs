//! How good an excitation is: kind `excitation_quality`.
//!
//! ```json
//! {"kind": "excitation_quality",
//!  "inputs": {"signal": {"generator": {"kind": "prts", "order": 5, "chip_s": 0.2}, "sample_time_s": 0.001},
//!             "plant": {"mass_kg": 10, "damping_ns_per_m": 50}, "controller": {"num": [9000], "den": [1]}},
//!  "spec": {"band_hz": [5, 10], "limits": {"force": 20000}}}
//! ```
//! `{"trial": ID}` stands for `{"signal": {"trial": ID, "channel": "r", "to": "y"}}`. A plant alone is driven by the
//! signal; with a controller the signal is the position asked for of their loop. The methods are those of
//! [`excite`](crate::excite).

mod declaration;
mod inputs;
mod likeness;
mod passage;
mod result;
mod spec;

use super::contract::{Analysis, Failure, Outcome, Samples};
use super::excitation::problems;
use super::excitation::signal::Signal;
use super::inputs::library::Library;
use super::inputs::plant::check_plant;
use super::kind::Kind;
use super::problem::{Code, Problem};
use super::report::Warning;
use crate::control::{Discrete, System};
use crate::ctl::Ctl;
use crate::excite::flatness::{Band, BandError, band_flatness};
use crate::excite::motion::{Motion, MotionSummary};
use crate::excite::path::{Carried, Path};
use crate::excite::recording::compare;
use crate::excite::spectrum::Spectrum;
pub use inputs::{ExcitationQualityInputs, SignalAndPath, TrackingTrial};
use likeness::{autocorrelation, predictability};
use passage::{path_result, slow_decay, travelled};
pub use result::{
    AutocorrelationResult, CorrelationKind, DeclaredResult, ExcitationQualityResult, FlatnessResult, JumpResult,
    LineRule, LinesResult, PathResult, PredictabilityResult, SamplesResult, SignalResult,
};
use serde_json::Value;
pub use spec::{ExcitationQualitySpec, LineChoice, LineName, Quantity};

/// A band with less of the signal's power than this deserves a warning.
const LITTLE: f64 = 0.5;
/// Lines between two looks at whether to go on.
const CHECKED: usize = 4096;
/// What counts as rounding beside the strongest line of a made signal.
const ROUNDING: f64 = 1e-20;

/// Where the signal is in a request.
const SIGNAL: &str = "/inputs/signal";

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: ExcitationQualityInputs,
    controller: Option<System>,
    spec: Box<ExcitationQualitySpec>,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("excitation_quality");
    const TITLE: &'static str = "Quality of an excitation";
    const SUMMARY: &'static str = "How well a signal excites, before a trial or from its recording: spectral flatness \
        in bands, lines with their power and noise, order of persistent excitation, autocorrelation and \
        predictability, and what a device and a body are asked for where a plant or loop is given (Qiu 2021, equations \
        1 to 16).";
    const RESULT_VERSION: u32 = 2;
    const EXAMPLE: &'static str = include_str!("example.json");

    type Inputs = ExcitationQualityInputs;
    type Spec = ExcitationQualitySpec;
    type Result = ExcitationQualityResult;

    fn check(inputs: ExcitationQualityInputs, spec: ExcitationQualitySpec) -> Result<Self, Problem> {
        let SignalAndPath { signal, plant, controller } = inputs.judged();
        let controller = controller.as_ref().map(|model| check_plant(model, "/inputs/controller")).transpose()?;
        let spec = spec.checked(signal.sample_time_s(), plant.is_some(), controller.is_some())?;
        Ok(Self { inputs, controller, spec: Box::new(spec) })
    }

    fn inputs(&self) -> &ExcitationQualityInputs {
        &self.inputs
    }

    fn spec(&self) -> &ExcitationQualitySpec {
        &self.spec
    }

    fn seed(&self) -> Option<u64> {
        self.inputs.judged().signal.seed()
    }

    /// The signal, then what comes out and the force behind it, by name.
    fn samples(result: &Value) -> Option<Samples> {
        let samples = &result["samples"];
        let column = |name: &'static str| (name, &samples[name]);
        Samples::named(&samples["sample_time_s"], &[column("signal"), column("force"), column("output")])
    }

    /// Progress counts its parts: the signal, its spectrum, what was declared, its way, its correlation and its motion.
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Outcome<ExcitationQualityResult>, Failure> {
        ctl.set_total(6);
        let step = || -> Result<(), Failure> {
            ctl.advance(1);
            Ok(ctl.check()?)
        };
        let signal = self.inputs.judged().signal.resolve(library, SIGNAL, ctl)?;
        step()?;
        let mut warnings = Vec::new();
        if let Some(period_s) = signal.uneven_period_s {
            let message = format!(
                "the period of {period_s} s is no whole number of samples of {} s: the record stands for a period, its \
                 lines lie between those of the sequence, and every one of them counts; choose a sample time that \
                 divides the chip or the period",
                signal.sample_time_s
            );
            warnings.push(Warning::new("period_not_whole", message));
        }
        let (record, samples) = signal.periods();
        let spectrum = Spectrum::new(record, samples, signal.sample_time_s, ctl)?;
        let (rule, lines) = self.lines(&signal, &spectrum)?;
        step()?;
        let declared = match &signal.declared {
            Some(declared) => compare(&signal.values, declared, ctl)?,
            None => None,
        };
        if let Some(compared) = &declared {
            warnings.extend(declaration::warnings(compared, &signal));
        }
        step()?;
        let path = self.path(library, &signal)?;
        let answer = self.answer(&signal, &spectrum, path.as_ref(), ctl)?;
        let flatness = self.flatness(&spectrum, answer.as_ref(), &lines, &mut warnings, ctl)?;
        if let Some(path) = &path {
            warnings.extend(slow_decay(path, &lines, spectrum.spacing_hz()));
        }
        step()?;
        let autocorrelation = autocorrelation(&signal, ctl)?;
        let predictability = predictability(&signal, &self.spec.horizons_s, ctl)?;
        step()?;
        let carried = match &path {
            None => None,
            Some(path) => Some(path.carry(&travelled(&signal), ctl).map_err(|error| problems::carried(&error))?),
        };
        let motion = self.motion(&signal, path.as_ref(), carried.as_ref(), ctl)?;
        if motion.within_limits == Some(false) {
            warnings.push(Warning::new("limits_broken", "a peak of the motion is above its limit; see motion"));
        }
        let unjudged = motion.unjudged(&self.spec.limits);
        if !unjudged.is_empty() {
            let message = format!(
                "nothing tells the {} of this signal, so that its limit was not judged: give the plant that moves, or \
                 say by quantity what the signal is",
                unjudged.join(" and the ")
            );
            warnings.push(Warning::new("limit_not_judged", message));
        }
        step()?;
        // From here to the end each part passes over the lines a few times.
        let whole = band_flatness(&spectrum, &lines, None).map_err(|error| problems::band(&error, SIGNAL))?;
        let whole_answer = answer
            .as_ref()
            .map(|answer| band_flatness(answer, &lines, None))
            .transpose()
            .map_err(|error| problems::band(&error, SIGNAL))?;
        let least = self.least(&signal);
        let carrying = self.carrying(&signal, &spectrum);
        let result = ExcitationQualityResult {
            signal: SignalResult::new(&signal, samples, record.len() / samples),
            declared: declared.map(|compared| DeclaredResult::new(&compared, signal.sample_time_s)),
            flatness,
            whole_band: FlatnessResult::new(Band::UpTo(0.5 / signal.sample_time_s), whole, whole_answer),
            lines: LinesResult::new(rule, &spectrum, answer.as_ref(), &lines, self.spec.max_lines),
            persistent_excitation_order: spectrum.persistent_excitation_order(&carrying, least),
            autocorrelation,
            predictability,
            path: path.as_ref().map(path_result),
            plant_fit: self
                .inputs
                .judged()
                .plant
                .as_ref()
                .map(|plant| plant.fit("/inputs/plant"))
                .transpose()?
                .flatten(),
            motion,
            samples: self.spec.include_samples.then(|| SamplesResult {
                sample_time_s: signal.sample_time_s,
                signal: signal.values.clone(),
                output: carried.as_ref().map(|c| c.output[..signal.values.len().min(c.output.len())].to_vec()),
                force: carried
                    .as_ref()
                    .filter(|_| self.controller.is_some())
                    .map(|c| c.effort[..signal.values.len().min(c.effort.len())].to_vec()),
            }),
        };
        Ok(Outcome::new(result, warnings))
    }
}

impl Plan {
    /// The share of the strongest line's power from which a line counts.
    fn least(&self, signal: &Signal) -> f64 {
        if signal.is_made { ROUNDING } else { self.spec.power_threshold }
    }

    /// The lines that carry power, whichever are judged: of a made signal by construction, of a recording those that
    /// stand out of it, since a device may not follow everything that was played.
    fn carrying(&self, signal: &Signal, spectrum: &Spectrum) -> Vec<usize> {
        match &signal.harmonics {
            Some(harmonics) if signal.is_made => {
                harmonics.iter().copied().filter(|n| 2 * n < spectrum.samples).collect()
            }
            _ => spectrum.excited(self.least(signal)),
        }
    }

    /// The lines that are judged, and by which rule they were chosen.
    fn lines(&self, signal: &Signal, spectrum: &Spectrum) -> Result<(LineRule, Vec<usize>), Problem> {
        let all = spectrum.all_lines();
        let (rule, lines) = match (&self.spec.lines, &signal.harmonics) {
            (LineChoice::Name(LineName::Auto), Some(harmonics)) => (LineRule::Sequence, harmonics.clone()),
            (LineChoice::Name(LineName::Auto | LineName::Excited), _) => {
                (LineRule::Excited, spectrum.excited(self.least(signal)))
            }
            (LineChoice::Name(LineName::All), _) => (LineRule::All, all),
            (LineChoice::Name(LineName::Odd), _) => (LineRule::Odd, all.into_iter().step_by(2).collect()),
            (LineChoice::Harmonics { harmonics }, _) => {
                if let Some(i) = harmonics.iter().position(|n| 2 * n >= spectrum.samples) {
                    let detail = format!(
                        "line {} is at or above the Nyquist frequency: a period has {} samples",
                        harmonics[i], spectrum.samples
                    );
                    return Err(Problem::new(Code::Invalid, "line above the Nyquist frequency", detail)
                        .at(format!("/spec/lines/harmonics/{i}")));
                }
                (LineRule::Given, harmonics.clone())
            }
        };
        let lines: Vec<usize> = lines.into_iter().filter(|n| 2 * n < spectrum.samples).collect();
        if lines.len() < 2 {
            let detail = format!("{} of the signal's lines carry power, and flatness takes two", lines.len());
            return Err(Problem::new(Code::NotIdentifiable, "no excited lines", detail)
                .at(SIGNAL)
                .mend("Excite more lines, or give the period, so that lines fall on its multiples."));
        }
        Ok((rule, lines))
    }

    fn path(&self, library: &Library, signal: &Signal) -> Result<Option<Path>, Problem> {
        let Some(plant) = &self.inputs.judged().plant else { return Ok(None) };
        let time = Discrete::new(signal.sample_time_s).map_err(|error| {
            Problem::new(Code::Invalid, "unusable sample time", error.to_string()).at("/inputs/signal/sample_time_s")
        })?;
        let sampled = plant.sample(library, self.spec.discretisation, time, "/inputs/plant")?;
        let path = match &self.controller {
            None => Path::open(sampled),
            Some(controller) => Path::closed(sampled, controller),
        };
        path.map(Some).map_err(|error| problems::path(&error))
    }

    /// The spectrum of what comes out: measured in a trial, or the steady state behind a path.
    fn answer(
        &self,
        signal: &Signal,
        spectrum: &Spectrum,
        path: Option<&Path>,
        ctl: &Ctl,
    ) -> Result<Option<Spectrum>, Failure> {
        if let Some(answer) = &signal.answer {
            let (_, samples) = signal.periods();
            return Ok(Some(Spectrum::new(answer, samples, signal.sample_time_s, ctl)?));
        }
        let Some(path) = path else { return Ok(None) };
        let mut answer = spectrum.clone();
        answer.noise = None;
        for n in 0..answer.mean.len() {
            if n % CHECKED == 0 {
                ctl.check()?;
            }
            answer.mean[n] *= path.response(spectrum.omega_rad_s(n));
            answer.power[n] = answer.mean[n].norm_sqr();
        }
        if let Some(n) = answer.power.iter().position(|p| !p.is_finite()) {
            let detail = format!("the system has a pole at {} Hz", n as f64 * spectrum.spacing_hz());
            return Err(Problem::new(Code::NotIdentifiable, "pole on a line", detail).at("/inputs/plant").into());
        }
        Ok(Some(answer))
    }

    fn flatness(
        &self,
        spectrum: &Spectrum,
        answer: Option<&Spectrum>,
        lines: &[usize],
        warnings: &mut Vec<Warning>,
        ctl: &Ctl,
    ) -> Result<Vec<FlatnessResult>, Failure> {
        let mut results = Vec::new();
        for (i, band) in self.spec.band_hz.iter().enumerate() {
            // A band may hold a million lines.
            ctl.check()?;
            let at = format!("/spec/band_hz/{i}");
            let judge = |spectrum: &Spectrum| -> Result<_, BandError> { band_flatness(spectrum, lines, Some(*band)) };
            let own = judge(spectrum).map_err(|error| problems::band(&error, &at))?;
            ctl.check()?;
            let other = answer.map(judge).transpose().map_err(|error| problems::band(&error, &at))?;
            let share = other.map_or(own.energy_fraction, |other| other.energy_fraction);
            if share < LITTLE {
                let [from, to] = band.ends();
                let message = format!(
                    "the band from {from} to {to} Hz holds {:.1} % of the signal's power: its flatness says little \
                     about the rest",
                    100.0 * share
                );
                warnings.push(Warning::new("little_power_in_band", message));
            }
            results.push(FlatnessResult::new(*band, own, other));
        }
        Ok(results)
    }

    fn motion(
        &self,
        signal: &Signal,
        path: Option<&Path>,
        carried: Option<&Carried>,
        ctl: &Ctl,
    ) -> Result<MotionSummary, Failure> {
        let limits = &self.spec.limits;
        let motion = match (path, carried, self.spec.quantity) {
            (Some(path), Some(carried), _) => Motion::of_plant(path.plant(), &carried.output, &carried.effort, ctl)
                .map_err(|error| problems::carried(&error))?,
            (_, _, Quantity::Force) => Motion::of_force(&signal.values),
            _ => {
                // The seam between periods is part of a periodic motion.
                let mut values = signal.answer.as_ref().unwrap_or(&signal.values).clone();
                if signal.is_made && signal.period.is_some_and(|n| values.len().is_multiple_of(n)) {
                    values.extend_from_within(..2);
                }
                Motion::of_samples(&values, None, signal.sample_time_s)
            }
        };
        Ok(motion.summary(limits))
    }
}
