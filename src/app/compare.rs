//! `volition compare STUDY`: the groups of a study, from its database.

use super::{Answer, ask, encoded, find_study};
use crate::learning::StudyComparison;
use crate::learning::comparison::people::Contrast;
use crate::learning::comparison::report::ComparedGroup;
use crate::learning::comparison::text::{number, symbol};
use crate::store::Store;
use anyhow::{Context as _, bail};
use clap::Args;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

/// The request makes no sense.
const REFUSED: u8 = 2;
const CELL: usize = 26;

/// Which study, and how its groups are compared: the parameters of `GET /v1/studies/{study}/comparison`.
#[derive(Debug, Clone, Args)]
pub struct CompareArgs {
    /// The study, by id or by name.
    pub study: String,
    /// Database file.
    #[arg(long, value_name = "FILE", default_value = "volition.db", env = "VOLITION_DATABASE")]
    pub database: PathBuf,
    /// Only these groups.
    #[arg(long, value_name = "NAME,NAME")]
    pub groups: Option<String>,
    /// Only trials on this plant, by id.
    #[arg(long, value_name = "ID")]
    pub plant: Option<String>,
    /// Only trials of this session.
    #[arg(long, value_name = "N")]
    pub session: Option<String>,
    /// Only identifications with this spec_sha256.
    #[arg(long, value_name = "SHA256")]
    pub spec: Option<String>,
    /// The metrics: mean_abs_error, rms_error, norm_feedback, norm_feedforward_minus_inverse,
    /// norm_feedforward_plant_minus_one, variance_accounted_for, control_log_dimensionless_jerk.
    #[arg(long, value_name = "NAME,NAME")]
    pub metrics: Option<String>,
    /// What is compared of each: first, last, change, retention.
    #[arg(long, value_name = "NAME,NAME")]
    pub contrasts: Option<String>,
    /// What a person's first and last value are: exponential, power, or trials.
    #[arg(long, value_name = "NAME")]
    pub curve: Option<String>,
    /// How p-values are adjusted: holm or benjamini_hochberg.
    #[arg(long, value_name = "NAME")]
    pub correction: Option<String>,
    /// People whose value is an extrapolation: leave_out or take_in.
    #[arg(long, value_name = "NAME")]
    pub extrapolated: Option<String>,
    /// The threshold on |u| above which the first control counts.
    #[arg(long, value_name = "U")]
    pub right_control_threshold: Option<String>,
    /// Trials that retention averages over at each end, at most.
    #[arg(long, value_name = "N")]
    pub retention_trials: Option<String>,
    /// The seed of random allocations.
    #[arg(long, value_name = "N")]
    pub seed: Option<String>,
    /// Write the whole answer as JSON.
    #[arg(long)]
    pub json: bool,
}

impl CompareArgs {
    fn query(&self) -> String {
        let parameters = [
            ("groups", &self.groups),
            ("plant", &self.plant),
            ("session", &self.session),
            ("spec", &self.spec),
            ("metrics", &self.metrics),
            ("contrasts", &self.contrasts),
            ("curve", &self.curve),
            ("correction", &self.correction),
            ("extrapolated", &self.extrapolated),
            ("right_control_threshold", &self.right_control_threshold),
            ("retention_trials", &self.retention_trials),
            ("seed", &self.seed),
        ];
        let given = parameters.iter().filter_map(|(name, value)| Some(format!("{name}={}", encoded(value.as_ref()?))));
        given.collect::<Vec<_>>().join("&")
    }
}

/// Compares, prints, and says by the exit code whether the request was refused (2).
///
/// # Errors
/// When there is no such database or study, or the database fails.
pub async fn compare(args: &CompareArgs) -> anyhow::Result<ExitCode> {
    if !args.database.exists() {
        bail!("there is no database {}; name it with --database", args.database.display());
    }
    let store = Store::open(Some(&args.database)).await?;
    let outcome = print(args, &store, &mut io::stdout().lock()).await;
    store.close().await;
    outcome
}

async fn print(args: &CompareArgs, store: &Store, out: &mut impl Write) -> anyhow::Result<ExitCode> {
    let study = find_study(store, &args.study).await?;
    let path = format!("/v1/studies/{study}/comparison?{}", args.query());
    let body = match ask(store, &path).await? {
        Answer::Body(body) => body,
        Answer::Problem(body) => {
            let mut err = io::stderr().lock();
            err.write_all(&body)?;
            writeln!(err)?;
            return Ok(ExitCode::from(REFUSED));
        }
    };
    if args.json {
        out.write_all(&body)?;
        writeln!(out)?;
    } else {
        let comparison = serde_json::from_slice(&body).context("the comparison cannot be read")?;
        write(out, &comparison)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// A table of means, then what was found, in sentences.
fn write(out: &mut impl Write, comparison: &StudyComparison) -> io::Result<()> {
    if comparison.groups.is_empty() {
        return writeln!(out, "There are no trials to compare.");
    }
    writeln!(out, "Means over people with 95 % intervals (Knapp–Hartung), at the first and at the last trial")?;
    for group in &comparison.groups {
        let name = group.group.as_deref().unwrap_or("people without a group");
        let (first, last) = (group.practice.first, group.practice.last);
        writeln!(out, "\n{name} on {} ({} people, trials {first} to {last})", group.plant.name, group.people)?;
        rows(out, group)?;
    }
    writeln!(out)?;
    for finding in &comparison.findings {
        writeln!(out, "- {finding}")?;
    }
    for remark in &comparison.remarks {
        writeln!(out, "note ({}): {}", remark.code, remark.message)?;
    }
    Ok(())
}

fn rows(out: &mut impl Write, group: &ComparedGroup) -> io::Result<()> {
    for metric in &group.metrics {
        let cell = |wanted: Contrast| {
            let found = metric.contrasts.iter().find(|c| c.contrast == wanted)?;
            let Some(mean) = found.mean.as_ref().and_then(|m| m.coefficients.first()) else {
                return Some("-".to_owned());
            };
            let [low, high] = mean.interval95;
            Some(format!("{} [{}, {}]", number(mean.value), number(low), number(high)))
        };
        let cells = [("first", Contrast::First), ("last", Contrast::Last), ("change", Contrast::Change)];
        let cells = cells.into_iter().filter_map(|(name, contrast)| Some(format!("{name} {:<CELL$}", cell(contrast)?)));
        writeln!(out, "  {:<14} {}", symbol(metric.metric), cells.collect::<Vec<_>>().join(" ").trim_end())?;
    }
    Ok(())
}
