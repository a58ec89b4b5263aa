//! What is drawn over the axes.

use super::{OVERLAP, px};
use crate::figure::layout::Frame;
use crate::figure::palette::class;
use crate::figure::path::{Path, Tenths, short, tenths};
use crate::figure::style::TICK;
use crate::figure::text::{escaped, room};
use crate::figure::value::{Axis, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::trust::Level;
use std::fmt::Write as _;

/// Fewer samples than this in sight have a dot each.
const DOTS: usize = 40;

/// A column whose samples lie further apart than this, in pixels, is a bar: its ends are written in whole pixels.
const BAR: f64 = 8.0;

/// Between the lines of a hatching, in pixels.
const HATCH: f64 = 7.0;

/// Turns numbers into places within a plot.
struct Plot<'a> {
    x: &'a Axis,
    y: &'a Axis,
    frame: &'a Frame,
}

impl Plot<'_> {
    fn x(&self, value: f64) -> f64 {
        self.x.position(value) * self.frame.width
    }

    fn y(&self, value: f64) -> f64 {
        (1.0 - self.y.position(value)) * self.frame.height + OVERLAP
    }

    fn place(&self, x: f64, y: f64) -> [Tenths; 2] {
        [tenths(self.x(x)), tenths(self.y(y))]
    }
}

/// Draws everything of a panel, spans and rules behind the series.
pub(super) fn write(out: &mut String, x: &Axis, panel: &Panel, frame: &Frame) {
    let plot = Plot { x, y: &panel.y, frame };
    for span in &panel.spans {
        let ends = [plot.x(span.from), plot.x(span.to)].map(|end| end.clamp(0.0, frame.width));
        let _ = write!(
            out,
            "<path class=\"f-hatch\" d=\"{}\"><title>{}</title></path>",
            hatch(ends, frame.height),
            escaped(&span.label)
        );
    }
    for rule in &panel.rules {
        let (name, data) = match rule.kind {
            RuleKind::Border => ("f-border", format!("M{} {OVERLAP}v{}", px(plot.x(rule.at)), px(frame.height))),
            RuleKind::Reference => ("f-reference", format!("M0 {}h{}", px(plot.y(rule.at)), px(frame.width))),
            RuleKind::Limit => ("f-limit", format!("M0 {}h{}", px(plot.y(rule.at)), px(frame.width))),
        };
        let _ = write!(out, "<path class=\"{name}\" d=\"{data}\"/>");
    }
    for series in panel.series.iter().filter(|series| !series.is_empty()) {
        match series.mark {
            Mark::Line | Mark::Samples => line(out, &plot, series),
            Mark::Band => band(out, &plot, series),
            Mark::Bars => bars(out, &plot, series),
            Mark::Points | Mark::Crosses | Mark::Times | Mark::Plus | Mark::Rings => points(out, &plot, series),
            Mark::Cells => cells(out, &plot, series),
            Mark::Columns => columns(out, &plot, series),
        }
    }
}

/// Slanted lines over a stretch, cut off at its ends.
fn hatch([from, to]: [f64; 2], height: f64) -> String {
    let side = px(height);
    let mut data = format!("M{} {OVERLAP}v{side}M{} {OVERLAP}v{side}", px(from), px(to));
    let mut at = from - height;
    while at < to {
        // A line from the lower left to the upper right, from `at` on the ground.
        let (left, right) = (at.max(from), (at + height).min(to));
        if left < right {
            let (low, high) = (height - (left - at), height - (right - at));
            let _ = write!(data, "M{} {}L{} {}", px(left), px(low + OVERLAP), px(right), px(high + OVERLAP));
        }
        at += HATCH;
    }
    data
}

fn weight(of: Weight) -> &'static str {
    match of {
        Weight::Wide => "f-wide",
        Weight::Thin => "f-thin",
        Weight::Thick => "f-thick",
        Weight::Faint => "f-faint",
    }
}

fn line(out: &mut String, plot: &Plot<'_>, series: &Series) {
    let in_sight = series.x.iter().filter(|x| (0.0..=1.0).contains(&plot.x.position(**x))).count();
    let data = if in_sight as f64 > plot.frame.width { by_columns(plot, series) } else { by_samples(plot, series) };
    let (ink, weight) = (class(series.ink), weight(series.weight));
    let name = escaped(&series.name);
    let _ = write!(out, "<path class=\"{ink} f-line {weight}\" data-series=\"{name}\" d=\"{data}\"/>");
    if series.mark == Mark::Samples && in_sight < DOTS {
        let mut dots = Path::default();
        for (x, y) in series.x.iter().zip(&series.y) {
            if let Some(y) = y {
                dots.dot(plot.place(*x, *y));
            }
        }
        let _ = write!(out, "<path class=\"{ink} f-dots\" d=\"{}\"/>", dots.finish());
    }
}

/// A line through samples, each at its place.
fn by_samples(plot: &Plot<'_>, series: &Series) -> String {
    let mut path = Path::default();
    let mut is_down = false;
    for (at, (x, y)) in series.x.iter().zip(&series.y).enumerate() {
        let Some(y) = y else {
            is_down = false;
            continue;
        };
        let to = plot.place(*x, *y);
        let is_alone = !is_down && series.y.get(at + 1).is_none_or(Option::is_none);
        match is_down {
            true => path.draw(to),
            false if is_alone => path.dot(to),
            false => path.go(to),
        }
        is_down = true;
    }
    path.finish()
}

/// A line through samples that stand closer than pixels, column by column.
///
/// Where they only rise or only fall within a column, the line goes straight from the first to the last of them;
/// otherwise it goes up and down in the middle of the column.
fn by_columns(plot: &Plot<'_>, series: &Series) -> String {
    let column = |x: f64| (plot.x.position(x) * plot.frame.width).floor() as Tenths;
    let mut path = Path::default();
    let mut is_down = false;
    let mut at = 0;
    while at < series.x.len() {
        if series.y[at].is_none() {
            is_down = false;
            at += 1;
            continue;
        }
        let own = column(series.x[at]);
        let together = |i: &usize| series.y[*i].is_some() && column(series.x[*i]) == own;
        let end = at + (at..series.x.len()).take_while(together).count();
        let samples = series.x[at..end].iter().zip(&series.y[at..end]);
        let samples: Vec<[f64; 2]> = samples.filter_map(|(x, y)| Some([plot.x(*x), plot.y((*y)?)])).collect();
        let heights = || samples.iter().map(|sample| sample[1]);
        let places: Vec<[Tenths; 2]> = if heights().is_sorted() || heights().rev().is_sorted() {
            // Rounding takes nothing out of its column.
            let place = |sample: &[f64; 2]| [tenths(sample[0]).clamp(10 * own, 10 * own + 9), tenths(sample[1])];
            [samples.first(), samples.last()].into_iter().flatten().map(place).collect()
        } else {
            let is_bar = heights().fold(f64::MIN, f64::max) - heights().fold(f64::MAX, f64::min) > BAR;
            let height = |own: f64| if is_bar { 10 * own.round() as Tenths } else { tenths(own) };
            heights().map(|one| [10 * own + 5, height(one)]).collect()
        };
        for to in places {
            if is_down {
                path.draw(to);
            } else {
                path.go(to);
            }
            is_down = true;
        }
        at = end;
    }
    path.finish()
}

fn band(out: &mut String, plot: &Plot<'_>, series: &Series) {
    let mut path = Path::default();
    let mut at = 0;
    let ends = |i: usize| Some((series.low[i]?, series.high[i]?));
    while at < series.x.len() {
        let run: Vec<(f64, f64, f64)> =
            (at..series.x.len()).map_while(|i| ends(i).map(|(low, high)| (series.x[i], low, high))).collect();
        if run.len() > 1 {
            path.go(plot.place(run[0].0, run[0].2));
            run.iter().skip(1).for_each(|(x, _, high)| path.draw(plot.place(*x, *high)));
            run.iter().rev().for_each(|(x, low, _)| path.draw(plot.place(*x, *low)));
            path.close();
        }
        at += run.len().max(1);
    }
    let (ink, name) = (class(series.ink), escaped(&series.name));
    let _ = write!(out, "<path class=\"{ink} f-band\" data-series=\"{name}\" d=\"{}\"/>", path.finish());
}

fn bars(out: &mut String, plot: &Plot<'_>, series: &Series) {
    const CAP: Tenths = 30;
    let mut path = Path::default();
    for ((x, low), high) in series.x.iter().zip(&series.low).zip(&series.high) {
        let Some((low, high)) = low.zip(*high) else { continue };
        let ([x, low], [_, high]) = (plot.place(*x, low), plot.place(*x, high));
        for level in [low, high] {
            path.go([x - CAP, level]);
            path.draw([x + CAP, level]);
        }
        path.go([x, low]);
        path.draw([x, high]);
    }
    let pale = if series.weight == Weight::Faint { " f-pale" } else { "" };
    let _ = write!(out, "<path class=\"{} f-bar{pale}\" d=\"{}\"/>", class(series.ink), path.finish());
}

/// The outline of a mark around the origin, in path data that follow a move to the place.
fn shape(series: &Series) -> &'static str {
    match (series.mark, series.ink) {
        (Mark::Crosses | Mark::Times, _) => "m-4-4l8 8m0-8l-8 8",
        (Mark::Plus, _) => "m-5 0h10m-5-5v10",
        (Mark::Rings, _) => "m-7 0a7 7 0 1 0 14 0a7 7 0 1 0-14 0z",
        (_, Ink::Second) => "m-3.4-3.4h6.8v6.8h-6.8z",
        (_, Ink::Third) => "m0-4.6l4.2 7.4h-8.4z",
        (_, Ink::Fourth) => "m0-4.6l4.6 4.6-4.6 4.6-4.6-4.6z",
        _ => "m-3.7 0a3.7 3.7 0 1 0 7.4 0a3.7 3.7 0 1 0-7.4 0z",
    }
}

fn points(out: &mut String, plot: &Plot<'_>, series: &Series) {
    let kind = if series.mark == Mark::Points { "f-mark" } else { "f-cross" };
    let (ink, shape) = (class(series.ink), shape(series));
    let mut together = String::new();
    for (i, (x, y)) in series.x.iter().zip(&series.y).enumerate() {
        let Some(y) = y else { continue };
        let [x, y] = plot.place(*x, *y).map(short);
        let Some(note) = series.notes.get(i) else {
            let _ = write!(together, "M{x} {y}{shape}");
            continue;
        };
        let trust = series.trust.get(i).map_or_else(String::new, |level| format!(" data-trust=\"{}\"", level.name()));
        let _ = write!(
            out,
            "<path class=\"{ink} {kind}\"{trust} d=\"M{x} {y}{shape}\"><title>{}</title></path>",
            escaped(note)
        );
    }
    if !together.is_empty() {
        let _ = write!(out, "<path class=\"{ink} {kind}\" d=\"{together}\"/>");
    }
}

/// A cell around each value, in the colours of its trust, with its text where there is room.
fn cells(out: &mut String, plot: &Plot<'_>, series: &Series) {
    const GAP: f64 = 2.0;
    let size = |ends: [f64; 2]| (ends[1] - ends[0]).abs() - GAP;
    let [width, height] = [size([plot.x(0.0), plot.x(1.0)]), size([plot.y(0.0), plot.y(1.0)])];
    for (i, (x, y)) in series.x.iter().zip(&series.y).enumerate() {
        let Some(y) = y else { continue };
        let [x, y] = [plot.x(*x), plot.y(*y)];
        let level = series.trust.get(i).copied().unwrap_or(Level::NotIdentified);
        let note = series.notes.get(i).map_or("", String::as_str);
        let _ = write!(
            out,
            "<g class=\"f-cell f-t-{}\" data-trust=\"{}\"><title>{}</title><path d=\"M{} {}h{}v{}h-{}z\"/>",
            trust_class(level),
            level.name(),
            escaped(note),
            px(x - 0.5 * width),
            px(y - 0.5 * height),
            px(width),
            px(height),
            px(width)
        );
        let text = series.texts.get(i).map_or("", String::as_str);
        // Where the value has no room its sign stays.
        let sign = text.chars().next().map_or_else(String::new, String::from);
        let words = [text, sign.as_str()].into_iter().find(|words| room(words, TICK) <= width && height >= TICK);
        if let Some(words) = words.filter(|words| !words.is_empty()) {
            let _ = write!(
                out,
                "<text text-anchor=\"middle\" x=\"{}\" y=\"{}\">{}</text>",
                px(x),
                px(y + 4.0),
                escaped(words)
            );
        }
        out.push_str("</g>");
    }
}

/// The ending of a level's class.
fn trust_class(level: Level) -> &'static str {
    match level {
        Level::NotIdentified => "n",
        Level::Ok => "o",
        Level::Read => "r",
        Level::DoNotUse => "x",
    }
}

/// A column from 0 to each value, of 0.6 of the distance between whole numbers, or of neighbours that are nearer.
fn columns(out: &mut String, plot: &Plot<'_>, series: &Series) {
    let apart = series.x.windows(2).map(|pair| pair[1] - pair[0]).filter(|d| *d > 0.0).fold(1.0, f64::min);
    let half = 0.3 * (plot.x(apart) - plot.x(0.0));
    let ground = plot.y(0.0);
    for (i, (x, y)) in series.x.iter().zip(&series.y).enumerate() {
        let Some(y) = y else { continue };
        let [x, y] = [plot.x(*x), plot.y(*y)];
        let note = series.notes.get(i).map_or("", String::as_str);
        let _ = write!(
            out,
            "<path class=\"{} f-mark\" d=\"M{} {}H{}V{}H{}z\"><title>{}</title></path>",
            class(series.ink),
            px(x - half),
            px(ground),
            px(x + half),
            px(y),
            px(x - half),
            escaped(note)
        );
    }
}
