//! Subsystem identification: the feedforward and feedback controllers behind a closed-loop frequency response
//! (Zhang 2015, algorithms 2.1, 3.1 and 5.1).

pub mod basis;
pub mod frequency;
pub mod pool;
pub mod problem;
pub mod search;
pub mod time;
pub mod validation;
