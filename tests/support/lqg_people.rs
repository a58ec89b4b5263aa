//! Simulated persons who control by a cost and a belief: their equations sample by sample, without the joint system
//! that the likelihood is made of.

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_distr::StandardNormal;
use std::ops::AddAssign;
use volition::likelihood::lqg::{Design, FilterStart, Horizon, Plant, Record, Recorded, Role, Start, Term, Timing};
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
        d: matrix(1, 1, &[0.0]),
    }
}

pub fn term(name: &str, role: Role, shape: DMatrix<f64>) -> Term {
    Term { name: name.to_owned(), role, shape, held: None, start: None, same_as: None }
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
        internal: None,
        recorded: Recorded {
            rows: None,
            instrument: None,
            control: control.map(|v| matrix(1, 1, &[v])),
            is_applied: false,
        },
        start: Start::Rest,
        horizon: None,
        on_the_way: None,
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

/// The sum of a role's terms at θ.
pub fn sum(design: &Design, theta: &[f64], role: Role, order: usize) -> DMatrix<f64> {
    let terms = design.terms.iter().enumerate().filter(|(_, term)| term.role == role);
    terms.fold(DMatrix::zeros(order, order), |sum, (at, term)| sum + &term.shape * design.coefficient(at, theta))
}

/// A trial of the person at θ, from rest, under this disturbance.
pub fn simulate(design: &Design, theta: &[f64], disturbance: &DMatrix<f64>, stream: &mut Stream) -> Record {
    let person = design.member(theta, false).unwrap();
    simulate_from(design, theta, None, disturbance, &|_| [person.k.clone(), person.l.clone()], stream)
}

/// A trial of the person at θ, from this state and belief, with these gains of every sample.
pub fn simulate_from(
    design: &Design,
    theta: &[f64],
    initial: Option<[DVector<f64>; 2]>,
    disturbance: &DMatrix<f64>,
    gains: &dyn Fn(usize) -> [DMatrix<f64>; 2],
    stream: &mut Stream,
) -> Record {
    let [n, m, p, _] = design.sizes();
    let Plant { a, b, c, e, d: through } = &design.plant;
    let own = design.internal();
    let samples = disturbance.nrows();
    let outputs = design.outputs();
    let mut measured = DMatrix::zeros(samples, design.channels());
    let [w, v, motor, grown] =
        [(Role::ProcessNoise, n), (Role::MeasurementNoise, p), (Role::MotorNoise, m), (Role::ControlDependentNoise, m)]
            .map(|(role, order)| sum(design, theta, role, order));
    // The belief before y is sensed.
    let (mut x, mut belief) =
        initial.clone().map_or_else(|| (DVector::zeros(n), DVector::zeros(own.a.nrows())), |[x, belief]| (x, belief));
    if let Some(entry) = &design.on_the_way {
        // What was sensed before has its noise too.
        let first = (0..n).find(|i| entry.row(*i).amax() > 0.0).unwrap();
        for at in (first..n).step_by(p) {
            x.rows_mut(at, p).add_assign(&drawn(&v, stream));
        }
    }
    for k in 0..samples {
        let [gain, filter] = gains(k);
        let d = disturbance.row(k).transpose();
        let (told, known) = if design.is_told {
            (&own.e * &d, through * &d)
        } else {
            (DVector::zeros(own.a.nrows()), DVector::zeros(p))
        };
        let noise = drawn(&v, stream);
        let y = c * &x + through * &d + &noise;
        let innovation = match &design.on_the_way {
            None => &y - known - &own.c * &belief,
            Some(_) => c * &x - &own.c * &belief,
        };
        let (u, next) = match design.timing {
            Timing::Predictor => {
                let u = -(&gain * &belief);
                let next = &own.a * &belief + &own.b * &u + told + &filter * innovation;
                (u, next)
            }
            Timing::Filter => {
                let after = &belief + &filter * innovation;
                let u = -(&gain * &after);
                let next = &own.a * after + &own.b * &u + told;
                (u, next)
            }
        };
        let signal = DMatrix::from_diagonal(&(&grown * &u).map(|v| v * v));
        let applied = &u + drawn(&(&motor + signal), stream);
        let [rows, seen] = design.recorded_rows();
        let shown = rows * &x + seen * &d;
        let shown = match &design.recorded.instrument {
            None => shown + &noise,
            Some(instrument) => shown + drawn(instrument, stream),
        };
        measured.view_mut((k, 0), (1, outputs)).copy_from(&shown.transpose());
        if let Some(noise) = &design.recorded.control {
            let used = if design.recorded.is_applied { &applied } else { &u };
            measured.view_mut((k, outputs), (1, m)).copy_from(&(used + drawn(noise, stream)).transpose());
        }
        x = a * x + b * applied + e * d + drawn(&w, stream);
        if let Some(entry) = &design.on_the_way {
            x += entry * noise;
        }
        belief = next;
    }
    Record { disturbance: disturbance.clone(), measured, initial }
}

/// A term whose coefficient is known.
pub fn held(name: &str, role: Role, shape: DMatrix<f64>, value: f64) -> Term {
    Term { held: Some(value), ..term(name, role, shape) }
}

/// A term with the coefficient of another one.
pub fn tied(name: &str, role: Role, shape: DMatrix<f64>, same_as: usize) -> Term {
    Term { same_as: Some(same_as), ..term(name, role, shape) }
}

/// A cursor that follows a target walking at random, both recorded exactly, by a person who believes what is true, in
/// the equations of the package `lqg`: θ is the logarithms of r, of the cursor's variance, and of both variances of the
/// senses. `believed` adds the target's velocity to the person's model, with two variances.
pub fn follower(steps: usize, believes_velocity: bool) -> Design {
    let dt = 1.0 / 60.0;
    let plant = Plant {
        a: DMatrix::identity(2, 2),
        b: matrix(2, 1, &[0.0, dt]),
        c: DMatrix::identity(2, 2),
        e: DMatrix::zeros(2, 1),
        d: DMatrix::zeros(2, 1),
    };
    let own = if believes_velocity { 3 } else { 2 };
    let internal = believes_velocity.then(|| Plant {
        a: matrix(3, 3, &[1.0, 0.0, dt, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        b: matrix(3, 1, &[0.0, dt, 0.0]),
        c: matrix(2, 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]),
        e: DMatrix::zeros(3, 1),
        d: DMatrix::zeros(2, 1),
    });
    let mut error = DMatrix::zeros(own, own);
    error.view_mut((0, 0), (2, 2)).copy_from(&matrix(2, 2, &[1.0, -1.0, -1.0, 1.0]));
    let one = |order: usize, at: usize, value: f64| {
        DMatrix::from_fn(order, order, |i, j| if i == at && j == at { value } else { 0.0 })
    };
    let mut terms = vec![
        held("error", Role::StateWeight, error.clone(), 1.0),
        term("effort", Role::ControlWeight, matrix(1, 1, &[1.0])),
        held("target", Role::ProcessNoise, one(2, 0, 1.0), 1.0),
        term("cursor", Role::ProcessNoise, one(2, 1, 1.0)),
        term("sees target", Role::MeasurementNoise, one(2, 0, 1.0)),
        term("sees cursor", Role::MeasurementNoise, one(2, 1, 1.0)),
        tied("believed cursor", Role::PerceivedProcessNoise, one(own, 1, 1.0), 3),
        tied("believes to see target", Role::PerceivedMeasurementNoise, one(2, 0, 1.0), 4),
        tied("believes to see cursor", Role::PerceivedMeasurementNoise, one(2, 1, 1.0), 5),
        held("error at the end", Role::TerminalWeight, error, 1.0),
        tied("first cursor", Role::InitialCovariance, one(own, 1, 2.0), 3),
    ];
    if believes_velocity {
        terms.push(term("believed target", Role::PerceivedProcessNoise, one(own, 0, 1.0)));
        terms.push(term("believed velocity", Role::PerceivedProcessNoise, one(own, 2, 1.0)));
        terms.push(tied("first target", Role::InitialCovariance, one(own, 0, 2.0), 11));
        // A W_p Aᵀ + W_p, in which the velocity has moved the target.
        let a = &internal.as_ref().unwrap().a;
        let moved = a * one(own, 2, 1.0) * a.transpose() + one(own, 2, 1.0);
        terms.push(tied("first velocity", Role::InitialCovariance, moved, 12));
    } else {
        terms.push(tied("believed target", Role::PerceivedProcessNoise, one(own, 0, 1.0), 2));
        terms.push(tied("first target", Role::InitialCovariance, one(own, 0, 2.0), 2));
    }
    Design {
        plant,
        internal,
        terms,
        control_weight: DMatrix::zeros(1, 1),
        perceived_measurement_noise: DMatrix::zeros(2, 2),
        is_told: false,
        timing: Timing::Filter,
        recorded: Recorded { rows: None, instrument: Some(DMatrix::zeros(2, 2)), control: None, is_applied: false },
        start: Start::Rest,
        horizon: Some(Horizon { steps, filter: FilterStart::BeforeSecond }),
        on_the_way: None,
    }
}

/// A reach of Todorov (2005): position, velocity, force and activation of a mass of 1 kg behind two lags of 40 ms, and
/// the target's position, 10 ms; control-dependent noise, and an additive one that is known. θ is the logarithms of r,
/// of the terminal weights of velocity and force, of c, and of the variance of the senses.
pub fn reach(steps: usize) -> Design {
    let (dt, tau) = (0.01, 0.04);
    let mut a = DMatrix::identity(5, 5);
    a[(0, 1)] = dt;
    a[(1, 2)] = dt;
    a[(2, 2)] = 1.0 - dt / tau;
    a[(2, 3)] = dt / tau;
    a[(3, 3)] = 1.0 - dt / tau;
    let mut b = DMatrix::zeros(5, 1);
    b[3] = dt / tau;
    let mut error = DMatrix::zeros(5, 5);
    (error[(0, 0)], error[(4, 4)], error[(0, 4)], error[(4, 0)]) = (1.0, 1.0, -1.0, -1.0);
    let c = DMatrix::from_fn(3, 5, |i, j| if i == j { 1.0 } else { 0.0 });
    let senses = diagonal(&[1e-4, 1e-2, 0.25]);
    Design {
        plant: Plant { a, b: b.clone(), c, e: DMatrix::zeros(5, 1), d: DMatrix::zeros(3, 1) },
        internal: None,
        terms: vec![
            held("error", Role::TerminalWeight, error, 1.0),
            term("effort", Role::ControlWeight, matrix(1, 1, &[1.0])),
            term("velocity", Role::TerminalWeight, diagonal(&[0.0, 1.0, 0.0, 0.0, 0.0])),
            term("force", Role::TerminalWeight, diagonal(&[0.0, 0.0, 1.0, 0.0, 0.0])),
            term("c", Role::ControlDependentNoise, matrix(1, 1, &[1.0])),
            term("senses", Role::MeasurementNoise, senses.clone()),
            tied("believed senses", Role::PerceivedMeasurementNoise, senses, 5),
            held("additive", Role::MotorNoise, matrix(1, 1, &[1.0]), 0.0025),
            held("believed additive", Role::PerceivedProcessNoise, &b * b.transpose(), 0.0025),
        ],
        control_weight: DMatrix::zeros(1, 1),
        perceived_measurement_noise: DMatrix::zeros(3, 3),
        is_told: false,
        timing: Timing::Predictor,
        recorded: Recorded {
            rows: Some([matrix(1, 5, &[1.0, 0.0, 0.0, 0.0, 0.0]), DMatrix::zeros(1, 1)]),
            instrument: Some(matrix(1, 1, &[2.5e-7])),
            control: None,
            is_applied: false,
        },
        start: Start::Rest,
        horizon: Some(Horizon { steps, filter: FilterStart::BeforeFirst }),
        on_the_way: None,
    }
}

/// The truth of [`reach`] for so many steps.
pub fn reach_truth(steps: usize) -> Vec<f64> {
    [1e-5 / steps as f64, 0.04, 4e-4, 0.3, 1.0].map(f64::ln).to_vec()
}

/// Reaches from rest over these distances, so many over each.
pub fn reaches(design: &Design, theta: &[f64], distances: &[f64], each: usize, stream: &mut Stream) -> Vec<Record> {
    let steps = design.horizon.unwrap().steps;
    let nothing = DMatrix::zeros(steps + 1, 1);
    let mut records = Vec::new();
    for distance in distances {
        let start = DVector::from_column_slice(&[0.0, 0.0, 0.0, 0.0, *distance]);
        let gains = design.gains_by_sample(theta, Some(&start)).unwrap();
        for _ in 0..each {
            let initial = Some([start.clone(), start.clone()]);
            let at = |k: usize| gains[k.min(gains.len() - 1)].clone();
            records.push(simulate_from(design, theta, initial, &nothing, &at, stream));
        }
    }
    records
}
