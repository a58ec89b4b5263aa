//! The seated balance design of Priess 2015, chapter 5, as test and bench use it.

use nalgebra::DMatrix;
use serde_json::Value;
use std::sync::LazyLock;
use volition::control::Discrete;
use volition::control::parametric::{Differentiated, ParametricModel};
use volition::excite::design::limits::autocorrelation;
use volition::excite::design::{Autocorrelation, Information, Limits, OutputLimit, Response, Responses};
use volition::plants::SeatedBalance;
use volition::plants::seated_balance::{Output, Parameter, Structure, Values};

/// The verified numbers.
pub static GOLDEN: LazyLock<Value> =
    LazyLock::new(|| serde_json::from_str(include_str!("../golden/input_design.json")).unwrap());

pub fn numbers(value: &Value) -> Vec<f64> {
    serde_json::from_value(value.clone()).unwrap()
}

/// The model of §5.2 at Table 5.1: the angles of lower and upper body, how far the back is bent, the person's torque.
pub fn plant() -> SeatedBalance {
    let outputs = vec![Output::LowerAngle, Output::UpperAngle, Output::Bend, Output::Torque];
    let structure = Structure { outputs, ..Structure::default() };
    SeatedBalance::new(structure, Values::table_5_1(), Parameter::ALL[..11].to_vec())
        .unwrap()
        .starting_from([0.01, 0.0, 0.0, 0.0])
        .unwrap()
}

pub fn sampled(theta: &[f64]) -> Option<Differentiated<Discrete>> {
    plant().differentiate(theta).ok()?.sampled(Discrete::new(0.1).unwrap()).ok()
}

pub struct Case {
    pub responses: Responses,
    pub information: Information,
    pub limits: Limits,
    pub start: Vec<f64>,
}

/// N samples at 0.1 s from the 63-chip sequence, five samples a chip, repeated.
pub fn case(samples: usize) -> Case {
    let theta = plant().nominal();
    let responses = Responses::new(&sampled(&theta).unwrap(), 0, samples).unwrap();
    let information = Information::new(&responses, &[0, 1], &DMatrix::identity(2, 2), &theta).unwrap();
    let start = prbs(samples);
    let limit = |name: &str, output: usize, most: f64| OutputLimit {
        name: name.to_owned(),
        response: responses.outputs[output].clone(),
        range: [-most, most],
    };
    // Table 5.3.
    let limits = Limits {
        input: [-20.0, 20.0],
        change: None,
        outputs: vec![
            limit("lower angle", 0, 0.192),
            limit("upper angle", 1, 0.078),
            limit("bend", 2, 0.252),
            limit("torque", 3, 60.0),
        ],
        autocorrelation: Some(Autocorrelation {
            reference: autocorrelation(&start, samples / 2 - 1).unwrap(),
            tolerance: 0.16,
            margin: 0.02,
        }),
    };
    Case { responses, information, limits, start }
}

/// The register of the golden file: six digits, taps 6 and 5, from the state 1.
pub fn prbs(samples: usize) -> Vec<f64> {
    let mut state: u32 = 1;
    let chips: Vec<f64> = (0..63)
        .map(|_| {
            let (last, next) = (state >> 5 & 1, (state >> 5 ^ state >> 4) & 1);
            state = (state << 1 & 63) | next;
            if last == 1 { 6.0 } else { -6.0 }
        })
        .collect();
    (0..samples).map(|k| chips[k / 5 % 63]).collect()
}

/// Whether an input keeps to every limit of the chapter, by sums written out here; the largest share of each limit that
/// it uses.
pub fn shares(case: &Case, u: &[f64]) -> [f64; 6] {
    let n = u.len();
    let direct = |response: &Response, most: f64| {
        (0..n)
            .map(|k| response.free[k] + (0..=k).map(|i| response.impulse[k - i] * u[i]).sum::<f64>())
            .fold(0.0, |peak: f64, y| peak.max(y.abs()))
            / most
    };
    let outputs = &case.responses.outputs;
    let correlation =
        |u: &[f64], lag: usize| (lag..n).map(|k| u[k] * u[k - lag]).sum::<f64>() / u.iter().map(|v| v * v).sum::<f64>();
    let deviation =
        (0..n / 2).map(|lag| (correlation(u, lag) - correlation(&case.start, lag)).abs()).fold(0.0, f64::max);
    [
        u.iter().fold(0.0_f64, |peak, u| peak.max(u.abs())) / 20.0,
        direct(&outputs[0], 0.192),
        direct(&outputs[1], 0.078),
        direct(&outputs[2], 0.252),
        direct(&outputs[3], 60.0),
        deviation / 0.16,
    ]
}
