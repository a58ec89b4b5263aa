//! Figures in pages, as the one writer draws them.

use super::layout::written;
use crate::figure::svg::{Drawing, write};
use crate::figure::{Figure, Theme};
use maud::{Markup, html};

/// The width on a narrow screen, in pixels. No page measures its reader's screen: both widths are sent, the style sheet
/// shows one.
const NARROW: u32 = 360;

/// Rows of numbers that stand in a page itself, of figures that have no address of their own.
const MOST_ROWS: usize = 200;

/// A figure, drawn for both sorts of screen.
pub(super) struct Drawn {
    name: String,
    title: String,
    caption: String,
    wide: String,
    narrow: String,
    is_empty: bool,
    /// What is drawn on a wide screen, of figures without an address: their numbers stand in the page.
    numbers: Option<Figure>,
}

/// The part of the x axis that is looked at.
pub(super) type View = [Option<f64>; 2];

impl Drawn {
    /// Draws. A view that the figure has nothing in is the whole figure.
    pub(super) fn new(figure: &Figure, width: u32, [from, to]: View) -> Self {
        let of = |width: u32| {
            let all = Drawing { width, theme: Theme::Page, from: None, to: None };
            let drawing = Drawing { from, to, ..all };
            match figure.drawn(&drawing) {
                Ok(seen) => write(&seen, &drawing),
                Err(_) => figure.drawn(&all).map(|seen| write(&seen, &all)).unwrap_or_default(),
            }
        };
        Self {
            name: figure.name.clone(),
            title: figure.title.clone(),
            caption: figure.caption.clone(),
            wide: of(width),
            narrow: of(NARROW),
            is_empty: figure.panels.iter().all(|panel| panel.series.iter().all(crate::figure::Series::is_empty)),
            numbers: None,
        }
    }

    /// The same with its numbers, for a figure that is not to be had elsewhere.
    pub(super) fn with_numbers(figure: &Figure, width: u32) -> Self {
        let drawing = Drawing { width, theme: Theme::Page, from: None, to: None };
        Self { numbers: figure.drawn(&drawing).ok(), ..Self::new(figure, width, [None, None]) }
    }

    /// Whether there is nothing to see.
    pub(super) fn is_empty(&self) -> bool {
        self.is_empty
    }

    /// The figure as a card without files of its own.
    pub(super) fn plain(&self, more: &Markup) -> Markup {
        html! {
            section.card.figure data-name=(self.name) {
                div.card-head { h2 { (self.title) } (more) }
                (self.plot())
                @if let Some(figure) = &self.numbers { (table(figure)) }
            }
        }
    }

    /// The figure and its caption alone, for a card that has more in it.
    pub(super) fn inside(&self) -> Markup {
        self.plot()
    }

    /// The figure as a card, drawn once: for paper, whose width is known.
    pub(super) fn single(&self) -> Markup {
        html! {
            section.card.figure data-name=(self.name) {
                h2 { (self.title) }
                (written(&self.wide))
                p.caption { (self.caption) }
            }
        }
    }

    fn plot(&self) -> Markup {
        html! {
            div.plot { div.wide { (written(&self.wide)) } div.narrow { (written(&self.narrow)) } }
            p.caption { (self.caption) }
        }
    }

    /// The figure as a card; `address` is where the interface has it, with the parameters that say of what, `more` is
    /// put beside the links.
    pub(super) fn card(&self, address: &str, more: &Markup) -> Markup {
        let join = if address.contains('?') { '&' } else { '?' };
        let link = |format: &str| format!("{address}{join}format={format}");
        html! {
            section.card.figure data-address=(address) data-name=(self.name) {
                div.card-head {
                    h2 { (self.title) }
                    (more)
                    p.files {
                        @for format in ["svg", "png", "csv", "json"] {
                            a href=(link(format)) aria-label={ (format.to_uppercase()) " of " (self.title) } {
                                (format.to_uppercase())
                            }
                            " "
                        }
                    }
                }
                (self.plot())
                // Filled by the script when it is opened; without it, the numbers are those of the CSV.
                details.numbers {
                    summary { "Data as a table" }
                    p.muted { "The numbers that are drawn: " a href=(link("csv")) { "CSV of " (self.title) } }
                }
            }
        }
    }
}

/// The numbers of a figure as a table.
fn table(figure: &Figure) -> Markup {
    let number = |value: Option<&Option<f64>>| value.copied().flatten().map_or_else(String::new, |own| own.to_string());
    let rows = figure.panels.iter().flat_map(|panel| {
        panel.series.iter().flat_map(move |series| (0..series.x.len()).map(move |at| (panel, series, at)))
    });
    let all = rows.clone().count();
    html! {
        details.numbers {
            summary { "Data as a table" }
            div.scroll tabindex="0" role="region" aria-label={ "Numbers of " (figure.title) } {
                table {
                    thead { tr {
                        @for head in ["Panel", "Series", figure.x.text().as_str(), "Value", "From", "To"] {
                            th scope="col" { (head) }
                        }
                    } }
                    tbody { @for (panel, series, at) in rows.take(MOST_ROWS) { tr {
                        td { (panel.y.text()) }
                        td { (series.name) }
                        td { (series.x[at]) }
                        td { (number(series.y.get(at))) }
                        td { (number(series.low.get(at))) }
                        td { (number(series.high.get(at))) }
                    } } }
                }
            }
            @if all > MOST_ROWS { p.muted { "The first " (MOST_ROWS) " of " (all) " rows." } }
        }
    }
}
