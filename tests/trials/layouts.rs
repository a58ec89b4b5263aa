//! Tables as labs write them: what each is taken for, or why it is refused.
//!
//! `tests/golden/layouts.txt` says it for every layout in one line. Where a layout is read, its signals are those that
//! were written into it, bit for bit.

use crate::round_trip::gzip;
use std::fmt::Write as _;
use volition::exchange::{self, Options, Reading, Resampling, TimeUnit, options::columns};

const ROWS: usize = 12;

/// The signals of every layout, numbers of few digits.
pub(crate) fn signals() -> [Vec<f64>; 3] {
    let row = |f: fn(f64) -> f64| (0..ROWS).map(|i| f(i as f64)).collect();
    [row(|i| 0.25 * i), row(|i| 1.125 - 0.5 * i), row(|i| 0.0625 * i * i)]
}

/// How a table is written.
struct Style<'a> {
    head: &'a str,
    delimiter: &'a str,
    end: &'a str,
    comma: bool,
    time: &'a dyn Fn(usize) -> String,
    /// Before and behind the signals.
    before: &'a dyn Fn(usize) -> String,
    behind: &'a str,
}

fn seconds(i: usize) -> String {
    format!("{:.2}", 0.02 * i as f64)
}

fn nothing(_: usize) -> String {
    String::new()
}

const PLAIN: Style<'static> =
    Style { head: "", delimiter: ",", end: "\n", comma: false, time: &seconds, before: &nothing, behind: "" };

impl Style<'_> {
    fn text(&self) -> String {
        let [r, u, y] = signals();
        let mut text = self.head.to_owned();
        for i in 0..ROWS {
            let mut cells = vec![(self.time)(i)];
            cells.extend([r[i], u[i], y[i]].map(|value| value.to_string()));
            cells.retain(|cell| !cell.is_empty());
            if self.comma {
                cells = cells.into_iter().map(|cell| cell.replace('.', ",")).collect();
            }
            let _ = write!(text, "{}{}{}{}", (self.before)(i), cells.join(self.delimiter), self.behind, self.end);
        }
        text
    }
}

fn mapped(text: &str) -> Options {
    Options { columns: columns(text).unwrap(), ..Options::default() }
}

fn rate(sample_time_s: f64) -> Options {
    Options { sample_time_s: Some(sample_time_s), ..Options::default() }
}

fn unit(time_unit: TimeUnit) -> Options {
    Options { time_unit: Some(time_unit), ..Options::default() }
}

fn resampled() -> Options {
    Options { resample: Some(Resampling::Linear), ..Options::default() }
}

fn utf16(text: &str, little: bool, mark: bool) -> Vec<u8> {
    let units = mark.then_some(0xfeff).into_iter().chain(text.encode_utf16());
    units.flat_map(|unit| if little { unit.to_le_bytes() } else { unit.to_be_bytes() }).collect()
}

/// Bytes of Latin-1, whose characters are the first of Unicode.
fn latin1(text: &str) -> Vec<u8> {
    text.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect()
}

type Layout = (&'static str, Vec<u8>, Options);

#[allow(clippy::too_many_lines, reason = "one entry a layout")]
fn layouts() -> Vec<Layout> {
    let default = Options::default;
    let text = |head: &str| Style { head, ..PLAIN }.text();
    let with = |head: &str, delimiter: &str| Style { head, delimiter, ..PLAIN }.text();
    let comma = |head: &str, delimiter: &str| Style { head, delimiter, comma: true, ..PLAIN }.text();
    let timed = |head: &str, time: &dyn Fn(usize) -> String| Style { head, time, ..PLAIN }.text();
    let number = |i: usize| format!("{},", i + 1);
    let quoted = |i: usize| format!("\"{}\" ", i + 1);
    let people = |i: usize| format!("s01,{},", if i < 6 { "left" } else { "right" });
    let german = Style { head: "\u{feff}t;r;u;y\r\n", delimiter: ";", end: "\r\n", comma: true, ..PLAIN }.text();
    let skipped =
        |gap: usize| timed("t,r,u,y\n", &move |i| format!("{:.2}", 0.02 * (if i < 5 { i } else { i + gap }) as f64));
    let changing = |i: usize| format!("{:.3}", if i <= 5 { 0.02 * i as f64 } else { 0.1 + 0.024 * (i - 5) as f64 });
    let shaken = |i: usize| format!("{:.4}", 0.02 * i as f64 + if i % 3 == 1 { 0.003 } else { 0.0 });
    let eyelink = timed("t r u y\n", &|i| (5_001_230 + i / 2).to_string()).replace(',', " ");
    let title = "Format Version,1.23,Take Name,walk 3\n\nFrame,Time (Seconds),r,u,y\n";
    vec![
        ("plain", text("t,r,u,y\n").into(), default()),
        ("packed", gzip(text("t,r,u,y\n").as_bytes()), default()),
        ("Excel, German", german.clone().into(), default()),
        ("Excel, German, with sep=", german.replace("\u{feff}", "sep=;\r\n").into(), default()),
        ("Excel, French names", comma("Temps (s);r;u;y\n", ";").into(), default()),
        ("Excel, French names mapped", comma("Temps (s);r;u;y\n", ";").into(), mapped("t:Temps (s)")),
        ("Excel, Unicode text", utf16(&comma("t\tr\tu\ty\n", "\t"), true, true), default()),
        ("UTF-16 without mark", utf16(&text("t,r,u,y\n"), true, false), default()),
        ("UTF-16 from a big-endian system", utf16(&with("t\tr\tu\ty\n", "\t"), false, true), default()),
        ("Latin-1", latin1(&comma("t [s];r [\u{b5}m];Gr\u{f6}\u{df}e;y\n", ";")), mapped("u:Größe")),
        ("tabs", with("t\tr\tu\ty\n", "\t").into(), default()),
        ("tabs, decimal comma", comma("t\tr\tu\ty\n", "\t").into(), default()),
        ("spaces", with("t r u y\n", " ").into(), default()),
        ("aligned with spaces", with("   t     r     u     y\n", "    ").into(), default()),
        ("spaces, decimal comma", comma("t r u y\n", "  ").into(), default()),
        ("bars", with("t|r|u|y\n", "|").into(), default()),
        ("numpy.savetxt, spaces", with("# t r u y\n", " ").into(), default()),
        ("numpy.savetxt, commas", text("# t,r,u,y\n").into(), default()),
        (
            "comments above and between",
            text("% recorded by rig 2\n% t,r,u,y\n").replace("0.06,", "% paused\n0.06,").into(),
            default(),
        ),
        ("comments of C", text("// rig 2\n// gain: 3\nt,r,u,y\n").into(), default()),
        ("pandas.to_csv", Style { head: ",t,r,u,y\n", before: &number, ..PLAIN }.text().into(), default()),
        (
            "write.table of R",
            Style { head: "\"t\" \"r\" \"u\" \"y\"\n", delimiter: " ", before: &quoted, ..PLAIN }.text().into(),
            default(),
        ),
        ("writematrix of MATLAB", text("").into(), default()),
        ("writematrix of MATLAB, mapped", text("").into(), mapped("t:1,r:2,u:3,y:4")),
        ("writematrix, columns in another order", text("").into(), mapped("t:1,y:2,u:3,r:4")),
        ("writetable of MATLAB", text("Time,Target,Joystick,Cursor\n").into(), default()),
        (
            "writetable of MATLAB, mapped",
            text("Time,Target,Joystick,Cursor\n").into(),
            mapped("r:Target,u:Joystick,y:Cursor"),
        ),
        ("names that suggest nothing", text("ch1,ch2,ch3,ch4\n").into(), default()),
        ("words", text("Time,Command,Control,Output\n").into(), default()),
        ("capitals", with("T;R;U;Y\n", ";").into(), default()),
        ("units in names", timed("t (ms),r (deg),u (N),y (deg)\n", &|i| (20 * i).to_string()).into(), default()),
        ("a row of units", timed("t,r,u,y\nms,deg,N,deg\n", &|i| (20 * i).to_string()).into(), default()),
        ("a row of units in brackets", text("t,r,u,y\n[s],[mm],[],[mm]\n").into(), default()),
        ("a unit that is unknown", text("t (min),r,u,y\n").into(), default()),
        ("microseconds in the name", timed("t_us,r,u,y\n", &|i| (20_000 * i).to_string()).into(), default()),
        ("milliseconds, given", timed("t,r,u,y\n", &|i| (20 * i).to_string()).into(), unit(TimeUnit::Milliseconds)),
        ("milliseconds, not said", timed("t,r,u,y\n", &|i| (20 * i).to_string()).into(), default()),
        (
            "dates in milliseconds",
            timed("t,r,u,y\n", &|i| (1_714_550_400_123_u64 + 20 * i as u64).to_string()).into(),
            default(),
        ),
        (
            "dates in seconds",
            timed("t,r,u,y\n", &|i| format!("{:.3}", 1_714_550_400.5 + 0.02 * i as f64)).into(),
            default(),
        ),
        (
            "counted samples",
            timed("t,r,u,y\n", &|i| (17 + i).to_string()).into(),
            Options { sample_time_s: Some(0.02), ..unit(TimeUnit::Samples) },
        ),
        ("counted samples, no rate", timed("t,r,u,y\n", &|i| i.to_string()).into(), unit(TimeUnit::Samples)),
        (
            "counted samples, two lost",
            timed("t,r,u,y\n", &|i| (if i < 5 { i } else { i + 2 }).to_string()).into(),
            Options { sample_time_s: Some(0.02), ..unit(TimeUnit::Samples) },
        ),
        (
            "EyeLink at 2 kHz",
            eyelink.clone().into(),
            Options { sample_time_s: Some(0.0005), ..unit(TimeUnit::Milliseconds) },
        ),
        ("EyeLink at 2 kHz, no rate", eyelink.clone().into(), unit(TimeUnit::Milliseconds)),
        (
            "EyeLink at 2 kHz, wrong rate",
            eyelink.into(),
            Options { sample_time_s: Some(0.001), ..unit(TimeUnit::Milliseconds) },
        ),
        (
            "PsychoPy",
            Style { head: "participant,condition,t,r,u,y\n", before: &people, ..PLAIN }.text().into(),
            default(),
        ),
        ("OptiTrack", Style { head: title, before: &number, ..PLAIN }.text().into(), default()),
        ("LabVIEW", with("Rig\t2\nOperator\tN. N.\n\nt\tr\tu\ty\n", "\t").into(), default()),
        (
            "a delimiter at every end",
            Style { head: "t;r;u;y\n", delimiter: ";", behind: ";", ..PLAIN }.text().into(),
            default(),
        ),
        ("a title and no names", text("Subject 12 of May\n").into(), mapped("t:1,r:2,u:3,y:4")),
        ("no times", Style { head: "r,u,y\n", time: &nothing, ..PLAIN }.text().into(), rate(0.02)),
        ("no times, no rate", Style { head: "r,u,y\n", time: &nothing, ..PLAIN }.text().into(), default()),
        (
            "numbers in quotes with commas",
            comma("t,r,u,y\n", "\",\"")
                .replace('\n', "\"\n\"")
                .replace("t,r,u,y\"", "t,r,u,y")
                .trim_end_matches('"')
                .to_owned()
                .into(),
            default(),
        ),
        ("commas between thousands", comma("t;r;u;y\n", ";").replace("0,25;", "1.234,25;").into(), default()),
        ("a value that is not there", text("t,r,u,y\n").replace("0.75", "n/a").into(), default()),
        ("names twice", text("t,r,r,y\n").into(), mapped("u:3")),
        ("line ends of an old Mac", text("t,r,u,y\n").replace('\n', "\r").into(), default()),
        ("three samples lost", skipped(3).into(), default()),
        ("three samples lost, resampled", skipped(3).into(), resampled()),
        ("a second lost, resampled", skipped(50).into(), resampled()),
        ("another rate in the middle", timed("t,r,u,y\n", &changing).into(), default()),
        ("another rate, resampled", timed("t,r,u,y\n", &changing).into(), resampled()),
        ("shaken times", timed("t,r,u,y\n", &shaken).into(), default()),
        ("shaken times, resampled", timed("t,r,u,y\n", &shaken).into(), resampled()),
        ("even times, resampled", text("t,r,u,y\n").into(), resampled()),
        ("JSON", br#"{"sample_time_s": 0.02, "r": [0, 1], "u": [0, 1], "y": [0, 1]}"#.to_vec(), default()),
        (
            "JSON with columns",
            br#"{"sample_time_s": 0.02, "r": [0, 1], "u": [0, 1], "y": [0, 1]}"#.to_vec(),
            mapped("r:a"),
        ),
        ("a picture", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec(), default()),
    ]
}

/// What a file was taken for, in one line.
pub(crate) fn line(reading: &Reading) -> String {
    let known = &reading.understood;
    let columns: Vec<String> = known
        .columns
        .iter()
        .map(|c| format!("{}={}{}", c.signal, c.name, c.unit.as_ref().map_or_else(String::new, |u| format!("[{u}]"))))
        .collect();
    let mut line = format!(
        "{} {} {} {}, names in {}, samples from {}, {}, time in {}, {} samples every {} s",
        known.format,
        known.encoding.as_deref().unwrap_or("-"),
        known.delimiter.unwrap_or("-"),
        known.decimal_mark.unwrap_or("-"),
        known.header_row.map_or_else(|| "-".to_owned(), |row| row.to_string()),
        known.first_row.map_or_else(|| "-".to_owned(), |row| row.to_string()),
        columns.join(" "),
        known.time_unit.unwrap_or("-"),
        reading.trial.samples(),
        reading.trial.sample_time_s,
    );
    if !reading.ignored_columns.is_empty() {
        let _ = write!(line, ", left out {}", reading.ignored_columns.join(" "));
    }
    for warning in &reading.warnings {
        let _ = write!(line, ", {}", warning.code);
    }
    line
}

#[test]
fn layouts_are_read_or_refused_as_the_table_says() {
    let mut table = String::new();
    let mut names = std::collections::BTreeSet::new();
    for (name, bytes, options) in layouts() {
        assert!(names.insert(name), "{name} twice");
        let said = match exchange::read(&bytes, &options) {
            Ok(reading) => {
                let found = &reading.trial.signals;
                let [r, u, y] = signals();
                let expected = if name.contains("another order") { [y, u, r] } else { [r, u, y] };
                if !reading.understood.resampled && reading.understood.format == "text" {
                    assert_eq!([&found.command, &found.control, &found.output], expected.each_ref(), "{name}");
                }
                assert!(
                    !reading.understood.words.is_empty() && reading.understood.words.iter().all(|w| w.ends_with('.'))
                );
                format!("read: {}", line(&reading))
            }
            Err(problem) => {
                assert!(problem.mend.is_some(), "{name}: {problem}");
                format!("refused: {problem}")
            }
        };
        let _ = writeln!(table, "{name}: {said}");
    }
    assert!(names.len() >= 52, "{}", names.len());
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/layouts.txt");
    if std::env::var_os("VOLITION_BLESS").is_some() {
        std::fs::write(&path, &table).unwrap();
    }
    let golden = std::fs::read_to_string(&path).unwrap_or_default();
    for (found, expected) in table.lines().zip(golden.lines()) {
        assert_eq!(found, expected);
    }
    assert_eq!(table, golden);
}

/// Straight lines stay straight, whatever the grid: `r` and `u` of a resampled layout are what they were.
#[test]
fn resampling_keeps_straight_lines_and_the_samples_that_it_meets() {
    let text = "t,r,u,y\n0,0,1,5\n0.02,0.2,1.4,7\n0.04,0.4,1.8,5\n0.09,0.9,2.8,-5\n0.1,1,3,0\n0.12,1.2,3.4,1\n";
    let reading = exchange::read(text.as_bytes(), &resampled()).unwrap();
    let found = &reading.trial.signals;
    assert_eq!((reading.trial.sample_time_s, reading.trial.samples()), (0.02, 7));
    for (k, (r, u)) in found.command.iter().zip(&found.control).enumerate() {
        let t = 0.02 * k as f64;
        assert!((r - 10.0 * t).abs() < 1e-12 && (u - 1.0 - 20.0 * t).abs() < 1e-12, "{k}: {r} {u}");
    }
    assert_eq!([found.output[0], found.output[1], found.output[2], found.output[6]], [5.0, 7.0, 5.0, 1.0]);
    // 0.06 s lies two fifths of the way from 0.04 to 0.09.
    assert!((found.output[3] - 1.0).abs() < 1e-12, "{}", found.output[3]);
    assert_eq!(reading.warnings[0].code, "resampled");
    let coarse = Options { sample_time_s: Some(0.05), ..resampled() };
    let refused = exchange::read(text.as_bytes(), &coarse).unwrap_err();
    assert!(refused.detail.contains("folded"), "{refused}");
}

/// No text brings the reader down, whatever is changed in it.
#[test]
fn damaged_tables_are_read_or_refused() {
    use rand::{RngExt as _, SeedableRng as _};
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(20_261_130);
    for (name, bytes, options) in layouts() {
        for _ in 0..40 {
            let mut bytes = bytes.clone();
            for _ in 0..random.random_range(1..6) {
                if bytes.is_empty() {
                    break;
                }
                let at = random.random_range(0..bytes.len());
                match random.random_range(0..4) {
                    0 => bytes[at] = random.random(),
                    1 => bytes.insert(at, *b",;\t \n\"'.#0-e".get(random.random_range(0..12)).unwrap()),
                    2 => drop(bytes.remove(at)),
                    _ => bytes.truncate(at),
                }
            }
            if let Ok(reading) = exchange::read(&bytes, &options) {
                assert!(reading.trial.signals.output.iter().all(|y| y.is_finite()), "{name}");
            }
        }
    }
}

/// A file of `tests/data/cases/csv`, packed as it is there.
fn case(name: &str) -> Vec<u8> {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases/csv").join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Files that people had: each is read rightly, or refused with the row, the reason and how to go on.
#[test]
fn files_of_labs_come_out_right() {
    let read = |name: &str, options: &Options| exchange::read(&case(name), options).unwrap();
    let refused = |name: &str, options: &Options| exchange::read(&case(name), options).unwrap_err();
    let default = Options::default;

    // Times in microseconds and milliseconds, once it is said. A warning where it is not: tests/service.
    let us = read("F13_csv_time_us_clean.csv.gz", &unit(TimeUnit::Microseconds));
    assert_eq!((us.trial.sample_time_s, us.trial.samples()), (0.016667, 400));
    let ms = read("ms.csv.gz", &unit(TimeUnit::Milliseconds));
    let seconds = read("excel_de.csv.gz", &default());
    assert_eq!((ms.trial.sample_time_s, ms.trial.samples()), (0.02, 3001));
    assert_eq!(ms.trial.signals_sha256(), seconds.trial.signals_sha256());
    let index = read("F14_csv_time_index.csv.gz", &Options { sample_time_s: Some(0.05), ..unit(TimeUnit::Samples) });
    assert_eq!((index.trial.sample_time_s, index.trial.signals.time_s), (0.05, None));

    // A header in a comment: its time column is read, and a sample time that it contradicts is refused.
    let commented = read("F16_csv_savetxt_default_fs.csv.gz", &default());
    assert!((commented.trial.sample_time_s - 1.0 / 60.0).abs() < 1e-6, "{}", commented.trial.sample_time_s);
    assert!(commented.understood.words[0].contains("the comment in row 1 names the columns"));
    let contradicted = refused("F16_csv_savetxt_default_fs.csv.gz", &rate(0.02));
    assert!(contradicted.detail.contains("the sample time given is 0.02 s"), "{contradicted}");
    assert_eq!(contradicted.location.as_deref(), Some("column t"));

    // No header: said, with a mapping by position; then the value that is none is what is wrong.
    let headerless = refused("F17_csv_headerless_na.csv.gz", &default());
    assert_eq!((headerless.title.as_str(), headerless.location.as_deref()), ("no header", Some("row 1")));
    assert!(headerless.mend.as_deref().unwrap().contains("columns=t:1,r:2,u:3,y:4"), "{headerless}");
    let missing = refused("F17_csv_headerless_na.csv.gz", &mapped("t:1,r:2,u:3,y:4"));
    assert_eq!(missing.location.as_deref(), Some("row 1, column 2"), "{missing}");

    // 90 Hz, and 82 Hz in rows 152 to 251.
    let changing = refused("F19_csv_fluctuating_90_82.csv.gz", &default());
    assert_eq!(changing.location.as_deref(), Some("row 152, column t"));
    assert!(changing.detail.contains("rows 152 to 251 follow each other by 0.0122 s (82 Hz)"), "{changing}");
    assert!(changing.mend.as_deref().unwrap().contains("resample=linear"));
    let even = read("F19_csv_fluctuating_90_82.csv.gz", &resampled());
    assert_eq!((even.trial.sample_time_s, even.warnings[0].code.as_str()), (0.011111, "resampled"));
    assert_eq!(even.trial.signals.output[0], 0.011110);

    let spaces = read("F25_csv_space_delim.csv.gz", &default());
    assert_eq!((spaces.understood.delimiter, spaces.trial.samples()), (Some("spaces"), 400));
    // Tabs, and a value that is not there: refused by its row, and filled on request.
    let tabs = refused("F26_csv_bids_tsv_header.csv.gz", &default());
    assert_eq!(tabs.location.as_deref(), Some("row 5, column r"));
    assert!(tabs.detail.contains("n/a") && tabs.mend.as_deref().unwrap().contains("resample=linear"), "{tabs}");
    let tabs = read("F26_csv_bids_tsv_header.csv.gz", &resampled());
    assert_eq!((tabs.understood.delimiter, tabs.trial.sample_time_s), (Some("tab"), 0.01));
    assert_eq!((tabs.trial.samples(), tabs.warnings[0].code.as_str()), (400, "resampled"));
    assert!((tabs.trial.signals.command[3] - 0.03).abs() < 1e-12);
    assert!(tabs.warnings.iter().any(|w| w.message.starts_with("1 samples without a value")), "{:?}", tabs.warnings);
    assert_eq!(
        (seconds.understood.delimiter, seconds.understood.decimal_mark, seconds.trial.sample_time_s),
        (Some("semicolon"), Some("comma"), 0.02)
    );

    // Other names: the mapping stands in the refusal, and does what it says.
    let names = refused("wrongnames.csv.gz", &default());
    let mapping = "columns=t:Time,r:Target,u:Joystick,y:Cursor";
    assert!(names.mend.as_deref().unwrap().contains(mapping), "{names}");
    let named = read("wrongnames.csv.gz", &mapped(mapping.strip_prefix("columns=").unwrap()));
    assert_eq!(named.trial.content_sha256(), seconds.trial.content_sha256());
}
