//! Where everything stands. No text is measured, since fonts differ: every label gets the room that it needs in any.

use super::palette::Theme;
use super::style::{HEADING, TEXT};
use super::text::{room, shortened, wrapped};
use super::value::{Figure, Ink, Mark, Panel};

/// Widths that are drawn, in pixels.
pub(super) const LEAST_WIDTH: f64 = 280.0;

/// Letters of a name at a line's end.
const NAME: usize = 22;

/// More names than this in one panel stand in a legend.
const MOST_NAMES: usize = 4;

/// From this width on, names stand beside the panels; on narrower figures they stand on the lines.
const WIDE: f64 = 560.0;

/// Columns of panels stand side by side where each has this much.
const COLUMN: f64 = 300.0;

/// Room left of a panel for ticks and label, and right of it for the last tick.
const LEFT: f64 = 62.0;
const RIGHT: f64 = 16.0;

/// The height of a row of a panel whose rows have names.
const ROW: f64 = 26.0;

/// Heights of what stands around the panels.
const LINE: f64 = 18.0;
const GAP: f64 = 14.0;
const X_AXIS: f64 = 40.0;
const EDGE: f64 = 8.0;

/// The plot of a panel, in pixels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Frame {
    pub x: f64,
    pub y: f64,
    pub width: f64,
    pub height: f64,
    /// Whether the labels of the x axis stand below it.
    pub has_x_axis: bool,
    /// The words above it.
    pub head: String,
    /// Whether the label of the y axis stands beside it; where it is too long, it is part of the head.
    pub has_y_label: bool,
}

/// A line of text with its baseline.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Words {
    pub text: String,
    pub x: f64,
    pub y: f64,
}

/// An entry of the legend.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    pub name: Words,
    pub ink: Ink,
}

/// Where names of lines stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Names {
    /// Right of the panels, level with the ends.
    Beside,
    /// On the lines, near their ends.
    OnLines,
    /// In the legend.
    InLegend,
}

/// The whole arrangement.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    pub width: f64,
    pub height: f64,
    /// In the order of the figure's panels.
    pub frames: Vec<Frame>,
    pub title: Vec<Words>,
    pub caption: Vec<Words>,
    pub legend: Vec<Entry>,
    pub names: Names,
}

/// A name as it stands at a line.
pub(super) fn name(text: &str) -> String {
    shortened(text, NAME)
}

fn lines(text: &str, size: f64, width: f64, top: f64) -> Vec<Words> {
    let lines = wrapped(text, size, width - 2.0 * EDGE).into_iter().zip(1..);
    lines.map(|(text, at)| Words { text, x: EDGE, y: top + LINE * f64::from(at) - 4.0 }).collect()
}

/// The names of a panel that are to be read.
fn labelled(panel: &Panel) -> impl Iterator<Item = (&str, Ink)> {
    panel.series.iter().filter(|series| series.labelled && !series.is_empty()).map(|s| (s.name.as_str(), s.ink))
}

fn legend(figure: &Figure, width: f64, top: f64) -> Vec<Entry> {
    let mut all: Vec<(&str, Ink)> = Vec::new();
    for entry in figure.panels.iter().flat_map(labelled) {
        if !all.contains(&entry) {
            all.push(entry);
        }
    }
    let cell = all.iter().map(|(text, _)| room(&name(text), TEXT)).fold(0.0, f64::max) + 46.0;
    let each = ((width - 2.0 * EDGE) / cell).floor().max(1.0) as usize;
    let place = |i: usize| [EDGE + 30.0 + cell * (i % each) as f64, top + LINE * (i / each + 1) as f64 - 4.0];
    let entries = all.iter().enumerate();
    entries
        .map(|(i, (text, ink))| {
            let [x, y] = place(i);
            Entry { name: Words { text: name(text), x, y }, ink: *ink }
        })
        .collect()
}

impl Layout {
    /// Arranges a figure in a width in pixels.
    pub(super) fn new(figure: &Figure, width: f64, theme: Theme) -> Self {
        let width = width.max(LEAST_WIDTH);
        let mut top = EDGE / 2.0;
        let mut title = Vec::new();
        if theme.has_words() {
            title = lines(&figure.title, HEADING, width, top);
            top += LINE * title.len() as f64 + EDGE / 2.0;
        }
        let mut entries = Vec::new();
        if figure.panels.iter().any(|panel| labelled(panel).count() > MOST_NAMES) {
            entries = legend(figure, width, top);
            top = entries.last().map_or(top, |last| last.name.y + EDGE);
        }
        let columns = figure.panels.iter().map(|panel| panel.column + 1).max().unwrap_or(1);
        let is_split = columns > 1 && width / columns as f64 >= COLUMN;
        let stacks: Vec<Vec<usize>> = if is_split {
            let of = |column| (0..figure.panels.len()).filter(move |i| figure.panels[*i].column == column).collect();
            (0..columns).map(of).collect()
        } else {
            let mut all: Vec<usize> = (0..figure.panels.len()).collect();
            all.sort_by_key(|i| figure.panels[*i].column);
            vec![all]
        };
        let names = match (entries.is_empty(), width >= WIDE && !is_split) {
            (false, _) => Names::InLegend,
            (true, true) => Names::Beside,
            (true, false) => Names::OnLines,
        };
        // Bold letters are wider, and a short name may be of wide ones alone.
        let longest = figure.panels.iter().flat_map(labelled).map(|(text, _)| 1.15 * room(&name(text), TEXT) + 18.0);
        let right = match names {
            Names::Beside => longest.fold(RIGHT, f64::max).min(0.32 * width),
            _ => RIGHT,
        };
        let column = width / stacks.len().max(1) as f64;
        let plot = (column - LEFT - right).floor();
        let mut frames = vec![None; figure.panels.len()];
        let mut bottom = top;
        for (at, stack) in stacks.iter().enumerate() {
            let left = (column * at as f64).floor() + LEFT;
            let end = arrange(figure, stack, [left, top, plot], &mut frames);
            bottom = f64::max(bottom, end);
        }
        let mut caption = Vec::new();
        if theme.has_words() && !figure.caption.is_empty() {
            // Of a curve that was computed at some places, their number says nothing.
            let is_recorded = figure.panels.iter().flat_map(|panel| &panel.series).any(|own| own.mark == Mark::Samples);
            let sampling = if is_recorded { format!("{}.", capital(&figure.sampling)) } else { String::new() };
            let text = format!("{} {sampling}", figure.caption);
            caption = lines(&text, TEXT, width, bottom + EDGE);
            bottom += LINE * caption.len() as f64 + EDGE;
        }
        let frames = frames.into_iter().flatten().collect();
        Self { width, height: (bottom + EDGE / 2.0).ceil(), frames, title, caption, legend: entries, names }
    }

    /// Pixel columns of a panel.
    pub(super) fn columns(&self) -> usize {
        self.frames.iter().map(|frame| frame.width as usize).max().unwrap_or(1)
    }
}

/// With a capital letter first.
fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Places the panels of a stack, one below the other; gives where they end.
fn arrange(figure: &Figure, stack: &[usize], [x, top, width]: [f64; 3], frames: &mut [Option<Frame>]) -> f64 {
    let full = if stack.len() == 1 { (0.5 * width).clamp(150.0, 300.0) } else { (0.24 * width).clamp(116.0, 170.0) };
    let mut y = top;
    for (at, panel) in stack.iter().enumerate() {
        let own = &figure.panels[*panel];
        let height = match own.y.names.len() {
            0 => (full * own.height.clamp(0.2, 1.0)).round(),
            names => ROW * names as f64,
        };
        let label = own.y.text();
        let has_y_label = room(&label, TEXT) <= height + 36.0;
        let head = match (has_y_label, own.title.is_empty()) {
            (true, _) => own.title.clone(),
            (false, true) => label,
            (false, false) => format!("{} · {label}", own.title),
        };
        y += if head.is_empty() { EDGE } else { LINE + EDGE };
        let has_x_axis = at + 1 == stack.len();
        frames[*panel] = Some(Frame { x, y, width, height, has_x_axis, head, has_y_label });
        y += height + if has_x_axis { X_AXIS } else { GAP };
    }
    y
}
