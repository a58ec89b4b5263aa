//! How far the intervals of `lqg_fit` hold, on simulated persons, and how long it takes beside the package `lqg`.
//!
//! `cargo bench --bench lqg_fit`; `-- --sets N` for N sets a row instead of 500, `-- ROW` for one row. `y_and_u`,
//! `y_and_u_20`, `told_y_and_u`, `told_y`, `y`, `y_driven` are the reference's example with five parameters, two trials
//! of 30 s (60 s of `told_y`), fitted in full from five starts. `grown` and `grown_1` are the same plant under motor
//! noise of 3 and 1 times the control, y apart, 16 s, `delay` y and u with the senses delayed by 60 ms. `reach_50` and
//! `reach_500` are reaches of .5 s over two distances. `peer` fits the trials of the package `lqg`, with CPU times.
#![allow(missing_docs, unreachable_pub, clippy::unwrap_used, clippy::print_stdout, dead_code)]

#[path = "../tests/support/lqg_people.rs"]
mod lqg_people;

use lqg_people::{binary, example, example_truth, follower, matrix, reach, reach_truth, reaches, simulate, term};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use rustix::time::{ClockId, clock_gettime};
use serde_json::Value;
use std::time::Instant;
use volition::control::Discrete;
use volition::ctl::Ctl;
use volition::likelihood::lqg::{self, Design, Record, Refusal, Role};
use volition::num::rng::{self, Stream};

/// The 95 % quantile of the normal distribution.
const NORMAL: f64 = 1.959_963_984_540_054;

/// What is simulated.
#[derive(Clone, Copy)]
enum Person {
    /// The example: told, perceived measurement noise over the true one, control recorded, size of d, samples a trial.
    Loop(bool, f64, bool, f64, usize),
    /// The example under noise of so many times the control.
    Grown(f64),
    /// The example with senses delayed by so many samples.
    Delayed(usize),
    /// So many reaches over each of two distances.
    Reach(usize),
}

struct Row {
    name: &'static str,
    person: Person,
    names: &'static [&'static str],
    /// Whether intervals are asked for.
    is_profiled: bool,
}

const LOOP: [&str; 5] = ["q1", "q2", "wp", "w", "v"];
const GROWN: [&str; 6] = ["q1", "q2", "wp", "w", "v", "c"];
const REACH: [&str; 5] = ["r", "velocity", "force", "c", "senses"];

const fn row(name: &'static str, person: Person, names: &'static [&'static str], is_profiled: bool) -> Row {
    Row { name, person, names, is_profiled }
}

const ROWS: [Row; 11] = [
    row("y_and_u", Person::Loop(false, 1.0, true, 0.5, 1500), &LOOP, true),
    row("y_and_u_20", Person::Loop(false, 20.0, true, 0.5, 1500), &LOOP, true),
    row("told_y_and_u", Person::Loop(true, 5.0, true, 0.5, 1500), &LOOP, true),
    row("told_y", Person::Loop(true, 1.0, false, 0.5, 3000), &LOOP, true),
    row("y", Person::Loop(false, 5.0, false, 0.5, 1500), &LOOP, true),
    row("y_driven", Person::Loop(false, 5.0, false, 5.0, 1500), &LOOP, true),
    row("delay", Person::Delayed(3), &LOOP, true),
    row("grown", Person::Grown(3.0), &GROWN, false),
    row("grown_1", Person::Grown(1.0), &GROWN, false),
    row("reach_50", Person::Reach(25), &REACH, true),
    row("reach_500", Person::Reach(250), &REACH, true),
];

/// Design, truth and records of a set.
fn simulated(person: Person, stream: &mut Stream) -> (Design, Vec<f64>, Vec<Record>) {
    let trials = |design: &Design, truth: &[f64], size: f64, samples: usize, count: usize, stream: &mut Stream| {
        let one = |_| {
            let d = binary(samples, size, stream);
            simulate(design, truth, &d, stream)
        };
        (0..count).map(one).collect::<Vec<_>>()
    };
    match person {
        Person::Loop(is_told, factor, has_control, size, samples) => {
            let design = example(is_told, has_control.then_some(4e-4));
            let truth = example_truth(factor);
            let records = trials(&design, &truth, size, samples, 2, stream);
            (design, truth, records)
        }
        Person::Delayed(samples) => {
            let design = example(false, Some(4e-4)).delayed(samples);
            let truth = example_truth(1.0);
            let records = trials(&design, &truth, 0.5, 1500, 2, stream);
            (design, truth, records)
        }
        Person::Grown(c) => {
            let mut design = example(false, None);
            design.recorded.instrument = Some(matrix(1, 1, &[1e-6]));
            design.terms.push(term("c", Role::ControlDependentNoise, matrix(1, 1, &[1.0])));
            let mut truth = example_truth(1.0);
            truth.push(c.ln());
            let records = trials(&design, &truth, 0.5, 800, 1, stream);
            (design, truth, records)
        }
        Person::Reach(each) => {
            let design = reach(50);
            let truth = reach_truth(50);
            let records = reaches(&design, &truth, &[0.1, 0.2], each, stream);
            (design, truth, records)
        }
    }
}

/// What a set came to, parameter by parameter.
struct Outcome {
    difference: Vec<f64>,
    error: Vec<Option<f64>>,
    /// Whether the profile interval holds the truth; `None` where it is not closed.
    profile: Vec<Option<bool>>,
    refusal: Vec<Option<Refusal>>,
    ratio: f64,
    arrived: usize,
    explanations: usize,
    is_observed: bool,
    cpu_s: f64,
}

/// CPU time of this thread.
fn cpu() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

fn outcome(row: &Row, seed: u64) -> Outcome {
    let begin = cpu();
    let ctl = Ctl::new();
    let mut stream = rng::stream(seed, row.name);
    let (design, truth, records) = simulated(row.person, &mut stream);
    let problem = lqg::Problem::new(&design, &records).unwrap();
    let gains = lqg::free_gains(&design, &records, Discrete::new(0.02).unwrap(), seed, &ctl).unwrap();
    let gains = gains.as_ref().map(|[k, l]| [k, l]);
    let fit = lqg::fit(&problem, gains, 5, seed, &ctl).unwrap();
    let there = problem.evaluate(&truth, false, &ctl).unwrap().unwrap().log_likelihood;
    let mut found = Outcome {
        difference: Vec::new(),
        error: vec![None; truth.len()],
        profile: vec![None; truth.len()],
        refusal: vec![None; truth.len()],
        ratio: 0.0,
        arrived: fit.arrived(fit.best.evaluation.log_likelihood),
        explanations: 1,
        is_observed: true,
        cpu_s: 0.0,
    };
    let mut best = fit.best.clone();
    if row.is_profiled {
        let hills = lqg::hills(&problem, &fit.best, &fit.bounds, &ctl).unwrap();
        let (better, known) = lqg::inference(&problem, best, &fit.bounds, 0.95, &ctl).unwrap();
        found.explanations = lqg::explanations(&problem, &fit, &hills, &better, &known, &ctl).unwrap().len();
        found.profile = (0..truth.len())
            .map(|i| match known.intervals[i] {
                [Some(low), Some(high)] => Some((low..=high).contains(&truth[i])),
                _ => None,
            })
            .collect();
        found.error = known.standard_errors;
        found.refusal = known.refusals;
        found.is_observed = known.is_observed;
        found.arrived = fit.arrived(better.evaluation.log_likelihood);
        best = better;
    }
    found.difference = best.theta.iter().zip(&truth).map(|(x, y)| x - y).collect();
    found.ratio = 2.0 * (best.evaluation.log_likelihood - there);
    found.cpu_s = cpu() - begin;
    found
}

fn share(flags: impl Iterator<Item = bool>) -> String {
    let all: Vec<bool> = flags.collect();
    if all.is_empty() {
        return "–".to_owned();
    }
    let held = all.iter().filter(|f| **f).count();
    format!("{:.3} of {}", held as f64 / all.len() as f64, all.len())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn coverage(row: &Row, sets: usize) {
    let begin = Instant::now();
    let all: Vec<Outcome> = (0..sets as u64).into_par_iter().map(|seed| outcome(row, seed)).collect();
    let cpu_s = all.iter().map(|o| o.cpu_s).sum::<f64>() / sets as f64;
    println!("{}: {sets} sets, {:.1} s, {cpu_s:.2} CPU-s a fit", row.name, begin.elapsed().as_secs_f64());
    for (i, name) in row.names.iter().enumerate() {
        let mean = all.iter().map(|o| o.difference[i]).sum::<f64>() / sets as f64;
        let sd = (all.iter().map(|o| (o.difference[i] - mean).powi(2)).sum::<f64>() / (sets as f64 - 1.0)).sqrt();
        println!("  {name}: bias {mean:+.3} ± {:.3}, sd {sd:.3}", sd / (sets as f64).sqrt());
        if !row.is_profiled {
            continue;
        }
        let errors: Vec<f64> = all.iter().filter_map(|o| o.error[i]).collect();
        let wald = all.iter().filter_map(|o| Some(o.difference[i].abs() <= NORMAL * o.error[i]?));
        let given = |o: &&Outcome| o.refusal[i].is_none();
        let of_given = all.iter().filter(given).filter_map(|o| o.profile[i]);
        println!(
            "    median se {:.3}; Wald holds {}, profile {}, of those given a number {}; refused {}",
            median(errors),
            share(wald),
            share(all.iter().filter_map(|o| o.profile[i])),
            share(of_given),
            all.iter().filter(|o| o.refusal[i].is_some()).count()
        );
    }
    println!(
        "  ratio mean {:.2} of {}; all starts arrived {}, one alone {}; more explanations {}; not observed {}",
        all.iter().map(|o| o.ratio).sum::<f64>() / sets as f64,
        row.names.len(),
        share(all.iter().map(|o| o.arrived == 5)),
        all.iter().filter(|o| o.arrived == 1).count(),
        all.iter().filter(|o| o.explanations > 1).count(),
        all.iter().filter(|o| !o.is_observed).count()
    );
}

/// CPU time of the whole process.
fn process_cpu() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

/// Fits of the package's own trials, from five starts without a guess.
fn peer() {
    for text in [include_str!("../tests/golden/lqg_bounded.json"), include_str!("../tests/golden/lqg_subjective.json")]
    {
        let golden: Value = serde_json::from_str(text).unwrap();
        let design = follower(300, golden["model"] == "SubjectiveActor");
        let states = design.internal().a.nrows();
        let one = |trial: &Value| {
            let rows = trial.as_array().unwrap();
            let x = DMatrix::from_fn(rows.len(), 2, |k, j| rows[k][j].as_f64().unwrap());
            let first = x.row(0).transpose();
            let mut belief = DVector::zeros(states);
            belief.rows_mut(0, 2).copy_from(&first);
            Record { disturbance: DMatrix::zeros(x.nrows(), 1), initial: Some([first, belief]), measured: x }
        };
        let records: Vec<Record> = golden["x"].as_array().unwrap().iter().map(one).collect();
        let problem = lqg::Problem::new(&design, &records).unwrap();
        let begin = process_cpu();
        let fit = lqg::fit(&problem, None, 5, 1, &Ctl::new()).unwrap();
        let spent = process_cpu() - begin;
        let other = &golden["peer"];
        let times = ["cpu_seconds_first", "cpu_seconds_again"].map(|name| other[name].as_f64().unwrap());
        println!(
            "{}: log likelihood {:.4}, the peer's {:.4}; {} of 5 starts arrived; {spent:.2} CPU-s, the peer's {:.1} \
             (first call, {:.0} times) and {:.1} (warm, {:.1} times)",
            golden["model"].as_str().unwrap(),
            fit.best.evaluation.log_likelihood,
            other["log_likelihood"].as_f64().unwrap(),
            fit.arrived(fit.best.evaluation.log_likelihood),
            times[0],
            times[0] / spent,
            times[1],
            times[1] / spent
        );
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let sets = arguments.iter().position(|a| a == "--sets").map_or(500, |at| arguments[at + 1].parse().unwrap());
    let is_named = |name: &str| arguments.iter().any(|a| a == name);
    let all = !is_named("peer") && !ROWS.iter().any(|row| is_named(row.name));
    if all || is_named("peer") {
        peer();
    }
    for row in ROWS.iter().filter(|row| all || is_named(row.name)) {
        coverage(row, sets);
    }
}
