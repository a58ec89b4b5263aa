//! Subsystem identification: the feedforward and feedback controllers behind a closed-loop frequency response
//! (Zhang 2015, algorithms 2.1, 3.1 and 5.1).

pub mod frequency;
pub mod pool;
pub mod time;
pub mod validation;
