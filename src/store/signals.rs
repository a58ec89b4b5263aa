//! How a recorded column is packed: `pco`, lossless to the bit, with a checksum over the packed bytes.

use super::error::{StoreError, StoreResult};
use crate::num::hexadecimal::hexadecimal;
use crate::trial::{Channel, Signals, Trial};
use pco::ChunkConfig;
use pco::standalone::{simple_compress, simple_decompress};
use sha2::{Digest, Sha256};

/// The name of the packing in the database.
pub(super) const CODEC: &str = "pco1";

/// A packed column.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Packed {
    pub(super) channel: String,
    pub(super) codec: String,
    pub(super) samples: i64,
    pub(super) sha256: String,
    pub(super) data: Vec<u8>,
}

/// Packs every column of a trial.
pub(super) fn pack(trial: &Trial) -> StoreResult<Vec<Packed>> {
    Channel::ALL.into_iter().filter_map(|channel| Some(pack_column(channel, trial.signals.channel(channel)?))).collect()
}

fn pack_column(channel: Channel, column: &[f64]) -> StoreResult<Packed> {
    let data = simple_compress(column, &ChunkConfig::default())
        .map_err(|error| StoreError::Damaged(format!("column {} cannot be packed: {error}", channel.letter())))?;
    Ok(Packed {
        channel: channel.letter().to_owned(),
        codec: CODEC.to_owned(),
        samples: super::rows::signed(column.len() as u64),
        sha256: hexadecimal(&Sha256::digest(&data)),
        data,
    })
}

/// Unpacks a trial and proves by its content hash that it is, bit for bit, what was stored.
pub(super) fn unpack(id: &str, sample_time_s: f64, sha256: &str, columns: &[Packed]) -> StoreResult<Trial> {
    let column = |channel: Channel| -> StoreResult<Option<Vec<f64>>> {
        let letter = channel.letter();
        let Some(packed) = columns.iter().find(|packed| packed.channel == letter) else { return Ok(None) };
        unpack_column(packed)
            .map(Some)
            .map_err(|why| StoreError::Damaged(format!("trial {id}, column {letter}: {why}")))
    };
    let required = |channel: Channel| -> StoreResult<Vec<f64>> {
        column(channel)?
            .ok_or_else(|| StoreError::Damaged(format!("trial {id}: column {} is missing", channel.letter())))
    };
    let signals = Signals {
        time_s: column(Channel::Time)?,
        command: required(Channel::Command)?,
        control: required(Channel::Control)?,
        output: required(Channel::Output)?,
        disturbance: column(Channel::Disturbance)?,
    };
    let trial =
        Trial::new(sample_time_s, signals).map_err(|error| StoreError::Damaged(format!("trial {id}: {error}")))?;
    let found = hexadecimal(&trial.content_sha256());
    if found != sha256 {
        return Err(StoreError::Damaged(format!("trial {id}: its content has the hash {found}, not {sha256}")));
    }
    Ok(trial)
}

fn unpack_column(packed: &Packed) -> Result<Vec<f64>, String> {
    if packed.codec != CODEC {
        return Err(format!("it is packed as '{}', which this version does not know", packed.codec));
    }
    let found = hexadecimal(&Sha256::digest(&packed.data));
    if found != packed.sha256 {
        return Err(format!("its {} bytes have the hash {found}, not {}", packed.data.len(), packed.sha256));
    }
    let values: Vec<f64> = simple_decompress(&packed.data).map_err(|error| error.to_string())?;
    if values.len() as u64 != packed.samples.unsigned_abs() {
        return Err(format!("it has {} samples, not {}", values.len(), packed.samples));
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    fn bits(values: &[f64]) -> Vec<u64> {
        values.iter().map(|value| value.to_bits()).collect()
    }

    fn round_trip(values: &[f64]) -> Vec<f64> {
        unpack_column(&pack_column(Channel::Output, values).unwrap()).unwrap()
    }

    #[test]
    fn awkward_numbers_keep_their_bits() {
        let subnormal = f64::from_bits(1);
        let values = [0.0, -0.0, subnormal, -subnormal, f64::MIN_POSITIVE, f64::MAX, f64::MIN, f64::EPSILON, 0.1, -0.1];
        assert_eq!(bits(&round_trip(&values)), bits(&values));
        assert_eq!(round_trip(&[]), Vec::<f64>::new());
        // Decimal steps are what the codec looks for; it must not tidy them up.
        let steps: Vec<f64> = (0..5000).map(|k| f64::from(k) * 0.1 - 0.05).collect();
        assert_eq!(bits(&round_trip(&steps)), bits(&steps));
        let zeros: Vec<f64> = (0..1000).map(|k| if k % 3 == 0 { -0.0 } else { 0.0 }).collect();
        assert_eq!(bits(&round_trip(&zeros)), bits(&zeros));
    }

    fn from_seed() -> ProptestConfig {
        ProptestConfig { rng_seed: RngSeed::Fixed(4), failure_persistence: None, ..ProptestConfig::default() }
    }

    proptest! {
        #![proptest_config(from_seed())]

        #[test]
        fn any_bits_round_trip(words in prop::collection::vec(any::<u64>(), 0..600)) {
            let values: Vec<f64> = words.iter().map(|word| f64::from_bits(*word)).collect();
            prop_assert_eq!(bits(&round_trip(&values)), words);
        }

        #[test]
        fn measured_signals_round_trip(
            steps in prop::collection::vec(-2048_i32..2048, 1..3000),
            scale in prop::sample::select(vec![0.1, 0.01, 1.0 / 3.0, 1e-300]),
        ) {
            let values: Vec<f64> = steps.iter().map(|step| f64::from(*step) * scale).collect();
            prop_assert_eq!(bits(&round_trip(&values)), bits(&values));
        }

        #[test]
        fn any_flipped_bit_is_found(
            values in prop::collection::vec(-1e3_f64..1e3, 1..200),
            place in any::<prop::sample::Index>(),
            bit in 0..8,
        ) {
            let mut packed = pack_column(Channel::Output, &values).unwrap();
            let index = place.index(packed.data.len());
            packed.data[index] ^= 1u8 << bit;
            let why = unpack_column(&packed).unwrap_err();
            prop_assert!(why.contains("have the hash"), "{}", why);
        }
    }
}
