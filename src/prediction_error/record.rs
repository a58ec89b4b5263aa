//! A trial at the working sample time.

use crate::trial::Trial;

/// The signals of a trial at every `step`-th sample.
///
/// Samples are picked and not averaged: an average would mix past and future of each sample and colour noise that was a
/// simple process, which the regression then mistakes for feedback.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Time between the samples in seconds.
    pub sample_time_s: f64,
    /// Command r.
    pub command: Vec<f64>,
    /// Control u.
    pub control: Vec<f64>,
    /// Output y.
    pub output: Vec<f64>,
    /// Error e = r − y.
    pub error: Vec<f64>,
    /// Disturbance d at the plant's input; `None` where none was recorded.
    pub disturbance: Option<Vec<f64>>,
}

impl Record {
    /// Every `step`-th sample of a trial, from its first.
    #[must_use]
    pub fn new(trial: &Trial, step: usize) -> Self {
        let pick = |x: &[f64]| x.iter().step_by(step.max(1)).copied().collect::<Vec<f64>>();
        let signals = &trial.signals;
        let (command, output) = (pick(&signals.command), pick(&signals.output));
        Self {
            sample_time_s: trial.sample_time_s * step.max(1) as f64,
            error: command.iter().zip(&output).map(|(r, y)| r - y).collect(),
            command,
            control: pick(&signals.control),
            output,
            disturbance: signals.disturbance.as_deref().map(pick),
        }
    }

    /// The number of samples.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.control.len()
    }
}
