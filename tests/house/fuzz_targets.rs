//! Every fuzz target compiles with the library of today and takes its seeds; `fuzz/run.sh` searches.
#![allow(clippy::duplicate_mod, reason = "two targets share the server, each with one of its own")]

use super::project;
use std::path::Path;

#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/archive.rs"]
mod archive;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/cache.rs"]
mod cache;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/csv.rs"]
mod csv;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/cursor.rs"]
mod cursor;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/expression.rs"]
mod expression;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/gzip.rs"]
mod gzip;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/hdf5.rs"]
mod hdf5;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/json_trial.rs"]
mod json_trial;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/matlab.rs"]
mod matlab;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/plant_text.rs"]
mod plant_text;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/request.rs"]
mod request;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/table.rs"]
mod table;
#[allow(unused_attributes)]
#[path = "../../fuzz/fuzz_targets/upload.rs"]
mod upload;

mod fuzzer {
    /// A fuzz target as a function of its input.
    #[macro_export]
    macro_rules! fuzz_target {
        (|$data:ident: &[u8]| $body:block) => {
            pub fn run($data: &[u8]) {
                $body
            }
        };
        (|$text:ident: &str| $body:block) => {
            pub fn run(data: &[u8]) {
                if let Ok($text) = std::str::from_utf8(data) {
                    $body
                }
            }
        };
    }
}

/// What a target does with an input.
type Target = fn(&[u8]);

fn files_of(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    files
}

#[test]
fn every_fuzz_target_takes_its_seeds() {
    let targets: [(&str, Target); 13] = [
        ("archive", archive::run),
        ("cache", cache::run),
        ("csv", csv::run),
        ("cursor", cursor::run),
        ("expression", expression::run),
        ("gzip", gzip::run),
        ("hdf5", hdf5::run),
        ("json_trial", json_trial::run),
        ("matlab", matlab::run),
        ("plant_text", plant_text::run),
        ("request", request::run),
        ("table", table::run),
        ("upload", upload::run),
    ];
    let fuzz = project().join("fuzz");
    let mut named: Vec<String> = files_of(&fuzz.join("fuzz_targets"))
        .iter()
        .filter(|file| file.is_file())
        .map(|file| file.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    named.sort();
    assert_eq!(named, targets.map(|(name, _)| name), "the targets of fuzz/fuzz_targets");
    for (name, run) in targets {
        let seeds = if name == "request" {
            let kinds = files_of(&project().join("src/analysis"));
            kinds.into_iter().map(|kind| kind.join("example.json")).filter(|example| example.is_file()).collect()
        } else {
            files_of(&fuzz.join("seeds").join(name))
        };
        assert!(!seeds.is_empty(), "{name} has no seeds");
        for seed in seeds {
            run(&std::fs::read(&seed).unwrap());
        }
    }
}
