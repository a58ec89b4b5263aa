//! A form with files and their metadata.
#![no_main]

mod server;

use libfuzzer_sys::fuzz_target;
use serde_json::{Value, json};
use server::Server;
use std::sync::OnceLock;

/// The path to send files to: of a study with a plant and a subject.
fn path() -> &'static str {
    static PATH: OnceLock<String> = OnceLock::new();
    PATH.get_or_init(|| {
        let made = |path: &str, body: Value| {
            let (status, body) = Server::get().ask("POST", path, "application/json", body.to_string().into_bytes());
            assert_eq!(status, 201);
            serde_json::from_slice::<Value>(&body).unwrap()["id"].as_str().unwrap().to_owned()
        };
        let study = made("/v1/studies", json!({"name": "fuzz"}));
        let model = json!({"num": [1], "den": [1, 0], "sample_time_s": null});
        let plant = made(&format!("/v1/studies/{study}/plants"), json!({"name": "integrator", "model": model}));
        let subject = made(&format!("/v1/studies/{study}/subjects"), json!({"code": "s1"}));
        format!("/v1/subjects/{subject}/trials?plant={plant}")
    })
}

fuzz_target!(|data: &[u8]| {
    Server::get().ask("POST", path(), "multipart/form-data; boundary=x", data.to_vec());
    Server::get().ask("POST", &format!("{}&sample_time_s=0.02", path()), "text/csv", data.to_vec());
});
