//! Subsystem identification: the feedforward and feedback controllers behind a closed-loop frequency response
//! (Zhang 2015, algorithms 2.1, 3.1 and 5.1).

pub mod basis;
pub mod both_stimuli;
pub mod delayed;
pub mod equivalent;
pub mod family;
mod findings;
pub mod held;
pub mod identifiability;
pub mod mimo;
pub mod pool;
pub mod problem;
pub mod refine;
pub mod search;
pub mod ssid;
pub mod time;
pub mod validation;
