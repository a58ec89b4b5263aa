//! Packed bytes, as a table of a trial and as they are; no more than the limit is ever unpacked.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::io::Read;
use volition::trial::Limits;
use volition::trial::csv::{self, Options};
use volition::trial::gzip::GzipReader;

fuzz_target!(|data: &[u8]| {
    let limits = Limits { max_rows: 1000, max_bytes: 1 << 16 };
    let _ = csv::read(GzipReader::new(data), &Options { limits, ..Options::default() });
    let mut unpacked = Vec::new();
    let _ = GzipReader::new(data).take(1 << 20).read_to_end(&mut unpacked);
});
