//! `volition table STUDY`: a study as one tidy table, and what is said about its groups as tables.

use super::{Answer, ask, encoded, find_study};
use crate::store::Store;
use anyhow::{Context as _, bail};
use clap::{Args, ValueEnum};
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

/// The request makes no sense.
const REFUSED: u8 = 2;

/// What the table is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TableOf {
    /// A row for each trial and analysis.
    Trials,
    /// A row for each group, plant, trial number and metric.
    LearningCurves,
    /// A row for each group, part of the loop and frequency.
    FrequencyResponses,
    /// A row for each mean, person's value and difference.
    Comparison,
}

/// How a table is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TableForm {
    /// Comma-separated values with a header.
    Csv,
    /// A JSON object a line.
    Ndjson,
}

/// Which table of which study.
#[derive(Debug, Clone, Args)]
pub struct TableArgs {
    /// The study, by id or by name.
    pub study: String,
    /// Database file.
    #[arg(long, value_name = "FILE", default_value = "volition.db", env = "VOLITION_DATABASE")]
    pub database: PathBuf,
    /// What the table is of.
    #[arg(long, value_enum, default_value = "trials")]
    pub of: TableOf,
    /// How it is written.
    #[arg(long, value_enum, default_value = "csv")]
    pub format: TableForm,
    /// A parameter of the request, such as kind=ssid or estimator=two_stimulus; may be repeated.
    #[arg(long = "with", value_name = "NAME=VALUE")]
    pub with: Vec<String>,
    /// The file that is written; without it, standard output.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Writes the table, and says by the exit code whether the request was refused (2).
///
/// # Errors
/// When there is no such database or study, the database fails, or the file cannot be written.
pub async fn table(args: &TableArgs) -> anyhow::Result<ExitCode> {
    if !args.database.exists() {
        bail!("there is no database {}; name it with --database", args.database.display());
    }
    let store = Store::open(Some(&args.database)).await?;
    let outcome = write(args, &store).await;
    store.close().await;
    outcome
}

async fn write(args: &TableArgs, store: &Store) -> anyhow::Result<ExitCode> {
    let study = find_study(store, &args.study).await?;
    let name = match args.of {
        TableOf::Trials => "table",
        TableOf::LearningCurves => "learning-curves",
        TableOf::FrequencyResponses => "frequency-responses",
        TableOf::Comparison => "comparison",
    };
    let form = match args.format {
        TableForm::Csv => "csv",
        TableForm::Ndjson => "ndjson",
    };
    let mut path = format!("/v1/studies/{study}/{name}?format={form}");
    for parameter in &args.with {
        let (name, value) =
            parameter.split_once('=').with_context(|| format!("--with {parameter} is no NAME=VALUE"))?;
        path.push_str(&format!("&{}={}", encoded(name), encoded(value)));
    }
    match ask(store, &path).await? {
        Answer::Body(body) => {
            match &args.out {
                Some(file) => std::fs::write(file, body).with_context(|| format!("cannot write {}", file.display()))?,
                None => io::stdout().lock().write_all(&body)?,
            }
            Ok(ExitCode::SUCCESS)
        }
        Answer::Problem(body) => {
            let mut err = io::stderr().lock();
            err.write_all(&body)?;
            writeln!(err)?;
            Ok(ExitCode::from(REFUSED))
        }
    }
}
