//! Simulated persons who control by a cost and a belief: their equations sample by sample, without the joint system
//! that the likelihood is made of.

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_distr::StandardNormal;
use volition::likelihood::lqg::{Design, Plant, Record, Recorded, Role, Start, Term, Timing};
use volition::num::rng::Stream;

pub fn matrix(rows: usize, columns: usize, entries: &[f64]) -> DMatrix<f64> {
    DMatrix::from_row_slice(rows, columns, entries)
}

pub fn diagonal(entries: &[f64]) -> DMatrix<f64> {
    DMatrix::from_diagonal(&DVector::from_column_slice(entries))
}

/// The example of the reference: 4, −.3 in continuous time, sampled at 20 ms.
pub fn example_plant() -> Plant {
    let b = matrix(2, 1, &[0.00019962720346188757, 0.019945437607715825]);
    Plant {
        a: matrix(2, 2, &[1.0007985088138476, 0.019945437607715825, 0.0797817504308633, 0.9948148775315327]),
        e: b.clone(),
        b,
        c: matrix(1, 2, &[1.0, 0.0]),
    }
}

pub fn term(name: &str, role: Role, shape: DMatrix<f64>) -> Term {
    Term { name: name.to_owned(), role, shape, held: None, start: None }
}

/// The example's person with five parameters: q1, q2, one scale of W_p, one of W (shape diag(1e-6, 4e-4)), and V;
/// with `control`, the recorder's variance.
pub fn example(is_told: bool, control: Option<f64>) -> Design {
    let shape = diagonal(&[0.0025, 1.0]);
    Design {
        plant: example_plant(),
        terms: vec![
            term("q1", Role::StateWeight, diagonal(&[1.0, 0.0])),
            term("q2", Role::StateWeight, diagonal(&[0.0, 1.0])),
            term("wp", Role::PerceivedProcessNoise, shape.clone()),
            term("w", Role::ProcessNoise, shape),
            term("v", Role::MeasurementNoise, matrix(1, 1, &[1.0])),
        ],
        control_weight: matrix(1, 1, &[1e-3]),
        perceived_measurement_noise: matrix(1, 1, &[1e-4]),
        is_told,
        timing: Timing::Predictor,
        recorded: Recorded { instrument: None, control: control.map(|v| matrix(1, 1, &[v])), is_applied: false },
        start: Start::Rest,
    }
}

/// The truth of [`example`] where perceived measurement noise is `factor` times the true one.
pub fn example_truth(factor: f64) -> Vec<f64> {
    [0.4, 0.02, 4e-4 / factor, 4e-4, 1e-4].map(f64::ln).to_vec()
}

/// ±size, held for 15 samples.
pub fn binary(samples: usize, size: f64, stream: &mut Stream) -> DMatrix<f64> {
    let mut value = size;
    DMatrix::from_fn(samples, 1, |k, _| {
        if k % 15 == 0 {
            value = if stream.random::<bool>() { size } else { -size };
        }
        value
    })
}

/// A normal vector of this covariance.
fn drawn(covariance: &DMatrix<f64>, stream: &mut Stream) -> DVector<f64> {
    let eigen = covariance.clone().symmetric_eigen();
    let z = DVector::from_fn(covariance.nrows(), |i, _| {
        eigen.eigenvalues[i].max(0.0).sqrt() * stream.sample::<f64, _>(StandardNormal)
    });
    eigen.eigenvectors * z
}

/// A trial of the person at θ, from rest, under this disturbance.
pub fn simulate(design: &Design, theta: &[f64], disturbance: &DMatrix<f64>, stream: &mut Stream) -> Record {
    let [n, m, p, _] = design.sizes();
    let Plant { a, b, c, e } = &design.plant;
    let person = design.member(theta, false).unwrap();
    let samples = disturbance.nrows();
    let mut measured = DMatrix::zeros(samples, design.channels());
    // The belief before y is sensed.
    let (mut x, mut belief) = (DVector::zeros(n), DVector::zeros(n));
    for k in 0..samples {
        let d = disturbance.row(k).transpose();
        let told = if design.is_told { e * &d } else { DVector::zeros(n) };
        let y = c * &x + drawn(&person.v, stream);
        let innovation = &y - c * &belief;
        let (u, next) = match design.timing {
            Timing::Predictor => {
                let u = -(&person.k * &belief);
                let next = a * &belief + b * &u + told + &person.l * innovation;
                (u, next)
            }
            Timing::Filter => {
                let after = &belief + &person.l * innovation;
                let u = -(&person.k * &after);
                let next = a * after + b * &u + told;
                (u, next)
            }
        };
        let applied = &u + drawn(&person.m, stream);
        let shown = match &design.recorded.instrument {
            None => y,
            Some(noise) => c * &x + drawn(noise, stream),
        };
        measured.view_mut((k, 0), (1, p)).copy_from(&shown.transpose());
        if let Some(noise) = &design.recorded.control {
            let used = if design.recorded.is_applied { &applied } else { &u };
            measured.view_mut((k, p), (1, m)).copy_from(&(used + drawn(noise, stream)).transpose());
        }
        x = a * x + b * applied + e * d + drawn(&person.w, stream);
        belief = next;
    }
    Record { disturbance: disturbance.clone(), measured }
}
