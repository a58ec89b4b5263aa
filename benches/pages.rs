//! How quickly pages and figures come, and how much memory they take: 11 people with 40 trials each and three kinds of
//! analysis, and one trial of 40,001 samples.
//!
//! `cargo bench --bench pages` asks for every page and for figures over HTTP and prints the time to the first byte,
//! half and all but a hundredth of the requests, with the budget of each; `-- --serve` fills a database, prints its
//! address and goes on, for measurements in a browser. Reports of one trial stand in for those of all others.
#![allow(unreachable_pub, clippy::unwrap_used, clippy::print_stdout, clippy::cast_precision_loss)]

use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;
use volition::analysis::Report;
use volition::api::AppState;
use volition::pages::router;
use volition::simulate::reference_signals::chirp60;
use volition::simulate::subject::SimulatedSubject;
use volition::store::Store;
use volition::worker::{Analyses, Worker, WorkerSettings};

const PEOPLE: usize = 11;
const TRIALS: u32 = 40;
const SAMPLE_TIME_S: f64 = 0.05;
/// One minute at this rate has 40,001 samples.
const FAST_TIME_S: f64 = 0.0015;

/// Requests of each address.
const TIMES: usize = 100;
/// Time to the first byte of a page, and of an exact figure, in ms.
const PAGE_MS: f64 = 100.0;
const FIGURE_MS: f64 = 100.0;
/// Memory while fifty figures are drawn at once, in MB.
const MEMORY_MB: f64 = 120.0;

fn main() {
    let serve = std::env::args().any(|argument| argument == "--serve");
    tokio::runtime::Runtime::new().unwrap().block_on(bench(serve));
}

struct Client {
    url: String,
    client: reqwest::Client,
}

impl Client {
    async fn post(&self, path: &str, body: &Value) -> Value {
        let answer = self.client.post(format!("{}{path}", self.url)).json(body).send().await.unwrap();
        assert!(answer.status().is_success(), "{path}: {}", answer.text().await.unwrap());
        answer.json().await.unwrap()
    }

    async fn get(&self, path: &str) -> Value {
        self.client.get(format!("{}{path}", self.url)).send().await.unwrap().json().await.unwrap()
    }

    async fn upload(&self, subject: &str, plant: &str, number: u32, step_s: f64, csv: String) -> String {
        let path = format!("/v1/subjects/{subject}/trials?plant={plant}&number={number}&sample_time_s={step_s}");
        let request = self.client.post(format!("{}{path}", self.url)).header("content-type", "text/csv").body(csv);
        let answer = request.send().await.unwrap();
        assert!(answer.status().is_success(), "{}", answer.text().await.unwrap());
        id(&answer.json().await.unwrap())
    }

    /// Milliseconds to the head of the answer and to its end, and its bytes.
    async fn take(&self, path: &str) -> (f64, f64, usize) {
        let began = Instant::now();
        let request = self.client.get(format!("{}{path}", self.url)).header("accept", "text/html,*/*");
        let answer = request.send().await.unwrap();
        let first = began.elapsed();
        assert_eq!(answer.status().as_u16(), 200, "{path}");
        let bytes = answer.bytes().await.unwrap().len();
        let ms = |time: Duration| 1e3 * time.as_secs_f64();
        (ms(first), ms(began.elapsed()), bytes)
    }
}

fn id(document: &Value) -> String {
    document["id"].as_str().unwrap_or_else(|| panic!("{document} has no id")).to_owned()
}

fn recording(seed: u64, number: u32, step_s: f64) -> String {
    let plant = volition::plants::catalogue::minimum_phase();
    let subject = SimulatedSubject::new(&plant, step_s, seed).unwrap();
    let trial = subject.trial(number, &chirp60(step_s), None).unwrap();
    let mut csv = Vec::new();
    volition::trial::write::csv(&trial, &mut csv).unwrap();
    String::from_utf8(csv).unwrap()
}

async fn work(store: &Store) {
    let settings = WorkerSettings { poll_s: 0.02, ..WorkerSettings::default() };
    let worker = Worker::new(store.clone(), Arc::new(Analyses::default()), settings).unwrap();
    let stop = CancellationToken::new();
    let idle = async {
        loop {
            let counts = store.count_by_status().await.unwrap();
            if counts.iter().all(|(status, n)| status.is_final() || *n == 0) {
                break;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        stop.cancel();
    };
    tokio::join!(worker.run(stop.clone()), idle);
}

/// Where everything is that is looked at.
struct Filled {
    study: String,
    subject: String,
    trial: String,
    long: String,
    analysis: String,
}

async fn fill(client: &Client, store: &Store) -> Filled {
    let study = id(&client.post("/v1/studies", &json!({"name": "440 trials"})).await);
    let plant = json!({"name": "minimum phase", "model": {"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0]}});
    let plant = id(&client.post(&format!("/v1/studies/{study}/plants"), &plant).await);
    let (mut subjects, mut trials) = (Vec::new(), Vec::new());
    for person in 0..PEOPLE {
        let body = json!({"code": format!("S{:02}", person + 1), "group": if person % 2 == 0 { "one" } else { "two" }});
        let subject = id(&client.post(&format!("/v1/studies/{study}/subjects"), &body).await);
        for number in 1..=TRIALS {
            let csv = recording(person as u64 + 1, number, SAMPLE_TIME_S);
            trials.push(client.upload(&subject, &plant, number, SAMPLE_TIME_S, csv).await);
        }
        subjects.push(subject);
    }
    let thin = json!({"poles": 12, "zeros": 12, "damping": 4, "gains": 6});
    let mut last = String::new();
    for (kind, spec) in [
        ("frequency_response", json!({})),
        ("ssid", json!({"pool": {"name": "zhang2015_appendix_c", "thin": thin}})),
        ("prediction_error", json!({"band_hz": [0.02, 0.5]})),
    ] {
        let request = json!({"kind": kind, "inputs": {"trial": trials[0]}, "spec": spec});
        last = id(&client.post("/v1/analyses", &request).await);
        work(store).await;
        let report = client.get(&format!("/v1/analyses/{last}/report")).await;
        let report: Report = serde_json::from_value(report).unwrap();
        client
            .post(&format!("/v1/studies/{study}/analyses"), &json!({"kind": kind, "spec": spec, "only": "all"}))
            .await;
        while let Some(claim) = store.claim("bench", 60.0).await.unwrap() {
            assert!(store.succeed(&claim.lease, &report).await.unwrap());
        }
    }
    let other = id(&client.post("/v1/studies", &json!({"name": "one long trial"})).await);
    let body = json!({"name": "minimum phase", "model": {"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0]}});
    let plant = id(&client.post(&format!("/v1/studies/{other}/plants"), &body).await);
    let subject = id(&client.post(&format!("/v1/studies/{other}/subjects"), &json!({"code": "L01"})).await);
    let long = client.upload(&subject, &plant, 1, FAST_TIME_S, recording(1, 1, FAST_TIME_S)).await;
    Filled { study, subject: subjects[0].clone(), trial: trials[0].clone(), long, analysis: last }
}

/// The resident memory of this process, in MB; none where the system does not say.
fn memory_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kb| kb / 1e3)
}

async fn bench(serve: bool) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(Some(&folder.path().join("pages.db"))).await.unwrap();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let app = router(AppState::new(store.clone()));
    let serving = tokio::spawn(async move { axum::serve(listener, app).await.unwrap() });
    let client = Client { url, client: reqwest::Client::new() };
    let Filled { study, subject, trial, long, analysis } = fill(&client, &store).await;
    if serve {
        println!("{}/trials/{long}", client.url);
        serving.await.unwrap();
        return;
    }
    let curves = format!("/v1/studies/{study}/figures");
    let routes = [
        ("/".to_owned(), PAGE_MS),
        (format!("/studies/{study}"), PAGE_MS),
        (format!("/subjects/{subject}"), PAGE_MS),
        (format!("/trials/{trial}"), PAGE_MS),
        (format!("/trials/{long}"), PAGE_MS),
        (format!("/analyses/{analysis}"), PAGE_MS),
        ("/queue".to_owned(), PAGE_MS),
        ("/excitation".to_owned(), PAGE_MS),
        (format!("/v1/trials/{long}/figures/signals?theme=page&w=1160"), FIGURE_MS),
        (format!("/v1/trials/{long}/figures/signals?theme=page&w=1160&from=20&to=25"), FIGURE_MS),
        (format!("{curves}/norm_feedforward_plant_minus_one?estimator=prediction_error"), FIGURE_MS),
        (format!("{curves}/bode?estimator=prediction_error"), FIGURE_MS),
    ];
    let mut late = Vec::new();
    println!("{:>9} {:>9} {:>9} {:>9}  address", "p50 ms", "p99 ms", "whole ms", "kB");
    for (route, budget) in &routes {
        let mut taken = Vec::new();
        for _ in 0..TIMES {
            taken.push(client.take(route).await);
        }
        let bytes = taken[0].2;
        let sorted = |pick: fn(&(f64, f64, usize)) -> f64| {
            let mut all: Vec<f64> = taken.iter().map(pick).collect();
            all.sort_by(f64::total_cmp);
            all
        };
        let (first, whole) = (sorted(|own| own.0), sorted(|own| own.1));
        let (half, most) = (first[TIMES / 2], first[TIMES * 99 / 100]);
        println!("{half:>9.1} {most:>9.1} {:>9.1} {:>9.0}  {route}", whole[TIMES / 2], bytes as f64 / 1e3);
        // Of a figure the middle counts, of a page all but a hundredth.
        let own = if route.starts_with("/v1/") { half } else { most };
        if own > *budget {
            late.push(format!("{route}: {own:.0} ms of {budget:.0}"));
        }
    }
    let before = memory_mb();
    let path = format!("/v1/trials/{long}/figures/signals?w=1160");
    let all = (0..50).map(|at| {
        let path = format!("{path}&from={at}&to={}", at + 5);
        let client = &client;
        async move { client.take(&path).await }
    });
    let began = Instant::now();
    futures::future::join_all(all).await;
    let drawn_s = began.elapsed().as_secs_f64();
    let after = memory_mb();
    println!("fifty figures of 40,001 samples at once: {drawn_s:.2} s, memory {before:.0?} to {after:.0?} MB");
    if after.is_some_and(|mb| mb > MEMORY_MB) {
        late.push(format!("memory: {after:.0?} MB of {MEMORY_MB}"));
    }
    serving.abort();
    assert!(late.is_empty(), "over their budgets:\n{}", late.join("\n"));
}
