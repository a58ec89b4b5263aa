//! How far values may be used, as pages show it.

use crate::learning::curves::Metric;
use crate::trust::Level;
use maud::{Markup, html};

/// What a quantity is called in a table.
pub(super) fn symbol(metric: Metric) -> &'static str {
    match metric {
        Metric::MeanAbsError => "mean |r − y|",
        Metric::RmsError => "rms of r − y",
        Metric::NormFeedback => "‖Gfb‖",
        Metric::NormFeedforwardMinusInverse => "‖Gff − G⁻¹‖",
        Metric::NormFeedforwardPlantMinusOne => "‖Gff G − 1‖",
        Metric::VarianceAccountedFor => "variance accounted for",
        Metric::ControlLogDimensionlessJerk => "log dimensionless jerk",
    }
}

/// The class that has its colours.
pub(super) fn class(level: Level) -> &'static str {
    match level {
        Level::NotIdentified => "t-none",
        Level::Ok => "t-ok",
        Level::Read => "t-read",
        Level::DoNotUse => "t-not",
    }
}

/// A level with its words.
pub(super) fn chip(level: Level, words: &str) -> Markup {
    html! {
        span class={ "chip " (class(level)) } data-trust=(level.name()) {
            span aria-hidden="true" { (level.sign()) } " " (words)
        }
    }
}

/// How many of each level there are, as words.
pub(super) fn counts(levels: &[Level]) -> Markup {
    html! {
        p.counts {
            @for level in [Level::Ok, Level::Read, Level::DoNotUse, Level::NotIdentified] {
                @let n = levels.iter().filter(|own| **own == level).count();
                @if n > 0 || level != Level::NotIdentified { (chip(level, &format!("{n} {}", level.words()))) " " }
            }
        }
    }
}
