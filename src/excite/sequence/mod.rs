//! Sequences: maximum-length pseudorandom ones, multisines, chirps and filtered noise, sampled at any rate.
//!
//! A [`SequenceSpec`] is written in JSON and checked into a [`CheckedSequence`]; sampling that gives a [`Sequence`]
//! with its exact period and the lines that carry its power. Equal specs give equal samples, on every machine: whatever
//! is drawn comes from the spec's seed.

mod chips;
mod chirp;
pub mod correlation;
mod crest;
mod error;
pub mod field;
mod multisine;
mod noise;
mod sampled;
mod spec;
pub mod write;

pub use chips::{ChipHold, Polynomial, ShiftRegister};
pub use chirp::{Chirp, ChirpPreset, Sweep};
pub use error::SequenceError;
pub use multisine::{Harmonics, Interleave, Multisine, Phases, PowerProfile};
pub use noise::{Butterworth, FilteredNoise, Screen, tukey};
pub use sampled::{Period, Sequence, SequenceDetails};
pub use spec::{CheckedSequence, Generator, Scale, SequenceSpec};

/// Samples of a sequence at most.
pub const MAX_SAMPLES: usize = 2_000_000;
