//! `volition demo`: the whole road on a simulated study.

pub mod simulate;
pub mod tables;

use super::import::progress_bar;
use super::{Answer, ask};
use crate::analysis::ids::{StudyId, TrialId};
use crate::analysis::report::sha256_json;
use crate::analysis::{Plan, Request};
use crate::config::CacheArgs;
use crate::jobs::Status;
use crate::learning::StudyLearningCurves;
use crate::plants::Plant;
use crate::simulate::SimulatedStudy;
use crate::store::{AnalysisFilter, AnalysisRecord, NewAnalysis, Page, Store};
use crate::worker::{Analyses, Worker, WorkerSettings};
use anyhow::{Context as _, bail};
use clap::Args;
use indicatif::ProgressBar;
use serde_json::json;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// The trials that are simulated, out of a practice of forty (Zhang 2015, section 5.2).
const TRIALS: [u32; 6] = [1, 5, 10, 20, 30, 40];

/// The band of the command, 0 to 0.5 Hz, over which norms are taken (Zhang 2015, section 5.7).
const BAND_RAD_S: (f64, f64) = (0.0, std::f64::consts::PI);

/// How often the queue is looked at for the progress bar.
const LOOK: Duration = Duration::from_millis(100);

/// What the demonstration does.
#[derive(Debug, Clone, Args)]
pub struct DemoArgs {
    /// Keep the study in this database file; by default it goes to a temporary one that is deleted at the end.
    #[arg(long, value_name = "FILE")]
    pub database: Option<PathBuf>,
    /// Add the study even if the database holds others already.
    #[arg(long, requires = "database")]
    pub force: bool,
    /// Who the simulated subjects are and what they do.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Subjects in each of the two groups.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=99))]
    pub subjects: u16,
    /// Compute threads; by default one for each processor.
    #[arg(long, value_name = "N")]
    pub compute_threads: Option<usize>,
    /// Where pools and trees wait for the next time.
    #[command(flatten)]
    pub cache: CacheArgs,
}

/// Simulates, stores, identifies, and prints the learning curves; fails (exit code 1) when an analysis failed.
///
/// # Errors
/// When the database holds studies already (without `--force`) or fails, or the person interrupts.
pub async fn demo(args: &DemoArgs) -> anyhow::Result<ExitCode> {
    let (folder, path) = match &args.database {
        Some(path) => (None, path.clone()),
        None => {
            let folder = TemporaryFolder::new()?;
            let path = folder.0.join("demo.db");
            (Some(folder), path)
        }
    };
    let store = Store::open(Some(&path)).await?;
    let mut out = std::io::stdout();
    let outcome = tokio::select! {
        outcome = run(args, &store, &mut out) => outcome,
        _ = tokio::signal::ctrl_c() => Err(anyhow::anyhow!("interrupted")),
    };
    store.close().await;
    drop(folder);
    outcome
}

/// The demonstration in a given store, printed to `out`.
///
/// # Errors
/// As [`demo`].
pub async fn run(args: &DemoArgs, store: &Store, out: &mut impl Write) -> anyhow::Result<ExitCode> {
    if !args.force && !store.studies(Page { after: None, limit: 1 }).await?.is_empty() {
        bail!("the database holds studies already; choose another file, or add to it with --force");
    }
    let simulated =
        Arc::new(SimulatedStudy::two_groups(usize::from(args.subjects), TRIALS[TRIALS.len() - 1], args.seed)?);
    let truth = simulate::truth(&simulated, &TRIALS, BAND_RAD_S)?;
    let bar = progress_bar("trials simulated");
    let stored = simulate::store_study(store, simulated, &TRIALS, args.seed, &bar).await;
    bar.finish_and_clear();
    let stored = stored?;

    let requests: Vec<NewAnalysis> =
        stored.trials.iter().map(|(trial, plant)| request(stored.study, *trial, *plant)).collect::<Result<_, _>>()?;
    store.create_analyses(requests, None).await?;
    let began = Instant::now();
    let finished = work(store, stored.study, args).await?;
    let seconds = began.elapsed().as_secs_f64();

    let curves = learning_curves(store, stored.study).await?;
    let trials: Vec<String> = TRIALS.iter().map(u32::to_string).collect();
    writeln!(
        out,
        "Study {:?}: 2 groups of {} simulated subjects, trials {} of {}, a 60 s chirp of 0 to 0.5 Hz",
        stored.name,
        args.subjects,
        trials.join(", "),
        TRIALS[TRIALS.len() - 1]
    )?;
    let failed: Vec<&AnalysisRecord> = finished.iter().filter(|a| a.status != Status::Succeeded).collect();
    let succeeded = finished.len() - failed.len();
    writeln!(
        out,
        "Subsystem identification: {succeeded} of {} trials in {seconds:.1} s, pool {}",
        finished.len(),
        pool()
    )?;
    tables::print(out, &curves, &truth)?;
    tables::print_reading(out, &curves)?;
    for analysis in &failed {
        let why = analysis.problem.as_ref().map_or_else(|| "no reason given".to_owned(), ToString::to_string);
        writeln!(out, "analysis {} {}: {why}", analysis.id, analysis.status.name())?;
    }
    match &args.database {
        Some(path) => writeln!(out, "\nKept in {0}: volition serve --database {0}", path.display())?,
        None => {
            writeln!(out, "\nNothing is kept; --database FILE keeps the study, for `volition serve --database FILE`.")?
        }
    }
    Ok(if failed.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// How every trial is identified: the sampled pool of Zhang 2015, appendix C, thinned to what a laptop searches in a
/// second.
fn pool() -> serde_json::Value {
    json!({"name": "zhang2015_appendix_c", "thin": {"poles": 12, "zeros": 12, "damping": 6, "gains": 3}})
}

/// The degree of the FIR feedforward that comes within 0.1 % of the inverse dynamics (Zhang 2015, section 5.6.2: 2 for
/// a minimum-phase plant, 6 for a nonminimum-phase one).
fn feedforward_degree(plant: Plant) -> u32 {
    if plant == Plant::MinimumPhase { 2 } else { 6 }
}

fn request(study: StudyId, trial: TrialId, plant: Plant) -> anyhow::Result<NewAnalysis> {
    let degree = feedforward_degree(plant);
    let spec =
        json!({"pool": pool(), "feedforward_numerator_degree": degree, "feedforward_denominator_degree": degree});
    let written = Request { kind: "ssid".to_owned(), inputs: json!({"trial": trial}), spec };
    let plan = Plan::parse(&written).context("the demonstration's own request is refused")?;
    let request = plan.request();
    let references = plan.references();
    Ok(NewAnalysis {
        study: Some(study),
        kind: plan.kind(),
        spec_sha256: sha256_json(&request.spec),
        request,
        trials: references.trials,
        plants: references.plants,
    })
}

/// Runs a worker until every analysis of the study is finished.
async fn work(store: &Store, study: StudyId, args: &DemoArgs) -> anyhow::Result<Vec<AnalysisRecord>> {
    let settings = WorkerSettings { compute_threads: args.compute_threads.unwrap_or(0), ..WorkerSettings::default() };
    let pools = args.cache.pools(args.database.as_deref());
    let worker = Worker::new(store.clone(), Arc::new(Analyses::new(pools)), settings)?;
    let stop = CancellationToken::new();
    // Dropped with this future when the person interrupts, which stops the worker too.
    let _stop_on_drop = stop.clone().drop_guard();
    let running = tokio::spawn({
        let stop = stop.clone();
        async move { worker.run(stop).await }
    });
    let bar = progress_bar("trials identified");
    let finished = watch(store, study, &bar).await;
    bar.finish_and_clear();
    stop.cancel();
    running.await?;
    finished
}

async fn watch(store: &Store, study: StudyId, bar: &ProgressBar) -> anyhow::Result<Vec<AnalysisRecord>> {
    let filter = AnalysisFilter { study: Some(study), ..AnalysisFilter::default() };
    loop {
        let mut all: Vec<AnalysisRecord> = Vec::new();
        loop {
            let page = Page { after: all.last().map(|a| a.id.0), limit: 500 };
            let next = store.analyses(filter.clone(), page).await?;
            let last = next.len() < 500;
            all.extend(next);
            if last {
                break;
            }
        }
        let waiting = all.iter().filter(|a| matches!(a.status, Status::Queued | Status::Running)).count();
        bar.set_length(all.len() as u64);
        bar.set_position((all.len() - waiting) as u64);
        if waiting == 0 {
            return Ok(all);
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// The answer of the API itself (without a network), so that the demonstration prints what a client reads.
async fn learning_curves(store: &Store, study: StudyId) -> anyhow::Result<StudyLearningCurves> {
    match ask(store, &format!("/v1/studies/{study}/learning-curves")).await? {
        Answer::Body(body) => serde_json::from_slice(&body).context("the learning curves cannot be read"),
        Answer::Problem(body) => bail!("the learning curves were refused: {}", String::from_utf8_lossy(&body)),
    }
}

/// A folder of our own that goes when this does.
struct TemporaryFolder(PathBuf);

impl TemporaryFolder {
    fn new() -> anyhow::Result<Self> {
        let path = std::env::temp_dir().join(format!("volition-demo-{}", uuid::Uuid::now_v7()));
        std::fs::create_dir(&path).with_context(|| format!("cannot make the folder {}", path.display()))?;
        Ok(Self(path))
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // What cannot be removed is left to the system's own cleaning of temporary files.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
