//! Learning curves of subjects, groups and their mean frequency responses, against direct formulas.

use crate::property::from_seed;
use num_complex::Complex64;
use volition::control::{Continuous, System, TransferFunction};
use volition::learning::bode::{frequency_grid, response_statistics};
use volition::learning::frequency_domain::controller_metrics;
use volition::learning::groups::statistics;
use volition::learning::time_domain::TimeDomainMetrics;
use volition::learning::{
    CurveOptions, Estimator, Identification, IdentifiedControllers, NormIntervals, PlantName, StandardErrors,
    SubjectInput, TrialInput, TrialSelection, choose_spec, study_frequency_responses, study_learning_curves,
    subject_learning_curve,
};
use volition::trust::Evidence;

fn continuous(num: &[f64], den: &[f64]) -> System {
    System::Continuous(TransferFunction::new(num, den, Continuous).unwrap())
}

const BAND: (f64, f64) = (0.5, 3.0);

/// G = 1/(s + 2), Gff = `gain`·G⁻¹ and Gfb = `feedback`: then ‖Gff G − 1‖ = |gain − 1| and ‖Gfb‖ = feedback.
fn identification(analysis: &str, spec: &str, gain: f64, feedback: f64) -> Identification {
    let plant = continuous(&[1.0], &[1.0, 2.0]);
    let feedforward = continuous(&[gain, 2.0 * gain], &[1.0]);
    let feedback = continuous(&[feedback], &[1.0]);
    let metrics = controller_metrics(&plant, &feedforward, &feedback, BAND).unwrap();
    Identification {
        analysis: analysis.to_owned(),
        spec_sha256: spec.to_owned(),
        estimator: Estimator::Ssid,
        controllers: Some(IdentifiedControllers { plant, feedforward, feedback }),
        metrics: Some(metrics),
        standard_errors: StandardErrors::default(),
        intervals: NormIntervals::default(),
        variance_accounted_for: Some(0.9),
        cost: Some(0.1),
        evidence: Evidence::default(),
    }
}

fn trial(number: i64, error: f64, identifications: Vec<Identification>) -> TrialInput {
    TrialInput {
        trial: format!("trial-{number}"),
        number,
        session: None,
        plant: PlantName { id: "p1".to_owned(), name: "lag".to_owned() },
        divergent: false,
        excluded: None,
        metrics: TimeDomainMetrics {
            mean_abs_error: error,
            rms_error: 2.0 * error,
            max_abs_output: 1.0,
            control_log_dimensionless_jerk: None,
            right_control_at_start: Some(number % 2 == 0),
            right_control_undetermined: None,
            right_control_time_s: Some(0.1),
            right_control_threshold: 0.05,
        },
        identifications,
        by_other_estimators: Vec::new(),
    }
}

fn subject(code: &str, group: &str, trials: Vec<TrialInput>) -> SubjectInput {
    SubjectInput { subject: format!("id-{code}"), code: code.to_owned(), group: Some(group.to_owned()), trials }
}

fn codes(remarks: &[volition::learning::Remark]) -> Vec<&str> {
    remarks.iter().map(|r| r.code.as_str()).collect()
}

#[test]
fn points_are_ordered_by_session_and_number() {
    let mut trials: Vec<_> = [3, 1, 2].into_iter().map(|n| trial(n, n as f64, Vec::new())).collect();
    trials[0].session = Some(1);
    trials[1].session = Some(2);
    trials[2].session = Some(1);
    let curve = subject_learning_curve(&subject("a", "g", trials), &CurveOptions::default());
    let order: Vec<_> = curve.curves[0].points.iter().map(|p| (p.session, p.number, p.position)).collect();
    assert_eq!(order, [(Some(1), 2, 1), (Some(1), 3, 2), (Some(2), 1, 3)]);
}

#[test]
fn divergent_trials_are_left_out_unless_asked_for_and_counted() {
    let mut trials: Vec<_> = (1..=4).map(|n| trial(n, n as f64, Vec::new())).collect();
    trials[1].divergent = true;
    let input = subject("a", "g", trials);
    let curve = &subject_learning_curve(&input, &CurveOptions::default());
    let shown = &curve.curves[0];
    assert_eq!(shown.points.iter().map(|p| p.number).collect::<Vec<_>>(), [1, 3, 4]);
    assert_eq!(shown.points[1].position, 3, "the person trained in the divergent trial too");
    assert_eq!((shown.left_out.len(), shown.left_out_count, shown.left_out[0].number), (1, 1, 2));
    assert!(codes(&curve.remarks).contains(&"divergent_left_out"));
    let options = CurveOptions { include_divergent: true, ..CurveOptions::default() };
    let all = &subject_learning_curve(&input, &options).curves[0];
    assert_eq!((all.points.len(), all.left_out_count), (4, 0));
    let group = &study_learning_curves(&[input], &CurveOptions::default()).groups[0];
    assert_eq!((group.points[1].subjects, group.points[1].left_out), (0, 1));
    assert_eq!(group.points[1].metrics.mean_abs_error.mean, None);
}

#[test]
fn missing_identifications_and_infinite_norms_say_why() {
    let mut infinite = identification("a3", "s", 1.0, 1.0);
    infinite.metrics = Some(
        controller_metrics(
            &continuous(&[1.0], &[1.0, 0.0]),
            &continuous(&[1.0], &[1.0]),
            &continuous(&[1.0], &[1.0]),
            (0.0, 1.0),
        )
        .unwrap(),
    );
    let trials = vec![
        trial(1, 1.0, vec![identification("a1", "s", 1.5, 2.0)]),
        trial(2, 1.0, vec![]),
        trial(3, 1.0, vec![infinite]),
    ];
    let curve = subject_learning_curve(&subject("a", "g", trials), &CurveOptions::default());
    let points = &curve.curves[0].points;
    assert!((points[0].norm_feedforward_plant_minus_one.unwrap() - 0.5).abs() < 1e-9);
    assert_eq!(points[0].missing, None);
    assert!(points[1].missing.as_ref().unwrap().contains("no succeeded ssid"));
    assert_eq!(points[2].norm_feedforward_plant_minus_one, None);
    assert!(points[2].norm_feedforward_minus_inverse.is_some());
    assert!(points[2].missing.as_ref().unwrap().contains("norm_feedforward_plant_minus_one"));
    assert_eq!(curve.curves[0].unidentified.len(), 1);
    assert!(codes(&curve.remarks).contains(&"unidentified_trials"));
}

#[test]
fn the_spec_that_covers_most_trials_is_shown_alone() {
    let trials = vec![
        trial(1, 1.0, vec![identification("01", "old", 3.0, 1.0), identification("05", "new", 1.1, 1.0)]),
        // The same spec twice on one trial covers it once.
        trial(2, 1.0, vec![identification("02", "old", 3.0, 1.0), identification("07", "old", 4.0, 1.0)]),
        trial(3, 1.0, vec![identification("06", "new", 1.2, 1.0)]),
    ];
    // Two trials each; the last analysis of all, 07, is of the old spec.
    let choice = choose_spec(&trials).unwrap();
    assert_eq!((choice.spec_sha256.as_str(), choice.trials), ("old", 2));
    assert_eq!((choice.others[0].spec_sha256.as_str(), choice.others[0].trials), ("new", 2));
    let input = subject("a", "g", trials);
    let curve = subject_learning_curve(&input, &CurveOptions::default());
    let gaps: Vec<_> = curve.curves[0].points.iter().map(|p| p.norm_feedforward_plant_minus_one).collect();
    assert!((gaps[0].unwrap() - 2.0).abs() < 1e-9);
    assert!((gaps[1].unwrap() - 3.0).abs() < 1e-9, "the newest identification with the spec counts");
    assert_eq!(gaps[2], None, "the other spec never fills a gap");
    assert!(codes(&curve.remarks).contains(&"several_specs"));

    let options = CurveOptions { spec_sha256: Some("new".to_owned()), ..CurveOptions::default() };
    let asked = subject_learning_curve(&input, &options);
    let spec = asked.curves[0].spec.as_ref().unwrap();
    assert_eq!((spec.spec_sha256.as_str(), spec.trials, spec.others.len()), ("new", 2, 1));
    assert_eq!(asked.curves[0].points[1].norm_feedback, None);
    assert_eq!(choose_spec(&[]), None);
}

#[test]
fn trends_compare_first_and_last_trials() {
    let trials: Vec<_> = (1..=10).map(|n| trial(n, 2.0 - 0.1 * n as f64, Vec::new())).collect();
    let curve =
        subject_learning_curve(&subject("a", "g", trials), &CurveOptions { trend_trials: 3, ..Default::default() });
    let trend = &curve.curves[0].trends.mean_abs_error;
    assert_eq!((trend.n, trend.averaged), (10, Some(3)));
    assert!((trend.first.unwrap() - 1.9).abs() < 1e-12 && (trend.last.unwrap() - 1.0).abs() < 1e-12);
    assert!((trend.mean_of_first.unwrap() - 1.8).abs() < 1e-12 && (trend.mean_of_last.unwrap() - 1.1).abs() < 1e-12);
    assert!((trend.ratio.unwrap() - 1.1 / 1.8).abs() < 1e-12);
    assert_eq!(curve.curves[0].trends.norm_feedback.n, 0);
}

#[test]
fn group_statistics_equal_direct_formulas() {
    let study: Vec<_> = [("a", 1.0, 1.2), ("b", 2.0, 1.4), ("c", 6.0, 2.0)]
        .into_iter()
        .map(|(code, error, gain)| {
            subject(code, "g", vec![trial(1, error, vec![identification(code, "s", gain, 2.0 * error)])])
        })
        .collect();
    let curves = study_learning_curves(&study, &CurveOptions::default());
    let group = &curves.groups[0];
    let m = &group.points[0].metrics;
    assert_eq!((m.mean_abs_error.n, m.mean_abs_error.mean), (3, Some(3.0)));
    // Deviations −2, −1, 3: √(14/2).
    assert!((m.mean_abs_error.sd.unwrap() - 7.0_f64.sqrt()).abs() < 1e-14);
    let trimmed = m.mean_abs_error.trimmed.as_ref().unwrap();
    assert_eq!((trimmed.n, trimmed.mean, trimmed.sd, trimmed.dropped_each_end), (1, 2.0, None, 1));
    assert!((m.norm_feedforward_plant_minus_one.mean.unwrap() - 1.6 / 3.0).abs() < 1e-9);
    assert!((m.norm_feedback.mean.unwrap() - 6.0).abs() < 1e-9);
    assert_eq!(group.last_trials.rows.iter().map(|r| r.code.as_str()).collect::<Vec<_>>(), ["a", "b", "c"]);
    assert_eq!(group.last_trials.metrics.rms_error.mean, Some(6.0));
    assert_eq!((group.points[0].right_control_at_start.count, group.points[0].right_control_at_start.of), (0, 3));
    assert_eq!(group.scatter.points.len(), 3);
    // ‖e‖ = 1, 2, 6 against 0.2, 0.4, 1: Sxy = 2.2, Sxx = 1.04/3, Syy = 14.
    let r = group.scatter.error_against_plant_minus_one;
    let exact = 2.2 / (1.04 / 3.0 * 14.0_f64).sqrt();
    assert!((r.pearson.unwrap() - exact).abs() < 1e-9, "{r:?} {exact}");
    assert!(r.n == 3 && (r.spearman.unwrap() - 1.0).abs() < 1e-12);
}

#[test]
fn trimming_drops_the_extremes_at_each_end() {
    let values = [9.0, 1.0, 5.0, 4.0, 100.0, 3.0];
    let s = statistics(&values, 1);
    let t = s.trimmed.unwrap();
    assert_eq!((s.n, t.n, t.mean), (6, 4, 5.25));
    let square = |x: f64| (x - 5.25) * (x - 5.25);
    let sd = ((square(9.0) + square(5.0) + square(4.0) + square(3.0)) / 3.0).sqrt();
    assert!((t.sd.unwrap() - sd).abs() < 1e-15);
    assert_eq!(statistics(&values, 2).trimmed.unwrap().mean, 4.5);
    assert_eq!(statistics(&values, 3).trimmed, None, "nothing would remain");
    assert_eq!(statistics(&values, 9).trimmed, None);
    assert_eq!(statistics(&values, 0).trimmed, None);
    let one = statistics(&[4.0], 0);
    assert_eq!((one.mean, one.sd), (Some(4.0), None), "one value has no deviation");
    assert_eq!(statistics(&[], 1).mean, None);
}

#[test]
fn groups_on_several_plants_are_split_and_flagged() {
    let mut other = trial(2, 1.0, Vec::new());
    other.plant = PlantName { id: "p2".to_owned(), name: "other".to_owned() };
    let study = [subject("a", "g", vec![trial(1, 1.0, vec![]), other]), subject("b", "h", vec![trial(1, 3.0, vec![])])];
    let curves = study_learning_curves(&study, &CurveOptions::default());
    let cells: Vec<_> = curves.groups.iter().map(|g| (g.group.clone().unwrap(), g.plant.name.clone())).collect();
    let expected = [("g", "lag"), ("g", "other"), ("h", "lag")].map(|(g, p)| (g.to_owned(), p.to_owned()));
    assert_eq!(cells, expected);
    assert_eq!(curves.groups[0].points.len(), 1);
    let codes = codes(&curves.remarks);
    assert!(codes.contains(&"several_plants_in_group") && codes.contains(&"groups_differ_in_plant"), "{codes:?}");
    let own = subject_learning_curve(&study[0], &CurveOptions::default());
    assert_eq!(own.curves.len(), 2);
    assert!(own.curves.iter().all(|c| c.points.len() == 1));
}

#[test]
fn a_group_without_the_common_spec_takes_its_own_and_is_flagged() {
    let of = |spec: &str, n: i64| trial(n, 1.0, vec![identification("1", spec, 1.5, 1.0)]);
    let study = [subject("a", "g", vec![of("s", 1), of("s", 2)]), subject("b", "h", vec![of("t", 1)])];
    let curves = study_learning_curves(&study, &CurveOptions::default());
    let specs: Vec<_> = curves.groups.iter().map(|g| g.spec.as_ref().unwrap().spec_sha256.as_str()).collect();
    assert_eq!(specs, ["s", "t"]);
    assert!(codes(&curves.remarks).contains(&"specs_differ_between_groups"));
}

#[test]
fn mean_responses_equal_direct_formulas() {
    // Gff G is the constant 1.2 and 1.6.
    let study: Vec<_> = [("a", 1.2), ("b", 1.6)]
        .into_iter()
        .map(|(code, gain)| subject(code, "g", vec![trial(1, 1.0, vec![identification(code, "s", gain, 3.0)])]))
        .collect();
    let omega = frequency_grid(BAND, 6);
    assert_eq!((omega[0], omega[5], omega.len()), (0.5, 3.0, 6));
    let answer = study_frequency_responses(&study, TrialSelection::Last, &omega, &CurveOptions::default(), true);
    let group = &answer.groups[0];
    assert_eq!(group.all.subjects, ["a", "b"]);
    assert_eq!(group.trimmed, None, "of two subjects nothing remains without the extremes");
    let db = |x: f64| 20.0 * x.log10();
    for (k, w) in omega.iter().enumerate() {
        let product = &group.all.feedforward_plant;
        assert_eq!(product.n[k], 2);
        assert!((product.mean[k].unwrap()[0] - 1.4).abs() < 1e-12 && product.mean[k].unwrap()[1].abs() < 1e-12);
        assert!((product.sd[k].unwrap() - 0.08_f64.sqrt()).abs() < 1e-12);
        assert!((product.gain_of_mean_db[k].unwrap() - db(1.4)).abs() < 1e-10);
        assert!((product.mean_gain_db[k].unwrap() - 0.5 * (db(1.2) + db(1.6))).abs() < 1e-10);
        let sd = (db(1.6) - db(1.2)) / 2.0_f64.sqrt();
        assert!((product.sd_gain_db[k].unwrap() - sd).abs() < 1e-10);
        assert!(product.mean_phase_deg[k].unwrap().abs() < 1e-9 && product.sd_phase_deg[k].unwrap() < 1e-9);
        // Each subject by itself, the plant, and the plant's inverse, G⁻¹ = jω + 2.
        let alone = group.subjects.as_ref().unwrap();
        for (subject, (code, gain)) in alone.iter().zip([("a", 1.2), ("b", 1.6)]) {
            let size = (w * w + 4.0).sqrt();
            assert_eq!(subject.code, code);
            assert!((subject.feedforward_plant.gain_db[k].unwrap() - db(gain)).abs() < 1e-10);
            assert!((subject.feedforward.gain_db[k].unwrap() - db(gain * size)).abs() < 1e-10);
            assert!((subject.feedback.gain_db[k].unwrap() - db(3.0)).abs() < 1e-10);
            let closed = (Complex64::new(2.0 * gain + 3.0, gain * w) / Complex64::new(5.0, *w)).norm();
            assert!((subject.closed_loop.gain_db[k].unwrap() - db(closed)).abs() < 1e-10);
        }
        let plant = group.plant_response.as_ref().unwrap();
        assert!((plant.phase_deg[k].unwrap() + w.atan2(2.0).to_degrees()).abs() < 1e-10);
        let inverse = group.inverse_plant.as_ref().unwrap();
        assert!((inverse.phase_deg[k].unwrap() - w.atan2(2.0).to_degrees()).abs() < 1e-10);
        assert!((inverse.gain_db[k].unwrap() - db((4.0 + w * w).sqrt())).abs() < 1e-10);
        // G(Gff + Gfb)/(1 + G Gfb) with G = 1/(jω+2), Gfb = 3.
        let g = 1.0 / Complex64::new(2.0, *w);
        let closed = |gain: f64| (gain + 3.0 * g) / (1.0 + 3.0 * g);
        let mean = 0.5 * (closed(1.2) + closed(1.6));
        let found = group.all.closed_loop.mean[k].unwrap();
        assert!((Complex64::new(found[0], found[1]) - mean).norm() < 1e-12);
    }
}

#[test]
fn the_chosen_trial_and_the_trimmed_subjects() {
    let study: Vec<_> = [("a", 1.9), ("b", 1.2), ("c", 1.3), ("d", 1.0)]
        .into_iter()
        .map(|(code, gain)| {
            let mut divergent = trial(4, 1.0, vec![identification("z", "s", 9.0, 1.0)]);
            divergent.divergent = true;
            let trials = vec![
                divergent,
                trial(3, 1.0, vec![]),
                trial(2, 1.0, vec![identification("y", "s", gain, 1.0)]),
                trial(1, 1.0, vec![identification("x", "s", 5.0, 1.0)]),
            ];
            subject(code, "g", trials)
        })
        .collect();
    let shown = |selection| {
        let answer = study_frequency_responses(&study, selection, &[1.0], &CurveOptions::default(), false);
        answer.groups[0].clone()
    };
    let last = shown(TrialSelection::Last);
    assert!(last.trials.iter().all(|t| t.number == 2), "{:?}", last.trials);
    assert_eq!(last.trimmed.unwrap().subjects, ["b", "c"]);
    assert!((last.all.feedforward_plant.mean[0].unwrap()[0] - 1.35).abs() < 1e-12);
    assert!(shown(TrialSelection::First).trials.iter().all(|t| t.number == 1));
    assert!(shown(TrialSelection::Number(2)).trials.iter().all(|t| t.number == 2));
    assert!(shown(TrialSelection::Number(3)).trials.is_empty());
}

#[test]
fn phases_across_the_cut_are_neighbours() {
    // 170° and −170° are 20° apart, and their mean is 180°, not 0°.
    let at = |degrees: f64| Complex64::from_polar(1.0, degrees.to_radians());
    let s = response_statistics(&[vec![at(170.0), at(-170.0)]]);
    assert!((s.mean_phase_deg[0].unwrap().abs() - 180.0).abs() < 1e-9);
    assert!((s.sd_phase_deg[0].unwrap() - 200.0_f64.sqrt()).abs() < 1e-9);
    // A phase that falls steadily is followed through several turns.
    let lag: Vec<_> = (0..30).map(|k| vec![at(-40.0 * f64::from(k)), at(-40.0 * f64::from(k) - 10.0)]).collect();
    let s = response_statistics(&lag);
    for (k, phase) in s.mean_phase_deg.iter().enumerate() {
        assert!((phase.unwrap() - (-40.0 * k as f64 - 5.0)).abs() < 1e-9, "{k} {phase:?}");
    }
    // Opposite phases have no mean.
    assert_eq!(response_statistics(&[vec![at(0.0), at(180.0)]]).mean_phase_deg[0], None);
}

#[test]
fn responses_that_are_not_finite_are_left_out_and_counted() {
    let s = response_statistics(&[vec![Complex64::new(f64::INFINITY, 0.0), Complex64::new(2.0, 0.0)], vec![]]);
    assert_eq!((s.n[0], s.mean[0], s.sd[0], s.sd_gain_db[0]), (1, Some([2.0, 0.0]), None, None));
    assert_eq!((s.n[1], s.mean[1], s.mean_gain_db[1], s.mean_phase_deg[1]), (0, None, None, None));
    let zero = response_statistics(&[vec![Complex64::new(0.0, 0.0)]]);
    assert_eq!(
        (zero.n[0], zero.mean[0], zero.mean_gain_db[0], zero.mean_phase_deg[0]),
        (1, Some([0.0, 0.0]), None, None)
    );
}

#[test]
fn the_median_subject_is_in_the_middle_of_its_group() {
    use volition::learning::curves::Metric;
    use volition::learning::median_subject::{MedianChoice, ShownTrial, ValueOver, study_median_subjects};
    let people = |errors: &[(&str, f64)]| -> Vec<SubjectInput> {
        let of = |code: &str, error: f64| {
            let own = |n: i64, e: f64| trial(n, e, vec![identification(&format!("{code}{n}"), "s", 1.2, 3.0)]);
            // The first trial of c is far out, and divergent trials count for nothing.
            let mut first = own(1, if code == "c" { 90.0 } else { error + 1.0 });
            first.divergent = code == "c";
            subject(code, "g", vec![first, own(2, error), own(7, error - 0.5)])
        };
        errors.iter().map(|(code, error)| of(code, *error)).collect()
    };
    let choice = MedianChoice {
        metric: Metric::MeanAbsError,
        over: ValueOver::All,
        trials: vec![ShownTrial::First, ShownTrial::Number(7), ShownTrial::Number(4)],
        omega_rad_s: vec![1.0, 2.0],
    };
    let options = CurveOptions::default();
    let found = study_median_subjects(&people(&[("a", 3.0), ("b", 5.0), ("c", 4.0)]), &choice, &options);
    let group = &found.groups[0];
    let values: Vec<(&str, f64, usize)> = group.ranking.iter().map(|s| (s.code.as_str(), s.value, s.trials)).collect();
    let expected = [("a", 9.5 / 3.0, 3), ("c", 3.75, 2), ("b", 15.5 / 3.0, 3)];
    for ((code, value, trials), wanted) in values.iter().zip(expected) {
        assert!(*code == wanted.0 && (value - wanted.1).abs() < 1e-12 && *trials == wanted.2, "{values:?}");
    }
    assert_eq!((group.median.as_ref().unwrap().code.as_str(), &group.other_middle), ("c", &None));
    let shown: Vec<i64> = group.trials.iter().map(|t| t.point.number).collect();
    assert_eq!(shown, [2, 7], "its first trial is divergent, and it has no fourth");
    assert_eq!(codes(&found.remarks), ["trial_not_shown"]);
    let responses = group.trials[0].responses.as_ref().unwrap();
    assert!((responses.feedback.gain_db[1].unwrap() - 20.0 * 3.0_f64.log10()).abs() < 1e-12);
    // By its last trial; of two the lower one, with the other named.
    let last = MedianChoice { over: ValueOver::Last, trials: vec![ShownTrial::Last], ..choice };
    let found = study_median_subjects(&people(&[("b", 5.0), ("a", 3.0)]), &last, &options);
    let group = &found.groups[0];
    assert_eq!(group.median.as_ref().map(|s| (s.code.as_str(), s.value)), Some(("a", 2.5)));
    assert_eq!(group.other_middle.as_ref().map(|s| s.code.as_str()), Some("b"));
    assert_eq!(codes(&found.remarks), ["no_single_median"]);
    // Nobody has a value of a norm where nothing is identified.
    let norm = MedianChoice { metric: Metric::NormFeedback, ..last };
    let nobody = [subject("a", "g", vec![trial(1, 1.0, Vec::new())])];
    let found = study_median_subjects(&nobody, &norm, &options);
    assert_eq!((&found.groups[0].median, codes(&found.remarks)), (&None, vec!["subjects_without_value"]));
}

#[test]
fn answers_are_json_and_come_back() {
    let study = [subject("a", "g", vec![trial(1, 1.0, vec![identification("x", "s", 1.1, 1.0)])])];
    let curves = study_learning_curves(&study, &CurveOptions::default());
    let text = serde_json::to_string(&curves).unwrap();
    assert_eq!(serde_json::from_str::<volition::learning::StudyLearningCurves>(&text).unwrap(), curves);
    let answer =
        study_frequency_responses(&study, TrialSelection::Number(1), &[0.5, 1.0], &CurveOptions::default(), false);
    let text = serde_json::to_string(&answer).unwrap();
    assert_eq!(serde_json::from_str::<volition::learning::StudyFrequencyResponses>(&text).unwrap(), answer);
}

proptest::proptest! {
    #![proptest_config(from_seed(3, 256))]
    #[test]
    fn turning_every_subject_turns_the_mean_and_nothing_else(
        gains in proptest::collection::vec(0.1_f64..10.0, 2..8),
        phases in proptest::collection::vec(-80.0_f64..80.0, 8),
        turn in -720.0_f64..720.0,
    ) {
        let responses = |turn: f64| -> Vec<Complex64> {
            let one = |(g, p): (&f64, &f64)| Complex64::from_polar(*g, (p + turn).to_radians());
            gains.iter().zip(&phases).map(one).collect()
        };
        let (still, turned) = (response_statistics(&[responses(0.0)]), response_statistics(&[responses(turn)]));
        let difference = turned.mean_phase_deg[0].unwrap() - still.mean_phase_deg[0].unwrap() - turn;
        proptest::prop_assert!((difference / 360.0 - (difference / 360.0).round()).abs() < 1e-9);
        proptest::prop_assert!((turned.sd_phase_deg[0].unwrap() - still.sd_phase_deg[0].unwrap()).abs() < 1e-8);
        proptest::prop_assert!((turned.mean_gain_db[0].unwrap() - still.mean_gain_db[0].unwrap()).abs() < 1e-9);
        proptest::prop_assert!((turned.sd[0].unwrap() - still.sd[0].unwrap()).abs() < 1e-9);
        // Phases within 80° of each other's centre need no unwrapping: their mean is the plain one.
        let plain = phases[..gains.len()].iter().sum::<f64>() / gains.len() as f64;
        proptest::prop_assert!((still.mean_phase_deg[0].unwrap() - plain).abs() < 1e-9);
    }

    #[test]
    fn statistics_do_not_depend_on_order_and_trimming_keeps_the_middle(
        values in proptest::collection::vec(-100.0_f64..100.0, 1..20),
        trim in 0_usize..6,
    ) {
        let mut reversed = values.clone();
        reversed.reverse();
        let (a, b) = (statistics(&values, trim), statistics(&reversed, trim));
        proptest::prop_assert_eq!(&a.trimmed, &b.trimmed);
        proptest::prop_assert!((a.mean.unwrap() - b.mean.unwrap()).abs() < 1e-10);
        proptest::prop_assert_eq!(a.trimmed.is_some(), trim > 0 && values.len() > 2 * trim);
        if let Some(t) = a.trimmed {
            proptest::prop_assert_eq!(t.n, values.len() - 2 * trim);
            let mut kept = values.clone();
            kept.sort_by(f64::total_cmp);
            let kept = &kept[trim..values.len() - trim];
            proptest::prop_assert!(kept[0] <= t.mean + 1e-12 && t.mean <= kept[kept.len() - 1] + 1e-12);
        }
    }
}

/// The estimator that is shown, and another on the same trials.
#[test]
fn estimators_are_compared_where_both_have_intervals() {
    let with = |estimator, analysis: &str, interval: Option<[f64; 2]>| Identification {
        estimator,
        intervals: NormIntervals { norm_feedback: interval, ..NormIntervals::default() },
        ..identification(analysis, "aa", 0.8, 1.0)
    };
    let pair = |number, other: Option<[f64; 2]>| TrialInput {
        by_other_estimators: vec![
            // The older one does not count.
            with(Estimator::TwoStimulus, "00", Some([50.0, 60.0])),
            with(Estimator::TwoStimulus, "01", other),
        ],
        ..trial(number, 1.0, vec![with(Estimator::PredictionError, "02", Some([0.8, 1.2]))])
    };
    let trials = vec![pair(1, Some([1.1, 2.0])), pair(2, Some([1.5, 2.0])), pair(3, None)];
    let options = CurveOptions { estimator: Estimator::PredictionError, ..CurveOptions::default() };
    let curve = subject_learning_curve(&subject("s01", "gm", trials), &options);
    assert_eq!(curve.curves[0].points[0].intervals_95.norm_feedback, Some([0.8, 1.2]));
    let remarks: Vec<&str> = curve.remarks.iter().map(|r| r.message.as_str()).collect();
    assert!(
        remarks.iter().any(|m| m.contains("prediction_error and two_stimulus differ") && m.contains("1 of 2 trials")),
        "{remarks:?}"
    );
}
