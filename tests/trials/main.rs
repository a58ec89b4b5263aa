//! Recordings as a lab has them: readers and writers, metrics, learning curves, import, the demonstration.
#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs, unreachable_pub)]

#[path = "../support/property.rs"]
mod property;
#[path = "../support/round_trip.rs"]
mod round_trip;
#[path = "../support/virtual_subjects.rs"]
mod virtual_subjects;

mod archives;
mod comparison;
mod comparison_study;
mod curves;
mod demo;
#[cfg(feature = "hdf5")]
mod hdf5;
mod import;
mod instruments;
mod layouts;
mod matlab;
mod metrics;
mod readers;
mod round_trips;
mod time_columns;
mod trust;
