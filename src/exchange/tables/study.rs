//! A study as one table: a row for each trial and analysis.

use super::{Record, Table};
use crate::analysis::Report;
use crate::analysis::estimates::QuantityTrust;
use crate::exchange::models;
use crate::learning::curves::Metric;
use crate::learning::inputs::Estimator;
use crate::trust::measured;
use serde_json::{Map, Value};

/// The columns that every table of a study begins with.
const COLUMNS: &[&str] = &[
    "study",
    "subject",
    "group",
    "session",
    "number",
    "trial",
    "plant",
    "sample_time_s",
    "samples",
    "duration_s",
    "divergent",
];

/// The member of a subject's attributes that has what an index said of each trial: an object by `NUMBER`, or by
/// `SESSION/NUMBER`.
pub const TRIAL_COLUMNS: &str = "trial_columns";

/// A trial, as a row begins.
#[derive(Debug, Clone)]
pub struct TrialFacts<'a> {
    /// The name of its study.
    pub study: &'a str,
    /// The pseudonym of its subject.
    pub subject: &'a str,
    /// The group of its subject.
    pub group: Option<&'a str>,
    /// The attributes of its subject, an object.
    pub attributes: &'a Value,
    /// What the subject's attributes hold of this trial alone.
    pub of_trial: Option<&'a Map<String, Value>>,
    /// Its session.
    pub session: Option<i64>,
    /// Its number.
    pub number: i64,
    /// Its id.
    pub trial: String,
    /// The name of its plant.
    pub plant: &'a str,
    /// Time between samples in seconds.
    pub sample_time_s: f64,
    /// How many samples.
    pub samples: u64,
    /// Whether its output passed the study's display limit.
    pub divergent: bool,
    /// SHA-256 of its content.
    pub sha256: &'a str,
    /// Its measures in time, an object.
    pub metrics: &'a Value,
    /// Codes of what must be read before it is used.
    pub warnings: Vec<&'a str>,
}

/// An analysis of a trial, as a row ends.
#[derive(Debug, Clone)]
pub struct AnalysisFacts<'a> {
    /// Its id.
    pub analysis: String,
    /// How many trials it combines.
    pub trials: usize,
    /// Which of them this one is, from 0.
    pub position: usize,
    /// When it was asked for, RFC 3339.
    pub created_at: String,
    /// Its report.
    pub report: &'a Report,
    /// What people take from the report about this trial, with how far it may be used.
    pub quantities: Vec<QuantityTrust>,
}

/// One of the attributes that are columns: not lists and objects, which are no cells.
fn is_cell(value: &Value) -> bool {
    !value.is_object() && !value.is_array()
}

fn of_trial(facts: &TrialFacts<'_>) -> Record {
    let mut row = Record::default()
        .with("study", facts.study)
        .with("subject", facts.subject)
        .with("group", facts.group)
        .with("session", facts.session)
        .with("number", facts.number)
        .with("trial", facts.trial.as_str())
        .with("plant", facts.plant)
        .with("sample_time_s", facts.sample_time_s)
        .with("samples", facts.samples)
        .with("duration_s", facts.sample_time_s * facts.samples as f64)
        .with("divergent", facts.divergent);
    for (name, value) in facts.attributes.as_object().into_iter().flatten().filter(|(_, value)| is_cell(value)) {
        row.add(format!("attribute_{name}"), value.clone());
    }
    for (name, value) in facts.of_trial.into_iter().flatten().filter(|(_, value)| is_cell(value)) {
        row.add(format!("trial_{name}"), value.clone());
    }
    for (name, value) in facts.metrics.as_object().into_iter().flatten().filter(|(_, value)| is_cell(value)) {
        row.add(name, value.clone());
    }
    for metric in [Metric::MeanAbsError, Metric::RmsError, Metric::ControlLogDimensionlessJerk] {
        if facts.metrics.get(metric.name()).is_some_and(Value::is_number) {
            row.add(format!("trust_{}", metric.name()), measured(metric.name(), facts.divergent).level.name());
        }
    }
    row.with("trial_warnings", facts.warnings.join(" ")).with("trial_sha256", facts.sha256)
}

/// The name of a column: of what the report says beside its first answer, with the estimator before it.
fn column(own: &QuantityTrust) -> String {
    match own.estimator {
        Some(Estimator::SsidRefined) => format!("refined_{}", own.trust.quantity),
        _ => own.trust.quantity.clone(),
    }
}

/// The coefficients of the controllers that a report has of the trial at this place.
fn controllers(row: &mut Record, result: &Value, position: usize) {
    let own = format!("trials_{position}_");
    for (name, model) in models::models(result) {
        let name = name.strip_prefix(&own).unwrap_or(&name);
        if name.starts_with("trials_") || !(name.contains("feedforward") || name.contains("feedback")) {
            continue;
        }
        for (part, coefficients) in [("num", &model.num), ("den", &model.den)] {
            for (i, value) in coefficients.iter().enumerate() {
                // By power, so that a column means the same in every row whatever its degree is.
                row.add(format!("{name}_{part}_{}", coefficients.len() - 1 - i), *value);
            }
        }
        row.add(format!("{name}_sample_time_s"), model.sample_time_s);
        row.add(format!("{name}_delay_s"), model.delay_s);
    }
}

fn with_analysis(mut row: Record, facts: &AnalysisFacts<'_>) -> Record {
    let AnalysisFacts { report, quantities, .. } = facts;
    row.add("kind", report.kind.name());
    row.add("analysis", facts.analysis.as_str());
    row.add("trials_combined", facts.trials);
    for own in quantities {
        let name = column(own);
        row.add_interval(&name, own.value, own.interval_95);
        row.add(format!("trust_{name}"), own.trust.level.name());
    }
    row.add("cost", report.result.get("cost").and_then(Value::as_f64));
    controllers(&mut row, &report.result, facts.position);
    let codes: Vec<&str> = report.warnings.iter().map(|warning| warning.code.as_str()).collect();
    row.add("warnings", codes.join(" "));
    row.add("seed", report.provenance.seed);
    row.add("spec_sha256", report.provenance.spec_sha256.as_str());
    row.add("result_sha256", report.provenance.result_sha256.as_str());
    row.add("report_schema", report.schema.as_str());
    row.add("product_version", report.provenance.product_version.as_str());
    row.add("analysed_at", facts.created_at.as_str());
    row
}

/// A row: of a trial with an analysis, or of a trial that has none.
#[must_use]
pub fn row(trial: &TrialFacts<'_>, analysis: Option<&AnalysisFacts<'_>>) -> Record {
    let row = of_trial(trial);
    match analysis {
        Some(analysis) => with_analysis(row, analysis),
        None => row,
    }
}

/// The table of these rows.
#[must_use]
pub fn table(rows: Vec<Record>) -> Table {
    rows.into_iter().collect::<Table>().beginning_with(COLUMNS)
}
