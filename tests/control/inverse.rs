//! Inverse optimal control against the reference's worked examples, and on random plants.
#![allow(non_snake_case)]

use nalgebra::DMatrix;
use serde_json::Value;
use std::sync::LazyLock;
use volition::control::lqg::{kalman, lqr};
use volition::control::lyapunov::Clock;
use volition::ctl::Ctl;
use volition::inverse::estimator::inverse_lqg;
use volition::inverse::fit::{DescentSettings, Evaluation, FitSettings, Objective, descent, fit, smallest_cross_term};
use volition::inverse::lqr::InverseError;
use volition::inverse::reading::{axes, compare, normalised, shares_along, stationary_shares};
use volition::inverse::{Gains, GainsError, QSign, Settings, Structure, Verdict, inverse_lqr};

static GOLDEN: LazyLock<Value> =
    LazyLock::new(|| serde_json::from_str(include_str!("../golden/inverse.json")).unwrap());

fn case(name: &str) -> &'static Value {
    let case = &GOLDEN["cases"][name];
    assert!(case.is_object(), "no case {name}");
    case
}

fn mat(value: &Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).unwrap();
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

fn clock(case: &Value) -> Clock {
    if case["discrete"] == true { Clock::Sampled } else { Clock::Continuous }
}

fn gains(case: &Value) -> Gains {
    Gains::regulator(&mat(&case["A"]), &mat(&case["B"]), &mat(&case["K"]), clock(case)).unwrap()
}

pub fn solve(gains: &Gains) -> volition::inverse::InverseLqr {
    inverse_lqr(gains, &Settings::default(), &Ctl::new()).unwrap()
}

fn close(found: f64, expected: f64, tolerance: f64) -> bool {
    (found - expected).abs() <= tolerance * expected.abs().max(1.0)
}

/// What every feasible answer must satisfy, computed here anew.
fn check_proof(gains: &Gains, answer: &volition::inverse::InverseLqr, forward: f64) {
    let weights = answer.weights.as_ref().unwrap();
    let conditioning = answer.conditioning.unwrap();
    let (q, r) = (weights.q.symmetric_eigenvalues(), weights.r.symmetric_eigenvalues());
    let (low, high) = (q.min().min(r.min()), q.max().max(r.max()));
    assert!(low > 1.0 - 1e-5, "the least eigenvalue is {low}");
    assert!(high <= conditioning.alpha * (1.0 + 1e-5), "{high} {}", conditioning.alpha);
    assert!(conditioning.alpha_lower_bound <= conditioning.alpha * (1.0 + 1e-9));
    let solution = lqr(gains.a(), gains.b(), &weights.q, &weights.r, gains.clock()).unwrap();
    let error = (&solution.k - gains.k()).norm() / gains.k().norm();
    assert!(error <= forward, "forward error {error:e}");
    assert!(weights.proof.forward_error <= forward && weights.proof.riccati_residual <= 1e-7);
    assert!(weights.proof.return_difference.unwrap().margin > -1e-6, "{:?}", weights.proof.return_difference);
    assert!(answer.t_star_upper_bound.unwrap() > 0.0);
}

#[test]
fn feasible_examples_have_the_reference_condition_number() {
    for name in [
        "ch3_3.3_Ke",
        "ch3_3.3_K0care",
        "ch4_4.4.2_Ke",
        "ch4_4.4.2_Le",
        "ch4_4.4.2_K0care",
        "disc_feasible_K0",
        "disc_feasible_K0_round4",
        "ct_scalar_K3",
        "dt_scalar_K1.6",
        "nonunique_A=I_B=I_K=diag(3,3.1)",
    ] {
        let case = case(name);
        let gains = gains(case);
        let answer = solve(&gains);
        assert_eq!(answer.verdict, Verdict::Feasible, "{name}");
        assert_eq!(answer.unknowns as u64, case["null_dim"].as_u64().unwrap(), "{name}");
        let alpha = answer.conditioning.unwrap();
        assert!(close(alpha.alpha, case["alpha"].as_f64().unwrap(), 1e-8), "{name}: {}", alpha.alpha);
        assert!(alpha.alpha_lower_bound > alpha.alpha * (1.0 - 1e-6), "{name}: {alpha:?}");
        assert!(close(answer.t_star.unwrap(), case["t_star"].as_f64().unwrap(), 1e-6), "{name}: {:?}", answer.t_star);
        check_proof(&gains, &answer, 1e-12);
    }
}

#[test]
fn unique_weights_are_those_of_the_reference_and_of_the_thesis() {
    for name in ["ch3_3.3_Ke", "ch3_3.3_K0care", "ch4_4.4.2_Ke", "disc_feasible_K0"] {
        let case = case(name);
        let answer = solve(&gains(case));
        assert_eq!(answer.conditioning.unwrap().solution_dimension, 0, "{name}");
        let weights = answer.weights.unwrap();
        let size = answer.conditioning.unwrap().alpha;
        for (found, expected) in [(&weights.q, "Qhat"), (&weights.r, "Rhat"), (&weights.proof.p, "Phat")] {
            let difference = (found - mat(&case[expected])).amax();
            assert!(difference < 2e-4 * size, "{name} {expected}: {difference:e}");
        }
    }
    // Section 3.3 prints Q̂ and R̂ with four digits.
    let case = case("ch3_3.3_Ke");
    let weights = solve(&gains(case)).weights.unwrap();
    assert!((&weights.q - mat(&case["Qhat_printed"])).amax() < 0.014);
    assert!((&weights.r - mat(&case["Rhat_printed"])).amax() < 0.0125);
}

#[test]
fn the_forward_examples_come_back() {
    let case = case("ch3_3.3_Ke");
    let s = lqr(&mat(&case["A"]), &mat(&case["B"]), &mat(&case["Q0"]), &mat(&case["R0"]), Clock::Continuous).unwrap();
    assert!((&s.k - mat(&case["K0_care"])).amax() < 1e-12);
    assert!((&s.p - mat(&case["P0_care"])).amax() < 1e-12);
    assert!((&s.k - mat(&case["K0_printed"])).amax() < 4.9e-4);
}

#[test]
fn infeasible_examples_are_proven_so() {
    for name in [
        "ch3_3.4_Ke",
        "ch3_3.4_K0",
        "ch4_4.4.3_Ke",
        "ch4_4.4.3_Le_dual",
        "disc_infeasible",
        "ct_scalar_K1.5_infeasible",
        "dt_scalar_K1.2_infeasible",
    ] {
        let case = case(name);
        let answer = solve(&gains(case));
        assert_eq!(answer.verdict, Verdict::Infeasible, "{name}");
        assert!(close(answer.t_star.unwrap(), case["t_star"].as_f64().unwrap(), 1e-6), "{name}: {:?}", answer.t_star);
        assert!(answer.t_star_upper_bound.unwrap() < 0.0 && answer.decision.ratio.unwrap() < -1e6, "{name}");
        assert!(answer.weights.is_none());
    }
}

#[test]
fn boundary_cases_are_called_so_and_come_with_singular_weights() {
    // K = 2 on a = b = 1: Q = 0.
    let one = DMatrix::from_element(1, 1, 1.0);
    let answer = solve(&Gains::regulator(&one, &one, &(&one * 2.0), Clock::Continuous).unwrap());
    assert_eq!(answer.verdict, Verdict::Boundary);
    // The double integrator with K = [1, √2] is the regulator of (diag(1, 0), 1), against remark 2 of the thesis.
    let a = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 0.0, 0.0]);
    let b = DMatrix::from_row_slice(2, 1, &[0.0, 1.0]);
    let k = DMatrix::from_row_slice(1, 2, &[1.0, 2f64.sqrt()]);
    let answer = solve(&Gains::regulator(&a, &b, &k, Clock::Continuous).unwrap());
    assert_eq!(answer.verdict, Verdict::Boundary);
    let weights = answer.weights.unwrap();
    assert!(weights.proof.forward_error < 1e-6);
    let (q, _, _) = normalised(&weights.q, &weights.r);
    assert!((q - DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, 0.0])).amax() < 1e-6);
}

#[test]
fn the_human_gain_of_section_3_5_is_feasible_on_the_printed_geometry() {
    let case = case("ch3_3.5_human_surrogate");
    for name in ["Ke_printed_on_ch5_geometry", "Kf=CLQR(A,B,Qhat_printed,1)"] {
        let gains =
            Gains::regulator(&mat(&case["A"]), &mat(&case["B"]), &mat(&case[name]["K"]), Clock::Continuous).unwrap();
        let answer = solve(&gains);
        assert_eq!(answer.verdict, Verdict::Feasible, "{name}");
        let alpha = answer.conditioning.unwrap().alpha;
        assert!((alpha / case[name]["alpha"].as_f64().unwrap() - 1.0).abs() < 1e-8, "{name}: {alpha}");
        assert!((answer.weights.as_ref().unwrap().r[0] - 1.0).abs() < 1e-5);
        assert!(answer.weights.as_ref().unwrap().proof.forward_error < 1e-9);
    }
    // What of the printed Q̂ is reproducible: its eigenvalues.
    let found = axes(&mat(&case["Qhat_printed"]));
    let mut expected: Vec<f64> = serde_json::from_value(case["eig_Qhat"].clone()).unwrap();
    expected.reverse();
    assert!(found.iter().zip(&expected).all(|(axis, e)| (axis.weight / e - 1.0).abs() < 1e-10));
}

#[test]
fn weights_of_one_condition_number_need_not_be_unique_and_the_width_says_so() {
    // Against remark 1 of the thesis: R₁₁ is free in [1, 3.41/3].
    let answer = solve(&gains(case("nonunique_A=I_B=I_K=diag(3,3.1)")));
    let conditioning = answer.conditioning.unwrap();
    assert_eq!(conditioning.solution_dimension, 1);
    let r = &answer.weights.as_ref().unwrap().r;
    assert!((r[(0, 0)] - 1.0).abs() < 1e-3, "least Frobenius norm takes the lower end: {r}");
    assert!((conditioning.solution_width.unwrap() - (3.41 / 3.0 - 1.0)).abs() < 2e-3, "{conditioning:?}");
}

#[test]
fn the_smallest_cross_term_is_that_of_the_reference() {
    let case = case("ch3_3.4_Ke");
    let found = smallest_cross_term(&gains(case), &Ctl::new()).unwrap();
    let expected = &case["smallest_cross_term"];
    assert!((found.norm / expected["S_F"].as_f64().unwrap() - 1.0).abs() < 1e-6, "{}", found.norm);
    assert!((&found.s - mat(&expected["S"])).amax() < 0.05, "{}", found.s);
}

#[test]
fn the_gradient_is_that_of_the_reference_and_of_differences() {
    let case34 = case("ch3_3.4_Ke");
    let gains34 = gains(case34);
    let objective = Objective::new(&gains34, None);
    let (qs, rs) = (mat(&case34["printed"]["Qs"]), mat(&case34["printed"]["Rs"]));
    let at = objective.evaluate(&qs, &rs, None).unwrap();
    let expected = &case34["at_printed_QsRs"];
    assert!(close(at.value, expected["f"].as_f64().unwrap(), 1e-9));
    assert!((&at.gradient_q - mat(&expected["gQ_sym"])).norm() < 1e-7 * at.gradient_q.norm());
    assert!((&at.gradient_r - mat(&expected["gR_sym"])).norm() < 1e-7 * at.gradient_r.norm());
    for name in ["ch4_4.4.3_Ke", "ch4_4.4.3_Le_dual", "disc_infeasible"] {
        let case = case(name);
        let gains = gains(case);
        let objective = Objective::new(&gains, None);
        let (n, m) = (gains.states(), gains.ports());
        let (q, r) = (DMatrix::identity(n, n), DMatrix::identity(m, m));
        let at = objective.evaluate(&q, &r, None).unwrap();
        if name == "disc_infeasible" {
            assert!(close(at.value, case["residual_at_Q_I_R_I"].as_f64().unwrap(), 1e-10));
        } else {
            assert!(close(at.value, case["at_identity"]["f"].as_f64().unwrap(), 1e-10));
            assert!((&at.gradient_q - mat(&case["at_identity"]["gQ_sym"])).amax() < 1e-8);
            assert!((&at.gradient_r - mat(&case["at_identity"]["gR_sym"])).amax() < 1e-8);
        }
        // Gradient and Hessian by central differences, with a metric.
        let size = n * m;
        let metric = DMatrix::from_fn(size, size, |i, j| if i == j { 1.0 + 0.3 * i as f64 } else { 0.1 });
        let objective = Objective::new(&gains, Some(&metric));
        let directions = Structure::default();
        let all = directions_of(&directions, n, m);
        let at = objective.evaluate(&q, &r, None).unwrap();
        let (gradient, hessian) = objective.derivatives(&at, &all, &Ctl::new()).unwrap();
        let step = 1e-5;
        for (i, (dq, dr)) in all.iter().enumerate() {
            let up = objective.evaluate(&(&q + dq * step), &(&r + dr * step), None).unwrap();
            let down = objective.evaluate(&(&q - dq * step), &(&r - dr * step), None).unwrap();
            assert!(((up.value - down.value) / (2.0 * step) - gradient[i]).abs() < 1e-6 * gradient.norm());
            let slope = |at: &Evaluation| objective.derivatives(at, &all, &Ctl::new()).unwrap().0;
            let change = (slope(&up) - slope(&down)) / (2.0 * step);
            assert!((change - hessian.column(i)).norm() < 1e-6 * hessian.norm(), "{name} {i}");
        }
    }
}

pub fn directions_of(_: &Structure, n: usize, m: usize) -> Vec<(DMatrix<f64>, DMatrix<f64>)> {
    let mut all = Vec::new();
    for (order, is_q) in [(n, true), (m, false)] {
        for j in 0..order {
            for i in 0..=j {
                let mut e = DMatrix::zeros(order, order);
                e[(i, j)] = 1.0;
                e[(j, i)] = 1.0;
                all.push(if is_q { (e, DMatrix::zeros(m, m)) } else { (DMatrix::zeros(n, n), e) });
            }
        }
    }
    all
}

#[test]
fn the_descent_of_the_thesis_is_reproduced() {
    let case34 = case("ch3_3.4_Ke");
    let gains34 = gains(case34);
    let (qs, rs) = (mat(&case34["printed"]["Qs"]), mat(&case34["printed"]["Rs"]));
    let settings = DescentSettings { rate: 1e-4, steps: 5000 };
    let run = descent(&Objective::new(&gains34, None), &qs, &rs, settings, &Ctl::new()).unwrap();
    assert!(close(run.values[5000], case34["descent"]["f_5000"].as_f64().unwrap(), 1e-9));
    assert!((&run.r - mat(&case34["descent"]["R"])).amax() < 1e-6);
    for name in ["ch4_4.4.3_Ke", "ch4_4.4.3_Le_dual"] {
        let case = case(name);
        let gains = gains(case);
        let (n, m) = (gains.states(), gains.ports());
        let settings = DescentSettings { rate: 1e-4, steps: 3000 };
        let objective = Objective::new(&gains, None);
        let run =
            descent(&objective, &DMatrix::identity(n, n), &DMatrix::identity(m, m), settings, &Ctl::new()).unwrap();
        let expected = &case["descent"];
        for (after, value) in expected["f_after"].as_object().unwrap() {
            assert!(
                close(run.values[after.parse::<usize>().unwrap()], value.as_f64().unwrap(), 1e-8),
                "{name} {after}"
            );
        }
        assert_eq!(run.rejected_q as u64, expected["rejQ"].as_u64().unwrap(), "{name}");
        assert_eq!(run.rejected_r as u64, expected["rejR"].as_u64().unwrap(), "{name}");
        assert!((&run.q - mat(&expected["Q"])).amax() < 1e-7);
    }
}

#[test]
fn the_trade_off_curve_reaches_or_beats_the_reference() {
    for name in ["ch3_3.4_Ke", "ch4_4.4.3_Ke", "ch4_4.4.3_Le_dual"] {
        let case = case(name);
        let gains = gains(case);
        let found = fit(&gains, &FitSettings::default(), &Ctl::new()).unwrap();
        let bests: Vec<(f64, f64)> = serde_json::from_value(case["kappa_bounded_best"].clone()).unwrap();
        for (kappa, best) in bests {
            let point = found.curve.iter().find(|p| p.condition_number == kappa).unwrap();
            assert!(point.residual <= best * (1.0 + 1e-6), "{name} {kappa:e}: {} {best}", point.residual);
            let (q, r) = (point.q.symmetric_eigenvalues(), point.r.symmetric_eigenvalues());
            assert!(q.min().min(r.min()) >= 1.0 && q.max().max(r.max()) <= kappa);
            let k = lqr(gains.a(), gains.b(), &point.q, &point.r, gains.clock()).unwrap().k;
            let residual = (&k - gains.k()).norm_squared();
            assert!((residual / point.residual - 1.0).abs() < 1e-6, "{name} {kappa:e}: {residual}");
        }
        for pair in found.curve.windows(2) {
            assert!(pair[1].residual <= pair[0].residual * (1.0 + 1e-6), "{name}: a looser bound fits no worse");
        }
        if name == "ch3_3.4_Ke" {
            assert!(found.curve.last().unwrap().residual < 1.469, "{:?}", found.curve.last());
        }
    }
}

#[test]
fn the_sampled_fit_is_as_good_as_the_best_known() {
    let case = case("disc_infeasible");
    let found = fit(&gains(case), &FitSettings::default(), &Ctl::new()).unwrap();
    assert!(found.curve.last().unwrap().residual <= case["best_residual_found"].as_f64().unwrap());
}

#[test]
fn filters_are_the_dual_case() {
    let (kc, lc) = (case("ch4_4.4.2_Ke"), case("ch4_4.4.2_Le"));
    let (a, b, k) = (mat(&kc["A"]), mat(&kc["B"]), mat(&kc["K"]));
    let (c, l) = (mat(&lc["B"]).transpose(), mat(&lc["K"]).transpose());
    let settings = (Settings::default(), Settings::default());
    let answer = inverse_lqg(&a, &b, &c, &k, &l, Clock::Continuous, &settings, &Ctl::new()).unwrap();
    assert!(close(answer.regulator.conditioning.unwrap().alpha, 18.387574037, 1e-8));
    let filter = answer.filter.weights.as_ref().unwrap();
    assert!((filter.r[0] - 1.0).abs() < 1e-6);
    assert!(close(answer.filter.conditioning.unwrap().alpha, 8.4405, 1e-8));
    assert!((&filter.q - mat(&lc["What_printed"])).amax() < 0.022);
    let forward = kalman(&a, &c, &filter.q, &filter.r, Clock::Continuous).unwrap();
    assert!((forward.l - l).norm() < 1e-12);
}

#[test]
fn structures_are_found_again() {
    // A diagonal Q and any R, exact gains: the structured weights come back up to scale.
    let a = DMatrix::from_row_slice(3, 3, &[0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, -2.0, 0.5]);
    let b = DMatrix::from_row_slice(3, 2, &[0.0, 0.3, 1.0, 0.0, 0.2, 1.0]);
    let q0 = DMatrix::from_diagonal(&nalgebra::dvector![3.0, 0.7, 1.9]);
    let r0 = DMatrix::from_row_slice(2, 2, &[1.0, 0.2, 0.2, 0.6]);
    for clock in [Clock::Continuous, Clock::Sampled] {
        let k = lqr(&a, &b, &q0, &r0, clock).unwrap().k;
        let gains = Gains::regulator(&a, &b, &k, clock).unwrap();
        let settings = Settings { structure: Structure::diagonal_q(3), ..Settings::default() };
        let answer = inverse_lqr(&gains, &settings, &Ctl::new()).unwrap();
        assert_eq!(answer.verdict, Verdict::Feasible, "{clock:?}");
        let weights = answer.weights.unwrap();
        assert!((0..3).all(|i| (0..3).all(|j| i == j || weights.q[(i, j)] == 0.0)));
        let likeness = compare((&q0, &r0), (&weights.q, &weights.r));
        assert!(answer.unknowns > 1 || likeness.log_distance.unwrap() < 1e-6, "{likeness:?}");
        assert!(weights.proof.forward_error < 1e-8);
        // A fixed R of the right shape, up to its scale.
        let structure = Structure { r: Some(&r0 * 7.0), ..Structure::default() };
        let settings = Settings { structure, ..Settings::default() };
        let answer = inverse_lqr(&gains, &settings, &Ctl::new()).unwrap();
        assert_eq!(answer.verdict, Verdict::Feasible);
        let r = answer.weights.unwrap().r;
        assert!((&r / r[(0, 0)] - &r0 / r0[(0, 0)]).amax() < 1e-12);
        // A wrong one leaves nothing.
        let structure = Structure { r: Some(DMatrix::identity(2, 2)), ..Structure::default() };
        let wrong = Settings { structure, ..Settings::default() };
        let answer = inverse_lqr(&gains, &wrong, &Ctl::new()).unwrap();
        assert_eq!(answer.verdict, Verdict::Infeasible);
        // And the fit of that structure keeps it.
        let settings = FitSettings {
            structure: Structure { r: Some(DMatrix::identity(2, 2)), ..Structure::diagonal_q(3) },
            condition_numbers: vec![1e3],
            ..FitSettings::default()
        };
        let point = &fit(&gains, &settings, &Ctl::new()).unwrap().curve[0];
        assert!((&point.r - DMatrix::identity(2, 2) * point.r[0]).amax() < 1e-12 * point.r[0]);
        assert!((0..3).all(|i| (0..3).all(|j| i == j || point.q[(i, j)] == 0.0)));
    }
    let misfit = Structure { q_pattern: Some(DMatrix::from_element(2, 2, true)), ..Structure::default() };
    let gains = gains(case("ch3_3.4_Ke"));
    assert!(matches!(
        inverse_lqr(&gains, &Settings { structure: misfit, ..Settings::default() }, &Ctl::new()),
        Err(InverseError::Structure(_))
    ));
}

#[test]
fn a_semidefinite_weight_may_be_asked_for() {
    let a = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 0.0, 0.0]);
    let b = DMatrix::from_row_slice(2, 1, &[0.0, 1.0]);
    let k = DMatrix::from_row_slice(1, 2, &[1.0, 2f64.sqrt()]);
    let gains = Gains::regulator(&a, &b, &k, Clock::Continuous).unwrap();
    let structure = Structure { q_sign: QSign::Semidefinite, ..Structure::default() };
    let settings = Settings { structure, ..Settings::default() };
    let answer = inverse_lqr(&gains, &settings, &Ctl::new()).unwrap();
    assert!(settings.accepts_boundary() && answer.weights.is_some());
}

#[test]
fn malformed_questions_name_the_matrix_the_size_and_the_reason() {
    let a = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 2.0, 0.0]);
    let b = DMatrix::from_row_slice(2, 1, &[0.0, 1.0]);
    let k = DMatrix::from_row_slice(1, 2, &[3.0, 2.0]);
    let ask = |a: &DMatrix<f64>, b: &DMatrix<f64>, k: &DMatrix<f64>| {
        Gains::regulator(a, b, k, Clock::Continuous).unwrap_err()
    };
    assert_eq!(ask(&DMatrix::zeros(2, 3), &b, &k), GainsError::NotSquare { rows: 2, columns: 3 });
    let error = ask(&a, &b, &DMatrix::zeros(2, 1));
    assert!(error.to_string().contains("K is 2x1 and must be 1x2"), "{error}");
    let error = ask(&a, &DMatrix::zeros(3, 1), &k);
    assert!(error.to_string().contains("B is 3x1 and must be 2x1"), "{error}");
    assert!(matches!(ask(&a, &b, &(&k * 0.1)), GainsError::UnstableLoop { product: "A − BK", .. }));
    assert!(matches!(ask(&a, &(&b * 0.0), &k), GainsError::Unreachable { matrix: "B", .. }));
    // A mode that grows and that no input reaches: answering it costs for ever.
    let apart = DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, -1.0]);
    assert!(matches!(ask(&apart, &b, &k), GainsError::EndlessCost { matrix: "K", .. }));
    let huge = DMatrix::from_row_slice(1, 2, &[3.0, 1e300]);
    assert!(matches!(ask(&a, &b, &huge), GainsError::Entry { matrix: "K", row: 0, column: 1, .. }));
    let error = Gains::filter(&a, &b.transpose(), &DMatrix::zeros(3, 1), Clock::Continuous).unwrap_err();
    assert!(error.to_string().contains("L is 3x1 and must be 2x1"), "{error}");
}

#[test]
fn costs_are_read_and_compared_up_to_their_scale() {
    let q = DMatrix::from_row_slice(2, 2, &[5.0, 2.0, 2.0, 2.0]);
    let r = DMatrix::from_row_slice(1, 1, &[4.0]);
    let found = axes(&q);
    assert!((found[0].weight - 6.0).abs() < 1e-14 && (found[1].weight - 1.0).abs() < 1e-14);
    assert!((found[0].direction[0] - 2.0 / 5f64.sqrt()).abs() < 1e-14 && (found[0].share - 6.0 / 7.0).abs() < 1e-14);
    // One sample x = (1, −1), u = 0.5: xᵀQx = 3 (3 from the first state, 0 from the second), uᵀRu = 1.
    let along =
        shares_along(&q, &r, &DMatrix::from_row_slice(1, 2, &[1.0, -1.0]), &DMatrix::from_row_slice(1, 1, &[0.5]))
            .unwrap();
    assert!(
        (along.states[0] - 0.75).abs() < 1e-15
            && along.states[1].abs() < 1e-15
            && (along.inputs[0] - 0.25).abs() < 1e-15
    );
    assert!(shares_along(&q, &r, &DMatrix::zeros(3, 2), &DMatrix::zeros(3, 1)).is_none());
    let same = compare((&q, &r), (&(&q * 3.0), &(&r * 3.0)));
    assert!((same.scale - 1.0 / 3.0).abs() < 1e-15 && (same.similarity - 1.0).abs() < 1e-15);
    assert!(same.log_distance.unwrap() < 1e-14);
    let other = compare((&q, &r), (&q, &(&r * std::f64::consts::E)));
    // Logarithms 0, 0, 1: standard deviation √2/3.
    assert!((other.log_distance.unwrap() - 2f64.sqrt() / 3.0).abs() < 1e-14);
    assert_eq!(compare((&q, &r), (&DMatrix::zeros(2, 2), &r)).log_distance, None);
    // In a stationary loop the shares sum to one, and the cost is tr(PW).
    let a = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 2.0, 0.0]);
    let b = DMatrix::from_row_slice(2, 1, &[0.0, 1.0]);
    let s = lqr(&a, &b, &q, &r, Clock::Continuous).unwrap();
    let identity = DMatrix::identity(2, 2);
    let shares = stationary_shares(&(&a - &b * &s.k), &s.k, &q, &r, &identity, Clock::Continuous).unwrap().unwrap();
    assert!((shares.states.iter().chain(&shares.inputs).sum::<f64>() - 1.0).abs() < 1e-14);
}
