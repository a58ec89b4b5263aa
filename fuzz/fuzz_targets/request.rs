//! A request for an analysis of any kind: what is taken is taken again in its canonical form, and means the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use volition::analysis::{Plan, Request};

fuzz_target!(|data: &[u8]| {
    let Ok(request) = serde_json::from_slice::<Request>(data) else { return };
    let Ok(plan) = Plan::parse(&request) else { return };
    let _ = plan.references();
    let canonical = plan.request();
    let again = Plan::parse(&canonical).unwrap_or_else(|problem| panic!("{problem}: {canonical:?}"));
    assert_eq!(again.request(), canonical);
    assert_eq!(again.kind(), plan.kind());
});
