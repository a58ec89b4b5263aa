//! A figure as a picture.

use super::palette::Theme;
use super::svg::{self, Drawing};
use super::value::Figure;
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::fontdb::{Database, Source};
use resvg::usvg::{Options, Tree};
use std::sync::Arc;

/// The family that letters are drawn in. The program carries it, since a machine may have no font at all, and without
/// one letters are left out in silence.
const FAMILY: &str = "DejaVu Sans";

/// Dots of a picture for each pixel of the figure: for screens, and 300 dots an inch for paper.
const SCREEN: f32 = 2.0;
const PRINT: f32 = 300.0 / 96.0;

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum PngError {
    /// A page's figure has no colours of its own.
    #[error("the theme page has no colours of its own, which a picture needs")]
    NoColours,
    /// The figure could not be read back; a defect of the program.
    #[error("the figure cannot be read: {0}")]
    Unreadable(String),
}

/// Draws what [`Figure::drawn`] gave for the same drawing, with two dots for each pixel, for paper with 300 an inch.
///
/// # Errors
/// [`PngError`].
pub fn write(figure: &Figure, drawing: &Drawing) -> Result<Vec<u8>, PngError> {
    if drawing.theme == Theme::Page {
        return Err(PngError::NoColours);
    }
    let unreadable = |error: &dyn std::fmt::Display| PngError::Unreadable(error.to_string());
    let text = svg::write(figure, drawing);
    let tree = Tree::from_str(&text, &options()).map_err(|error| unreadable(&error))?;
    let scale = if drawing.theme == Theme::Paper { PRINT } else { SCREEN };
    let size = tree.size().to_int_size().scale_by(scale).ok_or_else(|| unreadable(&"it has no size"))?;
    let mut picture = Pixmap::new(size.width(), size.height()).ok_or_else(|| unreadable(&"it has no size"))?;
    resvg::render(&tree, Transform::from_scale(scale, scale), &mut picture.as_mut());
    picture.encode_png().map_err(|error| unreadable(&error))
}

fn options() -> Options<'static> {
    let mut fonts = Database::new();
    for face in [dejavu::sans::regular(), dejavu::sans::bold()] {
        fonts.load_font_source(Source::Binary(Arc::new(face)));
    }
    fonts.set_sans_serif_family(FAMILY);
    Options { fontdb: Arc::new(fonts), font_family: FAMILY.to_owned(), ..Options::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::of::signals::signals;
    use crate::figure::of::signals::tests::{origin, trial};

    fn drawing(theme: Theme) -> Drawing {
        Drawing { width: 720, theme, from: None, to: None }
    }

    fn picture(figure: &Figure, theme: Theme) -> Pixmap {
        let drawing = drawing(theme);
        Pixmap::decode_png(&write(&figure.drawn(&drawing).unwrap(), &drawing).unwrap()).unwrap()
    }

    /// Dots of a rectangle, in pixels of the figure, that differ from the ground.
    fn ink(picture: &Pixmap, scale: f32, [left, top, right, bottom]: [f32; 4]) -> usize {
        let ground = picture.pixel(1, 1).unwrap();
        let range = |from: f32, to: f32| (from * scale) as u32..(to * scale) as u32;
        let dots = range(top, bottom).flat_map(|y| range(left, right).map(move |x| (x, y)));
        dots.filter(|(x, y)| picture.pixel(*x, *y).unwrap() != ground).count()
    }

    /// Without a font letters are left out in silence: where the heading is there must be ink.
    #[test]
    fn letters_are_drawn() {
        let figure = signals(&trial(812, 0.1), &origin());
        for theme in [Theme::Light, Theme::Dark] {
            let with = picture(&figure, theme);
            assert_eq!(with.width(), 1440);
            let heading = [8.0, 4.0, 260.0, 22.0];
            assert!(ink(&with, SCREEN, heading) > 1_500, "{theme:?}: {} dots", ink(&with, SCREEN, heading));
        }
        // Every sort of letter that figures write has a shape of its own.
        for text in ["‖Gff G − 1‖", "∠Gff·G (°)", "10⁻⁴", "±", "×"] {
            let own = picture(&Figure { title: text.to_owned(), ..figure.clone() }, Theme::Light);
            let missing = picture(&Figure { title: "\u{e000}".to_owned(), ..figure.clone() }, Theme::Light);
            let row = [8.0, 4.0, 120.0, 22.0];
            assert!(ink(&own, SCREEN, row) > 20, "{text}");
            assert_ne!(own.data(), missing.data(), "{text}");
        }
    }

    #[test]
    fn lines_are_drawn_in_the_colours_of_the_theme() {
        let figure = signals(&trial(812, 0.1), &origin());
        for (theme, ground, line) in [
            (Theme::Light, [0xff, 0xff, 0xff], [0xc2, 0x41, 0x0c]),
            (Theme::Dark, [0x18, 0x20, 0x29], [0xff, 0x7a, 0x3d]),
            (Theme::Paper, [0xff, 0xff, 0xff], [0xc2, 0x41, 0x0c]),
        ] {
            let picture = picture(&figure, theme);
            let count = |colour: [u8; 3]| {
                picture.pixels().iter().filter(|dot| [dot.red(), dot.green(), dot.blue()] == colour).count()
            };
            assert!(count(ground) > picture.pixels().len() / 2, "{theme:?}");
            assert!(count(line) > 500, "{theme:?}: {} dots of the error's line", count(line));
        }
        assert_eq!(picture(&figure, Theme::Paper).width(), 2250);
        assert!(matches!(write(&figure, &drawing(Theme::Page)), Err(PngError::NoColours)));
    }
}
