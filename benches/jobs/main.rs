//! How soon analyses stop when they are told to, and how honest their progress is.
//!
//! `cargo bench --bench jobs` stops every kind, at the largest size that it takes, at several moments of its
//! computation and asserts that none goes on for longer than 0.4 s (a worker looks every 0.1 s whether it should stop,
//! which makes half a second in all). Then it follows five long analyses to their ends and holds the time that they
//! said was left against the clock. `-- stopping` and `-- progress` do one of the two, `-- --only KIND` one kind.
#![allow(unreachable_pub, clippy::unwrap_used, clippy::print_stdout, clippy::cast_precision_loss)]

mod largest;
mod long;

use std::sync::Arc;
use std::time::{Duration, Instant};
use volition::analysis::{Failure, Library, Plan, Report, Request};
use volition::ctl::{Ctl, StopReason};
use volition::jobs::EtaEstimator;
use volition::worker::run_plan;

/// The longest that a computation may go on after it was told to stop, in seconds.
const LONGEST_S: f64 = 0.4;

/// When computations are stopped, in seconds after they began.
const MOMENTS_S: [f64; 6] = [0.05, 0.3, 1.0, 3.0, 8.0, 20.0];

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let only = arguments.iter().position(|argument| argument == "--only").map(|at| arguments[at + 1].clone());
    let asked = |name: &str| arguments.iter().any(|argument| argument == name);
    let both = !asked("stopping") && !asked("progress");
    let wanted = |request: &Request| only.as_ref().is_none_or(|kind| *kind == request.kind);
    if both || asked("stopping") {
        println!("{:<22} {:>12} {:>16}", "kind", "stopped after", "went on for");
        let worst = largest::requests().into_iter().filter(wanted).map(|request| stop(&request)).fold(0.0, f64::max);
        println!("longest: {worst:.3} s (target {LONGEST_S} s)");
        assert!(worst <= LONGEST_S, "{worst} s");
    }
    if both || asked("progress") {
        long::requests().into_iter().filter(wanted).for_each(|request| follow(&request));
    }
}

type Ended = (Result<Report, Failure>, Instant);

/// Begins an analysis on a thread of its own.
fn begin(plan: Arc<Plan>, ctl: Arc<Ctl>) -> std::thread::JoinHandle<Ended> {
    std::thread::spawn(move || {
        let (outcome, _) = run_plan(plan.as_ref(), &Library::default(), &ctl, 0);
        (outcome, Instant::now())
    })
}

/// Stops an analysis at each moment, and returns the longest that it went on.
fn stop(request: &Request) -> f64 {
    let plan = Arc::new(Plan::parse(request).unwrap());
    let mut worst: f64 = 0.0;
    for moment in MOMENTS_S {
        let ctl = Arc::new(Ctl::new());
        let running = begin(Arc::clone(&plan), Arc::clone(&ctl));
        std::thread::sleep(Duration::from_secs_f64(moment));
        let told = Instant::now();
        ctl.stop(StopReason::Cancelled);
        let (outcome, ended) = running.join().unwrap();
        match outcome {
            Err(Failure::Stopped(_) | Failure::Interrupted { .. }) => {
                let went_on = ended.duration_since(told).as_secs_f64();
                println!("{:<22} {moment:>10.2} s {went_on:>14.3} s", request.kind);
                worst = worst.max(went_on);
            }
            Ok(_) => {
                // It may also have ended after it was told, without looking again.
                let went_on = ended.saturating_duration_since(told).as_secs_f64();
                println!("{:<22} {moment:>10.2} s {went_on:>14.3} s, at its end", request.kind);
                worst = worst.max(went_on);
                break;
            }
            Err(Failure::Problem(problem)) => panic!("{}: {problem:?}", request.kind),
        }
    }
    worst
}

/// Follows an analysis to its end: its fraction never falls, and from a quarter of its time on what it says is left is
/// within a factor of two of what was.
fn follow(request: &Request) {
    let plan = Arc::new(Plan::parse(request).unwrap());
    let ctl = Arc::new(Ctl::new());
    let began = Instant::now();
    let running = begin(plan, Arc::clone(&ctl));
    let mut eta = EtaEstimator::begin(0);
    let mut said = Vec::new();
    let mut last = ctl.progress();
    while !running.is_finished() {
        std::thread::sleep(Duration::from_millis(50));
        let (progress, at) = (ctl.progress(), began.elapsed());
        assert!(progress.fraction >= last.fraction, "{last:?} then {progress:?}");
        last = progress;
        eta.observe(i64::try_from(at.as_micros()).unwrap(), progress);
        said.push((at.as_secs_f64(), eta.eta_s(), progress));
    }
    let (outcome, ended) = running.join().unwrap();
    outcome.unwrap_or_else(|failure| panic!("{}: {failure:?}", request.kind));
    let whole = ended.duration_since(began).as_secs_f64();
    println!("{}: {whole:.1} s", request.kind);
    for share in [0.25, 0.5, 0.75] {
        let at = said.iter().find(|(at, ..)| *at >= share * whole);
        let Some((at, eta_s, progress)) = at else { panic!("{}: over before it was watched", request.kind) };
        let left = whole - at;
        let eta_s = eta_s.unwrap_or_else(|| panic!("{}: nothing was said at {at:.1} s: {progress:?}", request.kind));
        println!(
            "  at {at:>6.1} s in {:<12} {:>5.1} % done, said {eta_s:>6.1} s left, were {left:.1} s",
            progress.phase.name(),
            100.0 * progress.fraction
        );
        let off = (eta_s - left).abs();
        assert!(off <= left.max(0.1 * whole), "{}: said {eta_s} s, were {left} s", request.kind);
    }
}
