//! Sequences, flatness and the loop that carries them, against numbers computed independently from Qiu 2021 and by
//! other routes.
#![allow(clippy::unwrap_used, missing_docs, unreachable_pub)]

#[path = "../support/chapter_five.rs"]
mod chapter_five;
// Its other half is for what goes over HTTP.
#[allow(dead_code)]
#[path = "../support/contract.rs"]
mod contract;
#[path = "../support/property.rs"]
mod property;

mod cases;
mod compensator;
mod flatness;
mod input_design;
mod requests;
mod sequences;
mod support;
