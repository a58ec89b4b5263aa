//! Adjustment of p-values for several tests.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How p-values of several tests are adjusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "MultipleTestCorrection")]
pub enum Correction {
    /// Holm (1979): the probability of even one false claim stays below 5 %, however the tests depend on each other.
    #[default]
    Holm,
    /// Benjamini and Hochberg (1995): the expected share of false claims among the claims stays below 5 %.
    BenjaminiHochberg,
}

impl Correction {
    /// Its name in a sentence.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Holm => "Holm",
            Self::BenjaminiHochberg => "Benjamini and Hochberg",
        }
    }

    /// The adjusted p-values, in the order of `p`.
    #[must_use]
    pub fn adjust(self, p: &[f64]) -> Vec<f64> {
        let m = p.len();
        let mut order: Vec<usize> = (0..m).collect();
        order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
        let mut adjusted = vec![1.0; m];
        match self {
            Self::Holm => {
                let mut most = 0.0_f64;
                for (rank, i) in order.into_iter().enumerate() {
                    most = most.max(p[i] * (m - rank) as f64).min(1.0);
                    adjusted[i] = most;
                }
            }
            Self::BenjaminiHochberg => {
                let mut least = 1.0_f64;
                for (rank, i) in order.into_iter().enumerate().rev() {
                    least = least.min(p[i] * m as f64 / (rank + 1) as f64);
                    adjusted[i] = least;
                }
            }
        }
        adjusted
    }
}
