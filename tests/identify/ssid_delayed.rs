//! Pools searched with delays, against a slow search that shares nothing with it.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use rand::RngExt;
use serde_json::json;
use volition::control::{Continuous, Discrete, System, TransferFunction};
use volition::ctl::Ctl;
use volition::identify::delayed::{Pair, search_with_delays};
use volition::identify::pool::{Candidate, Degrees, PoolSpec};
use volition::identify::search::{Automatic, Exhaustive, KeepNothing, Method};
use volition::identify::ssid::{Settings, Weights};
use volition::num::{Polynomial, linalg, rng};
use volition::response::FrequencyData;

fn omega() -> Vec<f64> {
    (1..=14).map(|k| 0.45 * f64::from(k)).collect()
}

fn polynomial(p: &[f64], x: Complex64) -> Complex64 {
    p.iter().fold(Complex64::default(), |sum, c| sum * x + c)
}

fn point(plant: &System, w: f64) -> Complex64 {
    plant.sample_time_s().map_or(Complex64::new(0.0, w), |t| Complex64::from_polar(1.0, w * t))
}

/// J of a candidate with delays, by one dense least-squares problem in powers of the variable.
fn cost(plant: &System, h: &[Complex64], candidate: &Candidate, degree: usize, delays: Pair) -> f64 {
    let lines = h.len();
    let mut a = DMatrix::zeros(2 * lines, degree + 1);
    let mut b = DVector::zeros(2 * lines);
    for (k, w) in omega().iter().enumerate() {
        let x = point(plant, *w);
        let g = plant.response(*w);
        let turn = |delay: f64| Complex64::from_polar(1.0, -w * delay);
        let feedback = candidate.feedback_gain * polynomial(&candidate.feedback_numerator, x)
            / polynomial(&candidate.feedback_denominator, x)
            * turn(delays.feedback_s);
        let sensitivity = 1.0 / (1.0 + g * feedback);
        let target = h[k] - g * feedback * sensitivity;
        (b[k], b[lines + k]) = (target.re, target.im);
        for i in 0..=degree {
            let entry = g * sensitivity * turn(delays.feedforward_s) * x.powu(i as u32)
                / polynomial(&candidate.feedforward_denominator, x);
            (a[(k, i)], a[(lines + k, i)]) = (entry.re, entry.im);
        }
    }
    for mut column in a.column_iter_mut() {
        let norm = column.norm();
        column /= norm;
    }
    linalg::least_squares(&a, &b).unwrap().1
}

/// Roots of `D + N e^{−sτ}` right of `−margin`, by the argument along the line `−margin + jω`, ω from 0 to far: a loop
/// of degree n with all roots on the left turns by nπ/2.
fn roots_right(d: &[f64], n: &[f64], delay: f64, margin: f64) -> i64 {
    let value = |w: f64| {
        let s = Complex64::new(-margin, w);
        polynomial(d, s) + polynomial(n, s) * (-s * delay).exp()
    };
    let (mut turned, mut last) = (0.0, value(0.0));
    for k in 1..=400_000 {
        let now = value(1e-3 * f64::from(k) * (1.0 + 1e-3 * f64::from(k)));
        turned += (now / last).arg();
        last = now;
    }
    let degree = d.len() as f64 - 1.0;
    ((degree * std::f64::consts::FRAC_PI_2 - turned) / std::f64::consts::PI).round() as i64
}

fn multiply(a: &[f64], b: &[f64]) -> Vec<f64> {
    Polynomial::new(a.to_vec()).mul(&Polynomial::new(b.to_vec())).coefficients().to_vec()
}

fn is_stable(plant: &System, candidate: &Candidate, delay_s: f64, margin: f64) -> bool {
    let d = multiply(plant.den().coefficients(), &candidate.feedback_denominator);
    let gain: Vec<f64> = candidate.feedback_numerator.iter().map(|c| candidate.feedback_gain * c).collect();
    let n = multiply(plant.num().coefficients(), &gain);
    match plant.sample_time_s() {
        None => roots_right(&d, &n, delay_s, margin) == 0,
        Some(t) => {
            let delayed = [d, vec![0.0; (delay_s / t).round() as usize]].concat();
            let closed = Polynomial::new(delayed).add(&Polynomial::new(n));
            closed.roots().unwrap().iter().all(|r| r.norm() < (-margin * t).exp())
        }
    }
}

/// A person with delays, and noise.
fn data(plant: &System, [ff, fb]: [&System; 2], delays: Pair, noise: f64, seed: u64) -> FrequencyData {
    let mut random = rng::stream(seed, "delayed person");
    let h: Vec<Complex64> = omega()
        .iter()
        .map(|w| {
            let turn = |delay: f64| Complex64::from_polar(1.0, -w * delay);
            let (g, ff, fb) = (
                plant.response(*w),
                ff.response(*w) * turn(delays.feedforward_s),
                fb.response(*w) * turn(delays.feedback_s),
            );
            let mut draw = || noise * (2.0 * random.random::<f64>() - 1.0);
            g * (ff + fb) / (1.0 + g * fb) + Complex64::new(draw(), draw())
        })
        .collect();
    FrequencyData { omega_rad_s: omega(), h, variance: None }
}

fn settings(pool: serde_json::Value, degree: usize) -> Settings {
    let degrees = Degrees { feedforward_numerator: Some(degree), ..Degrees::default() };
    let recipe = serde_json::from_value::<PoolSpec>(pool).unwrap().check(degrees).unwrap();
    Settings { recipe, weights: Weights::Uniform, sample_time_s: None, max_candidates: u64::MAX }
}

fn pairs(values: &[f64]) -> Vec<Pair> {
    let of = |feedback_s: &f64| {
        values
            .iter()
            .map(|feedforward_s| Pair { feedback_s: *feedback_s, feedforward_s: *feedforward_s })
            .collect::<Vec<_>>()
    };
    values.iter().flat_map(of).collect()
}

#[test]
fn every_pair_of_delays_has_the_optimum_of_a_slow_search() {
    let time = Discrete::new(0.1).unwrap();
    let continuous =
        |num: &[f64], den: &[f64]| System::Continuous(TransferFunction::new(num, den, Continuous).unwrap());
    let sampled = |num: &[f64], den: &[f64]| System::Discrete(TransferFunction::new(num, den, time).unwrap());
    let axis = |from: f64, to: f64, step: f64| json!({"from": from, "to": to, "step": step});
    let cases = [
        (
            continuous(&[2.0], &[1.0, 0.5]),
            [continuous(&[0.9, 0.4], &[1.0, 2.0]), continuous(&[3.0], &[1.0, 1.5])],
            json!({"grid": {"feedforward_denominator": [axis(0.5, 4.0, 0.5)],
                            "feedback_numerator": [axis(0.5, 8.0, 0.5)],
                            "feedback_denominator": [axis(0.5, 4.0, 0.5)]}, "stability_margin": 0.05}),
        ),
        (
            sampled(&[0.15], &[1.0, -0.92]),
            [sampled(&[2.0, -1.0], &[1.0, -0.4]), sampled(&[0.9, 0.0], &[1.0, -0.5])],
            json!({"grid": {"feedforward_denominator": [axis(-0.8, 0.4, 0.2)],
                            "feedback_numerator": [axis(0.3, 3.0, 0.3), [0.0]],
                            "feedback_denominator": [axis(-0.9, 0.3, 0.2)]}, "stability_margin": 0.05}),
        ),
    ];
    let delays = [0.0, 0.1, 0.2, 0.3];
    for (plant, [ff, fb], pool) in &cases {
        let truth = Pair { feedback_s: 0.2, feedforward_s: 0.1 };
        let settings = settings(pool.clone(), 1);
        for (seed, noise) in [(1, 0.0), (2, 0.05), (3, 0.2)] {
            let data = data(plant, [ff, fb], truth, noise, seed);
            let ctl = Ctl::new();
            let found = search_with_delays(plant, &data, &settings, &pairs(&delays), &Exhaustive, &ctl).unwrap();
            let automatic = Automatic { method: Method::default(), pools: &KeepNothing };
            assert_eq!(search_with_delays(plant, &data, &settings, &pairs(&delays), &automatic, &ctl).unwrap(), found);
            let mut at_truth = f64::INFINITY;
            for point in &found {
                // Members: stable with the delay, and in continuous time without it too.
                let own = match plant {
                    System::Continuous(_) => settings.recipe.build(plant, &ctl).unwrap(),
                    System::Discrete(tf) => {
                        let samples = (point.delays.feedback_s / 0.1).round() as usize;
                        let den = [tf.den().coefficients(), &vec![0.0; samples]].concat();
                        settings.recipe.build(&sampled(tf.num().coefficients(), &den), &ctl).unwrap()
                    }
                };
                assert_eq!(own.size(), point.pool_size);
                let mut costs: Vec<(f64, Candidate)> = (0..own.size())
                    .map(|i| own.candidate(own.position(i)))
                    .map(|c| (cost(plant, &data.h, &c, 1, point.delays), c))
                    .collect();
                costs.sort_by(|a, b| a.0.total_cmp(&b.0));
                let first = costs.iter().position(|(_, c)| is_stable(plant, c, point.delays.feedback_s, 0.05)).unwrap();
                let expected = costs[first].0;
                match &point.best {
                    Some(best) => {
                        assert!((best.cost - expected).abs() <= 1e-8 * expected + 1e-20, "{point:?} {expected}");
                        assert_eq!(best.cost, point.lower_bound);
                        let again = cost(plant, &data.h, &own.candidate(own.position(best.index)), 1, point.delays);
                        assert!((again - expected).abs() <= 1e-8 * expected + 1e-20);
                        if point.delays == truth {
                            at_truth = best.cost;
                        }
                    }
                    None => {
                        assert!(point.lower_bound <= expected * (1.0 + 1e-9), "{point:?} {expected}");
                        assert!(point.unstable as usize <= first);
                    }
                }
            }
            // The true delays are told from others by their cost where noise does not hide them.
            if noise == 0.0 {
                let best = found.iter().filter_map(|p| p.best.as_ref()).map(|b| b.cost).fold(f64::INFINITY, f64::min);
                assert_eq!(best, at_truth);
                assert!(at_truth < 1e-20, "{at_truth}");
            }
        }
    }
}

/// A delay that the best loops do not survive: what is best among the stable is said only where it is known.
#[test]
fn what_the_delay_makes_unstable_is_passed_over_or_said() {
    let plant = System::Continuous(TransferFunction::new(&[1.0], &[1.0, 0.0], Continuous).unwrap());
    let gain = |k: f64| System::Continuous(TransferFunction::new(&[k], &[1.0], Continuous).unwrap());
    let none = Pair { feedback_s: 0.0, feedforward_s: 0.0 };
    let data = data(&plant, [&gain(0.5), &gain(12.0)], none, 0.0, 1);
    for (step, from) in [(0.001, 4.9), (4.0, 1.0)] {
        let pool = json!({"grid": {"feedback_numerator": [{"from": from, "to": 13.0, "step": step}]},
            "stability_margin": 0.0});
        let settings = settings(pool, 0);
        let pair = Pair { feedback_s: 0.3, feedforward_s: 0.3 };
        let found = search_with_delays(&plant, &data, &settings, &[pair], &Exhaustive, &Ctl::new()).unwrap().remove(0);
        let own = settings.recipe.build(&plant, &Ctl::new()).unwrap();
        // s + k e^{−sτ} is stable for kτ < π/2.
        let stable = |c: &Candidate| c.feedback_gain * c.feedback_numerator[0] * 0.3 < std::f64::consts::FRAC_PI_2;
        let expected = (0..own.size())
            .map(|i| own.candidate(own.position(i)))
            .filter(stable)
            .map(|c| cost(&plant, &data.h, &c, 0, pair))
            .fold(f64::INFINITY, f64::min);
        assert!(found.lower_bound <= expected * (1.0 + 1e-9), "{found:?} {expected}");
        match &found.best {
            Some(best) => assert!((best.cost - expected).abs() < 1e-9 * expected, "{found:?} {expected}"),
            None => assert!(found.unstable > 0, "{found:?}"),
        }
    }
}
