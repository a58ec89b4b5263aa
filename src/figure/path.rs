//! Path data in few bytes: relative, in tenths of a pixel.
//!
//! Places are rounded once and differences are taken of what was rounded, so that errors do not add up along a line.

use std::fmt::Write as _;

/// A place in tenths of a pixel.
pub(super) type Tenths = i64;

/// Pixels in tenths.
pub(super) fn tenths(pixels: f64) -> Tenths {
    (10.0 * pixels).round() as Tenths
}

/// Tenths as a number of pixels, as short as it can be written.
pub(super) fn short(tenths: Tenths) -> String {
    let (sign, size) = (if tenths < 0 { "-" } else { "" }, tenths.abs());
    match (size / 10, size % 10) {
        (whole, 0) => format!("{sign}{whole}"),
        (0, part) => format!("{sign}.{part}"),
        (whole, part) => format!("{sign}{whole}.{part}"),
    }
}

/// A path under way.
#[derive(Debug, Default)]
pub(super) struct Path {
    data: String,
    at: [Tenths; 2],
    /// The command that further numbers would repeat.
    command: char,
    /// Whether the number written last has a point.
    pointed: bool,
}

impl Path {
    fn command(&mut self, command: char) {
        if self.command != command {
            self.data.push(command);
            self.command = command;
            // Nothing needs to be kept apart from a letter.
            self.pointed = false;
        }
    }

    /// A number; the grammar needs no space before a sign, nor before a point where the number before has one.
    fn number(&mut self, tenths: Tenths) {
        let text = short(tenths);
        let ends_in_digit = self.data.ends_with(|c: char| c.is_ascii_digit());
        if ends_in_digit && !(text.starts_with('-') || (text.starts_with('.') && self.pointed)) {
            self.data.push(' ');
        }
        self.pointed = text.contains('.');
        self.data.push_str(&text);
    }

    /// Goes to a place without drawing.
    pub(super) fn go(&mut self, to: [Tenths; 2]) {
        let _ = write!(self.data, "M{} {}", short(to[0]), short(to[1]));
        (self.at, self.command) = (to, 'M');
    }

    /// Draws a straight line to a place.
    pub(super) fn draw(&mut self, to: [Tenths; 2]) {
        let [dx, dy] = [to[0] - self.at[0], to[1] - self.at[1]];
        match (dx, dy) {
            (0, 0) => return,
            (0, _) => {
                self.command('v');
                self.number(dy);
            }
            (_, 0) => {
                self.command('h');
                self.number(dx);
            }
            _ => {
                self.command('l');
                self.number(dx);
                self.number(dy);
            }
        }
        self.at = to;
    }

    /// A dot, for lines with round ends.
    pub(super) fn dot(&mut self, at: [Tenths; 2]) {
        self.go(at);
        self.data.push_str("h.01");
        self.command = ' ';
    }

    /// Goes back to where the last line began.
    pub(super) fn close(&mut self) {
        self.data.push('z');
        self.command = 'z';
    }

    /// The data.
    pub(super) fn finish(self) -> String {
        self.data
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// The places that a path goes through, by the grammar of SVG 2 as far as it is used here: `None` lifts the pen.
    pub(in crate::figure) fn read(data: &str) -> Vec<Option<[f64; 2]>> {
        let mut places = Vec::new();
        let mut at = [0.0, 0.0];
        let mut rest = data;
        let mut command = ' ';
        while !rest.is_empty() {
            let first = rest.chars().next().unwrap();
            if first.is_ascii_alphabetic() {
                command = first;
                rest = &rest[1..];
                if command == 'M' {
                    places.push(None);
                }
                continue;
            }
            let mut number = || {
                rest = rest.trim_start_matches([' ', ',']);
                let mut end = usize::from(rest.starts_with('-'));
                let mut pointed = false;
                for c in rest[end..].chars() {
                    if !(c.is_ascii_digit() || (c == '.' && !pointed)) {
                        break;
                    }
                    pointed |= c == '.';
                    end += 1;
                }
                let value: f64 = rest[..end].parse().unwrap_or_else(|_| panic!("{rest:.20}"));
                rest = &rest[end..];
                value
            };
            match command {
                'M' => at = [number(), number()],
                'l' => at = [at[0] + number(), at[1] + number()],
                'h' => at[0] += number(),
                'v' => at[1] += number(),
                other => panic!("{other} in {data:.40}"),
            }
            places.push(Some(at));
        }
        places
    }

    #[test]
    fn paths_are_short_and_read_back() {
        let mut path = Path::default();
        path.go([0, 100]);
        for to in [[10, 97], [10, 86], [10, 105], [10, 97], [20, 97], [30, 97], [35, 102], [40, 105], [40, 105]] {
            path.draw(to);
        }
        path.go([600, 5]);
        path.draw([603, 11]);
        let data = path.finish();
        assert_eq!(data, "M0 10l1-.3v-1.1 1.9-.8h1 1l.5.5.5.3M60 .5l.3.6");
        let at = |x: f64, y: f64| Some([x, y]);
        let close = |a: &Option<[f64; 2]>, b: &Option<[f64; 2]>| match (a, b) {
            (Some(a), Some(b)) => (a[0] - b[0]).abs() < 1e-9 && (a[1] - b[1]).abs() < 1e-9,
            (None, None) => true,
            _ => false,
        };
        let expected = [
            None,
            at(0.0, 10.0),
            at(1.0, 9.7),
            at(1.0, 8.6),
            at(1.0, 10.5),
            at(1.0, 9.7),
            at(2.0, 9.7),
            at(3.0, 9.7),
            at(3.5, 10.2),
            at(4.0, 10.5),
            None,
            at(60.0, 0.5),
            at(60.3, 1.1),
        ];
        let found = read(&data);
        assert!(found.len() == expected.len() && found.iter().zip(&expected).all(|(a, b)| close(a, b)), "{found:?}");
        assert_eq!([short(-5), short(0), short(-120), short(123)], ["-.5", "0", "-12", "12.3"]);
    }

    #[test]
    fn any_path_reads_back() {
        use crate::num::rng::stream;
        use rand::RngExt;
        let mut random = stream(20_261_130, "paths");
        for case in 0..500 {
            let mut path = Path::default();
            let mut places: Vec<Option<[Tenths; 2]>> = Vec::new();
            let mut at = [0, 0];
            for step in 0..40 {
                let mut one = |scale: f64| ((random.random::<f64>() - 0.5) * scale) as Tenths;
                let to = [at[0] + one(30.0), at[1] + one(3000.0)];
                if step == 0 || to[0] % 7 == 0 {
                    path.go(to);
                    places.extend([None, Some(to)]);
                } else if to != at {
                    path.draw(to);
                    places.push(Some(to));
                }
                at = to;
            }
            let rounded: Vec<_> = read(&path.finish()).into_iter().map(|p| p.map(|p| p.map(tenths))).collect();
            assert_eq!(rounded, places, "case {case}");
        }
    }
}
