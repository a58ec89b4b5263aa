//! What the tests have in common: the reference, sequences, a run without a server, the linear drive.

use crate::contract::contract;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use volition::analysis::{Failure, Library, Plan, Problem, Report, Request};
use volition::control::Discrete;
use volition::ctl::Ctl;
use volition::excite::compensator::Design;
use volition::excite::flatness::{Band, band_flatness};
use volition::excite::path::SampledPlant;
use volition::excite::sequence::{Sequence, SequenceSpec};
use volition::excite::spectrum::Spectrum;

#[derive(Deserialize)]
pub struct Golden {
    pub primitive: Vec<Vec<u8>>,
    pub sequence_c: Vec<u8>,
    pub sequence: Vec<f64>,
    pub gamma_r2: BTreeMap<String, Value>,
    pub gamma_r2_2p5: Value,
    pub gamma_r2_strict_below: BTreeMap<String, f64>,
    #[serde(rename = "gamma_T002")]
    pub gamma_t002: BTreeMap<String, f64>,
    pub energy_fraction: Value,
    pub closed_loop: Value,
    #[serde(rename = "fig3_BLSFG_T002")]
    pub figure_3: BTreeMap<String, BTreeMap<String, f64>>,
    pub prbs: Value,
}

pub fn golden() -> Golden {
    serde_json::from_str(include_str!("../golden/excitation.json")).unwrap()
}

pub fn close(found: f64, expected: f64, tolerance: f64) {
    assert!((found / expected - 1.0).abs() <= tolerance, "{found} where {expected} is expected");
}

pub fn made(spec: Value) -> Sequence {
    let spec: SequenceSpec = serde_json::from_value(spec).unwrap();
    spec.check().unwrap().sample(&Ctl::new()).unwrap()
}

pub fn prts(sample_time_s: f64) -> Sequence {
    made(json!({"generator": {"kind": "prts", "order": 5, "chip_s": 0.2}, "sample_time_s": sample_time_s}))
}

pub fn spectrum(sequence: &Sequence) -> Spectrum {
    let period = sequence.one_period().unwrap();
    Spectrum::new(period, period.len(), sequence.sample_time_s, &Ctl::new()).unwrap()
}

pub fn gamma(sequence: &Sequence, to_hz: f64) -> f64 {
    band_flatness(&spectrum(sequence), sequence.harmonics.as_ref().unwrap(), Some(Band::UpTo(to_hz))).unwrap().sfm
}

pub fn run(kind: &str, inputs: Value, spec: Value) -> Result<Report, Problem> {
    let request = Request { kind: kind.to_owned(), inputs, spec };
    // What a report says about its spec leads to the same plan.
    let canonical = Plan::parse(&request)?.request();
    assert_eq!(Plan::parse(&canonical).unwrap().request(), canonical);
    match contract().run(&request, &Library::default(), &Ctl::new()) {
        Ok(report) => Ok(report),
        Err(Failure::Problem(problem)) => Err(problem),
        Err(Failure::Stopped(stopped) | Failure::Interrupted { stopped, .. }) => panic!("{stopped}"),
    }
}

pub fn design(band: f64) -> Design {
    let sequence = prts(0.001);
    let spectrum = spectrum(&sequence);
    let lines = sequence.harmonics.clone().unwrap();
    let inside = Band::UpTo(band).of(&lines, spectrum.spacing_hz()).unwrap();
    let omegas: Vec<f64> = inside.iter().map(|n| spectrum.omega_rad_s(*n)).collect();
    let powers: Vec<f64> = inside.iter().map(|n| spectrum.power[*n]).collect();
    let plant = SampledPlant::mass_damper(10.0, 50.0, Discrete::new(0.001).unwrap()).unwrap();
    Design::new(plant, &omegas, &powers, [&sequence.values[..], &sequence.values[..]].concat())
}

pub const DRIVE: fn() -> Value = || json!({"mass_kg": 10, "damping_ns_per_m": 50});
pub const SIGNAL: fn() -> Value =
    || json!({"generator": {"kind": "prts", "order": 5, "chip_s": 0.2}, "sample_time_s": 0.001});
