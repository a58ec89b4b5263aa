//! How good an excitation is: kind `excitation_quality`.
//!
//! ```json
//! {"kind": "excitation_quality",
//!  "inputs": {"signal": {"generator": {"kind": "prts", "order": 5, "chip_s": 0.2}, "sample_time_s": 0.001},
//!             "plant": {"mass_kg": 10, "damping_ns_per_m": 50}, "controller": {"num": [9000], "den": [1]}},
//!  "spec": {"band_hz": [5, 10], "limits": {"force": 20000}}}
//! ```
//! `{"trial": ID}` stands for `{"signal": {"trial": ID, "channel": "r", "to": "y"}}`. A plant alone is driven by the signal; with a controller the signal is the position asked for of their loop. The methods are those of
//! [`excite`](crate::excite).

mod result;
mod spec;

use super::plant::PlantInput;
use super::signal::{Signal, SignalInput};
use super::{members, only, problems};
use crate::analysis::inputs::{Library, References};
use crate::analysis::kind::{Kind, Request};
use crate::analysis::plan::Failure;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::report::{Report, Warning, sha256_json};
use crate::analysis::ssid::problems::check_plant;
use crate::analysis::trial_input::parse_model;
use crate::control::{Discrete, Model, System};
use crate::ctl::Ctl;
use crate::excite::flatness::{Band, BandError, band_flatness};
use crate::excite::motion::Motion;
use crate::excite::path::Path;
use crate::excite::peak::supremum;
use crate::excite::sequence::correlation;
use crate::excite::spectrum::Spectrum;
pub use result::{
    AutocorrelationResult, ExcitationQualityResult, FlatnessResult, LinesResult, PathResult, PredictabilityResult,
    SamplesResult, SignalResult,
};
use serde_json::json;
pub use spec::{ExcitationQualitySpec, LineChoice, LineName, Quantity};
use std::collections::BTreeMap;

/// Version of [`ExcitationQualityResult`].
const RESULT_VERSION: u32 = 1;
/// Lags of the autocorrelation that are given.
const LAGS: usize = 200;
/// A signal has left its own likeness behind when its autocorrelation has fallen to this.
const FORGOTTEN: f64 = 0.1;
/// A band with less of the signal's power than this deserves a warning.
const LITTLE: f64 = 0.5;
/// What counts as rounding beside the strongest line of a made signal.
const ROUNDING: f64 = 1e-20;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    signal: SignalInput,
    plant: Option<PlantInput>,
    controller: Option<(Model, System)>,
    spec: Box<ExcitationQualitySpec>,
}

impl Plan {
    /// Checks a request.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(request: &Request) -> Result<Self, Problem> {
        let inputs = members(&request.inputs, "the inputs", "/inputs")?;
        let signal = match (inputs.get("signal"), inputs.get("trial")) {
            // The form in which one analysis is asked for of every trial of a study.
            (None, Some(trial)) => {
                only(inputs, &["trial"], "/inputs")?;
                SignalInput::parse(&json!({"trial": trial, "channel": "r", "to": "y"}), "/inputs")?
            }
            (Some(signal), _) => {
                only(inputs, &["signal", "plant", "controller"], "/inputs")?;
                SignalInput::parse(signal, "/inputs/signal")?
            }
            (None, None) => {
                return Err(Problem::new(Code::Invalid, "unusable inputs", "there is no signal")
                    .at("/inputs/signal")
                    .mend("Give a generator, a trial or samples as the signal."));
            }
        };
        let present = |name: &str| inputs.get(name).filter(|value| !value.is_null());
        let plant = present("plant").map(|value| PlantInput::parse(value, "/inputs/plant")).transpose()?;
        let controller = match present("controller") {
            None => None,
            Some(_) if plant.is_none() => {
                return Err(Problem::new(Code::Invalid, "unusable inputs", "there is a controller, and no plant")
                    .at("/inputs/controller")
                    .mend("Give the plant that it controls."));
            }
            Some(value) => {
                let model = parse_model(value, "/inputs/controller")?;
                let system = check_plant(&model, "/inputs/controller")?;
                Some((model, system))
            }
        };
        let spec = ExcitationQualitySpec::parse(&request.spec, &signal, plant.is_some(), controller.is_some())?;
        Ok(Self { signal, plant, controller, spec: Box::new(spec) })
    }

    /// The stored things that it needs.
    #[must_use]
    pub fn references(&self) -> References {
        let mut references = self.signal.references();
        references.plants.extend(self.plant.as_ref().and_then(PlantInput::id));
        references
    }

    /// The request with its defaults filled in; parsing it again gives an equal plan.
    #[must_use]
    pub fn request(&self) -> Request {
        let mut inputs = json!({"signal": self.signal.to_value()});
        if let Some(plant) = &self.plant {
            inputs["plant"] = plant.to_value();
        }
        if let Some((model, _)) = &self.controller {
            inputs["controller"] = json!(model);
        }
        Request { kind: Kind::ExcitationQuality.name().to_owned(), inputs, spec: json!(self.spec) }
    }

    /// Computes the report; progress counts its parts: the signal, its spectrum, its way, its correlation and its motion.
    ///
    /// # Errors
    /// [`Failure::Stopped`] when `ctl` says so, [`Failure::Problem`] when the question has no answer.
    pub fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        ctl.set_total(5);
        let step = || -> Result<(), Failure> {
            ctl.advance(1);
            Ok(ctl.check()?)
        };
        let signal = self.signal.resolve(library, "/inputs/signal", ctl)?;
        step()?;
        let mut warnings = Vec::new();
        let mut hashes = BTreeMap::from([("/inputs/signal".to_owned(), signal.sha256.clone())]);
        if let Some(period_s) = signal.uneven_period_s {
            let message = format!(
                "the period of {period_s} s is no whole number of samples of {} s: the record stands for a period, its lines lie between \
                 those of the sequence, and every one of them counts; choose a sample time that divides the chip or the period",
                signal.sample_time_s
            );
            warnings.push(Warning::new("period_not_whole", message));
        }
        let (record, samples) = signal.periods();
        let spectrum = Spectrum::new(record, samples, signal.sample_time_s, ctl)?;
        let (rule, lines) = self.lines(&signal, &spectrum)?;
        step()?;
        let path = self.path(library, &signal, &mut hashes)?;
        let answer = self.answer(&signal, &spectrum, path.as_ref(), ctl)?;
        let flatness = self.flatness(&spectrum, answer.as_ref(), &lines, &mut warnings)?;
        if let Some(path) = &path {
            warnings.extend(slow_decay(path, &lines, spectrum.spacing_hz()));
        }
        step()?;
        let autocorrelation = autocorrelation(&signal);
        let predictability = self.predictability(&signal)?;
        step()?;
        let carried = match &path {
            None => None,
            Some(path) => Some(path.carry(&travelled(&signal)).map_err(|error| problems::path(&error))?),
        };
        let motion = self.motion(&signal, path.as_ref(), carried.as_ref())?;
        if motion.within_limits == Some(false) {
            warnings.push(Warning::new("limits_broken", "a peak of the motion is above its limit; see motion"));
        }
        let unjudged = motion.unjudged(&self.spec.limits);
        if !unjudged.is_empty() {
            let message = format!(
                "nothing tells the {} of this signal, so that its limit was not judged: give the plant that moves, or say by quantity what the \
                 signal is",
                unjudged.join(" and the ")
            );
            warnings.push(Warning::new("limit_not_judged", message));
        }
        step()?;
        let whole = band_flatness(&spectrum, &lines, None).map_err(|error| problems::band(&error, "/inputs/signal"))?;
        let whole_answer = answer
            .as_ref()
            .map(|answer| band_flatness(answer, &lines, None))
            .transpose()
            .map_err(|error| problems::band(&error, "/inputs/signal"))?;
        let least = self.least(&signal);
        let carrying = self.carrying(&signal, &spectrum);
        let result = ExcitationQualityResult {
            signal: SignalResult::new(&signal, samples, record.len() / samples),
            flatness,
            whole_band: FlatnessResult::new(Band::UpTo(0.5 / signal.sample_time_s), whole, whole_answer),
            lines: LinesResult::new(rule, &spectrum, answer.as_ref(), &lines, self.spec.max_lines),
            persistent_excitation_order: spectrum.persistent_excitation_order(&carrying, least),
            autocorrelation,
            predictability,
            path: path.as_ref().map(path_result),
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
        let spec = json!(self.spec);
        Ok(Report::new(
            Kind::ExcitationQuality,
            RESULT_VERSION,
            json!(result),
            warnings,
            spec,
            hashes,
            self.signal.seed(),
        ))
    }

    /// The share of the strongest line's power from which a line counts.
    fn least(&self, signal: &Signal) -> f64 {
        if signal.is_made { ROUNDING } else { self.spec.power_threshold }
    }

    /// The lines that carry power, whichever are judged: of a made signal by construction, of a recording those that stand out of it, since a
    /// device may not follow everything that was played.
    fn carrying(&self, signal: &Signal, spectrum: &Spectrum) -> Vec<usize> {
        match &signal.harmonics {
            Some(harmonics) if signal.is_made => {
                harmonics.iter().copied().filter(|n| 2 * n < spectrum.samples).collect()
            }
            _ => spectrum.excited(self.least(signal)),
        }
    }

    /// The lines that are judged, and by which rule they were chosen.
    fn lines(&self, signal: &Signal, spectrum: &Spectrum) -> Result<(&'static str, Vec<usize>), Problem> {
        let all = spectrum.all_lines();
        let (rule, lines) = match (&self.spec.lines, &signal.harmonics) {
            (LineChoice::Name(LineName::Auto), Some(harmonics)) => ("sequence", harmonics.clone()),
            (LineChoice::Name(LineName::Auto | LineName::Excited), _) => {
                ("excited", spectrum.excited(self.least(signal)))
            }
            (LineChoice::Name(LineName::All), _) => ("all", all),
            (LineChoice::Name(LineName::Odd), _) => ("odd", all.into_iter().step_by(2).collect()),
            (LineChoice::Harmonics { harmonics }, _) => {
                if let Some(i) = harmonics.iter().position(|n| 2 * n >= spectrum.samples) {
                    let detail = format!(
                        "line {} is at or above the Nyquist frequency: a period has {} samples",
                        harmonics[i], spectrum.samples
                    );
                    return Err(Problem::new(Code::Invalid, "line above the Nyquist frequency", detail)
                        .at(format!("/spec/lines/harmonics/{i}")));
                }
                ("given", harmonics.clone())
            }
        };
        let lines: Vec<usize> = lines.into_iter().filter(|n| 2 * n < spectrum.samples).collect();
        if lines.len() < 2 {
            let detail = format!("{} of the signal's lines carry power, and flatness takes two", lines.len());
            return Err(Problem::new(Code::NotIdentifiable, "no excited lines", detail)
                .at("/inputs/signal")
                .mend("Excite more lines, or give the period, so that lines fall on its multiples."));
        }
        Ok((rule, lines))
    }

    fn path(
        &self,
        library: &Library,
        signal: &Signal,
        hashes: &mut BTreeMap<String, String>,
    ) -> Result<Option<Path>, Problem> {
        let Some(plant) = &self.plant else { return Ok(None) };
        let time = Discrete::new(signal.sample_time_s).map_err(|error| {
            Problem::new(Code::Invalid, "unusable sample time", error.to_string()).at("/inputs/signal/sample_time_s")
        })?;
        let (sampled, sha256) = plant.sample(library, self.spec.discretisation, time, "/inputs/plant")?;
        hashes.insert("/inputs/plant".to_owned(), sha256);
        let path = match &self.controller {
            None => Path::open(sampled),
            Some((model, system)) => {
                hashes.insert("/inputs/controller".to_owned(), sha256_json(&json!(model)));
                Path::closed(sampled, system)
            }
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
    ) -> Result<Vec<FlatnessResult>, Problem> {
        let mut results = Vec::new();
        for (i, band) in self.spec.band_hz.iter().enumerate() {
            let at = format!("/spec/band_hz/{i}");
            let judge = |spectrum: &Spectrum| -> Result<_, BandError> { band_flatness(spectrum, lines, Some(*band)) };
            let own = judge(spectrum).map_err(|error| problems::band(&error, &at))?;
            let other = answer.map(judge).transpose().map_err(|error| problems::band(&error, &at))?;
            let share = other.map_or(own.energy_fraction, |other| other.energy_fraction);
            if share < LITTLE {
                let [from, to] = band.ends();
                let message = format!(
                    "the band from {from} to {to} Hz holds {:.1} % of the signal's power: its flatness says little about the rest",
                    100.0 * share
                );
                warnings.push(Warning::new("little_power_in_band", message));
            }
            results.push(FlatnessResult::new(*band, own, other));
        }
        Ok(results)
    }

    fn predictability(&self, signal: &Signal) -> Result<Vec<PredictabilityResult>, Problem> {
        let (record, samples) = signal.periods();
        let mean = record.iter().sum::<f64>() / record.len() as f64;
        let level: Vec<f64> = record.iter().map(|x| x - mean).collect();
        let mut results = Vec::new();
        let mut around = Vec::new();
        for horizon_s in &self.spec.horizons_s {
            let horizon = ((horizon_s / signal.sample_time_s).round() as usize).max(1);
            let spacing = horizon.div_ceil(4);
            let lags = correlation::lags_needed(horizon, spacing);
            if lags > samples {
                continue;
            }
            if around.is_empty() {
                around = match signal.period {
                    Some(n) => correlation::periodic_autocorrelation(&level[..n], n),
                    None => correlation::autocorrelation(&level, level.len()),
                };
            }
            let share = correlation::predictability(&around, horizon, spacing).map_err(|error| {
                Problem::new(Code::Numerical, "no prediction", error.to_string()).at("/spec/horizons_s")
            })?;
            results.push(PredictabilityResult {
                horizon_s: horizon as f64 * signal.sample_time_s,
                spacing_s: spacing as f64 * signal.sample_time_s,
                r_squared: share,
            });
        }
        Ok(results)
    }

    fn motion(
        &self,
        signal: &Signal,
        path: Option<&Path>,
        carried: Option<&crate::excite::path::Carried>,
    ) -> Result<crate::excite::motion::MotionSummary, Problem> {
        let limits = &self.spec.limits;
        let motion = match (path, carried, self.spec.quantity) {
            (Some(path), Some(carried), _) => Motion::of_plant(path.plant(), &carried.output, &carried.effort)
                .map_err(|error| problems::path(&error.into()))?,
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

/// What a device that starts from rest is given: two periods, so that its settling and its steady state are both in it, or the record.
fn travelled(signal: &Signal) -> Vec<f64> {
    match signal.period {
        Some(n) if signal.values.len() < 2 * n => [&signal.values[..n], &signal.values[..n]].concat(),
        _ => signal.values.clone(),
    }
}

fn autocorrelation(signal: &Signal) -> AutocorrelationResult {
    let (record, samples) = signal.periods();
    let (values, kind) = match signal.period {
        Some(n) => (correlation::periodic_autocorrelation(&record[..n], n / 2 + 1), "periodic"),
        None => (correlation::autocorrelation(record, samples / 2 + 1), "record"),
    };
    let scale = if values[0] > 0.0 { values[0] } else { 1.0 };
    let values: Vec<f64> = values.iter().map(|r| r / scale).collect();
    // Its likeness to itself a moment ago is no repetition.
    let own = values.iter().position(|r| *r < FORGOTTEN).unwrap_or(values.len());
    let sidelobe = (own..values.len()).max_by(|a, b| values[*a].abs().total_cmp(&values[*b].abs()));
    let chip = signal.chip_s.map_or(1, |chip_s| ((chip_s / signal.sample_time_s).round() as usize).max(1));
    let step = chip.max(1);
    let shown: Vec<usize> = (0..values.len()).step_by(step).take(LAGS).collect();
    AutocorrelationResult {
        kind: kind.to_owned(),
        lag_s: shown.iter().map(|j| *j as f64 * signal.sample_time_s).collect(),
        value: shown.iter().map(|j| values[*j]).collect(),
        largest_sidelobe: sidelobe.map(|j| values[j]),
        sidelobe_lag_s: sidelobe.map(|j| j as f64 * signal.sample_time_s),
    }
}

/// A warning where a mode decays so slowly that its resonance fits between two lines, which then say nothing about it.
fn slow_decay(path: &Path, lines: &[usize], spacing_hz: f64) -> Option<Warning> {
    let gap = lines.windows(2).map(|pair| pair[1] - pair[0]).min()?;
    let time = path.plant().time();
    let radius = poles(path).iter().map(|z| z.norm()).fold(0.0, f64::max);
    let decay = -radius.ln() / time.period_s();
    let needed = std::f64::consts::PI * gap as f64 * spacing_hz;
    (decay < needed).then(|| {
        Warning::new(
            "slow_decay",
            format!(
                "the slowest mode decays with {decay:.3e} per second: its resonance is narrower than the distance of the lines, and has not \
                 settled within a period (both would take {needed:.3e} per second)"
            ),
        )
    })
}

/// The poles in z.
fn poles(path: &Path) -> Vec<crate::num::Complex64> {
    let found = match path.loop_() {
        Some(closed) => closed.poles(),
        None => path.plant().sampled().poles(),
    };
    found.unwrap_or_default()
}

fn path_result(path: &Path) -> PathResult {
    use crate::control::TimeBase as _;
    let time = path.plant().time();
    let nyquist = std::f64::consts::PI / time.period_s();
    let hints = path.pole_hints();
    let resonance = crate::excite::peak::resonance(|w| path.response(w).norm(), nyquist, &hints);
    let disturbance = path.loop_().map(|closed| supremum(|w| closed.disturbance_to_output(w).norm(), nyquist, &hints));
    let hz = |omega: f64| omega / (2.0 * std::f64::consts::PI);
    PathResult {
        is_loop: path.loop_().is_some(),
        sample_time_s: time.sample_time_s().unwrap_or_default(),
        resonance_hz: resonance.map(|peak| hz(peak.at)),
        resonance_gain: resonance.map(|peak| peak.value),
        disturbance_norm: disturbance.map(|peak| peak.value),
        disturbance_norm_hz: disturbance.map(|peak| hz(peak.at)),
        spectral_radius: poles(path).iter().map(|z| z.norm()).fold(0.0, f64::max),
    }
}
