//! The innovation form: gains and filter from recordings of output and control.
#![allow(non_snake_case)]

use super::gain_fit::{estimated, matrix, normal, plain, settings, time};
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use volition::control::lqg::{kalman, lqr};
use volition::control::lyapunov::Clock;
use volition::likelihood::{Experiment, Innovation, LoopModel, Predicted, Record, residuals};
use volition::num::rng::{self, Stream};
use volition::person::state_feedback::AffinePlant;

fn controlled(samples: usize, stream: &mut Stream) -> (AffinePlant, Vec<f64>, Vec<f64>, [DMatrix<f64>; 3]) {
    let a = matrix(2, 2, &[1.0, 0.1, 0.15, 1.02]);
    let b = matrix(2, 1, &[0.005, 0.1]);
    let c = matrix(1, 2, &[1.0, 0.0]);
    let k = lqr(&a, &b, &matrix(2, 2, &[4.0, 0.0, 0.0, 1.0]), &matrix(1, 1, &[0.3]), Clock::Sampled).unwrap().k;
    let w = matrix(2, 2, &[1e-5, 0.0, 0.0, 4e-4]);
    let v = matrix(1, 1, &[1e-3]);
    let l = kalman(&a, &c, &w, &v, Clock::Sampled).unwrap().l;
    let (mut x, mut estimate) = (DVector::zeros(2), DVector::zeros(2));
    let mut push = DMatrix::zeros(samples, 1);
    let mut y = DMatrix::zeros(samples, 1);
    let mut u = DMatrix::zeros(samples, 1);
    let mut value = 1.0;
    for sample in 0..samples {
        if sample % 7 == 0 {
            value = if stream.random::<bool>() { 0.5 } else { -0.5 };
        }
        push[(sample, 0)] = value;
        let measured = x[0] + 1e-3_f64.sqrt() * normal(stream);
        // The motor adds a little noise of its own, which is what tells K where u is recorded.
        let control = -(&k * &estimate)[(0, 0)];
        y[(sample, 0)] = measured;
        u[(sample, 0)] = control + 0.01 * normal(stream);
        let noise = DVector::from_vec(vec![1e-5_f64.sqrt() * normal(stream), 0.02 * normal(stream)]);
        let innovation = measured - estimate[0];
        x = &a * &x + &b * (control + value) + noise;
        estimate = &a * &estimate + &b * (control + value) + &l * innovation;
    }
    (plain(a, b, c), k.iter().copied().collect(), l.iter().copied().collect(), [push, y, u])
}

fn beside(parts: &[&DMatrix<f64>]) -> DMatrix<f64> {
    let columns: Vec<_> = parts.iter().flat_map(|m| m.column_iter().map(|c| c.into_owned())).collect();
    DMatrix::from_columns(&columns)
}

#[test]
fn gain_and_filter_come_from_the_output_alone() {
    let mut stream = rng::stream(8, "innovation");
    let (plant, k, l, [push, y, _]) = controlled(4000, &mut stream);
    let model = Innovation { plant, continuous: false, predicted: Predicted::Output, is_told: true };
    let record = Record { stimulus: beside(&[&push, &y]), target: y, initial: None };
    let experiment = Experiment::new(&model, time(0.1), vec![record], true).unwrap();
    let (estimate, uncertainty) = estimated(&experiment, &settings(&model));
    let errors = uncertainty.standard_errors().unwrap();
    let truth = [k, l].concat();
    println!("{:?}\n{truth:?}\n{errors:?} condition {:.2e}", estimate.theta, uncertainty.condition);
    for ((found, expected), error) in estimate.theta.iter().zip(&truth).zip(&errors) {
        assert!((found - expected).abs() < 4.0 * error, "{found} {expected} {error}");
    }
    let errors = experiment.errors(&estimate.evaluation.residuals, &estimate.whitening).unwrap();
    let white = residuals::whiteness(&errors, &[&experiment.records()[0].target]);
    assert!(white[0].p_value > 1e-3, "{white:?}");
}

#[test]
fn a_recorded_control_tells_gain_from_filter() {
    let mut stream = rng::stream(9, "innovation with control");
    let (plant, k, l, [push, y, u]) = controlled(4000, &mut stream);
    let truth = [k, l].concat();
    let alone = Innovation { plant: plant.clone(), continuous: false, predicted: Predicted::Output, is_told: true };
    let both = Innovation { plant, continuous: false, predicted: Predicted::OutputAndControl, is_told: true };
    let record = Record { stimulus: beside(&[&push, &y, &u]), target: beside(&[&y, &u]), initial: None };
    let experiment = Experiment::new(&both, time(0.1), vec![record], true).unwrap();
    let (estimate, uncertainty) = estimated(&experiment, &settings(&both));
    let record = Record { stimulus: beside(&[&push, &y]), target: y, initial: None };
    let experiment = Experiment::new(&alone, time(0.1), vec![record], true).unwrap();
    let (_, blind) = estimated(&experiment, &settings(&alone));
    let (errors, blind) = (uncertainty.standard_errors().unwrap(), blind.standard_errors().unwrap());
    println!("{:?}\n{truth:?}\n{errors:?}\n{blind:?}", estimate.theta);
    for (i, (found, expected)) in estimate.theta.iter().zip(&truth).enumerate() {
        // The motor's noise is not in the filter's model: the estimate is near, the interval nominal.
        assert!((found / expected - 1.0).abs() < 0.15, "{i}: {found} {expected}");
        assert!(errors[i] < blind[i], "{i}");
    }
}

#[test]
fn sensitivities_of_the_predictor_are_exact() {
    let mut stream = rng::stream(10, "predictor");
    let (plant, k, l, [push, y, u]) = controlled(60, &mut stream);
    let theta = [k, l].concat();
    let all = [Predicted::Output, Predicted::OutputAndControl, Predicted::Control];
    for (predicted, is_told) in all.into_iter().flat_map(|predicted| [(predicted, true), (predicted, false)]) {
        let model = Innovation { plant: plant.clone(), continuous: true, predicted, is_told };
        let alone = predicted == Predicted::Output;
        let stimulus = if alone { beside(&[&push, &y]) } else { beside(&[&push, &y, &u]) };
        // As a continuous plant the numbers mean another one; its derivatives are as good.
        let exact = model.sampled(&theta, time(0.1), true).unwrap().respond(&stimulus).unwrap();
        for i in 0..theta.len() {
            let at = |step: f64| {
                let mut moved = theta.clone();
                moved[i] += step;
                model.sampled(&moved, time(0.1), false).unwrap().value.respond(&stimulus).unwrap()
            };
            let h = 1e-3;
            let quotient = ((at(h) - at(-h)) * 45.0 - (at(2.0 * h) - at(-2.0 * h)) * 9.0
                + (at(3.0 * h) - at(-3.0 * h)))
                / (60.0 * h);
            let error = (&quotient - &exact.slopes[i]).norm() / exact.slopes[i].norm();
            assert!(error < 1e-8, "{predicted:?} {is_told} {i}: {error:.1e}");
        }
    }
}
