//! The statistically equivalent set: its size and the ranges of the norms over it, against every candidate one by one.

use num_complex::Complex64;
use rand::RngExt;
use serde_json::{Value, json};
use volition::analysis::{Library, Plan, Report, Request};
use volition::control::{Continuous, Discrete, System, TransferFunction};
use volition::ctl::{Ctl, StopReason};
use volition::identify::identifiability::Structure;
use volition::identify::pool::{Degrees, Pool, PoolSpec};
use volition::identify::problem::{Lines, Problem};
use volition::identify::search::{
    BandNorms, Clusters, EquivalentRanges, Exhaustive, ExtremeMember, FactorTrees, NormRange, Prepared, Question,
    Search, Threshold, exact, ranges, share,
};
use volition::identify::ssid::plant_for;
use volition::learning::frequency_domain::{controller_metrics, norm_feedback, norm_feedforward_plant_minus_one};
use volition::num::rng;

/// The random cases.
const SEED: u64 = 15;
const CASES: u32 = 100;

#[derive(Debug)]
struct Norms<'a> {
    plant: &'a System,
    band: [f64; 2],
}

impl BandNorms for Norms<'_> {
    fn band_rad_s(&self) -> [f64; 2] {
        self.band
    }

    fn feedback(&self, feedback: &System) -> f64 {
        norm_feedback(feedback, self.band).unwrap_or(f64::INFINITY)
    }

    fn feedforward_plant_minus_one(&self, feedforward: &System) -> f64 {
        norm_feedforward_plant_minus_one(self.plant, feedforward, self.band).unwrap_or(f64::INFINITY)
    }
}

struct Case {
    plant: System,
    problem: Problem,
    pool: Pool,
    structure: Structure,
    band: [f64; 2],
}

/// A published pool, thinned at random, on a random plant with random data.
fn case(number: u32) -> Option<Case> {
    let mut random = rng::stream(SEED, &format!("case {number}"));
    let mut draw = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    let is_sampled = number % 2 == 1;
    let name = if is_sampled { "zhang2015_appendix_c" } else { "zhang2015_appendix_b" };
    let thin = json!({
        "poles": draw(35.0, 70.0) as usize, "zeros": draw(30.0, 60.0) as usize,
        "damping": draw(10.0, 20.0) as usize, "gains": draw(5.0, 14.0) as usize,
    });
    let spec: PoolSpec = serde_json::from_value(json!({"name": name, "thin": thin})).unwrap();
    let degrees = Degrees { feedforward_numerator: Some(2 + (number / 2 % 4) as usize), ..Degrees::default() };
    let degrees = if is_sampled {
        Degrees { feedforward_denominator: degrees.feedforward_numerator, ..degrees }
    } else {
        degrees
    };
    let recipe = spec.check(degrees).unwrap();
    let (num, den) = ([draw(0.5, 3.0), draw(1.0, 6.0)], [1.0, draw(0.4, 4.0), draw(0.0, 6.0)]);
    let plant = System::Continuous(TransferFunction::new(&num, &den, Continuous).unwrap());
    let plant = plant_for(&recipe, &plant, Some(0.02)).unwrap();
    let pool = recipe.build(&plant, &Ctl::new()).ok()?;
    if pool.size() > 1500 {
        return None;
    }
    let omega: Vec<f64> = (0..13).map(|k| 0.7 + 0.19 * f64::from(k)).collect();
    let noise = 0.003 * 100f64.powf(draw(0.0, 1.0));
    let (gain, lag) = (draw(0.2, 2.0), draw(0.02, 0.3));
    let h: Vec<Complex64> = omega
        .iter()
        .map(|w| {
            let loop_gain = gain * plant.response(*w) * (-Complex64::new(0.0, *w) * lag).exp();
            let scatter = Complex64::new(noise * draw(-1.0, 1.0), noise * draw(-1.0, 1.0));
            (0.8 + loop_gain) / (1.0 + loop_gain) / (1.0 + Complex64::new(0.0, lag * w)) + scatter
        })
        .collect();
    let weights: Option<Vec<f64>> = number.is_multiple_of(3).then(|| omega.iter().map(|_| draw(0.3, 2.0)).collect());
    let lines = Lines::new(&plant, &omega, &h, weights.as_deref());
    let problem = Problem::new(&lines, recipe.feedforward_numerator_degree).unwrap();
    // A band within the lines, and one that passes them on both sides.
    let band = if number.is_multiple_of(5) { [0.2, 4.0] } else { [0.7, 2.9] };
    Some(Case { plant, problem, pool, structure: recipe.structure(), band })
}

/// Index, cost and norm of the member with the smallest or the largest norm, the first of several.
type Extreme = Option<(u64, f64, f64)>;

fn told(member: &Option<ExtremeMember>) -> Extreme {
    member.as_ref().map(|m| (m.index, m.cost, m.norm))
}

fn ends(range: &NormRange) -> [Extreme; 2] {
    [told(&range.least), told(&range.largest)]
}

fn both(found: &EquivalentRanges) -> [[Extreme; 2]; 2] {
    [&found.feedback, &found.feedforward_plant_minus_one].map(|range| ends(range.as_ref().unwrap()))
}

/// Every candidate, one after another, with transfer functions made here.
fn brute_force(case: &Case, limit: f64) -> (u64, [[Extreme; 2]; 2]) {
    let norms = Norms { plant: &case.plant, band: case.band };
    let time = case.plant.sample_time_s().map(|t| Discrete::new(t).unwrap());
    let system = |num: &[f64], den: &[f64]| match time {
        None => System::Continuous(TransferFunction::new(num, den, Continuous).unwrap()),
        Some(time) => System::Discrete(TransferFunction::new(num, den, time).unwrap()),
    };
    let mut count = 0;
    let mut found: [[Extreme; 2]; 2] = [[None; 2]; 2];
    let mut last: Option<(u64, f64)> = None;
    let partners = case.pool.feedforward().len() as u64;
    for index in 0..case.pool.size() {
        let candidate = case.pool.candidate(case.pool.position(index));
        let fit = exact::fit(&case.problem, &candidate);
        if fit.cost > limit {
            continue;
        }
        count += 1;
        let feedback = match last {
            Some((controller, norm)) if controller == index / partners => norm,
            _ => {
                let num: Vec<f64> = candidate.feedback_numerator.iter().map(|c| candidate.feedback_gain * c).collect();
                norms.feedback(&system(&num, &candidate.feedback_denominator))
            }
        };
        last = Some((index / partners, feedback));
        let feedforward = system(&fit.feedforward_numerator, &candidate.feedforward_denominator);
        let distance = norms.feedforward_plant_minus_one(&feedforward);
        for (found, norm) in found.iter_mut().zip([feedback, distance]) {
            if found[0].is_none_or(|(_, _, least)| norm < least) {
                found[0] = Some((index, fit.cost, norm));
            }
            if found[1].is_none_or(|(_, _, largest)| norm > largest) {
                found[1] = Some((index, fit.cost, norm));
            }
        }
    }
    let finite = |extreme: Extreme| extreme.filter(|(_, _, norm)| norm.is_finite());
    (count, found.map(|ends| ends.map(finite)))
}

#[test]
fn ranges_and_counts_are_those_of_brute_force_on_a_hundred_thinned_pools() {
    let (mut done, mut number) = (0, 0);
    let (mut shares, mut within) = (Vec::new(), 0);
    while done < CASES {
        number += 1;
        assert!(number < 2000, "{done} cases");
        let Some(case) = case(number) else { continue };
        let ctl = Ctl::new();
        let optimum = Exhaustive.search(&case.problem, &case.pool, &ctl).unwrap();
        let Some(threshold) = Threshold::new(&case.problem, case.structure, optimum.cost) else { continue };
        done += 1;
        // The threshold itself, one that few pass, and one that all do.
        let limit = match number % 4 {
            0 => optimum.cost * 1.2,
            1 => optimum.cost * 30.0,
            _ => threshold.limit,
        };
        let norms = Norms { plant: &case.plant, band: case.band };
        let Case { problem, pool, plant, .. } = &case;
        let question = Question { problem, pool, plant, limit, best: optimum.index, norms: &norms, held: None };
        let (count, expected) = brute_force(&case, limit);
        assert!(count >= 1, "the best candidate is a member");
        let counted = share(&question, false, &ctl).unwrap();
        assert_eq!(counted.count, Some(count), "case {number}");
        assert_eq!(counted.share, count as f64 / pool.size() as f64);
        let listed = ranges(&question, None, &ctl).unwrap();
        assert_eq!(both(&listed), expected, "case {number}, listed");
        let trees = Prepared::Factored(FactorTrees::new(problem, pool, &ctl).unwrap().into());
        assert_eq!(both(&ranges(&question, Some(&trees), &ctl).unwrap()), expected, "case {number}, factored");
        for leaf in [2, 20] {
            let Some(clusters) = Clusters::with_leaves(problem, pool, leaf, &ctl).unwrap() else { continue };
            within += 1;
            let clusters = Prepared::Sensitivity(clusters.into());
            let found = ranges(&question, Some(&clusters), &ctl).unwrap();
            assert_eq!(both(&found), expected, "case {number}, leaves of {leaf}");
        }
        shares.push(counted.share);
    }
    shares.sort_by(f64::total_cmp);
    // Sets of every size were met, and every structure.
    assert!(within >= 50 && shares[5] < 0.1 && shares[CASES as usize - 5] > 0.9, "{within} {shares:?}");
}

#[test]
fn whoever_stops_it_is_heard() {
    let case = (1..).find_map(case).unwrap();
    let ctl = Ctl::new();
    let norms = Norms { plant: &case.plant, band: case.band };
    let Case { problem, pool, plant, .. } = &case;
    let question = Question { problem, pool, plant, limit: f64::MAX, best: 0, norms: &norms, held: None };
    ctl.stop(StopReason::Cancelled);
    assert_eq!(ranges(&question, None, &ctl).unwrap_err().0, StopReason::Cancelled);
    assert_eq!(share(&question, true, &ctl).unwrap_err().0, StopReason::Cancelled);
}

/// The figures of the reference: 11 unknowns and 26 equations admit 2.8 times the smallest cost.
#[test]
fn the_threshold_is_that_of_the_f_distribution() {
    let structure = Structure {
        feedforward_numerator: 4,
        feedforward_denominator_is_free: true,
        feedforward_denominator: 2,
        feedback_numerator: 1,
        feedback_denominator: 2,
        held: None,
    };
    let plant = System::Continuous(TransferFunction::new(&[2.0, 4.4], &[1.0, 3.6, 4.0], Continuous).unwrap());
    let problem = |lines: u32, h: f64| {
        let omega: Vec<f64> = (0..lines).map(|k| 0.7 + 0.19 * f64::from(k)).collect();
        let h = vec![Complex64::new(h, 0.0); omega.len()];
        Problem::new(&Lines::new(&plant, &omega, &h, None), 4).unwrap()
    };
    let threshold = Threshold::new(&problem(13, 1.0), structure, 2.0).unwrap();
    assert_eq!((threshold.equations, threshold.unknowns), (26, 11));
    // 1 + 11/15 F(11, 15): F = 2.5068 in printed tables, and 2.8 in all.
    assert!((threshold.ratio - (1.0 + 11.0 / 15.0 * 2.5068)).abs() < 1e-4, "{threshold:?}");
    assert_eq!(threshold.limit, 2.0 * threshold.ratio);
    // Never finer than rounding.
    let fine = Threshold::new(&problem(13, 1.0), structure, 1e-30).unwrap();
    assert_eq!(fine.limit, 1e-30 + problem(13, 1.0).rounding());
    // As many equations as unknowns leave nothing to judge by.
    assert_eq!(Threshold::new(&problem(5, 1.0), structure, 2.0), None);
}

/// A loop that a member of the pool makes, with noise, as a request.
fn request(noise: f64, lines: u32, equivalent: Value) -> Request {
    let plant = TransferFunction::new(&[2.0, 4.4], &[1.0, 3.6, 4.0], Continuous).unwrap();
    let mut random = rng::stream(3, "request");
    let omega: Vec<f64> = (0..lines).map(|k| 0.7 + 0.19 * f64::from(k)).collect();
    let h: Vec<[f64; 2]> = omega
        .iter()
        .map(|w| {
            let (s, g) = (Complex64::new(0.0, *w), plant.response(*w));
            let (gff, gfb) = ((s + 3.0) / (s + 5.0), 0.6 / (s + 4.0));
            let mut draw = || noise * (2.0 * random.random::<f64>() - 1.0);
            let h = g * (gff + gfb) / (1.0 + g * gfb) + Complex64::new(draw(), draw());
            [h.re, h.im]
        })
        .collect();
    Request {
        kind: "ssid".to_owned(),
        inputs: json!({
            "plant": {"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0]},
            "frequency_response": {"omega_rad_s": omega, "h": h}
        }),
        spec: json!({
            "pool": {"grid": {
                "feedforward_denominator": {"listed": [[2.0], [5.0], [9.0]]},
                "feedback_numerator": {"listed": [[0.2], [0.6], [1.2], [2.4]]},
                "feedback_denominator": {"listed": [[1.0], [4.0], [8.0]]},
            }, "stability_margin": 0.0},
            "feedforward_numerator_degree": 1, "equivalent": equivalent
        }),
    }
}

fn run(request: &Request) -> Report {
    Plan::parse(request).unwrap().run(&Library::default(), &Ctl::new()).unwrap()
}

#[test]
fn a_report_says_first_that_the_command_does_not_determine_the_feedback() {
    let report = run(&request(0.4, 13, Value::Null));
    let set = &report.result["equivalent"];
    assert!(set["share"].as_f64().unwrap() >= 0.5, "{set}");
    assert_eq!(report.warnings[0].code, "command_does_not_determine_feedback");
    assert!(report.warnings[0].message.starts_with("the command alone does not determine the feedback"));
    assert_eq!((&set["norms_reason"], &set["draws"]), (&Value::Null, &json!(0)));
    let size = report.result["certificate"]["pool_size"].as_f64().unwrap();
    assert_eq!(set["count"].as_f64().unwrap() / size, set["share"].as_f64().unwrap());
    let best = report.result["metrics"]["norm_feedback"].as_f64().unwrap();
    let ends = ["least", "largest"].map(|end| set["norm_feedback"][end]["norm"].as_f64().unwrap());
    assert!(ends[0] <= best && best <= ends[1] && ends[0] < ends[1], "{ends:?} {best}");
    assert_eq!(report.schema, "volition.ssid/7");

    // Good data determine it, and nothing is said.
    let report = run(&request(1e-4, 13, json!("counted")));
    assert!(report.result["equivalent"]["share"].as_f64().unwrap() < 0.2, "{}", report.result["equivalent"]);
    assert!(report.warnings.iter().all(|warning| warning.code != "command_does_not_determine_feedback"));
    // Without noise only the truth is left.
    let report = run(&request(0.0, 13, Value::Null));
    let set = &report.result["equivalent"];
    assert_eq!(set["count"], json!(1));
    assert_eq!(set["norm_feedback"]["least"], set["norm_feedback"]["largest"]);
    assert_eq!(set["norm_feedback"]["least"]["index"], report.result["certificate"]["index"]);
}

#[test]
fn where_there_is_no_set_the_reason_is_given() {
    let report = run(&request(0.1, 13, json!("none")));
    assert_eq!(report.result["equivalent"], Value::Null);
    assert_eq!(report.result["equivalent_reason"], json!("the spec asks for none"));
    // 5 unknowns and 6 equations, then 3 lines with as many equations as there are unknowns cannot be had: one more.
    let report = run(&request(0.1, 3, Value::Null));
    assert_eq!(report.result["equivalent"]["equations"], json!(6));
    let plant_with_delay = {
        let mut request = request(0.1, 13, Value::Null);
        request.inputs["plant"]["delay_s"] = json!(0.02);
        request
    };
    let report = run(&plant_with_delay);
    assert_eq!(report.result["equivalent"], Value::Null);
    assert!(report.result["equivalent_reason"].as_str().unwrap().contains("the plant's delay"));
}

#[test]
fn refined_controllers_have_their_norms() {
    let report = run(&request(0.02, 13, json!("none")));
    let refined = &report.result["refined"];
    let system = |name: &str| {
        let numbers = |field: &str| -> Vec<f64> {
            refined[name][field].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
        };
        System::Continuous(TransferFunction::new(&numbers("num"), &numbers("den"), Continuous).unwrap())
    };
    let plant = System::Continuous(TransferFunction::new(&[2.0, 4.4], &[1.0, 3.6, 4.0], Continuous).unwrap());
    let band = &report.result["metrics"]["band_rad_s"];
    let band = (band[0].as_f64().unwrap(), band[1].as_f64().unwrap());
    let expected = controller_metrics(&plant, &system("feedforward"), &system("feedback"), band).unwrap();
    assert_eq!(refined["metrics"], serde_json::to_value(&expected).unwrap());
    assert_ne!(refined["metrics"]["norm_feedback"], report.result["metrics"]["norm_feedback"]);
}
