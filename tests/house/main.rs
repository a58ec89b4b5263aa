//! The house: which room uses which, what the lower rooms must not know, how tangled the files are, how long they are.
//!
//! `cargo test --test house figures -- --nocapture` prints the figures.
#![allow(clippy::print_stdout, clippy::unwrap_used, unreachable_pub)]

// The fuzz targets are compiled here as they stand, with this crate in the place of the fuzzer.
extern crate self as libfuzzer_sys;

mod builds;
mod figures;
mod fixture;
mod fuzz_targets;
mod graph;
mod layers;
mod resolve;
mod source;
mod tokens;

/// The folder of the project.
fn project() -> &'static std::path::Path {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
}
