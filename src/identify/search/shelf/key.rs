//! What a pool or its trees were made from, as one number.

use crate::control::System;
use crate::identify::pool::Recipe;
use crate::identify::pool::recipe::Ingredients;
use crate::identify::pool::roots::RootPair;
use crate::num::hexadecimal::hexadecimal;
use crate::num::{Complex64, Polynomial};
use sha2::{Digest, Sha256};

/// Names something on a [`Shelf`](super::Shelf) by its kind and the SHA-256 of everything that it depends on, the code included: two
/// things with the same key are interchangeable.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Key {
    kind: &'static str,
    sha256: [u8; 32],
}

impl Key {
    /// What it is: a word in lower-case letters.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        self.kind
    }

    /// The hash of what it was made from.
    #[must_use]
    pub fn sha256(&self) -> &[u8; 32] {
        &self.sha256
    }

    /// The hash in lower-case hexadecimal.
    #[must_use]
    pub fn hexadecimal(&self) -> String {
        hexadecimal(&self.sha256)
    }
}

/// Makes keys: every member goes into the hash with its length or a tag before it, so that no two lists of members look alike, and
/// numbers go in bit by bit.
pub(in super::super) struct Maker {
    kind: &'static str,
    hash: Sha256,
}

impl Maker {
    /// Of a kind of thing, made by this program.
    pub(in super::super) fn new(kind: &'static str) -> Self {
        let mut made = Self { kind, hash: Sha256::new() };
        made.text(kind);
        made.text(env!("CARGO_PKG_VERSION"));
        // The version of a program that is being worked on stays the same: see build.rs.
        made.text(env!("VOLITION_TREES_CODE"));
        made
    }

    pub(in super::super) fn key(self) -> Key {
        Key { kind: self.kind, sha256: self.hash.finalize().into() }
    }

    pub(in super::super) fn number(&mut self, number: u64) {
        self.hash.update(number.to_le_bytes());
    }

    pub(in super::super) fn length(&mut self, length: usize) {
        self.number(length as u64);
    }

    pub(in super::super) fn real(&mut self, x: f64) {
        self.number(x.to_bits());
    }

    fn text(&mut self, text: &str) {
        self.length(text.len());
        self.hash.update(text);
    }

    fn reals(&mut self, values: &[f64]) {
        self.length(values.len());
        values.iter().for_each(|x| self.real(*x));
    }

    /// A checked pool. Named member by member, so that a new one is not forgotten here.
    pub(in super::super) fn recipe(&mut self, recipe: &Recipe) {
        let Recipe {
            sampled,
            feedforward,
            feedforward_numerator_degree,
            feedforward_denominator_degree,
            feedback_numerators,
            feedback_denominators,
            gains,
            zero_gain,
            band_rad_s,
            margin,
        } = recipe;
        self.number(match sampled {
            None => 0,
            Some(false) => 1,
            Some(true) => 2,
        });
        self.ingredients(feedforward);
        self.length(*feedforward_numerator_degree);
        self.length(*feedforward_denominator_degree);
        self.ingredients(feedback_numerators);
        self.ingredients(feedback_denominators);
        self.reals(gains);
        self.number(u64::from(*zero_gain));
        self.reals(band_rad_s.as_ref().map_or(&[][..], |band| band));
        self.real(*margin);
    }

    fn ingredients(&mut self, ingredients: &Ingredients) {
        match ingredients {
            Ingredients::Power(n) => {
                self.number(0);
                self.length(*n);
            }
            Ingredients::Roots(roots) => {
                self.number(1);
                self.length(roots.len());
                roots.iter().for_each(|pair| self.roots(*pair));
            }
            Ingredients::Coefficients(rows) => {
                self.number(2);
                self.length(rows.len());
                rows.iter().for_each(|row| self.reals(row));
            }
        }
    }

    fn roots(&mut self, pair: RootPair) {
        match pair {
            RootPair::None => self.number(0),
            RootPair::One(a) => {
                self.number(1);
                self.real(a);
            }
            RootPair::Two(a, b) => {
                self.number(2);
                self.real(a);
                self.real(b);
            }
            RootPair::Complex { natural_frequency, damping } => {
                self.number(3);
                self.real(natural_frequency);
                self.real(damping);
            }
        }
    }

    /// A plant with its time base.
    pub(in super::super) fn plant(&mut self, plant: &System) {
        let (num, den): (&Polynomial, &Polynomial) = match plant {
            System::Continuous(tf) => {
                self.number(0);
                (tf.num(), tf.den())
            }
            System::Discrete(tf) => {
                self.number(1);
                self.real(tf.time().period_s());
                (tf.num(), tf.den())
            }
        };
        self.reals(num.coefficients());
        self.reals(den.coefficients());
    }

    /// Angular frequency and plant at each line.
    pub(in super::super) fn lines(&mut self, lines: &[(f64, Complex64)]) {
        self.length(lines.len());
        for (omega, plant) in lines {
            self.real(*omega);
            self.real(plant.re);
            self.real(plant.im);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Continuous, Discrete, TransferFunction};

    fn recipe() -> Recipe {
        Recipe {
            sampled: None,
            feedforward: Ingredients::Roots(vec![RootPair::Two(-1.0, -2.0), RootPair::One(-1.0)]),
            feedforward_numerator_degree: 4,
            feedforward_denominator_degree: 2,
            feedback_numerators: Ingredients::Coefficients(vec![vec![1.0, 2.0], vec![3.0]]),
            feedback_denominators: Ingredients::Power(2),
            gains: vec![0.5, -0.5],
            zero_gain: true,
            band_rad_s: Some([0.0, 1.0]),
            margin: 0.1,
        }
    }

    fn key(recipe: &Recipe) -> Key {
        let mut maker = Maker::new("recipe");
        maker.recipe(recipe);
        maker.key()
    }

    #[test]
    fn whatever_differs_in_a_recipe_gives_another_key() {
        let roots = |pairs: &[RootPair]| Ingredients::Roots(pairs.to_vec());
        let complex = |damping| RootPair::Complex { natural_frequency: 2.0, damping };
        let variants = [
            recipe(),
            Recipe { sampled: Some(false), ..recipe() },
            Recipe { sampled: Some(true), ..recipe() },
            Recipe { feedforward: roots(&[RootPair::Two(-2.0, -1.0), RootPair::One(-1.0)]), ..recipe() },
            Recipe { feedforward: roots(&[RootPair::One(-1.0), RootPair::Two(-2.0, -1.0)]), ..recipe() },
            Recipe { feedforward: roots(&[complex(0.5), RootPair::None]), ..recipe() },
            Recipe { feedforward: roots(&[complex(0.5f64.next_up()), RootPair::None]), ..recipe() },
            Recipe { feedforward_numerator_degree: 3, ..recipe() },
            Recipe { feedforward_denominator_degree: 3, ..recipe() },
            Recipe { feedback_numerators: Ingredients::Coefficients(vec![vec![1.0], vec![2.0, 3.0]]), ..recipe() },
            Recipe { feedback_denominators: Ingredients::Power(1), ..recipe() },
            Recipe { gains: vec![0.5], ..recipe() },
            Recipe { gains: vec![-0.5, 0.5], ..recipe() },
            Recipe { zero_gain: false, ..recipe() },
            Recipe { band_rad_s: None, ..recipe() },
            Recipe { band_rad_s: Some([0.0, 2.0]), ..recipe() },
            Recipe { margin: 0.2, ..recipe() },
        ];
        for (i, a) in variants.iter().enumerate() {
            for (j, b) in variants.iter().enumerate() {
                assert_eq!(key(a) == key(b), i == j, "{a:?}\n{b:?}");
            }
        }
    }

    #[test]
    fn plants_lines_and_kinds_give_other_keys() {
        let continuous =
            |num: &[f64]| System::Continuous(TransferFunction::new(num, &[1.0, 1.0, 4.0], Continuous).unwrap());
        let sampled = |period| {
            let time = Discrete::new(period).unwrap();
            System::Discrete(TransferFunction::new(&[2.0, 4.4], &[1.0, 1.0, 4.0], time).unwrap())
        };
        let plants = [continuous(&[2.0, 4.4]), continuous(&[2.0, 4.5]), sampled(0.02), sampled(0.01)];
        let lines = [vec![], vec![(1.0, Complex64::new(1.0, 2.0))], vec![(1.0, Complex64::new(1.0, -2.0))]];
        let mut keys = std::collections::HashSet::new();
        for kind in ["a", "b"] {
            for plant in &plants {
                for lines in &lines {
                    let mut maker = Maker::new(kind);
                    maker.plant(plant);
                    maker.lines(lines);
                    let key = maker.key();
                    assert_eq!(key.hexadecimal().len(), 64);
                    assert!(keys.insert(key), "{kind} {plant:?} {lines:?}");
                }
            }
        }
        assert_eq!(keys.len(), 24);
    }
}
