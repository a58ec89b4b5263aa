//! The compensator of a position loop: kind `compensator_design`.
//!
//! ```json
//! {"kind": "compensator_design",
//!  "inputs": {"plant": {"mass_kg": 10, "damping_ns_per_m": 50},
//!             "signal": {"generator": {"kind": "prts", "order": 5, "chip_s": 0.2, "amplitude": 0.05},
//!                        "sample_time_s": 0.001}},
//!  "spec": {"structure": "lead", "band_hz": 5, "limits": {"force": 2000, "disturbance_norm": 0.001}}}
//! ```
//! The method is that of [`excite::compensator`](crate::excite::compensator).

mod inputs;
mod result;
mod spec;

use super::contract::{Analysis, Failure, Outcome};
use super::excitation::plant::PlantFit;
use super::excitation::problems;
use super::excitation::signal::Signal;
use super::inputs::library::Library;
use super::kind::Kind;
use super::problem::{Code, Problem};
use super::report::Warning;
use crate::control::Discrete;
use crate::ctl::{Ctl, Phase};
use crate::excite::compensator::{
    Design, DesignError, DesignLimits, Edge, Found, Judged, SearchBox, SectionBox, search, sweep,
};
use crate::excite::path::SampledPlant;
use crate::excite::spectrum::Spectrum;
pub use inputs::CompensatorDesignInputs;
use inputs::{PLANT, SIGNAL};
pub use result::{
    Action, BaselineResult, CompensatorDesignResult, CurveResult, FlatnessParts, RunnerUpResult, SearchResult,
    SectionResult,
};
pub use spec::{CompensatorDesignSpec, Structure, SweepSpec};

/// A share of agreeing climbs below which the answer deserves a warning.
const AGREEMENT: f64 = 0.25;
/// How much farther than the proportional loop a person's force may push the device without a warning.
const WEAK: f64 = 1.5;
/// Damping ratios of sections of second order, where none are given.
const DAMPING: [f64; 2] = [0.05, 100.0];
/// A misfit of a measured plant above this deserves a warning.
const POOR_FIT: f64 = 0.1;
/// A share of the signal's power below this is no delivery.
const DELIVERED: f64 = 0.25;
/// A gain in flatness below this is none.
const BETTER: f64 = 1e-6;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: CompensatorDesignInputs,
    spec: Box<CompensatorDesignSpec>,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("compensator_design");
    const TITLE: &'static str = "Design of a compensator";
    const SUMMARY: &'static str = "The proportional control, lead, cascade or compensator of free order of a position \
        loop (a manipulandum, a motion platform) that delivers a given signal with the flattest spectrum in a band, \
        under limits on motion and force: limits out of reach are refused with a bound, then a grid over the whole box \
        and climbs from its best points, with stability proven (Qiu 2021, sections IV.B to IV.D).";
    const RESULT_VERSION: u32 = 2;
    const EXAMPLE: &'static str = include_str!("example.json");

    type Inputs = CompensatorDesignInputs;
    type Spec = CompensatorDesignSpec;
    type Result = CompensatorDesignResult;

    fn check(inputs: CompensatorDesignInputs, spec: CompensatorDesignSpec) -> Result<Self, Problem> {
        let spec = Box::new(spec.checked(inputs.signal.sample_time_s())?);
        Ok(Self { inputs, spec })
    }

    fn inputs(&self) -> &CompensatorDesignInputs {
        &self.inputs
    }

    fn spec(&self) -> &CompensatorDesignSpec {
        &self.spec
    }

    fn seed(&self) -> Option<u64> {
        self.inputs.signal.seed()
    }

    /// Progress counts columns of the grid and climbs, of each search anew.
    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Outcome<CompensatorDesignResult>, Failure> {
        let signal = self.inputs.signal.resolve(library, SIGNAL, ctl)?;
        let time = Discrete::new(signal.sample_time_s).map_err(|error| {
            Problem::new(Code::Invalid, "unusable sample time", error.to_string()).at("/inputs/signal/sample_time_s")
        })?;
        let plant = self.inputs.plant.sample(library, self.spec.discretisation, time, PLANT)?;
        let (design, spacing_hz) = self.design(&signal, plant, ctl)?;
        let fit = self.inputs.plant.fit(PLANT)?;
        let mut limits = self.spec.limits;
        limits.decay_per_s = Some(limits.decay_per_s.unwrap_or(std::f64::consts::PI * spacing_hz));
        let limits = &limits;
        let region = self.region(&design, time)?;
        let mut warnings = Vec::new();

        // The search, the same with a proportional controller, and curves.
        let in_search = ctl.scope(0.8);
        let found = search(&design, &region, limits, ctl).map_err(|error| problems::design(&error))?;
        drop(in_search);
        let judged = design
            .judge(&found.compensator, limits, ctl)
            .map_err(|error| problems::design(&DesignError::Path(error)))?;
        let in_baseline = ctl.scope(0.1);
        let baseline = if !region.sections.is_empty() { self.baseline(&design, &region, limits, ctl)? } else { None };
        drop(in_baseline);
        let mut curves = Vec::new();
        if let Some(asked) = &self.spec.sweep {
            ctl.enter(Phase::Verification, 0.1);
            ctl.set_total(asked.zero_hz.len().max(1) as u64);
            let gain = asked.gain.unwrap_or(region.gain);
            let corners: Vec<Option<[f64; 2]>> = match asked.pole_hz {
                None => vec![None],
                Some(pole) => asked.zero_hz.iter().map(|zero| Some([*zero, pole])).collect(),
            };
            for corners in corners {
                let curve =
                    sweep(&design, corners, gain, asked.count, ctl).map_err(|error| problems::design(&error))?;
                curves.push(CurveResult::new(&curve));
            }
        }
        warn(&found, &judged, baseline.as_ref(), design.reference_mean(), &mut warnings);
        if let Some(fit) = &fit {
            warnings.extend(plant_warnings(fit, &design, &judged)?);
        }
        let result = CompensatorDesignResult::new(
            fit,
            self.spec.band_hz,
            limits,
            &design,
            &found,
            &judged,
            baseline.as_ref(),
            curves,
        )
        .map_err(|error| problems::design(&DesignError::Path(error)))?;
        Ok(Outcome::new(result, warnings))
    }
}

impl Plan {
    /// The loop, and the least distance of neighbouring lines in the band.
    fn design(&self, signal: &Signal, plant: SampledPlant, ctl: &Ctl) -> Result<(Design, f64), Failure> {
        let (record, samples) = signal.periods();
        let spectrum = Spectrum::new(record, samples, signal.sample_time_s, ctl)?;
        let lines = signal.harmonics.clone().unwrap_or_else(|| spectrum.excited(self.spec.power_threshold));
        let band = self.spec.band_hz;
        band.check(Some(signal.sample_time_s)).map_err(|error| problems::band(&error, "/spec/band_hz"))?;
        let inside = band.of(&lines, spectrum.spacing_hz()).map_err(|error| problems::band(&error, "/spec/band_hz"))?;
        let omegas: Vec<f64> = inside.iter().map(|n| spectrum.omega_rad_s(*n)).collect();
        let powers: Vec<f64> = inside.iter().map(|n| spectrum.share(*n)).collect();
        let reference = match signal.period {
            Some(n) if signal.values.len() < 2 * n => [&signal.values[..n], &signal.values[..n]].concat(),
            _ => signal.values.clone(),
        };
        let gap = inside.windows(2).map(|pair| pair[1] - pair[0]).min().unwrap_or(1);
        Ok((Design::new(plant, &omegas, &powers, reference), gap as f64 * spectrum.spacing_hz()))
    }

    /// Where is searched: what is fixed, what has a range, and the rest by default.
    fn region(&self, design: &Design, time: Discrete) -> Result<SearchBox, Problem> {
        let spec = &self.spec;
        let typical = design.typical_gain();
        if !(typical > 0.0 && typical.is_finite()) {
            let detail = "the plant has no gain at the upper end of the band, or an infinite one";
            return Err(Problem::new(Code::NotIdentifiable, "no gain", detail).at("/inputs/plant"));
        }
        let fixed = |value: Option<f64>, range: Option<[f64; 2]>, default: [f64; 2]| match (value, range) {
            (Some(value), _) => [value; 2],
            (None, Some(range)) => range,
            (None, None) => default,
        };
        let gain = fixed(spec.gain, spec.gain_range, [1e-4 * typical, 1e4 * typical]);
        let top = 0.5 / time.period_s();
        let corner = [1e-3 * spec.band_hz.ends()[1], 0.9 * top];
        let zero_hz = fixed(spec.zero_hz, spec.zero_range_hz, corner);
        let pole_hz = fixed(spec.pole_hz, spec.pole_range_hz, corner);
        let first = SectionBox::First { zero_hz, pole_hz };
        let sections = match spec.structure {
            Structure::Proportional => Vec::new(),
            Structure::Lead => vec![first],
            Structure::Cascade => vec![first; spec.sections.unwrap_or(2)],
            Structure::FreeOrder => {
                let order = spec.order.unwrap_or(2);
                let damping = spec.damping_range.unwrap_or(DAMPING);
                let mut sections = vec![SectionBox::Second { zero_hz, pole_hz, damping }; order / 2];
                sections.extend((order % 2 == 1).then_some(first));
                sections
            }
        };
        for (name, range) in [("zero_range_hz", spec.zero_range_hz), ("pole_range_hz", spec.pole_range_hz)] {
            if let Some([_, high]) = range.filter(|r| r[1] >= top) {
                let detail = format!("{name} reaches {high} Hz, at or above the Nyquist frequency of {top} Hz");
                return Err(Problem::new(Code::Invalid, "corner above the Nyquist frequency", detail)
                    .at(format!("/spec/{name}")));
            }
        }
        Ok(SearchBox { gain, sections, zero_below_pole: spec.zero_below_pole })
    }

    /// The best proportional control under the same limits; `None` where there is none.
    fn baseline(
        &self,
        design: &Design,
        region: &SearchBox,
        limits: &DesignLimits,
        ctl: &Ctl,
    ) -> Result<Option<Judged>, Failure> {
        let alone = SearchBox { gain: region.gain, sections: Vec::new(), zero_below_pole: false };
        match search(design, &alone, limits, ctl) {
            Ok(found) => {
                let judged = design.judge(&found.compensator, limits, ctl);
                judged.map(Some).map_err(|error| problems::design(&DesignError::Path(error)))
            }
            Err(DesignError::NothingStable { .. } | DesignError::Limits { .. } | DesignError::Impossible(_)) => {
                Ok(None)
            }
            Err(error) => Err(problems::design(&error)),
        }
    }
}

fn warn(found: &Found, judged: &Judged, baseline: Option<&Judged>, reference_mean: f64, warnings: &mut Vec<Warning>) {
    let summary = &found.summary;
    if !summary.edges.is_empty() {
        let edges: Vec<String> = summary.edges.iter().map(Edge::to_string).collect();
        let message = format!(
            "the best compensator lies on the edge of what was searched: {}; beyond it there may be a better one",
            edges.join(", ")
        );
        warnings.push(Warning::new("edge_of_the_box", message));
    }
    if (summary.agreeing as f64) < AGREEMENT * summary.climbs as f64 {
        let message = format!(
            "{} of {} climbs ended in this answer: the landscape has several tops, and the grid may have missed a \
             narrow one",
            summary.agreeing, summary.climbs
        );
        warnings.push(Warning::new("few_climbs_agree", message));
    }
    let delivered = judged.output_mean / reference_mean;
    if delivered < DELIVERED {
        let message = format!(
            "the loop delivers {:.2} % of the signal's power in the band: the limits leave the device too weak to \
             follow; raise them, or scale the signal's amplitude down",
            100.0 * delivered
        );
        warnings.push(Warning::new("signal_not_delivered", message));
    }
    if judged.blsfg <= 1.0 {
        let message = format!("the loop makes the spectrum less flat: its flatness gain is {:.4}", judged.blsfg);
        warnings.push(Warning::new("no_gain_in_flatness", message));
    }
    if let Some(baseline) = baseline
        && judged.disturbance.value > WEAK * baseline.disturbance.value
    {
        let message = format!(
            "a person's force pushes this loop aside by up to {:.3e} per unit of force, {:.1} times as far as the best \
             proportional loop: limit disturbance_norm if that matters",
            judged.disturbance.value,
            judged.disturbance.value / baseline.disturbance.value
        );
        warnings.push(Warning::new("weak_against_disturbance", message));
    }
    if let Some(baseline) = baseline
        && judged.blsfg <= baseline.blsfg * (1.0 + BETTER)
    {
        let message = format!(
            "no compensator of this structure does better than proportional control with the gain {:.6}, whose \
             flatness gain is {:.6}",
            baseline.compensator.gain, baseline.blsfg
        );
        warnings.push(Warning::new("proportional_is_as_good", message));
    }
}

/// What a measured plant's misfit means for the loop: with `H = P (1 + Δ)` at every line it is stable with the measured
/// plant too where `|Δ T| < 1` (small gain), T being the gain from reference to position.
fn plant_warnings(fit: &PlantFit, design: &Design, judged: &Judged) -> Result<Vec<Warning>, Failure> {
    let path = design.path(&judged.compensator).map_err(|error| problems::design(&DesignError::Path(error)))?;
    let mut warnings = Vec::new();
    if fit.largest_misfit > POOR_FIT {
        let message = format!(
            "the model of the measured plant misses it by {:.1} % at {} Hz; what is said of the loop is said of the \
             model",
            100.0 * fit.largest_misfit,
            fit.largest_misfit_hz
        );
        warnings.push(Warning::new("plant_fits_poorly", message));
    }
    let gain = |hz: &f64| path.response(2.0 * std::f64::consts::PI * hz).norm();
    let top = 0.5 / design.plant().time().period_s();
    let product = fit
        .frequency_hz
        .iter()
        .zip(&fit.misfit)
        .filter(|(hz, _)| **hz < top)
        .map(|(hz, misfit)| (*hz, misfit * gain(hz)))
        .fold((0.0, 0.0), |most, v| if v.1 > most.1 { v } else { most });
    if product.1 >= 1.0 {
        let message = format!(
            "the loop is stable with the model, and need not be with the measured plant: misfit times closed-loop gain \
             is {:.2} at {} Hz, where 1 is the most that is safe; give more poles, or limit the gain",
            product.1, product.0
        );
        warnings.push(Warning::new("stability_not_robust", message));
    }
    Ok(warnings)
}
