//! Random streams that a seed and a name determine, on every machine and in every version.

use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::SeedableRng;
use sha2::{Digest, Sha256};

/// The generator behind every random number of the product.
pub type Stream = ChaCha12Rng;

/// The stream that belongs to a seed and a name.
///
/// Different names give independent streams, so adding a use of randomness in one place never moves the numbers
/// drawn in another.
#[must_use]
pub fn stream(seed: u64, name: &str) -> Stream {
    let mut hasher = Sha256::new();
    hasher.update(seed.to_le_bytes());
    hasher.update(name.as_bytes());
    Stream::from_seed(hasher.finalize().into())
}

#[cfg(test)]
mod tests {
    use super::stream;
    use rand::RngExt;

    #[test]
    fn a_stream_is_a_function_of_seed_and_name() {
        let draw = |seed, name| stream(seed, name).random::<u64>();
        assert_eq!(draw(7, "remnant"), draw(7, "remnant"));
        assert_ne!(draw(7, "remnant"), draw(8, "remnant"));
        assert_ne!(draw(7, "remnant"), draw(7, "delay"));
    }
}
