//! Trials that are written and read again.

use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::Write;
use volition::trial::csv::Options;
use volition::trial::gzip::GzipReader;
use volition::trial::{Limits, Signals, Trial, csv, json, write};

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn bits(column: &[f64]) -> Vec<u64> {
    column.iter().map(|x| x.to_bits()).collect()
}

fn same_bits(a: &Signals, b: &Signals) {
    for (a, b) in [(&a.command, &b.command), (&a.control, &b.control), (&a.output, &b.output)] {
        assert_eq!(bits(a), bits(b));
    }
    assert_eq!(a.disturbance.as_deref().map(bits), b.disturbance.as_deref().map(bits));
    assert_eq!(a.time_s.as_deref().map(bits), b.time_s.as_deref().map(bits));
}

/// As CSV and as JSON, every bit comes back.
pub fn check_round_trip(trial: &Trial) {
    let mut text = Vec::new();
    write::csv(trial, &mut text).unwrap();
    let options = Options { sample_time_s: Some(trial.sample_time_s), ..Options::default() };
    let back = csv::read(GzipReader::new(gzip(&text).as_slice()), &options).unwrap().trial;
    same_bits(&trial.signals, &back.signals);
    assert_eq!(back.content_sha256(), trial.content_sha256());

    let mut text = Vec::new();
    write::json(trial, &mut text).unwrap();
    let back = json::read(text.as_slice(), None, &Limits::default()).unwrap();
    same_bits(&trial.signals, &back.signals);
    assert_eq!(back.content_sha256(), trial.content_sha256());
    let value: serde_json::Value = serde_json::from_slice(&text).unwrap();
    assert_eq!(value, write::json_value(trial));
    let back = json::from_value(&value, &Limits::default()).unwrap();
    assert_eq!(back.content_sha256(), trial.content_sha256());
}
