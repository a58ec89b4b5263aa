//! Verdicts of optimality: the cases of the reference, every class of gain with fresh members, and certificates
//! checked in rational arithmetic.
#![allow(non_snake_case)]

use crate::boundary_gains::{Member, of_output, open, rotation, touching, truth};
use crate::exact;
use nalgebra::DMatrix;
use num_rational::BigRational;
use num_traits::{One, Signed, Zero};
use rand::RngExt;
use serde_json::Value;
use volition::control::lqg::lqr;
use volition::control::lyapunov::Clock;
use volition::ctl::Ctl;
use volition::inverse::lqr::decision;
use volition::inverse::{Decision, Evidence, Gains, GainsError, Knowledge, Verdict};
use volition::num::linalg::eigenvalues;
use volition::num::rng::{self, Stream};

const MEMBERS: usize = 300;
const SEED: u64 = 20_261_130;

fn mat(value: &Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).unwrap();
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

fn random(rows: usize, columns: usize, stream: &mut Stream) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| stream.random_range(-1.0..1.0))
}

fn definite(n: usize, least: f64, stream: &mut Stream) -> DMatrix<f64> {
    let root = random(n, n, stream);
    &root * root.transpose() + DMatrix::identity(n, n) * least
}

fn clock_of(stream: &mut Stream) -> Clock {
    if stream.random::<bool>() { Clock::Continuous } else { Clock::Sampled }
}

/// Every second member is asked as a filter.
fn decided(member: &Member, round: usize) -> Result<Decision, GainsError> {
    let Member { a, b, k, clock } = member;
    let gains = if round.is_multiple_of(2) {
        Gains::regulator(a, b, k, *clock)?
    } else {
        Gains::filter(&a.transpose(), &b.transpose(), &k.transpose(), *clock)?
    };
    Ok(decision(&gains, &Ctl::new()).unwrap())
}

/// Draws members until there are enough, and compares with what each must be.
fn class(name: &str, mut draw: impl FnMut(&mut Stream) -> Option<(Member, Verdict)>) {
    let mut stream = rng::stream(SEED, name);
    let mut counts = [0; 3];
    let mut largest: f64 = 0.0;
    let mut round = 0;
    while counts.iter().sum::<usize>() < MEMBERS {
        round += 1;
        assert!(round < 8 * MEMBERS, "{name}: {counts:?}");
        let Some((member, expected)) = draw(&mut stream) else { continue };
        let found = match decided(&member, round) {
            Ok(found) => found,
            // Refused as too near to instability, which is honest and no verdict.
            Err(GainsError::MarginalLoop { .. } | GainsError::UnstableLoop { .. }) => continue,
            Err(error) => panic!("{name} {round}: {error}"),
        };
        let Member { a, b, k, clock } = &member;
        assert_eq!(found.verdict, expected, "{name} {round}: {found:?}\n{a}{b}{k}{clock:?}");
        counts[expected as usize] += 1;
        if expected == Verdict::Boundary {
            largest = largest.max(found.ratio.map_or(0.0, f64::abs));
        }
    }
    eprintln!("{name}: feasible, infeasible, boundary {counts:?}; largest ratio on the boundary {largest:.3}");
}

fn second_order(a: [f64; 2], k: [f64; 2]) -> Member {
    Member {
        a: DMatrix::from_row_slice(2, 2, &[0.0, 1.0, a[0], a[1]]),
        b: DMatrix::from_row_slice(2, 1, &[0.0, 1.0]),
        k: DMatrix::from_row_slice(1, 2, &k),
        clock: Clock::Continuous,
    }
}

#[test]
fn cases_of_the_reference_have_their_verdicts_in_both_roles() {
    let golden: Value = serde_json::from_str(include_str!("../golden/inverse_boundary.json")).unwrap();
    let cases = golden["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 137);
    for case in cases {
        let clock = if case["sample_time_s"].is_null() { Clock::Continuous } else { Clock::Sampled };
        let member = Member { a: mat(&case["a"]), b: mat(&case["b"]), k: mat(&case["k"]), clock };
        for round in 0..2 {
            let found = decided(&member, round).unwrap_or_else(|error| panic!("{}: {error}", case["name"]));
            let verdict = format!("{:?}", found.verdict).to_lowercase();
            assert_eq!(verdict, case["truth"].as_str().unwrap(), "{}: {found:?}", case["name"]);
            // Where the case says at which frequency and how far.
            if let (Some(at), Evidence::ReturnDifference { value, rounding, .. }) =
                (case["at"].as_f64(), &found.evidence)
            {
                assert!(at.is_finite() && value < &-rounding, "{}: {found:?}", case["name"]);
            }
        }
    }
}

#[test]
fn integer_gains_on_the_boundary() {
    class("integer gains", |stream| {
        let a = f64::from(stream.random_range(1..=100));
        let least = (2.0 * f64::sqrt(a)).ceil();
        let k2 = least + f64::from(stream.random_range(0..=40));
        Some((second_order([a, 0.0], [2.0 * a, k2]), Verdict::Boundary))
    });
}

#[test]
fn costs_of_velocity_alone_and_of_position_alone() {
    class("velocity alone", |stream| {
        let (a1, a2) = (10f64.powf(stream.random_range(-1.0..2.0)), stream.random_range(-3.0..3.0_f64));
        let q = 10f64.powf(stream.random_range(-2.0..4.0));
        let k1 = 2.0 * a1;
        Some((second_order([a1, a2], [k1, a2 + (a2 * a2 + 2.0 * k1 + q).sqrt()]), Verdict::Boundary))
    });
    class("position alone", |stream| {
        let (a1, a2) = (stream.random_range(-20.0..20.0_f64), stream.random_range(-3.0..3.0_f64));
        let q = 10f64.powf(stream.random_range(-2.0..4.0));
        let k1 = a1 + a1.hypot(q.sqrt());
        Some((second_order([a1, a2], [k1, a2 + (a2 * a2 + 2.0 * k1).sqrt()]), Verdict::Boundary))
    });
}

#[test]
fn gains_of_least_energy() {
    class("least energy", |stream| {
        let n = stream.random_range(2..=5);
        let clock = clock_of(stream);
        let roots: Vec<f64> = (0..n)
            .map(|i| match clock {
                Clock::Continuous => stream.random_range(0.2..2.0) * if i == 0 || stream.random() { 1.0 } else { -1.0 },
                Clock::Sampled => {
                    let size: f64 = stream.random_range(1.1..1.8);
                    if i == 0 || stream.random() { size } else { 1.0 / size }
                }
            })
            .collect();
        // Unstable roots are mirrored, in double-double by the product of few factors: each coefficient is right to
        // some units of rounding.
        let product = |roots: &[f64]| {
            roots.iter().fold(vec![1.0], |p: Vec<f64>, r| {
                let mut next = vec![0.0; p.len() + 1];
                for (i, c) in p.iter().enumerate() {
                    next[i + 1] += c;
                    next[i] -= r * c;
                }
                next
            })
        };
        let mirrored: Vec<f64> = roots
            .iter()
            .map(|r| match clock {
                Clock::Continuous => -r.abs(),
                Clock::Sampled => {
                    if r.abs() > 1.0 {
                        1.0 / r
                    } else {
                        *r
                    }
                }
            })
            .collect();
        let (open, closed) = (product(&roots), product(&mirrored));
        let a = DMatrix::from_fn(n, n, |i, j| if i + 1 < n { f64::from(u8::from(j == i + 1)) } else { -open[j] });
        let b = DMatrix::from_fn(n, 1, |i, _| f64::from(u8::from(i + 1 == n)));
        let k = DMatrix::from_fn(1, n, |_, j| closed[j] - open[j]);
        Some((Member { a, b, k, clock }, Verdict::Boundary))
    });
}

#[test]
fn return_differences_that_touch_one_at_one_frequency() {
    class("touching", |stream| {
        let n = stream.random_range(2..=6);
        let clock = clock_of(stream);
        let (plant, output) = (open(n, clock, stream), touching(n, clock, stream));
        let member = of_output(&plant, &output, clock)?;
        let member = if stream.random() { member.rotated(stream) } else { member };
        Some((member, Verdict::Boundary))
    });
}

#[test]
fn optimal_gains_in_any_units() {
    class("optimal", |stream| {
        let n = stream.random_range(2..=8);
        let clock = clock_of(stream);
        let (a, b) = (random(n, n, stream), random(n, 1, stream));
        let r = DMatrix::from_element(1, 1, 10f64.powf(stream.random_range(-2.0..2.0)));
        let k = lqr(&a, &b, &definite(n, 0.1, stream), &r, clock).ok()?.k;
        let spread = if stream.random() { 3.0 } else { 0.0 };
        let unit: Vec<f64> = (0..n).map(|_| 10f64.powf(spread * stream.random_range(-1.0..=1.0))).collect();
        let a = DMatrix::from_fn(n, n, |i, j| a[(i, j)] * unit[i] / unit[j]);
        let b = DMatrix::from_fn(n, 1, |i, _| b[i] * unit[i]);
        let k = DMatrix::from_fn(1, n, |_, j| k[j] / unit[j]);
        Some((Member { a, b, k, clock }, Verdict::Feasible))
    });
}

fn stabilising(stream: &mut Stream) -> Option<Member> {
    let n = stream.random_range(2..=6);
    let clock = clock_of(stream);
    let (a, b) = (random(n, n, stream), random(n, 1, stream));
    let near = lqr(&a, &b, &DMatrix::identity(n, n), &DMatrix::identity(1, 1), clock).ok()?.k;
    let size = near.norm() * stream.random_range(0.0..0.8);
    let k = &near + random(1, n, stream) * size;
    let poles = eigenvalues(&(&a - &b * &k)).unwrap();
    poles.iter().all(|pole| clock.margin(*pole) > 1e-6).then_some(Member { a, b, k, clock })
}

#[test]
fn random_stabilising_gains_against_rational_arithmetic() {
    class("stabilising", |stream| {
        let member = stabilising(stream)?;
        let expected = truth(&member);
        Some((member, expected))
    });
}

#[test]
fn what_no_input_reaches_does_not_change_the_verdict() {
    class("unreached", |stream| {
        let core = stabilising(stream)?;
        let expected = truth(&core);
        let (n, more) = (core.a.nrows(), stream.random_range(1..=2usize));
        let clock = core.clock;
        let is_target = stream.random::<bool>();
        let lasting = if clock == Clock::Continuous { 0.0 } else { 1.0 };
        let mut unreached = DMatrix::zeros(more, more);
        for i in 0..more {
            unreached[(i, i)] = match (is_target, clock) {
                (true, _) => lasting,
                (false, Clock::Continuous) => -stream.random_range(0.1..2.0),
                (false, Clock::Sampled) => stream.random_range(-0.9..0.9),
            };
        }
        let coupling = random(n, more, stream);
        let k_u = if is_target {
            // X and K_u with KV = 0: A X + A₁₂ = X A_u.
            let x = random(n, more, stream);
            let moved = &x * &unreached - &core.a * &x;
            (-(&core.k * x), Some(moved))
        } else {
            (random(1, more, stream), None)
        };
        let coupling = k_u.1.unwrap_or(coupling);
        let size = n + more;
        let mut a = DMatrix::zeros(size, size);
        a.view_mut((0, 0), (n, n)).copy_from(&core.a);
        a.view_mut((0, n), (n, more)).copy_from(&coupling);
        a.view_mut((n, n), (more, more)).copy_from(&unreached);
        let mut b = DMatrix::zeros(size, 1);
        b.rows_mut(0, n).copy_from(&core.b);
        let mut k = DMatrix::zeros(1, size);
        k.columns_mut(0, n).copy_from(&core.k);
        k.columns_mut(n, more).copy_from(&k_u.0);
        Some((Member { a, b, k, clock }.rotated(stream), expected))
    });
}

#[test]
fn loops_that_are_stable_only_within_rounding_are_refused() {
    let mut stream = rng::stream(SEED, "marginal");
    for round in 0..MEMBERS {
        let n = stream.random_range(2..=5);
        let clock = clock_of(&mut stream);
        let plant = open(n, clock, &mut stream);
        // d_closed has a root on the boundary, the others inside.
        let mut closed = vec![1.0];
        let edge = match clock {
            Clock::Continuous => 0.0,
            Clock::Sampled => {
                if stream.random() {
                    1.0
                } else {
                    -1.0
                }
            }
        };
        for i in 0..n {
            let root = match clock {
                _ if i == 0 => edge,
                Clock::Continuous => -stream.random_range(0.3..2.0),
                Clock::Sampled => stream.random_range(-0.8..0.8),
            };
            let mut next = vec![0.0; closed.len() + 1];
            for (i, c) in closed.iter().enumerate() {
                next[i + 1] += c;
                next[i] -= root * c;
            }
            closed = next;
        }
        let a = DMatrix::from_fn(n, n, |i, j| if i + 1 < n { f64::from(u8::from(j == i + 1)) } else { -plant[j] });
        let b = DMatrix::from_fn(n, 1, |i, _| f64::from(u8::from(i + 1 == n)));
        let k = DMatrix::from_fn(1, n, |_, j| closed[j] - plant[j]);
        let member = Member { a, b, k, clock }.rotated(&mut stream);
        let found = decided(&member, round);
        assert!(
            matches!(found, Err(GainsError::MarginalLoop { .. } | GainsError::UnstableLoop { .. })),
            "{round}: {found:?}"
        );
    }
}

fn optimal_of_several(n: usize, m: usize, stream: &mut Stream) -> Option<Member> {
    let clock = clock_of(stream);
    let (a, b) = (random(n, n, stream), random(n, m, stream));
    let k = lqr(&a, &b, &definite(n, 0.1, stream), &definite(m, 0.1, stream), clock).ok()?.k;
    Some(Member { a, b, k, clock })
}

#[test]
fn optimal_gains_of_several_inputs() {
    class("several inputs", |stream| {
        let n = stream.random_range(2..=8usize);
        let m = stream.random_range(2..=n.min(4));
        Some((optimal_of_several(n, m, stream)?, Verdict::Feasible))
    });
}

/// Channels side by side, mixed by rotations of states and inputs: as good as the worst.
fn mixed(worst: Verdict, stream: &mut Stream) -> Option<Member> {
    let channels = stream.random_range(2..=3usize);
    let which = stream.random_range(0..channels);
    let mut parts = Vec::new();
    for channel in 0..channels {
        let member = if channel != which {
            let a = stream.random_range(0.2..2.0_f64);
            let (q, d) = (stream.random_range(0.5..5.0_f64), stream.random_range(0.5..4.0_f64));
            let k1 = a + a.hypot(q.sqrt());
            second_order([a, 0.0], [k1, (2.0 * k1 + d).sqrt()])
        } else {
            let a = stream.random_range(0.2..2.0_f64);
            // k₁ = 2a is the boundary; below it no weight on the position is negative enough.
            let share = match worst {
                Verdict::Boundary => 2.0,
                _ => stream.random_range(1.1..1.9),
            };
            second_order([a, 0.0], [share * a, (8.0 * a + stream.random_range(0.5..4.0)).sqrt()])
        };
        parts.push(member);
    }
    let (n, m) = (2 * channels, channels);
    let (mut a, mut b, mut k) = (DMatrix::zeros(n, n), DMatrix::zeros(n, m), DMatrix::zeros(m, n));
    for (i, part) in parts.iter().enumerate() {
        a.view_mut((2 * i, 2 * i), (2, 2)).copy_from(&part.a);
        b.view_mut((2 * i, i), (2, 1)).copy_from(&part.b);
        k.view_mut((i, 2 * i), (1, 2)).copy_from(&part.k);
    }
    let turn = rotation(m, stream);
    let whole = Member { a, b: b * turn.transpose(), k: turn * k, clock: Clock::Continuous };
    Some(whole.rotated(stream))
}

#[test]
fn one_channel_that_is_not_optimal_makes_the_whole_so() {
    class("one channel not optimal", |stream| Some((mixed(Verdict::Infeasible, stream)?, Verdict::Infeasible)));
    class("one channel on the boundary", |stream| Some((mixed(Verdict::Boundary, stream)?, Verdict::Boundary)));
}

#[test]
fn equal_and_complex_eigenvalues_of_the_gain_times_the_input() {
    let one = DMatrix::<f64>::identity(2, 2);
    let ask = |k: &[f64], clock| {
        let k = DMatrix::from_row_slice(2, 2, k);
        decision(&Gains::regulator(&one, &one, &k, clock).unwrap(), &Ctl::new()).unwrap()
    };
    assert_eq!(ask(&[3.0, 0.0, 0.0, 3.0], Clock::Continuous).verdict, Verdict::Feasible);
    // A gain that is optimal for no ε but 0, and none that is.
    for epsilon in [1e-4, 1e-10] {
        let found = ask(&[3.0, epsilon, -epsilon, 3.0], Clock::Continuous);
        assert_eq!(found.verdict, Verdict::Infeasible, "{epsilon:e}: {found:?}");
    }
    assert_ne!(ask(&[3.0, 1e-17, -1e-17, 3.0], Clock::Continuous).verdict, Verdict::Infeasible);
    assert_eq!(ask(&[3.0, 0.0, 0.0, 1.5], Clock::Continuous).verdict, Verdict::Infeasible);
    assert_eq!(ask(&[3.0, 0.0, 0.0, 2.0], Clock::Continuous).verdict, Verdict::Boundary);
}

#[test]
fn a_large_loop_with_eight_inputs_is_decided() {
    let mut stream = rng::stream(SEED, "large");
    let (n, m) = (32, 8);
    let a = random(n, n, &mut stream) * 0.3;
    let b = random(n, m, &mut stream);
    let k = lqr(&a, &b, &definite(n, 0.1, &mut stream), &definite(m, 0.3, &mut stream), Clock::Continuous).unwrap().k;
    let ask =
        |k: &DMatrix<f64>| decision(&Gains::regulator(&a, &b, k, Clock::Continuous).unwrap(), &Ctl::new()).unwrap();
    assert_eq!(ask(&k).verdict, Verdict::Feasible);
    // Half of an optimal gain still stabilises, and is too feeble to be optimal itself.
    let found = ask(&(&k * 0.55));
    assert_eq!(found.verdict, Verdict::Infeasible);
    assert!(found.relative_change.unwrap() < 0.9, "{:?}", found.relative_change);
}

#[test]
fn a_gain_known_to_few_digits_is_on_the_boundary() {
    let mut stream = rng::stream(SEED, "digits");
    for digits in [4, 6] {
        for _ in 0..40 {
            let (a1, a2) = (stream.random_range(-20.0..20.0_f64), stream.random_range(-3.0..3.0_f64));
            let k1 = a1 + a1.hypot(stream.random_range(0.3..30.0_f64));
            let member = second_order([a1, a2], [k1, a2 + (a2 * a2 + 2.0 * k1).sqrt()]);
            let unit = member.k.map(|v| 10f64.powi(v.abs().log10().floor() as i32 + 1 - digits));
            let k = member.k.zip_map(&unit, |v, u| (v / u).round() * u);
            let known = Knowledge { gain_rounding: Some(unit * 0.5), ..Knowledge::default() };
            let Ok(gains) = Gains::regulator_with(&member.a, &member.b, &k, member.clock, &known) else { continue };
            let found = decision(&gains, &Ctl::new()).unwrap();
            assert_eq!(found.verdict, Verdict::Boundary, "{digits}: {found:?} {k}");
        }
    }
}

#[test]
fn the_factor_of_the_whole_gain_is_where_it_becomes_optimal() {
    let mut stream = rng::stream(SEED, "factor");
    let mut checked = 0;
    while checked < 20 {
        let Some(member) = stabilising(&mut stream) else { continue };
        let Ok(gains) = Gains::regulator(&member.a, &member.b, &member.k, member.clock) else { continue };
        let Some(factor) = decision(&gains, &Ctl::new()).unwrap().factor else { continue };
        for (share, expected) in [(1.00001, Verdict::Feasible), (0.99999, Verdict::Infeasible)] {
            let k = &member.k * (factor * share);
            let Ok(gains) = Gains::regulator(&member.a, &member.b, &k, member.clock) else { continue };
            assert_eq!(decision(&gains, &Ctl::new()).unwrap().verdict, expected, "{share} {factor}");
        }
        checked += 1;
    }
}

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

/// Whether N proves that no weights exist, in rational arithmetic.
fn proves_infeasible(member: &Member, n: &DMatrix<f64>) -> bool {
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
    let mut t = exact::combined(&exact::combined(&kxk, &half, 1), &exact::transpose(&half), 1);
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
