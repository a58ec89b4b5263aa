//! HDF5: MATLAB's files of version 7.3, and plain ones as h5py writes them. The only user of `hdf5-pure`.
//!
//! In MATLAB's files a group is a struct, a dataset of references is a cell array (or a field of an array of structs),
//! and a class stands beside every value: an empty array is stored as its dimensions, text as numbers, a complex number
//! as a pair, and an array with its dimensions in reverse, so that its values lie column by column. How much is read is
//! known from the shapes before anything is.

use super::variables::{Numbers, Value, Variables};
use crate::analysis::{Code, Problem};
use crate::trial::ReadError;
use hdf5_pure::{AttrValue, DType, Dataset, Error, File, Group, Object};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The deepest nesting of structs and cells.
const MAX_DEPTH: usize = 32;

/// Values (arrays, texts, structs, cells) of one file at most.
const MAX_VALUES: usize = 100_000;

/// What a file of HDF5 is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Matlab,
    Plain,
}

/// Why reading ends.
enum Stop {
    Damaged(String),
    Problem(Problem),
}

impl From<Error> for Stop {
    fn from(error: Error) -> Self {
        Self::Damaged(error.to_string())
    }
}

impl From<Stop> for Problem {
    fn from(stop: Stop) -> Self {
        match stop {
            Stop::Problem(problem) => problem,
            Stop::Damaged(why) => Self::new(Code::Malformed, "damaged HDF5 file", format!("it cannot be read: {why}"))
                .mend("Send the whole file again, or save it anew: save('trial.mat', 't', 'r', 'u', 'y', '-v7')."),
        }
    }
}

/// The variables of a file, and what it is of.
///
/// # Errors
/// Where it is damaged, of Octave, or holds more than `max_bytes`.
pub(super) fn read(file: Vec<u8>, max_bytes: u64) -> Result<(Variables, Kind), Problem> {
    let size = file.len() as u64;
    // A young library of 120,000 lines: a defect of it must not be more than a refusal.
    let read = catch_unwind(AssertUnwindSafe(|| whole(file, max_bytes)));
    let (named, kind, left) =
        read.unwrap_or_else(|_| Err(Stop::Damaged("its reader came upon what it did not expect".to_owned())))?;
    Ok((Variables { named, bytes: size.max(max_bytes - left) }, kind))
}

type Named = Vec<(String, Value)>;

fn whole(file: Vec<u8>, max_bytes: u64) -> Result<(Named, Kind, u64), Stop> {
    let file = File::from_bytes(file)?;
    let root = file.root();
    let (datasets, groups) = (sorted(root.datasets()?), sorted(root.groups()?));
    for name in &groups {
        if root.group(name)?.attrs()?.contains_key("OCTAVE_NEW_FORMAT") {
            return Err(Stop::Problem(
                Problem::new(
                    Code::Malformed,
                    "a format that is not read",
                    "the file is HDF5 as Octave writes it with -hdf5, which only Octave reads",
                )
                .mend("In Octave, save it for MATLAB: save('-v7', 'trial.mat', 't', 'r', 'u', 'y')."),
            ));
        }
    }
    let mut is_matlab = false;
    for name in &datasets {
        is_matlab |= root.dataset(name)?.attrs()?.contains_key("MATLAB_class");
    }
    for name in &groups {
        is_matlab |= root.group(name)?.attrs()?.contains_key("MATLAB_class");
    }
    let kind = if is_matlab { Kind::Matlab } else { Kind::Plain };
    let mut walk = Walk { kind, max_bytes, bytes: max_bytes, values: MAX_VALUES };
    let mut named = Vec::new();
    // What begins with # are MATLAB's own stores of cells and objects.
    for name in datasets.iter().filter(|name| !name.starts_with('#')) {
        named.push((name.clone(), walk.dataset(&root.dataset(name)?, 0)?));
    }
    for name in groups.iter().filter(|name| !name.starts_with('#')) {
        named.push((name.clone(), walk.group(&root.group(name)?, 0)?));
    }
    Ok((named, kind, walk.bytes))
}

fn sorted(mut names: Vec<String>) -> Vec<String> {
    names.sort();
    names
}

struct Walk {
    kind: Kind,
    max_bytes: u64,
    bytes: u64,
    values: usize,
}

impl Walk {
    fn enter(&mut self, depth: usize) -> Result<(), Stop> {
        self.values = self.values.saturating_sub(1);
        if depth <= MAX_DEPTH && self.values > 0 {
            return Ok(());
        }
        let what = if depth > MAX_DEPTH {
            format!("structs and cells are nested more than {MAX_DEPTH} deep")
        } else {
            format!("there are more than {MAX_VALUES} arrays, texts, structs and cells")
        };
        Err(Stop::Problem(
            Problem::new(Code::TooLarge, "too much in one file", what).mend(
                "Save the signals of one trial as variables of their own: save('trial.mat', 't', 'r', 'u', 'y').",
            ),
        ))
    }

    fn spend(&mut self, values: usize) -> Result<(), Stop> {
        let bytes = (values as u64).saturating_mul(8);
        let left = self.bytes.checked_sub(bytes);
        self.bytes = left.ok_or_else(|| Stop::Problem(ReadError::TooManyBytes { limit: self.max_bytes }.into()))?;
        Ok(())
    }

    fn object(&mut self, object: &Object, depth: usize) -> Result<Value, Stop> {
        match object {
            Object::Group(group) => self.group(group, depth),
            Object::Dataset(dataset) => self.dataset(dataset, depth),
            _ => Ok(Value::Other("what is no array of numbers")),
        }
    }

    /// A group as a struct, or an array of structs.
    fn group(&mut self, group: &Group, depth: usize) -> Result<Value, Stop> {
        self.enter(depth)?;
        let mut fields = Vec::new();
        let mut count = 1;
        for name in sorted(group.datasets()?) {
            let dataset = group.dataset(&name)?;
            let is_list = self.kind == Kind::Matlab
                && matches!(dataset.dtype()?, DType::ObjectReference)
                && !dataset.attrs()?.contains_key("MATLAB_class");
            if is_list {
                let objects = self.referenced(&dataset)?;
                count = objects.len();
                let values = objects.iter().map(|object| self.object(object, depth + 1));
                fields.push((name, values.collect::<Result<_, _>>()?));
            } else {
                fields.push((name, vec![self.dataset(&dataset, depth + 1)?]));
            }
        }
        for name in sorted(group.groups()?) {
            fields.push((name.clone(), vec![self.group(&group.group(&name)?, depth + 1)?]));
        }
        if fields.iter().any(|(_, values)| values.len() != count) {
            return Err(Stop::Damaged("the fields of an array of structs are not equally many".to_owned()));
        }
        Ok(Value::Structs { count, fields })
    }

    fn referenced(&mut self, dataset: &Dataset) -> Result<Vec<Object>, Stop> {
        self.spend(self.count(&dataset.shape()?)?)?;
        Ok(dataset.dereference()?)
    }

    /// How many values a shape holds.
    fn count(&self, shape: &[u64]) -> Result<usize, Stop> {
        let product = shape.iter().try_fold(1_u64, |product, size| product.checked_mul(*size));
        let product = product.and_then(|product| usize::try_from(product).ok());
        product.ok_or_else(|| Stop::Problem(ReadError::TooManyBytes { limit: self.max_bytes }.into()))
    }

    fn dataset(&mut self, dataset: &Dataset, depth: usize) -> Result<Value, Stop> {
        self.enter(depth)?;
        let attributes = dataset.attrs()?;
        let class = text(&attributes, "MATLAB_class").unwrap_or_default();
        let shape = dataset.shape()?;
        let count = self.count(&shape)?;
        if attributes.contains_key("MATLAB_empty") && is_set(&attributes, "MATLAB_empty") || count == 0 {
            // What is stored are its dimensions.
            return Ok(Value::Numbers(numbers(0, 0, Vec::new())));
        }
        let (rows, columns) = self.sides(&shape, count);
        let dtype = dataset.dtype()?;
        if class == "cell" && matches!(dtype, DType::ObjectReference) {
            let objects = self.referenced(dataset)?;
            let items = objects.iter().map(|object| self.object(object, depth + 1));
            return Ok(Value::Cells(items.collect::<Result<_, _>>()?));
        }
        if class == "char" {
            self.spend(count)?;
            return Ok(Value::Text(String::from_utf16_lossy(&dataset.read_u16()?)));
        }
        match dtype {
            DType::Compound(members) if members.len() == 2 => {
                Ok(Value::Numbers(Numbers { is_complex: true, ..numbers(rows, columns, Vec::new()) }))
            }
            DType::F32 | DType::F64 | DType::I8 | DType::I16 | DType::I32 | DType::U8 | DType::U16 | DType::U32 => {
                self.spend(count)?;
                Ok(Value::Numbers(self.ordered(rows, columns, dataset.read_f64()?, false)))
            }
            DType::I64 => {
                self.spend(2 * count)?;
                let whole = dataset.read_i64()?;
                let is_rounded = whole.iter().any(|value| *value as f64 as i128 != i128::from(*value));
                Ok(Value::Numbers(self.ordered(rows, columns, whole.iter().map(|v| *v as f64).collect(), is_rounded)))
            }
            DType::U64 => {
                self.spend(2 * count)?;
                let whole = dataset.read_u64()?;
                let is_rounded = whole.iter().any(|value| *value as f64 as u128 != u128::from(*value));
                Ok(Value::Numbers(self.ordered(rows, columns, whole.iter().map(|v| *v as f64).collect(), is_rounded)))
            }
            // h5py's truth values.
            DType::Enum(names) if names.iter().any(|name| name == "TRUE") => {
                self.spend(count)?;
                let raw = dataset.read_raw()?;
                Ok(Value::Numbers(self.ordered(rows, columns, raw.iter().map(|v| f64::from(*v)).collect(), false)))
            }
            DType::String | DType::VariableLengthString => Ok(Value::Other("text")),
            _ => Ok(Value::Other("what is no array of numbers")),
        }
    }

    /// Rows and columns. MATLAB's dimensions are stored in reverse.
    fn sides(&self, shape: &[u64], count: usize) -> (usize, usize) {
        let rows = if self.kind == Kind::Matlab { shape.last() } else { shape.first() };
        let rows = rows.map_or(1, |rows| usize::try_from(*rows).unwrap_or(usize::MAX)).max(1);
        (rows, count / rows)
    }

    /// Values column by column.
    fn ordered(&self, rows: usize, columns: usize, values: Vec<f64>, is_rounded: bool) -> Numbers {
        let values = if self.kind == Kind::Matlab || rows <= 1 || columns <= 1 {
            values
        } else {
            (0..columns).flat_map(|column| values.iter().skip(column).step_by(columns).copied()).collect()
        };
        Numbers { is_rounded, ..numbers(rows, columns, values) }
    }
}

fn numbers(rows: usize, columns: usize, values: Vec<f64>) -> Numbers {
    Numbers { rows, columns, values, is_complex: false, is_rounded: false }
}

fn text(attributes: &HashMap<String, AttrValue>, name: &str) -> Option<String> {
    match attributes.get(name)? {
        AttrValue::String(text) | AttrValue::AsciiString(text) | AttrValue::StringSized { value: text, .. } => {
            Some(text.trim_end_matches('\0').to_owned())
        }
        _ => None,
    }
}

/// Whether a flag, of whatever type of integer, is not 0.
fn is_set(attributes: &HashMap<String, AttrValue>, name: &str) -> bool {
    match attributes.get(name) {
        Some(AttrValue::U8(value)) => *value != 0,
        Some(AttrValue::U32(value)) => *value != 0,
        Some(AttrValue::U64(value)) => *value != 0,
        Some(AttrValue::I32(value)) => *value != 0,
        Some(AttrValue::I64(value)) => *value != 0,
        Some(_) => true,
        None => false,
    }
}
