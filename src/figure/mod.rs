//! Figures: values that are drawn once, in one way, for the page, the paper and the picture.
//!
//! A [`Figure`] says what is shown: panels over one x axis, with axes, series, rules and the words that belong to them.
//! [`of`] makes figures from stored things. [`Figure::view`] cuts one to what is looked at and thins out what no pixel
//! can show; [`svg`], [`png`] and [`table`] write what is left, so that the picture, its CSV and its JSON have the same
//! numbers. The theme is the only thing that differs between a page and a paper.

mod decimate;
mod layout;
pub mod of;
mod palette;
mod path;
pub mod png;
mod style;
pub mod svg;
pub mod table;
pub mod text;
mod ticks;
mod value;
mod view;

pub use palette::Theme;
pub use style::page_style;
pub use value::{Axis, Figure, Ink, Mark, Panel, Rule, RuleKind, Scale, Series, Span, Weight};
pub use view::{View, ViewError};

/// Rises with every change of what is drawn from the same numbers, so that nobody keeps an old picture.
pub const RENDERER: u32 = 1;
