use super::*;
use std::collections::BTreeSet;
use volition::analysis::Incumbent;
use volition::analysis::ids::AnalysisId;
use volition::ctl::{Bracket, Phase, Progress};
use volition::jobs::Status;
use volition::store::{AnalysisFilter, AnalysisRecord, Heartbeat, Lease, LeaseState};

const LEASE_S: f64 = 15.0;

#[tokio::test]
async fn a_claim_takes_the_oldest_and_counts_the_attempt() {
    let bench = Bench::new().await;
    let store = &bench.store;
    assert_eq!(store.claim("w", LEASE_S).await.unwrap(), None);
    let first = bench.queue().await;
    bench.pass(1.0);
    let second = bench.queue().await;
    let claim = store.claim("w", LEASE_S).await.unwrap().unwrap();
    assert_eq!((claim.lease.analysis, claim.attempt), (first, 1));
    assert_eq!(claim.request, new_analysis(Vec::new()).request);
    let record = store.analysis(first).await.unwrap();
    assert_eq!((record.status, record.attempts), (Status::Running, 1));
    assert!(record.started_at.is_some() && record.finished_at.is_none());
    assert_eq!(store.claim("w", LEASE_S).await.unwrap().unwrap().lease.analysis, second);
    assert_eq!(store.claim("w", LEASE_S).await.unwrap(), None);
}

#[tokio::test]
async fn success_stores_the_exact_bytes() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let id = bench.queue().await;
    assert_eq!(store.report_json(id).await.unwrap(), None);
    let lease = store.claim("w", LEASE_S).await.unwrap().unwrap().lease;
    assert!(store.succeed(&lease, &report(0.125)).await.unwrap());
    let text = store.report_json(id).await.unwrap().unwrap();
    assert_eq!(text, serde_json::to_string(&report(0.125)).unwrap());
    let record = store.analysis(id).await.unwrap();
    assert_eq!(record.status, Status::Succeeded);
    assert_eq!(record.progress, Progress::of_units(1, 1));
    assert!(record.finished_at.is_some() && record.problem.is_none() && record.eta_s.is_none());
    // Once only.
    assert!(!store.succeed(&lease, &report(9.0)).await.unwrap());
    assert!(!store.fail(&lease, &problem()).await.unwrap());
    assert!(!store.release(&lease).await.unwrap());
    assert_eq!(store.report_json(id).await.unwrap().unwrap(), text);
}

#[tokio::test]
async fn failure_stores_the_problem() {
    let bench = Bench::new().await;
    let id = bench.queue().await;
    let lease = bench.store.claim("w", LEASE_S).await.unwrap().unwrap().lease;
    assert!(bench.store.fail(&lease, &problem()).await.unwrap());
    let record = bench.store.analysis(id).await.unwrap();
    assert_eq!((record.status, record.problem), (Status::Failed, Some(problem())));
    assert_eq!(bench.store.report_json(id).await.unwrap(), None);
}

/// Every write of a worker that lost its lease is refused, and changes nothing.
async fn assert_powerless(store: &Store, lease: &Lease) {
    let before = store.analysis(lease.analysis).await;
    assert_eq!(store.heartbeat(lease, Progress::of_units(1, 2), LEASE_S).await.unwrap(), LeaseState::Lost);
    assert_eq!(store.peek(lease).await.unwrap(), LeaseState::Lost);
    assert!(!store.succeed(lease, &report(1.0)).await.unwrap());
    assert!(!store.fail(lease, &problem()).await.unwrap());
    assert!(!store.confirm_cancel(lease).await.unwrap());
    assert!(!store.release(lease).await.unwrap());
    match (before, store.analysis(lease.analysis).await) {
        (Ok(before), Ok(after)) => assert_eq!(before, after),
        (Err(_), after) => assert_not_found(after, "analysis"),
        (Ok(_), Err(error)) => panic!("{error}"),
    }
}

#[tokio::test]
async fn a_late_worker_can_never_win() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let id = bench.queue().await;
    let late = store.claim("late", LEASE_S).await.unwrap().unwrap().lease;
    bench.pass(LEASE_S - 0.001);
    assert_eq!(store.rescue(5).await.unwrap().requeued, []);
    bench.pass(0.001);
    assert_eq!(store.rescue(5).await.unwrap().requeued, [id]);
    assert_powerless(store, &late).await;

    bench.pass(60.0);
    let other = store.claim("other", LEASE_S).await.unwrap().unwrap();
    assert_eq!((other.lease.analysis, other.attempt), (id, 2));
    assert_powerless(store, &late).await;
    // The lease counts, not the name: the same worker may have come back.
    let forged = Lease { analysis: id, token: late.token.clone() };
    assert_powerless(store, &forged).await;

    assert!(store.succeed(&other.lease, &report(2.0)).await.unwrap());
    assert_powerless(store, &late).await;
    assert_eq!(store.report_json(id).await.unwrap().unwrap(), serde_json::to_string(&report(2.0)).unwrap());
}

#[tokio::test]
async fn an_expired_lease_that_nobody_rescued_still_holds() {
    let bench = Bench::new().await;
    let id = bench.queue().await;
    let lease = bench.store.claim("slow", LEASE_S).await.unwrap().unwrap().lease;
    bench.pass(10.0 * LEASE_S);
    assert_eq!(bench.store.heartbeat(&lease, Progress::default(), LEASE_S).await.unwrap(), LeaseState::Held);
    assert_eq!(bench.store.rescue(5).await.unwrap(), Default::default());
    assert_eq!(bench.store.analysis(id).await.unwrap().status, Status::Running);
}

#[tokio::test]
async fn a_deleted_analysis_is_lost_to_its_worker() {
    let bench = Bench::new().await;
    let id = bench.queue().await;
    let lease = bench.store.claim("w", LEASE_S).await.unwrap().unwrap().lease;
    bench.store.delete::<AnalysisRecord>(id, None).await.unwrap();
    assert_powerless(&bench.store, &lease).await;
    assert_not_found(bench.store.delete::<AnalysisRecord>(id, None).await, "analysis");
}

#[tokio::test]
async fn heartbeats_carry_progress_eta_and_the_wish_to_cancel() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let id = bench.queue().await;
    let lease = store.claim("w", LEASE_S).await.unwrap().unwrap().lease;
    let claimed = store.analysis(id).await.unwrap();
    assert_eq!(claimed.eta_s, None);
    // Nothing new to see: the same ETag.
    assert_eq!(store.heartbeat(&lease, Progress::default(), LEASE_S).await.unwrap(), LeaseState::Held);
    assert_eq!(store.analysis(id).await.unwrap(), claimed);
    bench.pass(2.0);
    store.heartbeat(&lease, Progress::of_units(20, 100), LEASE_S).await.unwrap();
    let record = store.analysis(id).await.unwrap();
    assert_eq!(record.progress, Progress::of_units(20, 100));
    assert_eq!(record.eta_s, Some(8.0));
    assert_eq!(record.version, claimed.version + 1);
    // A new phase counts from the last sign of the old one.
    bench.pass(3.0);
    let search = Progress { phase: Phase::Search, done: 10, total: 40, from: 0.25, to: 1.0, fraction: 0.4375 };
    store.heartbeat(&lease, search, LEASE_S).await.unwrap();
    let record = store.analysis(id).await.unwrap();
    assert_eq!((record.progress, record.eta_s), (search, Some(9.0)));

    assert_eq!(store.peek(&lease).await.unwrap(), LeaseState::Held);
    let flagged = store.request_cancel(id).await.unwrap();
    assert_eq!((flagged.status, flagged.cancel_requested), (Status::Running, true));
    assert_eq!(store.request_cancel(id).await.unwrap().version, flagged.version);
    assert_eq!(store.peek(&lease).await.unwrap(), LeaseState::CancelRequested);
    assert_eq!(
        store.heartbeat(&lease, Progress::of_units(11, 40), LEASE_S).await.unwrap(),
        LeaseState::CancelRequested
    );
    assert!(store.confirm_cancel(&lease).await.unwrap());
    let record = store.analysis(id).await.unwrap();
    assert_eq!((record.status, record.eta_s), (Status::Cancelled, None));
    assert!(record.finished_at.is_some());
}

fn incumbent() -> Incumbent {
    Incumbent { feedforward: model(), feedback: model() }
}

#[tokio::test]
async fn a_bracket_is_seen_while_it_runs_and_stays_with_what_was_stopped() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let id = bench.queue().await;
    let lease = store.claim("w", LEASE_S).await.unwrap().unwrap().lease;
    let claimed = store.analysis(id).await.unwrap();
    assert_eq!((claimed.bracket, &claimed.incumbent), (None, &None));
    let progress = Progress::default();
    let bracket = Bracket { incumbent: 0.1 + 0.2, bound: 0.25, index: 159_566_654_961 };
    let heartbeat = |bracket, incumbent| Heartbeat { progress, bracket: Some(bracket), incumbent };
    store.heartbeat(&lease, heartbeat(bracket, None), LEASE_S).await.unwrap();
    let running = store.analysis(id).await.unwrap();
    assert_eq!((running.bracket, running.version), (Some(bracket), claimed.version + 1), "bit for bit, and a new ETag");
    store.heartbeat(&lease, heartbeat(bracket, None), LEASE_S).await.unwrap();
    assert_eq!(store.analysis(id).await.unwrap().version, running.version, "nothing new to see");
    // What no database can hold, or is no bracket, is passed over and does no harm.
    for bad in [Bracket { index: u64::MAX, ..bracket }, Bracket { incumbent: f64::NAN, ..bracket }] {
        assert_eq!(
            store.heartbeat(&lease, heartbeat(bad, Some(incumbent())), LEASE_S).await.unwrap(),
            LeaseState::Held
        );
        let none = store.analysis(id).await.unwrap();
        assert_eq!((none.bracket, none.incumbent), (None, None));
    }
    let last = Bracket { bound: 0.275, ..bracket };
    store.heartbeat(&lease, heartbeat(last, Some(incumbent())), LEASE_S).await.unwrap();
    store.request_cancel(id).await.unwrap();
    assert!(store.confirm_cancel(&lease).await.unwrap());
    let cancelled = store.analysis(id).await.unwrap();
    assert_eq!((cancelled.bracket, cancelled.incumbent), (Some(last), Some(incumbent())));

    // What goes back to the queue begins anew, and a report speaks for itself.
    for (end, status) in [("release", Status::Queued), ("succeed", Status::Succeeded), ("fail", Status::Failed)] {
        let id = if end == "succeed" { id_of_the_released(store).await } else { bench.queue().await };
        let lease = store.claim("w", LEASE_S).await.unwrap().unwrap().lease;
        assert_eq!(lease.analysis, id);
        assert_eq!(store.analysis(id).await.unwrap().bracket, None);
        store.heartbeat(&lease, heartbeat(last, Some(incumbent())), LEASE_S).await.unwrap();
        assert!(match end {
            "release" => store.release(&lease).await.unwrap(),
            "succeed" => store.succeed(&lease, &report(1.0)).await.unwrap(),
            _ => store.fail(&lease, &problem()).await.unwrap(),
        });
        let record = store.analysis(id).await.unwrap();
        let kept = (end == "fail").then_some(last);
        assert_eq!(
            (record.status, record.bracket, record.incumbent.is_some()),
            (status, kept, kept.is_some()),
            "{end}"
        );
    }
}

async fn id_of_the_released(store: &Store) -> AnalysisId {
    let filter = AnalysisFilter { status: Some(Status::Queued), ..AnalysisFilter::default() };
    store.analyses(filter, EVERYTHING).await.unwrap()[0].id
}

#[tokio::test]
async fn cancelling_what_waits_is_immediate_and_what_is_finished_stays() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let waiting = bench.queue().await;
    assert_eq!(store.request_cancel(waiting).await.unwrap().status, Status::Cancelled);
    assert_eq!(store.claim("w", LEASE_S).await.unwrap(), None);
    let done = bench.queue().await;
    let lease = store.claim("w", LEASE_S).await.unwrap().unwrap().lease;
    // Nobody asked: the worker has nothing to confirm.
    assert!(!store.confirm_cancel(&lease).await.unwrap());
    assert!(store.succeed(&lease, &report(1.0)).await.unwrap());
    let before = store.analysis(done).await.unwrap();
    assert_eq!(store.request_cancel(done).await.unwrap(), before);
}

#[tokio::test]
async fn released_work_keeps_its_place_and_its_attempts() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let first = bench.queue().await;
    bench.pass(1.0);
    bench.queue().await;
    let lease = store.claim("w", LEASE_S).await.unwrap().unwrap().lease;
    store.heartbeat(&lease, Progress::of_units(1, 3), LEASE_S).await.unwrap();
    assert!(store.release(&lease).await.unwrap());
    let record = store.analysis(first).await.unwrap();
    assert_eq!((record.status, record.attempts, record.progress), (Status::Queued, 0, Progress::default()));
    let again = store.claim("w", LEASE_S).await.unwrap().unwrap();
    assert_eq!((again.lease.analysis, again.attempt), (first, 1));
    // Shutdown and a wish to cancel at once: nobody wants it back in the queue.
    store.request_cancel(first).await.unwrap();
    assert!(store.release(&again.lease).await.unwrap());
    assert_eq!(store.analysis(first).await.unwrap().status, Status::Cancelled);
}

#[tokio::test]
async fn rescued_work_goes_to_the_end_of_the_queue() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let victim = bench.queue().await;
    let mut others = Vec::new();
    for _ in 0..3 {
        bench.pass(0.5);
        others.push(bench.queue().await);
    }
    assert_eq!(store.claim("w", LEASE_S).await.unwrap().unwrap().lease.analysis, victim);
    bench.pass(LEASE_S);
    assert_eq!(store.rescue(5).await.unwrap().requeued, [victim]);
    bench.pass(60.0);
    for other in others {
        assert_eq!(store.claim("w", LEASE_S).await.unwrap().unwrap().lease.analysis, other);
    }
    assert_eq!(store.claim("w", LEASE_S).await.unwrap().unwrap().lease.analysis, victim);
}

/// A run of hundreds delays neither another study nor an analysis of another kind, and each line keeps its order.
#[tokio::test]
async fn lines_of_studies_and_kinds_take_turns() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (one, other) = (bench.study().await, bench.study().await);
    let new = |study, kind| NewAnalysis { study: Some(study), kind, ..new_analysis(Vec::new()) };
    let many = store.create_analyses(vec![new(one, ssid::Plan::KIND); 300], None).await.unwrap();
    let run: Vec<AnalysisId> = many.iter().map(|analysis| analysis.id).collect();
    let claim = async || store.claim("w", LEASE_S).await.unwrap().unwrap().lease.analysis;
    for expected in &run[..100] {
        assert_eq!(claim().await, *expected);
    }
    let short = frequency_response::Plan::KIND;
    let first = store.create_analyses(vec![new(other, ssid::Plan::KIND); 3], None).await.unwrap();
    let quick = store.create_analysis(new(one, short), None).await.unwrap().into_inner().id;
    let mut taken = Vec::new();
    for _ in 0..8 {
        taken.push(claim().await);
    }
    let place = |id: AnalysisId| taken.iter().position(|other| *other == id);
    assert!(place(quick).is_some_and(|place| place <= 2), "the short one waited for a run");
    for analysis in &first {
        assert!(place(analysis.id).is_some(), "the other study waited for a run");
    }
    let of_run: Vec<_> = taken.iter().filter(|id| run.contains(id)).copied().collect();
    assert_eq!(of_run, run[100..104], "and the run goes on meanwhile, in order");
    // What is released keeps its place before everything.
    let lease = store.claim("w", LEASE_S).await.unwrap().unwrap().lease;
    assert!(store.release(&lease).await.unwrap());
    assert_eq!(claim().await, lease.analysis);
}

#[tokio::test]
async fn a_job_whose_workers_die_fails_and_says_so() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let poison = bench.queue().await;
    for attempt in 1..=3 {
        let claim = store.claim("unlucky", LEASE_S).await.unwrap().unwrap();
        assert_eq!(claim.attempt, attempt);
        bench.pass(LEASE_S);
        let rescued = store.rescue(3).await.unwrap();
        if attempt < 3 {
            assert_eq!((rescued.requeued, rescued.failed), (vec![poison], vec![]));
        } else {
            assert_eq!((rescued.requeued, rescued.failed), (vec![], vec![poison]));
        }
        bench.pass(100.0);
    }
    assert_eq!(store.claim("unlucky", LEASE_S).await.unwrap(), None);
    let record = store.analysis(poison).await.unwrap();
    assert_eq!((record.status, record.attempts), (Status::Failed, 3));
    let problem = record.problem.unwrap();
    assert_eq!(problem.code, Code::WorkerDied);
    assert!(problem.detail.contains("3 times") && problem.detail.contains("unlucky"), "{}", problem.detail);
}

#[tokio::test]
async fn cancelled_while_its_worker_died_means_cancelled() {
    let bench = Bench::new().await;
    let id = bench.queue().await;
    bench.store.claim("w", LEASE_S).await.unwrap().unwrap();
    bench.store.request_cancel(id).await.unwrap();
    bench.pass(LEASE_S);
    assert_eq!(bench.store.rescue(1).await.unwrap().cancelled, [id]);
    assert_eq!(bench.store.analysis(id).await.unwrap().status, Status::Cancelled);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn concurrent_claims_never_give_the_same_row_twice() {
    let bench = Bench::new().await;
    let mut queued = BTreeSet::new();
    for _ in 0..60 {
        queued.insert(bench.queue().await);
    }
    let start = Arc::new(tokio::sync::Barrier::new(8));
    let workers: Vec<_> = (0..8)
        .map(|worker| {
            let (store, start) = (bench.store.clone(), Arc::clone(&start));
            tokio::spawn(async move {
                start.wait().await;
                let mut taken = Vec::new();
                while let Some(claim) = store.claim(&format!("w{worker}"), LEASE_S).await.unwrap() {
                    taken.push(claim.lease);
                }
                taken
            })
        })
        .collect();
    let mut taken = Vec::new();
    for worker in workers {
        taken.extend(worker.await.unwrap());
    }
    assert_eq!(taken.len(), 60);
    assert_eq!(taken.iter().map(|lease| lease.analysis).collect::<BTreeSet<_>>(), queued);
    assert_eq!(taken.iter().map(|lease| lease.token.clone()).collect::<BTreeSet<_>>().len(), 60);
}

/// Two processes on one file are two stores on it.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn two_stores_on_one_file_share_the_queue() {
    let directory = directory();
    let path = directory.path().join("shared.db");
    let (one, two) = tokio::join!(Store::open(Some(&path)), Store::open(Some(&path)));
    let (one, two) = (one.unwrap(), two.unwrap());
    for _ in 0..30 {
        one.create_analysis(new_analysis(Vec::new()), None).await.unwrap();
    }
    let drain = |store: Store| async move {
        let mut taken = Vec::new();
        while let Some(claim) = store.claim("w", LEASE_S).await.unwrap() {
            taken.push(claim.lease.analysis);
        }
        taken
    };
    let (a, b) = tokio::join!(tokio::spawn(drain(one.clone())), tokio::spawn(drain(two.clone())));
    let mut all = a.unwrap();
    all.extend(b.unwrap());
    assert_eq!(all.len(), 30);
    assert_eq!(all.into_iter().collect::<BTreeSet<_>>().len(), 30);
    one.close().await;
    two.close().await;
}
