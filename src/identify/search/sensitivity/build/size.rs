//! How large clusters and their kernels are.

/// Leading directions of a cluster, to which y adapts.
pub(crate) const DIRECTIONS: usize = 6;

/// Faint ones after them, along which the bound only takes the worst.
pub(crate) const FAINT: usize = 6;

/// All of them.
pub(crate) const ALL: usize = DIRECTIONS + FAINT;

/// The most parts that a cluster is divided into.
pub(crate) const PARTS: usize = 8;

/// Single controllers that are evaluated at once.
pub(crate) const CONTROLLER_LANES: usize = 8;
