//! The service: the life of a job, the store, the worker, the interface, and the command in real processes.
#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs, unreachable_pub)]

#[path = "../support/contract.rs"]
mod contract;
#[path = "../support/property.rs"]
mod property;

mod api;
mod bundle;
mod clients;
mod jobs;
mod pages;
mod process;
mod store;
mod worker;
mod worker_bench;
