//! How fast the multivariable search is: Zhang 2015, example 4.2, and larger relatives of it.
//!
//! `cargo bench --bench mimo`; wall time, best and median of repeated runs, with the machine's own number of threads.
#![allow(unreachable_pub, clippy::unwrap_used, clippy::print_stdout)]

use nalgebra::DMatrix;
use num_complex::Complex64;
use serde_json::json;
use std::f64::consts::PI;
use std::time::Instant;
use volition::control::{MultivariableModel, MultivariableSystem};
use volition::ctl::Ctl;
use volition::identify::mimo::{FeedbackPool, MatrixFrequencyData, Plant, Settings, identify};
use volition::identify::ssid::Weights;

fn main() {
    let smoke = std::env::args().any(|argument| argument == "--smoke");
    let runs = if smoke { 1 } else { 15 };
    run("example 4.2, FIR of order 1", 0.1, 1, runs);
    run("the same with order 4", 0.1, 4, runs);
    if !smoke {
        run("axes twice as dense, order 1", 0.05, 1, 3);
    }
}

/// Example 4.2 on axes from −0.5 to 1.5 with this step.
fn run(name: &str, step: f64, order: usize, runs: usize) {
    let model: MultivariableModel = serde_json::from_value(json!({
        "numerator": [[[1.0], [0.0]], [[0.0], [-1.0]]],
        "denominator": [[[1.0, 0.1], [0.0]], [[0.0], [1.0, -0.2]]],
        "sample_time_s": 1.0,
    }))
    .unwrap();
    let MultivariableSystem::Discrete(system) = model.check().unwrap() else { panic!("{model:?}") };
    let plant = Plant { system, measured: vec![0, 1], fed_back: vec![0, 1] };
    let real = |rows: [f64; 4]| DMatrix::from_row_slice(2, 2, &rows).map(|v| Complex64::new(v, 0.0));
    let omega_rad_s: Vec<f64> = (1..=20).map(|k| 0.02 * PI * f64::from(k)).collect();
    let h = omega_rad_s
        .iter()
        .map(|w| {
            let z = Complex64::from_polar(1.0, *w);
            let (g, fb) = (plant.system.eval(z).unwrap(), real([0.3, 1.0, 0.2, 0.4]));
            let ff = real([1.0, 1.0, 0.5, 0.0]) + real([-0.3, 0.4, 0.0, 1.0]) / z;
            &g * (DMatrix::identity(2, 2) + &fb * &g).try_inverse().unwrap() * (fb + ff)
        })
        .collect();
    let data = MatrixFrequencyData { omega_rad_s, h, variance: None };
    let axis = json!([{"from": -0.5, "to": 1.5, "step": step}]);
    let axes = serde_json::from_value(json!([[axis, axis], [axis, axis]])).unwrap();
    let pool = FeedbackPool::new(&axes, None, 0.0, "pool").unwrap();
    let settings = Settings { pool, feedforward_order: order, weights: Weights::Uniform, max_candidates: u64::MAX };
    let mut times = Vec::new();
    let mut found = None;
    for _ in 0..runs {
        let start = Instant::now();
        found = Some(identify(&plant, &data, &settings, &Ctl::new()).unwrap());
        times.push(start.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    let found = found.unwrap();
    assert_eq!(found.optimum.coefficients.concat(), [0.3, 1.0, 0.2, 0.4]);
    println!(
        "{name:<30} {:>9} of {:>9} stable: best {:>7.1} ms, median {:>7.1} ms ({:.1} million stable candidates a \
         second)",
        found.optimum.pool_size,
        found.listed,
        1e3 * times[0],
        1e3 * times[times.len() / 2],
        found.optimum.pool_size as f64 / times[times.len() / 2] / 1e6
    );
}
