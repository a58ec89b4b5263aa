//! Files for other programs and for devices: MATLAB, NumPy, sound, archives.
//!
//! The same content gives the same bytes: nothing here knows a clock, and archives have their files in the order of
//! their names under one fixed time.

pub mod mat;
pub mod npz;
pub mod wav;
pub mod zip;

/// Columns of one length on a uniform grid: a recording, or what a device plays.
#[derive(Debug, Clone, PartialEq)]
pub struct Sequence {
    /// Time between samples in seconds.
    pub sample_time_s: f64,
    /// Names and samples. A column of times, where there is one, is called `t`.
    pub columns: Vec<(String, Vec<f64>)>,
}

impl Sequence {
    /// Of a recording, under the letters of its signals.
    #[must_use]
    pub fn of_trial(trial: &crate::trial::Trial) -> Self {
        let channels = crate::trial::Channel::ALL.into_iter();
        let columns = channels
            .filter_map(|channel| Some((channel.letter().to_owned(), trial.signals.channel(channel)?.to_vec())));
        Self { sample_time_s: trial.sample_time_s, columns: columns.collect() }
    }
}
