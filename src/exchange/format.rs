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

/// How files begin that are known and not read: what they are, and what to do.
const REFUSED: [(&[u8], &str, &str); 7] = [
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
    (b"PAR1", "a Parquet file", "Save it as CSV, such as pandas.read_parquet(FILE).to_csv('trial.csv')."),
    (
        b"\x80\x04\x95",
        "a pickled object of Python",
        "Save the arrays with numpy.savez('trial.npz', t=t, r=r, u=u, y=y).",
    ),
    (b"RDX3", "a file of R", "Save the table as CSV: write.csv(data, 'trial.csv', row.names = FALSE)."),
];

impl Format {
    pub(super) fn of(head: &[u8]) -> Result<Self, Problem> {
        if let Some((_, what, mend)) = REFUSED.into_iter().find(|(mark, ..)| head.starts_with(mark)) {
            let detail = format!("the file is {what}, which is not read here");
            return Err(Problem::new(Code::Malformed, "a format that is not read", detail).mend(mend));
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
        Ok(if head.trim_ascii_start().starts_with(b"{") { Self::Json } else { Self::Text })
    }
}
