//! The two-stimulus estimate: a command r and a disturbance d at the plant's input tell feedback from feedforward,
//! without assumed degrees.
//!
//! With `y = G (u + d)` and `u = Gff r + Gfb (r − y)` the loop answers
//!
//! - to the command `H_yr = G (Gff + Gfb)/(1 + G Gfb)`, `H_ur = (Gff + Gfb)/(1 + G Gfb)`,
//! - to the disturbance `H_yd = G/(1 + G Gfb)`, `H_ud = −G Gfb/(1 + G Gfb)`,
//!
//! four responses of two unknown controllers at every line. From r alone they cannot be told apart (Zhang 2015, Example
//! 2.1).

pub mod controllers;
pub mod fit;
pub mod regularised;
pub mod responses;
pub mod simulate;
pub mod stability;
pub mod steady;
pub mod structure;
