//! The whole pool of appendix B, all 160 billion candidates, for the trials of the reference.

use num_complex::Complex64;
use serde_json::Value;
use std::f64::consts::TAU;
use volition::control::System;
use volition::ctl::Ctl;
use volition::identify::pool::{Degrees, PoolSpec};
use volition::identify::problem::{Lines, Problem};
use volition::identify::search::{Clusters, Search, SensitivitySearch};
use volition::plants::catalogue;

#[test]
fn the_best_candidate_of_all_is_the_one_that_an_independent_search_found() {
    let golden: Value = serde_json::from_str(include_str!("../golden/ssid_examples.json")).unwrap();
    let spec: PoolSpec = serde_json::from_value("zhang2015_appendix_b".into()).unwrap();
    let ctl = Ctl::new();
    let plant = System::Continuous(catalogue::two_mass());
    let pool = spec.check(Degrees::default()).unwrap().build(&plant, &ctl).unwrap();
    let omega: Vec<f64> = (0..13).map(|k| TAU * (0.1 + 0.025 * f64::from(k))).collect();
    let mut clusters = None;
    for case in golden["ch3_cases"].as_array().unwrap() {
        let number = |name: &str| case[name].as_f64().unwrap();
        let pair = |x: &Value| Complex64::new(x[0].as_f64().unwrap(), x[1].as_f64().unwrap());
        let h: Vec<Complex64> = case["H"].as_array().unwrap().iter().map(pair).collect();
        let problem = Problem::new(&Lines::new(&plant, &omega, &h, None), 4).unwrap();
        let clusters = clusters.get_or_insert_with(|| Clusters::new(&problem, &pool, &ctl).unwrap().unwrap());
        ctl.begin_search();
        let found = SensitivitySearch { clusters }.search(&problem, &pool, &ctl).unwrap();

        let expected = number("J");
        let near = (found.cost - expected).abs() <= 1e-6 * expected || (found.cost < 1e-28 && expected < 1e-28);
        assert!(near, "{}: {} and not {expected}", case["case"], found.cost);
        let best = pool.candidate(pool.position(found.index));
        let zero = best.feedback_numerator.iter().map(|c| c * best.feedback_gain).collect::<Vec<_>>();
        let identified = [
            (best.feedforward_denominator[1], number("ff_a1")),
            (best.feedforward_denominator[2], number("ff_a0")),
            (best.feedback_denominator[1], number("fb_a1")),
            (best.feedback_denominator[2], number("fb_a0")),
            (zero[0], number("k")),
        ];
        for (ours, theirs) in identified {
            assert!((ours - theirs).abs() < 1e-9 * theirs.abs().max(1.0), "{}: {identified:?}", case["case"]);
        }
        // What was told on the way brackets the answer, up to rounding.
        let told = ctl.bracket().unwrap();
        assert!(told.bound <= found.cost + 1e-9 && found.cost <= told.incumbent + 1e-9, "{told:?} {found:?}");
    }
}
