//! How many trials of a study passed its display limit.

use super::learning_curves::names;
use super::places::Places;
use super::provenance::product;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, Series, Weight};
use crate::learning::StudyLearningCurves;
use crate::learning::groups::GroupCurve;
use std::collections::BTreeMap;

/// The name of the figure in addresses.
pub const NAME: &str = "divergent";

/// Divergent trials of a group by session and number, and how many trials it has.
fn counts(group: &GroupCurve) -> (BTreeMap<(Option<i64>, i64), usize>, usize) {
    let mut counts = BTreeMap::new();
    let mut all = 0;
    for curve in group.subjects.iter().map(|subject| &subject.curve) {
        all += curve.points.len() + curve.left_out.len();
        let shown = curve.points.iter().filter(|point| point.divergent).map(|point| (point.session, point.number));
        for key in shown.chain(curve.left_out.iter().map(|trial| (trial.session, trial.number))) {
            *counts.entry(key).or_default() += 1;
        }
    }
    (counts, all)
}

/// Divergent trials of each group by trial number, each group in a panel of its own (Zhang 2015, figure 5.8).
#[must_use]
pub fn divergent(curves: &StudyLearningCurves) -> Figure {
    let places = Places::of(curves);
    let names = names(curves);
    let mut panels = Vec::new();
    let mut sentences = Vec::new();
    for (at, (name, group)) in names.iter().zip(&curves.groups).enumerate() {
        let (counts, all) = counts(group);
        let sum: usize = counts.values().sum();
        sentences.push(format!("{name}: {sum} of {all} trials are divergent."));
        let mut bars: Vec<(f64, usize)> =
            counts.iter().map(|((session, number), count)| (places.at(*session, *number), *count)).collect();
        bars.sort_by(|a, b| a.0.total_cmp(&b.0));
        let notes = bars.iter().map(|(place, count)| format!("{name} · trial {place} · {count} divergent")).collect();
        let look = (Mark::Columns, Ink::of_group(at), Weight::Thick);
        let (x, y): (Vec<f64>, Vec<Option<f64>>) = bars.into_iter().map(|(x, count)| (x, Some(count as f64))).unzip();
        let series = Series::values(name.as_str(), look, x, y).with_notes(notes);
        let axis = Axis::linear("divergent trials", "").including(&[0.0, 1.0]);
        panels.push(Panel::new(format!("{name}: {sum} of {all}"), axis, vec![series]).of_height(0.7));
    }
    let label = if places.are_counted_on { "trial, counted on through the sessions" } else { "trial" };
    Figure {
        name: NAME.to_owned(),
        title: "Divergent trials".to_owned(),
        description: if sentences.is_empty() { "There is no trial.".to_owned() } else { sentences.join(" ") },
        caption: format!("Trials whose output passed the study's display limit. {}.", product()),
        sampling: String::new(),
        x: Axis { range: Some([0.0, places.last + 1.0]), ..Axis::linear(label, "") },
        panels,
    }
}
