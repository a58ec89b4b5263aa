//! How quick a full database is: 200,000 analyses of 20,000 trials, and the time of each route that lists or counts.
//!
//! `cargo bench --bench full` fills a database in a temporary folder, asks every route several times, prints the median
//! and the longest, and asserts that none of those that must not grow takes longer than 0.1 s. `-- --analyses 20000`
//! fills less, `-- --database FILE` keeps the file and uses it again.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use serde_json::{Value, json};
use sqlx::Connection as _;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tower::ServiceExt as _;
use volition::analysis::{Analysis as _, Report, Request, frequency_response, ssid};
use volition::api::{AppState, router};
use volition::control::Model;
use volition::jobs::Status;
use volition::num::hexadecimal::hexadecimal;
use volition::store::{
    AnalysisFilter, NewAnalysis, NewPlant, NewStudy, NewSubject, NewTrial, Page, SignalUnits, Store, StudyReading,
};
use volition::trial::{Signals, Trial};

/// Trials of a subject.
const TRIALS_EACH: usize = 40;

/// What a route may take.
const TARGET: Duration = Duration::from_millis(100);

/// How often each route is asked.
const TIMES: usize = 7;

fn main() {
    tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap().block_on(run());
}

async fn run() {
    let arguments: Vec<String> = std::env::args().collect();
    let after = |name: &str| arguments.iter().position(|argument| argument == name).map(|at| arguments[at + 1].clone());
    let analyses: usize = after("--analyses").map_or(200_000, |text| text.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = after("--database").map_or(folder.path().join("full.db"), PathBuf::from);
    let store = Store::open(Some(&path)).await.unwrap();
    if store.studies(Page { after: None, limit: 1 }).await.unwrap().is_empty() {
        let began = Instant::now();
        fill(&store, &path, analyses).await;
        println!("filled in {:.1} s", began.elapsed().as_secs_f64());
    }
    store.upkeep(Duration::from_secs(1)).await.unwrap();
    let bytes = std::fs::metadata(&path).unwrap().len();
    let counts = store.count_by_status().await.unwrap();
    println!("{} MB, {counts:?}", bytes / 1_000_000);
    let worst = measure(&store).await;
    assert!(worst <= TARGET, "{worst:?}");
    store.close().await;
}

/// One of each by the store itself, and the rest as copies of those rows.
async fn fill(store: &Store, path: &Path, analyses: usize) {
    let study = NewStudy {
        name: "full".into(),
        description: String::new(),
        display_limit: None,
        reading: StudyReading::default(),
    };
    let study = store.create_study(study, None).await.unwrap().into_inner().id;
    let model: Model = serde_json::from_value(json!({"num": [1.0], "den": [1.0, 0.1, 0.0]})).unwrap();
    let new = NewPlant { name: "mass".into(), model: model.clone(), units: SignalUnits::default() };
    let plant = store.create_plant(study, new, None).await.unwrap().into_inner().id;
    let subject = NewSubject { code: "S".into(), group: Some("g".into()), attributes: json!({}) };
    let subject = store.create_subject(study, subject, None).await.unwrap().into_inner().id;
    let wave = |gain: f64| (0..100).map(|k| gain * (0.1 * f64::from(k)).sin()).collect::<Vec<f64>>();
    let (command, control, output) = (wave(1.0), wave(0.3), wave(0.9));
    let trial = Trial::new(0.02, Signals { time_s: None, command, control, output, disturbance: None }).unwrap();
    let sha256 = hexadecimal(&trial.content_sha256());
    let metrics = serde_json::to_value(volition::learning::time_domain::metrics(&trial, &model)).unwrap();
    let warnings = Vec::new();
    let new = NewTrial { plant, number: 1, session: None, trial, sha256, max_abs_output: 0.9, metrics, warnings };
    let trial = store.create_trials(subject, vec![new], None).await.unwrap().remove(0).into_inner().id;
    let request = |spec: Value| Request { kind: "ssid".into(), inputs: json!({"trial": trial}), spec };
    for _ in 0..2 {
        let new = NewAnalysis {
            study: Some(study),
            kind: ssid::Plan::KIND,
            request: request(json!({"pool": "zhang2015_appendix_b"})),
            spec_sha256: "5".repeat(64),
            trials: vec![trial],
            plants: Vec::new(),
            analyses: Vec::new(),
        };
        store.create_analysis(new, None).await.unwrap();
    }
    let lease = store.claim("bench", 1e6).await.unwrap().unwrap().lease;
    let result = json!({"answer": "x".repeat(3000)});
    let report = Report::new(ssid::Plan::KIND, 1, result, Vec::new(), json!({}), [].into(), None);
    assert!(store.succeed(&lease, &report).await.unwrap());
    let options = SqliteConnectOptions::new().filename(path);
    let mut connection = SqliteConnection::connect_with(&options).await.unwrap();
    let trials = (analyses / 10).max(1);
    // Ids of version 7 in the order of their numbers.
    let id = |number: &str| format!("printf('01a00000-%04x-7000-8000-%012x', {number} >> 16, {number})");
    for (table, many, more) in [
        ("subjects", trials / TRIALS_EACH, vec![("code", "'S' || i".to_owned())]),
        (
            "trials",
            trials,
            vec![
                ("subject_id", format!("({})", id(&format!("(i % {})", (trials / TRIALS_EACH).max(1))))),
                ("number", format!("2 + i / {}", (trials / TRIALS_EACH).max(1))),
                ("sha256", "printf('%064x', i)".to_owned()),
            ],
        ),
        ("analyses", analyses, vec![("place", "0".to_owned())]),
    ] {
        let columns: Vec<String> =
            sqlx::query_scalar(sqlx::AssertSqlSafe(format!("SELECT name FROM pragma_table_info('{table}')")))
                .fetch_all(&mut connection)
                .await
                .unwrap();
        let values: Vec<String> = columns
            .iter()
            .map(|column| match more.iter().find(|(name, _)| name == column) {
                Some((_, value)) => value.clone(),
                None if column == "id" => id("i"),
                None => format!("t.{column}"),
            })
            .collect();
        let only = if table == "analyses" { "WHERE status = 'succeeded'" } else { "" };
        let sql = format!(
            "WITH RECURSIVE n(i) AS (VALUES (0) UNION ALL SELECT i + 1 FROM n WHERE i + 1 < {many})
             INSERT INTO {table} ({}) SELECT {} FROM n, (SELECT * FROM {table} {only} LIMIT 1) t",
            columns.join(", "),
            values.join(", ")
        );
        sqlx::query(sqlx::AssertSqlSafe(sql)).execute(&mut connection).await.unwrap();
    }
    let sql = format!(
        "INSERT INTO analysis_trials (analysis_id, position, trial_id)
         WITH RECURSIVE n(i) AS (VALUES (0) UNION ALL SELECT i + 1 FROM n WHERE i + 1 < {analyses})
         SELECT {}, 0, {} FROM n",
        id("i"),
        id(&format!("(i % {trials})"))
    );
    sqlx::query(sqlx::AssertSqlSafe(sql)).execute(&mut connection).await.unwrap();
    connection.close().await.unwrap();
}

/// Asks every route, and returns the longest median.
async fn measure(store: &Store) -> Duration {
    let study = store.studies(Page { after: None, limit: 1 }).await.unwrap()[0].id;
    let subject = store.subjects(study, None, Page { after: None, limit: 5 }).await.unwrap()[3].id;
    let trial = store.trials(subject, Page { after: None, limit: 1 }).await.unwrap()[0].id;
    let filter = AnalysisFilter { status: Some(Status::Queued), ..AnalysisFilter::default() };
    let analysis = store.analyses(filter, Page { after: None, limit: 1 }).await.unwrap()[0].id;
    let other = frequency_response::Plan::KIND.name();
    let routes = [
        "/healthz".to_owned(),
        "/readyz".to_owned(),
        "/metrics".to_owned(),
        "/v1/studies".to_owned(),
        format!("/v1/studies/{study}"),
        format!("/v1/studies/{study}/plants"),
        format!("/v1/studies/{study}/subjects?limit=100"),
        format!("/v1/studies/{study}/subjects?limit=100&group=none"),
        format!("/v1/subjects/{subject}/trials"),
        format!("/v1/trials/{trial}"),
        format!("/v1/analyses/{analysis}"),
        "/v1/analyses?limit=100".to_owned(),
        "/v1/analyses?status=queued".to_owned(),
        "/v1/analyses?status=failed".to_owned(),
        format!("/v1/analyses?kind={other}"),
        format!("/v1/analyses?status=succeeded&kind={other}"),
        format!("/v1/analyses?trial={trial}"),
        format!("/v1/analyses?study={study}&limit=100"),
        format!("/v1/analyses?study={study}&status=failed"),
        format!("/v1/analyses?study={study}&kind={other}&status=queued"),
        format!("/v1/studies/{study}/progress"),
        format!("/v1/subjects/{subject}/learning-curves"),
    ];
    let app = router(AppState::new(store.clone()));
    let mut worst = Duration::ZERO;
    println!("{:>10} {:>10}  route", "median ms", "longest");
    for route in routes {
        let mut took = Vec::new();
        let mut status = 0;
        for _ in 0..TIMES {
            let request = axum::http::Request::get(&route).header("host", "localhost").body(axum::body::Body::empty());
            let began = Instant::now();
            let answer = app.clone().oneshot(request.unwrap()).await.unwrap();
            status = answer.status().as_u16();
            axum::body::to_bytes(answer.into_body(), 1 << 30).await.unwrap();
            took.push(began.elapsed());
        }
        took.sort();
        let (median, longest) = (took[TIMES / 2], took[TIMES - 1]);
        let ms = |time: Duration| time.as_secs_f64() * 1e3;
        println!("{:>10.2} {:>10.2}  {status} {route}", ms(median), ms(longest));
        assert_eq!(status, 200, "{route}");
        worst = worst.max(median);
    }
    let began = Instant::now();
    let trials = store.matching_trials(study, &Default::default()).await.unwrap();
    let ids: Vec<_> = trials.iter().map(|trial| trial.id).collect();
    println!("{:>10.0} {:>10}  every trial of the study ({})", began.elapsed().as_secs_f64() * 1e3, "", ids.len());
    let began = Instant::now();
    let found = store.estimates_of_trials(&ids[..ids.len().min(400)], None).await.unwrap().found;
    println!("{:>10.0} {:>10}  {} reports of 400 trials", began.elapsed().as_secs_f64() * 1e3, "", found.len());
    worst
}
