use crate::harness::{Lab, TestServer};
use serde_json::{Value, json};

#[tokio::test]
async fn curves_before_anything_is_identified() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    for number in 1..=3 {
        server.trial(&lab, number).await;
    }
    let wild = "t,r,u,y\n0,0,0,0\n0.1,1,1,4.5\n0.2,1,1,-6\n0.3,1,1,2\n";
    server.upload_csv(&lab, "&number=4&session=1", wild).await.json(201);

    let path = format!("/v1/subjects/{}/learning-curves", lab.subject);
    let curve = server.get(&path).await.json(200);
    assert_eq!((&curve["code"], &curve["group"]), (&json!("s01"), &json!("gm")));
    let curve = &curve["curves"][0];
    assert_eq!(curve["plant"], json!({"id": lab.plant, "name": "gm"}));
    assert_eq!(numbers(&curve["points"]), [1, 2, 3]);
    assert_eq!(numbers(&curve["left_out"]), [4]);
    assert_eq!(curve["spec"], Value::Null);
    let first = server.get(&format!("/v1/trials/{}", curve["points"][0]["trial"].as_str().unwrap())).await.json(200);
    assert_eq!(curve["points"][0]["mean_abs_error"], first["metrics"]["mean_abs_error"]);

    let all = server.get(&format!("{path}?include_divergent=true")).await.json(200);
    assert_eq!(numbers(&all["curves"][0]["points"]), [1, 2, 3, 4]);
    let none = server.get(&format!("{path}?session=2")).await.json(200);
    assert_eq!(none["curves"], json!([]));
    let one = server.get(&format!("{path}?plant={}&session=1", lab.plant)).await.json(200);
    assert_eq!(one["curves"].as_array().unwrap().len(), 1);

    let study = server.get(&format!("/v1/studies/{}/learning-curves", lab.study)).await.json(200);
    assert_eq!((&study["groups"][0]["group"], &study["trim"]), (&json!("gm"), &json!(1)));
    let responses = server.get(&format!("/v1/studies/{}/frequency-responses", lab.study)).await.json(200);
    assert_eq!(responses["omega_rad_s"], json!([]));
    let grid = format!("/v1/studies/{}/frequency-responses?omega_from_rad_s=1&omega_to_rad_s=3&points=5", lab.study);
    assert_eq!(server.get(&grid).await.json(200)["omega_rad_s"], json!([1.0, 1.5, 2.0, 2.5, 3.0]));
    server.finish().await;
}

fn numbers(list: &Value) -> Vec<i64> {
    list.as_array().unwrap().iter().map(|p| p["number"].as_i64().unwrap()).collect()
}

#[tokio::test]
async fn groups_are_told_apart() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    server.trial(&lab, 1).await;
    let body = json!({"code": "s02", "group": "gn"});
    let other = server.post(&format!("/v1/studies/{}/subjects", lab.study), &body).await.id(201);
    lab = Lab { subject: other, ..lab };
    server.trial(&lab, 2).await;
    let path = format!("/v1/studies/{}/learning-curves", lab.study);
    let groups = |value: &Value| -> Vec<String> {
        value["groups"].as_array().unwrap().iter().map(|g| g["group"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(groups(&server.get(&path).await.json(200)), ["gm", "gn"]);
    assert_eq!(groups(&server.get(&format!("{path}?group=gn")).await.json(200)), ["gn"]);
    server.finish().await;
}
