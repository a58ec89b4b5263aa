//! A study's run whose server is killed goes on where it was, with the trees from disk.

use crate::process::harness::{Process, Server, id};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

const TRIALS: u32 = 8;

/// Appendix B thinned until a trial takes about a second, and still listed and clustered.
fn run() -> Value {
    json!({"kind": "ssid", "spec": {
        "pool": {"name": "zhang2015_appendix_b", "thin": {"poles": 4, "feedforward_poles": 4, "zeros": 6, "gains": 3}},
        "frequency": {"lines": {"frequency_hz": [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4]}}, "refine": false
    }})
}

/// A counter of the server's metrics.
async fn counter(server: &Server, what: &str, from: &str) -> u64 {
    let text = String::from_utf8(server.get_bytes("/metrics", "text/plain").await).unwrap();
    let name = format!("volition_shared_total{{what=\"{what}\",from=\"{from}\"}} ");
    let found = text.lines().find_map(|line| line.strip_prefix(&name));
    found.unwrap_or_else(|| panic!("{name} is not in\n{text}")).parse().unwrap()
}

/// Succeeded analyses by id, with what must not change about them any more.
async fn succeeded(server: &Server, study: &str) -> BTreeMap<String, Value> {
    let listed = server.get(&format!("/v1/analyses?study={study}&status=succeeded&limit=500")).await;
    let items = listed["items"].as_array().unwrap();
    items.iter().map(|item| (id(item), json!([item["attempts"], item["finished_at"], item["version"]]))).collect()
}

async fn result_hashes(server: &Server, study: &str) -> Vec<Value> {
    let mut hashes = Vec::new();
    for analysis in server.settled(study).await {
        assert_eq!(analysis["status"], "succeeded", "{analysis}");
        let report = server.get(&format!("/v1/analyses/{}/report", id(&analysis))).await;
        hashes.push(report["provenance"]["result_sha256"].clone());
    }
    hashes
}

/// The files of the cache by kind.
fn kept(cache: &Path, kind: &str) -> usize {
    let Ok(folder) = std::fs::read_dir(cache) else { return 0 };
    let names = folder.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names.filter(|name| name.starts_with(kind) && name.ends_with(".kept")).count()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_goes_on_after_its_server_was_killed() {
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("lab.db");
    // Beside the database, where nothing else is said.
    let cache = folder.path().join("lab.db.cache");
    let more = ["--lease-s", "1"];
    let mut server = Server::start(&database, &more);
    let (study, trials) = server.simulated_study(TRIALS).await;
    let queued = server.post(&format!("/v1/studies/{study}/analyses"), &run()).await;
    assert_eq!(queued["created"], TRIALS);
    let progress = queued["progress"].as_str().unwrap().to_owned();
    let begin = Instant::now();
    let standing = loop {
        let standing = server.get(&progress).await;
        assert_eq!(standing["total"], TRIALS);
        assert!(begin.elapsed() < crate::process::harness::PATIENCE, "{standing}");
        assert_eq!(standing["analyses"]["failed"], 0, "{standing}");
        if standing["done"].as_u64().unwrap() >= 2 {
            break standing;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    assert!(standing["eta_s"].is_null() || standing["eta_s"].as_f64().unwrap() > 0.0, "{standing}");
    assert_eq!(counter(&server, "trees", "made").await, 1);
    server.process.kill();
    assert_eq!((kept(&cache, "counts-"), kept(&cache, "trees-")), (1, 1));

    let before = {
        // Nobody works: what is done stays as it is.
        let server = Server::start(&database, &["--no-worker"]);
        succeeded(&server, &study).await
    };
    assert!(
        (2..trials.len()).contains(&before.len()),
        "{} of {TRIALS} trials were done: killed too late",
        before.len()
    );

    let server = Server::start(&database, &more);
    let hashes = result_hashes(&server, &study).await;
    let after = succeeded(&server, &study).await;
    assert_eq!(after.len(), trials.len());
    for (analysis, standing) in &before {
        assert_eq!(&after[analysis], standing, "what was done is not done again");
    }
    let left = (trials.len() - before.len()) as u64;
    for what in ["pool", "trees"] {
        let from = [
            counter(&server, what, "cache").await,
            counter(&server, what, "made").await,
            counter(&server, what, "memory").await,
        ];
        assert_eq!(from, [1, 0, left - 1], "{what}");
    }
    let standing = server.get(&progress).await;
    let expected = json!({"done": TRIALS, "total": TRIALS, "eta_s": 0.0, "analyses":
        {"queued": 0, "running": 0, "succeeded": TRIALS, "failed": 0, "cancelled": 0}});
    assert_eq!(standing, expected);
    drop(server);

    // The same study without a cache: the same results.
    let database = folder.path().join("other.db");
    let server = Server::start(&database, &["--cache-gib", "0", "--no-worker"]);
    let (study, _) = server.simulated_study(TRIALS).await;
    server.post(&format!("/v1/studies/{study}/analyses"), &run()).await;
    let mut worker = Process::worker(&database, 15.0, &["--until-idle", "--cache-gib", "0"]);
    assert_eq!(worker.finish(), Some(0));
    assert_eq!(result_hashes(&server, &study).await, hashes);
    assert!(!folder.path().join("other.db.cache").exists());
}
