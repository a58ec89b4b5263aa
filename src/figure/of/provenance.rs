//! Where the numbers of a figure come from, as its caption says it.

use crate::analysis::Report;
use crate::trial::Trial;

/// The units of a lab's signals.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Units {
    /// Of the command and the output.
    pub output: String,
    /// Of the control and the disturbance.
    pub control: String,
}

impl Default for Units {
    /// What stands where the lab gave none.
    fn default() -> Self {
        Self { output: "unit of y".to_owned(), control: "unit of u".to_owned() }
    }
}

/// A trial, as captions name it.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialOrigin {
    /// The subject's pseudonym.
    pub subject: String,
    /// The trial's number.
    pub number: i64,
    /// Its session, where it has one.
    pub session: Option<i64>,
    /// The plant that it was recorded on, by name.
    pub plant: String,
    /// SHA-256 of the recording, in hexadecimal.
    pub sha256: String,
    /// |y| above which the study calls a trial divergent, in the unit of y.
    pub display_limit: Option<f64>,
    /// The units of its signals.
    pub units: Units,
}

impl TrialOrigin {
    /// `MP01, trial 40`, with the session where there is one.
    #[must_use]
    pub fn name(&self) -> String {
        let session = self.session.map_or_else(String::new, |session| format!("session {session}, "));
        format!("{}, {session}trial {}", self.subject, self.number)
    }

    /// The recording in a caption.
    pub(super) fn caption(&self, trial: &Trial) -> String {
        let duration = trial.sample_time_s * (trial.samples().saturating_sub(1)) as f64;
        format!(
            "{} on {}: {} samples, {} s at {} Hz; sha256 {}; {}.",
            self.name(),
            self.plant,
            trial.samples(),
            super::super::text::three(duration),
            super::super::text::three(1.0 / trial.sample_time_s),
            eight(&self.sha256),
            product()
        )
    }
}

/// An analysis, as captions name it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReportOrigin {
    /// What it is about: a trial, or several.
    pub subject: String,
}

impl ReportOrigin {
    /// The analysis in a caption.
    pub(super) fn caption(&self, report: &Report) -> String {
        let origin = &report.provenance;
        format!(
            "{}: {}, spec {}, result {}; Volition {}.",
            self.subject,
            report.kind,
            eight(&origin.spec_sha256),
            eight(&origin.result_sha256),
            origin.product_version
        )
    }
}

/// The beginning of a hash, which names it to a reader.
pub(super) fn eight(hash: &str) -> &str {
    hash.get(..8).unwrap_or(hash)
}

/// The program that drew.
pub(super) fn product() -> String {
    format!("Volition {}", env!("CARGO_PKG_VERSION"))
}
