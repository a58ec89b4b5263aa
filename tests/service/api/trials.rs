use crate::api::harness::{TestServer, recording};
use serde_json::{Value, json};

#[tokio::test]
async fn a_trial_is_renumbered_and_deleted() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    server.trial(&lab, 2).await;
    let path = format!("/v1/trials/{trial}");
    let changed = server.patch(&path, &json!({"number": 7, "session": null})).await.json(200);
    assert_eq!((&changed["number"], &changed["session"], &changed["version"]), (&json!(7), &Value::Null, &json!(2)));
    server.patch(&path, &json!({"number": 2, "session": 1})).await.problem(409, "conflict");
    let refused = server.patch(&path, &json!({"number": 0})).await.problem(422, "invalid");
    assert_eq!(refused["where"], "/number");
    assert_eq!(server.patch(&path, &json!([])).await.problem(422, "invalid")["where"], "/", "an array is no patch");
    assert_eq!(server.patch(&path, &json!({"number": 8.0})).await.json(200)["number"], 8);
    assert_eq!(
        server.patch(&path, &json!({"plant": lab.plant})).await.json(200)["plant"],
        json!(lab.plant),
        "as it is"
    );
    server.patch(&path, &json!({"subject": lab.subject})).await.problem(422, "invalid");
    assert_eq!(server.delete(&path).await.status, 204);
    server.get(&path).await.problem(404, "not_found");
    assert_eq!(server.census().await[3], 1);
    server.finish().await;
}

#[tokio::test]
async fn divergence_follows_the_display_limit() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let csv = "t,r,u,y\n0,0,0,0\n0.1,1,1,4.5\n0.2,1,1,-6\n0.3,1,1,2\n";
    let made = server.upload_csv(&lab, "", csv).await.json(201);
    assert_eq!(made["metrics"]["divergent"], true);
    assert!(made["warnings"].to_string().contains("divergent"));
    let trial = format!("/v1/trials/{}", made["id"].as_str().unwrap());
    let before = server.get(&trial).await.header("etag").to_owned();
    let study = format!("/v1/studies/{}", lab.study);
    server.patch(&study, &json!({"display_limit": 6.0})).await.json(200);
    let after = server.get(&trial).await;
    assert_eq!(after.json(200)["metrics"]["divergent"], false, "6 does not pass 6");
    assert_ne!(after.header("etag"), before, "what changed has another ETag");
    server.patch(&study, &json!({"display_limit": null})).await.json(200);
    assert_eq!(server.get(&trial).await.json(200)["metrics"]["divergent"], false);
    server.finish().await;
}

#[tokio::test]
async fn signals_come_back_bit_for_bit() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    // Numbers that careless writers lose: subnormal, negative zero, many digits, large exponents.
    let columns: [Vec<f64>; 4] = [
        vec![0.1 + 0.2, -0.0, 5e-324, 1.0],
        vec![1.797_693_134_862_315_7e308, 1e-300, -2.5, 1.0 / 3.0],
        vec![-0.0, 123_456_789.123_456_79, 2.0_f64.powi(-1022), 4.0],
        vec![9_007_199_254_740_993.0, 0.1, -1e22, 1e23],
    ];
    let body = json!({"sample_time_s": 0.01, "r": columns[0], "u": columns[1], "y": columns[2], "d": columns[3]});
    let path = format!("/v1/subjects/{}/trials?plant={}", lab.subject, lab.plant);
    let made = server.post(&path, &body).await.json(201);
    assert_eq!(made["has_disturbance"], true);
    let signals = format!("/v1/trials/{}/signals", made["id"].as_str().unwrap());

    let answer = server.send(server.request("GET", &signals).header("accept", "application/json")).await;
    let document = answer.json(200);
    assert_eq!(document["sample_time_s"], 0.01);
    assert!(document.get("t").is_none());
    for (name, column) in ["r", "u", "y", "d"].iter().zip(&columns) {
        let back: Vec<u64> = document[name].as_array().unwrap().iter().map(|x| x.as_f64().unwrap().to_bits()).collect();
        assert_eq!(back, column.iter().map(|x| x.to_bits()).collect::<Vec<_>>(), "{name}");
    }
    let answer = server.get(&signals).await;
    assert!(answer.header("content-type").starts_with("text/csv"));
    assert_eq!(answer.header("volition-sample-time-s"), "0.01");
    let text = answer.text();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("r,u,y,d"));
    for (i, line) in lines.enumerate() {
        let row: Vec<u64> = line.split(',').map(|x| x.parse::<f64>().unwrap().to_bits()).collect();
        assert_eq!(row, columns.iter().map(|c| c[i].to_bits()).collect::<Vec<_>>(), "row {i}");
    }
    // What was downloaded is the same content when it is uploaded again, by either way.
    let again = server.upload_csv(&lab, "&sample_time_s=0.01", text).await.json(200);
    assert_eq!((&again["duplicate"], &again["sha256"]), (&json!(true), &made["sha256"]));
    server.finish().await;
}

#[tokio::test]
async fn a_long_recording_is_streamed_whole() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let csv = recording(60_000, 1.0);
    let made = server.upload_csv(&lab, "", csv.clone()).await.json(201);
    assert_eq!(made["samples"], 60_000);
    let answer = server.get(&format!("/v1/trials/{}/signals", made["id"].as_str().unwrap())).await;
    let numbers = |text: &str| -> Vec<Vec<u64>> {
        text.lines().skip(1).map(|l| l.split(',').map(|x| x.parse::<f64>().unwrap().to_bits()).collect()).collect()
    };
    assert!(numbers(&answer.text()) == numbers(&csv));
    server.finish().await;
}

#[tokio::test]
async fn signals_are_negotiated_and_cached() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let path = format!("/v1/trials/{trial}/signals");
    let html = server.send(server.request("GET", &path).header("accept", "text/html")).await;
    assert_eq!(html.problem(406, "not_acceptable")["where"], "header Accept");
    let csv = server.get(&path).await.header("etag").to_owned();
    let json = server.send(server.request("GET", &path).header("accept", "application/json")).await;
    assert_ne!(json.header("etag"), csv);
    let known = server.send(server.request("GET", &path).header("if-none-match", &csv)).await;
    assert_eq!((known.status.as_u16(), known.bytes.len(), known.header("etag")), (304, 0, csv.as_str()));
    server.finish().await;
}
