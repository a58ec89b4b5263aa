//! The norms of every subject's last trial, side by side.

use super::learning_curves::{interval, names, phrase};
use super::places::trial;
use super::provenance::{Units, eight, product};
use crate::figure::text::{listed, three};
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::learning::StudyLearningCurves;
use crate::learning::curves::Metric;
use crate::learning::groups::TableRow;
use crate::trust::Level;

/// The name of the figure in addresses.
pub const NAME: &str = "last_trial";

/// What is shown.
const METRICS: [Metric; 2] = [Metric::NormFeedforwardPlantMinusOne, Metric::NormFeedback];

/// ‖Gff G − 1‖ and ‖Gfb‖ of the last trial of each subject, with intervals where there are any (Zhang 2015, figure
/// 5.17).
#[must_use]
pub fn last_trial(curves: &StudyLearningCurves, units: &Units) -> Figure {
    let names = names(curves);
    let codes: Vec<String> =
        curves.groups.iter().flat_map(|group| &group.last_trials.rows).map(|row| row.code.clone()).collect();
    let mut panels = Vec::new();
    let mut sentences = Vec::new();
    for metric in METRICS {
        let mut series = Vec::new();
        let (mut all, mut bad, mut first) = (0, 0, 0);
        for (at, (name, group)) in names.iter().zip(&curves.groups).enumerate() {
            let rows = &group.last_trials.rows;
            series.extend(marks(name, Ink::of_group(at), rows, metric, first));
            first += rows.len();
            all += rows.iter().filter(|row| row.point.value(metric).is_some()).count();
            bad += rows.iter().filter(|row| is_bad(row, metric)).count();
        }
        sentences.push(format!("{}: {bad} of {all} values are not to be used.", phrase(metric)));
        let axis = match metric {
            Metric::NormFeedback => Axis::linear("‖Gfb‖", format!("{} / {}", units.control, units.output)),
            _ => Axis::linear("‖Gff G − 1‖", "1"),
        };
        let mut panel = Panel::new("", axis.including(&[0.0]), series);
        if metric == Metric::NormFeedforwardPlantMinusOne {
            panel = panel.with_rule(1.0, "feedforward does nothing", RuleKind::Reference);
        }
        panels.push(panel);
    }
    let mut specs: Vec<String> =
        curves.groups.iter().filter_map(|group| Some(eight(&group.spec.as_ref()?.spec_sha256).to_owned())).collect();
    specs.dedup();
    let spec = if specs.is_empty() { String::new() } else { format!(" Spec {}.", listed(&specs)) };
    Figure {
        name: NAME.to_owned(),
        title: "Last trial of every subject".to_owned(),
        description: sentences.join(" "),
        caption: format!("Whiskers: 95 % intervals where there are any; ×: do not use.{spec} {}.", product()),
        sampling: String::new(),
        x: Axis::named("subject", codes),
        panels,
    }
}

fn is_bad(row: &TableRow, metric: Metric) -> bool {
    row.point.value(metric).is_some() && row.point.level(metric) == Level::DoNotUse
}

/// Whiskers, dots and crosses of a group's rows, from a place on the axis on.
fn marks(name: &str, ink: Ink, rows: &[TableRow], metric: Metric, first: usize) -> Vec<Series> {
    let x: Vec<f64> = (0..rows.len()).map(|at| (first + at) as f64).collect();
    let note = |row: &TableRow| {
        let value = row.point.value(metric).map_or_else(|| "no value".to_owned(), three);
        let trial = trial(row.point.session, row.point.number);
        format!("{} · {trial} · {value} · {}", row.code, row.point.level(metric).words())
    };
    let ends: Vec<Option<[f64; 2]>> = rows.iter().map(|row| interval(&row.point, metric)).collect();
    let mut found = Vec::new();
    if ends.iter().any(Option::is_some) {
        let look = (Mark::Bars, ink, Weight::Thin);
        found.push(Series::intervals(format!("{name}: 95 % intervals"), look, x.clone(), ends));
    }
    let dots = Series::values(name, (Mark::Points, ink, Weight::Thick), x, rows.iter().map(|r| r.point.value(metric)))
        .with_notes(rows.iter().map(note).collect())
        .with_trust(rows.iter().map(|row| row.point.level(metric)).collect());
    found.push(dots.labelled());
    let bad: Vec<(f64, &TableRow)> = rows
        .iter()
        .enumerate()
        .filter(|(_, row)| is_bad(row, metric))
        .map(|(at, row)| ((first + at) as f64, row))
        .collect();
    if !bad.is_empty() {
        let look = (Mark::Crosses, ink, Weight::Thin);
        let x = bad.iter().map(|(x, _)| *x).collect();
        let crosses =
            Series::values(format!("{name}: not to be used"), look, x, bad.iter().map(|(_, r)| r.point.value(metric)))
                .with_notes(bad.iter().map(|(_, row)| note(row)).collect())
                .with_trust(vec![Level::DoNotUse; bad.len()]);
        found.push(crosses);
    }
    found
}
