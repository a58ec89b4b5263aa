//! The style sheet of figures: the same rules in a file of its own and in that of a page.

use super::palette::{DARK, INKS, LIGHT, PAPER, Palette, TRUST, Theme, VARIABLES, class};
use super::value::Ink;
use std::fmt::Write as _;

/// Heights of letters in pixels.
pub(super) const TICK: f64 = 12.0;
pub(super) const TEXT: f64 = 12.5;
pub(super) const HEADING: f64 = 15.0;

/// The widths of lines in pixels; none is thinner than 0.6 pt at 96 pixels an inch.
const RULES: &str = ".f-line{fill:none;stroke-linejoin:round}\
.f-wide{stroke-width:3.6px;stroke-dasharray:none}\
.f-thin{stroke-width:1.3px}\
.f-thick{stroke-width:2.4px}\
.f-faint{stroke-width:1px;stroke-opacity:.45;stroke-dasharray:none}\
.f-dots{fill:none;stroke-width:4px;stroke-linecap:round;stroke-dasharray:none}\
.f-band{stroke:none;fill-opacity:.16}\
.f-mark{stroke:none}\
.f-cross{fill:none;stroke-width:1.8px;stroke-dasharray:none}\
.f-bar{fill:none;stroke-width:1.2px;stroke-dasharray:none}\
.f-pale{stroke-opacity:.45}\
.f-key{stroke:none}";

/// The rules in the colours of a palette.
fn rules(palette: &Palette) -> String {
    let Palette { card, ink, muted, line, base, limit, inks, trust } = palette;
    let mut css = format!(
        ".fig{{font-family:system-ui,-apple-system,\"Segoe UI\",Roboto,\"DejaVu Sans\",sans-serif;\
         font-size:{TEXT}px}}\
         .f-ground{{fill:{card}}}\
         .f-tick{{fill:{muted};font-size:{TICK}px}}\
         .f-axis{{fill:{muted};font-weight:600}}\
         .f-head{{fill:{ink};font-weight:600}}\
         .f-title{{fill:{ink};font-size:{HEADING}px;font-weight:700}}\
         .f-note{{fill:{muted}}}\
         .f-grid{{fill:none;stroke:{line};stroke-width:1px}}\
         .f-base{{fill:none;stroke:{base};stroke-width:1.2px}}\
         .f-reference{{fill:none;stroke:{muted};stroke-width:1px;stroke-dasharray:2 3}}\
         .f-border{{fill:none;stroke:{base};stroke-width:1px;stroke-dasharray:6 3}}\
         .f-limit{{fill:none;stroke:{limit};stroke-width:1.3px}}\
         .f-hatch{{fill:none;stroke:{muted};stroke-width:1px;stroke-opacity:.5}}"
    );
    for (of, colour) in INKS.iter().zip(inks) {
        let dashes = match of {
            Ink::Second => ";stroke-dasharray:8 3.5",
            Ink::Third => ";stroke-dasharray:2 3",
            Ink::Fourth => ";stroke-dasharray:9 3 2 3",
            _ => "",
        };
        let _ = write!(css, ".{}{{fill:{colour};stroke:{colour}{dashes}}}", class(*of));
    }
    for (name, [text, ground]) in TRUST.iter().zip(trust) {
        let _ = write!(
            css,
            ".f-t-{name} path{{fill:{ground};stroke:{text};stroke-width:.7px}}.f-t-{name} text{{fill:{text}}}"
        );
    }
    let _ = write!(css, ".f-cell text{{font-size:{TICK}px;font-weight:600}}");
    css.push_str(RULES);
    // Names over lines are read through a rim of the ground's colour.
    let rim = format!("stroke:{card};stroke-width:3px;paint-order:stroke;stroke-linejoin:round;stroke-dasharray:none");
    let _ = write!(css, ".f-name{{font-weight:700;{rim}}}.f-rim{{fill:{muted};{rim}}}");
    css
}

/// The style sheet of a figure in a file of its own; `None` on a page, which has one.
pub(super) fn of(theme: Theme) -> Option<String> {
    match theme {
        Theme::Page => None,
        Theme::Light => Some(rules(&LIGHT)),
        Theme::Dark => Some(rules(&DARK)),
        Theme::Paper => Some(rules(&PAPER)),
    }
}

/// The part of a page's style sheet that figures need: rules by variables, and the variables for light and dark, as the
/// reader's system or `data-theme` of the page says; print is light.
#[must_use]
pub fn page_style() -> String {
    let variables = |palette: &Palette| {
        let Palette { card, ink, muted, line, base, limit, inks, trust } = palette;
        let mut css = format!(
            "--fig-card:{card};--fig-ink:{ink};--fig-muted:{muted};--fig-line:{line};--fig-base:{base};\
             --fig-limit:{limit}"
        );
        for (of, colour) in INKS.iter().zip(inks) {
            let _ = write!(css, ";--fig-{}:{colour}", class(*of).trim_start_matches("fi-"));
        }
        for (name, [text, ground]) in TRUST.iter().zip(trust) {
            let _ = write!(css, ";--fig-t{name}:{text};--fig-t{name}g:{ground}");
        }
        css
    };
    let (light, dark) = (variables(&LIGHT), variables(&DARK));
    format!(
        ":root{{{light}}}@media (prefers-color-scheme:dark){{:root:not([data-theme=light]){{{dark}}}}}\
         :root[data-theme=dark]{{{dark}}}@media print{{:root,:root[data-theme=dark]{{{light}}}}}{}",
        rules(&VARIABLES)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sheet_of_a_page_defines_every_variable_that_it_uses() {
        let css = page_style();
        for name in css.split("var(").skip(1).map(|rest| rest.split(')').next().unwrap()) {
            assert_eq!(css.matches(&format!("{name}:")).count(), 4, "{name}");
        }
        assert!(!css.contains('<'), "it would end the element that holds it");
        assert_eq!(of(Theme::Page), None);
        for theme in [Theme::Light, Theme::Dark, Theme::Paper] {
            assert!(!of(theme).unwrap().contains("var("), "{theme:?}: pictures know no variables");
        }
    }

    /// The relative luminance of a colour and contrasts as the Web Content Accessibility Guidelines 2.2 define them.
    fn contrast(a: &str, b: &str) -> f64 {
        let luminance = |colour: &str| {
            let part = |at: usize| {
                let c = f64::from(u8::from_str_radix(&colour[at..at + 2], 16).unwrap()) / 255.0;
                if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
            };
            0.2126 * part(1) + 0.7152 * part(3) + 0.0722 * part(5)
        };
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    #[test]
    fn everything_can_be_seen_against_the_ground() {
        for palette in [LIGHT, DARK, PAPER] {
            for [text, ground] in palette.trust {
                assert!(contrast(text, ground) >= 4.5, "{text} on {ground}");
            }
            for text in [palette.ink, palette.muted, palette.limit] {
                assert!(contrast(text, palette.card) >= 4.5, "text {text} on {}", palette.card);
            }
            for (ink, colour) in INKS.iter().zip(palette.inks) {
                // The command lies wide and pale beneath the output on purpose.
                let least = if *ink == Ink::Command { 3.0 } else { 3.5 };
                assert!(contrast(colour, palette.card) >= least, "{ink:?} {colour} on {}", palette.card);
            }
        }
    }
}
