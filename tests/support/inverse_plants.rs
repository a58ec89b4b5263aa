//! Random plants with gains that are optimal by construction, and random stabilising gains.

use nalgebra::DMatrix;
use num_complex::Complex64;
use rand::{Rng, RngExt};
use volition::control::lqg::lqr;
use volition::control::lyapunov::Clock;
use volition::ctl::Ctl;
use volition::inverse::{Gains, Settings, Verdict, inverse_lqr};
use volition::num::linalg::eigenvalues;
use volition::num::rng;

/// The recorded seed.
pub const SEED: u64 = 7;

/// What came of the plants.
#[derive(Debug, Default, Clone, Copy)]
#[allow(dead_code)]
pub struct Tally {
    pub feasible: usize,
    pub boundary: usize,
    pub infeasible: usize,
    /// Plants whose forward problem has no solution in working precision, or whose gain vanishes.
    pub skipped: usize,
    pub worst_forward_error: f64,
}

fn matrix(rows: usize, columns: usize, stream: &mut impl Rng) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| stream.random_range(-1.0..1.0))
}

fn magnitude(decades: f64, stream: &mut impl Rng) -> f64 {
    10f64.powf(stream.random_range(-decades..=decades))
}

/// Stable plants with n ≤ 12 states and m ≤ n inputs, in continuous and sampled time, with Q over R over 12 decades,
/// inputs over 3 and time constants over 3: K = LQR(Q0, R0) must be feasible, or on the boundary where the margin says
/// so. Anything else is told to `complain`.
pub fn optimal(count: usize, seed: u64, mut complain: impl FnMut(String)) -> Tally {
    let mut stream = rng::stream(seed, "plants");
    let mut tally = Tally::default();
    for round in 0..count {
        let n = stream.random_range(1..=12usize);
        let m = stream.random_range(1..=n);
        let clock = if stream.random::<bool>() { Clock::Continuous } else { Clock::Sampled };
        let mut a = matrix(n, n, &mut stream);
        let b = matrix(n, m, &mut stream) * magnitude(1.5, &mut stream);
        let (q, r) = (matrix(n, n, &mut stream), matrix(m, m, &mut stream));
        let poles = eigenvalues(&a).unwrap();
        match clock {
            Clock::Continuous => {
                let slowest = poles.iter().map(|v| v.re).fold(f64::MIN, f64::max);
                a -= DMatrix::identity(n, n) * (slowest + 0.05);
                a *= magnitude(1.5, &mut stream);
            }
            Clock::Sampled => a *= 0.97 / poles.iter().map(|v| v.norm()).fold(0.0, f64::max),
        }
        let q = (&q * q.transpose() + DMatrix::identity(n, n) * 0.01) * magnitude(3.0, &mut stream);
        let r = (&r * r.transpose() + DMatrix::identity(m, m) * 0.01) * magnitude(3.0, &mut stream);
        let name = format!("plant {round} (n = {n}, m = {m}, {clock:?})");
        let Ok(solution) = lqr(&a, &b, &q, &r, clock) else {
            tally.skipped += 1;
            continue;
        };
        let gains = match Gains::regulator(&a, &b, &solution.k, clock) {
            Ok(gains) => gains,
            Err(error) => {
                complain(format!("{name}: {error}"));
                continue;
            }
        };
        match inverse_lqr(&gains, &Settings::default(), &Ctl::new()) {
            Err(error) => complain(format!("{name}: {error}")),
            Ok(answer) => match answer.verdict {
                Verdict::Feasible => {
                    tally.feasible += 1;
                    let error = answer.weights.unwrap().proof.forward_error;
                    tally.worst_forward_error = tally.worst_forward_error.max(error);
                    if error > 1e-6 {
                        complain(format!("{name}: forward error {error:e}"));
                    }
                }
                Verdict::Boundary => tally.boundary += 1,
                Verdict::Infeasible => complain(format!("{name}: infeasible, {:?}", answer.t_star_upper_bound)),
            },
        }
    }
    tally
}

/// Random stabilising gains of single-input plants: feasible with R = 1 if and only if |1 + K(jωI − A)⁻¹B| ≥ 1 at every
/// frequency (Kalman 1964). Where the least value is within 1e-6 of 1 either verdict is let pass.
pub fn single_input(count: usize, seed: u64, mut complain: impl FnMut(String)) -> Tally {
    let mut stream = rng::stream(seed, "single input");
    let mut tally = Tally::default();
    for round in 0..count {
        let n = stream.random_range(1..=6usize);
        let a = matrix(n, n, &mut stream);
        let b = matrix(n, 1, &mut stream);
        // Around an optimal gain, so that both verdicts occur.
        let r = DMatrix::from_element(1, 1, magnitude(1.0, &mut stream));
        let Ok(optimal) = lqr(&a, &b, &DMatrix::identity(n, n), &r, Clock::Continuous) else {
            tally.skipped += 1;
            continue;
        };
        let size = optimal.k.norm() * stream.random_range(0.0..0.6);
        let k = &optimal.k + matrix(1, n, &mut stream) * size;
        let Ok(gains) = Gains::regulator(&a, &b, &k, Clock::Continuous) else {
            tally.skipped += 1;
            continue;
        };
        let least = least_return_difference(&a, &b, &k);
        let answer = inverse_lqr(&gains, &Settings::default(), &Ctl::new()).unwrap();
        match answer.verdict {
            Verdict::Feasible => {
                tally.feasible += 1;
                if least < -1e-6 {
                    complain(format!("gain {round}: feasible, but |1 + L|² − 1 = {least:e}"));
                }
            }
            Verdict::Infeasible => {
                tally.infeasible += 1;
                if least > 1e-6 {
                    complain(format!("gain {round}: infeasible, but |1 + L|² − 1 ≥ {least:e}"));
                }
            }
            Verdict::Boundary => tally.boundary += 1,
        }
    }
    tally
}

/// `min over ω of (|1 + L(jω)|² − 1)(1 + ω²)`: the factor keeps the limit at infinity away from zero.
fn least_return_difference(a: &DMatrix<f64>, b: &DMatrix<f64>, k: &DMatrix<f64>) -> f64 {
    let complex = |m: &DMatrix<f64>| m.map(|v| Complex64::new(v, 0.0));
    let (ca, cb, ck) = (complex(a), complex(b), complex(k));
    let value = |omega: f64| {
        let n = a.nrows();
        let resolvent = DMatrix::from_diagonal_element(n, n, Complex64::new(0.0, omega)) - &ca;
        let l = (&ck * resolvent.lu().solve(&cb).unwrap())[0];
        // |1 + L|² − 1 without cancellation.
        (2.0 * l.re + l.norm_sqr()) * (1.0 + omega * omega)
    };
    let mut least = f64::INFINITY;
    for i in 0..4000 {
        let omega = 10f64.powf(-4.0 + 8.0 * f64::from(i) / 4000.0);
        least = least.min(value(omega));
    }
    for pole in eigenvalues(a).unwrap().into_iter().chain(eigenvalues(&(a - b * k)).unwrap()) {
        for factor in [0.97, 0.99, 1.0, 1.01, 1.03] {
            least = least.min(value((pole.im.abs() * factor).max(1e-9)));
        }
    }
    least
}
