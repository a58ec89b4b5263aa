//! The numbers of a figure as tables.

use super::value::{Figure, Mark};

/// A number that reads back as the same double; nothing where there is none.
fn number(value: Option<&Option<f64>>) -> String {
    value.copied().flatten().map_or_else(String::new, |value| format!("{value:?}"))
}

fn mark(mark: Mark) -> &'static str {
    match mark {
        Mark::Line => "line",
        Mark::Samples => "samples",
        Mark::Points => "points",
        Mark::Crosses => "crosses",
        Mark::Bars => "bars",
        Mark::Band => "band",
        Mark::Cells => "cells",
        Mark::Columns => "columns",
        Mark::Times => "times",
        Mark::Plus => "plus",
        Mark::Rings => "rings",
    }
}

/// The numbers of a figure in one tidy table, a row for each place of each series: the panel by the label of its axis,
/// the series, how it is drawn, x, y, the ends of bands and bars, trust and note.
#[must_use]
pub fn csv(figure: &Figure) -> String {
    let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new());
    let x = format!("x: {}", figure.x.text());
    // Writing to memory does not fail.
    let _ = writer.write_record(["panel", "series", "mark", &x, "y", "low", "high", "trust", "note"]);
    for panel in &figure.panels {
        let name = panel.y.text();
        for series in &panel.series {
            for (i, x) in series.x.iter().enumerate() {
                let _ = writer.write_record([
                    name.as_str(),
                    &series.name,
                    mark(series.mark),
                    &format!("{x:?}"),
                    &number(series.y.get(i)),
                    &number(series.low.get(i)),
                    &number(series.high.get(i)),
                    series.trust.get(i).map_or("", |level| level.name()),
                    series.notes.get(i).map_or("", String::as_str),
                ]);
            }
        }
    }
    writer.into_inner().ok().and_then(|bytes| String::from_utf8(bytes).ok()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{Axis, Ink, Panel, Series, Weight};
    use crate::trust::Level;

    #[test]
    fn every_number_reads_back_and_names_stay_cells() {
        let look = (Mark::Line, Ink::First, Weight::Thin);
        let line = Series::values("a, \"b\"\r\n=c", look, vec![0.1, 0.2], [Some(1.0 / 3.0), None])
            .with_notes(vec!["one".into(), "two".into()])
            .with_trust(vec![Level::Ok, Level::DoNotUse]);
        let band =
            Series::intervals("band", (Mark::Band, Ink::First, Weight::Thin), vec![1e-300], [Some([-0.0, 1e22])]);
        let figure = Figure {
            name: "f".into(),
            title: String::new(),
            description: String::new(),
            caption: String::new(),
            sampling: String::new(),
            x: Axis::linear("time", "s"),
            panels: vec![Panel::new("", Axis::linear("y", "1"), vec![line, band])],
        };
        let text = csv(&figure);
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let heads: Vec<String> = reader.headers().unwrap().iter().map(str::to_owned).collect();
        assert_eq!(heads, ["panel", "series", "mark", "x: time (s)", "y", "low", "high", "trust", "note"]);
        let rows: Vec<Vec<String>> =
            reader.records().map(|row| row.unwrap().iter().map(str::to_owned).collect()).collect();
        assert_eq!(rows[0], ["y (1)", "a, \"b\"\r\n=c", "line", "0.1", "0.3333333333333333", "", "", "ok", "one"]);
        assert_eq!(rows[1][4..], ["", "", "", "do_not_use", "two"]);
        assert_eq!(rows[2], ["y (1)", "band", "band", "1e-300", "", "-0.0", "1e22", "", ""]);
        assert_eq!(rows.len(), 3);
    }
}
