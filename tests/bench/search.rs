//! How fast the pool search is, and how quick polling stays while it runs.
//!
//! `cargo bench --bench search` takes about a minute; `-- --smoke` some seconds, for CI: it asserts only that the machinery
//! works, and prints what it measured.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;
use volition::analysis::{Library, Plan, Request};
use volition::api::{AppState, router};
use volition::num::Ctl;
use volition::plants::SimulatedStudy;
use volition::store::Store;
use volition::trial::write;
use volition::worker::{Analyses, Worker, WorkerSettings, compute};

fn main() {
    let smoke = std::env::args().any(|argument| argument == "--smoke");
    let coarse = if smoke { 12 } else { 5 };
    candidates_per_second("sampled, FIR of degree 2", "zhang2015_appendix_c", 2, 2, coarse);
    candidates_per_second("sampled, FIR of degree 6", "zhang2015_appendix_c", 6, 6, coarse);
    candidates_per_second("continuous, degrees 4 and 2", "zhang2015_appendix_b", 4, 2, if smoke { 16 } else { 9 });
    tokio::runtime::Runtime::new().unwrap().block_on(polling_under_load(if smoke { 100 } else { 2000 }));
}

fn request(pool: &str, numerator: usize, denominator: usize, thin: usize) -> Request {
    let study = SimulatedStudy::two_groups(1, 1, 7).unwrap();
    let trial = write::json_value(&study.trial(&study.groups[0].members[0], 1).unwrap());
    Request {
        kind: "ssid".to_owned(),
        inputs: json!({"trial": trial, "plant": {"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0]}}),
        spec: json!({
            "pool": {"name": pool, "thin": {"poles": thin, "zeros": thin, "damping": 2, "gains": 2}},
            "feedforward_numerator_degree": numerator,
            "feedforward_denominator_degree": denominator,
            "frequency": {"lines": "zhang2015_chapter_5"},
            "max_candidates": 1_000_000_000_000_u64
        }),
    }
}

fn candidates_per_second(name: &str, pool: &str, numerator: usize, denominator: usize, thin: usize) {
    let plan = Plan::parse(&request(pool, numerator, denominator, thin)).unwrap();
    let (report, timing) = compute::run_plan(&plan, &Library::default(), &Ctl::new(), 0);
    let report = report.unwrap();
    let size = report.result["certificate"]["pool_size"].as_u64().unwrap();
    println!(
        "{name:<30} {size:>13} candidates in {:>7.2} s: {:>7.1} million a second",
        timing.wall_time_s,
        size as f64 / timing.wall_time_s / 1e6
    );
}

/// Latency of `GET /v1/analyses/{id}` while every processor computes.
async fn polling_under_load(polls: usize) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(Some(&folder.path().join("bench.db"))).await.unwrap();
    let shutdown = CancellationToken::new();
    let settings = WorkerSettings { concurrency: 2, drain_s: 0.0, ..WorkerSettings::default() };
    let worker = Worker::new(store.clone(), Arc::new(Analyses), settings).unwrap();
    let stop = shutdown.clone();
    let working = tokio::spawn(async move { worker.run(stop).await });
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}/v1/analyses", listener.local_addr().unwrap());
    let state = AppState::new(store.clone()).with_shutdown(shutdown.clone());
    let stop = shutdown.clone();
    let serving = tokio::spawn(async move {
        axum::serve(listener, router(state)).with_graceful_shutdown(stop.cancelled_owned()).await.unwrap();
    });

    let client = reqwest::Client::new();
    let mut ids = Vec::new();
    for _ in 0..2 {
        let request = request("zhang2015_appendix_b", 4, 2, 3);
        let answer: Value = client.post(&url).json(&request).send().await.unwrap().json().await.unwrap();
        ids.push(answer["id"].as_str().unwrap_or_else(|| panic!("{answer}")).to_owned());
    }
    let state = |id: String| {
        let (client, url) = (client.clone(), url.clone());
        async move { client.get(format!("{url}/{id}")).send().await.unwrap().json::<Value>().await.unwrap() }
    };
    while state(ids[0].clone()).await["progress"]["done"].as_u64().unwrap_or(0) == 0 {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let mut latencies = Vec::with_capacity(polls);
    for i in 0..polls {
        let begin = Instant::now();
        assert_eq!(state(ids[i % ids.len()].clone()).await["status"], "running", "the load ended too early");
        latencies.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    latencies.sort_by(f64::total_cmp);
    println!(
        "polling under full load         {polls:>13} polls: median {:.2} ms, 99th percentile {:.2} ms, worst {:.2} ms",
        latencies[polls / 2],
        latencies[polls * 99 / 100],
        latencies[polls - 1]
    );
    shutdown.cancel();
    working.await.unwrap();
    serving.await.unwrap();
    store.close().await;
}
