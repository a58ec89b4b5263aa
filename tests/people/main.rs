//! Two recorded people (the data of CPHS 2017, 120 trials), which are not in the repository.
//!
//! `cargo test --release --test people` runs these tests and fails where the data are not. They are sought in the
//! folder that `VOLITION_CPHS2017` names, or in `../shared/data/cphs2017`.
#![allow(clippy::unwrap_used, missing_docs, unreachable_pub)]

// Its other half is for what goes over HTTP.
#[allow(dead_code)]
#[path = "../support/contract.rs"]
mod contract;
#[path = "../support/round_trip.rs"]
mod round_trip;

mod frequency;
mod import;
mod readers;
mod recordings;
mod ssid;
mod two_stimulus;
