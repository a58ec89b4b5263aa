//! A document of a trial: what is read reads the same when it is written, and as a value.
#![no_main]

use libfuzzer_sys::fuzz_target;
use volition::trial::{Limits, json, write};

fuzz_target!(|data: &[u8]| {
    let limits = Limits { max_rows: 1000, max_bytes: 1 << 16 };
    let found = json::read(data, None, &limits);
    let Ok(found) = found.or_else(|_| json::read(data, Some(0.02), &limits)) else { return };
    let again = json::from_value(&write::json_value(&found), &limits).unwrap();
    assert_eq!(again.content_sha256(), found.content_sha256());
});
