//! Arrays of NumPy: `.npy`, and `.npz` as an archive of them.
//!
//! Format: *NEP 1, a simple file format for NumPy arrays*, versions 1 to 3: a dictionary as Python writes it, then the
//! numbers. Objects are pickled Python, which runs when it is read: they are refused.

use super::archive::Archive;
use super::numbers::Stored;
use super::variables::{Numbers, Value, Variables};
use crate::analysis::{Code, Problem};

pub(super) const MARK: &[u8] = b"\x93NUMPY";

/// A dictionary is a line of text.
const MAX_HEADER: usize = 64 * 1024;

/// Dimensions of an array at most.
const MAX_DIMENSIONS: usize = 32;

fn damaged(why: impl Into<String>) -> Problem {
    Problem::new(Code::Malformed, "damaged NumPy file", why)
        .mend("Save it anew: numpy.savez('trial.npz', t=t, r=r, u=u, y=y).")
}

/// The array of an `.npy` file, under the name `array`.
///
/// # Errors
/// Where it is damaged, or holds objects.
pub(super) fn array(file: &[u8]) -> Result<Variables, Problem> {
    Ok(Variables { named: vec![("array".to_owned(), value(file)?)], bytes: file.len() as u64 })
}

/// The arrays of an `.npz` file, by name.
///
/// # Errors
/// As [`array()`], or where the archive is damaged or unpacks to more than is allowed.
pub(super) fn arrays(mut archive: Archive<'_>) -> Result<Variables, Problem> {
    let mut named = Vec::new();
    for (at, name) in archive.names().into_iter().enumerate() {
        let file = archive.file(at)?;
        let name = name.strip_suffix(".npy").unwrap_or(&name).to_owned();
        let value = value(&file).map_err(|problem| {
            let place = name.clone();
            problem.at(place)
        })?;
        named.push((name, value));
    }
    Ok(Variables { named, bytes: archive.unpacked() })
}

/// What stands before the numbers.
struct Header {
    descr: String,
    is_fortran: bool,
    shape: Vec<usize>,
}

fn value(file: &[u8]) -> Result<Value, Problem> {
    let (header, data) = split(file).ok_or_else(|| damaged("the file ends in the middle of its header"))?;
    let text = std::str::from_utf8(header).map_err(|_| damaged("its header is no text"))?;
    let Header { descr, is_fortran, shape } =
        parse(text).ok_or_else(|| damaged("its header is not as NumPy writes it"))?;
    let Some((stored, is_big_endian, is_complex)) = stored(&descr) else {
        return match descr.trim_start_matches(['<', '>', '|', '=']).chars().next() {
            Some('O') => Err(Problem::new(
                Code::Malformed,
                "objects of Python",
                "the array holds objects of Python, which are read by running them",
            )
            .mend("Save plain arrays: numpy.savez('trial.npz', t=t, r=r, u=u, y=y), each of numbers.")),
            Some('U' | 'S') => Ok(Value::Other("text")),
            _ => Ok(Value::Other("an array of records, dates or half precision")),
        };
    };
    let too_many = || damaged(format!("its shape {shape:?} holds another number of values than the file"));
    let count = shape.iter().try_fold(1_usize, |product, size| product.checked_mul(*size)).ok_or_else(too_many)?;
    let width = stored.width() * if is_complex { 2 } else { 1 };
    if count.checked_mul(width) != Some(data.len()) {
        return Err(too_many());
    }
    let rows = shape.first().copied().unwrap_or(1);
    let columns = count.checked_div(rows).unwrap_or(0);
    if is_complex {
        return Ok(Value::Numbers(Numbers { rows, columns, values: Vec::new(), is_complex, is_rounded: false }));
    }
    let (values, is_rounded) = stored.numbers(data, is_big_endian);
    // Row by row unless it says otherwise; here they stand column by column.
    let values = if is_fortran || rows <= 1 || columns <= 1 {
        values
    } else {
        (0..columns).flat_map(|column| values.iter().skip(column).step_by(columns).copied()).collect()
    };
    Ok(Value::Numbers(Numbers { rows, columns, values, is_complex, is_rounded }))
}

fn split(file: &[u8]) -> Option<(&[u8], &[u8])> {
    let rest = file.strip_prefix(MARK)?;
    let (length, at) = match rest.first()? {
        1 => (usize::from(u16::from_le_bytes([*rest.get(2)?, *rest.get(3)?])), 4),
        2 | 3 => {
            let bytes: [u8; 4] = rest.get(2..6)?.try_into().ok()?;
            (u32::from_le_bytes(bytes) as usize, 6)
        }
        _ => return None,
    };
    if length > MAX_HEADER {
        return None;
    }
    rest.get(at..)?.split_at_checked(length)
}

/// A dictionary with `descr`, `fortran_order` and `shape`.
fn parse(text: &str) -> Option<Header> {
    let after = |key: &str| {
        let quoted = [format!("'{key}':"), format!("\"{key}\":")];
        quoted.iter().find_map(|quoted| text.find(quoted.as_str()).map(|at| text[at + quoted.len()..].trim_start()))
    };
    let descr = after("descr")?;
    let quote = descr.chars().next()?;
    // A list describes records.
    let descr = if quote == '\'' || quote == '"' { descr[1..].split(quote).next()?.to_owned() } else { "V".to_owned() };
    let order = after("fortran_order")?;
    let is_fortran = if order.starts_with("True") { true } else { !order.starts_with("False").then_some(true)? };
    let shape = after("shape")?.strip_prefix('(')?.split(')').next()?;
    let sizes = shape.split(',').map(str::trim).filter(|size| !size.is_empty());
    let shape = sizes.map(|size| size.trim_end_matches('L').parse().ok()).collect::<Option<Vec<usize>>>()?;
    (shape.len() <= MAX_DIMENSIONS).then_some(Header { descr, is_fortran, shape })
}

/// How numbers are stored, whether the most significant byte comes first, and whether they are pairs.
fn stored(descr: &str) -> Option<(Stored, bool, bool)> {
    let is_big_endian = descr.starts_with('>');
    Some(match descr.trim_start_matches(['<', '>', '|', '=']) {
        "f8" => (Stored::F64, is_big_endian, false),
        "f4" => (Stored::F32, is_big_endian, false),
        "i8" => (Stored::I64, is_big_endian, false),
        "i4" => (Stored::I32, is_big_endian, false),
        "i2" => (Stored::I16, is_big_endian, false),
        "i1" => (Stored::I8, is_big_endian, false),
        "u8" => (Stored::U64, is_big_endian, false),
        "u4" => (Stored::U32, is_big_endian, false),
        "u2" => (Stored::U16, is_big_endian, false),
        "u1" | "b1" => (Stored::U8, is_big_endian, false),
        "c16" => (Stored::F64, is_big_endian, true),
        "c8" => (Stored::F32, is_big_endian, true),
        _ => return None,
    })
}
