//! Formulas in named variables, as text: numbers, names, `+ − * / ^` with whole exponents, parentheses, `sin`, `cos`
//! and `pi`.

use super::dual::Real;

/// Nested parentheses and signs at most.
const MAX_DEPTH: usize = 60;
/// Characters at most.
const MAX_LENGTH: usize = 2_000;

/// A formula, ready to be evaluated.
#[derive(Debug, Clone, PartialEq)]
pub enum Expression {
    /// A number.
    Number(f64),
    /// A variable, by its place.
    Variable(usize),
    /// The negative.
    Negative(Box<Self>),
    /// A sum (`+`), difference (`-`), product (`*`) or quotient (`/`).
    Binary(char, Box<Self>, Box<Self>),
    /// A whole power.
    Power(Box<Self>, u32),
    /// The sine, of radians.
    Sine(Box<Self>),
    /// The cosine, of radians.
    Cosine(Box<Self>),
}

/// Text that is no formula.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what} at character {at} of \"{text}\"")]
pub struct ExpressionError {
    /// What is wrong.
    pub what: String,
    /// Where, from 1.
    pub at: usize,
    /// The text.
    pub text: String,
}

impl Expression {
    /// Reads a formula in the variables `names`.
    ///
    /// # Errors
    /// [`ExpressionError`] with the place of what is not understood, names that do not exist included.
    pub fn parse(text: &str, names: &[String]) -> Result<Self, ExpressionError> {
        let mut parser = Parser { characters: text.chars().collect(), at: 0, names, text };
        if parser.characters.len() > MAX_LENGTH {
            return Err(parser.error(format!("there are more than {MAX_LENGTH} characters")));
        }
        let expression = parser.sum(0)?;
        match parser.peek() {
            None => Ok(expression),
            Some(c) => Err(parser.error(format!("'{c}' is not expected"))),
        }
    }

    /// Its value for these values of the variables.
    ///
    /// # Panics
    /// If there are fewer values than names that it was read with.
    pub fn value<S: Real>(&self, of: &[S]) -> S {
        match self {
            Self::Number(number) => S::from(*number),
            Self::Variable(index) => of[*index],
            Self::Negative(inner) => -inner.value(of),
            Self::Binary('+', a, b) => a.value(of) + b.value(of),
            Self::Binary('-', a, b) => a.value(of) - b.value(of),
            Self::Binary('*', a, b) => a.value(of) * b.value(of),
            Self::Binary(_, a, b) => a.value(of) / b.value(of),
            Self::Power(inner, exponent) => {
                let base = inner.value(of);
                (0..*exponent).fold(S::from(1.0), |product, _| product * base)
            }
            Self::Sine(inner) => inner.value(of).sin(),
            Self::Cosine(inner) => inner.value(of).cos(),
        }
    }
}

struct Parser<'a> {
    characters: Vec<char>,
    at: usize,
    names: &'a [String],
    text: &'a str,
}

impl Parser<'_> {
    fn error(&self, what: String) -> ExpressionError {
        ExpressionError { what, at: self.at + 1, text: self.text.chars().take(200).collect() }
    }

    /// The next character that is no space.
    fn peek(&mut self) -> Option<char> {
        while self.characters.get(self.at).is_some_and(|c| c.is_whitespace()) {
            self.at += 1;
        }
        self.characters.get(self.at).copied()
    }

    fn taken(&mut self, wanted: char) -> bool {
        let found = self.peek() == Some(wanted);
        self.at += usize::from(found);
        found
    }

    fn sum(&mut self, depth: usize) -> Result<Expression, ExpressionError> {
        if depth > MAX_DEPTH {
            return Err(self.error("the formula is nested too deeply".to_owned()));
        }
        let mut left = self.product(depth)?;
        while let Some(sign) = self.peek().filter(|c| matches!(c, '+' | '-')) {
            self.at += 1;
            left = Expression::Binary(sign, Box::new(left), Box::new(self.product(depth)?));
        }
        Ok(left)
    }

    fn product(&mut self, depth: usize) -> Result<Expression, ExpressionError> {
        let mut left = self.signed(depth)?;
        while let Some(sign) = self.peek().filter(|c| matches!(c, '*' | '/')) {
            self.at += 1;
            left = Expression::Binary(sign, Box::new(left), Box::new(self.signed(depth)?));
        }
        Ok(left)
    }

    fn signed(&mut self, depth: usize) -> Result<Expression, ExpressionError> {
        if depth > MAX_DEPTH {
            return Err(self.error("the formula is nested too deeply".to_owned()));
        }
        if self.taken('-') {
            return Ok(Expression::Negative(Box::new(self.signed(depth + 1)?)));
        }
        let base = self.atom(depth)?;
        if !self.taken('^') {
            return Ok(base);
        }
        self.peek();
        let from = self.at;
        while self.characters.get(self.at).is_some_and(char::is_ascii_digit) {
            self.at += 1;
        }
        let digits: String = self.characters[from..self.at].iter().collect();
        match digits.parse::<u32>() {
            Ok(exponent) if exponent <= 20 => Ok(Expression::Power(Box::new(base), exponent)),
            _ => Err(self.error("an exponent must be a whole number from 0 to 20".to_owned())),
        }
    }

    fn atom(&mut self, depth: usize) -> Result<Expression, ExpressionError> {
        match self.peek() {
            Some('(') => {
                self.at += 1;
                let inner = self.sum(depth + 1)?;
                if self.taken(')') { Ok(inner) } else { Err(self.error("a ')' is missing".to_owned())) }
            }
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if c.is_alphabetic() || c == '_' => self.name(depth),
            Some(c) => Err(self.error(format!("'{c}' is not expected"))),
            None => Err(self.error("something is missing".to_owned())),
        }
    }

    fn number(&mut self) -> Result<Expression, ExpressionError> {
        let from = self.at;
        while let Some(c) = self.characters.get(self.at) {
            let after_exponent = self.at > from && matches!(self.characters[self.at - 1], 'e' | 'E');
            if c.is_ascii_digit() || matches!(c, '.' | 'e' | 'E') || (after_exponent && matches!(c, '+' | '-')) {
                self.at += 1;
            } else {
                break;
            }
        }
        let digits: String = self.characters[from..self.at].iter().collect();
        match digits.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(Expression::Number(number)),
            _ => {
                self.at = from;
                Err(self.error(format!("'{digits}' is no number")))
            }
        }
    }

    fn name(&mut self, depth: usize) -> Result<Expression, ExpressionError> {
        let from = self.at;
        while self.characters.get(self.at).is_some_and(|c| c.is_alphanumeric() || *c == '_') {
            self.at += 1;
        }
        let name: String = self.characters[from..self.at].iter().collect();
        if let Some(index) = self.names.iter().position(|known| *known == name) {
            return Ok(Expression::Variable(index));
        }
        if name == "pi" {
            return Ok(Expression::Number(std::f64::consts::PI));
        }
        if matches!(name.as_str(), "sin" | "cos") {
            if !self.taken('(') {
                return Err(self.error(format!("'{name}' needs a '('")));
            }
            let inner = Box::new(self.sum(depth + 1)?);
            if !self.taken(')') {
                return Err(self.error("a ')' is missing".to_owned()));
            }
            return Ok(if name == "sin" { Expression::Sine(inner) } else { Expression::Cosine(inner) });
        }
        self.at = from;
        Err(self.error(format!("there is no parameter '{name}'")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::dual::Dual;

    fn names() -> Vec<String> {
        ["m", "k_1", "τ"].map(str::to_owned).to_vec()
    }

    #[test]
    fn formulas_have_their_values_and_derivatives() {
        let cases: [(&str, f64); 9] = [
            ("-k_1/m", -1.5),
            ("2 * (m + k_1) - -1", 11.0),
            ("m^3", 8.0),
            ("-m^2", -4.0),
            ("1 - 2 - 3", -4.0),
            ("12/m/k_1", 2.0),
            ("1.5e-1 + .5", 0.65),
            ("cos(2*pi) + sin(0)", 1.0),
            ("τ*m^0", 0.25),
        ];
        for (text, expected) in cases {
            let formula = Expression::parse(text, &names()).unwrap();
            assert!((formula.value(&[2.0, 3.0, 0.25]) - expected).abs() < 1e-14, "{text}");
        }
        let formula = Expression::parse("k_1^2/m", &names()).unwrap();
        let slope = formula.value(&[Dual::variable(2.0), Dual::from(3.0), Dual::from(0.0)]).slope;
        assert!((slope + 9.0 / 4.0).abs() < 1e-14);
    }

    #[test]
    fn what_is_no_formula_is_named_with_its_place() {
        for (text, at, what) in [
            ("k_2 + 1", 1, "no parameter 'k_2'"),
            ("m +", 4, "missing"),
            ("(m", 3, "')'"),
            ("m m", 3, "not expected"),
            ("m^-1", 3, "exponent"),
            ("m^2.5", 4, "not expected"),
            ("1e999", 1, "no number"),
            ("sin m", 5, "needs"),
            ("", 1, "missing"),
        ] {
            let error = Expression::parse(text, &names()).unwrap_err();
            assert_eq!(error.at, at, "{error}");
            assert!(error.to_string().contains(what), "{error}");
        }
        let deep = "(".repeat(100) + "m" + &")".repeat(100);
        assert!(Expression::parse(&deep, &names()).unwrap_err().what.contains("deeply"));
        assert!(Expression::parse(&"-".repeat(100), &names()).unwrap_err().what.contains("deeply"));
    }
}
