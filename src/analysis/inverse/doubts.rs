//! Other readings of the numbers that would change the verdict.

use super::half::Half;
use super::problems;
use super::spec::Form;
use crate::analysis::contract::Failure;
use crate::control::lyapunov::Clock;
use crate::ctl::Ctl;
use crate::inverse::lqr::decision;
use crate::inverse::{Gains, InverseLqr, Knowledge, Role, Verdict};
use nalgebra::DMatrix;

/// Entries with so many significant digits are taken for rounded; those with fewer are as often exact, those with more
/// are doubles.
const ROUNDED: std::ops::RangeInclusive<usize> = 4..=15;

/// Half a unit of the last digit that a number is written with, where that is among those of [`ROUNDED`].
fn half_a_digit(value: f64) -> Option<f64> {
    let text = format!("{value:e}");
    let (mantissa, exponent) = text.split_once('e')?;
    let digits = mantissa.bytes().filter(u8::is_ascii_digit).count();
    let exponent: i32 = exponent.parse().ok()?;
    ROUNDED.contains(&digits).then(|| 0.5 * 10f64.powi(exponent + 1 - digits as i32))
}

fn asked(half: &Half, gain: &DMatrix<f64>, knowledge: &Knowledge, ctl: &Ctl) -> Result<Option<Verdict>, Failure> {
    let [a, b, _] = &half.written;
    let clock = half.gains.clock();
    let gains = match half.gains.role() {
        Role::Regulator => Gains::regulator_with(a, b, gain, clock, knowledge),
        Role::Filter => Gains::filter_with(a, b, gain, clock, knowledge),
    };
    let Ok(gains) = gains else { return Ok(None) };
    Ok(Some(decision(&gains, ctl).map_err(|error| problems::inverse(&error))?.verdict))
}

/// Whether the verdict is one only as the gain is written, and the boundary within half a unit of its last digit.
pub(super) fn within_digits(half: &Half, answer: &InverseLqr, ctl: &Ctl) -> Result<bool, Failure> {
    let known = half.knowledge.gain_rounding.is_some() || answer.decision.verdict == Verdict::Boundary;
    let [_, _, gain] = &half.written;
    if known || half.form == Form::Filter || !gain.iter().any(|v| half_a_digit(*v).is_some()) {
        return Ok(false);
    }
    let rounding = gain.map(|v| half_a_digit(v).unwrap_or(0.0));
    let knowledge = Knowledge { gain_rounding: Some(rounding), ..half.knowledge.clone() };
    Ok(asked(half, gain, &knowledge, ctl)? == Some(Verdict::Boundary))
}

/// Whether L is infeasible as the gain of a predictor, and AL is not.
pub(super) fn would_pass_as_filter(half: &Half, answer: &InverseLqr, ctl: &Ctl) -> Result<bool, Failure> {
    let is_candidate = half.gains.role() == Role::Filter
        && half.gains.clock() == Clock::Sampled
        && half.form == Form::Predictor
        && answer.decision.verdict == Verdict::Infeasible;
    if !is_candidate {
        return Ok(false);
    }
    let [a, _, l] = &half.written;
    let found = asked(half, &(a * l), &half.knowledge, ctl)?;
    Ok(found.is_some_and(|verdict| verdict != Verdict::Infeasible))
}

#[cfg(test)]
mod tests {
    use super::half_a_digit;

    #[test]
    fn digits_are_counted_as_they_are_written() {
        assert_eq!(half_a_digit(3.0), None);
        assert_eq!(half_a_digit(0.5), None);
        assert_eq!(half_a_digit(std::f64::consts::PI), None);
        assert!((half_a_digit(1234.0).unwrap() - 0.5).abs() < 1e-15);
        assert!((half_a_digit(-0.01234).unwrap() - 0.000_005).abs() < 1e-18);
    }
}
