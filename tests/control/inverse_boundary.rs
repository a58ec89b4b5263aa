//! Verdicts of optimality: the cases of the reference, and every class of gain with fresh members.
#![allow(non_snake_case)]

use crate::boundary_gains::{mixed, of_output, open, optimal_of_several, second_order, touching};
use crate::gain_classes::{Member, clock_of, definite, large, random, stabilising, truth};
use nalgebra::DMatrix;
use rand::RngExt;
use serde_json::Value;
use volition::control::lqg::lqr;
use volition::control::lyapunov::Clock;
use volition::ctl::Ctl;
use volition::inverse::lqr::{decision, gain_factor};
use volition::inverse::{Decision, Evidence, Gains, GainsError, Knowledge, Settings, Verdict, inverse_lqr};
use volition::num::rng::{self, Stream};

const MEMBERS: usize = 300;
pub(crate) const SEED: u64 = 20_261_130;

pub(crate) fn mat(value: &Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).unwrap();
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
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
    let (mut largest, mut farthest) = (0.0_f64, String::new());
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
        let ratio = found.ratio.map_or(0.0, f64::abs);
        if expected == Verdict::Boundary && ratio > largest {
            largest = ratio;
            farthest = format!("n = {}, {clock:?}, {:?}", a.nrows(), found.evidence);
        }
    }
    eprintln!(
        "{name}: feasible, infeasible, boundary {counts:?}; largest ratio on the boundary {largest:.3}: {farthest}"
    );
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

#[test]
fn optimal_gains_of_several_inputs() {
    class("several inputs", |stream| {
        let n = stream.random_range(2..=8usize);
        let m = stream.random_range(2..=n.min(4));
        Some((optimal_of_several(n, m, stream)?, Verdict::Feasible))
    });
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

/// Up to 64 states and eight inputs; `cargo bench --bench inverse -- --full` asks 300 of them. A certificate may be
/// missing at these sizes (docs/limits.md); then the verdict is the boundary without evidence, and never the other
/// side.
#[test]
fn large_loops_of_several_inputs() {
    let mut stream = rng::stream(SEED, "large loops");
    let (mut decided_ones, mut without) = (0, 0);
    for round in 0..24 {
        let expected = if round % 2 == 0 { Verdict::Feasible } else { Verdict::Infeasible };
        let Some(member) = large(expected, &mut stream) else { continue };
        let found = match decided(&member, round) {
            Ok(found) => found,
            Err(GainsError::MarginalLoop { .. } | GainsError::UnstableLoop { .. }) => continue,
            Err(error) => panic!("{round}: {error}"),
        };
        if found.verdict == Verdict::Boundary && found.evidence == Evidence::None {
            without += 1;
            continue;
        }
        assert_eq!(found.verdict, expected, "{round}: n = {}, {:?}", member.a.nrows(), member.clock);
        decided_ones += 1;
    }
    eprintln!("{decided_ones} large loops decided, {without} without a certificate");
    assert!(decided_ones >= 18, "{decided_ones} {without}");
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

/// With several inputs c* is certified on both sides: verdicts a little above and below it differ.
#[test]
fn the_factor_of_several_inputs_lies_between_two_certificates() {
    let mut stream = rng::stream(SEED, "factor of several inputs");
    let (mut checked, mut infeasible) = (0, 0);
    for _ in 0..60 {
        let n = stream.random_range(2..=5usize);
        let m = stream.random_range(2..=n.min(3));
        let clock = if stream.random::<bool>() { Clock::Continuous } else { Clock::Sampled };
        let mut draw = |rows, columns| DMatrix::from_fn(rows, columns, |_, _| stream.random_range(-1.0..1.0));
        let (a, b, q, r) = (draw(n, n), draw(n, m), draw(n, n), draw(m, m));
        let definite = |m: &DMatrix<f64>| m * m.transpose() + DMatrix::identity(m.nrows(), m.nrows()) * 0.1;
        let Ok(solution) = lqr(&a, &b, &definite(&q), &definite(&r), clock) else { continue };
        let ask = |c: f64| {
            let gains = Gains::regulator(&a, &b, &(&solution.k * c), clock).ok()?;
            let mut answer = inverse_lqr(&gains, &Settings::default(), &Ctl::new()).ok()?;
            answer.decision.factor = gain_factor(&gains, &answer.decision, &Ctl::new()).unwrap();
            Some(answer)
        };
        let Some(factor) = ask(1.0).unwrap().decision.factor else { continue };
        assert!(factor <= 1.0, "an optimal gain has its factor below 1: {factor}");
        // The loop of half the gain may be unstable: then there is no question.
        for (share, expected) in [(1.01, Verdict::Feasible), (0.99, Verdict::Infeasible)] {
            let Some(answer) = ask(factor * share) else { continue };
            assert_eq!(answer.decision.verdict, expected, "{share} {factor}: {:?}", answer.decision);
            infeasible += usize::from(expected == Verdict::Infeasible);
            // Found from there too, and the same.
            let again = answer.decision.factor.unwrap() * factor * share;
            assert!((again / factor - 1.0).abs() < 3e-3, "{again} {factor}");
        }
        checked += 1;
    }
    eprintln!("{checked} factors, {infeasible} with a stable loop below");
    assert!(checked >= 20 && infeasible >= 5, "{checked} {infeasible}");
}
