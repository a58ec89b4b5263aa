//! How properties are drawn: from recorded seeds.

use proptest::test_runner::{Config, RngSeed};

/// Draws `cases` from a fixed seed, or from that of the environment variable `PROPTEST_RNG_SEED`. A test that fails
/// prints the seed with the smallest failing case.
pub fn from_seed(seed: u64, cases: u32) -> Config {
    let mut config = Config::with_cases(cases);
    if config.rng_seed == RngSeed::Random {
        config.rng_seed = RngSeed::Fixed(seed);
    }
    config.failure_persistence = None;
    eprintln!("drawn with PROPTEST_RNG_SEED={}", config.rng_seed);
    config
}
