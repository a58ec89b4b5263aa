//! Readers and writers of trials: every defect with its place, every bit back.

use crate::round_trip::gzip;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::{Read, Write};
use std::path::Path;
use volition::analysis::{Code, Problem};
use volition::trial::csv::{ColumnMapping, Options};
use volition::trial::gzip::{GzipError, GzipReader};
use volition::trial::{Limits, Location, ReadError, ReadTrial, Signals, TimeDefect, Trial, TrialError, csv, json};

pub fn read(text: impl AsRef<[u8]>) -> Result<ReadTrial, ReadError> {
    csv::read(text.as_ref(), &Options::default())
}

fn problem(text: impl AsRef<[u8]>) -> Problem {
    Problem::from(read(text).unwrap_err())
}

/// A CSV of ten rows at 50 Hz whose rows `edit` may change.
pub fn table(edit: impl Fn(&mut Vec<String>)) -> String {
    let mut rows: Vec<String> = (0..10).map(|i| format!("{:.3},{i}.5,0.25,-{i}", f64::from(i) * 0.02)).collect();
    edit(&mut rows);
    format!("t,r,u,y\n{}\n", rows.join("\n"))
}

pub fn with_times(times: &[f64]) -> Result<Trial, TrialError> {
    let zeros = vec![0.0; times.len()];
    let signals = Signals {
        time_s: Some(times.to_vec()),
        command: zeros.clone(),
        control: zeros.clone(),
        output: zeros,
        disturbance: None,
    };
    Trial::from_signals(None, signals)
}

pub fn defect(times: &[f64]) -> TimeDefect {
    match with_times(times).unwrap_err() {
        TrialError::Time(defect) => defect,
        other => panic!("{other}"),
    }
}

// ---- what is read

#[test]
fn a_plain_file_is_read() {
    let ReadTrial { trial, ignored_columns } = read(table(|_| ())).unwrap();
    assert_eq!(trial.sample_time_s, 0.02);
    assert_eq!(trial.samples(), 10);
    assert_eq!(trial.signals.output[9], -9.0);
    assert_eq!(trial.signals.disturbance, None);
    assert!(ignored_columns.is_empty());
}

#[test]
fn harmless_variations_read_the_same() {
    let plain = read("t,r,u,y,d\n0,1,2,3,4\n0.5,5,6,7,-0\n").unwrap().trial;
    for (name, text) in [
        ("byte order mark", "\u{feff}t,r,u,y,d\n0,1,2,3,4\n0.5,5,6,7,-0\n"),
        ("CR LF", "t,r,u,y,d\r\n0,1,2,3,4\r\n0.5,5,6,7,-0\r\n"),
        ("no last line end", "t,r,u,y,d\n0,1,2,3,4\n0.5,5,6,7,-0"),
        ("empty lines at the end", "t,r,u,y,d\n0,1,2,3,4\n0.5,5,6,7,-0\n\n \r\n\n"),
        ("upper case", "T,R,U,Y,D\n0,1,2,3,4\n0.5,5,6,7,-0\n"),
        ("another order", "y,d,t,u,r\n3,4,0,2,1\n7,-0,0.5,6,5\n"),
        ("spaces", " t , r,u ,y,d\n 0, 1,2 ,\t3,4\n0.5,5,6,7,-0\n"),
        ("quotes", "\"t\",\"r\",u,y,d\n\"0\",1,2,3,4\n0.5,5,6,7,\"-0\"\n"),
        ("other notations", "t,r,u,y,d\n0e0,+1,2.,3.0,.4e1\n5E-1,5,6,7,-0.0\n"),
    ] {
        let trial = read(text).unwrap_or_else(|error| panic!("{name}: {error}")).trial;
        assert_eq!(trial.content_sha256(), plain.content_sha256(), "{name}");
    }
}

#[test]
fn extra_columns_are_reported() {
    let text = "t,trigger,r,u,y,,note\n0,1,1,2,3,,\"a, b\nc\"\n0.5,0,5,6,7,,\n";
    let found = read(text).unwrap();
    assert_eq!(found.ignored_columns, ["trigger", "(column 6, without a name)", "note"]);
    assert_eq!(found.trial.signals.command, [1.0, 5.0]);
    // A line end within quotes counts as a line of the file.
    let wrong = read(text.replace("0.5,0,5,6,7", "0.5,0,5,x,7")).unwrap_err();
    assert_eq!(wrong.location(), Some(Location::Cell { line: 4, column: "u".into() }));
}

#[test]
fn columns_can_be_mapped() {
    let columns = ColumnMapping {
        time: Some("time_s".into()),
        command: Some("target_px".into()),
        output: Some("u".into()),
        control: Some("stick".into()),
        ..ColumnMapping::default()
    };
    let options = Options { columns, ..Options::default() };
    let found = csv::read("time_s,target_px,stick,u,r\n0,1,2,3,9\n1,4,5,6,9\n".as_bytes(), &options).unwrap();
    assert_eq!(found.trial.signals.command, [1.0, 4.0]);
    assert_eq!(found.trial.signals.control, [2.0, 5.0]);
    assert_eq!(found.trial.signals.output, [3.0, 6.0]);
    // r is mapped elsewhere, so the column of that name is an extra one.
    assert_eq!(found.ignored_columns, ["r"]);

    let missing = csv::read("time_s,r,stick,u\n0,1,2,3\n1,4,5,6\n".as_bytes(), &options).unwrap_err();
    assert!(matches!(&missing, ReadError::MissingColumns { missing, .. } if missing == &["target_px"]), "{missing}");

    let columns = ColumnMapping { command: Some("a".into()), output: Some("a".into()), ..ColumnMapping::default() };
    let twice = csv::read("t,a,u\n0,1,2\n".as_bytes(), &Options { columns, ..Options::default() }).unwrap_err();
    assert!(matches!(twice, ReadError::MappedTwice { .. }), "{twice}");
    let unknown = serde_json::from_str::<ColumnMapping>(r#"{"comand": "x"}"#);
    assert!(unknown.unwrap_err().to_string().contains("unknown field `comand`"));
}

#[test]
fn a_sample_time_stands_in_for_the_time_column() {
    let options = Options { sample_time_s: Some(0.02), ..Options::default() };
    let trial = csv::read("r,u,y\n1,2,3\n4,5,6\n".as_bytes(), &options).unwrap().trial;
    assert_eq!((trial.sample_time_s, trial.signals.time_s.clone()), (0.02, None));
    let none = read("r,u,y\n1,2,3\n4,5,6\n").unwrap_err();
    assert!(matches!(none, ReadError::Trial { error: TrialError::NoSampleTime, .. }), "{none}");
    let wrong = csv::read(table(|_| ()).as_bytes(), &Options { sample_time_s: Some(0.021), ..Options::default() });
    let problem = Problem::from(wrong.unwrap_err());
    assert_eq!(problem.location.as_deref(), Some("column t"));
    assert!(problem.detail.contains("0.021 s, the time column says 0.02 s"), "{problem}");
}

// ---- what is refused, and where

#[test]
fn every_defect_of_a_table_is_named_with_its_place() {
    use Code::{BadSignal, Malformed};
    let row = |index: usize, text: &'static str| table(move |rows| rows[index] = text.to_owned());
    for (name, text, code, location, words) in [
        ("nothing", String::new(), Malformed, None, "empty"),
        ("white space", " \n\r\n \n".into(), Malformed, None, "empty"),
        ("empty first line", "\nt,r,u,y\n0,1,2,3\n".into(), Malformed, Some("row 1"), "line is empty"),
        ("header only", "t,r,u,y\n".into(), Malformed, None, "no row of data"),
        ("no header", "0,1,2,3\n1,2,3,4\n".into(), Malformed, Some("row 1"), "does not name"),
        ("commas only", ",,,\n0,1,2,3\n".into(), Malformed, Some("row 1"), "does not name"),
        (
            "no y",
            "t,r,u\n0,1,2\n".into(),
            Malformed,
            Some("row 1"),
            "no column \"y\"; the columns are \"t\", \"r\", \"u\"",
        ),
        ("other names", "time,target,stick\n0,1,2\n".into(), Malformed, Some("row 1"), "no column \"r\", \"u\", \"y\""),
        ("twice", "t,r,u,y,R\n0,1,2,3,4\n".into(), Malformed, Some("column r"), "columns 2 and 5 are both named"),
        ("extra twice", "t,r,u,y,x,x\n0,1,2,3,4,5\n".into(), Malformed, Some("column x"), "columns 5 and 6"),
        ("semicolons", "t;r;u;y\n0;1;2;3\n".into(), Malformed, Some("row 1"), "separated by ';'"),
        ("tabs", "t\tr\tu\ty\n".into(), Malformed, Some("row 1"), "separated by '\\t'"),
        ("short row", row(3, "0.060,1,2"), Malformed, Some("row 5"), "3 cells, the header has 4"),
        ("long row", row(0, "0.000,1,2,3,4"), Malformed, Some("row 2"), "5 cells, the header has 4"),
        ("one cell", row(1, "0.02"), Malformed, Some("row 3"), "1 cell, the header"),
        ("decimal comma", row(3, "0.060,1,2,3,5"), Malformed, Some("row 5"), "5 cells"),
        ("empty cell", row(4, "0.080,1,,3"), BadSignal, Some("row 6, column u"), "empty"),
        ("blank cell", row(4, "0.080,1,2, "), BadSignal, Some("row 6, column y"), "empty"),
        ("text", row(9, "0.180,1,2,high"), BadSignal, Some("row 11, column y"), "\"high\" is no number"),
        ("hexadecimal", row(9, "0.180,0x1F,2,3"), BadSignal, Some("row 11, column r"), "\"0x1F\" is no number"),
        ("quoted comma", row(5, "0.100,\"1,5\",2,3"), BadSignal, Some("row 7, column r"), "\"1,5\" is no number"),
        ("NaN", row(2, "0.040,NaN,2,3"), BadSignal, Some("row 4, column r"), "\"NaN\" is no finite"),
        ("nan", row(2, "nan,1,2,3"), BadSignal, Some("row 4, column t"), "no finite"),
        ("inf", row(2, "0.040,1,2,-inf"), BadSignal, Some("row 4, column y"), "\"-inf\" is no finite"),
        ("Infinity", row(2, "0.040,1,Infinity,3"), BadSignal, Some("row 4, column u"), "no finite"),
        ("Windows infinity", row(2, "0.040,1,1.#INF,3"), BadSignal, Some("row 4, column u"), "\"1.#INF\" is no finite"),
        ("overflow", row(2, "0.040,1,1e400,3"), BadSignal, Some("row 4, column u"), "\"1e400\" is no finite"),
        ("comment", row(2, "# paused"), Malformed, Some("row 4"), "1 cell"),
        ("empty line between", table(|rows| rows.insert(5, String::new())), Malformed, Some("row 7"), "line is empty"),
        ("stray quote", row(2, "0.040,1\"x\",2,3"), Malformed, Some("row 4"), "quotes"),
        ("open quote", row(2, "0.040,\"1,2,3"), Malformed, Some("row 4"), "quotes"),
        ("old line ends", "t,r,u,y\r0,1,2,3\r1,2,3,4\r".into(), Malformed, Some("row 1"), "carriage return"),
        ("one sample", "t,r,u,y\n0,1,2,3\n".into(), BadSignal, None, "1 samples, and a trial needs at least 2"),
        ("reversed", row(6, "0.090,1,2,3"), BadSignal, Some("row 8, column t"), "backwards, from 0.1 s to 0.09 s"),
        ("repeated", row(6, "0.100,1,2,3"), BadSignal, Some("row 8, column t"), "0.1 s is there twice"),
        ("gap", table(|rows| drop(rows.drain(4..7))), BadSignal, Some("row 6, column t"), "3 samples are missing"),
        ("jitter", row(6, "0.125,1,2,3"), BadSignal, Some("row 8, column t"), "off the uniform grid of 0.02 s"),
    ] {
        let problem = problem(&text);
        assert_eq!(problem.code, code, "{name}: {problem}");
        assert_eq!(problem.location.as_deref(), location, "{name}: {problem}");
        assert!(problem.detail.contains(words), "{name}: {problem}");
        assert!(problem.mend.is_some(), "{name}: {problem}");
    }
}

#[test]
fn bytes_that_are_no_text_are_named() {
    let mut text = table(|_| ()).into_bytes();
    let at = text.iter().position(|b| *b == b'\n').unwrap() + 3;
    text[at] = 0xff;
    let error = read(&text).unwrap_err();
    assert!(matches!(error, ReadError::NotUtf8 { line: 2, byte: 3 }), "{error}");
    let utf16: Vec<u8> = "t,r,u,y\n0,1,2,3\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let with_mark = [vec![0xff, 0xfe], utf16].concat();
    assert!(matches!(read(with_mark).unwrap_err(), ReadError::NotUtf8 { line: 1, byte: 1 }));
}

#[test]
fn columns_of_unequal_length_and_bad_sample_times_are_no_trial() {
    let signals = |output: Vec<f64>| Signals {
        time_s: None,
        command: vec![0.0; 3],
        control: vec![0.0; 3],
        output,
        disturbance: None,
    };
    assert!(matches!(
        Trial::new(0.1, signals(vec![0.0; 2])).unwrap_err(),
        TrialError::UnequalLengths { samples: 3, expected: 2, .. }
    ));
    let error = Trial::new(0.1, signals(vec![0.0, 1.0, f64::NEG_INFINITY])).unwrap_err();
    assert!(matches!(error, TrialError::NotFinite { sample: 2, .. }), "{error}");
    for bad in [0.0, -0.1, f64::NAN, f64::INFINITY, 1e-320] {
        let error = Trial::new(bad, signals(vec![0.0; 3])).unwrap_err();
        assert!(matches!(error, TrialError::BadSampleTime(_)), "{bad}: {error}");
    }
}

// ---- limits and compression

/// Endless text after a beginning; it counts what is taken.
struct Endless {
    head: Vec<u8>,
    body: &'static [u8],
    at: usize,
}

impl Read for Endless {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        for byte in buffer.iter_mut() {
            *byte = match self.head.get(self.at) {
                Some(byte) => *byte,
                None => self.body[(self.at - self.head.len()) % self.body.len()],
            };
            self.at += 1;
        }
        Ok(buffer.len())
    }
}

#[test]
fn limits_hold_while_reading() {
    let limits = Limits { max_rows: 1000, max_bytes: 1_000_000 };
    let options = Options { limits, sample_time_s: Some(0.1), ..Options::default() };
    let mut source = Endless { head: b"r,u,y\n".to_vec(), body: b"1,2,3\n", at: 0 };
    let error = csv::read(&mut source, &options).unwrap_err();
    assert!(matches!(error, ReadError::TooManyRows { limit: 1000 }), "{error}");
    assert!(source.at < 200_000, "{} bytes were taken", source.at);

    let options = Options { limits: Limits { max_rows: usize::MAX, ..limits }, ..options };
    let mut source = Endless { head: b"r,u,y\n".to_vec(), body: b"1,2,3\n", at: 0 };
    let error = csv::read(&mut source, &options).unwrap_err();
    assert!(matches!(error, ReadError::TooManyBytes { limit: 1_000_000 }), "{error}");
    assert_eq!(Problem::from(error).code, Code::TooLarge);
    assert!(source.at < 1_200_000, "{} bytes were taken", source.at);

    let mut source = Endless { head: b"r,u,y\n".to_vec(), body: b"1", at: 0 };
    let options = Options { limits: Limits::default(), sample_time_s: Some(0.1), ..Options::default() };
    let error = csv::read(&mut source, &options).unwrap_err();
    assert!(matches!(error, ReadError::LineTooLong { line: 2, .. }), "{error}");

    let mut source = Endless { head: br#"{"r":["#.to_vec(), body: b"1,", at: 0 };
    let error = json::read(&mut source, None, &limits).unwrap_err();
    assert!(matches!(error, ReadError::TooManyBytes { .. }), "{error}");
    assert!(source.at < 2_100_000, "{} bytes were taken", source.at);
    let long = format!("{{\"r\": [{}1]}}", "1,".repeat(1000));
    let error = json::read(long.as_bytes(), None, &limits).unwrap_err();
    assert!(matches!(error, ReadError::TooManyRows { limit: 1000 }), "{error}");
    let exact = format!("{{\"r\": [{}1]}}", "1,".repeat(999));
    let error = json::read(exact.as_bytes(), None, &limits).unwrap_err();
    assert!(matches!(error, ReadError::MissingArrays { .. }), "{error}");
}

pub fn unpack(bytes: &[u8]) -> Result<ReadTrial, ReadError> {
    csv::read(GzipReader::new(bytes), &Options::default())
}

#[test]
fn defects_of_gzip_are_told_apart() {
    let plain = table(|_| ());
    let packed = gzip(plain.as_bytes());
    assert_eq!(unpack(&packed).unwrap(), read(&plain).unwrap());
    // Several members are one file.
    let (head, tail) = plain.split_at(20);
    assert_eq!(unpack(&[gzip(head.as_bytes()), gzip(tail.as_bytes())].concat()).unwrap(), read(&plain).unwrap());

    let error = |bytes: &[u8]| match unpack(bytes).unwrap_err() {
        ReadError::Gzip(error) => error,
        other => panic!("{other}"),
    };
    assert_eq!(error(b""), GzipError::Empty);
    assert_eq!(error(plain.as_bytes()), GzipError::NotGzip);
    for length in 1..packed.len() {
        assert!(matches!(error(&packed[..length]), GzipError::Truncated { .. }), "{length} bytes");
    }
    let garbage = [packed.clone(), b"t,r".to_vec()].concat();
    assert_eq!(error(&garbage), GzipError::TrailingGarbage { unpacked_bytes: plain.len() as u64 });
    let mut corrupted = packed.clone();
    let checksum = packed.len() - 8;
    corrupted[checksum] ^= 1;
    assert!(matches!(error(&corrupted), GzipError::Corrupted { .. }), "{:?}", error(&corrupted));
    corrupted = packed.clone();
    corrupted[12] = 0xff;
    corrupted[13] = 0xff;
    assert!(matches!(error(&corrupted), GzipError::Corrupted { .. } | GzipError::Truncated { .. }));
    // An empty file inside.
    assert!(matches!(unpack(&gzip(b"")).unwrap_err(), ReadError::Empty));
}

#[test]
fn a_small_file_that_unpacks_to_a_large_one_is_stopped() {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    let rows = "1,2,3\n".repeat(10_000);
    encoder.write_all(b"r,u,y\n").unwrap();
    for _ in 0..1000 {
        encoder.write_all(rows.as_bytes()).unwrap();
    }
    let packed = encoder.finish().unwrap();
    assert!(packed.len() < 1_000_000);
    let options = Options { sample_time_s: Some(0.1), ..Options::default() };
    let error = csv::read(GzipReader::new(packed.as_slice()), &options).unwrap_err();
    assert!(matches!(error, ReadError::TooManyRows { limit: 2_000_000 }), "{error}");
}

// ---- JSON

#[test]
fn every_defect_of_a_document_is_named_with_its_place() {
    use Code::{BadSignal, Malformed};
    let good = r#"{"sample_time_s": 0.1, "r": [1, 2.5], "u": [0, -0.0], "y": [1e-320, 3], "d": null}"#;
    let trial = json::read(good.as_bytes(), None, &Limits::default()).unwrap();
    assert_eq!(trial.signals.command, [1.0, 2.5]);
    assert!(trial.signals.control[1].is_sign_negative());
    assert_eq!(trial.signals.output[0], 1e-320);
    let twice = json::read(good.as_bytes(), Some(0.2), &Limits::default()).unwrap_err();
    let error = TrialError::SampleTimes { document_s: 0.1, given_s: 0.2 };
    assert!(matches!(&twice, ReadError::Trial { error: found, .. } if *found == error), "{twice}");
    for (text, code, location, words) in [
        ("", Malformed, None, "empty"),
        ("[1]", Malformed, None, "expected an object with the arrays r, u, y"),
        ("{", Malformed, None, "EOF"),
        (r#"{"r": [1]} x"#, Malformed, None, "trailing characters"),
        (r#"{"r": [1, 2], "u": [1, 2]}"#, Malformed, None, r#"no array "y""#),
        (r#"{"r": [1, 2], "u": [1, 2], "y": null}"#, Malformed, None, r#"no array "y""#),
        (r#"{"r": [1], "r": [1]}"#, Malformed, Some("/r"), "twice"),
        (r#"{"target": [1]}"#, Malformed, Some("/target"), r#"no member "target""#),
        (r#"{"r": [1, null]}"#, BadSignal, Some("/r/1"), "null, where a number belongs"),
        (r#"{"r": [1, 2, "3"]}"#, BadSignal, Some("/r/2"), r#"the text "3""#),
        (r#"{"y": [true]}"#, BadSignal, Some("/y/0"), "true"),
        (r#"{"y": [[1]]}"#, BadSignal, Some("/y/0"), "an array"),
        (r#"{"y": [0, {"a": 1}]}"#, BadSignal, Some("/y/1"), "an object"),
        (r#"{"y": [0, NaN]}"#, Malformed, None, "expected value at line 1"),
        (r#"{"y": [0, 1e400]}"#, BadSignal, Some("/y/1"), "beyond the range"),
        (r#"{"y": 3}"#, BadSignal, Some("/y"), "the number 3, where an array"),
        (r#"{"y": "3"}"#, BadSignal, Some("/y"), "the text"),
        (r#"{"sample_time_s": "x"}"#, BadSignal, Some("/sample_time_s"), "the text"),
        (
            r#"{"sample_time_s": 0, "r": [1, 2], "u": [1, 2], "y": [1, 2]}"#,
            BadSignal,
            Some("/sample_time_s"),
            "positive",
        ),
        (r#"{"r": [1, 2], "u": [1, 2], "y": [1, 2]}"#, BadSignal, None, "neither a time column t nor a sample time"),
        (
            r#"{"sample_time_s": 1, "r": [1, 2, 3], "u": [1, 2], "y": [1, 2]}"#,
            BadSignal,
            Some("/r"),
            "r has 3 samples, y has 2",
        ),
        (r#"{"t": [0, 1, 1], "r": [1, 2, 3], "u": [1, 2, 3], "y": [1, 2, 3]}"#, BadSignal, Some("/t/2"), "twice"),
    ] {
        let problem = Problem::from(json::read(text.as_bytes(), None, &Limits::default()).unwrap_err());
        assert_eq!(problem.code, code, "{text}: {problem}");
        assert_eq!(problem.location.as_deref(), location, "{text}: {problem}");
        assert!(problem.detail.contains(words), "{text}: {problem}");
    }
}

// ---- recordings

fn read_file(path: &Path) -> ReadTrial {
    let file = std::fs::File::open(path).unwrap();
    csv::read(GzipReader::new(file), &Options::default()).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn virtual_subjects_are_read_and_have_their_true_errors() {
    let folder = crate::virtual_subjects::folder();
    let truth: Vec<serde_json::Value> =
        serde_json::from_slice(&std::fs::read(folder.join("truth.json")).unwrap()).unwrap();
    assert_eq!(truth.len(), 60);
    for entry in truth {
        let path = folder.join(entry["file"].as_str().unwrap());
        let trial = read_file(&path).trial;
        assert_eq!(trial.sample_time_s, entry["sample_time_s"].as_f64().unwrap(), "{}", path.display());
        let error = trial.error();
        let mean = error.iter().map(|e| e.abs()).sum::<f64>() / error.len() as f64;
        let expected = entry["mean_abs_error"].as_f64().unwrap();
        // The columns are printed with five decimals.
        assert!((mean - expected).abs() < 1e-5, "{}: {mean} {expected}", path.display());
        let largest = trial.signals.output.iter().fold(0.0, |most: f64, y| most.max(y.abs()));
        let limit = entry["display_limit"].as_f64().unwrap();
        assert_eq!(largest > limit, entry["divergent"].as_bool().unwrap(), "{}", path.display());
    }
}
