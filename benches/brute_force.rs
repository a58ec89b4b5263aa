//! The best candidate of the complete appendix B, one candidate after another, against the search by bounds.
//!
//! `cargo bench --bench brute_force` evaluates all 160 billion candidates for one noisy trial of the reference;
//! `-- --smoke` a thinned pool. Nothing of the search is used: normal equations in single precision, several
//! denominators at once, with a bound of their rounding; whoever might still be the best is evaluated by QR.
#![allow(unreachable_pub, clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)]

use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::f64::consts::{E, TAU};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;
use volition::control::System;
use volition::ctl::Ctl;
use volition::identify::pool::{Degrees, Pool, PoolSpec, Position};
use volition::identify::problem::{Lines, Problem};
use volition::identify::search::{Clusters, Search, SensitivitySearch, exact};
use volition::num::Complex64;
use volition::plants::catalogue;

/// Lines, coefficients of the numerator's real and imaginary half, entries of the two Gram matrices.
const LINES: usize = 13;
const EVEN: usize = 3;
const ODD: usize = 2;
const ENTRIES: usize = EVEN * (EVEN + 1) / 2 + ODD * (ODD + 1) / 2;

/// Denominators per instruction.
const LANES: usize = 8;
type Lanes = [f32; LANES];

/// Re and Im of 1/D, and its square, per line.
type Denominators = [[Lanes; 3]; LINES];

/// A feedback controller at the lines: |S G|² times the basis' products, the conjugate of S G times E − S, the basis.
struct Controller {
    products: [[f32; ENTRIES]; LINES],
    turned: [[f32; 2]; LINES],
    functions: [[f32; EVEN + ODD]; LINES],
    /// `Σ |E − S|²`, and `4 γ Σ (|E| + |S|)²`.
    total: f32,
    margin: f32,
}

impl Controller {
    /// With the typical `|1/D|²` per line, for which the basis is made orthonormal.
    fn new(problem: &Problem, feedback: &[Complex64], typical: &[f64; LINES]) -> Self {
        let mut sg = [Complex64::ZERO; LINES];
        let mut b = [Complex64::ZERO; LINES];
        let (mut total, mut size) = (0.0, 0.0);
        for (k, line) in problem.lines().iter().enumerate() {
            let s = 1.0 / (1.0 + line.plant * feedback[k]);
            let turn = Complex64::from_polar(1.0, -problem.basis().rotation(line.omega_rad_s));
            sg[k] = s * line.plant * turn;
            b[k] = 1.0 - line.response - s;
            total += b[k].norm_sqr();
            size += ((1.0 - line.response).norm() + s.norm()).powi(2);
        }
        let largest = sg.iter().map(|x| x.norm()).fold(0.0, f64::max);
        sg.iter_mut().for_each(|x| *x /= largest);
        let mut functions = [[0.0; EVEN + ODD]; LINES];
        for (k, row) in functions.iter_mut().enumerate() {
            let values = problem.basis().even().values.iter().chain(&problem.basis().odd().values);
            row.iter_mut().zip(values).for_each(|(f, v)| *f = v[k]);
        }
        for half in [0..EVEN, EVEN..EVEN + ODD] {
            for i in half.clone() {
                for j in half.start..=i {
                    let weight = |k: usize| sg[k].norm_sqr() * typical[k];
                    let share: f64 = (0..LINES).map(|k| functions[k][i] * functions[k][j] * weight(k)).sum();
                    for row in &mut functions {
                        row[i] = if i == j { row[i] / share.sqrt() } else { row[i] - share * row[j] };
                    }
                }
            }
        }
        let mut products = [[0.0; ENTRIES]; LINES];
        for (k, row) in products.iter_mut().enumerate() {
            let mut n = 0;
            for half in [0..EVEN, EVEN..EVEN + ODD] {
                for i in half.clone() {
                    for j in half.start..=i {
                        row[n] = (functions[k][i] * functions[k][j] * sg[k].norm_sqr()) as f32;
                        n += 1;
                    }
                }
            }
        }
        // Sums of LINES terms, each of factors with some roundings of their own; a solution of order three.
        let gamma = (LINES + 24) as f64 * 0.5 * f64::from(f32::EPSILON);
        Self {
            products,
            turned: std::array::from_fn(|k| {
                let z = sg[k].conj() * b[k];
                [z.re as f32, z.im as f32]
            }),
            functions: functions.map(|row| row.map(|f| f as f32)),
            total: total as f32,
            margin: (4.0 * gamma * size * 1.01) as f32,
        }
    }
}

/// Places of the denominators with which a controller may cost no more than the limit.
struct Screen<'a> {
    controller: &'a Controller,
    denominators: &'a [Denominators],
    limit: f32,
    close: &'a mut Vec<u32>,
}

impl WithSimd for Screen<'_> {
    type Output = ();

    /// Plain loops over the lanes, which the compiler vectorises for the dispatched instructions.
    ///
    /// Rounding: sums and factors err by γ of what is summed, so the minimum errs by at most `2γ (√C + ‖x‖₁)²` with the
    /// coefficients x in units of the columns' lengths, where `‖x‖₁² ≤ p C/λ` and `λ ≥ det/e`: by `4γ C (1 + p e/det)`
    /// for a half of p coefficients.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { controller, denominators, limit, close } = self;
        for (v, denominators) in denominators.iter().enumerate() {
            let mut gram = [[0.0_f32; LANES]; ENTRIES];
            let mut right = [[0.0_f32; LANES]; EVEN + ODD];
            for (row, d) in controller.products.iter().zip(denominators) {
                for n in 0..ENTRIES {
                    for l in 0..LANES {
                        gram[n][l] = row[n].mul_add(d[2][l], gram[n][l]);
                    }
                }
            }
            for ((functions, z), d) in controller.functions.iter().zip(&controller.turned).zip(denominators) {
                let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
                for l in 0..LANES {
                    re[l] = d[0][l].mul_add(z[0], d[1][l] * z[1]);
                    im[l] = d[0][l].mul_add(z[1], -d[1][l] * z[0]);
                }
                for i in 0..EVEN {
                    for l in 0..LANES {
                        right[i][l] = functions[i].mul_add(re[l], right[i][l]);
                    }
                }
                for i in EVEN..EVEN + ODD {
                    for l in 0..LANES {
                        right[i][l] = functions[i].mul_add(im[l], right[i][l]);
                    }
                }
            }
            let mut bound = [0.0_f32; LANES];
            for l in 0..LANES {
                // L D Lᵀ of the halves.
                let [a, b, c, d, e, f] = std::array::from_fn(|n| gram[n][l]);
                let (l_b, l_d) = (b / a, d / a);
                let pivot = c - l_b * b;
                let entry = e - l_b * d;
                let l_e = entry / pivot;
                let last = f - l_d * d - l_e * entry;
                let second = right[1][l] - l_b * right[0][l];
                let third = right[2][l] - l_d * right[0][l] - l_e * second;
                let even = right[0][l] * right[0][l] / a + second * second / pivot + third * third / last;
                let determinant = (pivot / c) * (last / f);
                let [g, h, i] = std::array::from_fn(|n| gram[6 + n][l]);
                let under = i - h / g * h;
                let fourth = right[4][l] - h / g * right[3][l];
                let odd = right[3][l] * right[3][l] / g + fourth * fourth / under;
                // What rounding may add to a determinant is taken off.
                let least = 3e-5;
                let condition = 1.0
                    + (3.0 * E as f32) / (determinant - least).max(0.0)
                    + (2.0 * E as f32) / (under / i - least).max(0.0);
                bound[l] = controller.total - even - odd - controller.margin * condition;
            }
            for (l, bound) in bound.iter().enumerate() {
                // What is no number says nothing.
                if *bound <= limit || bound.is_nan() {
                    close.push((v * LANES + l) as u32);
                }
            }
        }
    }
}

fn main() {
    let smoke = std::env::args().any(|argument| argument == "--smoke");
    let thin = if smoke { json!({"poles": 5, "zeros": 5, "gains": 5}) } else { json!({}) };
    let golden: Value = serde_json::from_str(include_str!("../tests/golden/ssid_examples.json")).unwrap();
    let case = golden["ch3_cases"].as_array().unwrap().iter().find(|case| case["case"] == "late-20%").unwrap();
    let spec: PoolSpec = serde_json::from_value(json!({"name": "zhang2015_appendix_b", "thin": thin})).unwrap();
    let ctl = Ctl::new();
    let plant = System::Continuous(catalogue::two_mass());
    let pool = spec.check(Degrees::default()).unwrap().build(&plant, &ctl).unwrap();
    let omega: Vec<f64> = (0..LINES).map(|k| TAU * (0.1 + 0.025 * k as f64)).collect();
    let pair = |x: &Value| Complex64::new(x[0].as_f64().unwrap(), x[1].as_f64().unwrap());
    let h: Vec<Complex64> = case["H"].as_array().unwrap().iter().map(pair).collect();
    let problem = Problem::new(&Lines::new(&plant, &omega, &h, None), 4).unwrap();

    let begin = Instant::now();
    let clusters = Clusters::new(&problem, &pool, &ctl).unwrap().unwrap();
    let found = SensitivitySearch { clusters: &clusters }.search(&problem, &pool, &ctl).unwrap();
    drop(clusters);
    println!(
        "by bounds:       candidate {} of {} costs {:e}, {} within 1 %; {:.1} s with set-up",
        found.index,
        pool.size(),
        found.cost,
        found.near_optimal,
        begin.elapsed().as_secs_f64()
    );
    let begin = Instant::now();
    let (index, cost, near, evaluated) = all(&problem, &pool, found.cost * 1.01);
    println!(
        "one by one:      candidate {index} costs {cost:e}, {near} within 1 %; {evaluated} again by QR; {:.1} s",
        begin.elapsed().as_secs_f64()
    );
    assert_eq!((index, cost.to_bits(), near), (found.index, found.cost.to_bits(), found.near_optimal), "they differ");
}

/// Lowest index of the smallest cost, how many cost no more than the limit, and how many were evaluated by QR.
fn all(problem: &Problem, pool: &Pool, limit: f64) -> (u64, f64, u64, u64) {
    let reciprocals: Vec<Vec<Complex64>> =
        pool.feedforward().iter().map(|d| problem.reciprocal_at_lines(&d.coefficients)).collect();
    // In units of its largest modulus: the numerator makes up for it.
    let unit = |d: &[Complex64]| 1.0 / d.iter().map(|x| x.norm()).fold(0.0, f64::max);
    let denominators: Vec<Denominators> = reciprocals
        .chunks(LANES)
        .map(|chunk| {
            std::array::from_fn(|k| {
                let at = |l: usize| {
                    let d = &chunk[l.min(chunk.len() - 1)];
                    d[k] * unit(d)
                };
                [
                    std::array::from_fn(|l| at(l).re as f32),
                    std::array::from_fn(|l| at(l).im as f32),
                    std::array::from_fn(|l| at(l).norm_sqr() as f32),
                ]
            })
        })
        .collect();
    let typical: [f64; LINES] = std::array::from_fn(|k| {
        reciprocals.iter().map(|d| (d[k] * unit(d)).norm_sqr()).sum::<f64>() / reciprocals.len() as f64
    });
    let table = pool.feedback();
    let numerators: Vec<Vec<Complex64>> =
        table.numerators().iter().map(|n| problem.at_lines(&n.coefficients)).collect();
    let (begin, done, evaluated) = (Instant::now(), AtomicU64::new(0), AtomicU64::new(0));
    let one_block = |block: usize| {
        let mut best = (f64::INFINITY, u64::MAX);
        let mut near = 0;
        let mut close = Vec::new();
        let mut inverse = (usize::MAX, Vec::new());
        table
            .walk(block, &Ctl::new(), |row| {
                if inverse.0 != row.denominator {
                    let d = &table.denominators()[row.denominator].coefficients;
                    inverse = (row.denominator, problem.reciprocal_at_lines(d));
                }
                for (i, gain) in row.gains.iter().enumerate() {
                    let zero = [Complex64::ZERO; LINES];
                    let numerator = row.numerator.map_or(&zero[..], |n| &numerators[n]);
                    let at: Vec<Complex64> = numerator.iter().zip(&inverse.1).map(|(n, d)| gain * n * d).collect();
                    let controller = Controller::new(problem, &at, &typical);
                    close.clear();
                    let screen = Screen {
                        controller: &controller,
                        denominators: &denominators,
                        limit: (limit as f32).next_up(),
                        close: &mut close,
                    };
                    pulp::Arch::new().dispatch(screen);
                    for place in close.iter().filter(|place| (**place as usize) < reciprocals.len()) {
                        let feedback = volition::identify::pool::Feedback {
                            denominator: row.denominator,
                            numerator: row.numerator,
                            gain: *gain,
                            gain_position: row.positions().get(i).copied(),
                        };
                        let position = Position { feedforward: *place as usize, feedback };
                        let cost = exact::cost(problem, &pool.candidate(position));
                        near += u64::from(cost <= limit);
                        if cost <= best.0 {
                            let index = pool.index(*place as usize, feedback);
                            best = if cost < best.0 || index < best.1 { (cost, index) } else { best };
                        }
                    }
                    evaluated.fetch_add(close.len() as u64, Ordering::Relaxed);
                    done.fetch_add(reciprocals.len() as u64, Ordering::Relaxed);
                }
                Ok(())
            })
            .unwrap();
        if block.is_multiple_of(16) {
            let (done, seconds) = (done.load(Ordering::Relaxed) as f64, begin.elapsed().as_secs_f64());
            eprintln!("{:.1} % after {seconds:.0} s", 100.0 * done / pool.size() as f64);
        }
        (best, near)
    };
    let smaller = |a: (f64, u64), b: (f64, u64)| if b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)).is_lt() { b } else { a };
    let (best, near) = (0..table.blocks())
        .into_par_iter()
        .map(one_block)
        .reduce(|| ((f64::INFINITY, u64::MAX), 0), |a, b| (smaller(a.0, b.0), a.1 + b.1));
    (best.1, best.0, near, evaluated.into_inner())
}
