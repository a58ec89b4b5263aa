//! How fast inputs are designed.
//!
//! `cargo bench --bench design` asserts the targets of one core: the case of Priess 2015, chapter 5 (300 samples) from
//! the 63-chip sequence to
//! 1.93 times its information in 2 s, and 1,200 samples in 60 s. It prints the times of the longest kinds of excitation
//! as documented, asserts the processor time of a limited lead and of the default robust design, and prints how long
//! the judgement of two million samples takes to stop when told at random moments. `-- --smoke` asserts no times and
//! leaves the long ones out.
#![allow(unreachable_pub, clippy::unwrap_used, clippy::print_stdout)]

use serde_json::{Value, json};
use std::time::{Duration, Instant};
use volition::analysis::{Failure, Library, Plan, Request};
use volition::ctl::{Ctl, StopReason};
use volition::excite::design::{Criterion, Settings, climb};

#[path = "../tests/support/chapter_five.rs"]
#[allow(dead_code, reason = "the tests use all of it")]
mod chapter_five;

fn main() {
    let smoke = std::env::args().any(|argument| argument == "--smoke");
    run(300, 2.0, !smoke);
    if !smoke {
        run(1200, 60.0, true);
        // The lead of older versions of the README: what force and disturbance allow bounds the answer.
        for (amplitude, force, target_s) in [(0.02, 500, Some(4.0)), (0.05, 2000, None)] {
            let limits = json!({"force": force, "disturbance_norm": 0.001});
            let lead = json!({"structure": "lead", "band_hz": 5, "limits": limits});
            let signal = json!({
                "generator": {"kind": "prts", "order": 5, "chip_s": 0.2, "amplitude": amplitude}, "sample_time_s": 0.001
            });
            let drive = json!({"mass_kg": 10, "damping_ns_per_m": 50});
            kind("compensator_design", &json!({"plant": drive, "signal": signal}), &lead, target_s);
        }
        kind("robust_input_design", &json!({"axis": "flexion_extension"}), &json!({}), Some(8.0));
        stops();
    }
}

fn plan(kind: &str, inputs: &Value, spec: &Value) -> Plan {
    Plan::parse(&Request { kind: kind.to_owned(), inputs: inputs.clone(), spec: spec.clone() }).unwrap()
}

/// Processor time of this process since it began, of all its threads; none where it is not told.
#[cfg(unix)]
#[allow(clippy::unnecessary_wraps, clippy::cast_precision_loss)]
fn cpu_s() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9)
}

#[cfg(not(unix))]
fn cpu_s() -> Option<f64> {
    None
}

/// The time of one analysis, on the threads of the pool; its processor time against a target.
fn kind(name: &str, inputs: &Value, spec: &Value, target_s: Option<f64>) {
    let plan = plan(name, inputs, spec);
    let (begin, before) = (Instant::now(), cpu_s());
    let report = plan.run(&Library::default(), &Ctl::new()).unwrap();
    let wall_s = begin.elapsed().as_secs_f64();
    println!("{name}: {wall_s:.2} s on {} threads", rayon::current_num_threads());
    let spent_s = cpu_s().zip(before).map(|(after, before)| after - before);
    if let Some(spent_s) = spent_s {
        println!("  {spent_s:.2} s of processors (target {target_s:?})");
        assert!(target_s.is_none_or(|target_s| spent_s <= target_s), "{spent_s} s");
    }
    for name in ["conclusion", "blsfg"] {
        if !report.result[name].is_null() {
            println!("  {name}: {}", report.result[name]);
        }
    }
}

/// From being told to being over, of the largest record: two million samples, and a prime number of them.
fn stops() {
    let mut worst = Duration::ZERO;
    for samples in [2_000_000_usize, 1_999_993] {
        let values: Vec<f64> = (0..samples).map(|k| ((k * k % 1009) as f64 * 0.37).sin()).collect();
        let inputs = json!({
            "signal": {"samples": values, "sample_time_s": 0.001},
            "plant": {"mass_kg": 10, "damping_ns_per_m": 50}, "controller": {"num": [2500], "den": [1]}
        });
        let plan = plan("excitation_quality", &inputs, &json!({}));
        let begin = Instant::now();
        plan.run(&Library::default(), &Ctl::new()).unwrap();
        let whole = begin.elapsed();
        for part in 0..8 {
            let (ctl, wait) = (Ctl::new(), whole * part / 8);
            let late = std::thread::scope(|scope| {
                let told = scope.spawn(|| {
                    std::thread::sleep(wait);
                    ctl.stop(StopReason::Cancelled);
                    Instant::now()
                });
                let outcome = plan.run(&Library::default(), &ctl);
                let over = Instant::now();
                let told = told.join().unwrap();
                matches!(outcome, Err(Failure::Stopped(_))).then(|| over.saturating_duration_since(told))
            });
            worst = worst.max(late.unwrap_or_default());
        }
        println!("excitation_quality of {samples} samples: {:.2} s", whole.as_secs_f64());
    }
    println!("  stops within {:.3} s (target 0.5 s)", worst.as_secs_f64());
}

fn run(samples: usize, target_s: f64, strict: bool) {
    let begin = Instant::now();
    let case = chapter_five::case(samples);
    let settings =
        Settings { criterion: Criterion::T, radius: 0.5, tolerance: 1e-3, least_radius: 1.0 / 64.0, max_steps: 500 };
    let found = climb(&case.information, &case.limits, &case.start, &settings, &Ctl::new()).unwrap();
    let seconds = begin.elapsed().as_secs_f64();
    println!(
        "N = {samples}: {:.4} times the information in {seconds:.2} s (target {target_s} s); {} steps, {} programs, \
         {} iterations, {:?}",
        found.factor, found.steps, found.programs, found.iterations, found.stop
    );
    let shares = chapter_five::shares(&case, &found.input);
    println!("  shares of the limits (input, angles, bend, torque, autocorrelation): {shares:.4?}");
    assert!(found.factor >= 1.93 && shares.iter().all(|share| *share <= 1.0));
    assert!(!strict || seconds <= target_s, "{seconds} s");
}
