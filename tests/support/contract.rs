//! Holds what goes over the wire against the OpenAPI document, with a validator that knows nothing of this program.

use jsonschema::{Draft, Validator};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Mutex};
use volition::analysis::{Failure, Library, Plan, Report, Request};
use volition::ctl::Ctl;

static CONTRACT: LazyLock<Contract> = LazyLock::new(Contract::new);

/// The document, with a validator for each schema that was needed so far.
pub struct Contract {
    document: Value,
    validators: Mutex<HashMap<String, Arc<Validator>>>,
}

/// The document that every test is held against.
pub fn contract() -> &'static Contract {
    &CONTRACT
}

impl Contract {
    fn new() -> Self {
        let document = serde_json::from_str(&volition::api::document()).expect("the document is JSON");
        Self { document, validators: Mutex::default() }
    }

    /// The document itself.
    pub fn document(&self) -> &Value {
        &self.document
    }

    /// Fails unless the value is one that the schema of this name allows.
    #[track_caller]
    pub fn assert_component(&self, name: &str, value: &Value) {
        let schema = json!({"$ref": format!("#/components/schemas/{name}")});
        self.assert_valid(&format!("component {name}"), &schema, value);
    }

    /// Fails unless the request and the answer are as the operation says. Requests that were refused may be anything.
    #[track_caller]
    pub fn assert_exchange(&self, exchange: &Exchange<'_>) {
        let Exchange { method, path, status, .. } = *exchange;
        let Some((route, operation)) = self.operation(method, path) else {
            // What is no operation at all is answered with a problem.
            return;
        };
        let name = format!("{method} {route}");
        if let (Some(body), 200..300) = (exchange.request, status) {
            let content = &operation["requestBody"]["content"]["application/json"];
            assert!(content.is_object(), "{name} takes JSON, which is not documented");
            self.assert_valid(&format!("request of {name}"), &content["schema"], body);
        }
        let answer = &operation["responses"][status.to_string()];
        assert!(answer.is_object(), "{name} answers {status}, which is not documented");
        if let Some(body) = exchange.answer {
            let schema = &answer["content"][exchange.media_type]["schema"];
            assert!(
                schema.is_object(),
                "{name} answers {status} with {}, which is not documented",
                exchange.media_type
            );
            self.assert_valid(&format!("answer {status} of {name}"), schema, body);
        }
    }

    /// The route and the operation that a path belongs to; one without parameters before others.
    fn operation(&self, method: &str, path: &str) -> Option<(&str, &Value)> {
        let path = path.split('?').next().unwrap_or_default();
        let fits = |route: &str| {
            let (route, path): (Vec<&str>, Vec<&str>) = (route.split('/').collect(), path.split('/').collect());
            route.len() == path.len() && route.iter().zip(&path).all(|(part, own)| part == own || part.starts_with('{'))
        };
        let routes = self.document["paths"].as_object()?.iter().filter(|(route, _)| fits(route));
        let (route, item) = routes.min_by_key(|(route, _)| route.matches('{').count())?;
        item.get(method.to_lowercase()).map(|operation| (route.as_str(), operation))
    }

    /// Computes what a request asks for, and fails unless it and its report are as the document says.
    ///
    /// # Errors
    /// Those of [`Plan::parse`] and [`Plan::run`].
    pub fn run(&self, request: &Request, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        let plan = Plan::parse(request)?;
        self.assert_component("Request", &json!(request));
        let report = plan.run(library, ctl)?;
        self.assert_component("Report", &json!(report));
        Ok(report)
    }

    #[track_caller]
    fn assert_valid(&self, what: &str, schema: &Value, value: &Value) {
        let validator = self.validator(what, schema);
        let errors: Vec<String> = validator
            .iter_errors(value)
            .take(5)
            .map(|error| format!("  at {}: {:.300}", error.instance_path(), error.to_string()))
            .collect();
        assert!(errors.is_empty(), "{what} is not as the OpenAPI document says:\n{}", errors.join("\n"));
    }

    fn validator(&self, what: &str, schema: &Value) -> Arc<Validator> {
        let key = schema.to_string();
        let mut validators = self.validators.lock().expect("no test panics while it holds this");
        let made = validators.entry(key).or_insert_with(|| {
            let mut whole = schema.clone();
            whole["components"] = self.document["components"].clone();
            let made = jsonschema::options().with_draft(Draft::Draft202012).build(&whole);
            Arc::new(made.unwrap_or_else(|error| panic!("the schema of {what} is none: {error}")))
        });
        Arc::clone(made)
    }
}

/// A request and its answer, as far as they are JSON.
pub struct Exchange<'a> {
    pub method: &'a str,
    pub path: &'a str,
    /// The body of the request.
    pub request: Option<&'a Value>,
    pub status: u16,
    /// The media type of the answer, without parameters.
    pub media_type: &'a str,
    /// The body of the answer.
    pub answer: Option<&'a Value>,
}
