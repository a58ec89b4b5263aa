use crate::api::harness::TestServer;
use serde_json::{Value, json};

#[tokio::test]
async fn subjects_keep_code_group_and_attributes() {
    let server = TestServer::start().await;
    let study = server.study().await;
    let path = format!("/v1/studies/{study}/subjects");
    let attributes = json!({"age": 23, "handedness": "left", "x": [1.5, null]});
    let made = server.post(&path, &json!({"code": "s07", "group": "gn", "attributes": attributes})).await.json(201);
    assert_eq!((&made["code"], &made["group"]), (&json!("s07"), &json!("gn")));
    assert_eq!(made["attributes"], attributes);
    let bare = server.post(&path, &json!({"code": "s08"})).await.json(201);
    assert_eq!((&bare["group"], &bare["attributes"]), (&Value::Null, &json!({})));

    let own = format!("/v1/subjects/{}", made["id"].as_str().unwrap());
    let changed = server.patch(&own, &json!({"group": null})).await.json(200);
    assert_eq!((&changed["group"], &changed["attributes"]), (&Value::Null, &attributes));
    let changed = server.patch(&own, &json!({"attributes": {"age": 24}, "group": "gm"})).await.json(200);
    assert_eq!((&changed["group"], &changed["attributes"]), (&json!("gm"), &json!({"age": 24})));
    assert_eq!(server.patch(&own, &json!({"attributes": null})).await.json(200)["attributes"], json!({}));

    server.patch(&own, &json!({"code": "s08"})).await.problem(409, "conflict");
    server.post(&path, &json!({"code": "s08"})).await.problem(409, "conflict");
    assert_eq!(server.delete(&own).await.status, 204);
    server.get(&own).await.problem(404, "not_found");
    server.finish().await;
}

#[tokio::test]
async fn subjects_are_listed_by_group() {
    let server = TestServer::start().await;
    let study = server.study().await;
    let path = format!("/v1/studies/{study}/subjects");
    for (code, group) in [("a", "gm"), ("b", "gn & co"), ("c", "gm"), ("d", "gn & co"), ("e", "gn & co")] {
        server.post(&path, &json!({"code": code, "group": group})).await.json(201);
    }
    let codes = |list: &Value| -> Vec<String> {
        list["items"].as_array().unwrap().iter().map(|s| s["code"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(codes(&server.get(&format!("{path}?group=gm")).await.json(200)), ["a", "c"]);
    // The Link header leads through the pages, filter and all.
    let mut at = format!("{path}?group=gn%20%26%20co&limit=2");
    let mut found = Vec::new();
    let mut pages = 0;
    loop {
        let answer = server.get(&at).await;
        let page = answer.json(200);
        found.extend(codes(&page));
        pages += 1;
        match page["next_cursor"].as_str() {
            None => {
                assert!(!answer.headers.contains_key("link"));
                break;
            }
            Some(cursor) => {
                let link = answer.header("link");
                assert!(link.contains(cursor) && link.ends_with("; rel=\"next\""), "{link}");
                at = link.trim_start_matches('<').split('>').next().unwrap().to_owned();
            }
        }
    }
    assert_eq!((found, pages), (vec!["b".to_owned(), "d".into(), "e".into()], 2));
    server.finish().await;
}
