use super::*;
use crate::analysis::{Plan, Report};
use crate::ctl::StopReason;
use serde_json::{Value, json};

/// The example of Zhang 2015, section 2.6, on a pool around the truth.
fn request() -> Value {
    let omega: Vec<f64> = (1..=20).map(|k| 0.2 * std::f64::consts::PI * f64::from(k)).collect();
    let h: Vec<[f64; 2]> = omega
        .iter()
        .map(|w| {
            let s = num_complex::Complex64::new(0.0, *w);
            let (g, ff, fb) = (4.0 / (s + 2.0), (2.1 * s + 3.0) / (s + 6.5), 5.4 / (s + 7.1));
            let closed = g * (ff + fb) / (1.0 + g * fb);
            [closed.re, closed.im]
        })
        .collect();
    json!({
        "kind": "ssid",
        "inputs": {"plant": {"num": [4], "den": [1, 2]}, "frequency_response": {"omega_rad_s": omega, "h": h}},
        "spec": {"pool": {"grid": {
            "feedforward_denominator": [{"from": 6, "to": 7, "step": 0.1}],
            "feedback_numerator": [{"from": 5, "to": 6, "step": 0.1}],
            "feedback_denominator": [{"from": 7, "to": 8, "step": 0.1}],
        }}},
    })
}

fn plan(request: &Value) -> Result<Plan, Problem> {
    Plan::parse(&serde_json::from_value(request.clone()).unwrap())
}

fn run(request: &Value) -> Result<Report, Failure> {
    plan(request).map_err(Failure::Problem)?.run(&Library::default(), &Ctl::new())
}

#[test]
fn a_report_holds_the_truth_and_its_certificate() {
    let report = run(&request()).unwrap();
    let result: SsidResult = serde_json::from_value(report.result.clone()).unwrap();
    let crate::control::Model::TransferFunction(ff) = &result.feedforward else { panic!("{:?}", result.feedforward) };
    let crate::control::Model::TransferFunction(fb) = &result.feedback else { panic!("{:?}", result.feedback) };
    assert_eq!(
        (ff.den.as_slice(), fb.num.as_slice(), fb.den.as_slice()),
        (&[1.0, 6.5][..], &[5.4][..], &[1.0, 7.1][..])
    );
    assert!((ff.num[0] - 2.1).abs() < 1e-12 && (ff.num[1] - 3.0).abs() < 1e-12, "{:?}", ff.num);
    assert!(result.cost < 1e-28);
    assert_eq!(result.certificate.pool_size, 11 * 11 * 11);
    assert_eq!(result.certificate.pool_size, 11 * 11 * 11);
    // Feedback outermost: denominator 7.1 (1), numerator 5.4 (4), then feedforward 6.5 (5).
    assert_eq!(result.certificate.index, (11 + 4) * 11 + 5);
    assert_eq!(result.fit.len(), 20);
    assert_eq!(result.closed_loop_poles.len(), 3);
    assert!(result.stability.largest_exponent_per_s.unwrap() < 0.0);
    assert!(result.simulated_vaf.is_none() && result.simulated_vaf_reason.is_some());
    assert!(report.warnings.iter().any(|w| w.code == "feedback_from_structure"), "{:?}", report.warnings);
    assert_eq!(report.provenance.inputs_sha256.len(), 2);
    assert!(report.provenance.seed.is_none());
    // The same bytes again.
    assert_eq!(run(&request()).unwrap(), report);
}

#[test]
fn the_canonical_request_parses_to_an_equal_plan() {
    for pool in [
        json!("zhang2015_appendix_b"),
        json!({"name": "zhang2015_appendix_c", "thin": {"poles": 3, "feedforward_poles": 2}}),
        request()["spec"]["pool"].clone(),
        json!({"roots": {"feedback_poles": {"real_rad_s": [-1.0, -2.0]}, "peak_gains": [0, 1.0], "band_rad_s": [0.1,
            2.0]}, "time": "sampled"}),
    ] {
        let mut request = request();
        request["spec"]["pool"] = pool;
        let first = plan(&request).unwrap();
        let again = Plan::parse(&first.request()).unwrap();
        assert_eq!(again.request(), first.request());
    }
}

#[test]
fn every_refusal_names_its_place() {
    for (change, value, code, location, words) in [
        ("/spec/pool", json!("zhang"), Code::Invalid, "/spec/pool", "zhang2015_appendix_b"),
        ("/spec/pool", json!(null), Code::Invalid, "/spec", "no pool"),
        (
            "/spec/pool/grid/feedback_numerator",
            json!([]),
            Code::Invalid,
            "/spec/pool/grid/feedback_numerator",
            "at least one",
        ),
        (
            "/spec/feedforward_denominator_degree",
            json!(3),
            Code::Invalid,
            "/spec/feedforward_denominator_degree",
            "degree 1",
        ),
        (
            "/spec/feedforward_denominator_degree",
            json!(-1),
            Code::Invalid,
            "/spec/feedforward_denominator_degree",
            "-1",
        ),
        ("/spec/max_candidates", json!(1000), Code::Unaffordable, "/spec/pool", "1331"),
        ("/spec/frequency", json!({"lines": "excited"}), Code::Invalid, "/spec/frequency", "no trial"),
        ("/spec/band_hz", json!([1.0, 0.5]), Code::Invalid, "/spec/band_hz", "none"),
        ("/spec/weights", json!("inverse_variance"), Code::Invalid, "/spec/weights", "no variance"),
        ("/spec/bootstrap", json!({"draws": 0, "seed": 1}), Code::Invalid, "/spec/bootstrap/draws", "0 draws"),
        ("/spec/structures", json!([]), Code::Invalid, "/spec/structures", "0 structures"),
        (
            "/inputs/frequency_response/averages",
            json!(1),
            Code::Invalid,
            "/inputs/frequency_response/averages",
            "too few",
        ),
        ("/spec/pools", json!(1), Code::Invalid, "/spec/pools", "unknown field"),
        ("/inputs/trial", json!("x"), Code::Invalid, "/inputs/trial", "no input"),
        ("/inputs/plant", json!(null), Code::Invalid, "/inputs", "no plant"),
        ("/inputs/plant", json!({"num": [1], "den": [0]}), Code::Invalid, "/inputs/plant", "denominator is zero"),
        ("/inputs/plant", json!({"num": [0], "den": [1, 1]}), Code::NotIdentifiable, "/inputs", "none of the 20"),
        (
            "/inputs/frequency_response/omega_rad_s/3",
            json!(-0.1),
            Code::Invalid,
            "/inputs/frequency_response/omega_rad_s/3",
            "negative",
        ),
        ("/inputs/frequency_response/h/3", json!([1.0]), Code::Invalid, "/inputs/frequency_response", "length"),
        (
            "/inputs/frequency_response",
            json!({"omega_rad_s": [1.0, 2.0], "h": [[1.0, 0.0], [0.9, -0.1]]}),
            Code::NotIdentifiable,
            "/inputs",
            "4 equations for 5",
        ),
        (
            "/spec/feedforward_numerator_degree",
            json!(25),
            Code::Invalid,
            "/spec/feedforward_numerator_degree",
            "at most 24",
        ),
    ] {
        let mut request = request();
        let (parent, name) = change.rsplit_once('/').unwrap();
        let parent = request.pointer_mut(parent).unwrap();
        match parent {
            Value::Array(items) => items[name.parse::<usize>().unwrap()] = value,
            parent => parent[name] = value,
        }
        let Err(Failure::Problem(problem)) = run(&request) else { panic!("{change} passed") };
        assert_eq!((problem.code, problem.location.as_deref()), (code, Some(location)), "{change}: {problem}");
        assert!(problem.detail.contains(words), "{change}: {problem}");
    }
}

#[test]
fn data_that_overflow_are_refused() {
    let mut request = request();
    for h in request["inputs"]["frequency_response"]["h"].as_array_mut().unwrap() {
        *h = json!([1e200, 1e200]);
    }
    let Err(Failure::Problem(problem)) = run(&request) else { panic!("passed") };
    assert_eq!(problem.code, Code::Numerical, "{problem}");
}

#[test]
fn a_sampled_pool_on_a_continuous_plant_needs_a_sample_time() {
    let mut request = request();
    request["spec"] = json!({"pool": {"grid": {"feedback_numerator": [[0.1, 0.2]], "feedback_denominator": [[-0.5]]},
        "time": "sampled"}});
    let Err(Failure::Problem(problem)) = run(&request) else { panic!("passed") };
    assert_eq!(problem.location.as_deref(), Some("/spec/sample_time_s"));
    request["spec"]["sample_time_s"] = json!(0.02);
    let result: SsidResult = serde_json::from_value(run(&request).unwrap().result).unwrap();
    assert_eq!(result.plant.sample_time_s(), Some(0.02));
    assert!(result.stability.spectral_radius.unwrap() < 1.0);
}

#[test]
fn trials_are_simulated() {
    // A loop that follows the model class exactly, from rest, over whole periods after the start has died away.
    let time = crate::control::Discrete::new(0.1).unwrap();
    let tf = |num: &[f64], den: &[f64]| TransferFunction::new(num, den, time).unwrap();
    let closed = crate::person::two_degrees_of_freedom::TwoDegreesOfFreedom::new(
        tf(&[0.2], &[1.0, -0.8]),
        tf(&[0.7, 0.1], &[1.0, 0.0]),
        tf(&[0.5], &[1.0]),
    )
    .unwrap();
    let r: Vec<f64> = (0..800)
        .map(|i| {
            [1, 2, 3, 5, 7, 11]
                .iter()
                .map(|m| (f64::from(m * i) * std::f64::consts::TAU / 400.0 + f64::from(*m)).sin())
                .sum()
        })
        .collect();
    let response = closed.simulate(&r, None).unwrap();
    let request = json!({
        "kind": "ssid",
        "inputs": {"trial": {"sample_time_s": 0.1, "r": r, "u": response.control.unwrap(), "y": response.output},
                   "plant": {"num": [0.2], "den": [1.0, -0.8], "sample_time_s": 0.1}},
        "spec": {"pool": {"grid": {"feedback_numerator": [{"from": 0, "to": 1, "step": 0.1}]}},
                 "feedforward_numerator_degree": 1, "feedforward_denominator_degree": 1,
                 "frequency": {"segments": [{"start_s": 40, "end_s": 80}]}},
    });
    let report = run(&request).unwrap();
    let result: SsidResult = serde_json::from_value(report.result.clone()).unwrap();
    let crate::control::Model::TransferFunction(fb) = &result.feedback else { panic!() };
    assert_eq!(fb.num, [0.5]);
    let vaf = result.simulated_vaf.unwrap();
    assert!(vaf.y.unwrap() > 1.0 - 1e-9 && vaf.u.unwrap() > 1.0 - 1e-9, "{vaf:?} {:?}", report.warnings);
    assert_eq!(result.variance_accounted_for, vaf.y);
}

/// The request with a variance and data that the pool's grid misses a little.
fn noisy(noise: f64) -> Value {
    use rand_distr::{Distribution, StandardNormal};
    let mut random = crate::num::rng::stream(9, "ssid tests");
    let mut request = request();
    let data = &mut request["inputs"]["frequency_response"];
    for h in data["h"].as_array_mut().unwrap() {
        for part in h.as_array_mut().unwrap() {
            let normal: f64 = StandardNormal.sample(&mut random);
            *part = json!(part.as_f64().unwrap() + noise * normal);
        }
    }
    let lines = data["h"].as_array().unwrap().len();
    data["variance"] = json!(vec![2.0 * noise * noise; lines]);
    request
}

fn result(request: &Value) -> (SsidResult, Vec<Warning>) {
    let report = run(request).unwrap();
    (serde_json::from_value(report.result).unwrap(), report.warnings)
}

#[test]
fn the_refined_optimum_stands_beside_the_pool_with_its_bands() {
    let mut request = noisy(1e-4);
    request["spec"]["bootstrap"] = json!({"draws": 60, "seed": 4});
    let (result, warnings) = result(&request);
    let refined = result.refined.unwrap();
    assert!(refined.converged && refined.cost <= result.cost && refined.pool_cost == result.cost, "{refined:?}");
    assert!(refined.gradient_norm < 1e-7 && refined.active_constraints.is_empty() && result.refined_reason.is_none());
    assert!((refined.cost_of_coefficients / refined.cost - 1.0).abs() < 1e-6);
    let uncertainty = refined.uncertainty.unwrap();
    // Coefficients of the truth within five standard deviations.
    for (name, truth) in
        [("feedforward_denominator[1]", 6.5), ("feedback_numerator[0]", 5.4), ("feedback_denominator[1]", 7.1)]
    {
        let found = uncertainty.parameters.iter().find(|p| p.name == name).unwrap();
        assert!((found.value - truth).abs() < 5.0 * found.standard_deviation.unwrap(), "{found:?}");
    }
    assert_eq!([uncertainty.feedforward.len(), uncertainty.closed_loop.len()], [20, 20]);
    assert!(uncertainty.closed_loop.iter().all(|band| band.magnitude_band.is_some()));
    assert!(refined.residual_tests.unwrap().power_p_value > 1e-4);
    let bootstrap = refined.bootstrap.unwrap();
    assert!(bootstrap.converged > 50 && bootstrap.draws == 60, "{bootstrap:?}");
    assert!(!warnings.iter().any(|w| w.code == "residuals_exceed_noise"), "{warnings:?}");

    // Without a variance there is nothing to say, and that is said.
    request["inputs"]["frequency_response"].as_object_mut().unwrap().remove("variance");
    let (silent, warnings) = self::result(&request);
    let refined = silent.refined.unwrap();
    assert!(refined.uncertainty.is_none() && refined.uncertainty_reason.is_some() && refined.bootstrap.is_none());
    assert!(warnings.iter().any(|w| w.code == "no_bootstrap"));
    // And none where none is wanted.
    request["spec"].as_object_mut().unwrap().remove("bootstrap");
    request["spec"]["refine"] = json!(false);
    let (without, _) = self::result(&request);
    assert!(without.refined.is_none() && without.refined_reason.is_some());
}

#[test]
fn a_delay_is_found_by_the_refinement() {
    let mut request = request();
    let omega = request["inputs"]["frequency_response"]["omega_rad_s"].clone();
    let h: Vec<[f64; 2]> = omega
        .as_array()
        .unwrap()
        .iter()
        .map(|w| {
            let s = num_complex::Complex64::new(0.0, w.as_f64().unwrap());
            let (g, ff, fb) = (4.0 / (s + 2.0), (2.1 * s + 3.0) / (s + 6.5), 5.4 / (s + 7.1) * (-0.15 * s).exp());
            let closed = g * (ff + fb) / (1.0 + g * fb);
            [closed.re, closed.im]
        })
        .collect();
    request["inputs"]["frequency_response"]["h"] = json!(h);
    request["spec"]["delay"] = json!({"feedback_s": {"from": 0.0, "to": 0.4}});
    let (result, _) = result(&request);
    let refined = result.refined.unwrap();
    assert!((refined.feedback_delay_s - 0.15).abs() < 1e-6 && refined.cost < 1e-16, "{refined:?}");
    assert!(result.cost > 1e-4 && refined.delay_scan.len() == 9 && refined.feedforward_delay_s == 0.0);
    for (delay, location, words) in [
        (json!({"feedback_s": -0.1}), "/spec/delay/feedback_s", "negative"),
        (json!({"feedback_s": []}), "/spec/delay/feedback_s", "1 to 100"),
        (json!({"feedforward_s": [0.2, 0.1]}), "/spec/delay/feedforward_s", "increase"),
        (json!({"feedback_s": {"from": 0.3, "to": 0.1}}), "/spec/delay/feedback_s", "no delay from"),
    ] {
        request["spec"]["delay"] = delay;
        let problem = plan(&request).unwrap_err();
        assert_eq!(problem.location.as_deref(), Some(location));
        assert!(problem.detail.contains(words), "{problem}");
    }
}

#[test]
fn structures_are_compared_and_the_answer_stays() {
    let mut request = noisy(1e-3);
    let (alone, _) = result(&request);
    request["spec"]["structures"] = json!([{"feedforward_numerator_degree": 0}, {"feedforward_numerator_degree": 1},
        {"feedforward_numerator_degree": 2}]);
    let (with, _) = result(&request);
    assert_eq!((&alone.feedforward, &alone.feedback), (&with.feedforward, &with.feedback));
    let compared = with.structures.unwrap();
    assert_eq!(compared.likelihood, Likelihood::KnownVariance);
    assert_eq!(compared.rows.iter().map(|row| row.degrees[0]).collect::<Vec<_>>(), [0, 1, 2]);
    assert_eq!(compared.bic_choice, Some(1), "{compared:?}");
    let criteria: Vec<_> = compared.rows.iter().map(|row| row.criteria.clone().unwrap()).collect();
    assert_eq!(criteria.iter().map(|c| c.unknowns).collect::<Vec<_>>(), [4, 5, 6]);
    request["spec"]["structures"] = json!([{"feedforward_denominator_degree": 3}]);
    assert_eq!(plan(&request).unwrap_err().location.as_deref(), Some("/spec/structures/0"));
}

#[test]
fn held_out_trials_are_simulated_and_must_not_be_fitted() {
    let trial = |gain: f64| {
        let r: Vec<f64> = (0..800).map(|i| gain * (0.05 * f64::from(i)).sin() + (0.31 * f64::from(i)).cos()).collect();
        let y: Vec<f64> = r
            .iter()
            .scan(0.0, |y, r| {
                *y = 0.8 * *y + 0.2 * r;
                Some(*y)
            })
            .collect();
        json!({"sample_time_s": 0.1, "r": r, "u": r, "y": y})
    };
    let mut request = json!({
        "kind": "ssid",
        "inputs": {"trial": trial(1.0), "validate_on": [trial(2.0), trial(3.0)],
                   "plant": {"num": [0.2], "den": [1.0, -0.8], "sample_time_s": 0.1}},
        "spec": {"pool": {"grid": {"feedback_numerator": [{"from": 0, "to": 1, "step": 0.1}]}},
                 "feedforward_numerator_degree": 1, "feedforward_denominator_degree": 1,
                 "frequency": {"lines": {"frequency_hz": [0.05, 0.08, 0.1, 0.2, 0.3, 0.4, 0.5]}}},
    });
    let first = plan(&request).unwrap();
    assert_eq!(Plan::parse(&first.request()).unwrap().request(), first.request());
    let (result, _) = result(&request);
    let held = result.held_out.unwrap();
    assert_eq!(
        held.pool.trials.iter().map(|t| t.trial.as_str()).collect::<Vec<_>>(),
        ["/inputs/validate_on/0", "/inputs/validate_on/1"]
    );
    assert!(held.pool.y.is_some_and(f64::is_finite) && held.refined.unwrap().y.is_some_and(f64::is_finite));
    request["inputs"]["validate_on"] = json!([trial(1.0)]);
    let Err(Failure::Problem(problem)) = run(&request) else { panic!("passed") };
    assert_eq!((problem.code, problem.location.as_deref()), (Code::Invalid, Some("/inputs/validate_on/0")));
    request["inputs"]["validate_on"] = json!([]);
    assert_eq!(plan(&request).unwrap_err().location.as_deref(), Some("/inputs/validate_on"));
}

#[test]
fn the_family_of_near_optimal_candidates_tells_how_flat_the_optimum_is() {
    let mut request = noisy(0.02);
    let fine = |from: f64, to: f64| json!([{"from": from, "to": to, "step": 0.01}]);
    request["spec"]["refine"] = json!(false);
    request["spec"]["pool"] = json!({"grid": {
        "feedforward_denominator": fine(6.2, 6.8), "feedback_numerator": fine(5.1, 5.7),
            "feedback_denominator": fine(6.8, 7.4)
    }});
    let (result, warnings) = result(&request);
    let near = &result.near_optimal;
    assert!(near.count > 100 && near.family.len() == 100 && !near.family_is_complete, "{} members", near.count);
    assert_eq!((near.family[0].index, near.family[0].cost), (result.certificate.index, result.cost));
    assert!(near.family.windows(2).all(|pair| (pair[0].cost, pair[0].index) < (pair[1].cost, pair[1].index)));
    assert!(near.family[99].cost <= (1.0 + near.within) * result.cost);
    for member in &near.family {
        let [ff, fb] = [&member.feedforward, &member.feedback].map(|model| model.check().unwrap());
        let cost: f64 = result
            .fit
            .iter()
            .map(|line| {
                let s = num_complex::Complex64::new(0.0, line.omega_rad_s);
                let (g, h) = (4.0 / (s + 2.0), num_complex::Complex64::new(line.h[0], line.h[1]));
                let (ff, fb) = (ff.response(line.omega_rad_s), fb.response(line.omega_rad_s));
                (g * (ff + fb) / (1.0 + g * fb) - h).norm_sqr()
            })
            .sum();
        assert!((cost - member.cost).abs() < 1e-9 * cost, "{cost} {}", member.cost);
    }
    let [low, high] = near.spread.norm_feedback.unwrap();
    let own = result.metrics.norm_feedback.unwrap();
    assert!(low < own && own < high, "{low} {own} {high}");
    assert!(near.spread.lines.iter().all(|line| line.feedback.unwrap()[0] < line.feedback.unwrap()[1]));
    let flat = warnings.iter().any(|w| w.code == "flat_optimum");
    let [a, b] = near.spread.norm_feedforward_plant_minus_one.unwrap();
    assert_eq!(flat, high > 1.25 * low || b > 1.25 * a);
}

#[test]
fn a_stopped_search_leaves_its_incumbent() {
    let mut request = request();
    let axis = json!([{"from": 0.01, "to": 10, "step": 0.01}]);
    request["spec"]["pool"] =
        json!({"grid": {"feedforward_denominator": axis, "feedback_numerator": axis, "feedback_denominator": axis}});
    request["spec"]["search"] = json!("exhaustive");
    let plan = plan(&request).unwrap();
    let ctl = Ctl::new();
    let outcome = std::thread::scope(|scope| {
        let running = scope.spawn(|| plan.run(&Library::default(), &ctl));
        while ctl.bracket().is_none() && !running.is_finished() {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        ctl.stop(StopReason::Cancelled);
        running.join().unwrap()
    });
    let Err(Failure::Interrupted { stopped, incumbent }) = outcome else { panic!("{outcome:?}") };
    assert_eq!(stopped.0, StopReason::Cancelled);
    assert!(incumbent.feedback.check().is_ok() && incumbent.feedforward.check().is_ok());
    assert!(ctl.bracket().unwrap().incumbent > 0.0);
}

#[test]
fn it_stops_when_asked() {
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    assert!(matches!(plan(&request()).unwrap().run(&Library::default(), &ctl), Err(Failure::Stopped(_))));
}
