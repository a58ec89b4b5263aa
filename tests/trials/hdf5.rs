//! HDF5, as MATLAB 7.3, h5py and Octave write it; made by `tests/exchange/hdf5.py`.

use std::path::Path;
use volition::exchange::options::columns;
use volition::exchange::{self, Options, Reading};

fn file(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/hdf5").join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn options(mapping: &str) -> Options {
    let columns = if mapping.is_empty() { Default::default() } else { columns(mapping).unwrap() };
    Options { columns, ..Options::default() }
}

fn read(name: &str, mapping: &str) -> Reading {
    exchange::read(&file(name), &options(mapping)).unwrap_or_else(|problem| panic!("{name}: {problem}"))
}

fn refused(name: &str, mapping: &str) -> String {
    exchange::read(&file(name), &options(mapping)).unwrap_err().to_string()
}

/// The same numbers in a file of level 5, by way of scipy.
fn level5() -> volition::trial::Trial {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/matlab/plain.mat");
    exchange::read(&std::fs::read(path).unwrap(), &Options::default()).unwrap().trial
}

#[test]
fn files_of_version_7_3_are_read_bit_for_bit() {
    let truth = level5();
    let plain = read("plain.mat", "");
    assert_eq!((plain.understood.format, &plain.trial), ("matlab_7_3", &truth));
    let mapped = read("struct.mat", "r:data.target,u:data.stick,y:data.cursor");
    assert_eq!((mapped.trial.sample_time_s, &mapped.trial.signals.output), (0.02, &truth.signals.output));
    // A matrix is stored with its dimensions in reverse.
    assert_eq!(read("cells.mat", "t:M(:,1),r:M(:,2),u:M(:,3),y:M(:,4)").trial, truth);
    let cells = Options { sample_time_s: Some(0.02), ..options("r:c{1},u:c{3},y:M(:,4)") };
    let cells = exchange::read(&file("cells.mat"), &cells).unwrap();
    assert_eq!(cells.trial.signals_sha256(), truth.signals_sha256());
    // An array of structs, packed, shuffled and with checksums.
    let runs = Options { sample_time_s: Some(0.02), ..options("r:runs(3).r") };
    let runs = exchange::read(&file("runs.mat"), &runs).unwrap().trial;
    assert_eq!((runs.signals.command[0], &runs.signals.control), (2.0, &truth.signals.control));
    assert!(refused("runs.mat", "").contains("3 recordings, runs(1) and runs(2)"), "{}", refused("runs.mat", ""));
}

#[test]
fn what_is_stored_otherwise_than_it_is_meant_is_no_signal() {
    let list = refused("struct.mat", "r:data.target,u:data.stick,y:nothing");
    // An empty array is stored as its dimensions, a complex one as pairs, text as numbers, a single as itself.
    for words in ["none (0×0)", "z (1×5)", "note (text)", "single (1×40)", "short (1×5)", "yes (1×2)"] {
        assert!(list.contains(words), "{words}: {list}");
    }
    assert!(refused("struct.mat", "r:z,u:data.stick,y:data.cursor").contains("complex"));
    let none = refused("struct.mat", "r:none,u:data.stick,y:data.cursor");
    assert!(none.contains("none has 0 samples") || none.contains("no variable") || none.contains("none"), "{none}");
}

#[test]
fn plain_hdf5_is_read_and_that_of_octave_refused_by_name() {
    let plain = read("plain.h5", "");
    assert_eq!((plain.understood.format, &plain.trial), ("hdf5", &level5()));
    assert_eq!(read("plain.h5", "t:M(:,1),r:M(:,2),u:M(:,3),y:M(:,4)").trial, level5());
    let octave = refused("octave.h5", "");
    assert!(octave.contains("as Octave writes it with -hdf5") && octave.contains("save('-v7'"), "{octave}");
}

#[test]
fn damaged_files_are_read_or_refused_in_words() {
    use rand::{RngExt as _, SeedableRng as _};
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(20_261_130);
    for k in 0..600 {
        let name = ["plain.mat", "struct.mat", "cells.mat", "runs.mat", "plain.h5"][k % 5];
        let mut bytes = file(name);
        for _ in 0..random.random_range(1..=6) {
            let at = random.random_range(0..bytes.len());
            bytes[at] = random.random();
        }
        if random.random_range(0..4) == 0 {
            bytes.truncate(random.random_range(1..bytes.len()));
        }
        let limits = volition::trial::Limits { max_rows: 100_000, max_bytes: 16 << 20 };
        if let Err(problem) = exchange::read(&bytes, &Options { limits, ..Options::default() }) {
            assert!(!problem.detail.is_empty() && problem.mend.is_some(), "{problem}");
        }
    }
}
