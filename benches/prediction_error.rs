//! How far the intervals and tests of prediction error hold, on virtual people outside its model class.
//!
//! `cargo bench --bench prediction_error`; `-- --few` for a tenth of it, `-- TABLE` for one table: `inside`, `outside`,
//! `joint`, `many`, `change`, `remnants`, `tests`, `time`.
#![allow(missing_docs, unreachable_pub, clippy::unwrap_used, clippy::print_stdout, dead_code)]

#[path = "../tests/support/virtual_people.rs"]
mod virtual_people;

use num_complex::Complex64;
use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use std::time::Instant;
use virtual_people::{Group, Person, Remnant};
use volition::control::System;
use volition::ctl::Ctl;
use volition::num::rng;
use volition::prediction_error::change::change_of_feedback;
use volition::prediction_error::controllers::{Norm, NormEstimate, Region};
use volition::prediction_error::estimate::{Estimate, Settings, estimate};
use volition::prediction_error::feedforward::slow_zeros;
use volition::prediction_error::hypotheses::{no_feedback, no_feedforward, unchanged_feedback};
use volition::prediction_error::lags::{Lags, Sharing};
use volition::prediction_error::loops::sampled_plant;
use volition::prediction_error::record::Record;

const DT: f64 = 0.02;
const NORMS: [Norm; 2] = [Norm::FeedforwardPlantMinusOne, Norm::Feedback];

fn settings(group: Group) -> Settings {
    let lags = Lags { autoregressive: 2, moving_average: 0, feedback: [4, 17], ahead: 10, behind: 25, terms: 8 };
    let sharing = Sharing { noise: true, feedback: true, feedforward: false };
    Settings { lags, sharing, zeros: slow_zeros(&System::Continuous(group.system()), DT) }
}

fn record(person: &Person, trial: f64, remnant: Remnant, seed: u64) -> Record {
    let trial = person.trial(trial, remnant, seed);
    Record::new(&trial, (DT / person.group.sample_time_s()).round() as usize)
}

fn plant_of(group: Group) -> impl Fn(f64) -> Complex64 {
    let plant = sampled_plant(&System::Continuous(group.system()), group.sample_time_s()).unwrap();
    move |omega| plant.response(omega)
}

fn norms(found: &Estimate, i: usize, group: Group) -> [NormEstimate; 2] {
    let plant = plant_of(group);
    NORMS.map(|norm| found.norm(i, norm, &plant, group.band_rad_s()).unwrap())
}

fn holds(interval: [f64; 2], truth: f64) -> bool {
    interval[0] <= truth && truth <= interval[1]
}

/// One trial's outcome.
#[derive(Clone, Copy)]
struct Outcome {
    white: bool,
    inside: [bool; 2],
    error: [f64; 2],
    width: [f64; 2],
    regions: [f64; 2],
    /// The person's number, for rms errors of a person.
    person: u64,
}

fn region_holds(region: &Region, value: Complex64, truth: Complex64) -> bool {
    let z = (truth - value) * Complex64::from_polar(1.0, -region.angle_rad);
    (z.re / region.half_axes[0]).powi(2) + (z.im / region.half_axes[1]).powi(2) <= 1.0
}

fn outcome(
    found: &Estimate,
    i: usize,
    group: Group,
    truth: [f64; 2],
    laws: &dyn Fn(f64) -> [Complex64; 2],
    white: bool,
    person: u64,
) -> Outcome {
    let norms = norms(found, i, group);
    let [from, to] = group.band_rad_s();
    let mut regions = [0.0; 2];
    for k in 0..30 {
        let omega = from + (to - from) * f64::from(k) / 29.0;
        let both = found.controllers(i, omega);
        for (count, (response, truth)) in
            regions.iter_mut().zip([&both.feedforward, &both.feedback].into_iter().zip(laws(omega)))
        {
            *count += f64::from(u8::from(region_holds(&found.region(i, response), response.value, truth))) / 30.0;
        }
    }
    Outcome {
        white,
        inside: [0, 1].map(|k| holds(norms[k].interval(), truth[k])),
        error: [norms[0].value - truth[0], norms[1].value / truth[1] - 1.0],
        width: [3.92 * norms[0].standard_error, 3.92 * norms[1].standard_error / norms[1].value],
        regions,
        person,
    }
}

fn percent(flags: impl Iterator<Item = bool>) -> String {
    let all: Vec<bool> = flags.collect();
    format!("{:.0} % of {}", 100.0 * all.iter().filter(|f| **f).count() as f64 / all.len().max(1) as f64, all.len())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn print(name: &str, all: &[Outcome]) {
    let mean = |f: &dyn Fn(&Outcome) -> f64| all.iter().map(f).sum::<f64>() / all.len() as f64;
    println!(
        "{name}: distance {} / {} where white, feedback {} / {} where white; white {}; rms error {:.4}, feedback \
         median |error| {:.2}; median width {:.3}, {:.2}; regions {:.0} / {:.0} %",
        percent(all.iter().map(|o| o.inside[0])),
        percent(all.iter().filter(|o| o.white).map(|o| o.inside[0])),
        percent(all.iter().map(|o| o.inside[1])),
        percent(all.iter().filter(|o| o.white).map(|o| o.inside[1])),
        percent(all.iter().map(|o| o.white)),
        mean(&|o| o.error[0] * o.error[0]).sqrt(),
        median(all.iter().map(|o| o.error[1].abs()).collect()),
        median(all.iter().map(|o| o.width[0]).collect()),
        median(all.iter().map(|o| o.width[1]).collect()),
        100.0 * mean(&|o| o.regions[0]),
        100.0 * mean(&|o| o.regions[1]),
    );
}

/// Trials of `people` people of both groups, jointly or one by one.
fn outside(people: u64, numbers: &[f64], joint: bool, remnant: Remnant, fixed: bool, first_seed: u64) -> Vec<Outcome> {
    let each = |seed: u64| -> Vec<Outcome> {
        let group = if seed.is_multiple_of(2) { Group::Gm } else { Group::Gn };
        let mut person = Person::draw(group, seed);
        if fixed {
            person.gain_at_start = 0.0;
        }
        let records: Vec<Record> =
            numbers.iter().enumerate().map(|(k, n)| record(&person, *n, remnant, 1000 * seed + k as u64)).collect();
        let settings = settings(group);
        let sets: Vec<&[Record]> = if joint { vec![&records] } else { records.chunks(1).collect() };
        let mut all = Vec::new();
        for (s, set) in sets.iter().enumerate() {
            let found = estimate(set, &settings, &Ctl::new()).unwrap();
            let tests = found.residual_tests(set, &Ctl::new()).unwrap();
            for (i, test) in tests.whiteness.iter().enumerate() {
                let number = numbers[if joint { i } else { s }];
                let laws = |omega: f64| {
                    let [_, ff, fb] = person.laws(number, omega);
                    [ff, fb]
                };
                all.push(outcome(&found, i, group, person.norms(number), &laws, test.is_white(), seed));
            }
        }
        all
    };
    (first_seed..first_seed + people).into_par_iter().flat_map_iter(each).collect()
}

/// People who are the form itself: estimates of virtual people, simulated anew.
fn inside(people: u64, times: u64) -> Vec<Outcome> {
    let each = |seed: u64| -> Vec<Outcome> {
        let group = if seed.is_multiple_of(2) { Group::Gm } else { Group::Gn };
        let (person, settings) = (Person::draw(group, seed), settings(group));
        let original = record(&person, 10.0, Remnant::Ar1, seed);
        let truth = estimate(std::slice::from_ref(&original), &settings, &Ctl::new()).unwrap();
        let plant = sampled_plant(&System::Continuous(group.system()), DT).unwrap();
        let law = truth.law(0);
        let values = norms(&truth, 0, group).map(|n| n.value);
        let laws = |omega: f64| {
            let c = truth.controllers(0, omega);
            [c.feedforward.value, c.feedback.value]
        };
        (0..times)
            .filter_map(|k| {
                let mut stream = rng::stream(1000 * seed + k, "inside");
                let w: Vec<f64> = (0..original.samples())
                    .map(|_| truth.records[0].variance.sqrt() * stream.sample::<f64, _>(StandardNormal))
                    .collect();
                let [control, output] = law.simulate(&original, &plant, Some(&w))?;
                let error = original.command.iter().zip(&output).map(|(r, y)| r - y).collect();
                let again = [Record { control, output, error, ..original.clone() }];
                let found = estimate(&again, &settings, &Ctl::new()).unwrap();
                let white = found.residual_tests(&again, &Ctl::new()).unwrap().whiteness[0].is_white();
                Some(outcome(&found, 0, group, values, &laws, white, seed))
            })
            .collect()
    };
    (0..people).into_par_iter().flat_map_iter(each).collect()
}

fn change(people: u64) {
    for group in [Group::Msd2, Group::Gm, Group::Gn] {
        let found: Vec<(bool, bool, f64)> = (0..people)
            .into_par_iter()
            .map(|seed| {
                let (person, settings) = (Person::draw(group, 500 + seed), settings(group));
                let block = |from: u64| -> Vec<Record> {
                    (from..from + 6).map(|n| record(&person, n as f64, Remnant::Ar1, 1000 * seed + n)).collect()
                };
                let truth = |from: u64| (from..from + 6).map(|n| person.norms(n as f64)[1]).sum::<f64>() / 6.0;
                let (a, b) = (block(1), block(35));
                let found = change_of_feedback(&a, &b, &settings, group.band_rad_s(), &Ctl::new()).unwrap().unwrap();
                let [low, high] = found.interval;
                let white = [(&a, &found.estimates[0]), (&b, &found.estimates[1])]
                    .iter()
                    .all(|(records, e)| e.residual_tests(records, &Ctl::new()).unwrap().all_white.is_white());
                (holds(found.interval, truth(35) - truth(1)), white, (high - low) / truth(1))
            })
            .collect();
        println!(
            "change of the feedback, {group:?}: {}, {} where white; median width over the norm {:.2}",
            percent(found.iter().map(|f| f.0)),
            percent(found.iter().filter(|f| f.1).map(|f| f.0)),
            median(found.iter().map(|f| f.2).collect())
        );
    }
}

fn tests(people: u64) {
    let rejected = |make: &(dyn Fn(u64) -> bool + Sync)| -> String {
        let all: Vec<bool> = (0..people).into_par_iter().map(make).collect();
        percent(all.into_iter())
    };
    for group in [Group::Gm, Group::Gn] {
        let settings = settings(group);
        let one = |seed: u64, feedback: f64, feedforward: f64| {
            let person =
                Person { feedback_share: feedback, feedforward_share: feedforward, ..Person::draw(group, 2000 + seed) };
            [record(&person, 10.0, Remnant::Ar1, 7000 + seed)]
        };
        let feedback = |share: f64| {
            rejected(&|seed| no_feedback(&one(seed, share, 1.0), &settings, &Ctl::new()).unwrap().p_value < 0.05)
        };
        println!("{group:?}, no feedback: size {}, power {}", feedback(0.0), feedback(1.0));
        let feedforward = |share: f64| {
            rejected(&|seed| no_feedforward(&one(seed, 1.0, share), &settings, &Ctl::new()).unwrap().is_needed())
        };
        println!("{group:?}, no feedforward: size {}, power {}", feedforward(0.0), feedforward(1.0));
        let unchanged = |factor: f64, trials: u64| {
            rejected(&|seed| {
                let before = Person { gain_at_start: 0.0, ..Person::draw(group, 3000 + seed) };
                let after = Person { feedback_share: factor, ..before.clone() };
                let half = trials / 2;
                let records: Vec<Record> = (0..trials)
                    .map(|k| {
                        let person = if k < half { &before } else { &after };
                        record(person, (k + 1) as f64, Remnant::Ar1, 100 * seed + k)
                    })
                    .collect();
                let blocks: Vec<usize> = (0..trials).map(|k| usize::from(k >= half)).collect();
                unchanged_feedback(&records, &blocks, &settings, &Ctl::new()).unwrap().p_value < 0.05
            })
        };
        println!(
            "{group:?}, unchanged feedback, six trials: size {}, power against 10 and 30 %: {}, {}",
            unchanged(1.0, 6),
            unchanged(0.9, 6),
            unchanged(0.7, 6)
        );
    }
}

fn time() {
    let person = Person::draw(Group::Gm, 1);
    let records: Vec<Record> = (1..=40).map(|n| record(&person, f64::from(n), Remnant::Ar1, n as u64)).collect();
    let settings = settings(Group::Gm);
    let start = Instant::now();
    let found = estimate(&records, &settings, &Ctl::new()).unwrap();
    println!("40 trials jointly: {:.2} s for the estimate", start.elapsed().as_secs_f64());
    let start = Instant::now();
    let all: Vec<_> = (0..40).map(|i| norms(&found, i, Group::Gm)).collect();
    println!("  {:.2} s for {} norms", start.elapsed().as_secs_f64(), 2 * all.len());
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let few = arguments.iter().any(|a| a == "--few" || a == "--smoke");
    let wanted: Vec<&String> = arguments.iter().filter(|a| !a.starts_with("--")).collect();
    let is_wanted = |name: &str| wanted.is_empty() || wanted.iter().any(|w| *w == name);
    let of = |count: u64| if few { count.div_ceil(10) } else { count };
    let six = [1.0, 5.0, 10.0, 20.0, 30.0, 40.0];
    if is_wanted("time") {
        time();
    }
    if is_wanted("inside") {
        print("inside, one trial", &inside(of(50), 10));
    }
    if is_wanted("outside") {
        print("outside, one trial", &outside(of(50), &six, false, Remnant::Ar1, false, 0));
    }
    if is_wanted("joint") {
        print("outside, six trials jointly, feedback fixed", &outside(of(60), &six, true, Remnant::Ar1, true, 100));
        print("outside, six trials jointly, feedback falling", &outside(of(60), &six, true, Remnant::Ar1, false, 100));
    }
    if is_wanted("many") {
        let all: Vec<f64> = (1..=40).map(f64::from).collect();
        print("outside, 40 trials jointly, feedback fixed", &outside(of(20), &all, true, Remnant::Ar1, true, 200));
        print("outside, 40 trials jointly, feedback falling", &outside(of(20), &all, true, Remnant::Ar1, false, 200));
    }
    if is_wanted("change") {
        change(of(40));
    }
    if is_wanted("remnants") {
        for remnant in [Remnant::SignalDependent, Remnant::Ar2, Remnant::White, Remnant::Ar1White, Remnant::Drift] {
            let all = outside(of(50), &six[2..4], false, remnant, false, 300);
            print(&format!("outside, one trial, {remnant:?}"), &all);
            let failed = all.iter().filter(|o| o.inside.contains(&false));
            println!("  warned of {} whose interval fails", percent(failed.map(|o| !o.white)));
        }
    }
    if is_wanted("tests") {
        tests(of(200));
    }
}
