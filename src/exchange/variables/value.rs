//! What variables hold.

/// What a variable holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Numbers, column by column.
    Numbers(Numbers),
    /// Text.
    Text(String),
    /// Cells.
    Cells(Vec<Value>),
    /// An array of structs: for each field its value in every element.
    Structs {
        /// How many elements.
        count: usize,
        /// Names of the fields, with as many values as there are elements.
        fields: Vec<(String, Vec<Value>)>,
    },
    /// What holds no signals, by what it is.
    Other(&'static str),
}

/// An array of numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbers {
    /// Rows.
    pub rows: usize,
    /// Columns, of all pages of an array of more dimensions.
    pub columns: usize,
    /// The values, column by column.
    pub values: Vec<f64>,
    /// Whether there are imaginary parts, which are left out here.
    pub is_complex: bool,
    /// Whether a value is no double, and was rounded to one.
    pub is_rounded: bool,
}

impl Numbers {
    pub(super) fn is_vector(&self) -> bool {
        self.rows.min(self.columns) == 1 && self.values.len() > 1
    }

    pub(super) fn column(&self, column: usize) -> Option<&[f64]> {
        self.values.get(column.checked_mul(self.rows)?..column.checked_add(1)?.checked_mul(self.rows)?)
    }
}

/// What the variables of a file are.
#[derive(Debug, Clone, PartialEq)]
pub struct Variables {
    /// They, by name, in file order.
    pub named: Vec<(String, Value)>,
    /// Bytes read, after unpacking.
    pub bytes: u64,
}
