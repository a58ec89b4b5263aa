//! `kill -9` at random moments loses nothing and repeats nothing.

use crate::process::harness::{Process, Server, id, quick_spec};
use rand::RngExt as _;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;
use volition::num::rng;

const TRIALS: u32 = 40;
const KILLS: u32 = 20;

/// The reports of a study's trials, by trial number, without the times that they took.
async fn reports(server: &Server, study: &str, trials: &[String]) -> BTreeMap<usize, Value> {
    let analyses = server.settled(study).await;
    assert_eq!(analyses.len(), trials.len(), "one analysis for each trial");
    let mut reports = BTreeMap::new();
    for analysis in analyses {
        assert_eq!(analysis["status"], "succeeded", "{analysis}");
        let mut report = server.get(&format!("/v1/analyses/{}/report", id(&analysis))).await;
        let provenance = report["provenance"].as_object_mut().unwrap();
        assert!(provenance.remove("wall_time_s").unwrap().is_number());
        assert!(provenance.contains_key("result_sha256"));
        provenance.remove("cpu_time_s").unwrap();
        provenance.remove("effort").unwrap();
        // Lists leave the request out.
        let whole = server.get(&format!("/v1/analyses/{}", id(&analysis))).await;
        let trial = whole["request"]["inputs"]["trial"].as_str().unwrap();
        let number = trials.iter().position(|id| id == trial).unwrap();
        assert!(reports.insert(number, report).is_none(), "trial {number} was identified twice");
    }
    reports
}

async fn queue(server: &Server, study: &str) {
    let body = json!({"kind": "ssid", "spec": quick_spec()});
    let queued = server.post(&format!("/v1/studies/{study}/analyses"), &body).await;
    assert_eq!(queued["created"], TRIALS, "{queued}");
}

#[tokio::test(flavor = "multi_thread")]
async fn twenty_killed_workers_change_no_report() {
    let folder = tempfile::tempdir().unwrap();

    let undisturbed = folder.path().join("undisturbed.db");
    let server = Server::start(&undisturbed, &["--no-worker"]);
    let (study, trials) = server.simulated_study(TRIALS).await;
    queue(&server, &study).await;
    let mut worker = Process::worker(&undisturbed, 15.0, &["--until-idle"]);
    assert_eq!(worker.finish(), Some(0));
    let expected = reports(&server, &study, &trials).await;
    drop(server);

    let disturbed = folder.path().join("disturbed.db");
    let server = Server::start(&disturbed, &["--no-worker"]);
    let (study, trials) = server.simulated_study(TRIALS).await;
    queue(&server, &study).await;
    let mut moments = rng::stream(20, "kill moments");
    for _ in 0..KILLS {
        let mut worker = Process::worker(&disturbed, 0.5, &[]);
        tokio::time::sleep(Duration::from_millis(moments.random_range(50..700))).await;
        worker.kill();
    }
    let mut worker = Process::worker(&disturbed, 15.0, &["--until-idle"]);
    assert_eq!(worker.finish(), Some(0));
    let found = reports(&server, &study, &trials).await;
    let attempts: u64 =
        server.settled(&study).await.iter().map(|analysis| analysis["attempts"].as_u64().unwrap()).sum();
    let interrupted = attempts - u64::from(TRIALS);
    eprintln!("{KILLS} workers killed, {interrupted} of them within an analysis");
    assert!(interrupted >= 5, "only {interrupted} kills met a running analysis: the moments test little");

    assert_eq!(found.len(), expected.len());
    for (number, report) in &found {
        assert_eq!(report, &expected[number], "the report of trial {number} differs");
    }
}
