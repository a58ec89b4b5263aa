use super::*;
use Level::{DoNotUse, NotIdentified, Ok, Read};

const NARROW: Estimate<'static> = Estimate {
    quantity: "norm_feedback",
    sort: Sort::Feedback,
    value: Some(0.4),
    interval: Some([0.36, 0.44]),
    reason: None,
    spread: None,
};

/// The same without an interval.
const ALONE: Estimate<'static> = Estimate { interval: None, ..NARROW };

/// Every row by itself, at both sides of its border.
#[test]
fn each_row_of_the_rule_has_its_level() {
    let clean = Evidence::default();
    let with = |change: &dyn Fn(&mut Evidence)| {
        let mut own = clean.clone();
        change(&mut own);
        own
    };
    let told = with(&|e| e.feedback_not_told = Some("one response".into()));
    let distance = Estimate { quantity: "norm_feedforward_plant_minus_one", sort: Sort::Feedforward, ..NARROW };
    let of = |interval: [f64; 2]| Estimate { interval: Some(interval), ..NARROW };
    let spread = |ends: [f64; 2]| Estimate { spread: Some(ends), ..NARROW };
    let cases: Vec<(Estimate, Evidence, Level, &str)> = vec![
        (NARROW, clean.clone(), Ok, "ok"),
        (Estimate { value: None, ..NARROW }, clean.clone(), NotIdentified, "not_identified"),
        (NARROW, with(&|e| e.agreement = Agreement::Foreign), DoNotUse, "output_not_from_control"),
        (NARROW, with(&|e| e.agreement = Agreement::Loose), Read, "output_loosely_from_control"),
        (ALONE, with(&|e| e.simulation_fails = true), DoNotUse, "simulation_fails"),
        (ALONE, with(&|e| e.simulated_share = Some(0.0)), DoNotUse, "simulation_fails"),
        (NARROW, with(&|e| e.simulation_fails = true), Read, "simulation_fails"),
        (NARROW, with(&|e| e.simulated_share = Some(0.49)), Read, "simulation_weak"),
        (NARROW, with(&|e| e.simulated_share = Some(0.5)), Ok, "ok"),
        (of([0.1, 0.7]), clean.clone(), DoNotUse, "interval_too_wide"),
        (of([0.2, 0.61]), clean.clone(), DoNotUse, "interval_too_wide"),
        (of([0.0, 0.3]), clean.clone(), DoNotUse, "interval_too_wide"),
        (of([0.29, 0.51]), clean.clone(), Read, "interval_wide"),
        (of([0.31, 0.49]), clean.clone(), Ok, "ok"),
        (spread([0.3, 1.0]), clean.clone(), DoNotUse, "spread_too_wide"),
        (spread([0.3, 0.6]), clean.clone(), Read, "spread_wide"),
        (spread([0.3, 0.37]), clean.clone(), Ok, "ok"),
        (NARROW, told.clone(), DoNotUse, "feedback_not_told"),
        (distance, told.clone(), Read, "feedback_not_told"),
        (Estimate { sort: Sort::Share, ..NARROW }, told, Ok, "ok"),
        (Estimate { interval: None, ..NARROW }, clean.clone(), Read, "no_interval"),
        (Estimate { sort: Sort::Share, interval: None, ..NARROW }, clean.clone(), Ok, "ok"),
        (NARROW, with(&|e| e.residual_p = Some(0.0009)), Read, "interval_refused"),
        (NARROW, with(&|e| e.residual_p = Some(0.04)), Read, "interval_doubtful"),
        (NARROW, with(&|e| e.residual_p = Some(0.06)), Ok, "ok"),
        (NARROW, with(&|e| e.not_converged = Some("no".into())), Read, "not_converged"),
        (NARROW, with(&|e| e.held_back = vec!["edge_of_pool".into()]), Read, "held_back"),
        (NARROW, with(&|e| e.form_moves_answer = vec!["answer_moves".into()]), Read, "form_moves_answer"),
    ];
    for (estimate, evidence, level, code) in cases {
        let found = judge(&estimate, &evidence, false);
        assert_eq!((found.level, found.code.as_str()), (level, code), "{estimate:?} {evidence:?}: {found:?}");
        assert_eq!(found.advice, advice(code));
        let diverged = judge(&estimate, &evidence, true);
        let expected = if level == NotIdentified { NotIdentified } else { DoNotUse };
        assert_eq!(diverged.level, expected);
    }
    assert_eq!(measured("rms_error", false).code, "measured");
    assert_eq!(measured("rms_error", true).level, DoNotUse);
}

#[test]
fn the_gravest_row_decides_and_the_others_are_kept() {
    let evidence = Evidence { feedback_not_told: Some("one response".into()), ..Evidence::default() };
    let estimate = Estimate { interval: None, reason: Some("one segment"), ..NARROW };
    let found = judge(&estimate, &evidence, false);
    assert_eq!(found.codes().collect::<Vec<_>>(), ["feedback_not_told", "no_interval"]);
    assert_eq!(found.also[0].because, "no interval: one segment");
}
