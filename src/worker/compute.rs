//! Runs one computation on a rayon pool of its own, fenced and timed.

use super::execute::Work;
use crate::analysis::{Code, Failure, Library, Problem, Report};
use crate::ctl::Ctl;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// The stack of a compute thread. Divide and conquer over deep pools nests more frames than the usual 2 MiB like.
const STACK_BYTES: usize = 8 << 20;

/// How much lower than the server's the priority of background computations is. Enough for a request to be answered at
/// once on a machine whose processors are all computing; on an otherwise idle machine it costs nothing.
const NICE: i32 = 5;

/// What a computation cost.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Timing {
    /// Elapsed time in seconds.
    pub wall_time_s: f64,
    /// Processor time of all of its threads in seconds; `None` where the system does not tell.
    pub cpu_time_s: Option<f64>,
}

/// Whether somebody waits for the computation at a terminal, or it runs beside a server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Priority {
    /// That of the process.
    Foreground,
    /// Lower, where the system can do that for single threads (Linux).
    Background,
}

/// Why there is no outcome.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ComputeError {
    /// The computation panicked, with this text.
    #[error("the computation panicked: {0}")]
    Panicked(String),
    /// The system gave no threads.
    #[error("no compute threads: {0}")]
    NoThreads(String),
}

/// Runs a plan in the foreground, on a fresh pool of `threads` threads (0: one for each processor), and notes the times
/// in the report's provenance. The caller's thread waits.
///
/// A panic does not pass: it is logged and becomes a [`Problem`] of code `internal`.
pub fn run_plan(plan: &dyn Work, library: &Library, ctl: &Ctl, threads: usize) -> (Result<Report, Failure>, Timing) {
    let (outcome, timing) = run_work(plan, library, ctl, threads, Priority::Foreground);
    let outcome = outcome.unwrap_or_else(|error| {
        tracing::error!(%error, "a computation came to no end");
        let detail = format!("{error}; this is a defect of the program, or of the machine");
        Err(Problem::new(Code::Internal, "the computation broke off", detail).into())
    });
    (outcome, timing)
}

/// [`run_plan`] with a choice of priority, and with what broke off told apart.
pub fn run_work(
    work: &dyn Work,
    library: &Library,
    ctl: &Ctl,
    threads: usize,
    priority: Priority,
) -> (Result<Result<Report, Failure>, ComputeError>, Timing) {
    let (mut outcome, timing) = on_own_pool(threads, priority, || work.run(library, ctl));
    if let Ok(Ok(report)) = &mut outcome {
        report.provenance.wall_time_s = Some(timing.wall_time_s);
        report.provenance.cpu_time_s = timing.cpu_time_s;
    }
    (outcome, timing)
}

/// Runs `work` on a fresh pool, which is gone afterwards.
pub fn on_own_pool<T: Send>(
    threads: usize,
    priority: Priority,
    work: impl FnOnce() -> T + Send,
) -> (Result<T, ComputeError>, Timing) {
    let begin = Instant::now();
    // Tasks that are spawned and never joined panic here; without a handler rayon would abort the process.
    let stray = Arc::new(Mutex::new(None));
    let noted = Arc::clone(&stray);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .stack_size(STACK_BYTES)
        .thread_name(|index| format!("compute-{index}"))
        .start_handler(move |_| lower_priority(priority))
        .panic_handler(move |payload| {
            let text = panic_text(payload.as_ref());
            noted.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(text);
        })
        .build();
    let pool = match pool {
        Ok(pool) => pool,
        Err(error) => return (Err(ComputeError::NoThreads(error.to_string())), Timing::default()),
    };
    // The pool's threads share nothing with us but what `work` captured, and that goes no further after a panic.
    let outcome = pool.install(|| catch_unwind(AssertUnwindSafe(work)));
    let cpu_times = pool.broadcast(|_| thread_cpu_time_s());
    drop(pool);
    let timing = Timing { wall_time_s: begin.elapsed().as_secs_f64(), cpu_time_s: cpu_times.into_iter().sum() };
    let stray = stray.lock().unwrap_or_else(PoisonError::into_inner).take();
    let outcome = match (outcome, stray) {
        (Err(payload), _) => Err(ComputeError::Panicked(panic_text(payload.as_ref()))),
        (Ok(_), Some(text)) => Err(ComputeError::Panicked(text)),
        (Ok(value), None) => Ok(value),
    };
    (outcome, timing)
}

/// What a panic said.
#[must_use]
pub fn panic_text(payload: &(dyn Any + Send)) -> String {
    payload
        .downcast_ref::<&str>()
        .map(|text| (*text).to_owned())
        .or_else(|| payload.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "a panic without a text".to_owned())
}

/// Processor time of the calling thread since it began.
#[cfg(unix)]
#[allow(clippy::cast_precision_loss, clippy::unnecessary_wraps)]
fn thread_cpu_time_s() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Some(time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9)
}

#[cfg(not(unix))]
fn thread_cpu_time_s() -> Option<f64> {
    None
}

/// On Linux, `nice` is of the calling thread alone; elsewhere it would slow the server down as well.
fn lower_priority(priority: Priority) {
    #[cfg(target_os = "linux")]
    if priority == Priority::Background
        && let Err(error) = rustix::process::nice(NICE)
    {
        tracing::debug!(%error, "compute threads keep the priority of the server");
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (priority, NICE);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    #[test]
    fn the_work_has_the_pool_that_it_asked_for() {
        let (threads, timing) = on_own_pool(3, Priority::Foreground, rayon::current_num_threads);
        assert_eq!(threads, Ok(3));
        assert!(timing.wall_time_s > 0.0);
    }

    #[test]
    fn a_panic_anywhere_in_the_pool_is_caught_with_its_text() {
        let direct = on_own_pool(2, Priority::Foreground, || -> u8 { panic!("value {}", 7) }).0;
        assert_eq!(direct, Err(ComputeError::Panicked("value 7".into())));
        let nested = on_own_pool(2, Priority::Foreground, || {
            (0..1000_u32).into_par_iter().map(|k| if k == 613 { panic!("candidate 613") } else { k }).max()
        });
        assert_eq!(nested.0, Err(ComputeError::Panicked("candidate 613".into())));
        let stray = on_own_pool(1, Priority::Foreground, || {
            rayon::spawn(|| panic!("stray"));
            // With one thread, the spawned task runs before this one ends only if we yield to it.
            while rayon::yield_now() == Some(rayon::Yield::Executed) {}
        });
        assert_eq!(stray.0, Err(ComputeError::Panicked("stray".into())));
    }

    #[cfg(unix)]
    #[test]
    fn processor_time_is_summed_over_the_threads() {
        // Each of two threads burns processor time by its own clock, whatever the wall clock does meanwhile.
        let burn = |_: rayon::BroadcastContext<'_>| {
            let begin = thread_cpu_time_s().unwrap();
            let mut sum = 0_u64;
            while thread_cpu_time_s().unwrap() - begin < 0.05 {
                sum = std::hint::black_box(sum.wrapping_mul(31).wrapping_add(7));
            }
            sum
        };
        let (outcome, timing) = on_own_pool(2, Priority::Background, || rayon::broadcast(burn).len());
        assert_eq!(outcome, Ok(2));
        let cpu = timing.cpu_time_s.unwrap();
        assert!((0.1..1.0).contains(&cpu), "{timing:?}");
    }
}
