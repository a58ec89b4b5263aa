//! One recorded trial: its signals, its sample time, and the ways it is written down.
//!
//! [`Trial::new`] and [`Trial::from_signals`] are the only ways to a [`Trial`]: whoever holds one holds equally long
//! columns of finite numbers on a uniform time grid. [`csv`] and [`json`] read trials within [`Limits`], [`gzip`]
//! unpacks them on the way, and [`mod@write`] writes them so that reading gives back the same bits.

pub mod csv;
pub mod error;
pub mod gzip;
pub mod json;
pub mod limits;
pub mod pointer;
pub mod sample_time;
pub mod signals;
pub mod write;

pub use error::{Location, ReadError, TrialError};
pub use limits::Limits;
pub use sample_time::TimeDefect;
pub use signals::{Channel, Signals, Trial};

/// What a reader found.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadTrial {
    /// The recording.
    pub trial: Trial,
    /// Columns of the file that are no signal of a trial, by name, in file order. Nothing is dropped without saying so.
    pub ignored_columns: Vec<String>,
}
