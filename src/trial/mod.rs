//! One recorded trial: its signals, its sample time, and the ways it is written down (CSV, JSON, bytes).

pub mod signals;

pub use signals::{Channel, Signals, Trial};
