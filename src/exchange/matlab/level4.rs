//! Level 4: matrices of numbers or text, one behind the other.

use super::bytes::Bytes;
use super::error::{MAX_VALUES, MatError};
use crate::exchange::numbers::Stored;
use crate::exchange::variables::{Numbers, Value, Variables};

/// Five numbers before each matrix.
const HEADER: usize = 20;

/// MATLAB's names are shorter.
const MAX_NAME: usize = 256;

struct Header {
    stored: Stored,
    kind: u32,
    rows: usize,
    columns: usize,
    is_complex: bool,
    name: String,
}

/// Whether a file begins with the header of a matrix with a name. The first number has four digits that say how it is
/// stored: a file of anything else hardly begins so.
pub(super) fn is_one(head: &[u8]) -> bool {
    [false, true].into_iter().any(|is_big_endian| header(&mut Bytes::new(head, is_big_endian)).is_ok())
}

fn header(bytes: &mut Bytes<'_>) -> Result<Header, MatError> {
    const WHAT: &str = "a matrix's header";
    let kind = bytes.u32(WHAT)?;
    let [rows, columns, imaginary, length] = [bytes.u32(WHAT)?, bytes.u32(WHAT)?, bytes.u32(WHAT)?, bytes.u32(WHAT)?];
    let order = u32::from(bytes.is_big_endian);
    if kind >= 5000 || kind / 1000 != order || kind / 100 % 10 != 0 || kind % 10 > 2 || imaginary > 1 {
        return Err(MatError::Malformed("it is no matrix of level 4"));
    }
    let stored = match kind / 10 % 10 {
        0 => Stored::F64,
        1 => Stored::F32,
        2 => Stored::I32,
        3 => Stored::I16,
        4 => Stored::U16,
        5 => Stored::U8,
        other => return Err(MatError::Type("a matrix", other)),
    };
    let length = length as usize;
    if !(2..=MAX_NAME).contains(&length) {
        return Err(MatError::Malformed("a matrix has no name"));
    }
    let name = bytes.take(length, "a matrix's name")?;
    let name = name.split(|byte| *byte == 0).next().unwrap_or_default();
    let is_name = name.first().is_some_and(u8::is_ascii_alphabetic)
        && name.iter().all(|byte| byte.is_ascii_alphanumeric() || *byte == b'_');
    if !is_name {
        return Err(MatError::Malformed("a matrix has no name"));
    }
    let name = String::from_utf8_lossy(name).into_owned();
    let is_complex = imaginary == 1;
    Ok(Header { stored, kind: kind % 10, rows: rows as usize, columns: columns as usize, is_complex, name })
}

pub(super) fn read(file: &[u8], max_bytes: u64) -> Result<Variables, MatError> {
    if file.len() as u64 > max_bytes {
        return Err(MatError::TooLarge(max_bytes));
    }
    let is_big_endian = header(&mut Bytes::new(file, false)).is_err();
    let mut bytes = Bytes::new(file, is_big_endian);
    let mut named = Vec::new();
    let mut budget = max_bytes;
    while bytes.len() >= HEADER {
        if named.len() >= MAX_VALUES {
            return Err(MatError::Values);
        }
        let Header { stored, kind, rows, columns, is_complex, name } = header(&mut bytes)?;
        let dimensions = || MatError::Dimensions([rows, columns].iter().map(|d| *d as i64).collect());
        let count = rows.checked_mul(columns).ok_or_else(dimensions)?;
        let length = count.checked_mul(stored.width()).ok_or_else(dimensions)?;
        let data = bytes.take(length, "a matrix")?;
        if is_complex {
            bytes.take(length, "a matrix's imaginary part")?;
        }
        budget = budget.checked_sub(count as u64 * 8).ok_or(MatError::TooLarge(max_bytes))?;
        let (values, is_rounded) = stored.numbers(data, is_big_endian);
        let value = match kind {
            0 => Value::Numbers(Numbers { rows, columns, values, is_complex, is_rounded }),
            1 => Value::Text(values.iter().filter_map(|code| char::from_u32(*code as u32)).collect()),
            _ => Value::Other("a sparse matrix"),
        };
        named.push((name, value));
    }
    if !bytes.is_empty() {
        return Err(MatError::Truncated("a matrix's header"));
    }
    Ok(Variables { named, bytes: file.len() as u64 })
}
