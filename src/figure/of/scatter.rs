//! Tracking error against distance from the inverse dynamics.

use super::learning_curves::names;
use super::places::trial;
use super::provenance::{Units, eight, product};
use crate::figure::text::{listed, number, three};
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::learning::StudyLearningCurves;
use crate::learning::groups::{GroupCurve, ScatterPoint};
use crate::trust::Level;

/// The name of the figure in addresses.
pub const NAME: &str = "scatter";
/// Against ‖Gff − G⁻¹‖.
pub const INVERSE: &str = "scatter_inverse";

/// Groups beyond so many have a panel each.
const MOST_GROUPS: usize = 4;

/// Which distance of the feedforward from the inverse dynamics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Distance {
    /// ‖Gff G − 1‖.
    PlantMinusOne,
    /// ‖Gff − G⁻¹‖.
    MinusInverse,
}

impl Distance {
    fn of(self, point: &ScatterPoint) -> Option<f64> {
        match self {
            Self::PlantMinusOne => point.norm_feedforward_plant_minus_one,
            Self::MinusInverse => point.norm_feedforward_minus_inverse,
        }
    }
}

/// A dot for each identified trial; what is not to be used crossed out. Trust is that of ‖Gff G − 1‖, from which the
/// other distance differs by the plant alone.
#[must_use]
pub fn scatter(curves: &StudyLearningCurves, units: &Units, distance: Distance) -> Figure {
    let names = names(curves);
    let axis = || Axis::linear("mean |r − y|", units.output.as_str()).including(&[0.0]);
    let groups = || names.iter().zip(&curves.groups).enumerate();
    let mut panels: Vec<Panel> = if curves.groups.len() <= MOST_GROUPS {
        vec![Panel::new(
            "",
            axis(),
            groups().flat_map(|(at, (name, group))| dots(name, Ink::of_group(at), group, distance)).collect(),
        )]
    } else {
        groups()
            .map(|(_, (name, group))| Panel::new(name.as_str(), axis(), dots(name, Ink::First, group, distance)))
            .collect()
    };
    if distance == Distance::PlantMinusOne {
        for panel in &mut panels {
            *panel = panel.clone().with_rule(1.0, "feedforward does nothing", RuleKind::Border);
        }
    }
    let sentence = |(name, group): (&String, &GroupCurve)| {
        let found = match distance {
            Distance::PlantMinusOne => &group.scatter.error_against_plant_minus_one,
            Distance::MinusInverse => &group.scatter.error_against_minus_inverse,
        };
        let bad = group.scatter.points.iter().filter(|point| point.trust == Level::DoNotUse).count();
        let reserve = if bad > 0 { format!("; {bad} of them are not to be used") } else { String::new() };
        match found.pearson {
            // A correlation of numbers of which more than a third are not to be used says nothing.
            Some(_) if 3 * bad > found.n => {
                format!("{name}: no statement: {bad} of the {} distances are not to be used.", found.n)
            }
            Some(r) => format!("{name}: correlation {} over {} trials{reserve}.", number(r, 2), found.n),
            None => format!("{name}: too few trials with a distance for a correlation."),
        }
    };
    let sentences: Vec<String> = names.iter().zip(&curves.groups).map(sentence).collect();
    let (own_name, x) = match distance {
        Distance::PlantMinusOne => (NAME, Axis::linear("‖Gff G − 1‖", "1")),
        Distance::MinusInverse => {
            (INVERSE, Axis::linear("‖Gff − G⁻¹‖", format!("{} / {}", units.control, units.output)))
        }
    };
    let mut specs: Vec<String> =
        curves.groups.iter().filter_map(|group| Some(eight(&group.spec.as_ref()?.spec_sha256).to_owned())).collect();
    specs.dedup();
    let spec = if specs.is_empty() { String::new() } else { format!(" Spec {}.", listed(&specs)) };
    Figure {
        name: own_name.to_owned(),
        title: "Tracking error against distance from the inverse dynamics".to_owned(),
        description: if sentences.is_empty() { "Nothing is identified yet.".to_owned() } else { sentences.join(" ") },
        caption: format!(
            "A dot for each identified trial; × over what is not to be used. Correlations take in all dots, several of \
             each subject.{spec} {}.",
            product()
        ),
        sampling: String::new(),
        x: x.including(&[0.0]),
        panels,
    }
}

fn dots(name: &str, ink: Ink, group: &GroupCurve, distance: Distance) -> Vec<Series> {
    let mut points: Vec<(f64, &ScatterPoint)> =
        group.scatter.points.iter().filter_map(|point| Some((distance.of(point)?, point))).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let series = |name: &str, mark, own: &[&(f64, &ScatterPoint)]| {
        let note = |(distance, point): &(f64, &ScatterPoint)| {
            let trial = trial(point.session, point.number);
            let (distance, error) = (three(*distance), three(point.mean_abs_error));
            format!("{} · {trial} · {distance}, {error} · {}", point.code, point.trust.words())
        };
        let x = own.iter().map(|(distance, _)| *distance).collect();
        let y = own.iter().map(|(_, point)| Some(point.mean_abs_error));
        Series::values(name, (mark, ink, Weight::Thin), x, y)
            .with_notes(own.iter().map(|point| note(point)).collect())
            .with_trust(own.iter().map(|(_, point)| point.trust).collect())
    };
    let all: Vec<&(f64, &ScatterPoint)> = points.iter().collect();
    let bad: Vec<&(f64, &ScatterPoint)> = points.iter().filter(|(_, point)| point.trust == Level::DoNotUse).collect();
    let mut found = vec![series(name, Mark::Points, &all).labelled()];
    if !bad.is_empty() {
        found.push(series(&format!("{name}: not to be used"), Mark::Crosses, &bad));
    }
    found
}
