//! Figures in pages, as the one writer draws them.

use super::layout::written;
use crate::figure::svg::{Drawing, write};
use crate::figure::{Figure, Theme};
use maud::{Markup, html};

/// The width on a narrow screen, in pixels. No page measures its reader's screen: both widths are sent, the style sheet
/// shows one.
const NARROW: u32 = 360;

/// A figure, drawn for both sorts of screen.
pub(super) struct Drawn {
    name: String,
    title: String,
    caption: String,
    wide: String,
    narrow: String,
    is_empty: bool,
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
        }
    }

    /// Whether there is nothing to see.
    pub(super) fn is_empty(&self) -> bool {
        self.is_empty
    }

    /// The figure as a card without files of its own.
    pub(super) fn plain(&self, more: &Markup) -> Markup {
        html! { section.card.figure data-name=(self.name) { div.card-head { h2 { (self.title) } (more) } (self.plot()) }
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
            }
        }
    }
}
