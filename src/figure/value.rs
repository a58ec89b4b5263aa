//! What a figure is.

use crate::trust::Level;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A figure: panels over one x axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Figure {
    /// Its name in addresses.
    pub name: String,
    /// What it shows, in a few words.
    pub title: String,
    /// What there is to see, in sentences: the finding, for whoever does not see the picture.
    pub description: String,
    /// Where it comes from and what its marks mean.
    pub caption: String,
    /// Which of the numbers there are: all of them, or the least and the greatest in every pixel.
    pub sampling: String,
    /// The axis that all panels share.
    pub x: Axis,
    /// The panels, from the top; of each column.
    pub panels: Vec<Panel>,
}

/// An axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigureAxis")]
pub struct Axis {
    /// The quantity.
    pub label: String,
    /// Its unit; `1` where it has none, empty where it counts.
    pub unit: String,
    /// Linear or logarithmic.
    pub scale: Scale,
    /// Values that the axis always reaches, in its unit.
    pub include: Vec<f64>,
    /// Its ends in its unit; null where the numbers decide.
    pub range: Option<[f64; 2]>,
    /// What stands at 0, 1, 2 and so on instead of numbers; empty where numbers stand.
    #[serde(default)]
    pub names: Vec<String>,
}

/// How an axis is divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigureScale")]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// Equal lengths for equal differences.
    Linear,
    /// Equal lengths for equal ratios.
    Logarithmic,
}

/// One y axis with what is drawn over it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigurePanel")]
pub struct Panel {
    /// What stands above it; empty where the axis says it all.
    pub title: String,
    /// Its y axis.
    pub y: Axis,
    /// The column that it stands in where there is room for several, from 0.
    pub column: usize,
    /// Its height as a share of the highest panel's.
    pub height: f64,
    /// What is drawn, from the back.
    pub series: Vec<Series>,
    /// Lines that mean something by themselves.
    pub rules: Vec<Rule>,
    /// Hatched stretches of the x axis.
    pub spans: Vec<Span>,
}

/// Numbers that are drawn in one way. All lists that are not empty are equally long.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigureSeries")]
pub struct Series {
    /// What it is called.
    pub name: String,
    /// Whether its name stands at its end, or in the legend where there are many.
    pub labelled: bool,
    /// How it is drawn.
    pub mark: Mark,
    /// In which colour, dashes and shape.
    pub ink: Ink,
    /// How strongly.
    pub weight: Weight,
    /// Places on the x axis, increasing, in its unit.
    pub x: Vec<f64>,
    /// Values in the unit of the y axis, null where there is none; empty for a band.
    pub y: Vec<Option<f64>>,
    /// Lower ends of bands and bars in the unit of the y axis, null where there is none; empty without.
    pub low: Vec<Option<f64>>,
    /// Upper ends, likewise.
    pub high: Vec<Option<f64>>,
    /// What each mark says of itself; empty where the numbers say it all.
    pub notes: Vec<String>,
    /// How far each value may be used; empty where nothing is said of it.
    pub trust: Vec<Level>,
    /// What stands on each mark; empty where nothing does.
    #[serde(default)]
    pub texts: Vec<String>,
}

/// How numbers are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigureMark")]
#[serde(rename_all = "snake_case")]
pub enum Mark {
    /// A line from value to value; gaps break it.
    Line,
    /// The same through samples, with a dot on each where few are in sight.
    Samples,
    /// A dot, square, triangle or diamond on each value, by its ink.
    Points,
    /// A cross on each value: not to be used.
    Crosses,
    /// A whisker from `low` to `high`.
    Bars,
    /// The surface between `low` and `high`; gaps break it.
    Band,
    /// A cell of the size 1 around each value, in the colours of its trust, with its text.
    Cells,
    /// A column from 0 to each value.
    Columns,
    /// An open cross on each value: ×.
    Times,
    /// An upright cross on each value: +.
    Plus,
    /// A ring around each value.
    Rings,
}

/// A colour with its dashes and shape. The four of groups are told apart without colour too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigureInk")]
#[serde(rename_all = "snake_case")]
pub enum Ink {
    /// The command r.
    Command,
    /// The output y.
    Output,
    /// The control u.
    Control,
    /// The error r − y.
    Error,
    /// First group: solid, dots.
    First,
    /// Second group: dashed, squares.
    Second,
    /// Third group: dotted, triangles.
    Third,
    /// Fourth group: dash-dot, diamonds.
    Fourth,
    /// What is there for comparison.
    Muted,
}

impl Ink {
    /// The ink of a group by its place; more groups than inks are shown in panels of their own, in the first.
    #[must_use]
    pub fn of_group(place: usize) -> Self {
        [Self::First, Self::Second, Self::Third, Self::Fourth].get(place).copied().unwrap_or(Self::First)
    }
}

/// How strongly something is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigureWeight")]
#[serde(rename_all = "snake_case")]
pub enum Weight {
    /// A wide pale line that lies beneath another.
    Wide,
    /// A thin line.
    Thin,
    /// A strong line.
    Thick,
    /// A thin pale line, one of many.
    Faint,
}

/// A straight line across a panel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigureRule")]
pub struct Rule {
    /// Where it lies, in the unit of the axis that it crosses.
    pub at: f64,
    /// What it means; empty where nothing needs to be said.
    pub label: String,
    /// What sort of line it is.
    pub kind: RuleKind,
}

/// What a straight line stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigureRuleKind")]
#[serde(rename_all = "snake_case")]
pub enum RuleKind {
    /// A value of y to compare with.
    Reference,
    /// A value of y that is not to be passed.
    Limit,
    /// A place on the x axis where something else begins.
    Border,
}

/// A stretch of the x axis that is not to be used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "FigureSpan")]
pub struct Span {
    /// Where it begins, in the unit of the x axis.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// Why it is marked.
    pub label: String,
}

impl Axis {
    /// A linear axis that follows its numbers.
    #[must_use]
    pub fn linear(label: impl Into<String>, unit: impl Into<String>) -> Self {
        let (include, names) = (Vec::new(), Vec::new());
        Self { label: label.into(), unit: unit.into(), scale: Scale::Linear, include, range: None, names }
    }

    /// An axis with a name at 0, 1, 2 and so on.
    #[must_use]
    pub fn named(label: impl Into<String>, names: Vec<String>) -> Self {
        let last = names.len() as f64 - 0.5;
        Self { range: Some([-0.5, last.max(0.5)]), names, ..Self::linear(label, "") }
    }

    /// A logarithmic axis that follows its numbers.
    #[must_use]
    pub fn logarithmic(label: impl Into<String>, unit: impl Into<String>) -> Self {
        Self { scale: Scale::Logarithmic, ..Self::linear(label, unit) }
    }

    /// The same, reaching some values whatever the numbers are.
    #[must_use]
    pub fn including(mut self, values: &[f64]) -> Self {
        self.include.extend_from_slice(values);
        self
    }

    /// Label and unit as they stand at the axis.
    #[must_use]
    pub fn text(&self) -> String {
        if self.unit.is_empty() { self.label.clone() } else { format!("{} ({})", self.label, self.unit) }
    }
}

impl Panel {
    /// A panel of full height in the first column.
    #[must_use]
    pub fn new(title: impl Into<String>, y: Axis, series: Vec<Series>) -> Self {
        Self { title: title.into(), y, column: 0, height: 1.0, series, rules: Vec::new(), spans: Vec::new() }
    }

    /// The same with a line across.
    #[must_use]
    pub fn with_rule(mut self, at: f64, label: impl Into<String>, kind: RuleKind) -> Self {
        self.rules.push(Rule { at, label: label.into(), kind });
        self
    }

    /// The same with a share of the highest panel's height.
    #[must_use]
    pub fn of_height(mut self, share: f64) -> Self {
        self.height = share;
        self
    }

    /// The same in another column.
    #[must_use]
    pub fn in_column(mut self, column: usize) -> Self {
        self.column = column;
        self
    }
}

impl Series {
    fn bare(name: impl Into<String>, mark: Mark, ink: Ink, weight: Weight, x: Vec<f64>) -> Self {
        let (y, low, high, notes, trust) = (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let texts = Vec::new();
        Self { name: name.into(), labelled: false, mark, ink, weight, x, y, low, high, notes, trust, texts }
    }

    /// Values, one at each place.
    #[must_use]
    pub fn values(
        name: impl Into<String>,
        (mark, ink, weight): (Mark, Ink, Weight),
        x: Vec<f64>,
        y: impl IntoIterator<Item = Option<f64>>,
    ) -> Self {
        Self { y: finite(y), ..Self::bare(name, mark, ink, weight, x) }
    }

    /// A pair of ends at each place: a band, or whiskers.
    #[must_use]
    pub fn intervals(
        name: impl Into<String>,
        (mark, ink, weight): (Mark, Ink, Weight),
        x: Vec<f64>,
        ends: impl IntoIterator<Item = Option<[f64; 2]>>,
    ) -> Self {
        let ends = ends.into_iter().map(|ends| ends.filter(|ends| ends.iter().all(|end| end.is_finite())));
        let (low, high) = ends.map(|ends| (ends.map(|e| e[0]), ends.map(|e| e[1]))).unzip();
        Self { low, high, ..Self::bare(name, mark, ink, weight, x) }
    }

    /// The same with its name at its end.
    #[must_use]
    pub fn labelled(mut self) -> Self {
        self.labelled = true;
        self
    }

    /// The same with what each mark says.
    #[must_use]
    pub fn with_notes(mut self, notes: Vec<String>) -> Self {
        self.notes = notes;
        self
    }

    /// The same with how far each value may be used.
    #[must_use]
    pub fn with_trust(mut self, trust: Vec<Level>) -> Self {
        self.trust = trust;
        self
    }

    /// The same with what stands on each mark.
    #[must_use]
    pub fn with_texts(mut self, texts: Vec<String>) -> Self {
        self.texts = texts;
        self
    }

    /// Whether nothing is drawn at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        !self.numbers().any(|(_, value)| value.is_finite())
    }

    /// Every number drawn, with its place on the x axis.
    pub(super) fn numbers(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        let lists = [&self.y, &self.low, &self.high].into_iter();
        lists.flat_map(|list| self.x.iter().zip(list).filter_map(|(x, value)| Some((*x, (*value)?))))
    }

    /// The entries at some places of the lists.
    pub(super) fn picked(&self, places: &[usize]) -> Self {
        fn pick<T: Clone>(list: &[T], places: &[usize]) -> Vec<T> {
            places.iter().filter_map(|place| list.get(*place).cloned()).collect()
        }
        Self {
            name: self.name.clone(),
            x: pick(&self.x, places),
            y: pick(&self.y, places),
            low: pick(&self.low, places),
            high: pick(&self.high, places),
            notes: pick(&self.notes, places),
            trust: pick(&self.trust, places),
            texts: pick(&self.texts, places),
            ..*self
        }
    }
}

fn finite(values: impl IntoIterator<Item = Option<f64>>) -> Vec<Option<f64>> {
    values.into_iter().map(|value| value.filter(|value| value.is_finite())).collect()
}
