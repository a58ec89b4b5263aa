//! The colours of a figure.
//!
//! Those of groups differ by at least 20 (ΔE*ab) from one another and have a contrast of 3.5 or more to the ground, for
//! usual sight and for protanopes, deuteranopes and tritanopes (Machado, Oliveira & Fernandes 2009).

use super::value::Ink;

/// How a figure is dressed. It is all that differs between a page, a screen and a paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Theme {
    /// Classes only: a page brings its own style sheet, heading and caption.
    Page,
    /// Dark on white, with heading and caption.
    #[default]
    Light,
    /// Light on dark, with heading and caption.
    Dark,
    /// For print: its width is one in millimetres at 96 pixels an inch; without heading and caption, which a paper has.
    Paper,
}

impl Theme {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Page, Self::Light, Self::Dark, Self::Paper];

    /// Its name in addresses.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Page => "page",
            Self::Light => "light",
            Self::Dark => "dark",
            Self::Paper => "paper",
        }
    }

    /// Whether heading and caption are drawn.
    pub(super) fn has_words(self) -> bool {
        matches!(self, Self::Light | Self::Dark)
    }
}

/// Colours as CSS writes them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Palette {
    pub card: &'static str,
    pub ink: &'static str,
    pub muted: &'static str,
    pub line: &'static str,
    pub base: &'static str,
    pub limit: &'static str,
    /// By [`INKS`].
    pub inks: [&'static str; 9],
    /// Text and ground of what is not identified, ok, to be read, not to be used.
    pub trust: [[&'static str; 2]; 4],
}

/// The inks, in the order in which palettes have them.
pub(super) const INKS: [Ink; 9] =
    [Ink::Command, Ink::Output, Ink::Control, Ink::Error, Ink::First, Ink::Second, Ink::Third, Ink::Fourth, Ink::Muted];

/// On white.
pub(super) const LIGHT: Palette = Palette {
    card: "#ffffff",
    ink: "#17212b",
    muted: "#52606d",
    line: "#dfe4ea",
    base: "#7b8794",
    limit: "#a61b1b",
    inks: ["#8793a0", "#0b5fa5", "#007785", "#c2410c", "#0b5fa5", "#c2410c", "#0097a7", "#17212b", "#52606d"],
    trust: [["#52606d", "#f6f7f9"], ["#17694b", "#e3f4ec"], ["#7a4d00", "#fdf0d3"], ["#a61b1b", "#fde5e3"]],
};

/// On dark.
pub(super) const DARK: Palette = Palette {
    card: "#182029",
    ink: "#e6ebf0",
    muted: "#a3b0bd",
    line: "#2b3742",
    base: "#718191",
    limit: "#ff9c93",
    inks: ["#718191", "#8cc4ff", "#8fe3d0", "#ff7a3d", "#4a9eff", "#ff7a3d", "#8fe3d0", "#f0c6ff", "#a3b0bd"],
    trust: [["#a3b0bd", "#10161d"], ["#7ee0b4", "#123528"], ["#f2c566", "#3a2d0d"], ["#ff9c93", "#431d1c"]],
};

/// On paper.
pub(super) const PAPER: Palette =
    Palette { ink: "#000000", muted: "#333333", line: "#cccccc", base: "#333333", ..LIGHT };

/// The variables of a page's style sheet.
pub(super) const VARIABLES: Palette = Palette {
    card: "var(--fig-card)",
    ink: "var(--fig-ink)",
    muted: "var(--fig-muted)",
    line: "var(--fig-line)",
    base: "var(--fig-base)",
    limit: "var(--fig-limit)",
    inks: [
        "var(--fig-r)",
        "var(--fig-y)",
        "var(--fig-u)",
        "var(--fig-e)",
        "var(--fig-1)",
        "var(--fig-2)",
        "var(--fig-3)",
        "var(--fig-4)",
        "var(--fig-m)",
    ],
    trust: [
        ["var(--fig-tn)", "var(--fig-tng)"],
        ["var(--fig-to)", "var(--fig-tog)"],
        ["var(--fig-tr)", "var(--fig-trg)"],
        ["var(--fig-tx)", "var(--fig-txg)"],
    ],
};

/// The endings of the classes of [`Palette::trust`].
pub(super) const TRUST: [&str; 4] = ["n", "o", "r", "x"];

/// The class of an ink.
pub(super) fn class(ink: Ink) -> &'static str {
    match ink {
        Ink::Command => "fi-r",
        Ink::Output => "fi-y",
        Ink::Control => "fi-u",
        Ink::Error => "fi-e",
        Ink::First => "fi-1",
        Ink::Second => "fi-2",
        Ink::Third => "fi-3",
        Ink::Fourth => "fi-4",
        Ink::Muted => "fi-m",
    }
}
