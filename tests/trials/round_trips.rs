//! Every bit comes back, and nothing that is read brings a reader down.

use super::readers::{read, table, unpack, with_times};
use crate::property::from_seed;
use crate::round_trip::{check_round_trip, gzip};
use proptest::prelude::*;
use std::io::Read;
use volition::trial::csv::Options;
use volition::trial::gzip::GzipReader;
use volition::trial::{Limits, Signals, Trial, csv, json};

fn finite() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<u64>().prop_map(f64::from_bits).prop_filter("finite", |x| x.is_finite()),
        -10.0..10.0_f64,
        Just(-0.0),
        Just(1e-320),
        Just(f64::MAX),
        Just(f64::MIN_POSITIVE),
    ]
}

fn trials() -> impl Strategy<Value = Trial> {
    let rows = prop::collection::vec((finite(), finite(), finite(), finite()), 2..40);
    (rows, any::<bool>(), any::<bool>(), 1e-4..10.0_f64, -100.0..100.0_f64).prop_map(
        |(rows, timed, disturbed, sample_time_s, start_s)| {
            let signals = Signals {
                time_s: timed.then(|| (0..rows.len()).map(|i| start_s + i as f64 * sample_time_s).collect()),
                command: rows.iter().map(|row| row.0).collect(),
                control: rows.iter().map(|row| row.1).collect(),
                output: rows.iter().map(|row| row.2).collect(),
                disturbance: disturbed.then(|| rows.iter().map(|row| row.3).collect()),
            };
            Trial::new(sample_time_s, signals).unwrap()
        },
    )
}

proptest! {
    #![proptest_config(from_seed(20_150_401, 256))]

    #[test]
    fn what_is_written_reads_back_bit_for_bit(trial in trials()) {
        check_round_trip(&trial);
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = read(&bytes);
        let _ = unpack(&bytes);
        let _ = unpack(&[vec![0x1f, 0x8b, 8, 0], bytes.clone()].concat());
        let _ = json::read(bytes.as_slice(), None, &Limits::default());
        let _ = read([b"t,r,u,y\n".to_vec(), bytes].concat());
    }

    #[test]
    fn nearly_right_tables_never_panic(text in "(t|r|u|y|d|,|\n|\r|\"|0|1|2|9|-|\\.|e|NaN| |;){0,80}") {
        let _ = read(&text);
        let _ = read(format!("t,r,u,y\n{text}"));
        let options = Options { sample_time_s: Some(0.1), ..Options::default() };
        let _ = csv::read(format!("r,u,y\n{text}").as_bytes(), &options);
    }

    #[test]
    fn arbitrary_times_never_panic(times in prop::collection::vec(finite(), 2..30)) {
        let _ = with_times(&times);
        let mut sorted = times;
        sorted.sort_by(f64::total_cmp);
        let _ = with_times(&sorted);
    }
}

#[test]
fn reading_at_most_a_byte_at_a_time_changes_nothing() {
    struct Trickle<'a>(&'a [u8]);
    impl Read for Trickle<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            let count = self.0.len().min(buffer.len()).min(1);
            buffer[..count].copy_from_slice(&self.0[..count]);
            self.0 = &self.0[count..];
            Ok(count)
        }
    }
    let plain = table(|_| ());
    let packed = gzip(plain.as_bytes());
    let trickled = csv::read(GzipReader::new(Trickle(&packed)), &Options::default()).unwrap();
    assert_eq!(trickled, read(&plain).unwrap());
}
