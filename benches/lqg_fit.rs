//! How far the intervals of `lqg_fit` hold, on simulated persons of the reference's example.
//!
//! `cargo bench --bench lqg_fit`; `-- --sets N` for N sets a row instead of 500, `-- ROW` for one row: `y_and_u`,
//! `y_and_u_20`, `told_y_and_u`, `told_y`, `y`, `y_driven`. Each set is two trials of 30 s with five parameters, fitted
//! in full from five starts.
#![allow(missing_docs, unreachable_pub, clippy::unwrap_used, clippy::print_stdout, dead_code)]

#[path = "../tests/support/lqg_people.rs"]
mod lqg_people;

use lqg_people::{binary, example, example_truth, simulate};
use rayon::prelude::*;
use std::time::Instant;
use volition::control::Discrete;
use volition::ctl::Ctl;
use volition::likelihood::lqg::{self, Record, Refusal};
use volition::num::rng;

/// Samples of a trial, and trials of a set.
const SAMPLES: usize = 1500;
const TRIALS: usize = 2;
const NAMES: [&str; 5] = ["q1", "q2", "wp", "w", "v"];
/// The 95 % quantiles of the normal distribution and of χ²₅.
const NORMAL: f64 = 1.959_963_984_540_054;
const CHI_5: f64 = 11.070_497_693_516_35;

struct Row {
    name: &'static str,
    is_told: bool,
    /// Perceived measurement noise over the true one.
    factor: f64,
    has_control: bool,
    size: f64,
}

const ROWS: [Row; 6] = [
    Row { name: "y_and_u", is_told: false, factor: 1.0, has_control: true, size: 0.5 },
    Row { name: "y_and_u_20", is_told: false, factor: 20.0, has_control: true, size: 0.5 },
    Row { name: "told_y_and_u", is_told: true, factor: 5.0, has_control: true, size: 0.5 },
    Row { name: "told_y", is_told: true, factor: 1.0, has_control: false, size: 0.5 },
    Row { name: "y", is_told: false, factor: 5.0, has_control: false, size: 0.5 },
    Row { name: "y_driven", is_told: false, factor: 5.0, has_control: false, size: 5.0 },
];

/// What a set came to, parameter by parameter.
struct Outcome {
    difference: [f64; 5],
    error: [Option<f64>; 5],
    /// Whether the profile interval holds the truth; `None` where it is not closed.
    profile: [Option<bool>; 5],
    refusal: [Option<Refusal>; 5],
    ratio: f64,
    arrived: usize,
    explanations: usize,
    is_observed: bool,
}

fn outcome(row: &Row, seed: u64) -> Outcome {
    let ctl = Ctl::new();
    let design = example(row.is_told, row.has_control.then_some(4e-4));
    let truth = example_truth(row.factor);
    let mut stream = rng::stream(seed, row.name);
    let records: Vec<Record> = (0..TRIALS)
        .map(|_| {
            let d = binary(SAMPLES, row.size, &mut stream);
            simulate(&design, &truth, &d, &mut stream)
        })
        .collect();
    let problem = lqg::Problem::new(&design, &records).unwrap();
    let gains = lqg::free_gains(&design, &records, Discrete::new(0.02).unwrap(), seed, &ctl).unwrap();
    let gains = gains.as_ref().map(|[k, l]| [k, l]);
    let fit = lqg::fit(&problem, gains, 5, seed, &ctl).unwrap();
    let hills = lqg::hills(&problem, &fit.best, &fit.bounds, &ctl).unwrap();
    let (best, known) = lqg::inference(&problem, fit.best.clone(), &fit.bounds, 0.95, &ctl).unwrap();
    let explanations = lqg::explanations(&problem, &fit, &hills, &best, &known, &ctl).unwrap();
    let there = problem.evaluate(&truth, false, &ctl).unwrap().unwrap().log_likelihood;
    let each = [0, 1, 2, 3, 4];
    Outcome {
        difference: each.map(|i| best.theta[i] - truth[i]),
        error: each.map(|i| known.standard_errors[i]),
        profile: each.map(|i| match known.intervals[i] {
            [Some(low), Some(high)] => Some((low..=high).contains(&truth[i])),
            _ => None,
        }),
        refusal: each.map(|i| known.refusals[i]),
        ratio: 2.0 * (best.evaluation.log_likelihood - there),
        arrived: fit.arrived(best.evaluation.log_likelihood),
        explanations: explanations.len(),
        is_observed: known.is_observed,
    }
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

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let sets = arguments.iter().position(|a| a == "--sets").map_or(500, |at| arguments[at + 1].parse().unwrap());
    let named: Vec<&Row> = ROWS.iter().filter(|row| arguments.iter().any(|a| a == row.name)).collect();
    let rows = if named.is_empty() { ROWS.iter().collect() } else { named };
    for row in rows {
        let begin = Instant::now();
        let all: Vec<Outcome> = (0..sets as u64).into_par_iter().map(|seed| outcome(row, seed)).collect();
        println!(
            "{}: told {}, perceived ×{}, {}, d ±{}; {sets} sets, {:.1} s",
            row.name,
            row.is_told,
            row.factor,
            if row.has_control { "y and u" } else { "y" },
            row.size,
            begin.elapsed().as_secs_f64()
        );
        for (i, name) in NAMES.iter().enumerate() {
            let mean = all.iter().map(|o| o.difference[i]).sum::<f64>() / sets as f64;
            let sd = (all.iter().map(|o| (o.difference[i] - mean).powi(2)).sum::<f64>() / (sets as f64 - 1.0)).sqrt();
            let errors: Vec<f64> = all.iter().filter_map(|o| o.error[i]).collect();
            let wald = all.iter().filter_map(|o| Some(o.difference[i].abs() <= NORMAL * o.error[i]?));
            let given = |o: &&Outcome| o.refusal[i].is_none();
            let of_given = all.iter().filter(given).filter_map(|o| o.profile[i]);
            println!(
                "  {name}: bias {mean:+.3}, sd {sd:.3}, median se {:.3}; Wald holds {}, profile {}, of those given a \
                 number {}; refused {}",
                median(errors),
                share(wald),
                share(all.iter().filter_map(|o| o.profile[i])),
                share(of_given),
                all.iter().filter(|o| o.refusal[i].is_some()).count()
            );
        }
        println!(
            "  ratio below {CHI_5:.2}: {}, mean {:.2} of 5; all starts arrived {}, one alone {}; more explanations {}; \
             information not observed {}",
            share(all.iter().map(|o| o.ratio < CHI_5)),
            all.iter().map(|o| o.ratio).sum::<f64>() / sets as f64,
            share(all.iter().map(|o| o.arrived == 5)),
            all.iter().filter(|o| o.arrived == 1).count(),
            all.iter().filter(|o| o.explanations > 1).count(),
            all.iter().filter(|o| !o.is_observed).count()
        );
    }
}
