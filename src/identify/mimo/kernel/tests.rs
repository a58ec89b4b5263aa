use super::*;
use crate::control::{Discrete, Multivariable, StateSpace};
use crate::identify::mimo::lines::{Lines, MatrixFrequencyData};
use crate::identify::mimo::stability::Tester;
use crate::num::rng::stream;
use nalgebra::DMatrix;
use rand::RngExt;

/// The screened cost of every stable candidate lies within its bound of the cost by orthogonalisation, and the bound is
/// tight enough to be of use; data and plants of many sizes, scales and conditions.
#[test]
fn the_screened_cost_errs_by_less_than_its_bound() {
    let (mut candidates, mut loose, mut widths) = (0, 0, Vec::new());
    for seed in 0..60 {
        let mut random = stream(seed, "mimo bound");
        let (m, l) = (random.random_range(1..=MOST_CONTROLS), random.random_range(1..4_usize));
        let states = random.random_range(m..m + 3);
        let outputs = m.max(l);
        let scale = 10.0_f64.powf(random.random_range(-3.0..3.0));
        let mut matrix = |rows: usize, columns: usize, size: f64| {
            DMatrix::from_fn(rows, columns, |_, _| size * random.random_range(-1.0..1.0))
        };
        let time = Discrete::new(0.1).unwrap();
        let model = StateSpace::new(
            matrix(states, states, 0.9),
            matrix(states, m, scale),
            matrix(outputs, states, 1.0),
            DMatrix::zeros(outputs, m),
            time,
        );
        let plant = Multivariable::StateSpace(model.unwrap());
        let axis = |random: &mut crate::num::rng::Stream| {
            let centre = random.random_range(-0.5..0.5) / scale;
            serde_json::json!([centre, centre + 0.4 / scale])
        };
        let numerator: Vec<Vec<_>> = (0..m)
            .map(|i| {
                (0..l)
                    .map(|_| {
                        serde_json::json!([if i + 1 == m {
                            axis(&mut random)
                        } else {
                            serde_json::json!([0.1 / scale])
                        }])
                    })
                    .collect()
            })
            .collect();
        let numerator = serde_json::from_value(serde_json::json!(numerator)).unwrap();
        let pool = FeedbackPool::new(&numerator, None, 0.0, "").unwrap();
        let omega: Vec<f64> = (0..25).map(|k| 0.3 + f64::from(k)).collect();
        let noise = 10.0_f64.powf(random.random_range(-12.0..0.0));
        let h = omega
            .iter()
            .map(|_| {
                DMatrix::from_fn(outputs, l, |_, _| Complex64::new(1.0 + noise * random.random_range(-1.0..1.0), noise))
            })
            .collect();
        let data = MatrixFrequencyData { omega_rad_s: omega, h, variance: None };
        let measured: Vec<usize> = (0..outputs).collect();
        let fed_back: Vec<usize> = (0..l).collect();
        let lines = Lines::new(&plant, &measured, &fed_back, &data, None);
        let problem = Problem::new(lines, random.random_range(0..6), time).unwrap();
        let tester = Tester::new(&pool, &plant, &fed_back);
        let all = pool.candidate(0);
        let (upper, _) = all.split_at(m - 1);
        let mut of_last = tester.last_row(upper);
        let fixed = Fixed::new(&problem, &pool, upper).unwrap();
        let mut scratch = fixed.scratch();
        for index in 0..pool.listed() as u64 {
            let coefficients = pool.candidate(index);
            if !of_last.is_stable(&coefficients[m - 1]) {
                continue;
            }
            let lanes: Vec<V> = coefficients[m - 1].iter().map(|c| [*c; LANES]).collect();
            let screened = fixed.screen(&lanes, &mut scratch);
            let fit = problem.fit(&pool, &coefficients).unwrap();
            candidates += 1;
            if screened.error[0].is_infinite() {
                loose += 1;
                continue;
            }
            let off = (screened.cost[0] - fit.cost).abs();
            assert!(off <= screened.error[0], "seed {seed}, candidate {index}: {off} {}", screened.error[0]);
            let size: f64 = data.h.iter().flatten().map(|v| v.norm_sqr()).sum();
            widths.push(screened.error[0] / size);
        }
    }
    assert!(candidates > 100 && loose * 5 < candidates, "{loose} of {candidates}");
    widths.sort_by(f64::total_cmp);
    let at = |share: f64| widths[(share * widths.len() as f64) as usize];
    assert!(at(0.5) < 1e-8 && at(0.9) < 1e-4, "{} {}", at(0.5), at(0.9));
}
