//! Files of MATLAB: every number as scipy reads it, and no file that brings the reader down.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use volition::exchange::matlab;
use volition::exchange::options::columns;
use volition::exchange::variables::{Numbers, Value};
use volition::exchange::{self, Options};

const LIMIT: u64 = 64 << 20;

/// The files of `tests/exchange/matlab.py`, made by scipy 1.17.1, that are kept here.
fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/matlab")
}

fn file(name: &str) -> Vec<u8> {
    let path = folder().join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn leaves<'a>(path: String, value: &'a Value, into: &mut BTreeMap<String, &'a Numbers>) {
    match value {
        Value::Numbers(numbers) if !numbers.is_complex => drop(into.insert(path, numbers)),
        Value::Structs { count, fields } => {
            for element in 0..*count {
                let own = if *count == 1 { path.clone() } else { format!("{path}({})", element + 1) };
                for (name, values) in fields {
                    leaves(format!("{own}.{name}"), &values[element], into);
                }
            }
        }
        Value::Cells(items) => {
            for (at, item) in items.iter().enumerate() {
                leaves(format!("{path}{{{}}}", at + 1), item, into);
            }
        }
        _ => {}
    }
}

/// Compares every file of a folder with what scipy read: how many files, arrays, and files that both refuse.
fn compare(folder: &Path) -> [usize; 3] {
    let mut tally = [0; 3];
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    // What is HDF5 has no document beside it.
    files.retain(|path| path.extension().is_some_and(|e| e == "mat") && path.with_extension("json").exists());
    files.sort();
    for path in files {
        let name = path.file_name().unwrap().to_str().unwrap();
        let truth: serde_json::Value =
            serde_json::from_slice(&std::fs::read(path.with_extension("json")).unwrap()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let read = matlab::recognise(&bytes).map(|level| matlab::read(&bytes, level, LIMIT));
        tally[0] += 1;
        if truth.get("refused").is_some() {
            // What scipy cannot read may be read here; what is damaged may not.
            tally[2] += usize::from(!matches!(read, Some(Ok(_))));
            continue;
        }
        let variables =
            read.unwrap_or_else(|| panic!("{name} is not recognised")).unwrap_or_else(|e| panic!("{name}: {e}"));
        let mut found = BTreeMap::new();
        for (name, value) in &variables.named {
            leaves(name.clone(), value, &mut found);
        }
        for (path, expected) in truth.as_object().unwrap() {
            let numbers = found.get(path).unwrap_or_else(|| panic!("{name}: {path} is not among {:?}", found.keys()));
            let bits: Vec<String> = numbers.values.iter().map(|value| format!("{:016x}", value.to_bits())).collect();
            let expected_bits: Vec<&str> =
                expected["bits"].as_array().unwrap().iter().map(|bits| bits.as_str().unwrap()).collect();
            assert_eq!(bits, expected_bits, "{name}: {path}");
            if !bits.is_empty() {
                let shape = (expected["rows"].as_u64().unwrap(), expected["columns"].as_u64().unwrap());
                assert_eq!((numbers.rows as u64, numbers.columns as u64), shape, "{name}: {path}");
            }
            tally[1] += 1;
        }
    }
    tally
}

#[test]
fn files_of_every_class_are_read_as_scipy_reads_them() {
    let [files, arrays, refused] = compare(&folder());
    assert_eq!((files, refused), (11, 0));
    assert!(arrays >= 50, "{arrays}");
}

/// With all files that scipy ships, by the python that `tests/exchange/install` made or `VOLITION_SCIPY` names.
#[test]
fn files_that_scipy_ships_are_read_as_scipy_reads_them() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let installed = root.join("target/exchange/bin/python");
    let python = std::env::var_os("VOLITION_SCIPY").map_or(installed, PathBuf::from);
    let say = |words: &str| std::io::stderr().write_all(format!("\n{words}\n").as_bytes()).unwrap();
    if !python.exists() {
        say("LEFT OUT: the files that scipy ships; run tests/exchange/install");
        return;
    }
    let out = tempfile::tempdir().unwrap();
    let script = root.join("tests/exchange/matlab.py");
    let made = Command::new(python).arg(script).arg(out.path()).arg("--scipy").output().unwrap();
    assert!(made.status.success(), "{made:?}");
    let told = String::from_utf8_lossy(&made.stdout).trim().to_owned();
    let [files, arrays, refused] = compare(out.path());
    say(&format!("{told}: {files} compared, {arrays} arrays bit for bit, {refused} that both refuse"));
    let shipped: usize = told.split([' ', ',']).filter_map(|word| word.parse().ok()).nth(1).unwrap();
    if shipped == 0 {
        say("scipy ships none of its files here: only those made by the script were compared");
        assert!(files >= 11 && arrays >= 50, "{told}: {files} files, {arrays} arrays");
        return;
    }
    assert!(shipped >= 110 && files >= 120 && arrays >= 170 && refused >= 4, "{told}: {files}, {arrays}, {refused}");
    #[cfg(feature = "hdf5")]
    {
        let file = std::fs::read(out.path().join("scipy_testhdf5_7.4_GLNX86.mat")).unwrap();
        // Of 2006, in a layout that its reader does not know (nor does scipy): refused with what to do.
        let refused = exchange::read(&file, &Options::default()).unwrap_err().to_string();
        assert!(refused.contains("data layout version: 2") && refused.contains("save it anew"), "{refused}");
    }
}

fn read(name: &str, mapping: &str) -> exchange::Reading {
    let columns = if mapping.is_empty() { Default::default() } else { columns(mapping).unwrap() };
    let options = Options { columns, ..Options::default() };
    exchange::read(&file(name), &options).unwrap_or_else(|problem| panic!("{name}: {problem}"))
}

fn refused(name: &str, mapping: &str) -> String {
    let columns = if mapping.is_empty() { Default::default() } else { columns(mapping).unwrap() };
    exchange::read(&file(name), &Options { columns, ..Options::default() }).unwrap_err().to_string()
}

/// What stands in the files: t = 0.02 i, and the rest in the order in which scipy rounds it.
#[test]
fn signals_are_found_by_name_or_by_path() {
    let plain = read("plain.mat", "");
    assert_eq!((plain.trial.samples(), plain.trial.sample_time_s), (40, 0.02));
    assert_eq!(plain.understood.format, "matlab_5");
    assert_eq!(plain.trial.signals.control[0], 0.5);
    for same in ["packed.mat", "columns.mat", "level4.mat", "turned.mat"] {
        assert_eq!(read(same, "").trial, plain.trial, "{same}");
    }
    let by_position = read("matrix.mat", "t:1,r:2,u:3,y:4");
    assert_eq!(by_position.trial, plain.trial);
    assert_eq!(read("matrix.mat", "t:M(:,1),r:M(:,2),u:M(:,3),y:M(:,4)").trial, plain.trial);

    // A struct with names of its own, and a rate beside them.
    let mapped = read("struct.mat", "r:data.target,u:data.stick,y:data.cursor");
    assert_eq!(mapped.trial.sample_time_s, 0.02);
    assert_eq!(mapped.trial.signals.command, plain.trial.signals.command);
    assert_eq!(mapped.trial.signals.time_s, None);
    assert!(
        mapped.understood.words.iter().any(|words| words.contains("0.02 s apart")),
        "{:?}",
        mapped.understood.words
    );
    let unnamed = refused("struct.mat", "");
    assert!(unnamed.contains("columns=r:data.target,u:data.stick,y:data.cursor"), "{unnamed}");
    assert!(unnamed.contains("data.target (1×40)"), "{unnamed}");

    // An array of structs holds several trials.
    let several = refused("runs.mat", "");
    assert!(several.contains("3 recordings, runs(1).signals and runs(2).signals"), "{several}");
    assert!(several.contains("columns=r:runs(1).signals.r,u:runs(1).signals.u,y:runs(1).signals.y"), "{several}");
    let options =
        Options { columns: columns("r:runs(2).signals.r").unwrap(), sample_time_s: Some(0.02), ..Options::default() };
    let second = exchange::read(&file("runs.mat"), &options).unwrap();
    assert_eq!(second.trial.signals.command[0], 1.0);
    assert_eq!(second.trial.signals.output, plain.trial.signals.output);

    let options = Options {
        columns: columns("r:c{1},u:c{3}.u,y:c{3}.inner.y").unwrap(),
        sample_time_s: Some(0.02),
        ..Options::default()
    };
    assert_eq!(exchange::read(&file("cells.mat"), &options).unwrap().trial.signals.output, plain.trial.signals.output);
}

#[test]
fn paths_that_lead_nowhere_say_what_is_there() {
    for (mapping, words) in [
        (
            "r:data.goal,u:data.stick,y:data.cursor",
            "there is no field \"goal\" (element 1); there are target, stick, cursor, fs",
        ),
        ("r:date.target,u:data.stick,y:data.cursor", "there is no variable \"date\""),
        ("r:data,u:data.stick,y:data.cursor", "data is no array of numbers"),
        ("r:note,u:data.stick,y:data.cursor", "note is no array of numbers"),
        ("r:data.target(,u:data.stick,y:data.cursor", "has no ')'"),
        ("r:data(0).target,u:data.stick,y:data.cursor", "no index from 1"),
        ("r:data.target{1},u:data.stick,y:data.cursor", "leads to no cells"),
    ] {
        let said = refused("struct.mat", mapping);
        assert!(said.contains(words), "{mapping}: {said}");
    }
    assert!(
        refused("runs.mat", "r:runs.signals.r").contains("runs\" has 3 elements; say which, such as runs(1).signals.r")
    );
    assert!(refused("matrix.mat", "r:M").contains("M has 40 rows and 4 columns; take one, such as M(:,1)"));
    assert!(refused("classes.mat", "r:z").contains("complex"));
}

/// A file that nests deeper than any, one that unpacks to more than is allowed, and cuts at every byte.
#[test]
fn files_without_end_are_refused() {
    fn element(kind: u32, data: &[u8]) -> Vec<u8> {
        let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        bytes.extend_from_slice(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }
    let array = |class: u32, dimensions: [i32; 2], rest: &[u8]| {
        let flags = element(6, &[class.to_le_bytes(), [0; 4]].concat());
        let sizes = element(5, &dimensions.map(i32::to_le_bytes).concat());
        element(14, &[flags, sizes, element(1, b"c"), rest.to_vec()].concat())
    };
    let mut header = b"MATLAB 5.0 MAT-file".to_vec();
    header.resize(124, b' ');
    header.extend_from_slice(&[0, 1, b'I', b'M']);
    let read = |body: &[u8]| matlab::read(&[header.clone(), body.to_vec()].concat(), matlab::Level::Five, LIMIT);
    let mut nested = array(6, [1, 1], &element(9, &1.5_f64.to_le_bytes()));
    for depth in 0..40 {
        let outcome = read(&nested);
        assert_eq!(outcome.is_ok(), depth <= 32, "{depth}");
        nested = array(1, [1, 1], &nested);
    }
    assert!(read(&nested).unwrap_err().detail.contains("nested more than 32 deep"));
    // Sizes that no memory holds.
    for (class, dimensions) in [(6, [i32::MAX, i32::MAX]), (1, [i32::MAX, 1]), (2, [i32::MAX, i32::MAX]), (6, [-1, 1])]
    {
        let fields = [element(5, &8_u32.to_le_bytes()), element(1, b"r\0\0\0\0\0\0\0")].concat();
        let rest = if class == 2 { fields } else { element(9, &[0; 8]) };
        let problem = read(&array(class, dimensions, &rest)).unwrap_err();
        assert!(problem.mend.is_some(), "{problem}");
    }
    // A small element that unpacks to a large one.
    let mut packer = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    for _ in 0..66 {
        packer.write_all(&vec![0; 1 << 20]).unwrap();
    }
    let packed = packer.finish().unwrap();
    let body = [15_u32.to_le_bytes().to_vec(), (packed.len() as u32).to_le_bytes().to_vec(), packed].concat();
    let problem = read(&body).unwrap_err();
    assert_eq!(problem.title, "too many bytes", "{problem}");
    let whole = file("runs.mat");
    for length in 0..whole.len() {
        let _ = exchange::read(&whole[..length], &Options::default());
    }
}

/// 3,000 files with one to six bytes changed, or cut: read or refused in words, never more.
#[test]
fn damaged_files_are_read_or_refused_in_words() {
    use rand::{RngExt as _, SeedableRng as _};
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(20_261_130);
    let mut files: Vec<_> = std::fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|e| e == "mat"));
    files.sort();
    let (mut read, mut refused) = (0, 0);
    for k in 0..3000 {
        let mut bytes = std::fs::read(&files[k % files.len()]).unwrap();
        for _ in 0..random.random_range(1..=6) {
            // Behind the text at the start, where every byte means something.
            let from = if bytes.len() > 200 { 124 } else { 0 };
            let at = random.random_range(from..bytes.len());
            bytes[at] = random.random();
        }
        if random.random_range(0..4) == 0 {
            bytes.truncate(random.random_range(1..bytes.len()));
        }
        match matlab::recognise(&bytes).map(|level| matlab::read(&bytes, level, LIMIT)) {
            Some(Ok(_)) => read += 1,
            Some(Err(problem)) => {
                assert!(!problem.detail.is_empty() && problem.mend.is_some(), "{problem}");
                refused += 1;
            }
            None => refused += 1,
        }
        let options = Options { columns: columns("r:data.target,u:u,y:M(:,2)").unwrap(), ..Options::default() };
        let _ = exchange::read(&bytes, &options);
        let _ = exchange::read(&bytes, &Options::default());
    }
    assert!(read > 200 && refused > 200, "{read} read, {refused} refused");
}
