//! Names at the ends of lines, and words at rules.

use super::text;
use crate::figure::layout::{Frame, Names, name};
use crate::figure::palette::class;
use crate::figure::style::TEXT;
use crate::figure::text::room;
use crate::figure::value::{Axis, Panel, RuleKind, Series};

/// Names stand at least so many pixels apart.
const APART: f64 = 15.0;

/// A name with where it should stand.
struct Label<'a> {
    series: &'a Series,
    x: f64,
    y: f64,
}

/// The last value in sight, in pixels of the frame.
fn end(series: &Series, x: &Axis, y: &Axis, frame: &Frame) -> Option<[f64; 2]> {
    let middle = |i: usize| match (series.y.get(i), series.low.get(i), series.high.get(i)) {
        (Some(value), ..) => *value,
        (None, Some(low), Some(high)) => low.zip(*high).map(|(low, high)| 0.5 * (low + high)),
        _ => None,
    };
    (0..series.x.len()).rev().find_map(|i| {
        let place = x.position(series.x[i]);
        let value = middle(i).filter(|_| (-1e-9..=1.0 + 1e-9).contains(&place))?;
        Some([place * frame.width, (1.0 - y.position(value)) * frame.height])
    })
}

/// The height of a line at a place, in pixels of the frame.
fn height_at(series: &Series, x: &Axis, y: &Axis, frame: &Frame, place: f64) -> Option<f64> {
    let at = (0..series.x.len()).find(|i| x.position(series.x[*i]) * frame.width >= place)?;
    Some((1.0 - y.position((*series.y.get(at)?)?)) * frame.height)
}

/// Pushes names apart within the frame, keeping their order.
fn spread(labels: &mut [Label<'_>], height: f64) {
    labels.sort_by(|a, b| a.y.total_cmp(&b.y));
    let mut least = f64::NEG_INFINITY;
    for label in labels.iter_mut() {
        label.y = label.y.max(least);
        least = label.y + APART;
    }
    let mut most = height;
    for label in labels.iter_mut().rev() {
        label.y = label.y.min(most);
        most = label.y - APART;
    }
}

/// Writes the names of a panel's lines and the words at its rules.
pub(super) fn write(out: &mut String, x: &Axis, panel: &Panel, frame: &Frame, names: Names) {
    for rule in panel.rules.iter().filter(|rule| !rule.label.is_empty()) {
        let axis = if rule.kind == RuleKind::Border { x } else { &panel.y };
        let place = axis.position(rule.at);
        if !(0.0..=1.0).contains(&place) {
            continue;
        }
        let (at, anchor) = match rule.kind {
            RuleKind::Border => ([frame.x + place * frame.width + 4.0, frame.y + 11.0], "start"),
            _ => {
                let y = frame.y + (1.0 - place) * frame.height - 4.0;
                ([frame.x + frame.width - 2.0, y], "end")
            }
        };
        text(out, "f-rim", at, &format!("text-anchor=\"{anchor}\""), &rule.label);
    }
    if names == Names::InLegend {
        return;
    }
    let is_named = |series: &&Series| series.labelled;
    let ends = panel.series.iter().filter(is_named).filter_map(|series| {
        let [x, y] = end(series, x, &panel.y, frame)?;
        Some(Label { series, x, y })
    });
    let mut labels: Vec<Label<'_>> = ends.collect();
    if names == Names::OnLines {
        for label in &mut labels {
            let words = room(&name(&label.series.name), TEXT);
            let line = height_at(label.series, x, &panel.y, frame, label.x - 0.6 * words).unwrap_or(label.y);
            // Above the line, or below it where it comes down from above.
            label.y = if line < label.y - 6.0 { label.y + 13.0 } else { label.y - 13.0 };
            label.y = label.y.clamp(8.0, frame.height - 8.0);
            label.x = label.x.max(words.min(frame.width));
        }
    }
    spread(&mut labels, frame.height);
    for label in labels {
        let (x, anchor) = match names {
            Names::Beside => (frame.x + frame.width + 7.0, "start"),
            _ => (frame.x + label.x - 2.0, "end"),
        };
        let class = format!("{} f-name", class(label.series.ink));
        let more = format!("text-anchor=\"{anchor}\"");
        text(out, &class, [x, frame.y + label.y + 4.0], &more, &name(&label.series.name));
    }
}
