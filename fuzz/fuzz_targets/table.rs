//! A file of a lab, whatever it is: what is read is finite, and reads the same when it is written.
#![no_main]

use libfuzzer_sys::fuzz_target;
use volition::exchange::{self, Options, Resampling, TimeUnit, options};
use volition::trial::{Limits, write};

fuzz_target!(|data: &[u8]| {
    let Some((first, file)) = data.split_first() else { return };
    let limits = Limits { max_rows: 1000, max_bytes: 1 << 16 };
    let mapping = if first & 8 == 0 { None } else { options::columns("t:1,r:2,u:3,y:4").ok() };
    let options = Options {
        columns: mapping.unwrap_or_default(),
        time_unit: (first & 1 == 1).then_some(TimeUnit::Milliseconds),
        sample_time_s: (first & 2 == 2).then_some(0.02),
        resample: (first & 4 == 4).then_some(Resampling::Linear),
        limits,
        ..Options::default()
    };
    let Ok(found) = exchange::read(file, &options) else { return };
    assert!(found.trial.sample_time_s > 0.0 && found.trial.signals.output.iter().all(|y| y.is_finite()));
    let mut written = Vec::new();
    write::csv(&found.trial, &mut written).unwrap();
    let plain = Options { sample_time_s: Some(found.trial.sample_time_s), ..Options::default() };
    let again = exchange::read(&written, &plain).unwrap().trial;
    assert_eq!(again.content_sha256(), found.trial.content_sha256());
});
