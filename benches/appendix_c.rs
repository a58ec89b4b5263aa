//! Appendix C of Zhang 2015 in full: how long counting, trees and exact search take, and what the search finds.
//!
//! `cargo bench --bench appendix_c` searches the first and the last trial of every subject of
//! `tests/data/virtual_subjects`; `-- --all` every trial of theirs, `-- --smoke` a thinned pool and simulated subjects,
//! for CI. Wall time with the machine's own number of threads. It asserts only that the answers are exact; what
//! they say about the subjects it prints.
#![allow(unreachable_pub, clippy::unwrap_used, clippy::print_stdout)]

use flate2::read::GzDecoder;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;
use volition::analysis::{Library, Plan, Request};
use volition::control::{Model, System, TransferFunction};
use volition::ctl::Ctl;
use volition::identify::pool::{Degrees, PoolSpec};
use volition::identify::search::{Automatic, Method, Search};
use volition::identify::ssid::plant_for;
use volition::learning::frequency_domain::controller_metrics;
use volition::simulate::SimulatedStudy;
use volition::trial::{csv, write};
use volition::worker::PoolMemo;

/// A trial as a request carries it.
struct Case {
    group: &'static str,
    name: String,
    trial: u64,
    recorded: Value,
}

fn main() {
    let has = |flag: &str| std::env::args().any(|argument| argument == flag);
    let (smoke, all) = (has("--smoke"), has("--all"));
    let thin = if smoke { json!({"poles": 6, "zeros": 6, "damping": 2, "gains": 2}) } else { json!({}) };
    let pool = json!({"name": "zhang2015_appendix_c", "thin": thin});
    let cases = if smoke { simulated() } else { recorded(all) };
    // Section 5.6.2: the feedforward can approximate the inverse of its plant.
    for (group, numerator, order) in [("minimum phase", [2.0, 4.4], 2), ("nonminimum phase", [-2.0, 4.4], 6)] {
        run(group, numerator, order, &pool, &cases);
    }
}

fn run(group: &str, numerator: [f64; 2], order: usize, pool: &Value, cases: &[Case]) {
    let denominator = [1.0, 3.6, 4.0];
    let library = Library { pools: Arc::new(PoolMemo::default()), ..Library::default() };
    let spec: PoolSpec = serde_json::from_value(pool.clone()).unwrap();
    let degrees =
        Degrees { feedforward_numerator: Some(order), feedforward_denominator: Some(order), ..Degrees::default() };
    let recipe = spec.check(degrees).unwrap();
    let continuous = TransferFunction::new(&numerator, &denominator, volition::control::Continuous).unwrap();
    let plant = plant_for(&recipe, &System::Continuous(continuous), Some(0.02)).unwrap();
    let begin = Instant::now();
    let automatic = Automatic { method: Method::BranchAndBound, pools: &*library.pools };
    let counted = automatic.pool(&recipe, &plant, &Ctl::new()).unwrap();
    println!("{group}: {} candidates, counted in {:.1} s", counted.size(), begin.elapsed().as_secs_f64());
    let identify = |case: &Case, refine: bool| {
        let request = Request {
            kind: "ssid".to_owned(),
            inputs: json!({"trial": case.recorded, "plant": {"num": numerator, "den": denominator}}),
            spec: json!({
                "pool": pool, "refine": refine,
                "feedforward_numerator_degree": order, "feedforward_denominator_degree": order
            }),
        };
        let begin = Instant::now();
        let report = Plan::parse(&request).unwrap().run(&library, &Ctl::new()).unwrap();
        (report.result, begin.elapsed().as_secs_f64())
    };
    let cases: Vec<&Case> = cases.iter().filter(|case| case.group == group).collect();
    let (_, first) = identify(cases[0], false);
    let (_, again) = identify(cases[0], false);
    println!("  trees in {:.1} s{}", first - again, memory());
    println!(
        "  {:<18} {:>7} {:>12} {:>7} {:>12} {:>8} {:>14}",
        "", "s", "J", "near", "‖Gff G − 1‖", "‖Gfb‖", "refined"
    );
    let mut times = Vec::new();
    let mut last: BTreeMap<u64, Vec<[f64; 2]>> = BTreeMap::new();
    for case in cases {
        let (_, seconds) = identify(case, false);
        let (result, _) = identify(case, true);
        times.push(seconds);
        let number = |pointer: &str| result.pointer(pointer).and_then(Value::as_f64);
        assert_eq!(result["certificate"]["pool_size"].as_u64().unwrap(), counted.size());
        assert_eq!(result["certificate"]["method"], "branch_and_bound");
        let distance = number("/metrics/norm_feedforward_plant_minus_one").unwrap();
        let refined = refined_distance(&plant, &result["refined"]);
        println!(
            "  {:<18} {seconds:>7.1} {:>12.4e} {:>7} {distance:>12.3} {:>8.3} {:>14}",
            format!("{} trial {}", case.name, case.trial),
            number("/cost").unwrap(),
            result["near_optimal"]["count"],
            number("/metrics/norm_feedback").unwrap_or(f64::NAN),
            refined.map_or("none".to_owned(), |d| format!("{d:.3}")),
        );
        last.entry(case.trial).or_default().push([distance, refined.unwrap_or(f64::NAN)]);
    }
    for (trial, distances) in last {
        let mean = |i: usize| distances.iter().map(|d| d[i]).sum::<f64>() / distances.len() as f64;
        println!("  mean of trial {trial}: {:.3}, refined {:.3}", mean(0), mean(1));
    }
    times.sort_by(f64::total_cmp);
    println!("  per trial: median {:.1} s, worst {:.1} s", times[times.len() / 2], times[times.len() - 1]);
}

/// The distance of the refined feedforward, where there is one.
fn refined_distance(plant: &System, refined: &Value) -> Option<f64> {
    let system = |part: &str| serde_json::from_value::<Model>(refined[part].clone()).ok()?.check().ok();
    let metrics =
        controller_metrics(plant, &system("feedforward")?, &system("feedback")?, (0.0, std::f64::consts::PI)).ok()?;
    metrics.norm_feedforward_plant_minus_one
}

/// The virtual subjects.
fn recorded(all: bool) -> Vec<Case> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/virtual_subjects"));
    let truth: Vec<Value> = serde_json::from_reader(File::open(folder.join("truth.json")).unwrap()).unwrap();
    let mut cases = Vec::new();
    for entry in truth {
        let trial = entry["trial"].as_u64().unwrap();
        let group = match entry["group"].as_str().unwrap() {
            "gm" => "minimum phase",
            "gn" => "nonminimum phase",
            _ => continue,
        };
        if all || trial == 1 || trial == 40 {
            let file = GzDecoder::new(File::open(folder.join(entry["file"].as_str().unwrap())).unwrap());
            let recorded = write::json_value(&csv::read(file, &csv::Options::default()).unwrap().trial);
            cases.push(Case { group, name: entry["subject"].as_str().unwrap().to_owned(), trial, recorded });
        }
    }
    cases
}

/// First trials of two simulated subjects, one of either group.
fn simulated() -> Vec<Case> {
    println!("simulated subjects");
    let study = SimulatedStudy::two_groups(1, 40, 7).unwrap();
    let mut cases = Vec::new();
    for (group, of) in ["minimum phase", "nonminimum phase"].into_iter().zip(&study.groups) {
        let recorded = write::json_value(&study.trial(&of.members[0], 1).unwrap());
        cases.push(Case { group, name: "simulated".to_owned(), trial: 1, recorded });
    }
    cases
}

/// The largest amount of memory that the process has held, where the system says.
fn memory() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("").trim().to_owned();
    if peak.is_empty() { peak } else { format!(", at most {peak} held") }
}
