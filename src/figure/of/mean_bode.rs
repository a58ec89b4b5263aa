//! Bode plots of the groups of a study: the mean of the subjects with its spread.

use super::places::trial;
use super::provenance::{eight, product};
use crate::figure::text::{listed, three};
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::learning::bode::{ControllerStatistics, GroupResponses, Response, ResponseStatistics, ResponseTrial};
use crate::learning::{StudyFrequencyResponses, TrialSelection};
use crate::trust::{Level, of_mean};
use std::f64::consts::TAU;

/// The name of the figure in addresses.
pub const NAME: &str = "bode";
/// First trials against last ones, with the closed loop.
pub const PRACTICE: &str = "bode_practice";
/// Without the subjects of the largest and the smallest ‖Gff G − 1‖.
pub const TRIMMED: &str = "bode_trimmed";

/// A mean of fewer subjects has no band.
const LEAST_FOR_BAND: usize = 3;

/// A response that is drawn: its symbol, which of a group's it is, and what it is compared with.
struct Drawn {
    symbol: &'static str,
    pick: fn(&ControllerStatistics) -> &ResponseStatistics,
    against: Against,
}

/// What a response is compared with.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Against {
    Nothing,
    /// The plant's inverse, a curve.
    Inverse,
    /// 1, with what that means.
    One(&'static str),
}

const FEEDFORWARD: Drawn = Drawn { symbol: "Gff", pick: |all| &all.feedforward, against: Against::Inverse };
const FEEDBACK: Drawn = Drawn { symbol: "Gfb", pick: |all| &all.feedback, against: Against::Nothing };
const PRODUCT: Drawn =
    Drawn { symbol: "Gff·G", pick: |all| &all.feedforward_plant, against: Against::One("inverse of the plant") };
const LOOP: Drawn = Drawn { symbol: "Gyr", pick: |all| &all.closed_loop, against: Against::One("y follows r") };

/// A group's mean in one way of drawing.
struct Curve<'a> {
    name: String,
    ink: Ink,
    weight: Weight,
    group: &'a GroupResponses,
    of: &'a ControllerStatistics,
}

fn name(group: &GroupResponses, all: &[GroupResponses]) -> String {
    let own = group.group.as_deref().unwrap_or("without a group");
    let is_alone = all.iter().filter(|other| other.group == group.group).count() == 1;
    // Of one person the person is meant.
    match group.trials.as_slice() {
        [only] => only.code.clone(),
        _ if is_alone => own.to_owned(),
        _ => format!("{own} on {}", group.plant.name),
    }
}

/// Band and line of a mean.
fn series(curve: &Curve<'_>, x: &[f64], n: &[usize], [mean, sd]: [&[Option<f64>]; 2]) -> Vec<Series> {
    let Curve { name, ink, weight, .. } = curve;
    let line = Series::values(name.as_str(), (Mark::Line, *ink, *weight), x.to_vec(), mean.iter().copied());
    let ends: Vec<Option<[f64; 2]>> = mean
        .iter()
        .zip(sd)
        .zip(n)
        .map(|((mean, sd), n)| {
            let (mean, sd) = (*mean).zip(*sd).filter(|_| *n >= LEAST_FOR_BAND)?;
            Some([mean - sd, mean + sd])
        })
        .collect();
    let mut found = Vec::new();
    if ends.iter().any(Option::is_some) {
        let look = (Mark::Band, *ink, Weight::Thin);
        found.push(Series::intervals(format!("{name}: mean ± 1 SD"), look, x.to_vec(), ends));
    }
    found.push(line.labelled());
    found
}

/// The inverse dynamics of each plant, once.
fn inverses(curves: &[Curve<'_>], x: &[f64], pick: fn(&Response) -> &Vec<Option<f64>>) -> Vec<Series> {
    let mut seen: Vec<&str> = Vec::new();
    let mut found = Vec::new();
    for group in curves.iter().map(|curve| curve.group) {
        let Some(inverse) = group.inverse_plant.as_ref().filter(|_| !seen.contains(&&*group.plant.id)) else {
            continue;
        };
        seen.push(&group.plant.id);
        let name = if curves.iter().all(|own| own.group.plant.id == group.plant.id) {
            "G⁻¹".to_owned()
        } else {
            format!("G⁻¹ of {}", group.plant.name)
        };
        let look = (Mark::Line, Ink::Muted, Weight::Thin);
        found.push(Series::values(name, look, x.to_vec(), pick(inverse).iter().copied()).labelled());
    }
    found
}

/// Gain above phase, for each response in a column of its own.
fn panels(curves: &[Curve<'_>], x: &[f64], drawn: &[Drawn], is_doubtful: bool) -> Vec<Panel> {
    let mut panels = Vec::new();
    for (column, Drawn { symbol, pick, against }) in drawn.iter().enumerate() {
        let (mut gains, mut phases) = (Vec::new(), Vec::new());
        if *against == Against::Inverse {
            gains.extend(inverses(curves, x, |own| &own.gain_db));
            phases.extend(inverses(curves, x, |own| &own.phase_deg));
        }
        for curve in curves {
            let own = pick(curve.of);
            gains.extend(series(curve, x, &own.n, [&own.mean_gain_db, &own.sd_gain_db]));
            phases.extend(series(curve, x, &own.n, [&own.mean_phase_deg, &own.sd_phase_deg]));
        }
        let title = if *symbol == "Gfb" && is_doubtful { "Gfb: × do not use" } else { symbol };
        let mut gain = Panel::new(title, Axis::linear(format!("|{symbol}|"), "dB"), gains).in_column(column);
        let mut phase = Panel::new("", Axis::linear(format!("∠{symbol}"), "°"), phases).in_column(column);
        if let Against::One(meaning) = against {
            (gain.y, phase.y) = (gain.y.including(&[0.0]), phase.y.including(&[0.0]));
            gain = gain.with_rule(0.0, *meaning, RuleKind::Reference);
            phase = phase.with_rule(0.0, "", RuleKind::Reference);
        }
        panels.extend([gain, phase]);
    }
    panels
}

/// Of how many trials, and in how many of them the stimuli do not tell the feedback, and what that says of their mean.
fn doubts<'a>(groups: impl Iterator<Item = &'a GroupResponses>) -> ([usize; 2], bool) {
    let told = |trial: &ResponseTrial| if trial.feedback_not_told.is_some() { Level::DoNotUse } else { Level::Ok };
    let found = of_mean(&groups.flat_map(|group| &group.trials).map(told).collect::<Vec<_>>());
    ([found.of, found.do_not_use], found.level == Level::DoNotUse)
}

fn hertz(responses: &StudyFrequencyResponses) -> Vec<f64> {
    responses.omega_rad_s.iter().map(|omega| omega / TAU).collect()
}

/// Mean gain and phase over the subjects of each group, ± 1 SD: Gff beside G⁻¹, Gfb and Gff·G.
#[must_use]
pub fn mean_bode(responses: &StudyFrequencyResponses) -> Figure {
    whole(responses, NAME, "", |group| Some(&group.all))
}

/// The same without the subjects of the largest and the smallest ‖Gff G − 1‖ (Zhang 2015, figure 5.18).
#[must_use]
pub fn trimmed_bode(responses: &StudyFrequencyResponses) -> Figure {
    whole(responses, TRIMMED, ", without the extremes", |group| group.trimmed.as_ref())
}

fn whole(
    responses: &StudyFrequencyResponses,
    own_name: &str,
    about: &str,
    pick: fn(&GroupResponses) -> Option<&ControllerStatistics>,
) -> Figure {
    let groups = &responses.groups;
    let ([all, bad], is_doubtful) = doubts(groups.iter());
    let curves: Vec<Curve<'_>> = groups
        .iter()
        .enumerate()
        .filter_map(|(at, group)| {
            let (name, ink) = (name(group, groups), Ink::of_group(at));
            Some(Curve { name, ink, weight: Weight::Thick, group, of: pick(group)? })
        })
        .collect();
    let shown = match responses.selection {
        TrialSelection::First => "the first trial".to_owned(),
        TrialSelection::Last => "the last trial".to_owned(),
        TrialSelection::Number(number) => format!("trial {number}"),
    };
    Figure {
        name: own_name.to_owned(),
        title: format!("Identified controllers on {shown}{about}"),
        description: description(&curves),
        caption: caption(groups, &curves, [all, bad]),
        sampling: String::new(),
        x: Axis::logarithmic("frequency", "Hz"),
        panels: panels(&curves, &hertz(responses), &[FEEDFORWARD, FEEDBACK, PRODUCT], is_doubtful),
    }
}

/// First trials (thin) against last ones (thick): Gff beside G⁻¹, Gfb and the closed loop (Zhang 2015, figures 3.5 and
/// 5.13).
#[must_use]
pub fn practice_bode(first: &StudyFrequencyResponses, last: &StudyFrequencyResponses) -> Figure {
    let mut curves = Vec::new();
    for (at, before) in first.groups.iter().enumerate() {
        let after = last.groups.iter().find(|own| own.group == before.group && own.plant == before.plant);
        // The first trial of a group is dashed as its second neighbour where there is one group alone.
        let ink = Ink::of_group(at);
        let before_ink = if first.groups.len() == 1 { Ink::Second } else { ink };
        let named = |group, all, when| format!("{}, {when}", name(group, all));
        curves.push(Curve {
            name: named(before, &first.groups, "first"),
            ink: before_ink,
            weight: Weight::Thin,
            group: before,
            of: &before.all,
        });
        if let Some(after) = after {
            let name = named(after, &last.groups, "last");
            curves.push(Curve { name, ink, weight: Weight::Thick, group: after, of: &after.all });
        }
    }
    let all_groups = || first.groups.iter().chain(&last.groups);
    let ([all, bad], is_doubtful) = doubts(all_groups());
    let groups: Vec<GroupResponses> = all_groups().cloned().collect();
    let subjects: Vec<&str> = groups.iter().flat_map(|group| &group.trials).map(|own| own.code.as_str()).collect();
    let of = match subjects.first() {
        Some(only) if subjects.iter().all(|own| own == only) => format!(" of {only}"),
        _ => String::new(),
    };
    Figure {
        name: PRACTICE.to_owned(),
        title: format!("Identified controllers{of} on the first and the last trial"),
        description: description(&curves),
        caption: format!("Thin: first trials; thick: last ones. {}", caption(&groups, &curves, [all, bad])),
        sampling: String::new(),
        x: Axis::logarithmic("frequency", "Hz"),
        panels: panels(&curves, &hertz(last), &[FEEDFORWARD, FEEDBACK, LOOP], is_doubtful),
    }
}

fn description(curves: &[Curve<'_>]) -> String {
    let sentence = |curve: &Curve<'_>| {
        let gains = curve.of.feedforward_plant.mean_gain_db.iter().flatten();
        let far = gains.copied().max_by(|a, b| a.abs().total_cmp(&b.abs()));
        let name = &curve.name;
        far.map_or_else(
            || format!("{name}: nothing is identified."),
            |far| {
                format!("{name}: the mean gain of Gff·G is at most {} dB from that of the plant's inverse.", three(far))
            },
        )
    };
    let sentences: Vec<String> = curves.iter().map(sentence).collect();
    if sentences.is_empty() { "Nothing is identified yet.".to_owned() } else { sentences.join(" ") }
}

fn caption(groups: &[GroupResponses], curves: &[Curve<'_>], [all, bad]: [usize; 2]) -> String {
    let mut text = "Mean over subjects of gain in dB and of phase; band: ± 1 SD of three subjects or more.".to_owned();
    for curve in curves.iter().filter(|curve| !curve.group.trials.is_empty()) {
        // Those that are drawn: the extremes are not where they are left out.
        let drawn = curve.group.trials.iter().filter(|own| curve.of.subjects.contains(&own.code));
        let of = |own: &ResponseTrial| format!("{} {}", own.code, trial(own.session, own.number));
        text.push_str(&format!(" {}: {}.", curve.name, listed(&drawn.map(of).collect::<Vec<_>>())));
    }
    if bad > 0 {
        text.push_str(&format!(
            " In {bad} of {all} trials the stimuli do not tell feedback from feedforward: the feedback shown is the \
             method's choice."
        ));
    }
    let mut specs: Vec<String> =
        groups.iter().filter_map(|group| Some(eight(&group.spec.as_ref()?.spec_sha256).to_owned())).collect();
    specs.dedup();
    if !specs.is_empty() {
        text.push_str(&format!(" Spec {}.", listed(&specs)));
    }
    text.push_str(&format!(" {}.", product()));
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Model;
    use crate::learning::inputs::{Estimator, Identification, NormIntervals, StandardErrors};
    use crate::learning::{
        CurveOptions, IdentifiedControllers, PlantName, SubjectInput, TrialInput, study_frequency_responses,
    };
    use crate::trust::Evidence;
    use serde_json::json;

    /// Three people whose feedforward is the plant's inverse times 1/2, 1 and 2: 0 dB ± 6 dB.
    #[test]
    fn means_and_spreads_are_those_of_the_subjects() {
        let model = |num: &[f64], den: &[f64]| {
            serde_json::from_value::<Model>(json!({"num": num, "den": den})).unwrap().check().unwrap()
        };
        let subjects: Vec<SubjectInput> = [0.5, 1.0, 2.0]
            .iter()
            .enumerate()
            .map(|(at, gain)| SubjectInput {
                subject: format!("id{at}"),
                code: format!("S{at}"),
                group: Some("one".into()),
                trials: vec![TrialInput {
                    trial: format!("t{at}"),
                    number: 40,
                    session: None,
                    plant: PlantName { id: "p".into(), name: "first order".into() },
                    divergent: false,
                    excluded: None,
                    metrics: serde_json::from_value(json!({
                        "mean_abs_error": 1.0, "rms_error": 1.0, "max_abs_output": 1.0,
                        "right_control_at_start": null, "right_control_threshold": 0.05
                    }))
                    .unwrap(),
                    identifications: vec![Identification {
                        analysis: format!("a{at}"),
                        spec_sha256: "0123456789".into(),
                        estimator: Estimator::Ssid,
                        controllers: Some(IdentifiedControllers {
                            plant: model(&[4.0], &[1.0, 2.0]),
                            feedforward: model(&[0.25 * gain, 0.5 * gain], &[1.0]),
                            feedback: model(&[2.0], &[1.0]),
                        }),
                        metrics: None,
                        standard_errors: StandardErrors::default(),
                        intervals: NormIntervals::default(),
                        variance_accounted_for: None,
                        cost: None,
                        evidence: Evidence::default(),
                    }],
                    by_other_estimators: Vec::new(),
                }],
            })
            .collect();
        let omega = [1.0, 2.0, 4.0];
        let options = CurveOptions::default();
        let responses = study_frequency_responses(&subjects, TrialSelection::Last, &omega, &options, false);
        let told = |count: usize| {
            let mut own = responses.clone();
            let trials = own.groups.iter_mut().flat_map(|group| &mut group.trials);
            trials.take(count).for_each(|trial| trial.feedback_not_told = Some("one response".into()));
            own
        };
        let figure = mean_bode(&told(1));
        let [band, line] = [0, 1].map(|at| &figure.panels[4].series[at]);
        assert_eq!((line.name.as_str(), line.x.len()), ("one", 3));
        for at in 0..3 {
            let six = 20.0 * 2f64.log10();
            assert!(line.y[at].unwrap().abs() < 1e-9, "{line:?}");
            assert!((band.low[at].unwrap() + six).abs() < 1e-9 && (band.high[at].unwrap() - six).abs() < 1e-9);
            assert!((figure.panels[2].series[1].y[at].unwrap() - six).abs() < 1e-9);
        }
        // One of three is not more than a third.
        assert_eq!(figure.panels[2].title, "Gfb");
        assert_eq!(mean_bode(&told(2)).panels[2].title, "Gfb: × do not use");
        assert!(figure.caption.contains("one: S0 trial 40, S1 trial 40 and S2 trial 40."), "{}", figure.caption);
        assert!(figure.caption.contains("In 1 of 3 trials") && figure.caption.contains("Spec 01234567."));
    }
}
