//! NumPy's archive of arrays.

use super::{Sequence, zip};

/// A one-dimensional array, or a single number, of doubles as a file of NumPy, version 1.0.
fn array(values: &[f64], is_scalar: bool) -> Vec<u8> {
    let shape = if is_scalar { "()".to_owned() } else { format!("({},)", values.len()) };
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
    // Magic, version, length and header together fill blocks of 64 bytes, a line's end last.
    let before = 10;
    let padded = (before + header.len() + 1).next_multiple_of(64);
    header.extend(std::iter::repeat_n(' ', padded - before - header.len() - 1));
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend(u16::try_from(header.len()).unwrap_or_default().to_le_bytes());
    out.extend(header.as_bytes());
    out.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    out
}

/// The columns of a sequence, and its `sample_time_s`, as `numpy.load` reads them.
#[must_use]
pub fn sequence(sequence: &Sequence) -> Vec<u8> {
    let columns = sequence.columns.iter().map(|(name, values)| (format!("{name}.npy"), array(values, false)));
    let time = ("sample_time_s.npy".to_owned(), array(&[sequence.sample_time_s], true));
    zip::write(columns.chain([time]).collect())
}
