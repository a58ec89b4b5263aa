//! Linear systems, matrix equations, convex programs, plants; optimal control and its inverse.
#![allow(clippy::unwrap_used, missing_docs, unreachable_pub)]

#[path = "../support/boundary_gains.rs"]
mod boundary_gains;
#[path = "../support/exact.rs"]
mod exact;
#[path = "../support/gain_classes.rs"]
mod gain_classes;
#[path = "../support/inverse_plants.rs"]
mod inverse_plants;
#[path = "../support/property.rs"]
mod property;
#[path = "../support/virtual_subjects.rs"]
mod virtual_subjects;

mod box_programs;
mod convex;
mod inverse;
mod inverse_boundary;
mod inverse_certificates;
mod inverse_random;
mod inverse_structures;
mod inverse_verdicts;
mod lti;
mod plants;
mod properties;
mod riccati;
mod seated_balance;
