//! `volition run SPEC.json`: one analysis without a server or a database.

mod summary;

use super::exit::{FAILED, INTERRUPTED, REFUSED};
use super::recordings;
use crate::analysis::{Code, Failure, Library, Plan, Problem, Request, samples};
use crate::config::CacheArgs;
use crate::ctl::{Bracket, Ctl, StopReason};
use crate::worker::compute;
use indicatif::{ProgressBar, ProgressStyle};
use std::fs::File;
use std::io::{IsTerminal as _, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

/// A document larger than this is no spec; trials inline at 1 kHz for an hour fit.
const MAX_DOCUMENT_BYTES: u64 = 512 << 20;

/// What `volition run` is asked for.
#[derive(Debug, Clone, clap::Args)]
pub struct RunArgs {
    /// A JSON document {"kind", "inputs", "spec"}; `-` reads standard input. A trial in it may be the path of a
    /// recording, relative to the document.
    pub spec: PathBuf,
    /// Compute threads; 0 for one on each processor.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub compute_threads: usize,
    /// Write the samples that the report carries as CSV, in place of the report.
    #[arg(long, conflicts_with_all = ["json", "summary"])]
    pub csv: bool,
    /// Write the whole report as JSON, as is done where standard output is no terminal.
    #[arg(long, conflicts_with = "summary")]
    pub json: bool,
    /// Write a summary for people, as is done where standard output is a terminal.
    #[arg(long)]
    pub summary: bool,
    /// Where pools and trees wait for the next time.
    #[command(flatten)]
    pub cache: CacheArgs,
}

/// Executes the document, writes the report to standard output or the problem to standard error, and says how it went
/// by its exit code: 0, 1 (failed), 2 (bad input) or 130 (interrupted).
///
/// # Errors
/// Only when standard output cannot be written or a thread cannot be started.
pub fn run(args: &RunArgs) -> anyhow::Result<ExitCode> {
    let RunArgs { spec: path, compute_threads, csv, json, summary: for_people, cache } = args;
    let plan = match read(path).and_then(|text| parse(&text, folder_of(path))) {
        Ok(plan) => plan,
        Err(problem) => return refuse(&problem, REFUSED),
    };
    let library = Library { pools: cache.pools(None), ..Library::default() };
    let ctl = Arc::new(Ctl::new());
    stop_on_ctrl_c(Arc::clone(&ctl))?;
    let bar = watch(&ctl);
    let (outcome, _) = compute::run_plan(&plan, &library, &ctl, *compute_threads);
    bar.finish_and_clear();
    match outcome {
        Ok(report) if *csv => match samples::csv(&report) {
            Ok(text) => {
                std::io::stdout().lock().write_all(text.as_bytes())?;
                Ok(ExitCode::SUCCESS)
            }
            Err(problem) => refuse(&problem, REFUSED),
        },
        Ok(report) => {
            let mut out = std::io::stdout().lock();
            if *for_people || (!json && out.is_terminal()) {
                out.write_all(summary::summary(&report).as_bytes())?;
            } else {
                serde_json::to_writer_pretty(&mut out, &report)?;
                writeln!(out)?;
            }
            Ok(ExitCode::SUCCESS)
        }
        Err(Failure::Problem(problem)) => {
            let code = if blames_the_input(problem.code) { REFUSED } else { FAILED };
            refuse(&problem, code)
        }
        Err(Failure::Stopped(stopped) | Failure::Interrupted { stopped, .. }) => {
            let found = ctl.bracket().map_or_else(String::new, |bracket| {
                let Bracket { incumbent, bound, index } = bracket;
                format!(
                    "; the best candidate until then is {index} with the cost {incumbent:e}, and none costs less \
                    than {bound:e}"
                )
            });
            let problem = Problem::new(Code::DeadlineExceeded, "the analysis was stopped", format!("{stopped}{found}"))
                .mend("Run it again and let it finish.");
            refuse(&problem, INTERRUPTED)
        }
    }
}

fn blames_the_input(code: Code) -> bool {
    matches!(
        code,
        Code::Malformed | Code::Invalid | Code::BadSignal | Code::NotFound | Code::TooLarge | Code::Unaffordable
    )
}

fn refuse(problem: &Problem, code: u8) -> anyhow::Result<ExitCode> {
    let mut err = std::io::stderr().lock();
    serde_json::to_writer_pretty(&mut err, problem)?;
    writeln!(err)?;
    Ok(ExitCode::from(code))
}

fn read(path: &Path) -> Result<String, Problem> {
    let unreadable = |error: std::io::Error| {
        Problem::new(Code::Malformed, "the document cannot be read", error.to_string())
            .at(path.display().to_string())
            .mend("Give the path of a JSON document in UTF-8, or - for standard input.")
    };
    let source: Box<dyn std::io::Read> = if path == Path::new("-") {
        Box::new(std::io::stdin().lock())
    } else {
        Box::new(File::open(path).map_err(unreadable)?)
    };
    let mut text = String::new();
    source.take(MAX_DOCUMENT_BYTES + 1).read_to_string(&mut text).map_err(unreadable)?;
    if text.len() as u64 > MAX_DOCUMENT_BYTES {
        return Err(Problem::new(
            Code::TooLarge,
            "the document is too large",
            format!("it has more than {MAX_DOCUMENT_BYTES} bytes"),
        )
        .at(path.display().to_string())
        .mend("Upload the trials to a server and name them by id."));
    }
    Ok(text)
}

/// Where files that a document names are looked for: beside it.
fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new(""))
}

fn parse(text: &str, folder: &Path) -> Result<Plan, Problem> {
    let mut request: Request = serde_json::from_str(text).map_err(|error| {
        Problem::new(Code::Malformed, "the document is no analysis request", error.to_string())
            .at(format!("line {}, column {}", error.line(), error.column()))
            .mend("Write one JSON object {\"kind\", \"inputs\", \"spec\"}.")
    })?;
    recordings::put_in(&mut request.inputs, folder, "/inputs")?;
    let plan = Plan::parse(&request)?;
    if plan.references().is_empty() {
        return Ok(plan);
    }
    Err(Problem::new(
        Code::Invalid,
        "there is no database here",
        "the inputs name stored trials or plants by id, and `run` works without a database",
    )
    .at("/inputs")
    .mend(
        "Put the data itself, or the path of a file in a trial's place, into the inputs; or post the document to a \
         server at /v1/analyses.",
    ))
}

fn stop_on_ctrl_c(ctl: Arc<Ctl>) -> std::io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    std::thread::Builder::new().name("ctrl-c".to_owned()).spawn(move || {
        if runtime.block_on(tokio::signal::ctrl_c()).is_ok() {
            ctl.stop(StopReason::Cancelled);
        }
    })?;
    Ok(())
}

/// How finely the progress bar is divided.
const PERMILLE: u64 = 1000;

/// A progress bar on standard error (hidden where that is no terminal), fed from `ctl` by a thread of its own.
fn watch(ctl: &Arc<Ctl>) -> ProgressBar {
    let bar = ProgressBar::new(PERMILLE);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {percent:>3} %  {msg}  {eta} left") {
        bar.set_style(style);
    }
    let (shown, ctl) = (bar.clone(), Arc::clone(ctl));
    // The bar is decoration: where no thread can be had, the analysis runs without it.
    let _ = std::thread::Builder::new().name("progress".to_owned()).spawn(move || {
        while !shown.is_finished() {
            let progress = ctl.progress();
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            shown.set_position((progress.fraction * PERMILLE as f64) as u64);
            shown.set_message(progress.phase.name());
            std::thread::sleep(Duration::from_millis(100));
        }
    });
    bar
}
