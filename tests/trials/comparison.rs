//! The statistics of group comparisons, against golden values (`tests/golden/groups.json`) and second methods.

use serde_json::Value;
use volition::learning::comparison::counts::{difference, fisher, proportion};
use volition::learning::comparison::effect::{hedges_g, welch};
use volition::learning::comparison::metric::{MetricSettings, group_metric, pair_metric};
use volition::learning::comparison::mixed_logit::{PersonCount, mixed_logit};
use volition::learning::comparison::mixed_model::{TrialRow, mixed_model};
use volition::learning::comparison::multiple::Correction;
use volition::learning::comparison::people::{Contrast, CurveForm};
use volition::learning::comparison::permutation::two_groups;
use volition::learning::comparison::random_effects::{Difference, RandomEffects, random_effects};
use volition::learning::comparison::series::{PersonSeries, PracticeAxis, SeriesPoint, SessionOffset};
use volition::learning::comparison::shape::{Bound, ErrorSource, Law, Observation, PersonFit, fit};
use volition::learning::curves::Metric;

const DIGITS: f64 = 1e-8;

fn golden() -> Value {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/groups.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn sets(golden: &Value) -> impl Iterator<Item = (&String, &Value)> {
    golden["data"].as_object().unwrap().iter()
}

fn f(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn list(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(f).collect()
}

/// Equal to eight digits of `size`, or of the value where that is larger.
#[track_caller]
fn near(found: f64, expected: &Value, size: f64, what: &str) {
    let expected = f(expected);
    let allowed = DIGITS * expected.abs().max(size);
    assert!((found - expected).abs() <= allowed, "{what}: {found}, and {expected} is expected");
}

#[track_caller]
fn near_all(found: &[f64], expected: &Value, size: f64, what: &str) {
    let expected = expected.as_array().unwrap();
    assert_eq!(found.len(), expected.len(), "{what}");
    for (found, expected) in found.iter().zip(expected) {
        near(*found, expected, size, what);
    }
}

/// The trials of each person of a set, with the group.
fn people(set: &Value) -> Vec<(PersonSeries, bool)> {
    let mut people: Vec<(PersonSeries, bool)> = Vec::new();
    for trial in set["input"].as_array().unwrap() {
        let code = trial["subject"].as_str().unwrap();
        if people.last().is_none_or(|p| p.0.code != code) {
            people.push((PersonSeries { code: code.to_owned(), points: Vec::new() }, trial["group"] == 1));
        }
        people.last_mut().unwrap().0.points.push(SeriesPoint {
            session: None,
            k: f(&trial["trial"]),
            value: trial["estimate"].as_f64(),
            standard_error: Some(f(&trial["variance"]).sqrt()),
            divergent: trial["divergent"].as_bool().unwrap(),
        });
    }
    people
}

fn observations(person: &PersonSeries) -> Vec<Observation> {
    let used = person.points.iter().filter(|p| !p.divergent);
    used.map(|p| Observation { k: p.k, value: p.value.unwrap(), variance: p.standard_error.unwrap().powi(2) }).collect()
}

fn same_fit(found: &PersonFit, expected: &Value, who: &str) {
    // What is a difference of larger numbers has the digits of those.
    let size = f(&expected["amplitude"]).abs().max(f(&expected["asymptote"]).abs());
    assert_eq!(found.n as u64, expected["n"].as_u64().unwrap(), "{who}");
    let bound = found.at_bound.map(|b| if b == Bound::Lower { "lower" } else { "upper" });
    assert_eq!(bound, expected["at_bound"].as_str(), "{who}");
    near(found.shape, &expected["shape"], 0.0, who);
    near(found.weighted_rss, &expected["weighted_rss"], 0.0, who);
    match (found.residual_scale, expected["residual_scale"].as_f64()) {
        (Some(scale), Some(_)) => near(scale, &expected["residual_scale"], 0.0, who),
        (None, None) => {}
        other => panic!("{who}: {other:?}"),
    }
    // The golden errors are the known ones; here they are scaled where they are too small.
    let known = |error: f64| error / found.variance_factor.sqrt();
    assert_eq!(found.variance_factor > 1.0, found.residual_scale.is_some_and(|s| s > 2.0), "{who}");
    for (estimate, name) in [
        (found.asymptote, "asymptote"),
        (found.amplitude, "amplitude"),
        (found.first, "first"),
        (found.last, "last"),
        (found.change, "change"),
    ] {
        near(estimate.value, &expected[name], size, &format!("{who} {name}"));
        near(known(estimate.standard_error), &expected["se_known"][name], 0.0, &format!("{who} error of {name}"));
    }
    match found.shape_standard_error {
        Some(error) => near(known(error), &expected["se_known"]["shape"], 0.0, &format!("{who} error of shape")),
        None => assert!(expected["se_known"]["shape"].is_null(), "{who}"),
    }
    if found.variance_factor == 1.0 {
        for (found, expected) in found.shape_interval95.iter().zip(expected["shape_profile95"].as_array().unwrap()) {
            match found {
                Some(found) => near(*found, expected, 0.0, &format!("{who} profile")),
                None => assert!(expected.is_null(), "{who}: an open profile, and {expected} is expected"),
            }
        }
    }
}

#[test]
fn curves_of_people_are_the_golden_ones() {
    let golden = golden();
    let (mut fits, mut at_bound, mut open) = (0, 0, 0);
    for (name, set) in sets(&golden) {
        let answer = &set["answer"];
        let (first, last) = (f(&answer["first_trial"]), f(&answer["last_trial"]));
        for ((person, _), expected) in people(set).iter().zip(answer["subjects"].as_array().unwrap()) {
            assert_eq!(expected["subject"], person.code);
            for (law, key) in [(Law::Exponential, "exponential"), (Law::Power, "power")] {
                let found = fit(law, &observations(person), ErrorSource::Known, first, last).unwrap();
                same_fit(&found, &expected[key], &format!("{name} {} {key}", person.code));
                fits += 1;
                at_bound += usize::from(found.at_bound.is_some());
                open += found.shape_interval95.iter().filter(|x| x.is_none()).count();
            }
        }
    }
    assert!(fits == 220 && at_bound > 50 && open > 50, "{fits} {at_bound} {open}");
}

fn same_mean(found: &RandomEffects, expected: &Value, what: &str) {
    // τ² is a difference of variances.
    let v = found.coefficients[0].standard_error_plain.powi(2) * found.k as f64;
    near(found.tau2, &expected["tau2"], v, &format!("{what} τ²"));
    assert_eq!(found.degrees_of_freedom as u64, expected["df"].as_u64().unwrap(), "{what}");
    near(found.knapp_hartung_factor, &expected["kh_factor"], 0.0, &format!("{what} factor"));
    near(found.q.unwrap(), &expected["Q"], 0.0, &format!("{what} Q"));
    near(found.q_p.unwrap(), &expected["Q_p"], 1e-3, &format!("{what} p of Q"));
    for (i, c) in found.coefficients.iter().enumerate() {
        near(c.value, &expected["coef"][i], c.standard_error_plain, &format!("{what} coefficient {i}"));
        near(c.standard_error_plain, &expected["se"][i], 0.0, &format!("{what} plain error {i}"));
        near(c.standard_error, &expected["se_kh"][i], 0.0, &format!("{what} error {i}"));
        let size = c.standard_error_plain;
        near_all(&c.interval95, &expected["ci95_kh"][i], size, &format!("{what} interval {i}"));
        let safe = &c.interval95_factor_at_least_one;
        near_all(safe, &expected["ci95_kh_adhoc"][i], size, &format!("{what} safe interval {i}"));
        near(c.p, &expected["p_kh"][i], 0.0, &format!("{what} p {i}"));
    }
}

fn same_difference(found: &Difference, expected: &Value, what: &str) {
    near(found.difference, &expected["difference"], found.standard_error, what);
    near(found.standard_error, &expected["se"], 0.0, what);
    near(found.degrees_of_freedom, &expected["df"], 0.0, what);
    near_all(&found.interval95, &expected["ci95"], found.standard_error, what);
    near(found.p, &expected["p"], 0.0, what);
}

#[test]
fn means_and_differences_of_groups_are_the_golden_ones() {
    let golden = golden();
    for (name, set) in sets(&golden) {
        let answer = &set["answer"];
        let group: Vec<f64> = answer["subjects"].as_array().unwrap().iter().map(|s| f(&s["group"])).collect();
        for contrast in ["first", "last", "change"] {
            let (expected, what) = (&answer[contrast], format!("{name} {contrast}"));
            let (y, v) = (list(&expected["values"]), list(&expected["variances"]));
            let of = |values: &[f64], wanted: f64| -> Vec<f64> {
                values.iter().zip(&group).filter(|(_, g)| **g == wanted).map(|(x, _)| *x).collect()
            };
            let [(y0, v0), (y1, v1)] = [0.0, 1.0].map(|g| (of(&y, g), of(&v, g)));
            let first = random_effects(&y0, &v0, None).unwrap();
            let second = random_effects(&y1, &v1, None).unwrap();
            same_mean(&first, &expected["group0"], &format!("{what} group 0"));
            same_mean(&second, &expected["group1"], &format!("{what} group 1"));
            let common = random_effects(&y, &v, Some(&group)).unwrap();
            same_mean(&common, &expected["difference_common_tau2"], &format!("{what} one τ²"));
            let own = Difference::of_means(&first, &second).unwrap();
            same_difference(&own, &expected["difference_own_tau2"], &format!("{what} own τ²"));
            same_difference(&welch(&y0, &y1).unwrap(), &expected["welch_1_minus_0"], &format!("{what} Welch"));
            let g = hedges_g(&y0, &y1).unwrap();
            near(g.g, &expected["hedges_1_minus_0"]["g"], 0.0, &what);
            near(g.correction, &expected["hedges_1_minus_0"]["J"], 0.0, &what);
            let interval = &expected["hedges_1_minus_0"]["d_interval95_noncentral_t"];
            near_all(&g.d_interval95.unwrap(), interval, 0.1, &format!("{what} d"));
            let test = two_groups(&y0, &y1, 1).unwrap();
            same_permutation(&test, &expected["permutation_1_minus_0"], &what);
        }
    }
}

fn same_permutation(test: &volition::learning::comparison::permutation::Permutation, expected: &Value, what: &str) {
    assert_eq!(test.allocations, expected["allocations"].as_u64().unwrap(), "{what}");
    near(test.difference, &expected["difference"], 1e-3, what);
    near(test.p, &expected["p"], 0.0, &format!("{what} permutation p"));
    near(test.smallest_p, &expected["smallest_p"], 0.0, what);
    match test.interval95 {
        Some(interval) => {
            // The golden limits are bisected to 1e-13 of a range of some standard deviations.
            let size = interval[1] - interval[0];
            near_all(&interval, &expected["interval95"], size, &format!("{what} permutation interval"));
        }
        None => {
            assert!(expected["interval95"].is_null(), "{what}");
            assert!(test.no_interval.as_ref().unwrap().contains("no test at 5 % exists"), "{what}");
        }
    }
}

#[test]
fn mixed_models_are_the_golden_ones() {
    let golden = golden();
    let mut models = 0;
    for (name, set) in sets(&golden) {
        let Some(expected) = set["answer"].get("lmm") else { continue };
        let people = people(set);
        let mut rows = Vec::new();
        for (i, (person, second)) in people.iter().enumerate() {
            let used = person.points.iter().filter(|p| !p.divergent);
            rows.extend(used.map(|p| TrialRow { person: i, second: *second, k: p.k, value: p.value.unwrap() }));
        }
        let found = mixed_model(&rows, people.len(), f(&expected["tau"])).unwrap();
        near_all(&found.coefficients, &expected["coef"], 0.1, &format!("{name} β"));
        near_all(&found.standard_errors, &expected["se"], 0.0, &format!("{name} errors"));
        for (row, expected) in found.covariance.iter().zip(expected["cov"].as_array().unwrap()) {
            near_all(row, expected, 1e-3, &format!("{name} covariance"));
        }
        near(found.residual_variance, &expected["sigma2"], 0.0, &format!("{name} σ²"));
        for (row, expected) in found.random_covariance.iter().zip(expected["random_cov"].as_array().unwrap()) {
            near_all(row, expected, 1e-3, &format!("{name} Ψ"));
        }
        let likelihood = &expected["minus2_restricted_loglik_without_constant"];
        near(found.minus_twice_restricted_log_likelihood, likelihood, 0.0, name);
        assert_eq!(
            (found.n as u64, found.people as u64),
            (expected["n"].as_u64().unwrap(), expected["subjects"].as_u64().unwrap())
        );
        models += 1;
    }
    assert_eq!(models, 5);
}

#[test]
fn counts_are_the_golden_ones() {
    let golden = golden();
    let counts = &golden["counts"];
    for expected in counts["single"].as_array().unwrap() {
        let [x, n] = ["x", "n"].map(|k| expected[k].as_u64().unwrap() as usize);
        let found = proportion(x, n);
        near_all(&found.wilson95.unwrap(), &expected["wilson"], 0.0, "Wilson");
        near_all(&found.clopper_pearson95.unwrap(), &expected["clopper_pearson"], 0.0, "Clopper and Pearson");
    }
    let found = difference(&proportion(7, 11), &proportion(2, 11)).unwrap();
    near_all(&found.newcombe95, &counts["newcombe_2_of_11_minus_7_of_11"], 0.0, "Newcombe");
    near(found.fisher_p, &counts["fisher_2_of_11_7_of_11"], 0.0, "Fisher");

    let divergent = &counts["divergent_trials"];
    let [x, n, g] = ["x", "n", "group"].map(|k| list(&divergent["input"][k]));
    let people: Vec<PersonCount> =
        (0..x.len()).map(|i| PersonCount { count: x[i] as usize, of: n[i] as usize, second: g[i] == 1.0 }).collect();
    let found = mixed_logit(&people).unwrap();
    let expected = &divergent["mixed_logit"];
    near(found.intercept, &expected["intercept"], 0.0, "β₀");
    near(found.group, &expected["group"], 0.0, "β₁");
    near(found.sd, &expected["sd"], 0.0, "s");
    near(found.log_likelihood, &expected["loglik_without_constant"], 0.0, "likelihood");
    near(found.likelihood_ratio, &expected["lr_group"], 0.0, "likelihood ratio");

    let share = |second: bool| -> Vec<f64> {
        people.iter().filter(|p| p.second == second).map(|p| p.count as f64 / p.of as f64).collect()
    };
    let test = two_groups(&share(false), &share(true), 1).unwrap();
    same_permutation(&test, &divergent["permutation_of_subject_proportions"], "shares of divergent trials");
    let sum = |second: bool| people.iter().filter(|p| p.second == second).map(|p| p.count).sum::<usize>();
    let (pooled, _) = fisher(sum(false), 440, sum(true), 440);
    near(pooled, &divergent["wrong_pooled_fisher_p"], 0.0, "Fisher over trials, which claims too much");
}

#[test]
fn several_tests_are_adjusted_as_the_golden_values() {
    let golden = golden();
    let p = list(&golden["multiple"]["p"]);
    near_all(&Correction::Holm.adjust(&p), &golden["multiple"]["holm"], 0.0, "Holm");
    near_all(&Correction::BenjaminiHochberg.adjust(&p), &golden["multiple"]["bh"], 0.0, "Benjamini and Hochberg");
    for (name, set) in sets(&golden) {
        let answer = &set["answer"];
        let p = ["first", "last", "change"].map(|c| f(&answer[c]["permutation_1_minus_0"]["p"]));
        near_all(&Correction::Holm.adjust(&p), &answer["holm_first_last_change"], 0.0, name);
        near_all(&Correction::BenjaminiHochberg.adjust(&p), &answer["bh_first_last_change"], 0.0, name);
    }
}

fn settings(leave_out_extrapolated: bool) -> MetricSettings {
    MetricSettings {
        form: CurveForm::Exponential,
        contrasts: vec![Contrast::First, Contrast::Last, Contrast::Change],
        leave_out_extrapolated,
        retention_trials: 5,
        seed: 1,
    }
}

/// From the trials to the difference of groups in one go: what the kernels do one by one is put together rightly.
#[test]
fn the_whole_road_from_trials_to_differences_is_the_golden_one() {
    let golden = golden();
    let mut compared = 0;
    for (name, set) in sets(&golden) {
        let answer = &set["answer"];
        let (first, last) = (f(&answer["first_trial"]), f(&answer["last_trial"]));
        let axis = PracticeAxis { first, last, sessions: vec![SessionOffset { session: None, offset: 0 }] };
        let of = |second: bool| -> Vec<PersonSeries> {
            people(set).into_iter().filter(|p| p.1 == second).map(|p| p.0).collect()
        };
        let groups = [of(false), of(true)];
        let settings = settings(false);
        let metric = Metric::NormFeedforwardPlantMinusOne;
        let pair = pair_metric(metric, &groups[0], &groups[1], ErrorSource::Known, &axis, &settings);
        let means = groups.map(|g| group_metric(metric, &g, ErrorSource::Known, &axis, &settings));
        // Errors that are scaled up, since they explain less than half of the scatter, have no golden value.
        let scaled = means.iter().flat_map(|m| &m.people).any(|p| p.fit.as_ref().unwrap().variance_factor > 1.0);
        for (i, contrast) in ["first", "last", "change"].into_iter().enumerate() {
            let (expected, what) = (&answer[contrast], format!("{name} {contrast}"));
            same_permutation(
                pair.contrasts[i].permutation.as_ref().unwrap(),
                &expected["permutation_1_minus_0"],
                &what,
            );
            if scaled {
                continue;
            }
            compared += 1;
            same_mean(means[0].contrasts[i].mean.as_ref().unwrap(), &expected["group0"], &what);
            same_mean(means[1].contrasts[i].mean.as_ref().unwrap(), &expected["group1"], &what);
            same_difference(pair.contrasts[i].difference.as_ref().unwrap(), &expected["difference_own_tau2"], &what);
            let alternatives = &pair.contrasts[i].alternatives;
            let common = alternatives.iter().find(|a| a.assumption.contains("one τ²")).unwrap();
            near(common.p, &expected["difference_common_tau2"]["p_kh"][1], 0.0, &what);
            assert!(alternatives.iter().any(|a| a.assumption.contains("power laws")), "{what}: {alternatives:?}");
        }
        let model = &pair.no_mixed_model;
        match name.as_str() {
            "heteroscedastic_8v8" => assert!(model.as_ref().unwrap().contains("takes errors as equal"), "{model:?}"),
            "balanced_11v11" | "missing_11v11" => assert_eq!(*model, None, "{name}"),
            _ => {}
        }
    }
    assert_eq!(compared, 9, "three sets are without scaled errors");
}
