//! A table of a trial: what is read is finite, and reads the same when it is written.
#![no_main]

use libfuzzer_sys::fuzz_target;
use volition::trial::csv::{self, Options};
use volition::trial::{Limits, write};

fuzz_target!(|data: &[u8]| {
    let Some((first, text)) = data.split_first() else { return };
    let limits = Limits { max_rows: 1000, max_bytes: 1 << 16 };
    let sample_time_s = (first % 2 == 1).then_some(0.02);
    let Ok(found) = csv::read(text, &Options { sample_time_s, limits, ..Options::default() }) else { return };
    assert!(found.trial.sample_time_s > 0.0 && found.trial.signals.output.iter().all(|y| y.is_finite()));
    let mut written = Vec::new();
    write::csv(&found.trial, &mut written).unwrap();
    let options = Options { sample_time_s: Some(found.trial.sample_time_s), ..Options::default() };
    let again = csv::read(written.as_slice(), &options).unwrap().trial;
    assert_eq!(again.content_sha256(), found.trial.content_sha256());
});
