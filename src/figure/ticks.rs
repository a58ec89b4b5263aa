//! Where an axis has its ticks, and what is written there.

use super::text::{decimal, power_of_ten};
use super::value::Scale;

/// Numbers of this size and more, or smaller than the second, are written as powers of ten.
const LARGE: f64 = 1e5;
const SMALL: f64 = 1e-4;

/// A tick.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    /// Where it is, in the axis's unit.
    pub at: f64,
    /// What stands there; empty at a tick between labels.
    pub text: String,
}

/// The ticks within a range, about `count` of them, at 1, 2 or 5 times a power of ten.
#[must_use]
pub(super) fn ticks(scale: Scale, range: [f64; 2], count: usize) -> Vec<Tick> {
    match scale {
        Scale::Linear => linear(range, count),
        Scale::Logarithmic => logarithmic(range, count),
    }
}

/// A step of 1, 2 or 5 times a power of ten that divides a length into at most `count` parts: mantissa and power.
fn step(length: f64, count: usize) -> (i64, i32) {
    let rough = length / count.max(1) as f64;
    let mut power = rough.log10().floor() as i32;
    let base = 10f64.powi(power);
    // A step that is what it should be but for rounding is that step.
    let mantissa = [1, 2, 5].into_iter().find(|m| rough <= *m as f64 * base * (1.0 + 1e-9));
    let mantissa = mantissa.unwrap_or_else(|| {
        power += 1;
        1
    });
    (mantissa, power)
}

fn linear([from, to]: [f64; 2], count: usize) -> Vec<Tick> {
    let length = to - from;
    if !(length > 0.0 && length.is_finite()) {
        return Vec::new();
    }
    let (mantissa, power) = step(length, count);
    // Multiples of a power of ten are divided where the power is negative: 3/10, and not 3·0.1.
    let value = |k: i64| {
        let whole = (k * mantissa) as f64;
        if power < 0 { whole / 10f64.powi(-power) } else { whole * 10f64.powi(power) }
    };
    let size = mantissa as f64 * 10f64.powi(power);
    let slack = 1e-9 * length;
    let (first, last) = (((from - slack) / size).ceil(), ((to + slack) / size).floor());
    if !(first.abs() < 1e15 && last.abs() < 1e15) {
        return Vec::new();
    }
    let largest = from.abs().max(to.abs());
    let as_power = largest >= LARGE || size < SMALL;
    let text = |k: i64| {
        if !as_power || k == 0 {
            return decimal(value(k), usize::try_from(-power).unwrap_or(0));
        }
        let (mut mantissa, mut power) = (k * mantissa, power);
        while mantissa % 10 == 0 {
            (mantissa, power) = (mantissa / 10, power + 1);
        }
        let sign = if mantissa < 0 { "\u{2212}" } else { "" };
        format!("{sign}{}", power_of_ten(mantissa.abs(), power))
    };
    let found: Vec<Tick> = (first as i64..=last as i64)
        .map(|k| Tick { at: value(k), text: if k == 0 { "0".to_owned() } else { text(k) } })
        .collect();
    // One tick alone is no scale.
    if found.len() < 2 && count < 32 { linear([from, to], 2 * count.max(1)) } else { found }
}

/// 10 to an integer power, correctly rounded where that can be.
fn ten(power: i32) -> f64 {
    if power < 0 { 1.0 / 10f64.powi(-power) } else { 10f64.powi(power) }
}

fn logarithmic([from, to]: [f64; 2], count: usize) -> Vec<Tick> {
    if !(from > 0.0 && from < to && to.is_finite()) {
        return Vec::new();
    }
    let (low, high) = (from * (1.0 - 1e-9), to * (1.0 + 1e-9));
    let powers = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let within = |mantissas: &[i64]| -> Vec<(i64, i32, f64)> {
        let all = powers.clone().flat_map(|power| mantissas.iter().map(move |m| (*m, power)));
        // 2/10 is 0.2, and 2·0.1 need not be.
        let value = |m: i64, p: i32| if p < 0 { m as f64 / ten(-p) } else { m as f64 * ten(p) };
        all.map(|(m, p)| (m, p, value(m, p))).filter(|(_, _, at)| (low..=high).contains(at)).collect()
    };
    // One way of writing for the whole axis.
    let as_power = high >= LARGE || low < SMALL * (1.0 - 1e-8);
    let text = |mantissa: i64, power: i32, at: f64| {
        if as_power { power_of_ten(mantissa, power) } else { decimal(at, usize::try_from(-power).unwrap_or(0)) }
    };
    let fine = within(&[1, 2, 5]);
    if fine.len() < 2 {
        // Less than a step of 1-2-5: the axis is as good as linear.
        return linear([from, to], count.min(4));
    }
    if fine.len() <= count + 1 {
        return fine.into_iter().map(|(m, p, at)| Tick { at, text: text(m, p, at) }).collect();
    }
    // Powers of ten, every one or every k-th of them with its label.
    let coarse = within(&[1]);
    if coarse.len() < 2 {
        let kept = fine.iter().filter(|(m, ..)| *m != 2).copied();
        return kept.map(|(m, p, at)| Tick { at, text: text(m, p, at) }).collect();
    }
    let each = coarse.len().div_ceil(count.max(1)) as i32;
    let label = |p: i32, at: f64| if p.rem_euclid(each) == 0 { text(1, p, at) } else { String::new() };
    coarse.into_iter().map(|(_, p, at)| Tick { at, text: label(p, at) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ticks: &[Tick]) -> Vec<f64> {
        ticks.iter().map(|tick| tick.at).collect()
    }

    fn texts(ticks: &[Tick]) -> Vec<&str> {
        ticks.iter().map(|tick| tick.text.as_str()).collect()
    }

    #[test]
    fn linear_ticks_are_at_one_two_five() {
        let found = linear([0.0, 60.0], 7);
        assert_eq!(at(&found), [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]);
        assert_eq!(texts(&found), ["0", "10", "20", "30", "40", "50", "60"]);
        let found = linear([-0.25, 0.31], 6);
        assert_eq!(at(&found), [-0.2, -0.1, 0.0, 0.1, 0.2, 0.3]);
        assert_eq!(texts(&found), ["−0.2", "−0.1", "0", "0.1", "0.2", "0.3"]);
        assert_eq!(
            texts(&linear([0.0, 1.7], 4)),
            ["0.0", "0.5", "1.0", "1.5"].map(|t| if t == "0.0" { "0" } else { t })
        );
        assert_eq!(texts(&linear([0.0, 5.0e6], 3)), ["0", "2·10⁶", "4·10⁶"]);
        assert_eq!(texts(&linear([-2.0e-6, 0.0], 2)), ["−2·10⁻⁶", "−10⁻⁶", "0"]);
        assert_eq!(linear([1.0, 1.0], 4), []);
        assert_eq!(linear([f64::NAN, 1.0], 4), []);
    }

    #[test]
    fn logarithmic_ticks_are_at_one_two_five_and_then_at_powers() {
        assert_eq!(texts(&logarithmic([0.005, 0.5], 7)), ["0.005", "0.01", "0.02", "0.05", "0.1", "0.2", "0.5"]);
        assert_eq!(at(&logarithmic([0.005, 0.5], 7)), [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5]);
        assert_eq!(texts(&logarithmic([1e-6, 10.0], 8)), ["10⁻⁶", "10⁻⁵", "10⁻⁴", "10⁻³", "10⁻²", "10⁻¹", "1", "10"]);
        assert_eq!(texts(&logarithmic([1e-6, 10.0], 4)), ["10⁻⁶", "", "10⁻⁴", "", "10⁻²", "", "1", ""]);
        assert_eq!(texts(&logarithmic([0.3, 0.45], 5)), ["0.30", "0.35", "0.40", "0.45"]);
        assert_eq!(logarithmic([0.0, 1.0], 5), []);
    }

    /// Whatever the range: at least two and not far more than asked for, increasing, within it, and each text reads as
    /// its place.
    #[test]
    fn any_range_has_ticks_that_say_where_they_are() {
        use crate::num::rng::stream;
        use rand::RngExt;
        let mut random = stream(20_261_130, "ticks");
        for case in 0..2000 {
            let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
            let size = 10f64.powf(uniform(-8.0, 8.0));
            let from = uniform(-1.0, 1.0) * size;
            let to = from + size * 10f64.powf(uniform(-3.0, 1.0));
            let count = uniform(3.0, 10.0) as usize;
            let found = linear([from, to], count);
            assert!((2..=2 * count + 1).contains(&found.len()), "case {case}: {from} {to} {count} {found:?}");
            for pair in found.windows(2) {
                assert!(pair[0].at < pair[1].at, "case {case}: {found:?}");
                assert_ne!(pair[0].text, pair[1].text, "case {case}: {found:?}");
            }
            let slack = 1e-8 * (to - from);
            for tick in &found {
                assert!(tick.at >= from - slack && tick.at <= to + slack, "case {case}: {tick:?} {from} {to}");
                assert!((read(&tick.text) - tick.at).abs() <= 1e-9 * size.max(tick.at.abs()), "case {case}: {tick:?}");
            }
        }
    }

    /// What a label says.
    fn read(text: &str) -> f64 {
        let text = text.replace('−', "-");
        let digit = |c: char| match c {
            '⁻' => '-',
            '⁰' => '0',
            '¹' => '1',
            '²' => '2',
            '³' => '3',
            c => char::from_digit(c as u32 - '⁴' as u32 + 4, 10).unwrap(),
        };
        let Some(at) = text.find(|c: char| "⁻⁰¹²³⁴⁵⁶⁷⁸⁹".contains(c)) else {
            return text.parse().unwrap();
        };
        let power: i32 = text[at..].chars().map(digit).collect::<String>().parse().unwrap();
        let mantissa = text[..at].strip_suffix("10").unwrap();
        let mantissa = match mantissa {
            "" => 1.0,
            "-" => -1.0,
            other => other.strip_suffix('·').unwrap().parse().unwrap(),
        };
        mantissa * 10f64.powi(power)
    }
}
