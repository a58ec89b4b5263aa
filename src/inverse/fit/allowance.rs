//! How many evaluations of f a fit, or a part of it, may take.

use std::cell::Cell;

/// Evaluations left, of all and of the part that is being worked on.
#[derive(Debug)]
pub(in crate::inverse) struct Allowance {
    left: Cell<usize>,
    part: Cell<usize>,
    is_exhausted: Cell<bool>,
}

impl Allowance {
    pub(in crate::inverse) fn new(evaluations: usize) -> Self {
        Self { left: Cell::new(evaluations), part: Cell::new(evaluations), is_exhausted: Cell::new(false) }
    }

    /// For a single local refinement.
    pub(in crate::inverse) fn small() -> Self {
        Self::new(400)
    }

    /// Begins a part that may take an equal share of what is left, one of so many.
    pub(super) fn begin(&self, parts: usize) {
        self.part.set(self.left.get() / parts.max(1));
    }

    /// Takes one evaluation; false where none is left.
    pub(super) fn take(&self) -> bool {
        if self.part.get() == 0 || self.left.get() == 0 {
            self.is_exhausted.set(true);
            return false;
        }
        self.left.set(self.left.get() - 1);
        self.part.set(self.part.get() - 1);
        true
    }

    pub(super) fn left(&self) -> usize {
        self.left.get()
    }

    /// Whether an evaluation was refused.
    pub(super) fn is_exhausted(&self) -> bool {
        self.is_exhausted.get()
    }
}
