//! What a person does, from recordings: frequency responses, subsystem identification, two stimuli, gains by
//! likelihood.
#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs, unreachable_pub)]

// Its other half is for what goes over HTTP.
#[allow(dead_code)]
#[path = "../support/contract.rs"]
mod contract;
#[path = "../support/lqg_people.rs"]
mod lqg_people;
#[path = "../support/virtual_people.rs"]
mod virtual_people;
#[path = "../support/virtual_subjects.rs"]
mod virtual_subjects;

mod cases;
mod gain_fit;
mod gain_fit_filter;
mod lqg_fit;
mod lqg_fit_models;
mod prediction_error;
mod response;
mod response_doubts;
mod response_leakage;
mod simulate;
mod ssid_appendix_b;
mod ssid_coverage;
mod ssid_delayed;
mod ssid_equivalent;
mod ssid_examples;
mod ssid_held;
mod ssid_kept;
mod ssid_mimo;
mod ssid_mimo_random;
mod ssid_pool;
mod ssid_refine;
mod ssid_search;
mod ssid_virtual;
mod two_stimulus;
mod two_stimulus_regularised;
