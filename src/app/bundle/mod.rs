//! A study in one file: `volition export STUDY FILE.zip`, and what `volition import FILE.zip` does with it.

pub mod motion_bids;
pub mod take_in;

use super::{Answer, ask, find_study};
use crate::analysis::Problem;
use crate::analysis::ids::{StudyId, TrialId};
use crate::exchange::bundle::BundleWriter;
use crate::store::{Store, StoredAnalysis, StoredRow, StudyTable};
use crate::trial::write;
use anyhow::{Context as _, bail};
use clap::Args;
use serde_json::{Map, Value};
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Analyses read at once.
const AT_ONCE: u32 = 20;

/// What stands in the place of a report in the list of analyses.
const LINKS: [&str; 2] = ["trials", "plants"];

/// Which study, and where to.
#[derive(Debug, Clone, Args)]
pub struct ExportArgs {
    /// The study, by id or by name.
    pub study: String,
    /// The file that is written (a .zip), or with --motion-bids the folder; neither may be there yet.
    pub target: PathBuf,
    /// Database file.
    #[arg(long, value_name = "FILE", default_value = "volition.db", env = "VOLITION_DATABASE")]
    pub database: PathBuf,
    /// Write the recordings as a folder of Motion-BIDS, without analyses.
    #[arg(long)]
    pub motion_bids: bool,
    /// The name of the task in names of files of Motion-BIDS: letters and digits.
    #[arg(long, value_name = "NAME", default_value = "tracking")]
    pub task: String,
}

/// Exports.
///
/// # Errors
/// When there is no such database or study, something in it is damaged, or the target cannot be written.
pub async fn export(args: &ExportArgs) -> anyhow::Result<ExitCode> {
    if !args.database.exists() {
        bail!("there is no database {}; name it with --database", args.database.display());
    }
    if args.target.exists() {
        bail!("{} is there already; name another, or remove it", args.target.display());
    }
    let store = Store::open(Some(&args.database)).await?;
    let outcome = async {
        let study: StudyId = find_study(&store, &args.study).await?.parse()?;
        if args.motion_bids {
            motion_bids::write(&store, study, &args.target, &args.task).await
        } else {
            write_file(&store, study, &args.target).await
        }
    }
    .await;
    store.close().await;
    let said = outcome?;
    writeln!(std::io::stdout().lock(), "{said}")?;
    Ok(ExitCode::SUCCESS)
}

/// In words, with the place and the way on.
pub(crate) fn said(problem: Problem) -> anyhow::Error {
    let place = problem.location.map_or_else(String::new, |place| format!("{place}: "));
    let mend = problem.mend.map_or_else(String::new, |mend| format!(". {mend}"));
    anyhow::anyhow!("{place}{}: {}{mend}", problem.title, problem.detail)
}

async fn write_file(store: &Store, study: StudyId, target: &Path) -> anyhow::Result<String> {
    // Beside its target, so that nobody takes a half for a whole.
    let mut partial = target.as_os_str().to_owned();
    partial.push(".part");
    let partial = PathBuf::from(partial);
    let outcome = write_to(store, study, &partial).await;
    match &outcome {
        Ok(_) => std::fs::rename(&partial, target).with_context(|| format!("cannot write {}", target.display()))?,
        Err(_) => drop(std::fs::remove_file(&partial)),
    }
    outcome.map(|said| format!("{said} in {}", target.display()))
}

fn id_of(row: &StoredRow) -> &str {
    row.get("id").and_then(Value::as_str).unwrap_or_default()
}

/// A JSON object a line.
fn lines<'a>(rows: impl IntoIterator<Item = &'a StoredRow>) -> anyhow::Result<Vec<u8>> {
    let mut text = Vec::new();
    for row in rows {
        serde_json::to_writer(&mut text, row)?;
        text.push(b'\n');
    }
    Ok(text)
}

/// An analysis as its line says it: its row, and what it refers to.
fn line_of(own: &StoredAnalysis) -> StoredRow {
    let mut line: Map<String, Value> = own.row.clone();
    for (name, ids) in LINKS.into_iter().zip([&own.trials, &own.plants]) {
        line.insert(name.to_owned(), ids.clone().into());
    }
    line
}

async fn write_to(store: &Store, study: StudyId, partial: &Path) -> anyhow::Result<String> {
    let cannot = || format!("cannot write {}", partial.display());
    let file = File::options().read(true).write(true).create(true).truncate(true).open(partial).with_context(cannot)?;
    let mut bundle = BundleWriter::new(file);
    let record = store.study(study).await?;
    bundle.add("README.md", readme(&record.name).as_bytes()).map_err(said)?;
    let mut analyses = Vec::new();
    let (mut after, mut reports): (Option<String>, usize) = (None, 0);
    loop {
        let some = store.stored_analyses(study, after.as_deref(), AT_ONCE).await?;
        let Some(last) = some.last() else { break };
        after = Some(last.id().to_owned());
        for own in some {
            if let Some(report) = &own.report {
                bundle.add(&format!("reports/{}.json", own.id()), report.as_bytes()).map_err(said)?;
                reports += 1;
            }
            analyses.push(line_of(&own));
        }
    }
    bundle.add("analyses.ndjson", &lines(&analyses)?).map_err(said)?;
    let mut trials = 0;
    for table in StudyTable::ALL {
        let rows = store.stored_rows(study, table).await?;
        bundle.add(&format!("{}.ndjson", table.name()), &lines(&rows)?).map_err(said)?;
        if table == StudyTable::Trials {
            for row in &rows {
                let id: TrialId = id_of(row).parse()?;
                let trial = store.trial_signals(id).await?;
                let mut text = Vec::new();
                write::csv(&trial, &mut text)?;
                bundle.add(&format!("signals/{id}.csv"), &text).map_err(said)?;
                trials += 1;
            }
        }
    }
    match ask(store, &format!("/v1/studies/{study}/table?format=csv")).await? {
        Answer::Body(table) => bundle.add("table.csv", &table).map_err(said)?,
        Answer::Problem(body) => bail!("the table cannot be made: {}", String::from_utf8_lossy(&body)),
    }
    bundle.finish().map_err(said)?.sync_all().with_context(cannot)?;
    Ok(format!("study {:?} ({study}): {trials} trials, {} analyses, {reports} reports", record.name, analyses.len()))
}

/// What somebody reads who has only the file.
fn readme(name: &str) -> String {
    format!(
        "# {name}\n\n\
         A study of human motor control, exported by Volition: its recordings, and every analysis of them that came to \
         an end.\n\n\
         - `table.csv`: everything at a glance, a row for each trial and analysis. Values have the ends of their 95 % \
         intervals beside them (`_low`, `_high`), and `trust_…` says how far each may be used.\n\
         - `signals/ID.csv`: the recording of a trial: time t (s) where it was recorded, command r, control u, output \
         y, disturbance d. Every number reads back as the same double. The sample time is in `trials.ndjson`.\n\
         - `studies.ndjson`, `plants.ndjson`, `subjects.ndjson`, `trials.ndjson`: who, what, how; a JSON object a \
         line. Times are microseconds since 1970 UTC. Subjects have pseudonyms.\n\
         - `analyses.ndjson`: what was asked (`request`), with the hashes of request and spec, and what became of it.\n\
         - `reports/ID.json`: the report of each analysis, byte for byte, with warnings and provenance.\n\
         - `manifest.json`: length and SHA-256 of every file. The archive's comment is the SHA-256 of all bytes before \
         it.\n\n\
         `volition import FILE.zip` takes it into another database under the same ids, after every hash was verified; \
         with `--recompute` it computes one analysis again and compares. Analyses that were waiting or running are not \
         here.\n"
    )
}
