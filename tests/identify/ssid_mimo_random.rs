//! Multivariable subsystem identification: random systems against brute force.

use super::ssid_mimo::{closed_loop, pool, settings};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use rand::RngExt;
use serde_json::{Value, json};
use volition::control::{Discrete, Multivariable, PolynomialMatrix, RightFraction, StateSpace};
use volition::ctl::Ctl;
use volition::identify::mimo::{FeedbackPool, MatrixFrequencyData, Plant, Settings, identify};
use volition::num::linalg;
use volition::num::rng::{Stream, stream};

fn uniform(random: &mut Stream, low: f64, high: f64) -> f64 {
    random.random_range(low..high)
}

struct Case {
    plant: Plant,
    data: MatrixFrequencyData,
    settings: Settings,
    truth: Vec<Vec<f64>>,
    /// By power of 1/z.
    feedforward: Vec<DMatrix<f64>>,
}

fn random_state_space(
    random: &mut Stream,
    states: usize,
    inputs: usize,
    outputs: usize,
    size: f64,
) -> StateSpace<Discrete> {
    let mut matrix = |rows, columns, size: f64| DMatrix::from_fn(rows, columns, |_, _| uniform(random, -size, size));
    let a = matrix(states, states, size);
    let (b, c) = (matrix(states, inputs, 1.0), matrix(outputs, states, 1.0));
    StateSpace::new(a, b, c, DMatrix::zeros(outputs, inputs), Discrete::new(0.1).unwrap()).unwrap()
}

fn random_fraction(random: &mut Stream, inputs: usize, outputs: usize, size: f64) -> RightFraction<Discrete> {
    let degrees: Vec<usize> = (0..inputs).map(|_| random.random_range(1..3)).collect();
    let mut entry = |degree: usize, leading: Option<f64>| {
        let mut c: Vec<f64> = leading.into_iter().collect();
        c.extend((0..degree).map(|_| uniform(random, -size, size)));
        if c.is_empty() { vec![0.0] } else { c }
    };
    let denominator: Vec<Vec<Vec<f64>>> =
        (0..inputs).map(|i| (0..inputs).map(|j| entry(degrees[j], (i == j).then_some(1.0))).collect()).collect();
    let numerator: Vec<Vec<Vec<f64>>> =
        (0..outputs).map(|_| (0..inputs).map(|j| entry(degrees[j], None)).collect()).collect();
    RightFraction::new(
        PolynomialMatrix::new(&numerator).unwrap(),
        PolynomialMatrix::new(&denominator).unwrap(),
        Discrete::new(0.1).unwrap(),
    )
    .unwrap()
}

/// The eigenvalues of the closed loop in state space: a second way to its poles.
fn loop_poles(plant: &Plant, pool: &FeedbackPool, coefficients: &[Vec<f64>]) -> Vec<Complex64> {
    let time = plant.system.time();
    let model = plant.system.to_state_space().unwrap();
    let feedback = pool.fraction(coefficients, time);
    let transposed =
        |p: &PolynomialMatrix| PolynomialMatrix::from_fn(p.columns(), p.rows(), |i, j| p.entry(j, i).clone());
    // Gfbᵀ = Nᵀ D⁻ᵀ is a right fraction; its realisation, transposed, is one of Gfb.
    let dual = RightFraction::new(transposed(feedback.numerator()), transposed(feedback.denominator()), time)
        .unwrap()
        .to_state_space()
        .unwrap();
    let (ak, bk, ck, dk) = (dual.a().transpose(), dual.c().transpose(), dual.b().transpose(), dual.d().transpose());
    let cv = model.c().select_rows(&plant.fed_back);
    let (n, k) = (model.states(), ak.nrows());
    let mut a = DMatrix::zeros(n + k, n + k);
    a.view_mut((0, 0), (n, n)).copy_from(&(model.a() - model.b() * dk * &cv));
    a.view_mut((0, n), (n, k)).copy_from(&(model.b() * ck));
    a.view_mut((n, 0), (k, n)).copy_from(&(-bk * &cv));
    a.view_mut((n, n), (k, k)).copy_from(&ak);
    linalg::eigenvalues(&a).unwrap()
}

/// A random plant, pool and person; with noise of the given share. Plants are often unstable.
fn random_case(seed: u64, noise: f64, largest_row: usize) -> Option<Case> {
    let mut random = stream(seed, "mimo");
    let m = random.random_range(1..4_usize);
    let l = random.random_range(1..4_usize);
    let same = random.random_range(0..2) == 0 && l >= m;
    let (outputs, measured, fed_back): (usize, Vec<usize>, Vec<usize>) = if same {
        (l, (0..l).collect(), (0..l).collect())
    } else {
        // Others than those fed back, one of them shared.
        let n = m + random.random_range(0..2);
        (n + l - 1, (0..n).collect(), (n - 1..n + l - 1).collect())
    };
    let size = uniform(&mut random, 0.4, 1.5);
    let system = if random.random_range(0..2) == 0 {
        let states = m + random.random_range(0..3_usize);
        Multivariable::StateSpace(random_state_space(&mut random, states, m, outputs, 0.8 * size))
    } else {
        Multivariable::Fraction(random_fraction(&mut random, m, outputs, size))
    };
    let plant = Plant { system, measured, fed_back };

    // Axes around a random feedback.
    let dynamic = random.random_range(0..2) == 0;
    let degrees: Vec<usize> = (0..m).map(|_| if dynamic { random.random_range(0..3) } else { 0 }).collect();
    let mut axis = |free: bool| {
        let centre = uniform(&mut random, -0.7, 0.7);
        if free { json!([centre - 0.3, centre, centre + 0.23]) } else { json!([centre]) }
    };
    let (mut numerator, mut denominator) = (Vec::new(), Vec::new());
    for degree in &degrees {
        // Three rows of free coefficients make many candidates.
        let mut free = if m == 3 { largest_row.min(2) } else { largest_row };
        let mut entry = |count: usize| -> Value {
            let axes = (0..count).map(|_| {
                let is_free = free > 0;
                free = free.saturating_sub(1);
                axis(is_free)
            });
            Value::Array(axes.collect())
        };
        numerator.push((0..l).map(|_| entry(degree + 1)).collect::<Vec<_>>());
        denominator.push(degree);
    }
    let mut of_denominator = Vec::new();
    for (i, degree) in denominator.iter().enumerate() {
        let row: Vec<Value> = (0..m)
            .map(|j| {
                let count = if i == j { **degree } else { degree.saturating_sub(1) };
                Value::Array((0..count).map(|_| axis(false)).collect())
            })
            .collect();
        of_denominator.push(row);
    }
    let pool = pool(json!(numerator), json!(of_denominator), 0.0);
    let order = random.random_range(0..4_usize);

    // The truth: the first stable candidate after a random one.
    let start = random.random_range(0..pool.listed() as u64);
    let truth = (0..pool.listed() as u64)
        .map(|k| pool.candidate((start + k) % pool.listed() as u64))
        .find(|c| loop_poles(&plant, &pool, c).iter().all(|p| p.norm() < 0.97))?;
    let feedforward: Vec<DMatrix<f64>> =
        (0..=order).map(|_| DMatrix::from_fn(m, l, |_, _| uniform(&mut random, -1.0, 1.0))).collect();
    let omega: Vec<f64> = (0..30).map(|k| 0.4 + f64::from(k)).collect();
    let fraction = pool.fraction(&truth, plant.system.time());
    let h = omega
        .iter()
        .map(|w| {
            let z = Complex64::from_polar(1.0, 0.1 * w);
            let g = plant.system.eval(z).unwrap();
            let gff = feedforward.iter().enumerate().fold(DMatrix::zeros(m, l), |sum, (i, b)| {
                sum + b.map(|v| Complex64::new(v, 0.0)) * z.powi(-(i as i32))
            });
            let exact = closed_loop(
                &g.select_rows(&plant.measured),
                &g.select_rows(&plant.fed_back),
                &gff,
                &fraction.eval(z).unwrap(),
            );
            exact.map(|v| {
                v + noise * v.norm() * Complex64::new(uniform(&mut random, -1.0, 1.0), uniform(&mut random, -1.0, 1.0))
            })
        })
        .collect();
    let data = MatrixFrequencyData { omega_rad_s: omega, h, variance: None };
    Some(Case { plant, data, settings: settings(pool, order), truth, feedforward })
}

/// Cost of one feedback by Householder QR of the equations as they stand, in powers of 1/z.
fn brute_force_cost(case: &Case, coefficients: &[Vec<f64>]) -> f64 {
    let pool = &case.settings.pool;
    let (m, l, order) = (pool.controls(), pool.fed_back(), case.settings.feedforward_order);
    let feedback = pool.fraction(coefficients, case.plant.system.time());
    let n = case.plant.measured.len();
    let mut cost = 0.0;
    for column in 0..l {
        let (mut rows, mut right): (Vec<Vec<f64>>, Vec<f64>) = (Vec::new(), Vec::new());
        for (w, h) in case.data.omega_rad_s.iter().zip(&case.data.h) {
            let z = Complex64::from_polar(1.0, 0.1 * w);
            let g = case.plant.system.eval(z).unwrap();
            let (gy, gv) = (g.select_rows(&case.plant.measured), g.select_rows(&case.plant.fed_back));
            let gfb = feedback.eval(z).unwrap();
            let through = gy * (DMatrix::identity(m, m) + &gfb * gv).try_inverse().unwrap();
            let rest = h - &through * gfb;
            for i in 0..n {
                let row: Vec<Complex64> = (0..=order)
                    .flat_map(|p| (0..m).map(|c| through[(i, c)] * z.powi(-(p as i32))).collect::<Vec<_>>())
                    .collect();
                rows.push(row.iter().map(|v| v.re).collect());
                rows.push(row.iter().map(|v| v.im).collect());
                right.extend([rest[(i, column)].re, rest[(i, column)].im]);
            }
        }
        let a = DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j]);
        cost += linalg::least_squares(&a, &DVector::from_vec(right)).unwrap().1;
    }
    cost
}

#[test]
fn random_pools_have_the_optimum_of_brute_force() {
    let (mut cases, mut unstable, mut different, mut dynamic) = (0, 0, 0, 0);
    for seed in 0..160 {
        let Some(case) = random_case(seed, [0.0, 0.02, 0.2, 1.0][seed as usize % 4], 3) else { continue };
        let found = identify(&case.plant, &case.data, &case.settings, &Ctl::new()).unwrap();
        let pool = &case.settings.pool;
        let mut best: Option<(f64, u64)> = None;
        let (mut stable, mut index) = (0, None);
        let mut costs = Vec::new();
        for k in 0..pool.listed() as u64 {
            let coefficients = pool.candidate(k);
            let largest = loop_poles(&case.plant, pool, &coefficients).iter().map(|p| p.norm()).fold(0.0, f64::max);
            assert!((largest - 1.0).abs() > 1e-9, "seed {seed}: a tie");
            if largest >= 1.0 {
                continue;
            }
            let cost = brute_force_cost(&case, &coefficients);
            costs.push(cost);
            if best.is_none_or(|(known, _)| cost < known) {
                (best, index) = (Some((cost, k)), Some(stable));
            }
            stable += 1;
        }
        let (cost, listed_index) = best.unwrap();
        assert_eq!(found.optimum.pool_size, stable, "seed {seed}");
        let scale: f64 = case.data.h.iter().flatten().map(|v| v.norm_sqr()).sum();
        assert!(
            (found.optimum.fit.cost - cost).abs() < 1e-9 * cost + 1e-22 * scale,
            "seed {seed}: {} {cost}",
            found.optimum.fit.cost
        );
        assert_eq!(
            (found.optimum.listed_index, Some(found.optimum.index)),
            (listed_index, index),
            "seed {seed}: {cost}"
        );
        let near = costs.iter().filter(|c| **c <= 1.01 * cost + 1e-20 * scale).count() as u64;
        assert_eq!(found.optimum.near_optimal, near, "seed {seed}");
        // Poles by the determinant polynomial are those of the state space loop.
        let mut other = loop_poles(&case.plant, pool, &found.optimum.coefficients);
        for pole in &found.closed_loop_poles {
            let (at, distance) =
                other.iter().map(|p| (p - pole).norm()).enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
            assert!(distance < 1e-5, "seed {seed}: {pole} {other:?}");
            other.swap_remove(at);
        }
        assert!(other.is_empty(), "seed {seed}");
        cases += 1;
        unstable +=
            u32::from(case.plant.system.to_state_space().unwrap().poles().unwrap().iter().any(|p| p.norm() > 1.0));
        different += u32::from(case.plant.measured != case.plant.fed_back);
        dynamic += u32::from(pool.states() > 0);
    }
    assert!(
        cases >= 90 && unstable >= 12 && different >= 30 && dynamic >= 30,
        "{cases} {unstable} {different} {dynamic}"
    );
}

#[test]
fn random_people_are_recovered_without_noise() {
    let mut recovered = 0;
    for seed in 1000..1040 {
        let Some(case) = random_case(seed, 0.0, 2) else { continue };
        let found = identify(&case.plant, &case.data, &case.settings, &Ctl::new()).unwrap();
        let scale: f64 = case.data.h.iter().flatten().map(|v| v.norm_sqr()).sum();
        assert!(found.optimum.fit.cost < 1e-24 * scale, "seed {seed}: {} of {scale}", found.optimum.fit.cost);
        let Some(separation) = found.identifiability.separation else { continue };
        if separation < 1e-6 {
            continue;
        }
        assert_eq!(found.optimum.coefficients, case.truth, "seed {seed}: separation {separation}");
        let condition = found.identifiability.condition_number.unwrap();
        let order = case.settings.feedforward_order;
        for (power, expected) in case.feedforward.iter().enumerate() {
            let error = (found.feedforward.numerator().coefficient(order - power) - expected).norm();
            assert!(error < 1e-13 * condition.max(10.0), "seed {seed}: {error} with condition {condition}");
        }
        recovered += 1;
    }
    assert!(recovered >= 20, "{recovered}");
}

#[test]
fn any_number_of_threads_gives_the_same_answer() {
    let case = (0..).find_map(|seed| random_case(seed, 0.3, 4).filter(|c| c.settings.pool.listed() > 500)).unwrap();
    let run = |threads: usize| {
        let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        threads.install(|| identify(&case.plant, &case.data, &case.settings, &Ctl::new()).unwrap())
    };
    assert_eq!(run(1), run(3));
}
