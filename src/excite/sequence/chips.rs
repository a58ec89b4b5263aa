//! Pseudorandom sequences of maximum length: ternary (PRTS) and binary (PRBS).

use super::error::SequenceError;
use super::field::Base;
use super::sampled::{Period, Sequence, SequenceDetails, whole};
use crate::ctl::Ctl;
use crate::num::rng::stream;
use rand::RngExt;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a signal does between the chips.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ChipHold {
    /// It keeps the chip's value (zero-order hold).
    #[default]
    Zero,
    /// It goes straight from chip to chip (first-order hold).
    Linear,
    /// It is the integral of the held chips over time, from 0: chips are velocities, as in Peterka 2002. Ternary
    /// sequences only.
    Integrated,
}

/// Which primitive polynomial.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "PrimitivePolynomial")]
pub enum Polynomial {
    /// Its place, from 0, among all of its order, in lexicographic order of the coefficients c₀, c₁, ….
    #[schemars(title = "PolynomialIndex")]
    Index(u64),
    /// The coefficients c₀ … c_{n−1} of the recurrence `s[t+n] = Σ cᵢ s[t+i]` over GF(3) or GF(2).
    #[schemars(title = "PolynomialCoefficients")]
    Coefficients(Vec<u8>),
}

/// A PRTS or a PRBS as written in JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ShiftRegister {
    /// Length n of the shift register: 3ⁿ − 1 (2 to 12) or 2ⁿ − 1 chips (2 to 20).
    pub order: u32,
    /// Length of a chip in seconds.
    pub chip_s: f64,
    /// Chips are −amplitude, 0 and +amplitude (ternary), or ∓amplitude for the digits 0 and 1 (binary), in the unit of
    /// the signal. Default: 1.
    #[serde(default = "one")]
    pub amplitude: f64,
    /// The primitive polynomial, by index or by coefficients. Default: 0, or drawn where there is a seed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polynomial: Option<Polynomial>,
    /// Chips that are skipped of the sequence that starts from the state 0 … 0 1. Default: 0, or drawn where there is a
    /// seed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub phase_chips: Option<u64>,
    /// Draws polynomial and phase where they are not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Between the chips: `zero`, `linear` or `integrated`. Default: zero.
    #[serde(default)]
    pub hold: ChipHold,
}

fn one() -> f64 {
    1.0
}

impl ShiftRegister {
    pub(super) fn check(&self, base: Base, sample_time_s: f64) -> Result<(), SequenceError> {
        let most = base.largest_order();
        if !(2..=most).contains(&self.order) {
            return Err(SequenceError::Order { order: self.order, least: 2, most });
        }
        for (field, value) in [("generator/chip_s", self.chip_s), ("generator/amplitude", self.amplitude)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(SequenceError::NotPositive { field, value });
            }
        }
        if self.chip_s < sample_time_s * (1.0 - 1e-9) {
            return Err(SequenceError::ChipBelowSample { chip_s: self.chip_s, sample_time_s });
        }
        match &self.polynomial {
            None => {}
            Some(Polynomial::Index(index)) => {
                let count = base.primitive_count(self.order);
                if *index >= count {
                    let (index, order, base) = (*index, self.order, base.p());
                    return Err(SequenceError::NoSuchPolynomial { index, count, order, base });
                }
            }
            Some(Polynomial::Coefficients(coefficients)) => {
                if coefficients.len() != self.order as usize {
                    return Err(SequenceError::Coefficients { found: coefficients.len(), order: self.order });
                }
                if let Some(index) = coefficients.iter().position(|c| *c >= base.p()) {
                    let (value, most) = (coefficients[index], base.p() - 1);
                    return Err(SequenceError::Digit { index, value, most });
                }
                if !base.is_primitive(coefficients) {
                    return Err(SequenceError::NotPrimitive {
                        coefficients: coefficients.clone(),
                        base: base.p(),
                        length: base.length(self.order),
                    });
                }
            }
        }
        let length = base.length(self.order);
        if let Some(phase) = self.phase_chips.filter(|phase| *phase >= length) {
            return Err(SequenceError::Phase { phase, length });
        }
        if self.hold == ChipHold::Integrated && base == Base::Two {
            return Err(SequenceError::Integrated);
        }
        Ok(())
    }

    /// Length of one period in seconds.
    pub(super) fn period_s(&self, base: Base) -> f64 {
        base.length(self.order) as f64 * self.chip_s
    }

    fn chips(&self, base: Base, ctl: &Ctl) -> Result<(Vec<u8>, u64, Vec<f64>), SequenceError> {
        let mut random = stream(self.seed.unwrap_or(0), "excite/maximum_length");
        let coefficients = match (&self.polynomial, self.seed) {
            (Some(Polynomial::Coefficients(coefficients)), _) => coefficients.clone(),
            (None, Some(_)) => base.draw_primitive(self.order, &mut random, ctl)?,
            (polynomial, _) => {
                let index = if let Some(Polynomial::Index(index)) = polynomial { *index } else { 0 };
                base.primitive(self.order, index, ctl)?.ok_or(SequenceError::NoSuchPolynomial {
                    index,
                    count: base.primitive_count(self.order),
                    order: self.order,
                    base: base.p(),
                })?
            }
        };
        let length = base.length(self.order);
        let phase = match (self.phase_chips, self.seed) {
            (Some(phase), _) => phase,
            (None, Some(_)) => random.random_range(0..length),
            (None, None) => 0,
        };
        let digits = base.digits(&coefficients);
        let level = |digit: u8| match (base, digit) {
            (Base::Three, 0) => 0.0,
            (Base::Three, 2) | (Base::Two, 0) => -self.amplitude,
            _ => self.amplitude,
        };
        let (before, after) = digits.split_at(phase as usize);
        let chips = after.iter().chain(before).map(|digit| level(*digit)).collect();
        Ok((coefficients, phase, chips))
    }

    /// The first `samples` samples, period after period.
    pub(super) fn sample(
        &self,
        base: Base,
        sample_time_s: f64,
        samples: usize,
        ctl: &Ctl,
    ) -> Result<Sequence, SequenceError> {
        let (coefficients, phase, chips) = self.chips(base, ctl)?;
        let length = chips.len();
        let per_chip = whole(self.chip_s / sample_time_s);
        // Which chip a sample falls in, counted without end, and how far into it.
        let place = |k: usize| match per_chip {
            Some(r) => (k / r, (k % r) as f64 / r as f64),
            None => {
                let chips = k as f64 * (sample_time_s / self.chip_s);
                // A sample on a boundary up to rounding belongs to the later chip.
                let chip = (chips * (1.0 + 4.0 * f64::EPSILON)).floor();
                (chip as usize, (chips - chip).max(0.0))
            }
        };
        let values = match self.hold {
            ChipHold::Zero => (0..samples).map(|k| chips[place(k).0 % length]).collect(),
            ChipHold::Linear => (0..samples)
                .map(|k| {
                    let (chip, part) = place(k);
                    let (now, next) = (chips[chip % length], chips[(chip + 1) % length]);
                    now + (next - now) * part
                })
                .collect(),
            ChipHold::Integrated => {
                // Sums of whole multiples of the amplitude are exact, so the integral closes exactly.
                let mut sums = Vec::with_capacity(length);
                let mut sum = 0.0;
                for chip in &chips {
                    sums.push(sum);
                    sum += (chip / self.amplitude).round();
                }
                let scale = self.amplitude * self.chip_s;
                (0..samples)
                    .map(|k| {
                        let (chip, part) = place(k);
                        scale * sums[chip % length] + self.chip_s * chips[chip % length] * part
                    })
                    .collect()
            }
        };
        let seconds = self.period_s(base);
        let period = Period { seconds, samples: per_chip.map(|r| r * length) };
        // A ternary sequence's second half is its first with the sign changed, so even harmonics vanish; every hold has
        // its zeros at the multiples of 1/chip, where the sample time does not fold other lines.
        let nyquist = seconds / (2.0 * sample_time_s);
        let harmonics = per_chip.map(|_| {
            let step = if base == Base::Three { 2 } else { 1 };
            (1..)
                .step_by(step)
                .take_while(|n| (*n as f64) < nyquist * (1.0 - 1e-12))
                .filter(|n| n % length != 0)
                .collect()
        });
        let details = SequenceDetails {
            polynomial: Some(coefficients),
            phase_chips: Some(phase),
            chips: Some(length),
            ..SequenceDetails::default()
        };
        Ok(Sequence { sample_time_s, values, period: Some(period), harmonics, chip_s: Some(self.chip_s), details })
    }
}
