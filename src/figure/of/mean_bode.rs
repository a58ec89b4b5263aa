//! Bode plots of the groups of a study: the mean of the subjects with its spread.

use super::places::trial;
use super::provenance::{eight, product};
use crate::figure::text::{listed, three};
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::learning::bode::{ControllerStatistics, GroupResponses, ResponseStatistics, ResponseTrial};
use crate::learning::{StudyFrequencyResponses, TrialSelection};
use crate::trust::{Level, of_mean};
use std::f64::consts::TAU;

/// The name of the figure in addresses.
pub const NAME: &str = "bode";

/// A mean of fewer subjects has no band.
const LEAST_FOR_BAND: usize = 3;

/// Picks one of the responses of a group.
type Pick = fn(&ControllerStatistics) -> &ResponseStatistics;

/// The responses that are drawn: symbol, which, and whether 1 is the plant's inverse.
const RESPONSES: [(&str, Pick, bool); 3] = [
    ("Gff", |all| &all.feedforward, false),
    ("Gfb", |all| &all.feedback, false),
    ("Gff·G", |all| &all.feedforward_plant, true),
];

fn name(group: &GroupResponses, all: &[GroupResponses]) -> String {
    let own = group.group.as_deref().unwrap_or("without a group");
    let is_alone = all.iter().filter(|other| other.group == group.group).count() == 1;
    if is_alone { own.to_owned() } else { format!("{own} on {}", group.plant.name) }
}

/// Line and band of a mean.
fn series(name: &str, ink: Ink, x: &[f64], n: &[usize], [mean, sd]: [&[Option<f64>]; 2]) -> [Series; 2] {
    let ends = mean.iter().zip(sd).zip(n).map(|((mean, sd), n)| {
        let (mean, sd) = (*mean).zip(*sd).filter(|_| *n >= LEAST_FOR_BAND)?;
        Some([mean - sd, mean + sd])
    });
    let band = Series::intervals(format!("{name}: mean ± 1 SD"), (Mark::Band, ink, Weight::Thin), x.to_vec(), ends);
    let line = Series::values(name, (Mark::Line, ink, Weight::Thick), x.to_vec(), mean.iter().copied());
    [band, line.labelled()]
}

/// Mean gain and phase over the subjects of each group, ± 1 SD: Gff, Gfb and Gff·G.
#[must_use]
pub fn mean_bode(responses: &StudyFrequencyResponses) -> Figure {
    let x: Vec<f64> = responses.omega_rad_s.iter().map(|omega| omega / TAU).collect();
    let groups = &responses.groups;
    let trials = groups.iter().flat_map(|group| &group.trials);
    let told = |trial: &ResponseTrial| if trial.feedback_not_told.is_some() { Level::DoNotUse } else { Level::Ok };
    let found = of_mean(&trials.map(told).collect::<Vec<_>>());
    let [all, bad] = [found.of, found.do_not_use];
    let is_doubtful = found.level == Level::DoNotUse;
    let mut panels = Vec::new();
    for (column, (symbol, pick, is_reference)) in RESPONSES.into_iter().enumerate() {
        let (mut gains, mut phases) = (Vec::new(), Vec::new());
        for (at, group) in groups.iter().enumerate() {
            let (own, ink, name) = (pick(&group.all), Ink::of_group(at), name(group, groups));
            gains.extend(series(&name, ink, &x, &own.n, [&own.mean_gain_db, &own.sd_gain_db]));
            phases.extend(series(&name, ink, &x, &own.n, [&own.mean_phase_deg, &own.sd_phase_deg]));
        }
        let title = if symbol == "Gfb" && is_doubtful { "Gfb: × do not use" } else { symbol };
        let mut gain = Panel::new(title, Axis::linear(format!("|{symbol}|"), "dB"), gains).in_column(column);
        let mut phase = Panel::new("", Axis::linear(format!("∠{symbol}"), "°"), phases).in_column(column);
        if is_reference {
            (gain.y, phase.y) = (gain.y.including(&[0.0]), phase.y.including(&[0.0]));
            gain = gain.with_rule(0.0, "inverse of the plant", RuleKind::Reference);
            phase = phase.with_rule(0.0, "", RuleKind::Reference);
        }
        panels.extend([gain, phase]);
    }
    Figure {
        name: NAME.to_owned(),
        title: match responses.selection {
            TrialSelection::First => "Identified controllers on the first trial".to_owned(),
            TrialSelection::Last => "Identified controllers on the last trial".to_owned(),
            TrialSelection::Number(number) => format!("Identified controllers on trial {number}"),
        },
        description: description(groups),
        caption: caption(groups, [all, bad]),
        sampling: String::new(),
        x: Axis::logarithmic("frequency", "Hz"),
        panels,
    }
}

fn description(groups: &[GroupResponses]) -> String {
    let sentence = |group: &GroupResponses| {
        let gains = group.all.feedforward_plant.mean_gain_db.iter().flatten();
        let far = gains.copied().max_by(|a, b| a.abs().total_cmp(&b.abs()));
        let name = name(group, groups);
        far.map_or_else(
            || format!("{name}: nothing is identified."),
            |far| {
                format!("{name}: the mean gain of Gff·G is at most {} dB from that of the plant's inverse.", three(far))
            },
        )
    };
    let sentences: Vec<String> = groups.iter().map(sentence).collect();
    if sentences.is_empty() { "Nothing is identified yet.".to_owned() } else { sentences.join(" ") }
}

fn caption(groups: &[GroupResponses], [all, bad]: [usize; 2]) -> String {
    let mut text = "Mean over subjects of gain in dB and of phase; band: ± 1 SD of three subjects or more.".to_owned();
    let named = |group: &GroupResponses| {
        let of = |own: &ResponseTrial| format!("{} {}", own.code, trial(own.session, own.number));
        format!("{}: {}.", name(group, groups), listed(&group.trials.iter().map(of).collect::<Vec<_>>()))
    };
    for group in groups.iter().filter(|group| !group.trials.is_empty()) {
        text.push_str(&format!(" {}", named(group)));
    }
    if bad > 0 {
        text.push_str(&format!(
            " In {bad} of {all} trials the stimuli do not tell feedback from feedforward: the feedback shown is the \
             choice of the pool."
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
