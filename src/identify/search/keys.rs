//! What a pool or its trees were made from, member by member.

use crate::cache::KeyHasher;
use crate::control::System;
use crate::identify::held::Held;
use crate::identify::pool::Recipe;
use crate::identify::pool::recipe::Ingredients;
use crate::identify::pool::roots::RootPair;
use crate::num::{Complex64, Polynomial};

/// A checked pool. Named member by member, so that a new one is not forgotten here.
pub(crate) fn hash_recipe(into: &mut KeyHasher, recipe: &Recipe) {
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
        held,
    } = recipe;
    into.number(match sampled {
        None => 0,
        Some(false) => 1,
        Some(true) => 2,
    });
    hash_ingredients(into, feedforward);
    into.length(*feedforward_numerator_degree);
    into.length(*feedforward_denominator_degree);
    hash_ingredients(into, feedback_numerators);
    hash_ingredients(into, feedback_denominators);
    into.reals(gains);
    into.number(u64::from(*zero_gain));
    into.reals(band_rad_s.as_ref().map_or(&[][..], |band| band));
    into.real(*margin);
    into.number(match held {
        None => 0,
        Some(Held::Feedback) => 1,
        Some(Held::Feedforward) => 2,
    });
}

fn hash_ingredients(into: &mut KeyHasher, ingredients: &Ingredients) {
    match ingredients {
        Ingredients::Power(n) => {
            into.number(0);
            into.length(*n);
        }
        Ingredients::Roots(roots) => {
            into.number(1);
            into.length(roots.len());
            roots.iter().for_each(|pair| hash_roots(into, *pair));
        }
        Ingredients::Coefficients(rows) => {
            into.number(2);
            into.length(rows.len());
            rows.iter().for_each(|row| into.reals(row));
        }
    }
}

fn hash_roots(into: &mut KeyHasher, pair: RootPair) {
    match pair {
        RootPair::None => into.number(0),
        RootPair::One(a) => {
            into.number(1);
            into.real(a);
        }
        RootPair::Two(a, b) => {
            into.number(2);
            into.real(a);
            into.real(b);
        }
        RootPair::Complex { natural_frequency, damping } => {
            into.number(3);
            into.real(natural_frequency);
            into.real(damping);
        }
    }
}

/// A plant with its time base.
pub(crate) fn hash_plant(into: &mut KeyHasher, plant: &System) {
    let (num, den): (&Polynomial, &Polynomial) = match plant {
        System::Continuous(tf) => {
            into.number(0);
            (tf.num(), tf.den())
        }
        System::Discrete(tf) => {
            into.number(1);
            into.real(tf.time().period_s());
            (tf.num(), tf.den())
        }
    };
    into.reals(num.coefficients());
    into.reals(den.coefficients());
}

/// Angular frequency and plant at each line.
pub(crate) fn hash_lines(into: &mut KeyHasher, lines: &[(f64, Complex64)]) {
    into.length(lines.len());
    for (omega, plant) in lines {
        into.real(*omega);
        into.real(plant.re);
        into.real(plant.im);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cache::Key;
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
            held: None,
        }
    }

    fn key(recipe: &Recipe) -> Key {
        let mut hasher = KeyHasher::new("recipe");
        hash_recipe(&mut hasher, recipe);
        hasher.key()
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
            Recipe { held: Some(Held::Feedback), ..recipe() },
            Recipe { held: Some(Held::Feedforward), ..recipe() },
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
                    let mut hasher = KeyHasher::new(kind);
                    hash_plant(&mut hasher, plant);
                    hash_lines(&mut hasher, lines);
                    let key = hasher.key();
                    assert_eq!(key.hexadecimal().len(), 64);
                    assert!(keys.insert(key), "{kind} {plant:?} {lines:?}");
                }
            }
        }
        assert_eq!(keys.len(), 24);
    }
}
