//! Words and numbers in figures.

use std::fmt::Write as _;

/// A letter's share of the height of its font, more than that of any usual letter on average. Fonts differ between
/// machines, so that no width is measured: every text is given this room.
const LETTER: f64 = 0.62;

/// A minus sign, which a hyphen is not.
const MINUS: &str = "\u{2212}";

/// The room that a text needs at a height of letters in pixels, whatever the font.
#[must_use]
pub(super) fn room(text: &str, size: f64) -> f64 {
    LETTER * size * text.chars().count() as f64
}

/// A text in lines that fit a width in pixels.
#[must_use]
pub(super) fn wrapped(text: &str, size: f64, width: f64) -> Vec<String> {
    let most = ((width / (LETTER * size)) as usize).max(8);
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= most => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// A name with no more letters than `most`, the last of them an ellipsis where some are left out.
#[must_use]
pub(super) fn shortened(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most.saturating_sub(1)).chain(['…']).collect()
}

/// Text in an element or an attribute: no character of it is markup, and what XML cannot hold is replaced.
#[must_use]
pub(super) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\t' | '\n' | '\r' => out.push(' '),
            '\u{0}'..='\u{1f}' | '\u{fffe}' | '\u{ffff}' => out.push('\u{fffd}'),
            other => out.push(other),
        }
    }
    out
}

/// Digits as exponents.
fn exponent(power: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let mut out = String::new();
    for letter in power.to_string().chars() {
        out.push(letter.to_digit(10).map_or('⁻', |digit| DIGITS[digit as usize]));
    }
    out
}

/// A number with so many digits after the point, with a true minus sign and no minus before zero.
#[must_use]
pub(super) fn decimal(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|b| matches!(b, b'0' | b'.')) => rest.to_owned(),
        Some(rest) => format!("{MINUS}{rest}"),
        None => text,
    }
}

/// `value = mantissa · 10^power`, as it is written beside an axis.
#[must_use]
pub(super) fn power_of_ten(mantissa: i64, power: i32) -> String {
    match (mantissa, power) {
        (_, 0) => mantissa.to_string(),
        (1, 1) => "10".to_owned(),
        (1, _) => format!("10{}", exponent(power)),
        _ => format!("{mantissa}·10{}", exponent(power)),
    }
}

/// A number in a sentence: `significant` digits, more only before the point.
#[must_use]
pub fn number(value: f64, significant: usize) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".to_owned() } else { "not finite".to_owned() };
    }
    let significant = significant.max(1);
    // The power after rounding: 0.9996 in three digits is 1.00.
    let written = format!("{:.*e}", significant - 1, value.abs());
    let power: i32 = written.rsplit('e').next().and_then(|power| power.parse().ok()).unwrap_or(0);
    if (-4..6).contains(&power) {
        return decimal(value, usize::try_from(significant as i32 - 1 - power).unwrap_or(0));
    }
    let mantissa = written.split('e').next().unwrap_or_default();
    let mut out = String::new();
    let sign = if value < 0.0 { MINUS } else { "" };
    let _ = write!(out, "{sign}{mantissa}·10{}", exponent(power));
    out
}

/// A number in a sentence with three digits.
#[must_use]
pub fn three(value: f64) -> String {
    number(value, 3)
}

/// A name in a list of names: `a`, `a and b`, `a, b and c`.
#[must_use]
pub fn listed(names: &[String]) -> String {
    match names {
        [] => String::new(),
        [only] => only.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_digits_that_were_asked_for() {
        let cases = [
            (0.0, "0"),
            (1.0, "1.00"),
            (-1.5, "−1.50"),
            (0.9996, "1.00"),
            (0.059_04, "0.0590"),
            (1234.6, "1235"),
            (999_999.0, "1.00·10⁶"),
            (-3.2e-7, "−3.20·10⁻⁷"),
            (1e-4, "0.000100"),
            (f64::NAN, "not finite"),
        ];
        for (value, text) in cases {
            assert_eq!(three(value), text, "{value}");
        }
        assert_eq!(decimal(-0.04, 1), "0.0");
        assert_eq!(decimal(-0.06, 1), "−0.1");
    }

    #[test]
    fn text_stays_text() {
        let text = "<script>alert('&\"1')</script>\u{0}\u{b}";
        assert_eq!(escaped(text), "&lt;script&gt;alert('&amp;&quot;1')&lt;/script&gt;\u{fffd}\u{fffd}");
    }

    #[test]
    fn lines_break_between_words_only() {
        assert_eq!(wrapped("one two three", 10.0, 6.2 * 8.0), ["one two", "three"]);
        assert_eq!(wrapped("", 10.0, 100.0), [""; 0]);
        assert_eq!(wrapped("unbreakable", 10.0, 10.0), ["unbreakable"]);
        assert_eq!(shortened("‖Gff G − 1‖", 4), "‖Gf…");
        assert_eq!(shortened("‖Gff", 4), "‖Gff");
    }

    #[test]
    fn lists_read_as_sentences() {
        let names = ["a", "b", "c"].map(str::to_owned);
        assert_eq!([listed(&names), listed(&names[..2]), listed(&names[..1])], ["a, b and c", "a and b", "a"]);
    }
}
