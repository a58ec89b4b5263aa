//! `volition demo`: the whole road on simulated people, whose truth is known.

pub mod page;
pub mod simulate;
pub mod story;
pub mod tables;

use super::exit::Interrupted;
use super::import::progress_bar;
use super::serve::{self, Served};
use super::{Answer, ask};
use crate::analysis::ids::{StudyId, TrialId};
use crate::analysis::report::sha256_json;
use crate::analysis::{Plan, Request};
use crate::api::{Connections, Limits};
use crate::config::{CacheArgs, DatabaseArgs, ListenArgs};
use crate::jobs::Status;
use crate::learning::inputs::Estimator;
use crate::learning::{StudyComparison, StudyLearningCurves};
use crate::plants::Plant;
use crate::simulate::SimulatedStudy;
use crate::store::{AnalysisFilter, AnalysisRecord, NewAnalysis, Page, Store};
use crate::worker::{Analyses, Worker, WorkerSettings};
use anyhow::{Context as _, bail};
use clap::Args;
use indicatif::ProgressBar;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};
use story::{Story, Way};
use tokio_util::sync::CancellationToken;

/// The trials that are simulated, out of a practice of forty (Zhang 2015, section 5.2).
pub const TRIALS: [u32; 6] = [1, 5, 10, 20, 30, 40];

/// The band of the command in Hz, over which norms are taken (Zhang 2015, section 5.7): from one period a trial.
pub const BAND_HZ: [f64; 2] = [1.0 / 60.0, 0.5];

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
    /// Write the story as a page too, which any browser shows.
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Serve the study at the end, and say where a browser finds it.
    #[arg(long)]
    pub serve: bool,
    /// Where to serve it.
    #[command(flatten)]
    pub listen: ListenArgs,
    /// Compute threads; by default one for each processor.
    #[arg(long, value_name = "N")]
    pub compute_threads: Option<usize>,
    /// Where pools and trees wait for the next time.
    #[command(flatten)]
    pub cache: CacheArgs,
}

/// Simulates the same people with one stimulus and with two, estimates every trial in several ways, and prints them
/// beside the truth; fails (exit code 1) when an analysis failed.
///
/// # Errors
/// When the database holds studies already (without `--force`) or fails, or the person interrupts.
pub async fn demo(args: &DemoArgs) -> anyhow::Result<ExitCode> {
    // Said before the work and not after it.
    args.listen.checked()?;
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
        _ = tokio::signal::ctrl_c() => Err(Interrupted.into()),
    };
    let newest = store.study_overviews(1).await;
    store.close().await;
    if let (Ok(_), Ok(newest), true) = (&outcome, &newest, args.serve) {
        let served = Served {
            address: args.listen.checked()?,
            limits: Limits::default(),
            worker: Some(WorkerSettings::default()),
            max_connections: Connections::default().at_once,
            backups: None,
            origins: Vec::new(),
            place: newest.first().map_or_else(|| "/".to_owned(), |newest| format!("/studies/{}", newest.study.id)),
        };
        serve::run(served, &DatabaseArgs { database: path, reserve_mib: 0 }, &args.cache).await?;
    }
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
    let first = SimulatedStudy::two_groups(usize::from(args.subjects), TRIALS[TRIALS.len() - 1], args.seed)?;
    let band_rad_s = BAND_HZ.map(|frequency| 2.0 * std::f64::consts::PI * frequency);
    let truth = simulate::truth(&first, &TRIALS, (band_rad_s[0], band_rad_s[1]))?;
    let bar = progress_bar("trials simulated");
    let name = format!("simulated, seed {}", args.seed);
    let second = Arc::new(first.clone().with_disturbance());
    let alone = simulate::store_study(store, Arc::new(first), &TRIALS, &name, &bar).await;
    let both = simulate::store_study(store, second, &TRIALS, &format!("{name}, two stimuli"), &bar).await;
    bar.finish_and_clear();
    let (alone, both) = (alone?, both?);

    let mut requests = Vec::new();
    for (trial, plant) in &alone.trials {
        requests.push(identification(alone.study, *trial, *plant)?);
        requests.push(prediction_error(alone.study, *trial)?);
    }
    for (trial, _) in &both.trials {
        requests.push(prediction_error(both.study, *trial)?);
    }
    store.create_analyses(requests, None).await?;
    let began = Instant::now();
    let finished = work(store, [alone.study, both.study], args).await?;
    let seconds = began.elapsed().as_secs_f64();

    let mut ways = Vec::new();
    for (study, estimator, title, stimuli) in [
        (alone.study, Estimator::Ssid, "pool, best candidate", "command alone"),
        (alone.study, Estimator::PredictionError, "prediction error", "command alone"),
        (both.study, Estimator::PredictionError, "prediction error", "two stimuli"),
    ] {
        let curves = learning_curves(store, study, estimator).await?;
        ways.push(Way { estimator, title, stimuli, curves });
    }
    let ends = [TRIALS[0], TRIALS[TRIALS.len() - 1]];
    let groups = story::groups(&ways, &truth, ends.map(i64::from));
    let failed: Vec<&AnalysisRecord> = finished.iter().filter(|a| a.status != Status::Succeeded).collect();
    let database = args.database.as_ref().map_or_else(|| "lab.db".to_owned(), |path| path.display().to_string());
    let told = Story {
        heading: vec![
            format!(
                "2 groups of {} simulated people (seed {}), trials {} of {}: a 60 s chirp of 0 to 0.5 Hz to follow, \
                 once alone and once with a disturbance of the control.",
                args.subjects,
                args.seed,
                TRIALS.map(|trial| trial.to_string()).join(", "),
                ends[1]
            ),
            format!(
                "{} of {} analyses in {seconds:.1} s; the pool of each trial is {}.",
                finished.len() - failed.len(),
                finished.len(),
                pool()
            ),
            "Values are means over people; brackets are the mean ends of each person's own 95 % interval, and no \
             interval of the mean."
                .to_owned(),
        ],
        lessons: story::lessons(&groups),
        groups,
        findings: findings(store, both.study).await?,
        next: vec![
            format!("volition demo --database {database}  # keeps the people, for the commands below"),
            format!("volition compare \"{name}, two stimuli\" --database {database}"),
            format!("volition serve --database {database}"),
        ],
    };
    if let Some(curves) = ways.last().map(|way| &way.curves) {
        tables::print(out, curves, &truth)?;
    }
    tables::print_story(out, &told)?;
    for analysis in &failed {
        let why = analysis.problem.as_ref().map_or_else(|| "no reason given".to_owned(), ToString::to_string);
        writeln!(out, "analysis {} {}: {why}", analysis.id, analysis.status.name())?;
    }
    if let Some(path) = &args.html {
        std::fs::write(path, page::page(&told)).with_context(|| format!("cannot write {}", path.display()))?;
        writeln!(out, "\nThe same as a page: {}", path.display())?;
    }
    Ok(if failed.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// How every trial is identified: the sampled pool of Zhang 2015, appendix C, thinned to what a laptop searches in a
/// second.
fn pool() -> Value {
    json!({"name": "zhang2015_appendix_c", "thin": {"poles": 12, "zeros": 12, "damping": 6, "gains": 3}})
}

/// The degree of the FIR feedforward that comes within 0.1 % of the inverse dynamics (Zhang 2015, section 5.6.2: 2 for
/// a minimum-phase plant, 6 for a nonminimum-phase one).
fn feedforward_degree(plant: Plant) -> u32 {
    if plant == Plant::MinimumPhase { 2 } else { 6 }
}

fn identification(study: StudyId, trial: TrialId, plant: Plant) -> anyhow::Result<NewAnalysis> {
    let degree = feedforward_degree(plant);
    let spec =
        json!({"pool": pool(), "feedforward_numerator_degree": degree, "feedforward_denominator_degree": degree});
    request(study, "ssid", json!({"trial": trial}), spec)
}

/// A trial by itself: nothing is assumed to be the same in others.
fn prediction_error(study: StudyId, trial: TrialId) -> anyhow::Result<NewAnalysis> {
    request(study, "prediction_error", json!({"trial": trial}), json!({"band_hz": BAND_HZ}))
}

fn request(study: StudyId, kind: &str, inputs: Value, spec: Value) -> anyhow::Result<NewAnalysis> {
    let plan = Plan::parse(&Request { kind: kind.to_owned(), inputs, spec })
        .context("the demonstration's own request is refused")?;
    let request = plan.request();
    let references = plan.references();
    Ok(NewAnalysis {
        study: Some(study),
        kind: plan.kind(),
        spec_sha256: sha256_json(&request.spec),
        request,
        trials: references.trials,
        plants: references.plants,
        analyses: references.analyses,
    })
}

/// Runs a worker until every analysis of the studies is finished.
async fn work(store: &Store, studies: [StudyId; 2], args: &DemoArgs) -> anyhow::Result<Vec<AnalysisRecord>> {
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
    let bar = progress_bar("analyses finished");
    let finished = watch(store, &studies, &bar).await;
    bar.finish_and_clear();
    stop.cancel();
    running.await?;
    finished
}

async fn watch(store: &Store, studies: &[StudyId], bar: &ProgressBar) -> anyhow::Result<Vec<AnalysisRecord>> {
    loop {
        let mut all: Vec<AnalysisRecord> = Vec::new();
        for study in studies {
            let filter = AnalysisFilter { study: Some(*study), ..AnalysisFilter::default() };
            let mut after = None;
            loop {
                let next = store.analyses(filter.clone(), Page { after, limit: 500 }).await?;
                let is_last = next.len() < 500;
                after = next.last().map(|a| a.id.0);
                all.extend(next);
                if is_last {
                    break;
                }
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
async fn answer<T: DeserializeOwned>(store: &Store, path: &str) -> anyhow::Result<T> {
    match ask(store, path).await? {
        Answer::Body(body) => serde_json::from_slice(&body).with_context(|| format!("{path} cannot be read")),
        Answer::Problem(body) => bail!("{path} was refused: {}", String::from_utf8_lossy(&body)),
    }
}

async fn learning_curves(store: &Store, study: StudyId, estimator: Estimator) -> anyhow::Result<StudyLearningCurves> {
    answer(store, &format!("/v1/studies/{study}/learning-curves?estimator={}", estimator.name())).await
}

/// What the comparison of the groups finds about their change with practice, in one sentence where both groups have
/// values.
async fn findings(store: &Store, study: StudyId) -> anyhow::Result<Vec<String>> {
    let metric = "norm_feedforward_plant_minus_one";
    let path = format!("/v1/studies/{study}/comparison?estimator=prediction_error&metrics={metric}&contrasts=change");
    let found: StudyComparison = answer(store, &path).await?;
    // Groups come first, then the differences between them, then the counts.
    Ok(found.findings.into_iter().skip(found.groups.len()).take(found.pairs.len()).collect())
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
