//! The worked examples of Zhang 2015, against answers computed independently of this project.

use num_complex::Complex64;
use serde_json::{Value, json};
use std::f64::consts::PI;
use volition::control::{Continuous, Discrete, System, TransferFunction};
use volition::ctl::Ctl;
use volition::identify::pool::{Candidate, Degrees, PoolName, PoolSpec};
use volition::identify::problem::{Lines, Problem};
use volition::identify::search::{Exhaustive, exact};
use volition::identify::ssid::{Identified, Settings, Weights, identify};
use volition::response::FrequencyData;

fn golden() -> Value {
    serde_json::from_str(include_str!("../golden/ssid_examples.json")).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn responses(value: &Value) -> Vec<Complex64> {
    value.as_array().unwrap().iter().map(numbers).map(|v| Complex64::new(v[0], v[1])).collect()
}

fn continuous(num: &[f64], den: &[f64]) -> System {
    System::Continuous(TransferFunction::new(num, den, Continuous).unwrap())
}

fn sampled(num: &[f64], den: &[f64]) -> System {
    // Angles are frequencies at a sample time of one.
    System::Discrete(TransferFunction::new(num, den, Discrete::new(1.0).unwrap()).unwrap())
}

fn closed_loop(plant: &System, ff: &System, fb: &System, omega: &[f64]) -> Vec<Complex64> {
    let at = |w: &f64| {
        let (g, ff, fb) = (plant.response(*w), ff.response(*w), fb.response(*w));
        g * (ff + fb) / (1.0 + g * fb)
    };
    omega.iter().map(at).collect()
}

fn identified(plant: &System, omega: &[f64], h: Vec<Complex64>, pool: Value, degrees: Degrees) -> Identified {
    let pool: PoolSpec = serde_json::from_value(pool).unwrap();
    let settings = Settings {
        recipe: pool.check(degrees).unwrap(),
        weights: Weights::Uniform,
        sample_time_s: None,
        max_candidates: u64::MAX,
    };
    let data = FrequencyData { omega_rad_s: omega.to_vec(), h, variance: None };
    identify(plant, &data, &settings, &Exhaustive, &Ctl::new()).unwrap()
}

#[track_caller]
fn assert_close(found: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}: {found:?} and {expected:?}");
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() <= tolerance * b.abs().max(1.0), "{what}: {found:?} and {expected:?}");
    }
}

#[track_caller]
fn assert_cost(found: f64, expected: f64, what: &str) {
    if expected < 1e-28 {
        assert!(found < 1e-28, "{what}: cost {found:e}, expected zero");
    } else {
        assert!((found / expected - 1.0).abs() < 1e-6, "{what}: cost {found:e}, expected {expected:e}");
    }
}

/// The plant, lines and true closed loop of section 2.6.
fn section_2_6() -> (System, Vec<f64>, Vec<Complex64>) {
    let plant = continuous(&[4.0], &[1.0, 2.0]);
    let omega: Vec<f64> = (1..=20).map(|k| 0.2 * PI * f64::from(k)).collect();
    let h = closed_loop(&plant, &continuous(&[2.1, 3.0], &[1.0, 6.5]), &continuous(&[5.4], &[1.0, 7.1]), &omega);
    (plant, omega, h)
}

/// φ in the order of the thesis.
fn phi(found: &Identified) -> Vec<f64> {
    vec![
        found.feedforward.den().coefficients()[1],
        found.feedback.num().coefficients()[0],
        found.feedback.den().coefficients()[1],
    ]
}

fn cube(axis: &Value, margin: f64) -> Value {
    json!({"grid": {"feedforward_denominator": [axis], "feedback_numerator": [axis], "feedback_denominator": [axis]},
           "stability_margin": margin})
}

#[test]
fn example_2_2_recovers_the_truth_exactly() {
    let expected = &golden()["ex2.2"];
    let (plant, omega, h) = section_2_6();
    let axis = json!({"from": -8, "to": 8, "step": 0.1});
    let found = identified(&plant, &omega, h, cube(&axis, 0.0), Degrees::default());
    assert_eq!(found.pool_size, expected["M"].as_u64().unwrap());
    assert_eq!(phi(&found), numbers(&expected["phi"]));
    assert_close(found.feedforward.num().coefficients(), &numbers(&expected["beta"]), 1e-12, "beta");
    assert_cost(found.optimum.cost, expected["J"].as_f64().unwrap(), "example 2.2");
    assert_eq!(found.optimum.near_optimal, 1);
}

#[test]
fn example_2_3_finds_the_nearest_candidates_on_25_grids() {
    let (plant, omega, h) = section_2_6();
    for expected in golden()["ex2.3"].as_array().unwrap() {
        let j = expected["j"].as_u64().unwrap();
        let axis = json!({"from": -8, "to": 8, "count": 6 + 10 * (j - 1)});
        let found = identified(&plant, &omega, h.clone(), cube(&axis, 0.001), Degrees::default());
        let what = format!("example 2.3, grid {j}");
        assert_eq!(found.pool_size, expected["M"].as_u64().unwrap(), "{what}");
        assert_close(&phi(&found), &numbers(&expected["phi"]), 1e-9, &what);
        assert_close(found.feedforward.num().coefficients(), &numbers(&expected["beta"]), 1e-8, &what);
        assert_cost(found.optimum.cost, expected["J"].as_f64().unwrap(), &what);
    }
}

#[test]
fn example_2_4_finds_the_truth_once_the_noise_is_small() {
    let (plant, omega, _) = section_2_6();
    let axis = json!({"from": -8, "to": 8, "step": 0.1});
    for expected in golden()["ex2.4"].as_array().unwrap() {
        let i = expected["i"].as_u64().unwrap();
        let found = identified(&plant, &omega, responses(&expected["H"]), cube(&axis, 0.0), Degrees::default());
        let what = format!("example 2.4, noise {i}");
        assert_close(&phi(&found), &numbers(&expected["phi"]), 1e-9, &what);
        assert_close(found.feedforward.num().coefficients(), &numbers(&expected["beta"]), 1e-7, &what);
        assert_cost(found.optimum.cost, expected["J"].as_f64().unwrap(), &what);
        assert_eq!(phi(&found) == [6.5, 5.4, 7.1], i >= 14, "{what}");
    }
}

/// ∫ |a − b| dθ over the lines' range, by the midpoint rule.
fn distance(a: &System, b: &System) -> f64 {
    let (top, count) = (0.24 * PI, 100_000);
    let step = top / f64::from(count);
    (0..count).map(|i| (f64::from(i) + 0.5) * step).map(|w| (a.response(w) - b.response(w)).norm() * step).sum()
}

/// The pool as printed (order 0), and with the roles of numerator and denominator exchanged (order 1); FIR feedforward
/// of 17 orders and the IIR feedforward of the true order.
#[test]
fn example_4_5_in_both_readings() {
    let golden = golden();
    let plant = sampled(&[0.4], &[1.0, -0.9]);
    let true_ff = sampled(&[0.2, -0.2 * 0.77], &[1.0, -0.83 - 0.89, 0.83 * 0.89]);
    let true_fb = sampled(&[0.32], &[1.0, -0.81]);
    let omega: Vec<f64> = (0..31).map(|k| 0.008 * PI * f64::from(k)).collect();
    let h = closed_loop(&plant, &true_ff, &true_fb, &omega);
    let narrow = json!({"from": -2, "to": 0, "step": 0.05});
    let wide = json!({"from": -2, "to": 2, "step": 0.05});
    let mut rows: Vec<[f64; 2]> = Vec::new();
    for a in 0..20 {
        for b in a..20 {
            rows.push([-f64::from(a + b) / 20.0, f64::from(a * b) / 400.0]);
        }
    }
    assert_eq!(rows.len(), 210);
    for (order, numerator, denominator) in [(0, &narrow, &wide), (1, &wide, &narrow)] {
        let count = golden[format!("ex4.5_order{order}_count")].as_u64().unwrap();
        for expected in golden[format!("ex4.5_order{order}")].as_array().unwrap() {
            let what = format!("example 4.5, order {order}, {expected}");
            let mut grid = json!({"feedback_numerator": [numerator], "feedback_denominator": [denominator]});
            let (degrees, size) = match expected["nff"].as_u64() {
                Some(n) => (Degrees { feedforward_denominator: Some(n as usize), ..Degrees::default() }, count),
                None => {
                    grid["feedforward_denominator"] = json!({"listed": rows});
                    (Degrees { feedforward_numerator: Some(1), ..Degrees::default() }, 210 * count)
                }
            };
            let found = identified(&plant, &omega, h.clone(), json!({"grid": grid}), degrees);
            assert_eq!(found.pool_size, size, "{what}");
            let feedback = vec![found.feedback.num().coefficients()[0], found.feedback.den().coefficients()[1]];
            assert_close(&feedback, &numbers(&expected["n_d"]), 1e-9, &what);
            // The reference's own costs lose digits at high orders; see the golden file.
            let (exact, printed) = (expected["J_90_digits"].as_f64().unwrap(), expected["J"].as_f64().unwrap());
            assert!((found.optimum.cost / exact - 1.0).abs() < 1e-9, "{what}: cost {}", found.optimum.cost);
            assert!((found.optimum.cost / printed - 1.0).abs() < 1e-5, "{what}: cost {}", found.optimum.cost);
            if expected.get("ff").is_some() {
                assert_close(&found.feedforward.den().coefficients()[1..], &numbers(&expected["ff"]), 1e-9, &what);
                assert_close(found.feedforward.num().coefficients(), &numbers(&expected["beta"]), 1e-7, &what);
            }
            for (system, truth, name) in [(&found.feedback, &true_fb, "Efb"), (&found.feedforward, &true_ff, "Eff")] {
                let wanted = expected[name].as_f64().unwrap();
                let error = distance(system, truth);
                assert!((error / wanted - 1.0).abs() < 1e-4, "{what}: {name} is {error}");
            }
        }
    }
}

/// Single candidates of the full appendix-B pool: they are in it, and cost what the reference says.
#[test]
fn chapter_3_candidates_cost_what_they_should() {
    let golden = golden();
    let plant = System::Continuous(volition::plants::catalogue::two_mass());
    let omega: Vec<f64> = (0..13).map(|k| 2.0 * PI * (0.1 + 0.025 * f64::from(k))).collect();
    let pool = PoolSpec::Name(PoolName::Zhang2015AppendixB).check(Degrees::default()).unwrap();
    let pool = pool.build(&plant, &Ctl::new()).unwrap();
    let same = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-12 * b.abs().max(1.0));
    for case in golden["ch3_cases"].as_array().unwrap() {
        let number = |name: &str| case[name].as_f64().unwrap();
        let candidate = Candidate {
            feedforward_denominator: vec![1.0, number("ff_a1"), number("ff_a0")],
            feedback_numerator: vec![1.0, -number("z")],
            feedback_gain: number("k"),
            feedback_denominator: vec![1.0, number("fb_a1"), number("fb_a0")],
        };
        let what = case["case"].as_str().unwrap();
        let problem = Problem::new(&Lines::new(&plant, &omega, &responses(&case["H"]), None), 4).unwrap();
        let fit = exact::fit(&problem, &candidate);
        assert_cost(fit.cost, number("J"), what);
        assert_close(&fit.feedforward_numerator, &numbers(&case["beta_high_first"]), 1e-8, what);

        assert!(
            pool.feedforward().iter().any(|f| same(&f.coefficients, &candidate.feedforward_denominator)),
            "{what}: feedforward denominator"
        );
        let table = pool.feedback();
        let find = |list: &[volition::identify::pool::factor::Factor], wanted: &[f64]| {
            list.iter().position(|f| same(&f.coefficients, wanted)).unwrap()
        };
        let denominator = find(table.denominators(), &candidate.feedback_denominator);
        let numerator = find(table.numerators(), &candidate.feedback_numerator);
        let gains = table.gains_of(denominator, Some(numerator));
        let gain = candidate.feedback_gain;
        assert!(gains.iter().any(|g| (g / gain - 1.0).abs() < 1e-12), "{what}: gain {gain} among {gains:?}");
    }
}
