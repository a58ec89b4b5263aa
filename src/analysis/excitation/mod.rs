//! What `excitation_quality` and `compensator_design` share: signals and plants of a request. The method is that of
//! [`excite`](crate::excite).

pub mod excerpt;
pub mod plant;
pub(in crate::analysis) mod problems;
pub mod signal;
pub mod signal_input;
