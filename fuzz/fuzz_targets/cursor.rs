//! The place in a list that a client asks for, and how many rows of it.
#![no_main]

mod server;

use libfuzzer_sys::fuzz_target;
use server::Server;

fuzz_target!(|data: &[u8]| {
    let encoded: String = data.iter().map(|byte| format!("%{byte:02X}")).collect();
    let server = Server::get();
    server.ask("GET", &format!("/v1/studies?cursor={encoded}"), "application/json", Vec::new());
    // As it stands, where that is an address at all.
    let Ok(text) = std::str::from_utf8(data) else { return };
    let path = format!("/v1/analyses?{text}");
    if path.parse::<axum::http::Uri>().is_ok() {
        server.ask("GET", &path, "application/json", Vec::new());
    }
});
