use super::super::refinement::prepared;
use super::super::setup::{Setup, Start};
use super::*;
use crate::control::{Continuous, Discrete, System, TransferFunction};
use crate::identify::identifiability::Structure;
use crate::identify::problem::Lines;

fn setting(sampled: bool, is_fir: bool) -> (System, Problem, Structure, Start) {
    let omega: Vec<f64> = (0..14).map(|k| 0.4 * f64::from(k)).collect();
    let h: Vec<Complex64> = omega.iter().map(|w| Complex64::new(1.0 / (1.0 + w), -0.2 * w)).collect();
    let weights: Vec<f64> = omega.iter().map(|w| 1.0 + 0.1 * w).collect();
    let structure = Structure {
        feedforward_numerator: 3,
        feedforward_denominator_is_free: !is_fir,
        feedforward_denominator: 2,
        feedback_numerator: 1,
        feedback_denominator: 2,
        held: None,
    };
    let (plant, start) = if sampled {
        let tf = TransferFunction::new(&[0.02, 0.018], &[1.0, -1.7, 0.72], Discrete::new(0.1).unwrap()).unwrap();
        let start = Start {
            feedforward_denominator: if is_fir { vec![1.0, 0.0, 0.0] } else { vec![1.0, -1.6, 0.66] },
            feedback_numerator: vec![0.4, -0.35],
            feedback_denominator: vec![1.0, -1.5, 0.57],
        };
        (System::Discrete(tf), start)
    } else {
        let tf = TransferFunction::new(&[2.0, 4.4], &[1.0, 3.6, 4.0], Continuous).unwrap();
        let start = Start {
            feedforward_denominator: vec![1.0, 3.0, 6.25],
            feedback_numerator: vec![0.8, 1.1],
            feedback_denominator: vec![1.0, 2.0, 7.0],
        };
        (System::Continuous(tf), start)
    };
    let problem = Problem::new(&Lines::new(&plant, &omega, &h, Some(&weights)), 3).unwrap();
    (plant, problem, structure, start)
}

/// Both Jacobians against central differences, with every kind of unknown, at a point with large residuals.
#[test]
fn derivatives_agree_with_differences() {
    for (sampled, is_fir) in [(false, false), (true, false), (true, true)] {
        let (plant, problem, structure, start) = setting(sampled, is_fir);
        let setup = Setup { problem: &problem, plant: &plant, structure, margin_per_s: 0.05 };
        let (mut projection, mut phi) = prepared(setup, &start, [DelayValue::NONE; 2]).unwrap();
        projection.layout.feedback_delay_is_free = true;
        projection.layout.feedforward_delay_is_free = true;
        projection.unknowns = projection.layout.unknowns();
        phi.extend([0.3, 0.2]);
        let point = projection.point(&phi).unwrap();
        let (projected, full) = (projection.projected(&point).unwrap(), projection.full(&point));
        let size = point.beta.len();
        for j in 0..phi.len() {
            let moved = |by: f64| {
                let mut moved = phi.clone();
                moved[j] += by;
                moved
            };
            let (step, unknown) = (1e-5, projection.unknowns[j]);
            let (up, down) = (projection.point(&moved(step)).unwrap(), projection.point(&moved(-step)).unwrap());
            let difference = (&up.residuals - &down.residuals) / (2.0 * step);
            let error = (&difference - projected.column(j)).norm() / (1e-3 + difference.norm());
            assert!(error < 1e-6, "{unknown:?} projected {error}");
            // Without elimination: β held.
            let held = |point: &Point| {
                let b = &point.a * &point.beta - &point.residuals;
                &point.a * &full_beta(&projection, &phi) - b
            };
            let difference = (held(&up) - held(&down)) / (2.0 * step);
            let error = (&difference - full.column(size + j)).norm() / (1e-3 + difference.norm());
            assert!(error < 1e-6, "{unknown:?} full {error}");
        }
    }
}

fn full_beta(projection: &Projection<'_>, phi: &[f64]) -> DVector<f64> {
    projection.point(phi).unwrap().beta
}
