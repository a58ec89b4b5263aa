//! How fast the pool search is, and how quick polling stays while it runs.
//!
//! `cargo bench --bench search` takes about a minute; `-- --smoke` some seconds, for CI: it asserts only that the
//! machinery works, and prints what it measured. `-- --appendix-b` searches that pool in full and nothing else; with
//! `--ranges` the ranges of the statistically equivalent set are timed beside each search, which takes minutes a trial.
#![allow(unreachable_pub, clippy::unwrap_used, clippy::print_stdout)]

use rand::RngExt;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;
use volition::analysis::{Library, Plan, Request};
use volition::api::{AppState, router};
use volition::control::System;
use volition::ctl::Ctl;
use volition::identify::pool::{Degrees, PoolSpec};
use volition::identify::problem::{Lines, Problem};
use volition::identify::search::{
    BandNorms, Clusters, ExtremeMember, NormRange, Prepared, Question, Search, SensitivitySearch, Threshold, ranges,
    share,
};
use volition::learning::frequency_domain::{norm_feedback, norm_feedforward_plant_minus_one};
use volition::num::{Complex64, rng};
use volition::plants::catalogue;
use volition::simulate::SimulatedStudy;
use volition::store::Store;
use volition::trial::write;
use volition::worker::{Analyses, Worker, WorkerSettings, compute};

fn main() {
    let asked = |flag: &str| std::env::args().any(|argument| argument == flag);
    let smoke = asked("--smoke");
    if asked("--appendix-b") {
        return branch_and_bound(smoke);
    }
    let coarse = if smoke { 12 } else { 5 };
    candidates_per_second("sampled, FIR of degree 2", "zhang2015_appendix_c", 2, 2, coarse);
    candidates_per_second("sampled, FIR of degree 6", "zhang2015_appendix_c", 6, 6, coarse);
    candidates_per_second("continuous, degrees 4 and 2", "zhang2015_appendix_b", 4, 2, if smoke { 16 } else { 9 });
    branch_and_bound(smoke);
    tokio::runtime::Runtime::new().unwrap().block_on(polling_under_load(if smoke { 100 } else { 2000 }));
}

/// The norms of a report over the band of appendix B.
#[derive(Debug)]
struct Norms<'a>(&'a System);

const BAND: [f64; 2] = [0.2 * std::f64::consts::PI, 0.8 * std::f64::consts::PI];

impl BandNorms for Norms<'_> {
    fn band_rad_s(&self) -> [f64; 2] {
        BAND
    }

    fn feedback(&self, feedback: &System) -> f64 {
        norm_feedback(feedback, BAND).unwrap_or(f64::INFINITY)
    }

    fn feedforward_plant_minus_one(&self, feedforward: &System) -> f64 {
        norm_feedforward_plant_minus_one(self.0, feedforward, BAND).unwrap_or(f64::INFINITY)
    }
}

/// Trials from early to late learning with 1 to 30 % noise, over appendix B; the complete pool but for the smoke test.
fn branch_and_bound(smoke: bool) {
    let with_ranges = std::env::args().any(|argument| argument == "--ranges");
    let ctl = Ctl::new();
    let plant = System::Continuous(catalogue::two_mass());
    let thin = if smoke { json!({"poles": 6, "zeros": 6, "gains": 6}) } else { json!({}) };
    let spec: PoolSpec = serde_json::from_value(json!({"name": "zhang2015_appendix_b", "thin": thin})).unwrap();
    let recipe = spec.check(Degrees::default()).unwrap();
    let begin = Instant::now();
    let pool = recipe.build(&plant, &ctl).unwrap();
    let omega: Vec<f64> = (0..13).map(|k| std::f64::consts::TAU * (0.1 + 0.025 * f64::from(k))).collect();
    let trials = if smoke { 4 } else { 40 };
    let mut clusters = None;
    let (mut times, mut range_times) = (Vec::new(), Vec::new());
    let mut rng = rng::stream(7, "bench");
    let mut draw = || rng.random::<f64>();
    for trial in 0..trials {
        let learned = f64::from(trial) / f64::from(trials - 1);
        let noise = 0.01 * 30f64.powf(draw());
        let (gain, zero) = (0.3 * 10f64.powf(draw()), 0.5 + 4.0 * draw());
        let (delay, bandwidth) = (0.05 + 0.2 * draw(), 6.0 + 10.0 * draw());
        let h: Vec<Complex64> = omega
            .iter()
            .map(|w| {
                let (s, g) = (Complex64::new(0.0, *w), plant.response(*w));
                let (late, slow) = ((-s * delay).exp(), 1.0 / (1.0 + s / bandwidth));
                let feedback = gain * (s + zero) / zero * slow * slow * late;
                let feedforward = learned * slow / g + (1.0 - learned) * 1.5 * slow * late;
                let scatter = Complex64::from_polar(noise * (2.0 * draw()).sqrt(), std::f64::consts::TAU * draw());
                g * (feedforward + feedback) / (1.0 + g * feedback) + scatter
            })
            .collect();
        let problem = Problem::new(&Lines::new(&plant, &omega, &h, None), 4).unwrap();
        let clusters = clusters.get_or_insert_with(|| {
            let clusters = Clusters::new(&problem, &pool, &ctl).unwrap().unwrap();
            println!(
                "appendix B by bounds            {:>12} candidates, set up in {:.1} s",
                pool.size(),
                begin.elapsed().as_secs_f64()
            );
            Prepared::Sensitivity(Arc::new(clusters))
        });
        let Prepared::Sensitivity(list) = &*clusters else { unreachable!("clusters were made") };
        let begin = Instant::now();
        let found = SensitivitySearch { clusters: list }.search(&problem, &pool, &ctl).unwrap();
        times.push(begin.elapsed().as_secs_f64());
        println!(
            "  learned {learned:.2}, noise {noise:.3}: {:>6.2} s, {:>6.2} million bounds, {:>6.2} million evaluated, \
             {:>4} candidates within 1 %",
            times[times.len() - 1],
            found.bounded as f64 / 1e6,
            found.evaluated as f64 / 1e6,
            found.near_optimal
        );
        if !with_ranges {
            continue;
        }
        let limit = Threshold::new(&problem, recipe.structure(), found.cost).unwrap().limit;
        let norms = Norms(&plant);
        let best = found.index;
        let question =
            Question { problem: &problem, pool: &pool, plant: &plant, limit, best, norms: &norms, held: None };
        let begin = Instant::now();
        let set = ranges(&question, Some(clusters), &ctl).unwrap();
        range_times.push(begin.elapsed().as_secs_f64());
        let begin = Instant::now();
        let share = share(&question, false, &ctl).unwrap();
        let of = |range: &Option<NormRange>| {
            let range = range.as_ref().expect("nothing is held at zero");
            let norm = |end: &Option<ExtremeMember>| end.as_ref().map_or(f64::INFINITY, |member| member.norm);
            format!("{:.4} to {:.4}", norm(&range.least), norm(&range.largest))
        };
        println!(
            "    equivalent: {:>6.2} s ({:>5.1} times), {:>6.2} million bounds, {:>6} norms, share {:.3} in {:.2} s; \
             feedback {}, distance {}",
            range_times[range_times.len() - 1],
            range_times[range_times.len() - 1] / times[times.len() - 1],
            set.bounded as f64 / 1e6,
            set.evaluated,
            share.share,
            begin.elapsed().as_secs_f64(),
            of(&set.feedback),
            of(&set.feedforward_plant_minus_one)
        );
    }
    times.sort_by(f64::total_cmp);
    range_times.sort_by(f64::total_cmp);
    for (name, times) in [("search", &times), ("ranges", &range_times)].into_iter().filter(|(_, t)| !t.is_empty()) {
        println!("  {name} per trial: median {:.2} s, worst {:.2} s", times[times.len() / 2], times[times.len() - 1]);
    }
    // Where the system tells: the most memory that this process has had.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    if let Some(peak) = status.lines().find_map(|line| line.strip_prefix("VmHWM:")) {
        println!("  memory at the peak: {}", peak.trim());
    }
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
            "search": "exhaustive",
            "refine": false,
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
    let worker = Worker::new(store.clone(), Arc::new(Analyses::default()), settings).unwrap();
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
