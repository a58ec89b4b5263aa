//! The largest or the smallest of some norms, found by several threads.

use super::question::Quantity;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// One of the two ends of a range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    Least,
    Largest,
}

/// How much a norm as computed may differ from its bounds: the quadrature's tolerance and the rounding of coefficients,
/// amply.
const SLACK: f64 = 1e-6;

/// The best value so far with the lowest index of those that have it. Values at the lower end are kept with their sign
/// turned, so that larger ones are better at both.
#[derive(Debug)]
pub(super) struct Best {
    quantity: Quantity,
    end: End,
    /// The value as bits, in an order of their own.
    value: AtomicU64,
    found: Mutex<Option<(f64, u64)>>,
}

impl Best {
    pub(super) fn new(quantity: Quantity, end: End) -> Self {
        Self { quantity, end, value: AtomicU64::new(f64::NEG_INFINITY.to_bits()), found: Mutex::new(None) }
    }

    pub(super) fn quantity(&self) -> Quantity {
        self.quantity
    }

    /// The largest of signed values that lie between two norms.
    pub(super) fn potential(&self, [low, high]: [f64; 2]) -> f64 {
        match self.end {
            End::Least => -low,
            End::Largest => high,
        }
    }

    /// The signed value of a norm.
    pub(super) fn signed(&self, norm: f64) -> f64 {
        match self.end {
            End::Least => -norm,
            End::Largest => norm,
        }
    }

    fn value(&self) -> f64 {
        f64::from_bits(self.value.load(Ordering::Relaxed))
    }

    /// Whether something that may be as good as this may be the best; what is no number may be anything.
    pub(super) fn may_be(&self, potential: f64) -> bool {
        let value = self.value();
        if value == f64::NEG_INFINITY {
            return true;
        }
        // ‖Gff G − 1‖ is a difference from 1, and ‖Gfb‖ of no difference.
        let scale = if self.quantity == Quantity::Distance { 1.0 + value.abs() } else { value.abs() };
        let worse = potential < value - SLACK * scale;
        !worse
    }

    /// Whether nothing can be better: a member has no finite norm.
    pub(super) fn is_infinite(&self) -> bool {
        self.value() == f64::INFINITY
    }

    /// Whether a norm is at least as good as the best so far.
    pub(super) fn is_better(&self, norm: f64) -> bool {
        self.signed(norm) >= self.value()
    }

    /// Takes the norm of a member, with its index.
    pub(super) fn take(&self, norm: f64, index: u64) {
        let value = self.signed(norm);
        // Plain values: whole whenever the lock is free.
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        let is_better = found.is_none_or(|(best, at)| value > best || (value == best && index < at));
        if is_better {
            *found = Some((value, index));
            self.value.store(value.to_bits(), Ordering::Relaxed);
        }
    }

    /// The best norm and its index.
    pub(super) fn found(&self) -> Option<(f64, u64)> {
        let found = *self.found.lock().unwrap_or_else(PoisonError::into_inner);
        found.map(|(value, index)| (self.signed(value), index))
    }
}
