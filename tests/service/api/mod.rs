//! The service over HTTP: every test has a server, a port and a database of its own.

mod analyses;
mod bad_input;
mod comparison;
mod conditional;
mod connections;
mod designs;
mod events;
mod excitation;
mod figures;
mod gain_fit;
pub mod harness;
mod inverse;
mod learning;
mod limits;
mod lqg_fit;
mod openapi;
mod plants;
mod recordings;
mod service;
mod simulate;
mod ssid;
mod studies;
mod subjects;
mod trials;
mod trust;
mod two_stimulus;
mod uploads;
