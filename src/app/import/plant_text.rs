//! Plants as people write them in a table: `1/s`, `1/(s(s+1))`, `2(s+2.2)/(s^2+3.6s+4)`.
//!
//! Only what can be read in one way is read: `1/s(s+1)` is refused, since some mean `(s+1)/s` and some `1/(s(s+1))`.

use crate::control::Model;
use crate::control::model::TransferFunctionModel;
use crate::num::Polynomial;

/// No transfer function in a table is longer.
const MAX_LENGTH: usize = 300;
const MAX_POWER: u32 = 20;

/// Why a text is no transfer function.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PlantTextError {
    /// Longer than any transfer function in a table.
    #[error("the text is longer than {MAX_LENGTH} characters")]
    TooLong,
    /// Something else than was expected.
    #[error("expected {expected} at character {position}")]
    Expected {
        /// What could stand there.
        expected: &'static str,
        /// Position from 1.
        position: usize,
    },
    /// A factor follows a divisor.
    #[error("what is divided by at character {position}? put the divisor in parentheses")]
    Ambiguous {
        /// Position of the second factor, from 1.
        position: usize,
    },
    /// Division by a zero polynomial.
    #[error("a divisor is zero")]
    ZeroDivisor,
    /// A coefficient beyond the range of doubles.
    #[error("a coefficient is larger than a double can be")]
    TooLarge,
    /// A power that is too high.
    #[error("powers go up to {MAX_POWER}")]
    PowerTooHigh,
}

/// A quotient of polynomials.
#[derive(Clone)]
struct Rational {
    num: Polynomial,
    den: Polynomial,
}

impl Rational {
    fn of(num: Vec<f64>) -> Self {
        Self { num: Polynomial::new(num), den: Polynomial::new(vec![1.0]) }
    }

    fn plus(&self, other: &Self) -> Self {
        if self.den == other.den {
            return Self { num: self.num.add(&other.num), den: self.den.clone() };
        }
        Self { num: self.num.mul(&other.den).add(&other.num.mul(&self.den)), den: self.den.mul(&other.den) }
    }

    fn times(&self, other: &Self) -> Self {
        Self { num: self.num.mul(&other.num), den: self.den.mul(&other.den) }
    }

    fn negated(&self) -> Self {
        Self { num: self.num.scale(-1.0), den: self.den.clone() }
    }

    fn inverted(&self) -> Result<Self, PlantTextError> {
        if self.num.is_zero() {
            return Err(PlantTextError::ZeroDivisor);
        }
        Ok(Self { num: self.den.clone(), den: self.num.clone() })
    }
}

/// Reads a continuous-time transfer function in `s`.
///
/// # Errors
/// [`PlantTextError`], with the position of what cannot be read.
pub fn parse(text: &str) -> Result<Model, PlantTextError> {
    if text.len() > MAX_LENGTH {
        return Err(PlantTextError::TooLong);
    }
    let mut reader = Reader { characters: text.chars().collect(), at: 0 };
    let value = reader.sum()?;
    reader.skip_space();
    if reader.at < reader.characters.len() {
        return Err(reader.expected("an operator or the end"));
    }
    if [&value.num, &value.den].iter().any(|part| part.coefficients().iter().any(|c| !c.is_finite())) {
        return Err(PlantTextError::TooLarge);
    }
    Ok(Model::TransferFunction(TransferFunctionModel {
        num: value.num.coefficients().to_vec(),
        den: value.den.coefficients().to_vec(),
        sample_time_s: None,
        delay_s: None,
    }))
}

struct Reader {
    characters: Vec<char>,
    at: usize,
}

impl Reader {
    fn skip_space(&mut self) {
        while self.characters.get(self.at).is_some_and(|c| c.is_whitespace()) {
            self.at += 1;
        }
    }

    fn peek(&mut self) -> Option<char> {
        self.skip_space();
        self.characters.get(self.at).copied()
    }

    fn take(&mut self, wanted: char) -> bool {
        let found = self.peek() == Some(wanted);
        self.at += usize::from(found);
        found
    }

    fn expected(&self, expected: &'static str) -> PlantTextError {
        PlantTextError::Expected { expected, position: self.at + 1 }
    }

    fn sum(&mut self) -> Result<Rational, PlantTextError> {
        let negative = self.take('-');
        let first = self.product()?;
        let mut total = if negative { first.negated() } else { first };
        loop {
            if self.take('+') {
                total = total.plus(&self.product()?);
            } else if self.take('-') {
                total = total.plus(&self.product()?.negated());
            } else {
                return Ok(total);
            }
        }
    }

    /// Factors, with or without `*` between them, over at most one factor.
    fn product(&mut self) -> Result<Rational, PlantTextError> {
        let mut product = self.power()?;
        loop {
            match self.peek() {
                Some('/') => {
                    self.at += 1;
                    let quotient = product.times(&self.power()?.inverted()?);
                    return match self.peek() {
                        None | Some('+' | '-' | ')') => Ok(quotient),
                        _ => Err(PlantTextError::Ambiguous { position: self.at + 1 }),
                    };
                }
                Some('*') => {
                    self.at += 1;
                    product = product.times(&self.power()?);
                }
                Some(c) if c == '(' || c == 's' || c.is_ascii_digit() => product = product.times(&self.power()?),
                _ => return Ok(product),
            }
        }
    }

    fn power(&mut self) -> Result<Rational, PlantTextError> {
        let base = self.factor()?;
        if !self.take('^') {
            return Ok(base);
        }
        self.skip_space();
        let start = self.at;
        while self.characters.get(self.at).is_some_and(char::is_ascii_digit) {
            self.at += 1;
        }
        let digits: String = self.characters[start..self.at].iter().collect();
        if digits.is_empty() {
            return Err(self.expected("a whole power"));
        }
        let power = digits.parse().ok().filter(|p| *p <= MAX_POWER).ok_or(PlantTextError::PowerTooHigh)?;
        Ok((0..power).fold(Rational::of(vec![1.0]), |product, _| product.times(&base)))
    }

    fn factor(&mut self) -> Result<Rational, PlantTextError> {
        match self.peek() {
            Some('(') => {
                self.at += 1;
                let inner = self.sum()?;
                if self.take(')') { Ok(inner) } else { Err(self.expected("a closing parenthesis")) }
            }
            Some('s') => {
                self.at += 1;
                Ok(Rational::of(vec![1.0, 0.0]))
            }
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            _ => Err(self.expected("a number, s or an opening parenthesis")),
        }
    }

    fn number(&mut self) -> Result<Rational, PlantTextError> {
        let start = self.at;
        while let Some(c) = self.characters.get(self.at) {
            let sign = matches!(c, '+' | '-') && matches!(self.characters[self.at - 1], 'e' | 'E') && self.at > start;
            if !(c.is_ascii_digit() || matches!(c, '.' | 'e' | 'E') || sign) {
                break;
            }
            self.at += 1;
        }
        let digits: String = self.characters[start..self.at].iter().collect();
        match digits.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Rational::of(vec![value])),
            _ => {
                self.at = start;
                Err(self.expected("a finite number"))
            }
        }
    }
}

/// A transfer function as text that [`parse`] reads back: the same coefficients but for common factors.
#[must_use]
pub fn write(model: &TransferFunctionModel) -> String {
    let variable = if model.sample_time_s.is_some() { "z" } else { "s" };
    let text = format!("({})/({})", polynomial(&model.num, variable), polynomial(&model.den, variable));
    match model.sample_time_s {
        Some(period) => format!("{text}, {period} s"),
        None => text,
    }
}

fn polynomial(descending: &[f64], variable: &str) -> String {
    let mut text = String::new();
    for (i, c) in descending.iter().enumerate().filter(|(_, c)| **c != 0.0) {
        let power = descending.len() - 1 - i;
        text.push_str(match (text.is_empty(), *c < 0.0) {
            (true, true) => "-",
            (true, false) => "",
            (false, true) => " - ",
            (false, false) => " + ",
        });
        if power == 0 || c.abs() != 1.0 {
            text.push_str(&c.abs().to_string());
        }
        match power {
            0 => {}
            1 => text.push_str(variable),
            _ => text.push_str(&format!("{variable}^{power}")),
        }
    }
    if text.is_empty() { "0".to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn coefficients(text: &str) -> (Vec<f64>, Vec<f64>) {
        match parse(text).unwrap() {
            Model::TransferFunction(m) => (m.num, m.den),
            Model::StateSpace(_) => unreachable!(),
        }
    }

    #[test]
    fn the_ways_people_write_plants() {
        for (text, num, den) in [
            ("1/s", vec![1.0], vec![1.0, 0.0]),
            ("1/(s(s+1))", vec![1.0], vec![1.0, 1.0, 0.0]),
            ("-2(s-2.2)/(s^2+3.6s+4)", vec![-2.0, 4.4], vec![1.0, 3.6, 4.0]),
            ("5.0e-1 * s / (s + 1)^2", vec![0.5, 0.0], vec![1.0, 2.0, 1.0]),
            ("1/s^2", vec![1.0], vec![1.0, 0.0, 0.0]),
            ("1/s + 2/(s+1)", vec![3.0, 1.0], vec![1.0, 1.0, 0.0]),
            ("3", vec![3.0], vec![1.0]),
        ] {
            assert_eq!(coefficients(text), (num, den), "{text}");
        }
    }

    #[test]
    fn what_can_be_read_in_two_ways_is_refused() {
        for text in ["1/s(s+1)", "1/s*2", "1/2s", "1/s/s"] {
            assert!(matches!(parse(text), Err(PlantTextError::Ambiguous { .. })), "{text}: {:?}", parse(text));
        }
        assert_eq!(parse("1/(s-s)"), Err(PlantTextError::ZeroDivisor));
        assert_eq!(parse("s^99"), Err(PlantTextError::PowerTooHigh));
        // Found by the fuzzer: this was read as a plant of infinite gain.
        for text in ["1e300^2", "1/(s+1e200)^2", &format!("{}^9", "2".repeat(100))] {
            assert_eq!(parse(text), Err(PlantTextError::TooLarge), "{text}");
        }
        assert_eq!(parse(&"(".repeat(400)), Err(PlantTextError::TooLong));
        for (text, position) in
            [("", 1), ("1/(s", 5), ("K/s", 1), ("1/x", 3), ("1/s)", 4), ("e3", 1), ("1e999", 1), ("s^", 3)]
        {
            match parse(text) {
                Err(PlantTextError::Expected { position: found, .. }) => assert_eq!(found, position, "{text}"),
                other => panic!("{text}: {other:?}"),
            }
        }
    }

    #[test]
    fn written_plants_are_read_back() {
        let model = TransferFunctionModel {
            num: vec![-2.0, 0.0, 4.4],
            den: vec![1.0, -1.0, 0.25, 0.0],
            sample_time_s: None,
            delay_s: None,
        };
        let text = write(&model);
        assert_eq!(text, "(-2s^2 + 4.4)/(s^3 - s^2 + 0.25s)");
        assert_eq!(parse(&text), Ok(Model::TransferFunction(model)));
    }
}
