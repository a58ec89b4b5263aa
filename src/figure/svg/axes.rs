//! Axes: grid, ticks, labels.

use super::{px, text};
use crate::figure::layout::Frame;
use crate::figure::text::shortened;
use crate::figure::ticks::ticks;
use crate::figure::value::{Axis, Figure, Panel};
use std::fmt::Write as _;

/// Pixels between ticks, about.
const APART_X: f64 = 78.0;
const APART_Y: f64 = 29.0;

/// Letters of a name at an axis.
const NAME: usize = 9;

/// The ticks of an axis over a length in pixels, each with its place from the beginning.
fn placed(axis: &Axis, length: f64, apart: f64) -> Vec<(f64, String)> {
    if !axis.names.is_empty() {
        let place = |(at, name): (usize, &String)| (axis.position(at as f64), name.clone());
        let within = axis.names.iter().enumerate().map(place).filter(|(place, _)| (0.0..=1.0).contains(place));
        return within.map(|(place, name)| (place * length, shortened(&name, NAME))).collect();
    }
    let range = axis.range.unwrap_or([0.0, 1.0]);
    let count = ((length / apart) as usize).clamp(2, 12);
    let found = ticks(axis.scale, range, count).into_iter();
    found.map(|tick| (axis.position(tick.at) * length, tick.text)).collect()
}

/// Draws the axes of a panel.
pub(super) fn write(out: &mut String, figure: &Figure, panel: &Panel, frame: &Frame) {
    let Frame { x, y, width, height, .. } = *frame;
    let (right, bottom) = (x + width, y + height);
    if !frame.head.is_empty() {
        text(out, "f-head", [x, y - 9.0], "", &frame.head);
    }
    let levels = placed(&panel.y, height, APART_Y);
    let mut grid = String::new();
    let is_ruled = panel.y.names.is_empty();
    for (level, _) in levels.iter().filter(|_| is_ruled) {
        let _ = write!(grid, "M{} {}h{}", px(x), px((bottom - level).round() - 0.5), px(width));
    }
    let _ = write!(out, "<path class=\"f-grid\" d=\"{grid}\"/>");
    for (level, words) in levels.iter().filter(|(_, words)| !words.is_empty()) {
        text(out, "f-tick", [x - 8.0, bottom - level + 4.0], "text-anchor=\"end\"", words);
    }
    let places = placed(&figure.x, width, APART_X);
    let mut base = format!("M{} {}H{}", px(x), px(bottom), px(right));
    for (place, _) in &places {
        let _ = write!(base, "M{} {}v4", px(x + place), px(bottom));
    }
    let _ = write!(out, "<path class=\"f-base\" d=\"{base}\"/>");
    if frame.has_x_axis {
        let mut free = f64::NEG_INFINITY;
        for (place, words) in places.iter().filter(|(_, words)| !words.is_empty()) {
            // Labels of logarithmic ticks come unevenly close: one that would touch the one before is left out.
            let half = 0.5 * crate::figure::text::room(words, crate::figure::style::TICK);
            if place - half < free {
                continue;
            }
            free = place + half + 4.0;
            text(out, "f-tick", [x + place, bottom + 17.0], "text-anchor=\"middle\"", words);
        }
        text(out, "f-axis", [x + 0.5 * width, bottom + 35.0], "text-anchor=\"middle\"", &figure.x.text());
    }
    if frame.has_y_label {
        let [at_x, at_y] = [x - 48.0, y + 0.5 * height];
        let turned = format!("text-anchor=\"middle\" transform=\"rotate(-90 {} {})\"", px(at_x), px(at_y));
        text(out, "f-axis", [at_x, at_y], &turned, &panel.y.text());
    }
}
