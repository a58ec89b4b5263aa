//! Certificates of verdicts, checked in rational arithmetic.

use crate::boundary_gains::optimal_of_several;
use crate::exact;
use crate::gain_classes::Member;
use crate::gain_classes::{random, stabilising};
use crate::inverse_boundary::SEED;
use nalgebra::DMatrix;
use num_rational::BigRational;
use num_traits::{One, Signed, Zero};
use rand::RngExt;
use volition::control::lyapunov::Clock;
use volition::ctl::Ctl;
use volition::inverse::lqr::decision;
use volition::inverse::{Evidence, Gains, Verdict};
use volition::num::rng;

/// Whether P and R prove that K, or one within the box, is optimal: in rational arithmetic.
fn proves_feasible(member: &Member, bounds: &DMatrix<f64>, p: &DMatrix<f64>, r: &DMatrix<f64>) -> bool {
    let (a, b, k) = (exact::exact(&member.a), exact::exact(&member.b), exact::exact(&member.k));
    let (p, r) = (exact::exact(p), exact::exact(r));
    let (n, m) = (a.len(), r.len());
    let closed = exact::combined(&a, &exact::product(&b, &k), -1);
    // BᵀP = R·(K, or K A_c⁻¹).
    let gain = match member.clock {
        Clock::Continuous => k.clone(),
        Clock::Sampled => exact::transpose(&exact::solve(&exact::transpose(&closed), &exact::transpose(&k)).unwrap()),
    };
    let product = exact::product(&gain, &b);
    // R moved to where R·product is symmetric: the least change, by its normal equations over antisymmetric matrices.
    let pairs: Vec<(usize, usize)> = (0..m).flat_map(|j| (0..j).map(move |i| (i, j))).collect();
    let antisymmetric = |r: &exact::Matrix| -> Vec<BigRational> {
        let half = exact::product(r, &product);
        pairs.iter().map(|(i, j)| &half[*i][*j] - &half[*j][*i]).collect()
    };
    let units: Vec<exact::Matrix> = (0..m)
        .flat_map(|j| (0..=j).map(move |i| (i, j)))
        .map(|(i, j)| {
            let mut unit = vec![vec![BigRational::zero(); m]; m];
            unit[i][j] = BigRational::one();
            unit[j][i] = BigRational::one();
            unit
        })
        .collect();
    let columns: Vec<Vec<BigRational>> = units.iter().map(&antisymmetric).collect();
    let normal: exact::Matrix = (0..pairs.len())
        .map(|x| (0..pairs.len()).map(|y| columns.iter().map(|c| &c[x] * &c[y]).sum()).collect())
        .collect();
    let missing: exact::Matrix = antisymmetric(&r).into_iter().map(|v| vec![-v]).collect();
    let mut r = r;
    if !pairs.is_empty() {
        let Some(multipliers) = exact::solve(&normal, &missing) else { return false };
        for (unit, column) in units.iter().zip(&columns) {
            let step: BigRational = column.iter().zip(&multipliers).map(|(c, l)| c * &l[0]).sum();
            for (row, unit_row) in r.iter_mut().zip(unit) {
                row.iter_mut().zip(unit_row).for_each(|(v, u)| *v += &step * u);
            }
        }
    }
    // P moved to where the equality holds: B⁺ᵀE + EᵀB⁺ − B⁺ᵀ(EB)B⁺.
    let bt = exact::transpose(&b);
    let e = exact::combined(&exact::product(&r, &gain), &exact::product(&bt, &p), -1);
    let pseudo = exact::solve(&exact::product(&bt, &b), &bt).unwrap();
    let half = exact::product(&exact::transpose(&pseudo), &e);
    let inner = exact::product(&exact::product(&half, &b), &pseudo);
    let p = exact::combined(&exact::combined(&exact::combined(&p, &half, 1), &exact::transpose(&half), 1), &inner, -1);
    assert_eq!(exact::product(&bt, &p), exact::product(&r, &gain), "the equality holds exactly");
    let krk = exact::product(&exact::transpose(&k), &exact::product(&r, &k));
    let closed_t = exact::transpose(&closed);
    let q = match member.clock {
        Clock::Continuous => {
            let left = exact::product(&closed_t, &p);
            let zero = vec![vec![BigRational::zero(); n]; n];
            let sum = exact::combined(&exact::combined(&zero, &left, -1), &exact::transpose(&left), -1);
            exact::combined(&sum, &krk, -1)
        }
        Clock::Sampled => {
            let moved = exact::product(&closed_t, &exact::product(&p, &closed));
            exact::combined(&exact::combined(&p, &moved, -1), &krk, -1)
        }
    };
    assert!(bounds.iter().all(|v| *v >= 0.0));
    exact::is_definite(&r) && exact::is_definite(&q)
}

/// X and T of a multiplier, in rational arithmetic.
pub fn multiplied(member: &Member, n: &DMatrix<f64>) -> [exact::Matrix; 2] {
    let (a, b, k) = (exact::exact(&member.a), exact::exact(&member.b), exact::exact(&member.k));
    let n = exact::exact(n);
    let size = a.len();
    let closed = exact::combined(&a, &exact::product(&b, &k), -1);
    let closed_t = exact::transpose(&closed);
    let source = match member.clock {
        Clock::Continuous => exact::product(&b, &n),
        Clock::Sampled => exact::product(&exact::product(&b, &n), &closed_t),
    };
    let source = exact::combined(&source, &exact::transpose(&source), 1);
    let pairs: Vec<(usize, usize)> = (0..size).flat_map(|j| (0..=j).map(move |i| (i, j))).collect();
    let mut rows = vec![Vec::new(); pairs.len()];
    for (i, j) in &pairs {
        let mut unit = vec![vec![BigRational::zero(); size]; size];
        unit[*i][*j] = BigRational::one();
        unit[*j][*i] = BigRational::one();
        let image = match member.clock {
            Clock::Continuous => {
                let half = exact::product(&closed, &unit);
                exact::combined(&half, &exact::transpose(&half), 1)
            }
            Clock::Sampled => exact::combined(&exact::product(&closed, &exact::product(&unit, &closed_t)), &unit, -1),
        };
        for (row, (x, y)) in rows.iter_mut().zip(&pairs) {
            row.push(image[*x][*y].clone());
        }
    }
    let right: exact::Matrix = pairs.iter().map(|(x, y)| vec![source[*x][*y].clone()]).collect();
    let solution = exact::solve(&rows, &right).unwrap();
    let mut x = vec![vec![BigRational::zero(); size]; size];
    for ((i, j), v) in pairs.iter().zip(&solution) {
        x[*i][*j] = v[0].clone();
        x[*j][*i] = v[0].clone();
    }
    let half = exact::product(&n, &exact::transpose(&k));
    let kxk = exact::product(&k, &exact::product(&x, &exact::transpose(&k)));
    let t = exact::combined(&exact::combined(&kxk, &half, 1), &exact::transpose(&half), 1);
    [x, t]
}

/// Whether N proves that no weights exist, in rational arithmetic.
fn proves_infeasible(member: &Member, n: &DMatrix<f64>) -> bool {
    let [x, mut t] = multiplied(member, n);
    // R of a condition number up to 1e5 in the units of the plant, a little less than what was promised.
    let m = t.len() as i64;
    let floor = BigRational::new(1.into(), 100_000.into());
    let trace: BigRational = t.iter().enumerate().map(|(i, row)| row[i].clone()).sum();
    let share = BigRational::from_integer(m.into()) * (BigRational::one() - &floor);
    let lift = floor * trace / share;
    t.iter_mut().enumerate().for_each(|(i, row)| row[i] += &lift);
    exact::is_definite(&x) && exact::is_definite(&t)
}

/// Whether Ω proves that no R makes R·M symmetric, in rational arithmetic.
fn proves_no_weight(member: &Member, omega: &DMatrix<f64>) -> bool {
    let (a, b, k) = (exact::exact(&member.a), exact::exact(&member.b), exact::exact(&member.k));
    let closed = exact::combined(&a, &exact::product(&b, &k), -1);
    let columns = match member.clock {
        Clock::Continuous => b,
        Clock::Sampled => exact::solve(&closed, &b).unwrap(),
    };
    let product = exact::product(&k, &columns);
    let omega = exact::exact(omega);
    assert_eq!(exact::transpose(&omega), exact::combined(&exact::combined(&omega, &omega, -1), &omega, -1));
    let half = exact::product(&omega, &exact::transpose(&product));
    let mut t = exact::combined(&half, &exact::transpose(&half), 1);
    let m = t.len() as i64;
    let floor = BigRational::new(1.into(), 100_000.into());
    let trace: BigRational = t.iter().enumerate().map(|(i, row)| row[i].clone()).sum();
    let lift = &floor * trace / (BigRational::from_integer(m.into()) * (BigRational::one() - &floor));
    t.iter_mut().enumerate().for_each(|(i, row)| row[i] += &lift);
    exact::is_definite(&t)
}

#[test]
fn certificates_of_several_inputs_hold_in_rational_arithmetic() {
    let mut stream = rng::stream(SEED, "certificates");
    let mut counts = [0, 0];
    while counts.iter().sum::<usize>() < 100 {
        let n = stream.random_range(2..=4usize);
        let m = stream.random_range(2..=n.min(3));
        let Some(mut member) = optimal_of_several(n, m, &mut stream) else { continue };
        if counts[0] >= 50 {
            let size = member.k.norm() * 0.3;
            member.k += random(m, n, &mut stream) * size;
        }
        let Ok(gains) = Gains::regulator(&member.a, &member.b, &member.k, member.clock) else { continue };
        let found = decision(&gains, &Ctl::new()).unwrap();
        match &found.evidence {
            Evidence::Weights { p: Some(p), r } => {
                assert!(proves_feasible(&member, &gains.rounding().unwrap(), p, r), "{found:?}");
                counts[0] += 1;
            }
            Evidence::Multiplier { n: Some(n), .. } => {
                assert!(proves_infeasible(&member, n), "{found:?}");
                counts[1] += 1;
            }
            Evidence::Coupling { omega } => {
                assert!(proves_no_weight(&member, omega), "{found:?}");
                counts[1] += 1;
            }
            _ => {}
        }
    }
    assert!(counts[1] >= 30, "{counts:?}");
}

#[test]
fn the_frequency_of_an_infeasible_gain_is_a_proof() {
    let mut stream = rng::stream(SEED, "frequencies");
    let mut proven = 0;
    while proven < 40 {
        let Some(member) = stabilising(&mut stream) else { continue };
        let Ok(gains) = Gains::regulator(&member.a, &member.b, &member.k, member.clock) else { continue };
        let found = decision(&gains, &Ctl::new()).unwrap();
        let Evidence::ReturnDifference { omega, .. } = found.evidence else { continue };
        if found.verdict != Verdict::Infeasible || !omega.is_finite() || member.clock == Clock::Sampled {
            continue;
        }
        let square = BigRational::from_float(omega * omega).unwrap();
        let a = exact::exact(&member.a);
        let closed = exact::combined(&a, &exact::product(&exact::exact(&member.b), &exact::exact(&member.k)), -1);
        let at = |m: &exact::Matrix| exact::value(&exact::on_axis(&exact::characteristic(m)), &square);
        assert!((at(&closed) - at(&a)).is_negative(), "{found:?}");
        proven += 1;
    }
}
