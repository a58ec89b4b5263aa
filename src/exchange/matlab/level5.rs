//! Level 5: elements with tags, one within the other, some compressed.

use super::bytes::Bytes;
use super::error::{MAX_DEPTH, MAX_VALUES, MatError};
use crate::exchange::numbers::Stored;
use crate::exchange::variables::{Numbers, Value, Variables};
use flate2::read::ZlibDecoder;
use std::io::Read as _;

/// Text, where the system's data lie, version, byte order.
const HEADER: usize = 128;

const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
const UTF8: u32 = 16;
const UTF16: u32 = 17;
const UTF32: u32 = 18;

/// A flag of an array.
const COMPLEX: u32 = 0x0800;

pub(super) fn is_one(head: &[u8]) -> bool {
    byte_order(head).is_some()
}

/// Whether the most significant byte comes first; `None` where it is no file of level 5.
fn byte_order(head: &[u8]) -> Option<bool> {
    match head.get(124..HEADER)? {
        [0x00, 0x01, b'I', b'M'] => Some(false),
        [0x01, 0x00, b'M', b'I'] => Some(true),
        _ => None,
    }
}

/// What may still be made of the file.
struct Budget {
    max_bytes: u64,
    bytes: u64,
    values: usize,
}

impl Budget {
    fn spend(&mut self, bytes: u64) -> Result<(), MatError> {
        self.bytes = self.bytes.checked_sub(bytes).ok_or(MatError::TooLarge(self.max_bytes))?;
        Ok(())
    }

    fn value(&mut self) -> Result<(), MatError> {
        self.values = self.values.checked_sub(1).ok_or(MatError::Values)?;
        Ok(())
    }
}

/// An element: its type, and its data.
struct Element<'a> {
    kind: u32,
    data: Bytes<'a>,
}

fn element<'a>(bytes: &mut Bytes<'a>, what: &'static str) -> Result<Element<'a>, MatError> {
    let first = bytes.u32(what)?;
    if first >> 16 != 0 {
        // Up to four bytes of data stand in the tag itself.
        let length = (first >> 16) as usize;
        if length > 4 {
            return Err(MatError::Malformed("the tag of a small element says that it is large"));
        }
        let data = &bytes.take(4, what)?[..length];
        return Ok(Element { kind: first & 0xffff, data: Bytes::new(data, bytes.is_big_endian) });
    }
    let length = bytes.u32(what)? as usize;
    let data = bytes.take(length, what)?;
    if first != COMPRESSED {
        bytes.pass(length.next_multiple_of(8) - length);
    }
    Ok(Element { kind: first, data: Bytes::new(data, bytes.is_big_endian) })
}

pub(super) fn read(file: &[u8], max_bytes: u64) -> Result<Variables, MatError> {
    if file.len() as u64 > max_bytes {
        return Err(MatError::TooLarge(max_bytes));
    }
    let is_big_endian = byte_order(file).ok_or(MatError::Malformed("it is no file of level 5"))?;
    let mut bytes = Bytes::new(file, is_big_endian);
    bytes.pass(HEADER);
    let mut budget = Budget { max_bytes, bytes: max_bytes, values: MAX_VALUES };
    let mut named = Vec::new();
    let mut unpacked = file.len() as u64;
    while !bytes.is_empty() {
        let Element { kind, data } = element(&mut bytes, "a variable")?;
        let variable = match kind {
            MATRIX => matrix(data, 0, &mut budget)?,
            COMPRESSED => {
                let inner = unpack(data, &mut budget)?;
                unpacked += inner.len() as u64;
                let mut inner = Bytes::new(&inner, is_big_endian);
                let Element { kind, data } = element(&mut inner, "a compressed variable")?;
                if kind != MATRIX {
                    return Err(MatError::Malformed("a compressed element is no variable"));
                }
                matrix(data, 0, &mut budget)?
            }
            _ => return Err(MatError::Type("a variable", kind)),
        };
        // The data of objects, which MATLAB keeps in a variable without a name.
        if !variable.0.is_empty() {
            named.push(variable);
        }
    }
    Ok(Variables { named, bytes: unpacked })
}

fn unpack(packed: Bytes<'_>, budget: &mut Budget) -> Result<Vec<u8>, MatError> {
    let mut packed = packed;
    let data = packed.take(packed.len(), "a compressed variable")?;
    let mut unpacked = Vec::new();
    let mut decoder = ZlibDecoder::new(data).take(budget.bytes.saturating_add(1));
    decoder.read_to_end(&mut unpacked).map_err(|error| MatError::Packed(error.to_string()))?;
    budget.spend(unpacked.len() as u64)?;
    Ok(unpacked)
}

/// A matrix's name and value.
fn matrix(mut bytes: Bytes<'_>, depth: usize, budget: &mut Budget) -> Result<(String, Value), MatError> {
    budget.value()?;
    // An element of a cell or struct that was never set.
    if bytes.is_empty() {
        return Ok((String::new(), empty()));
    }
    if depth > MAX_DEPTH {
        return Err(MatError::Depth);
    }
    let mut flags = element(&mut bytes, "an array's flags")?.data;
    let flags = flags.u32("an array's flags")?;
    let class = flags & 0xff;
    if class == 17 {
        // An object (a table, a string, a timeseries): its layout is MATLAB's own.
        let name = element(&mut bytes, "an object's name")?;
        return Ok((text(&name), Value::Other("an object of MATLAB")));
    }
    let dimensions = dimensions(&element(&mut bytes, "an array's dimensions")?)?;
    let name = text(&element(&mut bytes, "an array's name")?);
    let bad = || MatError::Dimensions(dimensions.iter().map(|d| *d as i64).collect());
    let count = dimensions.iter().try_fold(1_usize, |product, d| product.checked_mul(*d)).ok_or_else(bad)?;
    let rows = dimensions.first().copied().unwrap_or(0);
    let columns = count.checked_div(rows).unwrap_or(0);
    let value = match class {
        1 => {
            // Each has a tag of eight bytes at least.
            if count > bytes.len() / 8 {
                return Err(bad());
            }
            let items = (0..count).map(|_| item(&mut bytes, depth, budget));
            Value::Cells(items.collect::<Result<_, _>>()?)
        }
        2 | 3 => {
            if class == 3 {
                element(&mut bytes, "an object's class")?;
            }
            structs(&mut bytes, count, depth, budget)?
        }
        4 => Value::Text(characters(&element(&mut bytes, "a text")?, rows, count, budget)?),
        5 => Value::Other("a sparse matrix"),
        6..=15 => {
            let data = element(&mut bytes, "an array's data")?;
            let (values, is_rounded) = numbers(&data, count, budget)?.ok_or_else(bad)?;
            Value::Numbers(Numbers { rows, columns, values, is_complex: flags & COMPLEX != 0, is_rounded })
        }
        16 => Value::Other("a function"),
        _ => return Err(MatError::Malformed("an array is of no class")),
    };
    Ok((name, value))
}

fn empty() -> Value {
    Value::Numbers(Numbers { rows: 0, columns: 0, values: Vec::new(), is_complex: false, is_rounded: false })
}

fn item(bytes: &mut Bytes<'_>, depth: usize, budget: &mut Budget) -> Result<Value, MatError> {
    let Element { kind, data } = element(bytes, "an element of a struct or cell")?;
    if kind != MATRIX {
        return Err(MatError::Type("an element of a struct or cell", kind));
    }
    Ok(matrix(data, depth + 1, budget)?.1)
}

fn structs(bytes: &mut Bytes<'_>, count: usize, depth: usize, budget: &mut Budget) -> Result<Value, MatError> {
    let mut width = element(bytes, "the length of field names")?.data;
    let width = width.u32("the length of field names")? as usize;
    let mut names = element(bytes, "field names")?.data;
    let total = names.len();
    let all = names.take(total, "field names")?;
    if width == 0 {
        return if total == 0 {
            Ok(Value::Structs { count, fields: Vec::new() })
        } else {
            Err(MatError::Malformed("field names have no length"))
        };
    }
    let names: Vec<String> = all
        .chunks_exact(width)
        .map(|name| String::from_utf8_lossy(name.split(|byte| *byte == 0).next().unwrap_or_default()).into_owned())
        .collect();
    let needed = count.checked_mul(names.len()).filter(|needed| *needed <= bytes.len() / 8);
    if needed.is_none() {
        return Err(MatError::Truncated("a struct's fields"));
    }
    let mut fields: Vec<(String, Vec<Value>)> = names.into_iter().map(|name| (name, Vec::new())).collect();
    for _ in 0..count {
        for (_, values) in &mut fields {
            values.push(item(bytes, depth, budget)?);
        }
    }
    Ok(Value::Structs { count, fields })
}

fn dimensions(element: &Element<'_>) -> Result<Vec<usize>, MatError> {
    let mut data = element.data;
    let mut dimensions = Vec::new();
    while data.len() >= 4 {
        let size = data.u32("an array's dimensions")? as i32;
        dimensions.push(usize::try_from(size).map_err(|_| MatError::Dimensions(vec![i64::from(size)]))?);
    }
    if (2..=32).contains(&dimensions.len()) {
        Ok(dimensions)
    } else {
        Err(MatError::Malformed("an array has no dimensions, or too many"))
    }
}

fn stored(kind: u32) -> Option<Stored> {
    Some(match kind {
        1 => Stored::I8,
        2 => Stored::U8,
        3 => Stored::I16,
        4 => Stored::U16,
        5 => Stored::I32,
        6 => Stored::U32,
        7 => Stored::F32,
        9 => Stored::F64,
        12 => Stored::I64,
        13 => Stored::U64,
        _ => return None,
    })
}

/// Numbers; `None` where there are not `count` of them.
fn numbers(element: &Element<'_>, count: usize, budget: &mut Budget) -> Result<Option<(Vec<f64>, bool)>, MatError> {
    let stored = stored(element.kind).ok_or(MatError::Type("an array", element.kind))?;
    let mut data = element.data;
    if count.checked_mul(stored.width()) != Some(data.len()) {
        return Ok(None);
    }
    budget.spend(count as u64 * 8)?;
    let is_big_endian = data.is_big_endian;
    Ok(Some(stored.numbers(data.take(data.len(), "an array's data")?, is_big_endian)))
}

/// A name, which is ASCII.
fn text(element: &Element<'_>) -> String {
    let mut data = element.data;
    let bytes = data.take(data.len(), "a name").unwrap_or_default();
    String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned()
}

/// Text, whose rows become lines; characters are stored column by column.
fn characters(element: &Element<'_>, rows: usize, count: usize, budget: &mut Budget) -> Result<String, MatError> {
    let mut data = element.data;
    let is_big_endian = data.is_big_endian;
    let bytes = data.take(data.len(), "a text")?;
    budget.spend(bytes.len() as u64 * 4)?;
    let codes = |stored: Stored| stored.numbers(bytes, is_big_endian).0.into_iter().map(|code| code as u32);
    let all: Vec<char> = match element.kind {
        UTF8 => String::from_utf8_lossy(bytes).chars().collect(),
        UTF16 | 4 => {
            let units: Vec<u16> = codes(Stored::U16).map(|code| code as u16).collect();
            String::from_utf16_lossy(&units).chars().collect()
        }
        UTF32 | 6 => codes(Stored::U32).filter_map(char::from_u32).collect(),
        1 | 2 => codes(Stored::U8).filter_map(char::from_u32).collect(),
        other => return Err(MatError::Type("a text", other)),
    };
    if rows <= 1 || all.len() != count {
        return Ok(all.into_iter().collect());
    }
    let line = |row: usize| all.iter().skip(row).step_by(rows).collect::<String>();
    Ok((0..rows).map(|row| line(row).trim_end().to_owned()).collect::<Vec<_>>().join("\n"))
}
