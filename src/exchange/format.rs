//! Which format a file is of, by its first bytes.

use super::matlab::{self, Level};
use super::{archive, numpy};
use crate::analysis::{Code, Problem};

/// A format that is read.
pub(super) enum Format {
    Json,
    Text,
    Matlab(Level),
    Numpy,
    Zip,
    Hdf5,
}

/// How HDF5 begins, perhaps behind a block of somebody else's.
const HDF5: &[u8] = b"\x89HDF\r\n\x1a\n";

/// What to do with packed files.
const UNPACK: &str = "Unpack it, and send the file, or a zip archive.";

/// How files begin that are known and not read: what they are, and what to do.
const REFUSED: [(&[u8], &str, &str); 30] = [
    (
        b"# Created by Octave",
        "a text file of Octave",
        "In Octave, save it for MATLAB: save('-v7', 'trial.mat', 't', 'r', 'u', 'y').",
    ),
    (
        b"Octave-1-",
        "a binary file of Octave",
        "In Octave, save it for MATLAB: save('-v7', 'trial.mat', 't', 'r', 'u', 'y').",
    ),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a file of an old Microsoft Office (.xls)", "Save it as CSV."),
    (b"%PDF", "a PDF", "Send the table itself, as CSV."),
    (b"{\\rtf", "a document of a word processor", "Send the table itself, as CSV."),
    (b"PAR1", "a Parquet file", "Save it as CSV, such as pandas.read_parquet(FILE).to_csv('trial.csv')."),
    (b"ARROW1", "a Feather file", "Save it as CSV, such as pandas.read_feather(FILE).to_csv('trial.csv')."),
    (b"\x80\x02", "a pickled object of Python", PICKLED),
    (b"\x80\x03", "a pickled object of Python", PICKLED),
    (b"\x80\x04", "a pickled object of Python", PICKLED),
    (b"\x80\x05", "a pickled object of Python", PICKLED),
    (b"RDX3", "a file of R", OF_R),
    (b"RDX2", "a file of R", OF_R),
    (b"X\n\0\0", "a file of R", OF_R),
    (
        b"TDSm",
        "a TDMS file of LabVIEW or DIAdem",
        "Save it as CSV, such as nptdms.TdmsFile.read(FILE).as_dataframe().to_csv('trial.csv').",
    ),
    (
        b"\x02P",
        "a C3D file",
        "Export the channels as text, such as with ezc3d or Mokka: one column for each, one row a frame.",
    ),
    (b"\xffBIOSEMI", "a BDF file", "Save it as CSV, such as mne.io.read_raw_bdf(FILE).to_data_frame().to_csv(…)."),
    (b"XDF:", "a recording of the Lab Streaming Layer", "Load it with pyxdf, and save its streams on one time as CSV."),
    (b"#ROSBAG V", "a bag of ROS", "Export its topics: rostopic echo -b FILE -p /TOPIC > trial.csv."),
    (b"\x89MCAP", "a bag of ROS 2", "Export its topics as CSV, such as with PlotJuggler."),
    (
        b"SQLite format 3\0",
        "a database (of ROS 2, among others)",
        "Export the table as CSV: sqlite3 -csv -header FILE.",
    ),
    (b"$FL2", "a file of SPSS", "Save it as CSV, such as pandas.read_spss(FILE).to_csv('trial.csv', index=False)."),
    (b"<stata_dta>", "a file of Stata", "Save it as CSV: export delimited using trial.csv."),
    (b"RIFF", "sound or film", "Send the samples as a table, with their sample time."),
    (b"Rar!", "packed by RAR", UNPACK),
    (b"7z\xbc\xaf", "packed by 7-Zip", UNPACK),
    (b"\x28\xb5\x2f\xfd", "packed by zstd", UNPACK),
    (b"BZh91AY&SY", "packed by bzip2", UNPACK),
    (b"\xfd7zXZ", "packed by xz", UNPACK),
    (b"\x1f\x9d", "packed by compress", UNPACK),
];

const PICKLED: &str = "Save the arrays with numpy.savez('trial.npz', t=t, r=r, u=u, y=y).";

const OF_R: &str = "Save the table as CSV: write.csv(data, 'trial.csv', row.names = FALSE).";

/// Whether a file is EDF: a version, and where the date and the time of the recording stand.
fn is_edf(head: &[u8]) -> bool {
    let at = |range: std::ops::Range<usize>| head.get(range).unwrap_or_default();
    let is_date = |text: &[u8]| text.len() == 8 && text[2] == b'.' && text[5] == b'.';
    at(0..8) == b"0       " && is_date(at(168..176)) && is_date(at(176..184))
}

/// Whether a file is of Spike2, by its maker's name.
fn is_spike2(head: &[u8]) -> bool {
    head.get(2..10).is_some_and(|name| name.starts_with(b"(C) CED"))
}

fn not_read(what: &str, mend: &str) -> Problem {
    let detail = format!("the file is {what}, which is not read here");
    Problem::new(Code::Malformed, "a format that is not read", detail).mend(mend)
}

/// Whether the lines are documents of their own.
fn is_json_lines(head: &[u8]) -> bool {
    let mut lines = head.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii).filter(|line| !line.is_empty());
    let is_one = |line: &[u8]| line.starts_with(b"{") && line.ends_with(b"}");
    lines.next().is_some_and(is_one) && lines.next().is_some_and(|line| line.starts_with(b"{"))
}

impl Format {
    pub(super) fn of(head: &[u8]) -> Result<Self, Problem> {
        if let Some((_, what, mend)) = REFUSED.into_iter().find(|(mark, ..)| head.starts_with(mark)) {
            return Err(not_read(what, mend));
        }
        if is_edf(head) {
            let mend = "Save it as CSV, such as mne.io.read_raw_edf(FILE).to_data_frame().to_csv('trial.csv').";
            return Err(not_read("an EDF file", mend));
        }
        if is_spike2(head) {
            return Err(not_read("a recording of Spike2", "In Spike2, export it as spreadsheet text."));
        }
        if head.starts_with(numpy::MARK) {
            return Ok(Self::Numpy);
        }
        if head.starts_with(archive::MARK) || head.starts_with(archive::MARK_OF_NONE) {
            return Ok(Self::Zip);
        }
        let starts = std::iter::once(0).chain((9..=15).map(|power| 1_usize << power));
        if starts.into_iter().any(|at| head.get(at..).is_some_and(|rest| rest.starts_with(HDF5))) {
            return Ok(Self::Hdf5);
        }
        if let Some(level) = matlab::recognise(head) {
            return Ok(Self::Matlab(level));
        }
        if is_json_lines(head) {
            let mend = "Make one document of them: jq -s '{t: map(.t), r: map(.r), u: map(.u), y: map(.y)}' FILE.";
            return Err(not_read("JSON lines, a document for each sample", mend));
        }
        Ok(if head.trim_ascii_start().starts_with(b"{") { Self::Json } else { Self::Text })
    }
}
