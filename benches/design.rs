//! How fast inputs are designed.
//!
//! `cargo bench --bench design` asserts the targets of one core: the case of Priess 2015, chapter 5 (300 samples) from
//! the 63-chip sequence to
//! 1.93 times its information in 2 s, and 1,200 samples in 60 s. `-- --smoke` asserts no times and leaves the long one
//! out.
#![allow(unreachable_pub, clippy::unwrap_used, clippy::print_stdout)]

use std::time::Instant;
use volition::ctl::Ctl;
use volition::excite::design::{Criterion, Settings, climb};

#[path = "../tests/support/chapter_five.rs"]
#[allow(dead_code, reason = "the tests use all of it")]
mod chapter_five;

fn main() {
    let smoke = std::env::args().any(|argument| argument == "--smoke");
    run(300, 2.0, !smoke);
    if !smoke {
        run(1200, 60.0, true);
    }
}

fn run(samples: usize, target_s: f64, strict: bool) {
    let begin = Instant::now();
    let case = chapter_five::case(samples);
    let settings =
        Settings { criterion: Criterion::T, radius: 0.5, tolerance: 1e-3, least_radius: 1.0 / 64.0, max_steps: 500 };
    let found = climb(&case.information, &case.limits, &case.start, &settings, &Ctl::new()).unwrap();
    let seconds = begin.elapsed().as_secs_f64();
    println!(
        "N = {samples}: {:.4} times the information in {seconds:.2} s (target {target_s} s); {} steps, {} programs, \
         {} iterations, {:?}",
        found.factor, found.steps, found.programs, found.iterations, found.stop
    );
    let shares = chapter_five::shares(&case, &found.input);
    println!("  shares of the limits (input, angles, bend, torque, autocorrelation): {shares:.4?}");
    assert!(found.factor >= 1.93 && shares.iter().all(|share| *share <= 1.0));
    assert!(!strict || seconds <= target_s, "{seconds} s");
}
