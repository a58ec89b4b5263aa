//! How a figure is asked for.

use super::needs_colours;
use crate::analysis::Problem;
use crate::api::extract::{FromQuery, QueryText};
use crate::figure::Theme;
use crate::figure::svg::Drawing;
use utoipa::IntoParams;

/// Widths in pixels.
const LEAST: i64 = 280;
const MOST: i64 = 2000;
/// Unless asked otherwise.
const USUAL: i64 = 720;
/// Widths are whole multiples of this, so that windows of about one size share their pictures.
const STEP: i64 = 40;

/// The form of an answer.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Format {
    #[default]
    Svg,
    Png,
    Csv,
    Json,
}

impl Format {
    const ALL: [Self; 4] = [Self::Svg, Self::Png, Self::Csv, Self::Json];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Svg => "svg",
            Self::Png => "png",
            Self::Csv => "csv",
            Self::Json => "json",
        }
    }

    pub(super) fn media_type(self) -> &'static str {
        match self {
            Self::Svg => "image/svg+xml",
            Self::Png => "image/png",
            Self::Csv => "text/csv; charset=utf-8; header=present",
            Self::Json => "application/json",
        }
    }
}

/// How a figure is drawn, and what of it.
#[derive(Debug, Clone, Copy, PartialEq, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct FigureQuery {
    /// `svg`, `png` (two dots a pixel; for paper 300 an inch), or the numbers that are drawn as `csv` or `json`.
    #[param(value_type = Option<String>, nullable = false, pattern = "^(svg|png|csv|json)$", default = "svg")]
    pub(super) format: Format,
    /// Where the x axis begins, in its unit; without it, at the beginning of the figure.
    #[param(nullable = false)]
    pub(super) from: Option<f64>,
    /// Where the x axis ends.
    #[param(nullable = false)]
    pub(super) to: Option<f64>,
    /// The width in pixels, rounded to a multiple of 40. On paper 96 pixels are an inch: 320 are 85 mm, 680 are 180 mm.
    #[param(required = false, minimum = 280, maximum = 2000, default = 720)]
    pub(super) w: u32,
    /// `light`, `dark`, `paper` (for print, without heading and caption), or `page` (classes only, for a page that has
    /// the style sheet).
    #[param(value_type = Option<String>, nullable = false, pattern = "^(light|dark|paper|page)$", default = "light")]
    pub(super) theme: Theme,
}

impl FromQuery for FigureQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let format =
            query.one_of("format", "svg, png, csv, json", |text| Format::ALL.into_iter().find(|f| f.name() == text))?;
        let (from, to) = (query.number("from")?, query.number("to")?);
        let width = query.integer("w", LEAST, MOST)?.unwrap_or(USUAL);
        let theme = query
            .one_of("theme", "light, dark, paper, page", |text| Theme::ALL.into_iter().find(|t| t.name() == text))?;
        let w = u32::try_from((width + STEP / 2) / STEP * STEP).unwrap_or_default();
        Ok(Self { format: format.unwrap_or_default(), from, to, w, theme: theme.unwrap_or_default() })
    }
}

impl FigureQuery {
    /// Refuses what contradicts itself.
    pub(super) fn check(&self) -> Result<(), Problem> {
        needs_colours(self)
    }

    pub(super) fn drawing(&self) -> Drawing {
        Drawing { width: self.w, theme: self.theme, from: self.from, to: self.to }
    }
}
