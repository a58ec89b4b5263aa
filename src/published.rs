//! Requests and reports of the unit tests, held against the OpenAPI document by a validator that knows nothing of this
//! program. The tests over HTTP have more of this in `tests/support/contract.rs`.

use crate::analysis::registry::About;
use crate::analysis::{Kind, Report, Request};
use jsonschema::{Draft, Validator};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Mutex};

static VALIDATORS: LazyLock<Mutex<HashMap<String, Arc<Validator>>>> = LazyLock::new(Mutex::default);

static DOCUMENT: LazyLock<Value> =
    LazyLock::new(|| serde_json::from_str(&crate::api::document()).expect("the document is JSON"));

fn validator(component: &str) -> Arc<Validator> {
    let mut made = VALIDATORS.lock().expect("no test panics while it holds this");
    let validator = made.entry(component.to_owned()).or_insert_with(|| {
        let schema = json!({
            "$ref": format!("#/components/schemas/{component}"),
            "components": DOCUMENT["components"],
        });
        let made = jsonschema::options().with_draft(Draft::Draft202012).build(&schema);
        Arc::new(made.unwrap_or_else(|error| panic!("the schema {component} is none: {error}")))
    });
    Arc::clone(validator)
}

#[track_caller]
fn hold(component: &str, value: &Value) {
    let errors: Vec<String> = validator(component)
        .iter_errors(value)
        .take(5)
        .map(|error| format!("  at {}: {:.300}", error.instance_path(), error.to_string()))
        .collect();
    assert!(errors.is_empty(), "this is no {component} of the OpenAPI document:\n{}", errors.join("\n"));
}

fn prefix(kind: Kind) -> String {
    crate::analysis::registry::kinds().find(|about| about.kind == kind).map(About::type_prefix).expect("listed")
}

/// Fails unless the document allows this request, which has been understood.
#[track_caller]
pub(crate) fn request(request: &Request) {
    let kind = request.kind.parse().expect("understood requests have a kind");
    hold(&format!("{}Request", prefix(kind)), &json!(request));
}

/// Fails unless the document allows this report.
#[track_caller]
pub(crate) fn report(report: &Report) {
    hold(&format!("{}Report", prefix(report.kind)), &json!(report));
}
