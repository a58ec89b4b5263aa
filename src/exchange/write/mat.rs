//! MATLAB's format of level 5, uncompressed: what MATLAB, Octave and scipy read without a toolbox.

use super::Sequence;

const INT8: u32 = 1;
const UINT16: u32 = 4;
const INT32: u32 = 5;
const UINT32: u32 = 6;
const DOUBLE: u32 = 9;
const MATRIX: u32 = 14;

const CLASS_CELL: u32 = 1;
const CLASS_STRUCT: u32 = 2;
const CLASS_CHAR: u32 = 4;
const CLASS_DOUBLE: u32 = 6;

/// Bytes of a field's name, with the zero that ends it.
const NAME_BYTES: usize = 32;

/// A value that a variable may have.
#[derive(Debug, Clone, PartialEq)]
pub enum MatValue {
    /// A matrix, row by row.
    Matrix(Vec<Vec<f64>>),
    /// Text.
    Text(String),
    /// A struct with fields in this order.
    Struct(Vec<(String, MatValue)>),
    /// A matrix of values, row by row.
    Cells(Vec<Vec<MatValue>>),
}

impl MatValue {
    /// A single number.
    #[must_use]
    pub fn number(value: f64) -> Self {
        Self::Matrix(vec![vec![value]])
    }

    /// Numbers in a row, as coefficients are written.
    #[must_use]
    pub fn row(values: &[f64]) -> Self {
        Self::Matrix(vec![values.to_vec()])
    }

    /// Numbers in a column, as samples are written.
    #[must_use]
    pub fn column(values: &[f64]) -> Self {
        Self::Matrix(values.iter().map(|value| vec![*value]).collect())
    }
}

/// A name that MATLAB takes: letters, digits and underscores, a letter first, so many characters at most.
fn name(text: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let mut name: String = text.chars().map(plain).take(NAME_BYTES - 1).collect();
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        name = format!("x{name}").chars().take(NAME_BYTES - 1).collect();
    }
    name
}

fn size(bytes: usize) -> u32 {
    u32::try_from(bytes).unwrap_or(u32::MAX)
}

fn element(out: &mut Vec<u8>, kind: u32, data: &[u8]) {
    out.extend(kind.to_le_bytes());
    out.extend(size(data.len()).to_le_bytes());
    out.extend(data);
    out.resize(out.len().next_multiple_of(8), 0);
}

fn dimension(length: usize) -> [u8; 4] {
    i32::try_from(length).unwrap_or(i32::MAX).to_le_bytes()
}

/// What every array begins with.
fn head(class: u32, [rows, columns]: [usize; 2], name: &str) -> Vec<u8> {
    let mut out = Vec::new();
    let mut flags = class.to_le_bytes().to_vec();
    flags.extend([0; 4]);
    element(&mut out, UINT32, &flags);
    element(&mut out, INT32, &[dimension(rows), dimension(columns)].concat());
    element(&mut out, INT8, name.as_bytes());
    out
}

fn array(out: &mut Vec<u8>, name: &str, value: &MatValue) {
    let mut body;
    match value {
        MatValue::Matrix(rows) => {
            let columns = rows.first().map_or(0, Vec::len);
            body = head(CLASS_DOUBLE, [rows.len(), columns], name);
            let mut data = Vec::with_capacity(8 * rows.len() * columns);
            for column in 0..columns {
                for row in rows {
                    data.extend(row.get(column).copied().unwrap_or(f64::NAN).to_le_bytes());
                }
            }
            element(&mut body, DOUBLE, &data);
        }
        MatValue::Text(text) => {
            let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
            let length = units.len() / 2;
            body = head(CLASS_CHAR, [usize::from(length > 0), length], name);
            element(&mut body, UINT16, &units);
        }
        MatValue::Cells(rows) => {
            let columns = rows.first().map_or(0, Vec::len);
            body = head(CLASS_CELL, [rows.len(), columns], name);
            for column in 0..columns {
                for row in rows {
                    // A row that is shorter has nothing there.
                    array(&mut body, "", row.get(column).unwrap_or(&MatValue::Matrix(Vec::new())));
                }
            }
        }
        MatValue::Struct(fields) => {
            body = head(CLASS_STRUCT, [1, 1], name);
            // A small element: its length stands beside its type.
            body.extend((4 << 16 | INT32).to_le_bytes());
            body.extend(dimension(NAME_BYTES));
            let mut names = Vec::with_capacity(NAME_BYTES * fields.len());
            for (field, _) in fields {
                names.extend(self::name(field).as_bytes());
                names.resize(names.len().next_multiple_of(NAME_BYTES), 0);
            }
            element(&mut body, INT8, &names);
            for (_, value) in fields {
                array(&mut body, "", value);
            }
        }
    }
    element(out, MATRIX, &body);
}

/// A file with these variables.
#[must_use]
pub fn write(variables: &[(String, MatValue)]) -> Vec<u8> {
    let mut out = b"MATLAB 5.0 MAT-file, written by Volition".to_vec();
    out.resize(124, b' ');
    out.extend([0x00, 0x01, b'I', b'M']);
    for (own, value) in variables {
        array(&mut out, &name(own), value);
    }
    out
}

/// A file with the columns of a sequence, and its `sample_time_s`.
#[must_use]
pub fn sequence(sequence: &Sequence) -> Vec<u8> {
    let columns = sequence.columns.iter().map(|(name, values)| (name.clone(), MatValue::column(values)));
    let time = ("sample_time_s".to_owned(), MatValue::number(sequence.sample_time_s));
    write(&columns.chain([time]).collect::<Vec<_>>())
}
