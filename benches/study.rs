//! A whole study: one request, one analysis for each of 400 trials, over the complete pool of appendix B.
//!
//! `cargo bench --bench study` takes ten to twenty minutes of all processors; `-- --few` has ten trials over the
//! complete pool, and `-- --smoke` ten over a thinned one. Trials are made of the 13 lines of Zhang 2015, section
//! 3.5.1, with what subjects from early to late learning would make of them and 1 to 30 % noise; the plant is that of
//! section 3.5. They are stored in a temporary database, asked for over HTTP, and computed by a worker with all
//! defaults (refinement included).
#![allow(unreachable_pub, clippy::unwrap_used, clippy::print_stdout)]

use rand::RngExt;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;
use volition::api::{AppState, router};
use volition::control::System;
use volition::learning::time_domain::metrics;
use volition::num::hexadecimal::hexadecimal;
use volition::num::{Complex64, rng};
use volition::plants::catalogue;
use volition::store::{NewPlant, NewStudy, NewSubject, NewTrial, SignalUnits, Store, StudyReading};
use volition::trial::{Signals, Trial};
use volition::worker::{Analyses, Folder, PoolMemo, Worker, WorkerSettings};

const SAMPLE_TIME_S: f64 = 0.05;
const PERIOD_S: f64 = 40.0;
const SUBJECTS: u32 = 10;

fn main() {
    let asked = |flag: &str| std::env::args().any(|argument| argument == flag);
    let smoke = asked("--smoke");
    let per_subject = if smoke || asked("--few") { 1 } else { 40 };
    tokio::runtime::Runtime::new().unwrap().block_on(study(smoke, per_subject));
}

async fn study(smoke: bool, per_subject: u32) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(Some(&folder.path().join("bench.db"))).await.unwrap();
    let study = fill(&store, per_subject).await;
    let pool = if smoke {
        json!({"name": "zhang2015_appendix_b", "thin": {"poles": 6, "zeros": 6, "gains": 6}})
    } else {
        json!("zhang2015_appendix_b")
    };
    let spec = json!({"pool": pool});
    let cache = folder.path().join("cache");

    let service = Service::start(&store, &cache).await;
    let begin = Instant::now();
    let path = format!("/v1/studies/{study}/analyses");
    let queued = service.post(&path, &json!({"kind": "ssid", "spec": spec})).await;
    let accepted_s = begin.elapsed().as_secs_f64();
    let trials = queued["created"].as_u64().unwrap();
    assert_eq!(trials, u64::from(SUBJECTS * per_subject), "{queued}");
    let ids: Vec<String> = queued["analyses"].as_array().unwrap().iter().map(|a| text(&a["id"])).collect();
    loop {
        let standing = service.get(queued["progress"].as_str().unwrap()).await;
        if standing["done"] == standing["total"] {
            assert_eq!(standing["analyses"]["succeeded"], trials, "{standing}");
            break;
        }
        tokio::time::sleep(Duration::from_millis(if smoke { 20 } else { 500 })).await;
    }
    let all_s = begin.elapsed().as_secs_f64();
    let mut times = Vec::new();
    let mut candidates = 0;
    for id in &ids {
        let report = service.get(&format!("/v1/analyses/{id}/report")).await;
        times.push(report["provenance"]["wall_time_s"].as_f64().unwrap());
        candidates = report["result"]["certificate"]["pool_size"].as_u64().unwrap();
    }
    let first = times.remove(0);
    service.stop().await;

    // As a process that starts again: the trees come from disk for the first analysis, and from memory for the second.
    let service = Service::start(&store, &cache).await;
    let trial = text(&queued["analyses"][0]["trial"]);
    let mut again = Vec::new();
    for _ in 0..2 {
        let request = json!({"kind": "ssid", "inputs": {"trial": trial}, "spec": spec});
        let id = text(&service.post("/v1/analyses", &request).await["id"]);
        while service.get(&format!("/v1/analyses/{id}")).await["status"] != "succeeded" {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        let report = service.get(&format!("/v1/analyses/{id}/report")).await;
        again.push(report["provenance"]["wall_time_s"].as_f64().unwrap());
    }
    let needed = service.pools.statistics();
    assert_eq!((needed.trees.store, needed.trees.memory), (1, 1), "{needed:?}");
    service.stop().await;
    store.close().await;

    let kept: u64 = std::fs::read_dir(&cache).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum();
    times.sort_by(f64::total_cmp);
    println!("{trials} trials, {candidates} candidates, accepted in {accepted_s:.2} s");
    println!(
        "  set up:    {:>7.2} s cold, {:>6.2} s from disk ({:.0} MB)",
        first - again[1],
        again[0] - again[1],
        kept as f64 / 1e6
    );
    println!("  per trial: {:>7.2} s median, {:>6.2} s worst", times[times.len() / 2], times[times.len() - 1]);
    println!("  all in:    {all_s:>7.1} s");
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_else(|| panic!("{value} is no text")).to_owned()
}

/// A server and a worker over a store, with a cache of their own.
struct Service {
    url: String,
    client: reqwest::Client,
    pools: Arc<PoolMemo>,
    shutdown: CancellationToken,
    tasks: Vec<tokio::task::JoinHandle<()>>,
}

impl Service {
    async fn start(store: &Store, cache: &Path) -> Self {
        let pools = Arc::new(PoolMemo::with_store(Arc::new(Folder::new(cache, 8 << 30))));
        let analyses = Arc::new(Analyses::new(Arc::clone(&pools)));
        let worker = Worker::new(store.clone(), analyses, WorkerSettings::default()).unwrap();
        let shutdown = CancellationToken::new();
        let stop = shutdown.clone();
        let working = tokio::spawn(async move {
            worker.run(stop).await;
        });
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let state = AppState::new(store.clone()).with_cache(pools.counters()).with_shutdown(shutdown.clone());
        let stop = shutdown.clone();
        let serving = tokio::spawn(async move {
            axum::serve(listener, router(state)).with_graceful_shutdown(stop.cancelled_owned()).await.unwrap();
        });
        Self { url, client: reqwest::Client::new(), pools, shutdown, tasks: vec![working, serving] }
    }

    async fn get(&self, path: &str) -> Value {
        self.client.get(format!("{}{path}", self.url)).send().await.unwrap().json().await.unwrap()
    }

    async fn post(&self, path: &str, body: &Value) -> Value {
        self.client.post(format!("{}{path}", self.url)).json(body).send().await.unwrap().json().await.unwrap()
    }

    async fn stop(self) {
        self.shutdown.cancel();
        drop(self.client);
        for task in self.tasks {
            task.await.unwrap();
        }
    }
}

/// Stores the study; its id.
async fn fill(store: &Store, per_subject: u32) -> String {
    let new = NewStudy {
        name: "bench".to_owned(),
        description: String::new(),
        display_limit: None,
        reading: StudyReading::default(),
    };
    let study = store.create_study(new, None).await.unwrap().into_inner().id;
    let plant = System::Continuous(catalogue::two_mass());
    let model = plant.to_model();
    let new = NewPlant { name: "two masses".to_owned(), model: model.clone(), units: SignalUnits::default() };
    let stored = store.create_plant(study, new, None).await.unwrap().into_inner().id;
    let mut draws = rng::stream(7, "study");
    let mut draw = || draws.random::<f64>();
    for subject in 1..=SUBJECTS {
        let new = NewSubject { code: format!("S{subject:02}"), group: None, attributes: json!({}) };
        let id = store.create_subject(study, new, None).await.unwrap().into_inner().id;
        let trials = (1..=per_subject).map(|number| {
            let learned = f64::from(number * SUBJECTS + subject) / f64::from((per_subject + 1) * SUBJECTS);
            let trial = trial(&plant, learned, &mut draw);
            let metrics = metrics(&trial, &model);
            NewTrial {
                plant: stored,
                number: i64::from(number),
                session: None,
                sha256: hexadecimal(&trial.content_sha256()),
                max_abs_output: metrics.max_abs_output,
                warnings: Vec::new(),
                metrics: serde_json::to_value(&metrics).unwrap(),
                trial,
            }
        });
        store.create_trials(id, trials.collect(), None).await.unwrap();
    }
    study.to_string()
}

/// Two periods of 13 cosines, as a subject follows them, with scatter that differs from period to period.
fn trial(plant: &System, learned: f64, draw: &mut impl FnMut() -> f64) -> Trial {
    let noise = 0.01 * 30f64.powf(draw());
    let (gain, zero) = (0.3 * 10f64.powf(draw()), 0.5 + 4.0 * draw());
    let (delay, bandwidth) = (0.05 + 0.2 * draw(), 6.0 + 10.0 * draw());
    let samples = (2.0 * PERIOD_S / SAMPLE_TIME_S).round() as usize + 1;
    let [mut command, mut control, mut output] = [(); 3].map(|()| vec![0.0; samples]);
    for line in 4..17 {
        let omega = std::f64::consts::TAU * f64::from(line) / PERIOD_S;
        let (s, g) = (Complex64::new(0.0, omega), plant.response(omega));
        let (late, slow) = ((-s * delay).exp(), 1.0 / (1.0 + s / bandwidth));
        let feedback = gain * (s + zero) / zero * slow * slow * late;
        let feedforward = learned * slow / g + (1.0 - learned) * 1.5 * slow * late;
        let h = g * (feedforward + feedback) / (1.0 + g * feedback);
        let phase = Complex64::from_polar(1.0, std::f64::consts::TAU * draw());
        for period in 0..2 {
            let scatter = Complex64::from_polar(noise * (2.0 * draw()).sqrt(), std::f64::consts::TAU * draw());
            let first = period * (samples - 1) / 2;
            let last = if period == 0 { (samples - 1) / 2 } else { samples };
            for k in first..last {
                let turned = phase * (s * SAMPLE_TIME_S * k as f64).exp();
                command[k] += turned.re;
                control[k] += ((h + scatter) / g * turned).re;
                output[k] += ((h + scatter) * turned).re;
            }
        }
    }
    Trial::new(SAMPLE_TIME_S, Signals { time_s: None, command, control, output, disturbance: None }).unwrap()
}
