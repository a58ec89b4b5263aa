//! What the table of feedback controllers is made of: lists of factors and gains, and the plant.

use super::factor::Factor;

/// How a listed gain becomes the leading coefficient of a numerator.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Normalisation {
    /// The numerators are taken as they are.
    None,
    /// A gain is the peak of |Gfb| over a band: per denominator and numerator, the peak at gain one, computed on the
    /// fly from the squared moduli as quadratics of the same variable.
    Peak {
        /// `|D|²` per denominator, and whether D vanishes on the band.
        denominators: Vec<([f64; 3], bool)>,
        /// `|N|²` per numerator.
        numerators: Vec<[f64; 3]>,
        /// The band in that variable.
        band: [f64; 2],
    },
}

/// What feedback controllers are made of.
#[derive(Debug, Clone)]
pub(super) struct FeedbackLists {
    pub(super) denominators: Vec<Factor>,
    pub(super) numerators: Vec<Factor>,
    /// Without zero.
    pub(super) gains: Vec<f64>,
    /// Whether no feedback is among them.
    pub(super) zero: bool,
    pub(super) normalisation: Normalisation,
}

/// A plant as the stability test takes it: see [`Region::map`](crate::identify::time::Region::map).
#[derive(Debug, Clone)]
pub(super) struct MappedPlant {
    pub(super) denominator: Vec<f64>,
    /// Homogenised to the degree of the denominator.
    pub(super) numerator: Vec<f64>,
    /// Leading zeros of every closed-loop polynomial, where plant or feedback is improper.
    pub(super) padding: usize,
}
