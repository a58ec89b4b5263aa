//! The rules of a job's life, without any storage.

use crate::property::from_seed;
use proptest::prelude::*;
use std::time::Duration;
use volition::ctl::{Phase, Progress};
use volition::jobs::{Backoff, EtaEstimator, Event, Job, LeasePolicy, Status, run_eta_s};

const DIED: Event = Event::WorkerDied { max_attempts: 3 };
const EVENTS: [Event; 7] =
    [Event::Claim, Event::Succeed, Event::Fail, Event::RequestCancel, Event::ConfirmCancel, Event::Release, DIED];

/// The whole table, written out by hand: (status, cancel requested, attempts) × event → status, attempts; `None` is
/// illegal.
#[test]
fn every_transition_is_as_the_diagram_says() {
    use Event::{Claim, ConfirmCancel, Fail, Release, RequestCancel, Succeed};
    use Status::{Cancelled, Failed, Queued, Running, Succeeded};
    let legal = [
        ((Queued, false, 0), Claim, (Running, false, 1)),
        ((Queued, false, 2), Claim, (Running, false, 3)),
        ((Queued, false, 0), RequestCancel, (Cancelled, true, 0)),
        ((Queued, false, 2), RequestCancel, (Cancelled, true, 2)),
        ((Running, false, 1), Succeed, (Succeeded, false, 1)),
        ((Running, true, 1), Succeed, (Succeeded, true, 1)),
        ((Running, false, 3), Succeed, (Succeeded, false, 3)),
        ((Running, false, 1), Fail, (Failed, false, 1)),
        ((Running, true, 1), Fail, (Failed, true, 1)),
        ((Running, false, 3), Fail, (Failed, false, 3)),
        ((Running, false, 1), RequestCancel, (Running, true, 1)),
        ((Running, true, 1), RequestCancel, (Running, true, 1)),
        ((Running, false, 3), RequestCancel, (Running, true, 3)),
        ((Running, true, 1), ConfirmCancel, (Cancelled, true, 1)),
        ((Running, false, 1), Release, (Queued, false, 0)),
        ((Running, false, 3), Release, (Queued, false, 2)),
        ((Running, true, 1), Release, (Cancelled, true, 0)),
        ((Running, false, 1), DIED, (Queued, false, 1)),
        ((Running, false, 3), DIED, (Failed, false, 3)),
        ((Running, true, 1), DIED, (Cancelled, true, 1)),
        ((Succeeded, false, 1), RequestCancel, (Succeeded, false, 1)),
        ((Failed, false, 3), RequestCancel, (Failed, false, 3)),
        ((Cancelled, true, 0), RequestCancel, (Cancelled, true, 0)),
    ];
    let states = [
        (Queued, false, 0),
        (Queued, false, 2),
        (Running, false, 1),
        (Running, true, 1),
        (Running, false, 3),
        (Succeeded, false, 1),
        (Failed, false, 3),
        (Cancelled, true, 0),
    ];
    let mut matched = 0;
    for (status, cancel_requested, attempts) in states {
        for event in EVENTS {
            let job = Job { status, attempts, cancel_requested };
            let expected =
                legal.iter().find(|(from, on, _)| *from == (status, cancel_requested, attempts) && *on == event);
            let found = job.apply(event).map(|job| (job.status, job.cancel_requested, job.attempts));
            match expected {
                Some((_, _, to)) => {
                    assert_eq!(found, Ok(*to), "{job:?} on {event:?}");
                    matched += 1;
                }
                None => {
                    let error = found.expect_err(&format!("{job:?} on {event:?} should be illegal"));
                    assert_eq!((error.status, error.event), (status, event));
                }
            }
        }
    }
    assert_eq!(matched, legal.len());
}

fn events() -> impl Strategy<Value = Vec<Event>> {
    prop::collection::vec(prop::sample::select(EVENTS.to_vec()), 0..60)
}

proptest! {
    #![proptest_config(from_seed(1, 256))]
    #[test]
    fn whatever_happens_the_invariants_hold(events in events()) {
        let mut job = Job::new();
        let mut deaths_since_release = 0_u32;
        for event in events {
            let before = job;
            match job.apply(event) {
                Ok(after) => job = after,
                Err(_) => continue,
            }
            if event == DIED { deaths_since_release += 1; }
            // Final means final.
            if before.status.is_final() { prop_assert_eq!(job, before); }
            // Nobody un-cancels.
            prop_assert!(job.cancel_requested || !before.cancel_requested);
            prop_assert!(job.status != Status::Cancelled || job.cancel_requested);
            prop_assert!(job.status != Status::Queued || !job.cancel_requested);
            // What has run has been attempted.
            let was_claimed = matches!(job.status, Status::Running | Status::Succeeded | Status::Failed);
            prop_assert!(job.attempts > 0 || !was_claimed);
            // No crash loop: every death counts, and the third is the last.
            prop_assert!(deaths_since_release <= 3);
            prop_assert!(job.attempts <= 3);
            prop_assert!(job.attempts >= deaths_since_release);
        }
    }

    #[test]
    fn a_wait_is_within_its_bounds_and_repeatable(attempts in 1..200_u32, identity in any::<u128>()) {
        let backoff = Backoff::default();
        let wait = backoff.wait(attempts, identity);
        let whole = (backoff.base.as_secs_f64() * 2_f64.powi(attempts as i32 - 1)).min(backoff.cap.as_secs_f64());
        prop_assert!(wait.as_secs_f64() >= 0.499_999 * whole && wait.as_secs_f64() <= 1.500_001 * whole);
        prop_assert_eq!(wait, backoff.wait(attempts, identity));
    }

    #[test]
    fn a_steady_rate_gives_the_exact_time_left(rate in 1..10_000_u64, seconds in 1..1000_u64,
            rest in 0..1_000_000_u64) {
        let done = rate * seconds;
        let mut eta = EtaEstimator::begin(5_000_000);
        eta.observe(5_000_000 + seconds as i64 * 1_000_000, Progress::of_units(done, done + rest));
        let expected = rest as f64 / rate as f64;
        prop_assert!((eta.eta_s().unwrap() - expected).abs() <= 1e-9 * expected.max(1.0));
    }

    #[test]
    fn an_eta_is_never_nonsense(
        observations in prop::collection::vec((any::<i64>(), any::<u64>(), any::<u64>()), 0..20),
    ) {
        let mut eta = EtaEstimator::begin(0);
        for (at, done, total) in observations {
            eta.observe(at, Progress::of_units(done, total));
            if let Some(seconds) = eta.eta_s() {
                prop_assert!(seconds.is_finite() && seconds >= 0.0);
            }
        }
    }
}

#[test]
fn waits_of_different_jobs_differ() {
    // A job that kills its process must not be offered together with the same bystander every time.
    let backoff = Backoff::default();
    let waits: Vec<Duration> = (0..50_u128).map(|identity| backoff.wait(1, identity << 3)).collect();
    let shortest = waits.iter().min().unwrap();
    let longest = waits.iter().max().unwrap();
    assert!(*longest - *shortest > Duration::from_millis(700), "{shortest:?} to {longest:?}");
}

#[test]
fn nothing_is_known_before_something_is_done() {
    let mut eta = EtaEstimator::begin(0);
    assert_eq!(eta.eta_s(), None);
    eta.observe(1_000_000, Progress::of_units(0, 0));
    assert_eq!(eta.eta_s(), None);
    eta.observe(2_000_000, Progress::of_units(0, 10));
    assert_eq!(eta.eta_s(), None);
    // The count began no earlier than the last time it was seen not to have begun.
    eta.observe(4_000_000, Progress::of_units(5, 10));
    assert_eq!(eta.eta_s(), Some(3.0));
    eta.observe(5_000_000, Progress::of_units(10, 10));
    assert_eq!(eta.eta_s(), Some(0.0));
    // A clock that went back says nothing.
    eta.observe(-1, Progress::of_units(10, 10));
    assert_eq!(eta.eta_s(), None);
}

#[test]
fn a_phase_is_measured_on_its_own_and_later_ones_by_the_whole() {
    let phase = |phase, from, to, fraction| Progress { phase, from, to, fraction, ..Progress::default() };
    let mut eta = EtaEstimator::begin(0);
    // Preparation was thought to take a tenth, and takes 100 s.
    eta.observe(50_000_000, phase(Phase::Preparation, 0.0, 0.1, 0.05));
    assert_eq!(eta.eta_s(), Some(50.0 + 50.0 * 0.9 / 0.05));
    eta.observe(100_000_000, phase(Phase::Preparation, 0.0, 0.1, 0.1));
    // The search is quicker than that; what is left of it is told by its own rate.
    eta.observe(110_000_000, phase(Phase::Search, 0.1, 1.0, 0.55));
    let left = eta.eta_s().unwrap();
    assert!((left - 10.0).abs() < 1e-9, "{left}");
    // A phase that has just begun says nothing yet.
    eta.observe(120_000_000, phase(Phase::Search, 0.1, 1.0, 1.0));
    eta.observe(121_000_000, phase(Phase::Fit, 1.0, 1.0, 1.0));
    assert_eq!(eta.eta_s(), None);
}

#[test]
fn policies_that_cannot_work_are_refused_by_field() {
    let field = |lease, heartbeat, attempts| LeasePolicy::new(lease, heartbeat, attempts).map_err(|error| error.field);
    assert!(field(15.0, 3.0, 5).is_ok());
    assert!(field(1.0, 0.5, 1).is_ok());
    assert_eq!(field(0.0, 3.0, 5), Err("lease_s"));
    assert_eq!(field(f64::NAN, 3.0, 5), Err("lease_s"));
    assert_eq!(field(f64::INFINITY, 3.0, 5), Err("lease_s"));
    assert_eq!(field(1.0, 0.6, 5), Err("heartbeat_s"));
    assert_eq!(field(1.0, f64::NAN, 5), Err("heartbeat_s"));
    assert_eq!(field(1.0, -1.0, 5), Err("heartbeat_s"));
    assert_eq!(field(1.0, 0.2, 0), Err("max_attempts"));
}

#[test]
fn status_names_are_those_on_the_wire() {
    for status in Status::ALL {
        assert_eq!(serde_json::to_value(status).unwrap(), status.name());
        assert_eq!(Status::from_name(status.name()), Some(status));
    }
    assert_eq!(Status::from_name("Queued"), None);
}

#[test]
fn a_run_takes_as_long_as_its_latest_analyses_did() {
    // The first made what the others share.
    let latest_s = [2.0, 3.0, 46.0];
    assert_eq!(run_eta_s(&latest_s, 10, 1), Some(31.5));
    assert_eq!(run_eta_s(&latest_s, 10, 4), Some(9.0));
    assert_eq!(run_eta_s(&latest_s, 0, 2), Some(1.5));
    assert_eq!(run_eta_s(&latest_s, 0, 0), Some(0.0));
    assert_eq!(run_eta_s(&[], 0, 0), Some(0.0));
    assert_eq!(run_eta_s(&latest_s, 10, 0), None, "nobody works on it");
    assert_eq!(run_eta_s(&[], 10, 1), None, "nothing is known yet");
}
