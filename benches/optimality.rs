//! Size and power of the test whether a person is optimal (`"constraint": "optimal"` of `gain_fit`).
//!
//! `cargo bench --bench optimality` simulates 1,000 persons a row, `-- --sets N` as many as wanted: a pendulum that
//! falls in half a second, pushed by ±0.5 held for 0.3 s, its angle recorded for 60 s at 50 Hz with white noise. It
//! prints how often the ratio test speaks against optimality at 5 %, and asserts its size on the boundary of the cone
//! and with fewer weights than gains: 5 % ± 2 from 1,000 persons on.
#![allow(missing_docs, unreachable_pub, clippy::unwrap_used, clippy::print_stdout)]

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use std::time::Instant;
use volition::control::lqg::lqr;
use volition::control::lyapunov::Clock;
use volition::control::{Continuous, Discrete};
use volition::ctl::Ctl;
use volition::likelihood::optimal::{OptimalPerson, ratio_test};
use volition::likelihood::uncertainty::Uncertainty;
use volition::likelihood::{Experiment, LoopModel, Noise, Record, Settings, fit};
use volition::num::rng;
use volition::person::state_feedback::{AffinePlant, Plant, StateFeedback};

const SAMPLES: usize = 3000;
const NOISE: f64 = 3e-3;
const LEVEL: f64 = 0.05;

fn pendulum() -> AffinePlant {
    AffinePlant {
        base: Plant {
            a: DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 4.0, -0.3]),
            b: DMatrix::from_row_slice(2, 1, &[0.0, 1.0]),
            e: DMatrix::from_row_slice(2, 1, &[0.0, 1.0]),
            c: DMatrix::from_row_slice(1, 2, &[1.0, 0.0]),
            d: DMatrix::zeros(1, 1),
            f: DMatrix::zeros(1, 1),
            initial: vec![0.0; 2],
        },
        terms: Vec::new(),
    }
}

/// The regulator of `Q = diag(q)`, R = 1.
fn regulator(plant: &AffinePlant, q: [f64; 2]) -> Vec<f64> {
    let Plant { a, b, .. } = &plant.base;
    let q = DMatrix::from_diagonal(&DVector::from_row_slice(&q));
    lqr(a, b, &q, &DMatrix::identity(1, 1), Clock::Continuous).unwrap().k.iter().copied().collect()
}

struct Row {
    name: &'static str,
    /// The true gain is the regulator of these weights, with its velocity gain cut by the factor.
    q: [f64; 2],
    cut: f64,
    weighed: &'static [usize],
    /// Whether the size is asserted.
    is_size: bool,
}

const ROWS: [Row; 6] = [
    Row { name: "position cost, one weight for two gains", q: [20.0, 0.0], cut: 1.0, weighed: &[0], is_size: true },
    Row { name: "position cost, two weights: the boundary", q: [20.0, 0.0], cut: 1.0, weighed: &[0, 1], is_size: true },
    Row { name: "both costs, two weights: inside", q: [20.0, 5.0], cut: 1.0, weighed: &[0, 1], is_size: false },
    Row { name: "velocity gain cut to 0.97, two weights", q: [20.0, 0.0], cut: 0.97, weighed: &[0, 1], is_size: false },
    Row { name: "velocity gain cut to 0.9, two weights", q: [20.0, 0.0], cut: 0.9, weighed: &[0, 1], is_size: false },
    Row { name: "velocity gain cut to 0.8, two weights", q: [20.0, 0.0], cut: 0.8, weighed: &[0, 1], is_size: false },
];

/// The p-value of one person.
fn person(row: &Row, seed: u64) -> f64 {
    let (plant, time) = (pendulum(), Discrete::new(0.02).unwrap());
    let free = StateFeedback { plant: plant.clone(), time: Continuous, delay: None, lag: None };
    let mut k = regulator(&plant, row.q);
    k[1] *= row.cut;
    let mut stream = rng::stream(seed, row.name);
    let mut push = 0.5;
    let stimulus = DMatrix::from_fn(SAMPLES, 1, |i, _| {
        if i % 15 == 0 {
            push = if stream.random::<bool>() { 0.5 } else { -0.5 };
        }
        push
    });
    let mut target = free.sampled(&k, time, false).unwrap().value.respond(&stimulus).unwrap();
    target.iter_mut().for_each(|y| *y += NOISE * stream.sample::<f64, _>(StandardNormal));
    let records = vec![Record { stimulus, target, initial: Some(DVector::zeros(2)) }];
    let experiment = Experiment::new(&free, time, records, false).unwrap();
    let unbounded = vec![[f64::NEG_INFINITY, f64::INFINITY]; 2];
    let settings = Settings { noise: Noise::Full, bounds: unbounded, start: Some(k), draws: 10, climbs: 3, seed };
    let ctl = Ctl::new();
    let estimate = fit(&experiment, &settings, &ctl).unwrap();
    let known = Uncertainty::new(&experiment, &estimate, &settings.noise, &settings.bounds);
    let start = row.weighed.iter().map(|state| row.q[*state].max(0.1).ln()).collect::<Vec<f64>>();
    let optimal = OptimalPerson {
        free: &free,
        plant: &plant,
        clock: Clock::Continuous,
        weighed: row.weighed.to_vec(),
        names: row.weighed.iter().map(|state| format!("q{state}")).collect(),
        control_weight: DMatrix::identity(1, 1),
        start: start.clone(),
    };
    let own = Settings { bounds: optimal.limits(), start: Some(start), draws: 10, climbs: 4, ..settings };
    let fitted = fit(&experiment.with_model(&optimal), &own, &ctl).unwrap();
    let ratio = fitted.deviance - estimate.deviance;
    assert!(ratio > -1e-3, "{}: the free fit has not arrived ({ratio})", row.name);
    ratio_test(&optimal, &fitted.theta, known.covariance.as_ref().unwrap(), ratio, seed).unwrap().p_value
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let sets = arguments
        .iter()
        .position(|argument| argument == "--sets")
        .map_or(1000, |at| arguments[at + 1].parse().expect("--sets takes a whole number"));
    for row in &ROWS {
        let begin = Instant::now();
        let p: Vec<f64> = (0..sets).into_par_iter().map(|i| person(row, 20_261_201 + i)).collect();
        let refused = p.iter().filter(|p| **p < LEVEL).count() as f64 / p.len() as f64;
        let certain = p.iter().filter(|p| **p >= 1.0).count() as f64 / p.len() as f64;
        println!(
            "{:<42} {sets} persons: below {LEVEL} in {:.1} %, p = 1 in {:.1} %; {:.1} s",
            row.name,
            100.0 * refused,
            100.0 * certain,
            begin.elapsed().as_secs_f64()
        );
        assert!(!(row.is_size && sets >= 1000) || (refused - LEVEL).abs() <= 0.02, "{}: {refused}", row.name);
    }
}
