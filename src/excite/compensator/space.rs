//! The box that is searched.

use super::design::Compensator;
use super::edge::{Edge, End, Unknown};
use super::search::SearchBox;

/// An unknown within this distance (of its logarithm) from an edge is on it.
pub(super) const EDGE: f64 = 1e-6;

/// A box in the logarithms of the unknowns: K, and f_z and f_p where there are corners.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Space {
    /// Lower and upper end of each.
    pub bounds: Vec<[f64; 2]>,
    /// Whether there are corners.
    pub corners: bool,
    /// Whether f_z ≤ f_p is asked for.
    pub zero_below_pole: bool,
}

impl Space {
    pub(super) fn new(region: &SearchBox) -> Self {
        let logs = |ends: [f64; 2]| ends.map(f64::ln);
        let mut bounds = vec![logs(region.gain)];
        if let Some([zero, pole]) = region.corners {
            bounds.extend([logs(zero), logs(pole)]);
        }
        Self { bounds, corners: region.corners.is_some(), zero_below_pole: region.zero_below_pole }
    }

    /// The compensator of a point.
    pub(super) fn compensator(&self, x: &[f64]) -> Compensator {
        if self.corners {
            // Equal corners are proportional control exactly.
            let (zero, pole) = (x[1].exp(), if self.zero_below_pole { x[2].max(x[1]) } else { x[2] }.exp());
            Compensator { gain: x[0].exp(), zero_hz: zero, pole_hz: pole }
        } else {
            Compensator::proportional(x[0].exp())
        }
    }

    /// Values along one unknown; one value where it is fixed.
    pub(super) fn axis(&self, i: usize, count: usize) -> Vec<f64> {
        let [low, high] = self.bounds[i];
        if high - low < EDGE { vec![low] } else { crate::control::bode::linear_grid(low, high, count) }
    }

    /// The edges that a point lies on.
    pub(super) fn edges(&self, x: &[f64]) -> Vec<Edge> {
        let mut edges = Vec::new();
        let unknowns = [Unknown::Gain, Unknown::ZeroHz, Unknown::PoleHz];
        for (i, unknown) in unknowns.into_iter().enumerate().take(self.bounds.len()) {
            let [low, high] = self.bounds[i];
            if high - low < EDGE {
                continue;
            }
            if x[i] - low < EDGE {
                edges.push(Edge { unknown, end: End::Lower });
            } else if high - x[i] < EDGE {
                edges.push(Edge { unknown, end: End::Upper });
            }
        }
        if self.corners && self.zero_below_pole && x[2] - x[1] < EDGE {
            edges.push(Edge { unknown: Unknown::ZeroBelowPole, end: End::Equal });
        }
        edges
    }
}
