//! A bundle into a database, under the same ids.

use super::{LINKS, id_of, said};
use crate::analysis::ids::{AnalysisId, TrialId};
use crate::analysis::{Failure, Plan, Report};
use crate::ctl::Ctl;
use crate::exchange::bundle::{Bundle, is_one};
use crate::exchange::{self, Options};
use crate::store::{Store, StoredAnalysis, StoredRow, StudyTable};
use crate::trial::Trial;
use crate::worker::compute;
use anyhow::{Context as _, bail};
use serde_json::Value;
use std::fs::File;
use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;

/// Something was refused, or a report came out otherwise.
const REFUSED: u8 = 2;

/// Whether a file is a bundle; a folder, and an archive of recordings, are none.
#[must_use]
pub fn is_bundle(path: &Path) -> bool {
    path.is_file() && File::open(path).is_ok_and(is_one)
}

/// What is taken in, and what is computed again.
#[derive(Debug, Clone, Copy)]
pub struct TakeIn<'a> {
    /// The bundle.
    pub file: &'a Path,
    /// The database, made if it does not exist.
    pub database: &'a Path,
    /// The analysis that is computed again: an id, or nothing for the first that succeeded.
    pub recompute: Option<Option<&'a str>>,
}

/// Verifies a bundle, takes it in, and computes an analysis again where that is asked for.
///
/// # Errors
/// When the database fails.
pub async fn take_in(ask: TakeIn<'_>) -> anyhow::Result<ExitCode> {
    let cannot = || format!("cannot read {}", ask.file.display());
    let mut bundle = match Bundle::open(File::open(ask.file).with_context(cannot)?) {
        Ok(bundle) => bundle,
        Err(problem) => return refuse(&said(problem)),
    };
    let store = Store::open(Some(ask.database)).await?;
    let outcome = async {
        let taken = match write(&store, &mut bundle).await {
            Ok(taken) => taken,
            Err(why) => return refuse(&why),
        };
        let head = format!("study {:?} ({}) in {}", taken.name, taken.study, ask.database.display());
        let counts = format!("{} trials, {} analyses, every hash verified", taken.trials, taken.analyses.len());
        writeln!(std::io::stdout().lock(), "{head}\n  {counts}")?;
        match ask.recompute {
            Some(wanted) => recompute(&store, &taken, wanted).await,
            None => Ok(ExitCode::SUCCESS),
        }
    }
    .await;
    store.close().await;
    outcome
}

fn refuse(why: &anyhow::Error) -> anyhow::Result<ExitCode> {
    writeln!(std::io::stderr().lock(), "volition: {why:#}")?;
    Ok(ExitCode::from(REFUSED))
}

struct Taken {
    study: String,
    name: String,
    trials: usize,
    /// Analyses that came to a report, and the others.
    analyses: Vec<(String, bool)>,
}

/// The rows of a file, a JSON object a line.
fn rows(bytes: &[u8], name: &str) -> anyhow::Result<Vec<StoredRow>> {
    let text = std::str::from_utf8(bytes).with_context(|| format!("{name} is no UTF-8"))?;
    let row = |(line, text): (usize, &str)| {
        serde_json::from_str(text).with_context(|| format!("{name}, line {}, is no JSON object", line + 1))
    };
    text.lines().enumerate().map(row).collect()
}

/// Takes the list of what an analysis refers to out of its line.
fn links(row: &mut StoredRow, name: &str) -> Vec<String> {
    let list = row.remove(name);
    let list = list.as_ref().and_then(Value::as_array).into_iter().flatten();
    list.filter_map(Value::as_str).map(str::to_owned).collect()
}

/// The recording of a trial, as its row says.
fn recording(row: &StoredRow, bytes: &[u8], name: &str) -> anyhow::Result<Trial> {
    let sample_time_s = row.get("sample_time_s").and_then(Value::as_f64).context("a trial has no sample time")?;
    let options = Options { sample_time_s: Some(sample_time_s), ..Options::default() };
    let reading = exchange::read(bytes, &options).map_err(said).with_context(|| name.to_owned())?;
    // With the bits of the row: what times say may differ in the last digit.
    Trial::new(sample_time_s, reading.trial.signals).with_context(|| name.to_owned())
}

async fn write(store: &Store, bundle: &mut Bundle<File>) -> anyhow::Result<Taken> {
    let mut taking = store.take_in().await?;
    let mut taken = Taken { study: String::new(), name: String::new(), trials: 0, analyses: Vec::new() };
    for table in StudyTable::ALL {
        let name = format!("{}.ndjson", table.name());
        for row in rows(&bundle.file(&name).map_err(said)?, &name)? {
            taking.row(table, &row).await.with_context(|| name.clone())?;
            match table {
                StudyTable::Studies => {
                    taken.study = id_of(&row).to_owned();
                    taken.name = row.get("name").and_then(Value::as_str).unwrap_or_default().to_owned();
                }
                StudyTable::Trials => {
                    let id: TrialId = id_of(&row).parse()?;
                    let name = format!("signals/{id}.csv");
                    let bytes = bundle.file(&name).map_err(said)?;
                    taking.signals(id, recording(&row, &bytes, &name)?).await.with_context(|| name.clone())?;
                    taken.trials += 1;
                }
                StudyTable::Plants | StudyTable::Subjects => {}
            }
        }
    }
    let name = "analyses.ndjson";
    for mut row in rows(&bundle.file(name).map_err(said)?, name)? {
        let [trials, plants] = LINKS.map(|list| links(&mut row, list));
        let has_report = row.get("report_sha256").is_some_and(Value::is_string);
        let report = format!("reports/{}.json", id_of(&row));
        let report = if has_report {
            Some(
                String::from_utf8(bundle.file(&report).map_err(said)?)
                    .with_context(|| format!("{report} is no UTF-8"))?,
            )
        } else {
            None
        };
        let own = StoredAnalysis { row, trials, plants, report };
        taking.analysis(&own).await.with_context(|| name.to_owned())?;
        taken.analyses.push((own.id().to_owned(), has_report));
    }
    taking.finish().await?;
    Ok(taken)
}

/// Computes an analysis again and compares what comes out with its report.
async fn recompute(store: &Store, taken: &Taken, wanted: Option<&str>) -> anyhow::Result<ExitCode> {
    let mut reported = taken.analyses.iter().filter(|(_, has_report)| *has_report).map(|(id, _)| id.as_str());
    let found = match wanted {
        Some(wanted) => reported.find(|id| *id == wanted),
        None => reported.next(),
    };
    let Some(id) = found else {
        let which = wanted.map_or_else(|| "no analysis of it".to_owned(), |id| format!("no analysis {id} of it"));
        bail!("the study is taken in, but {which} has a report to compute again");
    };
    let id: AnalysisId = id.parse()?;
    let record = store.analysis(id).await?;
    let text = store.report_json(id).await?.context("the report is missing")?;
    let stored: Report = serde_json::from_str(&text)?;
    let plan = Plan::parse(&record.request).map_err(said)?;
    let library = store.library(&plan.references()).await?;
    let outcome = tokio::task::spawn_blocking(move || compute::run_plan(&plan, &library, &Ctl::new(), 0).0).await?;
    let again = match outcome {
        Ok(report) => report,
        Err(Failure::Problem(problem)) => return refuse(&said(problem)),
        Err(other) => return refuse(&other.into()),
    };
    let (before, after) = (&stored.provenance, &again.provenance);
    let mut out = std::io::stdout().lock();
    let kind = stored.kind;
    if before.result_sha256 == after.result_sha256 {
        writeln!(out, "  computed analysis {id} ({kind}) again: the same result, {}", after.result_sha256)?;
        return Ok(ExitCode::SUCCESS);
    }
    writeln!(
        out,
        "  computed analysis {id} ({kind}) again: another result, {} (version {}) where the report has {} (version {})",
        after.result_sha256, after.product_version, before.result_sha256, before.product_version
    )?;
    Ok(ExitCode::from(REFUSED))
}
