//! Arrays of NumPy and archives: every number as NumPy has it, and no archive that fills the memory.

use std::io::{Cursor, Write as _};
use std::path::Path;
use volition::analysis::Code;
use volition::exchange::options::columns;
use volition::exchange::{self, Options, Reading, archive};
use zip::write::SimpleFileOptions;

fn file(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/numpy").join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn mapped(mapping: &str) -> Options {
    Options { columns: columns(mapping).unwrap(), ..Options::default() }
}

fn refused(bytes: &[u8], options: &Options) -> String {
    exchange::read(bytes, options).unwrap_err().to_string()
}

/// An archive of files.
fn zipped(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        writer.start_file(*name, SimpleFileOptions::default()).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

#[test]
fn arrays_are_the_trial_that_was_saved() {
    let read = |name: &str, options: &Options| -> Reading {
        exchange::read(&file(name), options).unwrap_or_else(|problem| panic!("{name}: {problem}"))
    };
    let plain = read("plain.npz", &Options::default());
    assert_eq!((plain.understood.format, plain.trial.samples(), plain.trial.sample_time_s), ("numpy", 40, 0.02));
    let packed = read("packed.npz", &Options::default());
    assert_eq!(packed.trial, plain.trial);
    assert_eq!(read("matrix.npy", &mapped("t:1,r:2,u:3,y:4")).trial, plain.trial);
    // The same numbers in a file of MATLAB, by way of scipy.
    let matlab = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/matlab/plain.mat");
    let matlab = exchange::read(&std::fs::read(matlab).unwrap(), &Options::default()).unwrap();
    assert_eq!(matlab.trial.content_sha256(), plain.trial.content_sha256());
}

/// Every array of every file, through a mapping that takes it for three signals at once.
#[test]
fn every_class_and_order_is_read_bit_for_bit() {
    let mut arrays = 0;
    for name in ["plain.npz", "packed.npz", "classes.npz", "orders.npz", "matrix.npy"] {
        let truth: serde_json::Value = serde_json::from_slice(&file(&format!("{name}.json"))).unwrap();
        for (array, expected) in truth.as_object().unwrap() {
            let bits: Vec<&str> =
                expected["bits"].as_array().unwrap().iter().map(|bits| bits.as_str().unwrap()).collect();
            let (rows, columns_) = (expected["rows"].as_u64().unwrap() as usize, expected["columns"].as_u64().unwrap());
            for column in 0..columns_ as usize {
                if rows < 2 {
                    continue;
                }
                let path = if columns_ == 1 { array.clone() } else { format!("{array}(:,{})", column + 1) };
                // A trial needs three signals, and sample times of its own are not wanted here.
                let options = Options { sample_time_s: Some(0.02), ..mapped(&format!("r:{path},u:side_u,y:side_y")) };
                let side: Vec<f64> = vec![0.0; rows];
                let with_sides = with_arrays(&file(name), &[("side_u", &side), ("side_y", &side)]);
                let read = exchange::read(&with_sides, &options).unwrap_or_else(|e| panic!("{name} {path}: {e}"));
                let found: Vec<String> =
                    read.trial.signals.command.iter().map(|value| format!("{:016x}", value.to_bits())).collect();
                assert_eq!(found, bits[column * rows..][..rows], "{name} {path}");
                arrays += 1;
            }
        }
    }
    assert!(arrays >= 24, "{arrays}");
}

/// The archive (or the single array) with more arrays.
fn with_arrays(bytes: &[u8], more: &[(&str, &[f64])]) -> Vec<u8> {
    let mut files: Vec<(String, Vec<u8>)> = if bytes.starts_with(b"PK") {
        let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).unwrap();
        (0..archive.len())
            .map(|at| {
                let mut file = archive.by_index(at).unwrap();
                let mut bytes = Vec::new();
                std::io::Read::read_to_end(&mut file, &mut bytes).unwrap();
                (file.name().unwrap().into_owned(), bytes)
            })
            .collect()
    } else {
        vec![("array.npy".to_owned(), bytes.to_vec())]
    };
    for (name, values) in more {
        let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({},), }}\n", values.len());
        let mut array = [b"\x93NUMPY\x01\x00".to_vec(), (header.len() as u16).to_le_bytes().to_vec()].concat();
        array.extend_from_slice(header.as_bytes());
        array.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        files.push((format!("{name}.npy"), array));
    }
    let files: Vec<(&str, &[u8])> = files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())).collect();
    zipped(&files)
}

#[test]
fn what_is_no_array_of_numbers_is_refused_in_words() {
    assert!(refused(&file("objects.npy"), &Options::default()).contains("objects of Python"));
    let plain = file("matrix.npy");
    for length in 1..plain.len() {
        let problem = exchange::read(&plain[..length], &mapped("r:1,u:2,y:3")).unwrap_err();
        assert!([Code::Malformed, Code::BadSignal].contains(&problem.code), "{length}: {problem}");
    }
    let header = |text: &str| {
        let mut bytes = [b"\x93NUMPY\x01\x00".to_vec(), (text.len() as u16).to_le_bytes().to_vec()].concat();
        bytes.extend_from_slice(text.as_bytes());
        refused(&bytes, &Options::default())
    };
    let huge = "{'descr': '<f8', 'fortran_order': False, 'shape': (18446744073709551615, 3), }";
    assert!(header(huge).contains("another number of values"), "{}", header(huge));
    assert!(header("{'descr': '<f8'}").contains("not as NumPy writes it"));
    // Bytes in the place of a header.
    assert!(header("\u{1}\u{2}").contains("damaged NumPy file"));
}

#[test]
fn archives_are_one_recording_or_say_what_they_are() {
    let table = b"t,r,u,y\n0,1,2,3\n0.02,2,3,4\n0.04,3,4,5\n";
    let one = zipped(&[("rig/s01.csv", table), ("__MACOSX/._s01.csv", b"x"), ("rig/.DS_Store", b"x")]);
    assert!(archive::is_folder(&one));
    assert_eq!(exchange::read(&one, &Options::default()).unwrap().trial.samples(), 3);
    let two = zipped(&[("a.csv", table), ("b.csv", table)]);
    assert!(refused(&two, &Options::default()).contains("the archive has 2 files"));
    assert_eq!(archive::folder(&two, 1000).unwrap().len(), 2);
    assert!(archive::folder(&two, 50).unwrap_err().detail.contains("more than 50 bytes"));
    let nested = zipped(&[("inner.zip", &one)]);
    assert!(refused(&nested, &Options::default()).contains("an archive in an archive"));
    let packed = crate::round_trip::gzip(&one);
    assert!(refused(&zipped(&[("inner.gz", &packed)]), &Options::default()).contains("an archive in an archive"));
    let bad = zipped(&[("rig/s01.csv", b"t,r,u,y\n0,1,2,x\n1,2,3,4\n1,2,3,4\n")]);
    assert!(refused(&bad, &Options::default()).contains("rig/s01.csv, row 2, column y"));
    assert!(refused(&zipped(&[]), &Options::default()).contains("no file"));
    for length in 4..one.len() {
        let _ = exchange::read(&one[..length], &Options::default());
    }
}

/// A small archive of zeros without end.
#[test]
fn an_archive_that_unpacks_to_too_much_is_stopped() {
    let zeros = vec![0_u8; 8 << 20];
    let archive = zipped(&[("r.npy", &zeros), ("u.npy", &zeros)]);
    assert!(archive.len() < 100_000);
    let limits = volition::trial::Limits { max_rows: 1000, max_bytes: 1 << 20 };
    let options = Options { limits, ..Options::default() };
    assert!(refused(&archive, &options).contains("more than 1048576 bytes"));
}

fn sheet(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/excel").join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn sheets_hold_the_doubles_nearest_to_what_stands_in_them() {
    let truth: serde_json::Value = serde_json::from_slice(&sheet("plain.json")).unwrap();
    let plain = exchange::read(&sheet("plain.xlsx"), &Options::default()).unwrap();
    let signals = &plain.trial.signals;
    let columns_ = [signals.time_s.as_ref().unwrap(), &signals.command, &signals.control, &signals.output];
    for (letter, column) in ["A", "B", "C", "D"].into_iter().zip(columns_) {
        let bits: Vec<String> = column.iter().map(|value| format!("{:016x}", value.to_bits())).collect();
        assert_eq!(serde_json::json!(bits), truth[letter], "{letter}");
    }
    let known = &plain.understood;
    assert_eq!((known.format, known.header_row, known.first_row), ("xlsx", Some(1), Some(2)));

    let german = exchange::read(&sheet("german.xlsx"), &mapped("t:Zeit,r:Ziel,u:Kraft,y:Ort")).unwrap();
    assert_eq!(german.trial.signals_sha256(), plain.trial.signals_sha256());
    assert_eq!((german.trial.sample_time_s, german.understood.time_unit), (0.02, Some("ms")));
    assert_eq!((german.understood.header_row, german.understood.first_row), (Some(3), Some(5)));
    assert_eq!(german.understood.columns[2].unit.as_deref(), Some("N"));
    assert!(
        german.understood.words[0].starts_with("The sheet \"Daten\" of Excel (of 2 sheets"),
        "{:?}",
        german.understood
    );
    assert_eq!(german.ignored_columns, ["(column 1, without a name)", "Bemerkung"]);
}

#[test]
fn sheets_that_are_no_recording_are_refused_in_words() {
    let dates = refused(&sheet("dates.xlsx"), &Options::default());
    assert!(dates.contains("(a date)") && dates.contains("row 6, column t"), "{dates}");
    let formula = refused(&sheet("formula.xlsx"), &Options::default());
    assert!(formula.contains("the cell is empty") && formula.contains("row 9, column u"), "{formula}");
    let several = refused(&sheet("two_sheets.xlsx"), &Options::default());
    assert!(several.contains("\"Sheet\" and \"copy\" both hold numbers"), "{several}");
    let whole = sheet("plain.xlsx");
    for length in (4..whole.len()).step_by(7) {
        let problem = exchange::read(&whole[..length], &Options::default()).unwrap_err();
        assert_eq!(problem.code, Code::Malformed, "{length}: {problem}");
    }
    // A cell at the far end of a sheet costs nothing.
    let far = |cell: &str| {
        let mut archive = zip::ZipArchive::new(Cursor::new(whole.as_slice())).unwrap();
        let files: Vec<(String, Vec<u8>)> = (0..archive.len())
            .map(|at| {
                let mut file = archive.by_index(at).unwrap();
                let mut bytes = Vec::new();
                std::io::Read::read_to_end(&mut file, &mut bytes).unwrap();
                let name = file.name().unwrap().into_owned();
                if name == "xl/worksheets/sheet1.xml" {
                    let text = String::from_utf8(bytes).unwrap();
                    let row: String = cell.chars().filter(char::is_ascii_digit).collect();
                    let more = format!("<row r=\"{row}\"><c r=\"{cell}\"><v>1</v></c></row></sheetData>");
                    bytes = text.replace("</sheetData>", &more).into_bytes();
                }
                (name, bytes)
            })
            .collect();
        let files: Vec<(&str, &[u8])> = files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())).collect();
        refused(
            &zipped(&files),
            &Options { limits: volition::trial::Limits { max_rows: 1000, ..Default::default() }, ..Options::default() },
        )
    };
    assert!(far("XFD40").contains("beyond column 1000"), "{}", far("XFD40"));
    assert!(far("A1048576").contains("more than 1000 rows"), "{}", far("A1048576"));
}

/// A folder as Motion-BIDS has it: a table without names, its channels, its description.
fn bids(rate: &str) -> Vec<(String, Vec<u8>)> {
    let stem = "sub-01/motion/sub-01_task-track_tracksys-rig";
    let rows: Vec<String> =
        (0..30).map(|i| format!("{}\t{}\t{}\t{}", 0.5 * f64::from(i), i, 3 * i, 0.02 * f64::from(i))).collect();
    let channels = "name\tcomponent\ttype\ttracked_point\tunits\ntarget\tx\tPOS\tn/a\tmm\nstick\tn/a\tMISC\tn/a\tN\n\
                    cursor\tx\tPOS\tn/a\tmm\nlatency\tn/a\tLATENCY\tn/a\ts\n";
    let description = format!("{{\"TaskName\": \"track\", \"SamplingFrequency\": {rate}}}");
    vec![
        ("dataset_description.json".to_owned(), b"{\"Name\": \"rig\"}".to_vec()),
        (format!("{stem}_motion.tsv"), rows.join("\n").into_bytes()),
        (format!("{stem}_channels.tsv"), channels.as_bytes().to_vec()),
        (format!("{stem}_motion.json"), description.into_bytes()),
    ]
}

#[test]
fn tables_of_motion_bids_have_their_names_beside_them() {
    let files = bids("50");
    let [channels, description] = exchange::bids::companions(&files[1].0).unwrap();
    assert_eq!((&channels, &description), (&files[2].0, &files[3].0));
    assert_eq!(exchange::bids::companions("s01.tsv"), None);
    let beside =
        |description: &[u8]| exchange::bids::sidecar(("channels", &files[2].1), Some(("motion.json", description)));
    let sidecar = beside(&files[3].1).unwrap();
    assert_eq!((sidecar.sample_time_s, sidecar.latency.as_deref()), (Some(0.02), Some("latency")));
    let options = Options { sidecar: Some(sidecar.clone()), ..mapped("r:target,u:stick,y:cursor") };
    let reading = exchange::read(&files[1].1, &options).unwrap();
    assert_eq!((reading.trial.samples(), reading.trial.sample_time_s), (30, 0.02));
    assert_eq!(reading.trial.signals.output[29], 87.0);
    assert_eq!(reading.understood.columns[1].unit.as_deref(), Some("mm"));
    assert!(reading.understood.words[0].contains("the file of its channels names the columns"));
    let unmapped = exchange::read(&files[1].1, &Options { sidecar: Some(sidecar.clone()), ..Options::default() });
    let unmapped = unmapped.unwrap_err().to_string();
    assert!(unmapped.contains("columns=t:latency,r:target,u:stick,y:cursor"), "{unmapped}");

    // A rate that the times contradict, and a file of other channels.
    let other = Options { sidecar: Some(beside(b"{\"SamplingFrequency\": 60}").unwrap()), ..options.clone() };
    assert!(refused(&files[1].1, &other).contains("the time column says 0.02 s"));
    assert!(beside(b"{\"SamplingFrequency\": 0}").unwrap_err().detail.contains("0 Hz"));
    assert!(beside(b"[").unwrap_err().to_string().contains("motion.json"));
    let fewer = exchange::bids::sidecar(("channels", b"name\ttype\nx\tPOS\n"), None).unwrap();
    let fewer = refused(&files[1].1, &Options { sidecar: Some(fewer), ..options });
    assert!(fewer.contains("the table has 4 columns, and the file of its channels names 1"), "{fewer}");
}
