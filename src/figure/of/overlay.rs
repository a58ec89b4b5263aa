//! Figures of one sort over one another, with common axes.

use crate::figure::{Axis, Figure, Ink, Panel, Series};

/// The name of the figure.
pub const NAME: &str = "overlay";

/// The panels of several figures of one name, those with the same axis together; each figure by its name in an ink of
/// its own. `None` of fewer than two figures, or where no axis is shared.
#[must_use]
pub fn overlay(figures: &[(String, Figure)]) -> Option<Figure> {
    let [(_, first), _, ..] = figures else { return None };
    let mut panels: Vec<Panel> = Vec::new();
    for panel in &first.panels {
        let mut series: Vec<Series> = Vec::new();
        let mut sharing = 0;
        for (at, (name, figure)) in figures.iter().enumerate() {
            let same = |own: &&Panel| own.y.label == panel.y.label && own.y.unit == panel.y.unit;
            let Some(own) = figure.panels.iter().find(same) else { continue };
            sharing += 1;
            series.extend(own.series.iter().map(|one| {
                // What is there for comparison stays so.
                let ink = if one.ink == Ink::Muted { Ink::Muted } else { Ink::of_group(at) };
                Series { name: format!("{name}: {}", one.name), ink, ..one.clone() }
            }));
        }
        if sharing > 1 {
            panels.push(Panel { series, ..panel.clone() });
        }
    }
    let x = Axis { range: None, ..first.x.clone() };
    (!panels.is_empty()).then(|| Figure {
        name: NAME.to_owned(),
        title: "Over one another".to_owned(),
        description: figures
            .iter()
            .map(|(name, own)| format!("{name}: {}", own.description))
            .collect::<Vec<_>>()
            .join(" "),
        caption: figures.iter().map(|(name, own)| format!("{name}: {}", own.title)).collect::<Vec<_>>().join("; ")
            + ".",
        sampling: String::new(),
        x,
        panels,
    })
}
