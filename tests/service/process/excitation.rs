//! Experiments designed from the command line.

use crate::process::harness::volition;
use serde_json::{Value, json};
use std::io::Write as _;
use std::process::{Output, Stdio};

fn run(document: &Value, more: &[&str]) -> Output {
    let mut arguments = vec!["run", "-"];
    arguments.extend(more);
    let mut child =
        volition(&arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(document.to_string().as_bytes()).unwrap();
    child.wait_with_output().unwrap()
}

#[test]
fn every_kind_of_design_runs_without_a_server() {
    let signal = json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.2}, "sample_time_s": 0.01});
    let drive = json!({"mass_kg": 10, "damping_ns_per_m": 50});
    let start =
        json!({"generator": {"kind": "prbs", "order": 4, "chip_s": 0.4}, "sample_time_s": 0.2, "duration_s": 12});
    let documents = [
        (
            json!({"kind": "excitation_quality", "inputs": {"signal": signal},
                   "spec": {"band_hz": [2], "include_samples": true}}),
            Some(("t,signal", 521)),
            json!({"inputs": {"signal": {"generator": {"order": 0}}}}),
            "/inputs/signal/generator/order",
        ),
        (
            json!({"kind": "compensator_design", "inputs": {"plant": drive, "signal": signal},
                "spec": {"structure": "proportional", "band_hz": 2}}),
            None,
            json!({"spec": {"band_hz": 51}}),
            "/spec/band_hz",
        ),
        (
            json!({"kind": "input_design", "inputs": {"model": {"name": "linear_drive"}, "starts": [start]},
                "spec": {"samples": 60, "sample_time_s": 0.2, "limits": {"input": 2}, "max_steps": 5}}),
            Some(("t,signal,start", 61)),
            json!({"spec": {"limits": {"input": 0.5}}}),
            "/inputs/starts",
        ),
        (
            json!({"kind": "robust_input_design", "inputs": {"axis": "axial_rotation"}, "spec": {
                "experiment": {"duration_s": 6, "sample_time_s": 0.06}, "draws": 2, "fresh_draws": 4,
                "max_iterations": 2, "rounds": 1}}),
            Some(("t,signal,nominal", 101)),
            json!({"spec": {"experiment": {"edge_hz": [1, 40]}}}),
            "/spec/experiment/edge_hz",
        ),
    ];
    for (document, table, change, at) in documents {
        let output = run(&document, &[]);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["kind"], document["kind"]);
        let output = run(&document, &["--csv"]);
        match table {
            Some((header, lines)) => {
                let csv = String::from_utf8(output.stdout).unwrap();
                assert_eq!((csv.lines().next(), csv.lines().count()), (Some(header), lines), "{}", document["kind"]);
            }
            None => assert_eq!((output.status.code(), output.stdout.len()), (Some(2), 0), "no samples"),
        }
        let mut wrong = document.clone();
        merge(&mut wrong, &change);
        let output = run(&wrong, &[]);
        assert_eq!((output.status.code(), output.stdout.len()), (Some(2), 0), "{wrong}");
        let problem: Value = serde_json::from_slice(&output.stderr).unwrap();
        assert_eq!(problem["where"], at, "{problem}");
    }
}

/// Members of objects are replaced one by one (RFC 7396).
fn merge(into: &mut Value, change: &Value) {
    match (into.as_object_mut(), change.as_object()) {
        (Some(members), Some(changes)) => {
            for (name, change) in changes {
                merge(members.entry(name.clone()).or_insert(Value::Null), change);
            }
        }
        _ => *into = change.clone(),
    }
}
