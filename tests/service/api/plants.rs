use crate::api::harness::TestServer;
use serde_json::json;

#[tokio::test]
async fn plants_come_as_transfer_functions_and_as_matrices() {
    let server = TestServer::start().await;
    let study = server.study().await;
    let path = format!("/v1/studies/{study}/plants");
    let models = [
        json!({"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0], "sample_time_s": null}),
        json!({"num": [0.1, 0.2], "den": [1.0, -0.5], "sample_time_s": 0.02}),
        json!({"a": [[0.0, 1.0], [-4.0, -3.6]], "b": [[0.0], [1.0]], "c": [[4.4, 2.0]], "d": [[0.0]],
            "sample_time_s": null}),
    ];
    for (i, model) in models.iter().enumerate() {
        let made = server.post(&path, &json!({"name": format!("plant {i}"), "model": model})).await;
        let plant = made.json(201);
        assert_eq!(&plant["model"], model, "a model is given back as it was given");
        assert_eq!(made.header("location"), format!("/v1/plants/{}", plant["id"].as_str().unwrap()));
        assert_eq!(server.get(made.header("location")).await.json(200), plant);
    }
    let listed = server.get(&path).await.json(200);
    assert_eq!(listed["items"].as_array().unwrap().len(), 3);
    server.finish().await;
}

#[tokio::test]
async fn a_plant_is_renamed_but_never_changed() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let path = format!("/v1/plants/{}", lab.plant);
    let renamed = server.patch(&path, &json!({"name": "minimum phase"})).await.json(200);
    assert_eq!((&renamed["name"], &renamed["version"]), (&json!("minimum phase"), &json!(2)));
    assert_eq!(server.patch(&path, &json!({})).await.json(200)["version"], 2);
    let refused = server.patch(&path, &json!({"model": {"num": [1.0], "den": [1.0]}})).await.problem(422, "invalid");
    assert_eq!(refused["where"], "/model");
    server.finish().await;
}

#[tokio::test]
async fn a_plant_in_use_stays() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let path = format!("/v1/plants/{}", lab.plant);
    server.delete(&path).await.problem(409, "conflict");
    assert_eq!(server.delete(&format!("/v1/trials/{trial}")).await.status, 204);
    assert_eq!(server.delete(&path).await.status, 204);
    server.finish().await;
}

#[tokio::test]
async fn names_are_taken_once_per_study() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let body = json!({"name": "gm", "model": {"num": [1.0], "den": [1.0, 1.0]}});
    server.post(&format!("/v1/studies/{}/plants", lab.study), &body).await.problem(409, "conflict");
    let third = server
        .post(&format!("/v1/studies/{}/plants", lab.study), &json!({"name": "x", "model": body["model"]}))
        .await
        .id(201);
    server.patch(&format!("/v1/plants/{third}"), &json!({"name": "gm"})).await.problem(409, "conflict");
    let other = server.study().await;
    server.post(&format!("/v1/studies/{other}/plants"), &body).await.json(201);
    server.finish().await;
}
