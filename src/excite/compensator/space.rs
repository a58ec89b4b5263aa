//! The box that is searched.

use super::controller::{Compensator, Section};
use super::edge::{Edge, End, Unknown};
use super::search_box::{SearchBox, SectionBox};

/// An unknown within this distance (of its logarithm) from an edge is on it.
pub(super) const EDGE: f64 = 1e-6;

/// A box in the logarithms of the unknowns: K, then zero and pole of every section, each with its damping where the
/// section is of second order.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Space {
    /// Lower and upper end of each.
    pub bounds: Vec<[f64; 2]>,
    /// Whether each section is of second order.
    pub orders: Vec<bool>,
    /// Whether f_z ≤ f_p is asked for, of sections of first order.
    pub zero_below_pole: bool,
}

impl Space {
    pub(super) fn new(region: &SearchBox) -> Self {
        let logs = |ends: [f64; 2]| ends.map(f64::ln);
        let mut bounds = vec![logs(region.gain)];
        for section in &region.sections {
            match *section {
                SectionBox::First { zero_hz, pole_hz } => bounds.extend([logs(zero_hz), logs(pole_hz)]),
                SectionBox::Second { zero_hz, pole_hz, damping } => {
                    bounds.extend([logs(zero_hz), logs(damping), logs(pole_hz), logs(damping)]);
                }
            }
        }
        let orders = region.sections.iter().map(|section| matches!(section, SectionBox::Second { .. })).collect();
        Self { bounds, orders, zero_below_pole: region.zero_below_pole }
    }

    /// Where each section's unknowns begin, and whether it is of second order.
    fn places(&self) -> impl Iterator<Item = (usize, bool)> {
        self.orders.iter().scan(1, |at, second| {
            let start = *at;
            *at += if *second { 4 } else { 2 };
            Some((start, *second))
        })
    }

    /// The compensator of a point.
    pub(super) fn compensator(&self, x: &[f64]) -> Compensator {
        let section = |(at, second): (usize, bool)| {
            if second {
                let [zero_hz, zero_damping, pole_hz, pole_damping] = std::array::from_fn(|i| x[at + i].exp());
                return Section::Second { zero_hz, zero_damping, pole_hz, pole_damping };
            }
            // Equal corners are proportional control exactly.
            let pole = if self.zero_below_pole { x[at + 1].max(x[at]) } else { x[at + 1] };
            Section::First { zero_hz: x[at].exp(), pole_hz: pole.exp() }
        };
        Compensator { gain: x[0].exp(), sections: self.places().map(section).collect() }
    }

    /// Values along one unknown; one value where it is fixed.
    pub(super) fn axis(&self, i: usize, count: usize) -> Vec<f64> {
        let [low, high] = self.bounds[i];
        if high - low < EDGE { vec![low] } else { crate::control::bode::linear_grid(low, high, count) }
    }

    /// The edges that a point lies on.
    pub(super) fn edges(&self, x: &[f64]) -> Vec<Edge> {
        let mut edges = Vec::new();
        let mut look = |i: usize, unknown: Unknown, section: Option<usize>| {
            let [low, high] = self.bounds[i];
            if high - low < EDGE {
            } else if x[i] - low < EDGE {
                edges.push(Edge { unknown, end: End::Lower, section });
            } else if high - x[i] < EDGE {
                edges.push(Edge { unknown, end: End::Upper, section });
            }
        };
        look(0, Unknown::Gain, None);
        let several = self.orders.len() > 1;
        for (place, (at, second)) in self.places().enumerate() {
            let section = several.then_some(place);
            if second {
                let unknowns = [Unknown::ZeroHz, Unknown::ZeroDamping, Unknown::PoleHz, Unknown::PoleDamping];
                for (i, unknown) in unknowns.into_iter().enumerate() {
                    look(at + i, unknown, section);
                }
            } else {
                look(at, Unknown::ZeroHz, section);
                look(at + 1, Unknown::PoleHz, section);
            }
        }
        for (place, (at, second)) in self.places().enumerate() {
            if !second && self.zero_below_pole && x[at + 1] - x[at] < EDGE {
                let section = several.then_some(place);
                edges.push(Edge { unknown: Unknown::ZeroBelowPole, end: End::Equal, section });
            }
        }
        edges
    }
}
