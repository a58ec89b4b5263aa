//! Every recording is read, and written and read again.

use crate::recordings::{folder, read};
use crate::round_trip::check_round_trip;
use std::path::PathBuf;
use volition::trial::ReadTrial;

#[test]
fn recordings_of_people_are_read() {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|ext| ext == "gz"))
        .collect();
    files.sort();
    assert_eq!(files.len(), 120);
    for path in files {
        let ReadTrial { trial, ignored_columns } = read(&path);
        assert!(ignored_columns.is_empty());
        assert_eq!(trial.samples(), 2702, "{}", path.display());
        assert!((trial.sample_time_s * 60.0 - 1.0).abs() < 2e-7, "{}", trial.sample_time_s);
        assert!(trial.signals.disturbance.is_some());
        check_round_trip(&trial);
    }
}
