//! Clocks that are set: work is neither lost, nor hidden, nor reordered, nor taken from a worker that lives.

use super::*;
use volition::ctl::Progress;
use volition::jobs::Status;
use volition::store::LeaseState;

const LEASE_S: f64 = 15.0;
const DAY_S: f64 = 86_400.0;

/// A store whose time of day is set while time passes.
struct Set {
    store: Store,
    day: Arc<AtomicI64>,
    passed: Arc<AtomicI64>,
    path: std::path::PathBuf,
    _directory: tempfile::TempDir,
}

fn us(seconds: f64) -> i64 {
    (seconds * 1e6) as i64
}

impl Set {
    async fn new() -> Self {
        let directory = directory();
        let path = directory.path().join("volition.db");
        let (day, passed) = (Arc::new(AtomicI64::new(1_790_000_000_000_000)), Arc::new(AtomicI64::new(0)));
        let clock = Clock::Apart { day: Arc::clone(&day), passed: Arc::clone(&passed) };
        let store = Store::open_with_clock(Some(&path), clock).await.unwrap();
        Self { store, day, passed, path, _directory: directory }
    }

    /// Somebody else on the same file, who has a clock of their own for what passes.
    async fn other(&self) -> Store {
        let clock = Clock::Apart { day: Arc::clone(&self.day), passed: Arc::clone(&self.passed) };
        Store::open_with_clock(Some(&self.path), clock).await.unwrap()
    }

    /// Time passes, and both clocks show it.
    fn pass(&self, seconds: f64) {
        self.day.fetch_add(us(seconds), Ordering::SeqCst);
        self.passed.fetch_add(us(seconds), Ordering::SeqCst);
    }

    /// The clock is set; no time passes.
    fn set(&self, seconds: f64) {
        self.day.fetch_add(us(seconds), Ordering::SeqCst);
    }

    async fn queue(&self) -> volition::analysis::ids::AnalysisId {
        self.store.create_analysis(new_analysis(Vec::new()), None).await.unwrap().into_inner().id
    }
}

#[tokio::test]
async fn a_clock_set_by_a_day_kills_no_worker_that_lives() {
    for jump_s in [DAY_S, -DAY_S] {
        let set = Set::new().await;
        let other = set.other().await;
        let id = set.queue().await;
        let lease = set.store.claim("alive", LEASE_S).await.unwrap().unwrap().lease;
        for round in 0..40 {
            set.pass(3.0);
            if round % 7 == 3 {
                set.set(if round % 2 == 0 { -jump_s } else { jump_s });
            }
            assert_eq!(set.store.rescue(5).await.unwrap(), Default::default(), "round {round}");
            assert_eq!(other.rescue(5).await.unwrap(), Default::default(), "round {round}");
            let state = set.store.heartbeat(&lease, Progress::of_units(round, 40), LEASE_S).await.unwrap();
            assert_eq!(state, LeaseState::Held, "round {round}");
        }
        assert!(set.store.succeed(&lease, &report(1.0)).await.unwrap());
        assert_eq!(set.store.analysis(id).await.unwrap().attempts, 1);
        other.close().await;
        set.store.close().await;
    }
}

#[tokio::test]
async fn a_clock_set_by_a_day_does_not_hide_a_worker_that_died() {
    for jump_s in [DAY_S, -DAY_S, 0.0] {
        let set = Set::new().await;
        let other = set.other().await;
        let id = set.queue().await;
        let dead = set.store.claim("dead", LEASE_S).await.unwrap().unwrap().lease;
        set.set(jump_s);
        // The other process has to see the silence itself: its first look begins the lease.
        let mut silent_s = 0.0;
        let rescued = loop {
            let rescued = other.rescue(5).await.unwrap();
            if rescued != Default::default() {
                break rescued;
            }
            set.pass(3.0);
            silent_s += 3.0;
            assert!(silent_s <= LEASE_S, "{silent_s} s of silence are more than a lease");
        };
        assert_eq!((rescued.requeued, silent_s), (vec![id], LEASE_S));
        assert!(!set.store.succeed(&dead, &report(1.0)).await.unwrap());
        other.close().await;
        set.store.close().await;
    }
}

#[tokio::test]
async fn a_clock_set_by_a_day_neither_hides_nor_reorders_what_waits() {
    for jump_s in [DAY_S, -DAY_S] {
        let set = Set::new().await;
        let mut queued = Vec::new();
        for k in 0..6 {
            queued.push(set.queue().await);
            // Submitted under five different times of day.
            set.set(if k % 2 == 0 { jump_s } else { -0.5 * jump_s });
        }
        for expected in queued {
            let claim = set.store.claim("w", LEASE_S).await.unwrap();
            assert_eq!(claim.map(|claim| claim.lease.analysis), Some(expected));
        }
        set.store.close().await;
    }
}

#[tokio::test]
async fn rescued_work_waits_by_the_clock_but_not_for_one_that_was_set_back() {
    let set = Set::new().await;
    let id = set.queue().await;
    set.store.claim("dead", LEASE_S).await.unwrap().unwrap();
    set.pass(LEASE_S);
    assert_eq!(set.store.rescue(5).await.unwrap().requeued, [id]);
    assert_eq!(set.store.claim("w", LEASE_S).await.unwrap(), None, "it waits half a second at least");
    set.set(-DAY_S);
    let claim = set.store.claim("w", LEASE_S).await.unwrap().unwrap();
    assert_eq!((claim.lease.analysis, claim.attempt), (id, 2));
    set.store.close().await;
}

#[tokio::test]
async fn who_was_stopped_begins_to_watch_anew() {
    let set = Set::new().await;
    set.queue().await;
    let lease = set.store.claim("stopped as well", LEASE_S).await.unwrap().unwrap().lease;
    // The whole process stood still for an hour, its worker too: neither can blame the other.
    set.pass(3600.0);
    assert_eq!(set.store.rescue(5).await.unwrap(), Default::default());
    set.pass(3.0);
    assert_eq!(set.store.heartbeat(&lease, Progress::default(), LEASE_S).await.unwrap(), LeaseState::Held);
    assert_eq!(set.store.rescue(5).await.unwrap(), Default::default());
    assert_eq!(set.store.analysis(lease.analysis).await.unwrap().status, Status::Running);
    set.store.close().await;
}

#[tokio::test]
async fn old_idempotency_keys_go_and_young_ones_stay() {
    let set = Set::new().await;
    let month = std::time::Duration::from_secs(30 * 86_400);
    let old = set.store.create_study(new_study("old"), Some(&key("old", "a"))).await.unwrap().into_inner().id;
    set.pass(29.0 * DAY_S);
    set.store.create_study(new_study("young"), Some(&key("young", "b"))).await.unwrap();
    // A clock that is a day ahead for a while takes nothing that is younger.
    set.set(0.5 * DAY_S);
    assert_eq!(set.store.upkeep(month).await.unwrap(), 0);
    set.pass(DAY_S);
    assert_eq!(set.store.upkeep(month).await.unwrap(), 1);
    let again = set.store.create_study(new_study("old"), Some(&key("old", "a"))).await.unwrap();
    assert!(is_new(&again) && again.into_inner().id != old);
    let again = set.store.create_study(new_study("young"), Some(&key("young", "b"))).await.unwrap();
    assert!(matches!(again, Created::Replayed(_)), "{again:?}");
    set.store.close().await;
}
