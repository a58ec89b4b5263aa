//! A request of every kind near the largest size that it takes.

use serde_json::{Value, json};
use volition::analysis::Request;

fn request(kind: &str, inputs: Value, spec: Value) -> Request {
    Request { kind: kind.to_owned(), inputs, spec }
}

/// Numbers from −1 to 1 without a pattern.
fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

/// `rows` × `columns` numbers from −1 to 1.
fn matrix(rows: usize, columns: usize, seed: u64) -> Vec<Vec<f64>> {
    noise(rows * columns, seed).chunks(columns).map(<[f64]>::to_vec).collect()
}

/// A tracking trial in which y follows r through 2/(s + 2) and u is what is left of r.
fn trial(samples: usize, sample_time_s: f64) -> Value {
    let r: Vec<f64> = noise(samples.div_ceil(50), 1).into_iter().flat_map(|value| [value; 50]).take(samples).collect();
    let (mut y, mut state) = (Vec::with_capacity(samples), 0.0);
    for command in &r {
        y.push(state);
        state += 2.0 * sample_time_s * (command - state);
    }
    let u: Vec<f64> = r.iter().zip(&y).map(|(r, y)| r - y).collect();
    json!({"sample_time_s": sample_time_s, "r": r, "u": u, "y": y})
}

/// The same with noise, so that neither signal foretells the other.
fn noisy_trial(samples: usize, sample_time_s: f64) -> Value {
    let mut recording = trial(samples, sample_time_s);
    for (signal, seed) in [("u", 18), ("y", 40)] {
        for (value, v) in recording[signal].as_array_mut().unwrap().iter_mut().zip(noise(samples, seed)) {
            *value = json!(value.as_f64().unwrap() + 0.5 * v);
        }
    }
    recording
}

/// The requests.
pub fn requests() -> Vec<Request> {
    let plant = json!({"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0], "sample_time_s": null});
    let frequencies: Vec<f64> = (1..=10_000).map(|line| 0.004 * f64::from(line)).collect();
    let omega: Vec<f64> = (1..=20).map(|line| 0.628_319 * f64::from(line)).collect();
    let loop_response: Vec<[f64; 2]> = omega.iter().map(|w: &f64| [(0.1 * w).cos(), -(0.1 * w).sin()]).collect();
    let n = 64;
    let square = |size: usize, seed| -> Vec<Vec<f64>> {
        let mut a = matrix(size, size, seed);
        for (i, row) in a.iter_mut().enumerate() {
            row.iter_mut().for_each(|entry| *entry /= size as f64);
            row[i] -= 2.0;
        }
        a
    };
    let gain = |rows, columns, seed| -> Vec<Vec<f64>> {
        let mut gain = matrix(rows, columns, seed);
        gain.iter_mut().flatten().for_each(|entry| *entry *= 0.1);
        gain
    };
    let grid = json!([{"from": -8, "to": 8, "step": 0.01}]);
    vec![
        request(
            "frequency_response",
            json!({"trial": trial(1_500_000, 0.01)}),
            json!({"segments": {"count": 2}, "lines": {"frequency_hz": frequencies}, "window": "hann"}),
        ),
        request(
            "ssid",
            json!({"plant": plant, "frequency_response": {"omega_rad_s": omega, "h": loop_response}}),
            json!({"pool": {"name": "zhang2015_appendix_b"}}),
        ),
        request(
            "ssid",
            json!({"trial": trial(1_500_000, 0.01), "plant": plant}),
            json!({"pool": {"name": "zhang2015_appendix_c"}}),
        ),
        request(
            "ssid_mimo",
            json!({"plant": {"numerator": [[[1], [0]], [[0], [-1]]], "denominator": [[[1, 0.1], [0]], [[0], [1, -0.2]]],
                             "sample_time_s": 1},
                   "frequency_response": {"omega_rad_s": [0.063, 0.126],
                        "h": [[[[1.44, -0.122], [3.075, -0.357]], [[-1.02, 0.099], [-1.923, 0.281]]],
                              [[[1.417, -0.242], [2.987, -0.702]], [[-1.0, 0.196], [-1.85, 0.553]]]]}}),
            json!({"pool": {"matrix_grid": {"feedback_numerator": [
                      [[{"from": -0.5, "to": 1.5, "step": 0.014}], [{"from": -0.5, "to": 1.5, "step": 0.014}]],
                      [[{"from": -0.5, "to": 1.5, "step": 0.014}], [{"from": -0.5, "to": 1.5, "step": 0.014}]]]}},
                   "feedforward_order": 1}),
        ),
        request(
            "two_stimulus",
            json!({"plant": {"num": [1], "den": [1, 0], "sample_time_s": null},
                   "frequency_response": {"omega_rad_s": omega, "h_yr": loop_response, "h_yd": loop_response}}),
            json!({"starts": 200, "pool": {"grid": {"feedforward_denominator": grid, "feedback_numerator": grid,
                       "feedback_denominator": [{"from": 0, "to": 8, "step": 0.4}]}},
                   "feedforward_numerator_degree": 1}),
        ),
        request("prediction_error", json!({"plant": plant, "trial": noisy_trial(400_000, 0.01)}), json!({})),
        request(
            "simulate",
            json!({"plant": "minimum_phase", "feedforward": {"num": [25, 90, 100], "den": [1, 52.2, 110]},
                   "feedback": {"num": [1], "den": [0.1, 1], "delay_s": 0.15},
                   "command": {"samples": noise(100_000, 17), "sample_time_s": 0.01},
                   "noise": {"remnant": {"sd": 0.1, "time_constant_s": 0.2}}}),
            json!({"realisations": 120, "points": 2_000}),
        ),
        request(
            "gain_fit",
            json!({"plant": {"a": square(60, 5), "b": matrix(60, 1, 6), "c": matrix(2, 60, 7)},
                   "trials": [{"sample_time_s": 0.01, "input": noise(20_000, 8), "output": matrix(20_000, 2, 9)},
                              {"sample_time_s": 0.01, "input": noise(20_000, 10), "output": matrix(20_000, 2, 11)}]}),
            json!({"draws": 10_000, "climbs": 100}),
        ),
        request(
            "lqg_fit",
            json!({"plant": {"a": square(16, 12), "b": matrix(16, 1, 13), "c": matrix(2, 16, 14)},
                   "trial": {"sample_time_s": 0.01, "output": matrix(15_000, 2, 15), "control": noise(15_000, 16)}}),
            json!({"control_variance": [[1.0]]}),
        ),
        request(
            "inverse_lqr",
            json!({"a": square(n, 1), "b": matrix(n, 8, 2), "k": gain(8, n, 3), "sample_time_s": null}),
            json!({}),
        ),
        request(
            "inverse_lqe",
            json!({"a": square(n, 1), "c": matrix(8, n, 2), "l": gain(n, 8, 3), "sample_time_s": null}),
            json!({"state_weight": "diagonal"}),
        ),
        request(
            "inverse_lqg",
            json!({"a": square(n, 1), "b": matrix(n, 4, 2), "c": matrix(4, n, 4), "k": gain(4, n, 3),
                   "l": gain(n, 4, 5), "sample_time_s": null}),
            json!({}),
        ),
        request(
            "excitation_quality",
            json!({"signal": {"samples": noise(2_000_000, 3), "sample_time_s": 0.001},
                   "plant": {"mass_kg": 10, "damping_ns_per_m": 50},
                   "controller": {"num": [2500], "den": [1], "sample_time_s": null}}),
            json!({"band_hz": (1..=100).map(|band| json!(band)).collect::<Vec<_>>()}),
        ),
        request(
            "compensator_design",
            json!({"plant": {"mass_kg": 10, "damping_ns_per_m": 50},
                   "signal": {"generator": {"kind": "prts", "order": 8, "chip_s": 0.2}, "sample_time_s": 0.001}}),
            json!({"structure": "lead", "band_hz": 20, "sweep": {"count": 2_000}}),
        ),
        request(
            "input_design",
            json!({"model": {"name": "seated_balance"}, "starts": [noise(2_000, 4)]}),
            json!({"samples": 2_000, "sample_time_s": 0.05, "limits": {"input": 2.0}, "max_steps": 2_000,
                   "scale_to_fit": true}),
        ),
        request(
            "robust_input_design",
            json!({"axis": "axial_rotation"}),
            json!({"draws": 500, "fresh_draws": 2_000, "max_iterations": 200, "rounds": 20}),
        ),
    ]
}
