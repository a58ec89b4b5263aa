//! Numbers of several draws side by side: one in each lane of the processor's vectors.
//!
//! What is computed in a lane depends on nothing in the others, and every step rounds as a single number would, so that
//! a report is the same whatever the processor.

use pulp::Simd;

/// Lanes at most.
pub(super) const MOST: usize = 8;

/// A vector whose lane `l` holds `value(l)`.
#[inline(always)]
pub(super) fn lanes<S: Simd>(simd: S, value: impl Fn(usize) -> f64) -> S::f64s {
    let mut all = [0.0; MOST];
    for (l, into) in all[..S::F64_LANES].iter_mut().enumerate() {
        *into = value(l);
    }
    load(simd, &all)
}

/// A vector of the first numbers of an array.
#[inline(always)]
pub(super) fn load<S: Simd>(_: S, all: &[f64; MOST]) -> S::f64s {
    let (vectors, _) = S::as_simd_f64s(&all[..S::F64_LANES]);
    vectors[0]
}

/// What the lanes hold; zero beyond them.
#[inline(always)]
pub(super) fn values<S: Simd>(_: S, of: S::f64s) -> [f64; MOST] {
    let mut all = [0.0; MOST];
    let (vectors, _) = S::as_mut_simd_f64s(&mut all[..S::F64_LANES]);
    vectors[0] = of;
    all
}
