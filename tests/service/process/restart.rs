//! What a restart must not change.

use crate::process::harness::{Process, Server, id, quick_spec};
use serde_json::json;
use volition::simulate::SimulatedStudy;
use volition::trial::write;

#[tokio::test(flavor = "multi_thread")]
async fn signals_and_reports_are_the_same_bits_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("lab.db");
    let mut server = Server::start(&database, &[]);
    let (study, trials) = server.simulated_study(2).await;
    let analysis = id(&server
        .post("/v1/analyses", &json!({"kind": "ssid", "inputs": {"trial": trials[0]}, "spec": quick_spec()}))
        .await);
    let settled = server.settled(&study).await;
    assert_eq!(settled[0]["status"], "succeeded", "{}", settled[0]);
    let report = server.get_bytes(&format!("/v1/analyses/{analysis}/report"), "application/json").await;
    assert_eq!(server.process.interrupt(), Some(0));

    let server = Server::start(&database, &[]);
    assert_eq!(server.get_bytes(&format!("/v1/analyses/{analysis}/report"), "application/json").await, report);
    let simulated = SimulatedStudy::two_groups(1, 2, 20).unwrap();
    for (trial, number) in trials.iter().zip(1..) {
        let mut uploaded = Vec::new();
        write::csv(&simulated.trial(&simulated.groups[0].members[0], number).unwrap(), &mut uploaded).unwrap();
        let stored = server.get_bytes(&format!("/v1/trials/{trial}/signals"), "text/csv").await;
        // Shortest round-trip numbers: equal text is equal bits.
        assert!(stored == uploaded, "trial {number} came back changed");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_interrupted_server_hands_its_work_back() {
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("lab.db");
    let mut server = Server::start(&database, &["--drain-s", "0"]);
    let (study, trials) = server.simulated_study(1).await;
    // Minutes of work, so that the interrupt surely meets it.
    let spec = json!({
        "pool": {"name": "zhang2015_appendix_c", "thin": {"poles": 2, "zeros": 2, "gains": 2}}, "search": "exhaustive",
        "feedforward_numerator_degree": 2, "feedforward_denominator_degree": 2, "max_candidates": 100_000_000_000_u64
    });
    let request = json!({"kind": "ssid", "inputs": {"trial": trials[0]}, "spec": spec});
    let analysis = id(&server.post("/v1/analyses", &request).await);
    loop {
        let state = server.get(&format!("/v1/analyses/{analysis}")).await;
        assert_ne!(state["status"], "succeeded", "too quick to be interrupted");
        if state["status"] == "running" {
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    assert_eq!(server.process.interrupt(), Some(0));

    let server = Server::start(&database, &["--no-worker"]);
    let state = server.get(&format!("/v1/analyses/{analysis}")).await;
    assert_eq!((state["status"].as_str(), state["attempts"].as_u64()), (Some("queued"), Some(0)), "{state}");
    let cancelled = server.post(&format!("/v1/analyses/{analysis}/cancel"), &json!({})).await;
    assert_eq!(cancelled["status"], "cancelled");
    assert_eq!(server.settled(&study).await.len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_analysis_stops_while_it_runs() {
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("lab.db");
    let server = Server::start(&database, &["--no-worker"]);
    let (study, trials) = server.simulated_study(1).await;
    let spec = json!({
        "pool": {"name": "zhang2015_appendix_c", "thin": {"poles": 2, "zeros": 2, "gains": 2}}, "search": "exhaustive",
        "feedforward_numerator_degree": 2, "feedforward_denominator_degree": 2, "max_candidates": 100_000_000_000_u64
    });
    let request = json!({"kind": "ssid", "inputs": {"trial": trials[0]}, "spec": spec});
    let analysis = id(&server.post("/v1/analyses", &request).await);
    let mut worker = Process::worker(&database, 15.0, &["--until-idle"]);
    while server.get(&format!("/v1/analyses/{analysis}")).await["status"] != "running" {
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    server.post(&format!("/v1/analyses/{analysis}/cancel"), &json!({})).await;
    assert_eq!(worker.finish(), Some(0));
    assert_eq!(server.settled(&study).await[0]["status"], "cancelled");
}
