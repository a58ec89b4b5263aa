//! What a long recording costs before anything is identified: reading its file, and its frequency response.
//!
//! `cargo bench --bench recordings` asserts the targets in CPU time, for a record of 40,001 samples (the chirp of Zhang
//! 2015, section 3.2): the CSV file of 2.6 MB in 20 ms (as CSV, and as a file that must be recognised), the frequency
//! response with the defaults and with the preset of that section in 25 ms. `-- --smoke` asserts no times.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use rustix::time::{ClockId, clock_gettime};
use serde_json::{Value, json};
use std::fmt::Write as _;
use volition::analysis::{Library, Plan, Request};
use volition::ctl::Ctl;
use volition::exchange;
use volition::simulate::reference_signals::chirp80;
use volition::trial::csv;

/// Runs of which the median is told.
const RUNS: usize = 9;

/// CPU time of this process, in seconds.
fn cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// The median CPU time of a task, against its target.
fn measure(name: &str, target_s: f64, is_strict: bool, mut task: impl FnMut()) {
    let mut times: Vec<f64> = (0..RUNS)
        .map(|_| {
            let begin = cpu_s();
            task();
            cpu_s() - begin
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let median = times[RUNS / 2];
    println!("{name}: {:.1} ms of CPU time (target {:.0})", 1e3 * median, 1e3 * target_s);
    assert!(!is_strict || median <= target_s, "{name}: {median} s");
}

fn main() {
    let is_strict = !std::env::args().any(|argument| argument == "--smoke");
    let command = chirp80(0.002);
    // A person of one lag, and noise that no seed decides.
    let (mut control, mut output) = (Vec::new(), Vec::new());
    let (mut u, mut y) = (0.0_f64, 0.0_f64);
    for (k, r) in command.iter().enumerate() {
        control.push(u);
        output.push(y);
        u += 0.02 * (1.4 * (r - y) - u) + 1e-3 * (k as f64 * k as f64 * 0.37).sin();
        y += 0.002 * u;
    }
    let mut text = String::from("t,r,u,y\n");
    for (k, ((r, u), y)) in command.iter().zip(&control).zip(&output).enumerate() {
        let _ = writeln!(text, "{:.3},{r:.16e},{u},{y}", k as f64 * 0.002);
    }
    println!("{} rows, {:.1} MB", command.len(), text.len() as f64 / 1e6);
    measure("reading the file", 0.020, is_strict, || {
        let found = csv::read(text.as_bytes(), &csv::Options::default()).unwrap();
        assert_eq!(found.trial.signals.output.len(), command.len());
    });
    measure("recognising and reading it", 0.020, is_strict, || {
        let found = exchange::read(text.as_bytes(), &exchange::Options::default()).unwrap();
        assert_eq!(found.trial.signals.output.len(), command.len());
    });
    let trial = json!({"sample_time_s": 0.002, "r": command, "u": control, "y": output});
    for (name, spec) in [("the defaults", json!({})), ("a preset", json!({"lines": "zhang2015_chapter_3"}))] {
        let plan = plan(&trial, &spec);
        measure(&format!("frequency response with {name}"), 0.025, is_strict, || {
            plan.run(&Library::default(), &Ctl::new()).unwrap();
        });
    }
}

fn plan(trial: &Value, spec: &Value) -> Plan {
    let request =
        Request { kind: "frequency_response".to_owned(), inputs: json!({"trial": trial}), spec: spec.clone() };
    Plan::parse(&request).unwrap()
}
