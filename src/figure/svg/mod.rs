//! A figure as SVG.
//!
//! One writer for the page, the paper and the picture. The image has a role, a title and a description that says the
//! finding; marks say what they are; classes carry the colours, so that a page changes its theme without drawing anew.
//! Data lie in an `svg` of their own for each panel, which cuts them off at its edges and needs no names that could
//! clash with those of another figure on the page.

mod axes;
mod labels;
mod marks;

use super::layout::Layout;
use super::palette::{Theme, class};
use super::style;
use super::text::escaped;
use super::value::{Figure, Scale};
use super::view::{View, ViewError};
use std::fmt::Write as _;

/// Millimetres of a pixel at 96 pixels an inch.
const MILLIMETRES: f64 = 25.4 / 96.0;

/// How far a plot reaches beyond its frame above and below, so that lines on its edges are drawn whole.
const OVERLAP: f64 = 5.0;

/// How a figure is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drawing {
    /// Its width in pixels.
    pub width: u32,
    /// How it is dressed.
    pub theme: Theme,
    /// Where the x axis begins, in its unit; at its own beginning where this is `None`.
    pub from: Option<f64>,
    /// Where it ends.
    pub to: Option<f64>,
}

impl Figure {
    /// What is drawn of the figure: the numbers of the picture, of its CSV and of its JSON.
    ///
    /// # Errors
    /// [`ViewError`] where nothing of it is in sight.
    pub fn drawn(&self, drawing: &Drawing) -> Result<Self, ViewError> {
        let columns = Layout::new(self, f64::from(drawing.width), drawing.theme).columns();
        self.view(&View { from: drawing.from, to: drawing.to, columns })
    }
}

/// A number of pixels in an attribute, in tenths.
fn px(pixels: f64) -> String {
    super::path::short(super::path::tenths(pixels))
}

/// Writes what [`Figure::drawn`] gave for the same drawing.
#[must_use]
pub fn write(figure: &Figure, drawing: &Drawing) -> String {
    let layout = Layout::new(figure, f64::from(drawing.width), drawing.theme);
    let [width, height] = [layout.width, layout.height];
    let mut out = String::with_capacity(16 << 10);
    let size = match drawing.theme {
        Theme::Paper => {
            format!("width=\"{:.2}mm\" height=\"{:.2}mm\"", width * MILLIMETRES, height * MILLIMETRES)
        }
        _ => format!("width=\"{width}\" height=\"{height}\""),
    };
    let [from, to] = figure.x.range.unwrap_or([0.0, 1.0]);
    let scale = match figure.x.scale {
        Scale::Linear => "linear",
        Scale::Logarithmic => "logarithmic",
    };
    let _ = write!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"fig\" role=\"img\" {size} viewBox=\"0 0 {width} {height}\" \
         data-figure=\"{}\" data-from=\"{from:?}\" data-to=\"{to:?}\" data-scale=\"{scale}\">",
        escaped(&figure.name)
    );
    let _ = write!(out, "<title>{}: {}</title>", escaped(&figure.title), escaped(&figure.sampling));
    let _ = write!(out, "<desc>{} {}</desc>", escaped(&figure.description), escaped(&figure.caption));
    if let Some(css) = style::of(drawing.theme) {
        let _ = write!(out, "<style>{css}</style><rect class=\"f-ground\" width=\"{width}\" height=\"{height}\"/>");
    }
    for words in &layout.title {
        text(&mut out, "f-title", [words.x, words.y], "", &words.text);
    }
    for entry in &layout.legend {
        let [x, y] = [entry.name.x, entry.name.y];
        let _ = write!(
            out,
            "<path class=\"{} f-line f-thick\" d=\"M{} {}h22\"/>",
            class(entry.ink),
            px(x - 28.0),
            px(y - 4.0)
        );
        text(&mut out, "f-note", [x, y], "", &entry.name.text);
    }
    for (panel, frame) in figure.panels.iter().zip(&layout.frames) {
        axes::write(&mut out, figure, panel, frame);
        let [low, high] = panel.y.range.unwrap_or([0.0, 1.0]);
        let _ = write!(
            out,
            "<svg class=\"f-plot\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" data-low=\"{low:?}\" \
             data-high=\"{high:?}\">",
            px(frame.x),
            px(frame.y - OVERLAP),
            px(frame.width),
            px(frame.height + 2.0 * OVERLAP)
        );
        marks::write(&mut out, &figure.x, panel, frame);
        out.push_str("</svg>");
        labels::write(&mut out, &figure.x, panel, frame, layout.names);
    }
    for words in &layout.caption {
        text(&mut out, "f-note", [words.x, words.y], "", &words.text);
    }
    out.push_str("</svg>");
    out
}

/// A text at a place; `more` are further attributes.
fn text(out: &mut String, class: &str, [x, y]: [f64; 2], more: &str, words: &str) {
    let space = if more.is_empty() { "" } else { " " };
    let _ =
        write!(out, "<text class=\"{class}\" x=\"{}\" y=\"{}\"{space}{more}>{}</text>", px(x), px(y), escaped(words));
}

#[cfg(test)]
mod tests;
