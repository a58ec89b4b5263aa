//! Subjects down, trials across: how far each value may be used.

use super::sentences::key;
use super::trust::class;
use crate::figure::text::three;
use crate::learning::StudyLearningCurves;
use crate::learning::curves::Metric;
use crate::learning::groups::GroupCurve;
use crate::trust::Level;
use maud::{Markup, html};
use std::collections::{BTreeMap, BTreeSet};

/// With more trials than this a cell has its sign alone, without the value.
const MOST_VALUES: usize = 20;

/// Session and number.
type Place = (Option<i64>, i64);

/// A trial of the grid.
struct Cell {
    trial: String,
    level: Level,
    value: Option<f64>,
    because: Option<String>,
}

/// A subject.
struct Row {
    subject: String,
    code: String,
    cells: BTreeMap<Place, Cell>,
}

/// The grid of a study.
pub(super) struct Grid {
    places: Vec<Place>,
    groups: Vec<(String, Vec<Row>)>,
}

impl Grid {
    /// Of a quantity.
    pub(super) fn new(curves: &StudyLearningCurves, metric: Metric) -> Self {
        let groups: Vec<(String, Vec<Row>)> = curves
            .groups
            .iter()
            .map(|group| {
                let name = group.group.clone().unwrap_or_else(|| "Without a group".to_owned());
                (format!("{name} on {}", group.plant.name), rows(group, metric))
            })
            .collect();
        let keys = groups.iter().flat_map(|(_, rows)| rows).flat_map(|row| row.cells.keys().copied());
        let places: BTreeSet<Place> = keys.collect();
        Self { places: places.into_iter().collect(), groups }
    }

    /// The level of every trial.
    pub(super) fn levels(&self) -> Vec<Level> {
        let rows = self.groups.iter().flat_map(|(_, rows)| rows);
        rows.flat_map(|row| row.cells.values().map(|cell| cell.level)).collect()
    }

    /// As a table.
    pub(super) fn markup(&self, caption: &str) -> Markup {
        let has_values = self.places.len() <= MOST_VALUES;
        let has_sessions = self.places.iter().any(|(session, _)| session.is_some());
        html! {
            div.scroll tabindex="0" role="region" aria-label=(caption) {
                table.grid.dense[!has_values] {
                    caption.hidden { (caption) }
                    thead {
                        tr {
                            th scope="col" { "Subject" }
                            @for (session, number) in &self.places {
                                th scope="col" {
                                    @if has_sessions { @if let Some(session) = session { (session) "·" } }
                                    (number)
                                }
                            }
                        }
                    }
                    @for (at, (name, rows)) in self.groups.iter().enumerate() {
                        tbody {
                            tr.group {
                                th scope="rowgroup" colspan=(self.places.len() + 1) {
                                    (key(at, self.groups.len())) " " (name)
                                }
                            }
                            @for row in rows {
                                tr {
                                    th scope="row" { a href={ "/subjects/" (row.subject) } { (row.code) } }
                                    @for place in &self.places {
                                        (cell(row.cells.get(place), has_values))
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn cell(cell: Option<&Cell>, has_value: bool) -> Markup {
    let Some(cell) = cell else { return html! { td {} } };
    let value = cell.value.map(three);
    let because = cell.because.as_deref().map_or_else(String::new, |why| format!(": {why}"));
    let words = format!("{}{because}", cell.level.words());
    html! {
        td {
            a.cell.(class(cell.level)) href={ "/trials/" (cell.trial) } data-trust=(cell.level.name()) title=(words) {
                span aria-hidden="true" { (cell.level.sign()) }
                @if has_value {
                    " " (value.as_deref().unwrap_or("–")) span.hidden { ", " (cell.level.words()) }
                } @else {
                    span.hidden { (value.as_deref().unwrap_or("no value")) ", " (cell.level.words()) }
                }
            }
        }
    }
}

fn rows(group: &GroupCurve, metric: Metric) -> Vec<Row> {
    let row = |subject: &crate::learning::groups::GroupSubject| {
        let mut cells = BTreeMap::new();
        for point in &subject.curve.points {
            let cell = Cell {
                trial: point.trial.clone(),
                level: point.level(metric),
                value: point.value(metric),
                because: point.trust(metric).map(|trust| trust.because.clone()),
            };
            cells.insert((point.session, point.number), cell);
        }
        for trial in &subject.curve.left_out {
            let because = Some("the output passed the display limit".to_owned());
            let cell = Cell { trial: trial.trial.clone(), level: Level::DoNotUse, value: None, because };
            cells.insert((trial.session, trial.number), cell);
        }
        Row { subject: subject.subject.clone(), code: subject.code.clone(), cells }
    };
    group.subjects.iter().map(row).collect()
}
