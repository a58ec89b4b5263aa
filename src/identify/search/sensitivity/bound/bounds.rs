//! What the kernel says of a cluster with some blocks.

use super::block_lanes::LANES;
use crate::identify::search::sensitivity::build::denominators::FREE;
use crate::identify::search::sensitivity::build::size::{DIRECTIONS, FAINT};

/// The largest half of a feedforward numerator that the kernel takes.
pub(crate) const LARGEST_HALF: usize = 8;

/// What is known about the cluster together with each of the blocks.
#[derive(Debug, Clone, Default)]
pub(crate) struct Bounds<N> {
    /// Cost of the relaxed problem.
    pub cost: [N; LANES],
    /// No member with any denominator of the block costs less, rounding included; −∞ or NaN where nothing is known.
    pub whole: [N; LANES],
    /// `Σ |E − S|² w |δ|²`: how far the block extends.
    pub extent: [N; LANES],
    /// The bound's parts, affine and quadratic in the offsets:
    /// `base − square − lost + Σ_m min over the box of slope_m t_m`.
    pub base: [[N; LANES]; FREE + 1],
    pub square: [[N; LANES]; 6],
    pub slopes: [[[N; LANES]; FREE + 1]; DIRECTIONS],
    /// Slopes along the faint directions, for all denominators of the block.
    pub faint: [[N; LANES]; FAINT],
    pub lost: [N; LANES],
}
