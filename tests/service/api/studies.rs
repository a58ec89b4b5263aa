use crate::api::harness::TestServer;
use serde_json::{Value, json};

#[tokio::test]
async fn a_study_lives_from_post_to_delete() {
    let server = TestServer::start().await;
    let made = server.post("/v1/studies", &json!({"name": "  gm and gn ", "display_limit": 5.0})).await;
    let study = made.json(201);
    let path = format!("/v1/studies/{}", study["id"].as_str().unwrap());
    assert_eq!(made.header("location"), path);
    assert_eq!(study["name"], "gm and gn");
    assert_eq!(study["description"], "");
    assert_eq!(study["display_limit"], 5.0);
    assert_eq!(study["version"], 1);
    assert!(study["created_at"].as_str().unwrap().ends_with('Z'));
    assert_eq!(server.get(&path).await.json(200), study);

    let changed = server.patch(&path, &json!({"description": "two\nlines", "display_limit": null})).await.json(200);
    assert_eq!(changed["name"], "gm and gn");
    assert_eq!(changed["description"], "two\nlines");
    assert_eq!(changed["display_limit"], Value::Null);
    assert_eq!(changed["version"], 2);
    let same = server.patch(&path, &json!({})).await.json(200);
    assert_eq!(same["name"], "gm and gn");

    assert_eq!(server.delete(&path).await.status, 204);
    server.get(&path).await.problem(404, "not_found");
    server.delete(&path).await.problem(404, "not_found");
    server.finish().await;
}

#[tokio::test]
async fn deleting_a_study_takes_everything_in_it() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    assert_eq!(server.census().await, [1, 1, 1, 1, 0]);
    assert_eq!(server.delete(&format!("/v1/studies/{}", lab.study)).await.status, 204);
    assert_eq!(server.census().await, [0; 5]);
    for path in [
        format!("/v1/plants/{}", lab.plant),
        format!("/v1/subjects/{}", lab.subject),
        format!("/v1/trials/{trial}"),
        format!("/v1/trials/{trial}/signals"),
        format!("/v1/studies/{}/plants", lab.study),
        format!("/v1/studies/{}/subjects", lab.study),
        format!("/v1/subjects/{}/trials", lab.subject),
        format!("/v1/studies/{}/learning-curves", lab.study),
    ] {
        server.get(&path).await.problem(404, "not_found");
    }
    server.finish().await;
}
