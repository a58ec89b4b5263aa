use super::*;
use crate::learning::frequency_domain::ControllerMetrics;
use crate::learning::time_domain::TimeDomainMetrics;
use crate::learning::{
    CurveOptions, Estimator, Identification, NormIntervals, PlantName, StandardErrors, SubjectInput, TrialInput,
    study_learning_curves,
};
use crate::trust::Evidence;

/// Subjects of two groups with errors by trial number; `session` of each trial.
fn curves(groups: usize, sessions: &[Option<i64>]) -> StudyLearningCurves {
    identified(groups, sessions, &|_| None)
}

/// The same with what was identified of each trial, by its number.
fn identified(
    groups: usize,
    sessions: &[Option<i64>],
    found: &dyn Fn(i64) -> Option<Identification>,
) -> StudyLearningCurves {
    let plant = PlantName { id: "p".into(), name: "minimum phase".into() };
    let subjects: Vec<SubjectInput> = (0..groups * 3)
        .map(|subject| SubjectInput {
            subject: format!("id{subject}"),
            code: format!("S{subject}"),
            group: Some(format!("group {}", subject / 3)),
            trials: sessions
                .iter()
                .flat_map(|session| [1, 5, 10].map(|number| (*session, number)))
                .map(|(session, number)| TrialInput {
                    trial: format!("t{subject}-{session:?}-{number}"),
                    number,
                    session,
                    plant: plant.clone(),
                    divergent: false,
                    excluded: None,
                    metrics: metrics(1.0 / number as f64 + 0.1 * (subject % 3) as f64),
                    identifications: found(number).into_iter().collect(),
                    by_other_estimators: Vec::new(),
                })
                .collect(),
        })
        .collect();
    study_learning_curves(&subjects, &CurveOptions::default())
}

fn metrics(error: f64) -> TimeDomainMetrics {
    serde_json::from_value(serde_json::json!({
        "mean_abs_error": error, "rms_error": 2.0 * error, "max_abs_output": 1.0, "right_control_at_start": null,
        "right_control_threshold": 0.05
    }))
    .unwrap()
}

fn figure(curves: &StudyLearningCurves, metric: Metric) -> Figure {
    learning_curve(curves, metric, &Units::default())
}

fn named<'a>(figure: &'a Figure, name: &str) -> &'a Series {
    figure.panels.iter().flat_map(|p| &p.series).find(|s| s.name == name).unwrap_or_else(|| panic!("no {name}"))
}

#[test]
fn means_bands_and_subjects_are_those_of_the_curves() {
    let curves = curves(2, &[None]);
    let found = figure(&curves, Metric::MeanAbsError);
    assert_eq!(found.panels.len(), 1);
    assert_eq!(found.panels[0].y.text(), "mean |r − y| (unit of y)");
    let mean = named(&found, "group 1");
    assert_eq!(mean.x, [1.0, 5.0, 10.0]);
    let own: Vec<Option<f64>> = curves.groups[1].points.iter().map(|p| p.metrics.mean_abs_error.mean).collect();
    assert_eq!(mean.y, own);
    assert_eq!((mean.ink, mean.labelled), (Ink::Second, true));
    // Means of 1.0, 1.1 and 1.2: a deviation of 0.1.
    let band = named(&found, "group 0: mean ± 1 SD");
    assert!((band.low[0].unwrap() - 1.0).abs() < 1e-12 && (band.high[0].unwrap() - 1.2).abs() < 1e-12, "{band:?}");
    assert_eq!(named(&found, "S4").y[2], Some(0.1 + 0.1));
    let notes = &named(&found, "group 0: mean").notes;
    assert_eq!(notes[0], "group 0 · trial 1 · mean 1.10 ± 0.100 (SD) of 3 · ok");
    let expected =
        "group 0: from the first trial to the last the tracking error fell from 1.10 to 0.200 (−82 %, n = 3).";
    assert!(found.description.starts_with(expected), "{}", found.description);
    assert!(!found.caption.contains('×'), "{}", found.caption);
}

#[test]
fn a_quantity_that_nobody_identified_has_no_curve_and_no_statement() {
    let found = figure(&curves(2, &[None]), Metric::NormFeedback);
    assert!(found.panels[0].series.iter().all(Series::is_empty));
    assert!(found.description.contains("nobody has both a first and a last value of ‖Gfb‖"), "{}", found.description);
    assert_eq!(found.panels[0].y.text(), "‖Gfb‖ (unit of u / unit of y)");
}

/// ‖Gfb‖ = 2 with an interval; of a trial whose number is 1 a wide one.
fn feedback(number: i64, wide: [f64; 2], evidence: Evidence) -> Identification {
    let interval = if number == 1 { wide } else { [1.9, 2.1] };
    Identification {
        analysis: "a".into(),
        spec_sha256: "0123456789".into(),
        estimator: Estimator::PredictionError,
        controllers: None,
        metrics: Some(ControllerMetrics {
            norm_feedback: Some(2.0),
            norm_feedforward_minus_inverse: None,
            norm_feedforward_plant_minus_one: None,
            band_rad_s: [0.1, 3.0],
            undefined: Vec::new(),
        }),
        standard_errors: StandardErrors::default(),
        intervals: NormIntervals { norm_feedback: Some(interval), ..NormIntervals::default() },
        variance_accounted_for: Some(0.9),
        cost: None,
        evidence,
    }
}

#[test]
fn what_is_not_to_be_used_is_crossed_out_and_makes_no_statement() {
    let wide = |number| Some(feedback(number, [0.1, 3.9], Evidence::default()));
    let study = identified(1, &[None], &wide);
    let found = figure(&study, Metric::NormFeedback);
    let crosses = named(&found, "group 0: not to be used");
    assert_eq!((crosses.x.as_slice(), crosses.y.len()), (&[1.0, 1.0, 1.0][..], 3));
    let note = "S0 · trial 1 · 2.00 [0.100, 3.90] · do not use: its 95 % interval runs from 0.100 to 3.900";
    assert_eq!(crosses.notes[0], note);
    let refusal = "no statement about ‖Gfb‖: 3 of the 6 values are not to be used. Record longer, or several trials";
    assert!(found.description.contains(refusal), "{}", found.description);
    assert!(found.caption.contains("×: do not use, 3 of 9 values; the means take them in."), "{}", found.caption);
    assert_eq!(named(&found, "group 0: 95 % intervals of subjects").x.len(), 9);
    // The mean of the first trials is not to be used, those of the others are.
    let levels = &named(&found, "group 0: mean").trust;
    assert_eq!(levels.iter().filter(|level| **level == Level::DoNotUse).count(), 1, "{levels:?}");
    let remark = study.remarks.iter().find(|remark| remark.code == "values_not_to_be_used").unwrap();
    assert!(remark.message.contains("3 of 9 of norm_feedback"), "{remark:?}");
    // What reports say of the stimuli crosses out as well.
    let alone = Evidence { feedback_not_told: Some("one response".into()), ..Evidence::default() };
    let found =
        figure(&identified(1, &[None], &|n| Some(feedback(n, [1.9, 2.1], alone.clone()))), Metric::NormFeedback);
    assert_eq!(named(&found, "group 0: not to be used").x.len(), 9);
}

#[test]
fn sessions_are_counted_on_and_bordered() {
    let found = figure(&curves(1, &[Some(1), Some(2)]), Metric::MeanAbsError);
    assert_eq!(named(&found, "group 0").x, [1.0, 5.0, 10.0, 11.0, 15.0, 20.0]);
    let borders: Vec<(f64, &str)> = found.panels[0].rules.iter().map(|rule| (rule.at, rule.label.as_str())).collect();
    assert_eq!(borders, [(10.5, "session 2")]);
    assert_eq!(found.x.label, "trial, counted on through the sessions");
    let single = figure(&curves(1, &[Some(3)]), Metric::MeanAbsError);
    assert_eq!((single.x.label.as_str(), single.panels[0].rules.len()), ("trial", 0));
}

#[test]
fn more_than_four_groups_have_panels_of_one_scale() {
    let found = figure(&curves(5, &[None]), Metric::MeanAbsError);
    assert_eq!(found.panels.len(), 5);
    let seen = found.view(&crate::figure::View { from: None, to: None, columns: 500 }).unwrap();
    assert!(seen.panels.windows(2).all(|pair| pair[0].y.range == pair[1].y.range));
    assert_eq!(found.panels[3].title, "group 3");
}
