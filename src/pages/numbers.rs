//! Numbers, times and lengths of time as pages write them.

use crate::figure::text::{number, three};
use crate::num::hexadecimal::hexadecimal;
use sha2::{Digest as _, Sha256};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Digits of a half-width that its value is written with.
const DIGITS: i32 = 2;

/// The beginning of the SHA-256 of a text, enough to tell versions apart.
pub(super) fn short_hash(text: &str) -> String {
    hexadecimal(&Sha256::digest(text))[..12].to_owned()
}

/// The beginning of a hash, which names it to a reader.
pub(super) fn eight(hash: &str) -> &str {
    hash.get(..8).unwrap_or(hash)
}

/// A value with as many digits as its 95 % interval carries: two of the half-width.
pub(super) fn within(value: f64, [low, high]: [f64; 2]) -> String {
    let half = 0.5 * (high - low).abs();
    if !(half.is_finite() && half > 0.0) {
        return three(value);
    }
    let decimals = DIGITS - 1 - half.log10().floor() as i32;
    // Far from 1 the digits stand before a power of ten instead.
    if !(0..=6).contains(&decimals) {
        return three(value);
    }
    let text = format!("{value:.*}", usize::try_from(decimals).unwrap_or(0));
    text.replace('-', "\u{2212}")
}

/// A value, and its interval in brackets where it has one.
pub(super) fn with_interval(value: f64, interval: Option<[f64; 2]>) -> String {
    match interval {
        None => three(value),
        Some(ends) => {
            format!("{} [{}, {}]", within(value, ends), within(ends[0], ends), within(ends[1], ends))
        }
    }
}

/// A change as a share of where it began, with its sign.
pub(super) fn share(change: f64, from: f64) -> Option<String> {
    let share = 100.0 * change / from.abs();
    let sign = if share > 0.0 { "+" } else { "" };
    share.is_finite().then(|| format!("{sign}{} %", number(share, 2)))
}

/// A p-value.
pub(super) fn p_value(p: f64) -> String {
    if p < 0.001 { "p < 0.001".to_owned() } else { format!("p = {}", number(p, 2)) }
}

/// A length of time.
pub(super) fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 0.95 => format!("{:.1} s", s.max(0.0)),
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.0} days", s / 86_400.0),
    }
}

/// How long ago something was.
pub(super) fn ago(then: OffsetDateTime) -> String {
    let seconds = (OffsetDateTime::now_utc() - then).as_seconds_f64();
    if seconds < 10.0 { "just now".to_owned() } else { format!("{} ago", duration(seconds)) }
}

/// A moment for machines.
pub(super) fn moment(then: OffsetDateTime) -> String {
    then.format(&Rfc3339).unwrap_or_default()
}

/// So many of something, by their name for one and for several.
pub(super) fn count(n: u64, one: &str, several: &str) -> String {
    if n == 1 { format!("1 {one}") } else { format!("{n} {several}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_digits_of_their_interval() {
        assert_eq!(with_interval(0.683_21, Some([0.659_7, 0.710_3])), "0.683 [0.660, 0.710]");
        assert_eq!(with_interval(12.345, Some([2.0, 22.7])), "12 [2, 23]");
        assert_eq!(with_interval(-0.5, Some([-0.9, -0.1])), "−0.50 [−0.90, −0.10]");
        assert_eq!(with_interval(0.683_21, None), "0.683");
        assert_eq!(with_interval(0.5, Some([0.5, 0.5])), "0.500 [0.500, 0.500]");
    }

    #[test]
    fn changes_and_times_read_as_sentences() {
        assert_eq!(share(-0.51, 0.61).as_deref(), Some("−84 %"));
        assert_eq!(share(0.5, 1.0).as_deref(), Some("+50 %"));
        assert_eq!(share(1.0, 0.0), None);
        assert_eq!(
            [0.2, 59.6, 300.0, 7200.0, 400_000.0].map(duration),
            ["0.2 s", "60 s", "5 min", "2.0 h", "5 days"].map(str::to_owned)
        );
        assert_eq!([p_value(0.0004), p_value(0.0123)], ["p < 0.001", "p = 0.012"]);
        assert_eq!([count(1, "trial", "trials"), count(0, "trial", "trials")], ["1 trial", "0 trials"]);
    }
}
