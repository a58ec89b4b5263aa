//! Five analyses that take long enough for their progress to be looked at.

use serde_json::{Value, json};
use volition::analysis::Request;

fn request(kind: &str, inputs: Value, spec: Value) -> Request {
    Request { kind: kind.to_owned(), inputs, spec }
}

/// The requests.
pub fn requests() -> Vec<Request> {
    let omega: Vec<f64> = (1..=20).map(|line| 0.628_319 * f64::from(line)).collect();
    let response: Vec<[f64; 2]> = omega.iter().map(|w: &f64| [(0.1 * w).cos(), -(0.1 * w).sin()]).collect();
    vec![
        request(
            "ssid",
            json!({"plant": {"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0], "sample_time_s": null},
                   "frequency_response": {"omega_rad_s": omega, "h": response}}),
            json!({"pool": {"name": "zhang2015_appendix_b"}, "refine": false}),
        ),
        request(
            "compensator_design",
            json!({"plant": {"mass_kg": 10, "damping_ns_per_m": 50},
                   "signal": {"generator": {"kind": "prts", "order": 6, "chip_s": 0.2}, "sample_time_s": 0.001}}),
            json!({"structure": "lead", "band_hz": 10}),
        ),
        request(
            "robust_input_design",
            json!({"axis": "axial_rotation"}),
            json!({"draws": 48, "max_iterations": 25, "rounds": 2}),
        ),
        request(
            "input_design",
            json!({"model": {"name": "seated_balance"},
                   "starts": [{"generator": {"kind": "prbs", "order": 6, "chip_s": 0.5}, "sample_time_s": 0.05,
                               "duration_s": 30}]}),
            json!({"samples": 600, "sample_time_s": 0.05, "limits": {"input": 2.0}, "scale_to_fit": true}),
        ),
        request(
            "ssid_mimo",
            json!({"plant": {"numerator": [[[1], [0]], [[0], [-1]]], "denominator": [[[1, 0.1], [0]], [[0], [1, -0.2]]],
                             "sample_time_s": 1},
                   "frequency_response": {"omega_rad_s": [0.063, 0.126],
                        "h": [[[[1.44, -0.122], [3.075, -0.357]], [[-1.02, 0.099], [-1.923, 0.281]]],
                              [[[1.417, -0.242], [2.987, -0.702]], [[-1.0, 0.196], [-1.85, 0.553]]]]}}),
            json!({"pool": {"matrix_grid": {"feedback_numerator": [
                      [[{"from": -0.5, "to": 1.5, "step": 0.02}], [{"from": -0.5, "to": 1.5, "step": 0.02}]],
                      [[{"from": -0.5, "to": 1.5, "step": 0.02}], [{"from": -0.5, "to": 1.5, "step": 0.02}]]]}},
                   "feedforward_order": 1}),
        ),
    ]
}
