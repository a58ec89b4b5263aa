//! The worker, with jobs of the tests' own in place of analyses; kept in step by channels, not by sleeping.

use super::worker_bench::{Bench, Scripts, hear, in_time, new_analysis, quick, report};
use serde_json::json;
use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use volition::analysis::{Code, Failure, Incumbent, Problem};
use volition::ctl::{Bracket, Progress, StopReason, Stopped};
use volition::jobs::Status;
use volition::store::{AnalysisRecord, Store, StoreError};
use volition::worker::{Drained, Worker, WorkerSettings};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_success_is_written_with_its_times() {
    let bench = Bench::new().await;
    bench.script("threads", |_, _| Ok(report(&rayon::current_num_threads().to_string())));
    let id = bench.queue("threads").await;
    let worker = bench.start(quick());
    let record = bench.finished(id).await;
    assert_eq!((record.status, record.attempts), (Status::Succeeded, 1));
    let report = bench.report(id).await;
    assert_eq!(report.result["answer"], "2");
    assert!(report.provenance.wall_time_s.unwrap() > 0.0);
    assert!(report.provenance.cpu_time_s.unwrap() >= 0.0);
    // Queued while the worker runs: woken, not polled.
    let slow_poll = bench.start(WorkerSettings { poll_s: 3000.0, ..quick() });
    worker.stop().await;
    let id = bench.queue("threads").await;
    assert_eq!(bench.finished(id).await.status, Status::Succeeded);
    slow_poll.stop().await;
    bench.assert_nothing_left().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_another_process_queues_is_found_by_polling() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("two.db");
    let bench = Bench { store: Store::open(Some(&path)).await.unwrap(), scripts: Arc::default() };
    bench.script("ok", |_, _| Ok(report("ok")));
    let worker = bench.start(quick());
    let other_process = Store::open(Some(&path)).await.unwrap();
    let id = other_process.create_analysis(new_analysis("ok"), None).await.unwrap().into_inner().id;
    assert_eq!(bench.finished(id).await.status, Status::Succeeded);
    worker.stop().await;
    other_process.close().await;
    bench.store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn problems_and_panics_fail_the_analysis_and_nothing_else() {
    let bench = Bench::new().await;
    bench
        .script("problem", |_, _| Err(Problem::new(Code::NotIdentifiable, "no power", "r is silent").into()))
        .script("panic", |_, _| panic!("index 7 out of bounds"))
        .script("deep panic", |_, _| {
            use rayon::prelude::*;
            (0..100).into_par_iter().for_each(|k| assert_ne!(k, 42, "candidate 42"));
            Ok(report("unreachable"))
        })
        .script("ok", |_, _| Ok(report("ok")));
    let mut ids = HashMap::new();
    for name in ["problem", "panic", "deep panic", "panic while planning", "unknown", "ok"] {
        ids.insert(name, bench.queue(name).await);
    }
    let worker = bench.start(quick());
    let code = async |name: &str| {
        let record = bench.finished(ids[name]).await;
        assert_eq!((record.status, record.attempts), (Status::Failed, 1), "{name}");
        record.problem.unwrap()
    };
    assert_eq!(code("problem").await.code, Code::NotIdentifiable);
    assert_eq!(code("unknown").await.code, Code::Invalid);
    for name in ["panic", "deep panic", "panic while planning"] {
        let problem = code(name).await;
        assert_eq!(problem.code, Code::Internal, "{name}");
        assert!(problem.detail.contains(&ids[name].to_string()), "{name}: {}", problem.detail);
    }
    assert_eq!(bench.finished(ids["ok"]).await.status, Status::Succeeded);
    worker.stop().await;
    bench.assert_nothing_left().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_input_that_was_deleted_is_a_problem() {
    let bench = Bench::new().await;
    bench.script("ok", |_, _| Ok(report("ok")));
    let mut new = new_analysis("ok");
    // Named in the request alone, as if it went between claim and fetch.
    new.request.inputs = json!({"trials": [uuid::Uuid::now_v7()]});
    let id = bench.store.create_analysis(new, None).await.unwrap().into_inner().id;
    let worker = bench.start(quick());
    assert_eq!(bench.finished(id).await.problem.unwrap().code, Code::NotFound);
    worker.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn cancelling_a_running_analysis_stops_it_within_a_heartbeat() {
    let bench = Bench::new().await;
    let (began, _go_on) = bench.waiting("wait");
    let id = bench.queue("wait").await;
    let waiting = bench.queue("wait").await;
    let worker = bench.start(quick());
    hear(began).await;
    // The other one still waits in the queue, and goes at once.
    assert_eq!(bench.store.request_cancel(waiting).await.unwrap().status, Status::Cancelled);
    let asked = Instant::now();
    assert_eq!(bench.store.request_cancel(id).await.unwrap().status, Status::Running);
    assert_eq!(bench.finished(id).await.status, Status::Cancelled);
    assert!(asked.elapsed() < Duration::from_secs(1), "{:?}", asked.elapsed());
    // It may still be on its way out.
    let drained = worker.stop().await;
    assert_eq!((drained.released, drained.abandoned), (0, 0));
    bench.assert_nothing_left().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_deadline_is_a_problem() {
    let bench = Bench::new().await;
    let (_began, _go_on) = bench.waiting("wait");
    let id = bench.queue("wait").await;
    let worker = bench.start(WorkerSettings { deadline_s: Some(0.1), ..quick() });
    assert_eq!(bench.finished(id).await.problem.unwrap().code, Code::DeadlineExceeded);
    worker.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_computation_that_does_not_stop_holds_up_nobody() {
    let bench = Bench::new().await;
    let (began, has_began) = channel();
    let (go_on, may_go_on) = channel::<()>();
    let (began, may_go_on) = (Mutex::new(began), Mutex::new(may_go_on));
    // Asks nobody whether it should stop.
    bench.script("deaf", move |_, _| {
        began.lock().unwrap().send(()).unwrap();
        let _ = may_go_on.lock().unwrap().recv();
        Ok(report("too late"))
    });
    bench.script("ok", |_, _| Ok(report("done")));
    let deaf = bench.queue("deaf").await;
    let next = bench.queue("ok").await;
    let worker = bench.start(WorkerSettings { stop_grace_s: 0.1, ..quick() });
    hear(has_began).await;
    bench.store.request_cancel(deaf).await.unwrap();
    assert_eq!(bench.finished(deaf).await.status, Status::Cancelled);
    assert_eq!(bench.finished(next).await.status, Status::Succeeded);
    // What it computed in the end changes nothing.
    go_on.send(()).unwrap();
    // It may still be on its way out.
    let drained = worker.stop().await;
    assert_eq!((drained.released, drained.abandoned), (0, 0));
    assert_eq!(bench.store.analysis(deaf).await.unwrap().status, Status::Cancelled);
    bench.assert_nothing_left().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_stopped_search_had_found_stays() {
    let bench = Bench::new().await;
    let (go_on, may_go_on) = channel::<()>();
    let may_go_on = Mutex::new(may_go_on);
    bench.script("search", move |_, ctl| {
        ctl.set_bracket(Bracket { incumbent: 2.0, bound: 0.5, index: 11 });
        let _ = may_go_on.lock().unwrap().recv();
        while ctl.check().is_ok() {
            std::thread::sleep(Duration::from_millis(1));
        }
        // Found after the last heartbeat.
        ctl.set_bracket(Bracket { incumbent: 1.5, bound: 1.0, index: 12 });
        let model: volition::control::Model = serde_json::from_value(json!({"num": [1.0], "den": [1.0, 3.0]})).unwrap();
        let incumbent = Box::new(Incumbent { feedforward: model.clone(), feedback: model });
        Err(Failure::Interrupted { stopped: ctl.check().unwrap_err(), incumbent })
    });
    let last = Some(Bracket { incumbent: 1.5, bound: 1.0, index: 12 });
    let id = bench.queue("search").await;
    let worker = bench.start(quick());
    bench.until(id, |record| record.bracket == Some(Bracket { incumbent: 2.0, bound: 0.5, index: 11 })).await;
    bench.store.request_cancel(id).await.unwrap();
    go_on.send(()).unwrap();
    let cancelled = bench.finished(id).await;
    assert_eq!((cancelled.status, cancelled.bracket), (Status::Cancelled, last));
    assert!(cancelled.incumbent.is_some());
    worker.stop().await;

    drop(go_on);
    let id = bench.queue("search").await;
    let worker = bench.start(WorkerSettings { deadline_s: Some(0.1), ..quick() });
    let late = bench.finished(id).await;
    assert_eq!((late.status, late.bracket), (Status::Failed, last));
    assert!(late.incumbent.is_some() && late.problem.unwrap().code == Code::DeadlineExceeded);
    worker.stop().await;
    bench.assert_nothing_left().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn progress_and_eta_can_be_watched() {
    let bench = Bench::new().await;
    let (go_on, may_go_on) = channel();
    let may_go_on = Mutex::new(may_go_on);
    bench.script("count", move |_, ctl| {
        ctl.set_total(40);
        ctl.advance(10);
        may_go_on.lock().unwrap().recv().unwrap();
        ctl.advance(10);
        may_go_on.lock().unwrap().recv().unwrap();
        Ok(report("counted"))
    });
    let id = bench.queue("count").await;
    let worker = bench.start(quick());
    let first = bench.until(id, |record| record.progress == Progress::of_units(10, 40)).await;
    let second = bench.until(id, |record| record.eta_s > first.eta_s).await;
    assert!(second.eta_s.unwrap() > 0.0);
    go_on.send(()).unwrap();
    bench.until(id, |record| record.progress == Progress::of_units(20, 40)).await;
    go_on.send(()).unwrap();
    let done = bench.finished(id).await;
    assert_eq!((done.progress, done.eta_s), (Progress::of_units(40, 40), None));
    worker.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn shutdown_lets_running_work_finish() {
    let bench = Bench::new().await;
    let (began, go_on) = bench.waiting("wait");
    let id = bench.queue("wait").await;
    let next = bench.queue("wait").await;
    let worker = bench.start(quick());
    hear(began).await;
    worker.shutdown.cancel();
    go_on.send(()).unwrap();
    assert_eq!(worker.stop().await, Drained { finished: 1, released: 0, abandoned: 0 });
    assert_eq!(bench.store.analysis(id).await.unwrap().status, Status::Succeeded);
    // Nothing new was begun.
    let next = bench.store.analysis(next).await.unwrap();
    assert_eq!((next.status, next.attempts), (Status::Queued, 0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn shutdown_hands_back_what_does_not_finish() {
    let bench = Bench::new().await;
    let (began, go_on) = bench.waiting("wait");
    let id = bench.queue("wait").await;
    let worker = bench.start(WorkerSettings { drain_s: 0.05, ..quick() });
    let began = hear(began).await;
    assert_eq!(worker.stop().await, Drained { finished: 0, released: 1, abandoned: 0 });
    let record = bench.store.analysis(id).await.unwrap();
    assert_eq!((record.status, record.attempts), (Status::Queued, 0));
    // The next process takes it up at once.
    let worker = bench.start(quick());
    hear(began).await;
    go_on.send(()).unwrap();
    let record = bench.finished(id).await;
    assert_eq!((record.status, record.attempts), (Status::Succeeded, 1));
    worker.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_whose_lease_was_taken_stops_and_writes_nothing() {
    let bench = Bench::new().await;
    let stopped = Arc::new(Mutex::new(Vec::new()));
    let (began, has_began) = channel();
    let (noted, reasons) = (Arc::clone(&stopped), Mutex::new(began));
    bench.script("wait", move |_, ctl| {
        reasons.lock().unwrap().send(()).unwrap();
        loop {
            if let Err(Stopped(reason)) = ctl.check() {
                noted.lock().unwrap().push(reason);
                return Err(Stopped(reason).into());
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    });
    let id = bench.queue("wait").await;
    let worker = bench.start(quick());
    hear(has_began).await;
    // Deleted under the worker: the lease is gone.
    bench.store.delete::<AnalysisRecord>(id, None).await.unwrap();
    in_time(async {
        while stopped.lock().unwrap().is_empty() {
            tokio::time::sleep(Duration::from_millis(3)).await;
        }
    })
    .await;
    worker.stop().await;
    assert_eq!(*stopped.lock().unwrap(), [StopReason::Withdrawn]);
    assert!(matches!(bench.store.analysis(id).await, Err(StoreError::NotFound { .. })));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_dead_workers_job_is_rescued_and_done_by_another() {
    let bench = Bench::new().await;
    bench.script("ok", |_, _| Ok(report("second time lucky")));
    let id = bench.queue("ok").await;
    // A worker that dies right after its claim: nobody renews this lease.
    let dead = bench.store.claim("dead", 0.2).await.unwrap().unwrap();
    let worker = bench.start(quick());
    let record = bench.finished(id).await;
    assert_eq!((record.status, record.attempts), (Status::Succeeded, 2));
    assert!(!bench.store.succeed(&dead.lease, &report("too late")).await.unwrap());
    assert_eq!(bench.report(id).await.result["answer"], "second time lucky");
    worker.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_that_kills_every_worker_fails_in_the_end() {
    let bench = Bench::new().await;
    bench.script("ok", |_, _| Ok(report("never")));
    let id = bench.queue("ok").await;
    bench.store.claim("dead", 0.0).await.unwrap().unwrap();
    let worker = bench.start(WorkerSettings { max_attempts: 1, ..quick() });
    let record = bench.finished(id).await;
    assert_eq!(record.status, Status::Failed);
    assert_eq!(record.problem.unwrap().code, Code::WorkerDied);
    worker.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn concurrency_is_used_and_not_exceeded() {
    let bench = Bench::new().await;
    let (now, most) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
    let meet = Arc::new(std::sync::Barrier::new(3));
    let (n, m) = (Arc::clone(&now), Arc::clone(&most));
    bench.script("meet", move |_, _| {
        m.fetch_max(n.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
        // Passes only when three run at once.
        meet.wait();
        n.fetch_sub(1, Ordering::SeqCst);
        Ok(report("met"))
    });
    let mut ids = Vec::new();
    for _ in 0..9 {
        ids.push(bench.queue("meet").await);
    }
    let worker = bench.start(WorkerSettings { concurrency: 3, compute_threads: 1, ..quick() });
    for id in ids {
        assert_eq!(bench.finished(id).await.status, Status::Succeeded);
    }
    assert_eq!(most.load(Ordering::SeqCst), 3);
    worker.stop().await;
    bench.assert_nothing_left().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_workers_do_every_analysis_once() {
    let bench = Bench::new().await;
    let runs = Arc::new(AtomicUsize::new(0));
    let counter = Arc::clone(&runs);
    bench.script("count", move |_, _| Ok(report(&counter.fetch_add(1, Ordering::SeqCst).to_string())));
    let ids: Vec<_> = bench
        .store
        .create_analyses((0..40).map(|_| new_analysis("count")).collect(), None)
        .await
        .unwrap()
        .into_iter()
        .map(|record| record.id)
        .collect();
    let one = bench.start(quick());
    let two = bench.start(quick());
    for id in &ids {
        let record = bench.finished(*id).await;
        assert_eq!((record.status, record.attempts), (Status::Succeeded, 1));
    }
    assert_eq!(runs.load(Ordering::SeqCst), 40);
    one.stop().await;
    two.stop().await;
}

#[tokio::test]
async fn settings_that_cannot_work_are_refused_by_field() {
    let store = Store::open(None).await.unwrap();
    let refused = |settings: WorkerSettings| {
        Worker::new(store.clone(), Arc::new(Scripts::default()), settings).err().map(|error| error.field)
    };
    assert_eq!(refused(WorkerSettings::default()), None);
    assert_eq!(refused(quick()), None);
    type Spoil = fn(&mut WorkerSettings);
    let cases: [(&str, Spoil); 9] = [
        ("worker_name", |s| s.worker_name.clear()),
        ("concurrency", |s| s.concurrency = 0),
        ("compute_threads", |s| s.compute_threads = 1 << 20),
        ("lease_s", |s| s.lease_s = -1.0),
        ("heartbeat_s", |s| s.heartbeat_s = s.lease_s),
        ("poll_s", |s| s.poll_s = f64::NAN),
        ("max_attempts", |s| s.max_attempts = 0),
        ("stop_grace_s", |s| s.stop_grace_s = 0.0),
        ("deadline_s", |s| s.deadline_s = Some(0.0)),
    ];
    for (field, spoil) in cases {
        let mut settings = WorkerSettings::default();
        spoil(&mut settings);
        assert_eq!(refused(settings), Some(field));
    }
}
