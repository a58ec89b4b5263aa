//! The OpenAPI document: committed, and every operation in it works.

use crate::api::harness::{TestServer, gzip, recording};
use crate::contract::contract;
use serde_json::{Value, json};
use std::collections::BTreeSet;

#[test]
fn the_committed_document_is_the_program_s() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi/openapi.json");
    let committed = std::fs::read_to_string(path).unwrap_or_default();
    assert!(
        committed == format!("{}\n", volition::api::document()),
        "openapi/openapi.json is not what the program says; write it anew: volition openapi > openapi/openapi.json"
    );
}

#[test]
fn operations_are_whole() {
    let document: Value = serde_json::from_str(&volition::api::document()).unwrap();
    let mut ids = BTreeSet::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let name = format!("{method} {path}");
            assert!(ids.insert(operation["operationId"].as_str().unwrap().to_owned()), "{name}: operationId twice");
            assert!(!operation["summary"].as_str().unwrap_or_default().is_empty(), "{name} has no summary");
            let in_path = path.matches('{').count();
            let parameters = operation["parameters"].as_array().cloned().unwrap_or_default();
            assert_eq!(parameters.iter().filter(|p| p["in"] == "path").count(), in_path, "{name}");
            for parameter in &parameters {
                assert!(!parameter["description"].as_str().unwrap_or_default().is_empty(), "{name}: {parameter}");
            }
            for (status, response) in operation["responses"].as_object().unwrap() {
                assert!(!response["description"].as_str().unwrap_or_default().is_empty(), "{name} {status}");
                let is_problem = status.starts_with(['4', '5']);
                assert_eq!(
                    response["content"].get("application/problem+json").is_some(),
                    is_problem,
                    "{name} {status}"
                );
            }
        }
    }
}

/// An exercised operation: method, route, and the request that must succeed with this status.
struct Call {
    method: &'static str,
    route: &'static str,
    query: String,
    body: Option<Value>,
    status: u16,
}

/// A figure that what the route names has.
fn figure_of(route: &str) -> &'static str {
    match route {
        _ if route.contains("/trials/") => "signals",
        _ if route.contains("/studies/") => "mean_abs_error",
        _ => "response",
    }
}

#[tokio::test]
async fn every_operation_succeeds_over_http() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let request = json!({"kind": "frequency_response", "inputs": {"trial": trial}, "spec": {}});
    let done = server.post("/v1/analyses", &request).await.id(202);
    server.work().await;
    let succeeded = server.get(&format!("/v1/analyses/{done}")).await.json(200);
    assert_eq!(succeeded["status"], "succeeded", "{succeeded}");

    let model = json!({"num": [1.0], "den": [1.0, 2.0]});
    let call = |method, route, body, status| Call { method, route, query: String::new(), body, status };
    // In an order in which they can follow one another: deletions last.
    let calls = [
        call("GET", "/healthz", None, 200),
        call("GET", "/readyz", None, 200),
        call("GET", "/metrics", None, 200),
        call("GET", "/openapi.json", None, 200),
        call("GET", "/v1", None, 200),
        call("GET", "/v1/kinds", None, 200),
        call("POST", "/v1/studies", Some(json!({"name": "another"})), 201),
        call("GET", "/v1/studies", None, 200),
        call("GET", "/v1/studies/{study}", None, 200),
        call("PATCH", "/v1/studies/{study}", Some(json!({"description": "new"})), 200),
        call("POST", "/v1/studies/{study}/plants", Some(json!({"name": "another", "model": model})), 201),
        call("GET", "/v1/studies/{study}/plants", None, 200),
        call("GET", "/v1/plants/{plant}", None, 200),
        call("PATCH", "/v1/plants/{plant}", Some(json!({"name": "new"})), 200),
        call("POST", "/v1/studies/{study}/subjects", Some(json!({"code": "another"})), 201),
        call("GET", "/v1/studies/{study}/subjects", None, 200),
        call("GET", "/v1/subjects/{subject}", None, 200),
        call("PATCH", "/v1/subjects/{subject}", Some(json!({"group": "new"})), 200),
        Call {
            method: "POST",
            route: "/v1/subjects/{subject}/trials",
            query: format!("?plant={}&number=2&session=1", lab.plant),
            body: Some(json!({"sample_time_s": 0.1, "r": [0.0, 1.0], "u": [0.0, 0.5], "y": [0.0, 0.5]})),
            status: 201,
        },
        call("GET", "/v1/subjects/{subject}/trials", None, 200),
        call("GET", "/v1/studies/{study}/trials", None, 200),
        call("GET", "/v1/trials/{trial}", None, 200),
        call("PATCH", "/v1/trials/{trial}", Some(json!({"session": 2})), 200),
        call("GET", "/v1/trials/{trial}/signals", None, 200),
        call("POST", "/v1/analyses", Some(request.clone()), 202),
        call("GET", "/v1/analyses", None, 200),
        call("POST", "/v1/studies/{study}/analyses", Some(json!({"kind": "frequency_response"})), 202),
        call("GET", "/v1/studies/{study}/progress", None, 200),
        call("GET", "/v1/analyses/{analysis}", None, 200),
        call("GET", "/v1/analyses/{analysis}/report", None, 200),
        // A frequency response carries none.
        call("GET", "/v1/analyses/{analysis}/samples", None, 404),
        call("GET", "/v1/analyses/{analysis}/events", None, 200),
        call("POST", "/v1/analyses/{analysis}/cancel", None, 200),
        call("GET", "/v1/subjects/{subject}/learning-curves", None, 200),
        call("GET", "/v1/studies/{study}/learning-curves", None, 200),
        call("GET", "/v1/studies/{study}/comparison", None, 200),
        call("GET", "/v1/studies/{study}/frequency-responses", None, 200),
        call("GET", "/v1/studies/{study}/median-subjects", None, 200),
        call("GET", "/v1/figures/queue", None, 200),
        call("GET", "/v1/trust-rule", None, 200),
        // A frequency response has no models, and says so.
        call("GET", "/v1/analyses/{analysis}/model", None, 404),
        call("GET", "/v1/studies/{study}/table", None, 200),
        call("GET", "/v1/analyses/{analysis}/trust", None, 200),
        call("GET", "/v1/trials/{trial}/trust", None, 200),
        call("GET", "/v1/studies/{study}/trust", None, 200),
        call("GET", "/v1/trials/{trial}/figures", None, 200),
        call("GET", "/v1/trials/{trial}/figures/{name}", None, 200),
        call("GET", "/v1/studies/{study}/figures", None, 200),
        call("GET", "/v1/studies/{study}/figures/{name}", None, 200),
        call("GET", "/v1/analyses/{analysis}/figures", None, 200),
        call("GET", "/v1/analyses/{analysis}/figures/{name}", None, 200),
        call("GET", "/v1/figures/queue", None, 200),
        call("GET", "/v1/trust-rule", None, 200),
        call("GET", "/v1/analyses/{analysis}/trust", None, 200),
        call("GET", "/v1/trials/{trial}/trust", None, 200),
        call("GET", "/v1/studies/{study}/trust", None, 200),
        call("DELETE", "/v1/analyses/{analysis}", None, 204),
        call("DELETE", "/v1/trials/{trial}", None, 204),
        call("DELETE", "/v1/subjects/{subject}", None, 204),
        call("DELETE", "/v1/plants/{plant}", None, 204),
        call("DELETE", "/v1/studies/{study}", None, 204),
    ];

    let document: Value = serde_json::from_str(&server.get("/openapi.json").await.text()).unwrap();
    let documented: BTreeSet<String> = document["paths"]
        .as_object()
        .unwrap()
        .iter()
        .flat_map(|(path, item)| {
            item.as_object().unwrap().keys().map(move |method| format!("{} {path}", method.to_uppercase()))
        })
        .collect();
    let exercised: BTreeSet<String> = calls.iter().map(|call| format!("{} {}", call.method, call.route)).collect();
    assert_eq!(documented, exercised, "every documented operation is exercised, and no other");

    for Call { method, route, query, body, status } in calls {
        let path = route
            .replace("{study}", &lab.study)
            .replace("{plant}", &lab.plant)
            .replace("{subject}", &lab.subject)
            .replace("{trial}", &trial)
            .replace("{analysis}", &done)
            .replace("{name}", figure_of(route));
        let mut request = server.request(method, &format!("{path}{query}"));
        if let Some(body) = &body {
            request = request.json(body);
        }
        let answer = server.send(request).await;
        assert_eq!(answer.status.as_u16(), status, "{method} {path}: {}", answer.text());
        let operation = &document["paths"][route][method.to_lowercase()];
        let described = &operation["responses"][status.to_string()];
        assert!(described.is_object(), "{method} {route} answers {status}, which is not documented");
        if let Some(content) = described["content"].as_object() {
            let media = answer.header("content-type").split(';').next().unwrap();
            assert!(content.contains_key(media), "{method} {route} answers {media}, which is not documented");
        } else {
            assert!(answer.bytes.is_empty(), "{method} {route} answers with a body that is not documented");
        }
    }
    server.finish().await;
}

#[tokio::test]
async fn uploads_take_every_documented_media_type() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let document: Value = serde_json::from_str(&volition::api::document()).unwrap();
    let body = &document["paths"]["/v1/subjects/{subject}/trials"]["post"]["requestBody"]["content"];
    let documented: BTreeSet<&str> = body.as_object().unwrap().keys().map(String::as_str).collect();
    let files = [
        "text/csv",
        "text/tab-separated-values",
        "text/plain",
        "application/octet-stream",
        "application/zip",
        "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
    ];
    assert_eq!(documented, [&files[..], &["application/json", "multipart/form-data"]].concat().into_iter().collect());
    // The examples are requests that work.
    let path = format!("/v1/subjects/{}/trials?plant={}", lab.subject, lab.plant);
    let csv = body["text/csv"]["example"].as_str().unwrap().to_owned();
    server.send(server.request("POST", &path).header("content-type", "text/csv").body(csv.clone())).await.json(201);
    for media in files {
        server.send(server.request("POST", &path).header("content-type", media).body(csv.clone())).await.json(200);
    }
    let schema = &document["components"]["schemas"]["NewTrial"];
    // The same signals as those of the CSV, without a time column.
    server.post(&path, &schema["examples"][0]).await.json(200);
    let packed = reqwest::multipart::Part::bytes(gzip(recording(8, 1.0).as_bytes())).file_name("a.csv.gz");
    let form = reqwest::multipart::Form::new().part("files", packed);
    server.send(server.request("POST", &path).multipart(form)).await.json(201);
    for (path, schema) in [
        ("/v1/studies".to_owned(), "NewStudy"),
        (format!("/v1/studies/{}/plants", lab.study), "NewPlant"),
        (format!("/v1/studies/{}/subjects", lab.study), "NewSubject"),
    ] {
        let mut example = document["components"]["schemas"][schema]["examples"][0].clone();
        if schema == "NewPlant" {
            example["name"] = json!("example");
        }
        server.post(&path, &example).await.json(201);
    }
    server.finish().await;
}

/// The document is one of OpenAPI 3.1 by the meta-schema of its authors, without the dialect of schemas, which the next
/// test looks at.
#[test]
fn the_document_keeps_to_the_meta_schema() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/openapi-3.1-schema.json");
    let meta: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let validator = jsonschema::draft202012::new(&meta).unwrap();
    let errors: Vec<String> = validator
        .iter_errors(contract().document())
        .take(5)
        .map(|error| format!("{}: {:.300}", error.instance_path(), error.to_string()))
        .collect();
    assert!(errors.is_empty(), "{}", errors.join("\n"));
}

/// Every schema of the document, with its place.
fn schemas() -> Vec<(String, Value)> {
    fn below(place: &str, schema: &Value, into: &mut Vec<(String, Value)>) {
        into.push((place.to_owned(), schema.clone()));
        for key in ["properties", "$defs", "patternProperties"] {
            for (name, inner) in schema.get(key).and_then(Value::as_object).into_iter().flatten() {
                below(&format!("{place}/{key}/{name}"), inner, into);
            }
        }
        for key in ["anyOf", "oneOf", "allOf", "prefixItems"] {
            for (i, inner) in schema.get(key).and_then(Value::as_array).into_iter().flatten().enumerate() {
                below(&format!("{place}/{key}/{i}"), inner, into);
            }
        }
        for key in ["items", "additionalProperties"] {
            if let Some(inner) = schema.get(key).filter(|inner| inner.is_object()) {
                below(&format!("{place}/{key}"), inner, into);
            }
        }
    }
    let mut all = Vec::new();
    for (name, schema) in contract().document()["components"]["schemas"].as_object().unwrap() {
        below(name, schema, &mut all);
    }
    all
}

#[test]
fn schemas_are_valid_and_each_hangs_on_a_route() {
    let document = contract().document();
    let schemas = document["components"]["schemas"].as_object().unwrap();
    for (name, schema) in schemas {
        assert!(jsonschema::meta::is_valid(schema), "{name} is no JSON schema");
        let ends = name.chars().next_back().unwrap();
        assert!(!ends.is_ascii_digit(), "{name}: another type has this name already");
    }
    let mut reached = BTreeSet::new();
    let mut open = vec![document["paths"].clone()];
    while let Some(value) = open.pop() {
        match value {
            Value::Object(members) => {
                for (key, member) in members {
                    if let (true, Some(path)) = (key == "$ref", member.as_str()) {
                        let name = path.strip_prefix("#/components/schemas/").unwrap_or_else(|| panic!("{path}"));
                        let schema = schemas.get(name).unwrap_or_else(|| panic!("there is no schema {name}"));
                        if reached.insert(name.to_owned()) {
                            open.push(schema.clone());
                        }
                    } else {
                        open.push(member);
                    }
                }
            }
            Value::Array(items) => open.extend(items),
            _ => {}
        }
    }
    let stray: Vec<&String> = schemas.keys().filter(|name| !reached.contains(*name)).collect();
    assert!(stray.is_empty(), "schemas that hang on no route: {stray:?}");
}

#[test]
fn every_field_is_explained() {
    let mut bare = Vec::new();
    for (place, schema) in schemas() {
        for (name, field) in schema.get("properties").and_then(Value::as_object).into_iter().flatten() {
            let described =
                |schema: &Value| schema.get("description").and_then(Value::as_str).is_some_and(|d| d.len() > 2);
            if !described(field) {
                bare.push(format!("{place}/{name}"));
            }
        }
    }
    assert!(bare.is_empty(), "{} fields without a sentence:\n{}", bare.len(), bare.join("\n"));
}

#[test]
fn lists_have_lengths_objects_say_what_they_hold_and_alternatives_have_names() {
    let mut wrong = Vec::new();
    for (place, schema) in schemas() {
        if schema.get("items") == Some(&json!(false)) {
            wrong.push(format!("{place}: items: false"));
        }
        if let Some(items) = schema.get("prefixItems").and_then(Value::as_array) {
            let length = json!(items.len());
            if schema.get("minItems") != Some(&length) || schema.get("maxItems") != Some(&length) {
                wrong.push(format!("{place}: a tuple without its length"));
            }
        }
        let is_object = schema.get("type").is_some_and(|kind| kind == "object");
        if is_object && schema.get("properties").is_none() && schema.get("additionalProperties").is_none() {
            wrong.push(format!("{place}: an object that does not say what it holds"));
        }
        if schema.as_object().is_some_and(serde_json::Map::is_empty) || schema == json!(true) {
            wrong.push(format!("{place}: anything"));
        }
        for key in ["anyOf", "oneOf"] {
            let Some(choices) = schema.get(key).and_then(Value::as_array) else { continue };
            let is_null = |choice: &Value| choice.get("type").is_some_and(|kind| kind == "null");
            let others: Vec<&Value> = choices.iter().filter(|choice| !is_null(choice)).collect();
            let named = |choice: &&&Value| choice.get("$ref").is_some() || choice.get("title").is_some();
            if others.len() > 1 && !others.iter().all(|choice| named(&choice)) {
                wrong.push(format!("{place}: alternatives without names"));
            }
        }
    }
    assert!(wrong.is_empty(), "{} places:\n{}", wrong.len(), wrong.join("\n"));
}

/// The examples of the kinds are requests that run, and both they and their reports are as the document says.
#[test]
fn the_example_of_every_kind_runs() {
    for about in volition::analysis::registry::kinds() {
        let written: Value = serde_json::from_str(about.example).unwrap();
        contract().assert_component(&format!("{}Request", about.type_prefix()), &written);
        let request: volition::analysis::Request = serde_json::from_value(written).unwrap();
        let plan = volition::analysis::Plan::parse(&request).unwrap();
        assert_eq!(plan.kind(), about.kind);
        contract().assert_component("Request", &json!(plan.request()));
        let report = contract().run(&request, &Default::default(), &volition::ctl::Ctl::new()).unwrap();
        contract().assert_component(&format!("{}Report", about.type_prefix()), &json!(report));
    }
}
