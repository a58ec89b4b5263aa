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
use super::excitation::problems;
use super::excitation::signal::Signal;
use super::inputs::library::Library;
use super::kind::Kind;
use super::problem::{Code, Problem};
use super::report::Warning;
use crate::control::Discrete;
use crate::ctl::{Ctl, Phase};
use crate::excite::compensator::{Design, DesignError, DesignLimits, Edge, Found, Judged, SearchBox, search, sweep};
use crate::excite::path::SampledPlant;
use crate::excite::spectrum::Spectrum;
pub use inputs::CompensatorDesignInputs;
use inputs::{PLANT, SIGNAL};
pub use result::{Action, BaselineResult, CompensatorDesignResult, CurveResult, RunnerUpResult, SearchResult};
pub use spec::{CompensatorDesignSpec, Structure, SweepSpec};

/// A share of agreeing climbs below which the answer deserves a warning.
const AGREEMENT: f64 = 0.25;
/// How much farther than the proportional loop a person's force may push the device without a warning.
const WEAK: f64 = 1.5;
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
    const SUMMARY: &'static str = "The proportional control or lead compensator of a position loop (a manipulandum, a \
        motion platform) that delivers a given signal with the flattest spectrum in a band, under limits on motion and \
        force: a grid over the whole box, then climbs from its best points, with stability proven (Qiu 2021, sections \
        IV.B to IV.D).";
    const RESULT_VERSION: u32 = 1;
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
        let mut limits = self.spec.limits;
        limits.decay_per_s = Some(limits.decay_per_s.unwrap_or(std::f64::consts::PI * spacing_hz));
        let limits = &limits;
        let region = self.region(&design, time)?;
        let mut warnings = Vec::new();

        // The search, the same with a proportional controller, and curves.
        let in_search = ctl.scope(0.8);
        let found = search(&design, &region, limits, ctl).map_err(|error| problems::design(&error))?;
        drop(in_search);
        let judged =
            design.judge(&found.compensator, limits).map_err(|error| problems::design(&DesignError::Path(error)))?;
        let in_baseline = ctl.scope(0.1);
        let baseline = if region.corners.is_some() { self.baseline(&design, &region, limits, ctl)? } else { None };
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
        warn(&found, &judged, baseline.as_ref(), &mut warnings);
        let result = CompensatorDesignResult::new(
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
        let powers: Vec<f64> = inside.iter().map(|n| spectrum.power[*n]).collect();
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
        let corners = (spec.structure == Structure::Lead).then(|| {
            [fixed(spec.zero_hz, spec.zero_range_hz, corner), fixed(spec.pole_hz, spec.pole_range_hz, corner)]
        });
        for (name, range) in [("zero_range_hz", spec.zero_range_hz), ("pole_range_hz", spec.pole_range_hz)] {
            if let Some([_, high]) = range.filter(|r| r[1] >= top) {
                let detail = format!("{name} reaches {high} Hz, at or above the Nyquist frequency of {top} Hz");
                return Err(Problem::new(Code::Invalid, "corner above the Nyquist frequency", detail)
                    .at(format!("/spec/{name}")));
            }
        }
        Ok(SearchBox { gain, corners, zero_below_pole: spec.zero_below_pole })
    }

    /// The best proportional control under the same limits; `None` where there is none.
    fn baseline(
        &self,
        design: &Design,
        region: &SearchBox,
        limits: &DesignLimits,
        ctl: &Ctl,
    ) -> Result<Option<Judged>, Failure> {
        let alone = SearchBox { gain: region.gain, corners: None, zero_below_pole: false };
        match search(design, &alone, limits, ctl) {
            Ok(found) => {
                let judged = design.judge(&found.compensator, limits);
                judged.map(Some).map_err(|error| problems::design(&DesignError::Path(error)))
            }
            Err(DesignError::NothingStable { .. } | DesignError::Limits { .. }) => Ok(None),
            Err(error) => Err(problems::design(&error)),
        }
    }
}

fn warn(found: &Found, judged: &Judged, baseline: Option<&Judged>, warnings: &mut Vec<Warning>) {
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
