//! Refinement from pool optima against an independent implementation.

use num_complex::Complex64;
use serde_json::Value;
use std::f64::consts::PI;
use volition::control::System;
use volition::ctl::Ctl;
use volition::identify::identifiability::Structure;
use volition::identify::problem::{Lines, Problem};
use volition::identify::refine::{ActiveConstraint, Refinement, Setup, Start};

#[test]
fn the_refined_costs_of_chapter_3_are_reached_or_passed() {
    let golden: Value = serde_json::from_str(include_str!("../golden/ssid_refined.json")).unwrap();
    let plant = System::Continuous(volition::plants::catalogue::two_mass());
    let omega: Vec<f64> = (0..13).map(|k| 2.0 * PI * (0.1 + 0.025 * f64::from(k))).collect();
    let structure = Structure {
        feedforward_numerator: 4,
        feedforward_denominator_is_free: true,
        feedforward_denominator: 2,
        feedback_numerator: 1,
        feedback_denominator: 2,
        held: None,
    };
    for case in golden["cases"].as_array().unwrap() {
        let what = case["case"].as_str().unwrap();
        let number = |name: &str| case[name].as_f64().unwrap();
        let h: Vec<Complex64> = case["H"]
            .as_array()
            .unwrap()
            .iter()
            .map(|h| Complex64::new(h[0].as_f64().unwrap(), h[1].as_f64().unwrap()))
            .collect();
        let problem = Problem::new(&Lines::new(&plant, &omega, &h, None), 4).unwrap();
        let start = Start {
            feedforward_denominator: vec![1.0, number("ff_a1"), number("ff_a0")],
            feedback_numerator: vec![number("k"), -number("k") * number("z")],
            feedback_denominator: vec![1.0, number("fb_a1"), number("fb_a0")],
        };
        let setup = Setup { problem: &problem, plant: &plant, structure, margin_per_s: 0.1 };
        let refined = Refinement::new(setup, &start, &Ctl::new()).unwrap().refined().unwrap();
        eprintln!(
            "{what}: pool {:.6e}, refined {:.6e} (reference {:.6e}), {:?}, cosine {:.1e}, {} steps, {} evaluations, \
             active {:?}",
            number("J"),
            refined.cost,
            number("J_refined"),
            refined.stop,
            refined.gradient_cosine,
            refined.iterations,
            refined.evaluations,
            refined.active,
        );
        assert!(refined.cost <= number("J_refined") * (1.0 + 1e-4) || refined.cost < 1e-24, "{what}: {refined:?}");
        assert!(refined.cost <= number("J") * (1.0 + 1e-9) || refined.cost < 1e-28, "{what}");
        assert!(refined.slowest_exponent.unwrap() < -0.1 + 1e-9, "{what}: {refined:?}");
        // The reference's own answer has its feedforward pair on the margin: 2 ζω = 0.2.
        assert_eq!(refined.active.contains(&ActiveConstraint::FeedforwardMargin), what == "early-5%", "{what}");
        assert!(refined.stop.is_converged() || what == "early-0%", "{what}: {refined:?}");
    }
}
