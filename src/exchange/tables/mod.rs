//! Tidy tables: a row for each thing that was observed, a column for each thing that is said of it.
//!
//! [`Table`] writes rows as CSV and as a JSON object a line; [`study`] has the rows of a study's trials and analyses,
//! [`curves`], [`responses`] and [`comparison`] those of what is answered about its groups. Tables are long where a
//! quantity has statistics (a row for each quantity, its name in `metric`), which is what mixed models and plots of R
//! and pandas take; they are wide only where a row is a trial.

pub mod comparison;
pub mod curves;
pub mod responses;
pub mod study;

use serde_json::Value;
use std::collections::BTreeMap;

/// What is said of one thing: names and values, in the order of the columns.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Record {
    cells: Vec<(String, Value)>,
}

impl Record {
    /// With a cell more; the value null where there is none. A name is given once.
    #[must_use]
    pub fn with(mut self, name: impl Into<String>, value: impl Into<Value>) -> Self {
        self.add(name, value);
        self
    }

    /// Adds a cell.
    pub fn add(&mut self, name: impl Into<String>, value: impl Into<Value>) {
        self.cells.push((name.into(), value.into()));
    }

    /// Adds a value with the ends of its interval, under `name`, `name_low` and `name_high`.
    pub(super) fn add_interval(&mut self, name: &str, value: Option<f64>, interval: Option<[f64; 2]>) {
        self.add(name, value);
        self.add(format!("{name}_low"), interval.map(|ends| ends[0]));
        self.add(format!("{name}_high"), interval.map(|ends| ends[1]));
    }
}

/// Rows under one list of columns.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Table {
    columns: Vec<String>,
    rows: Vec<Vec<Value>>,
}

/// Where a new column goes: behind the one that stood before it in its own record.
fn place(columns: &[String], before: Option<&str>) -> usize {
    before.and_then(|name| columns.iter().position(|column| column == name)).map_or(0, |at| at + 1)
}

impl FromIterator<Record> for Table {
    /// Every column that any of the records has; where a record does not say it, the cell is empty.
    fn from_iter<I: IntoIterator<Item = Record>>(records: I) -> Self {
        let records: Vec<Record> = records.into_iter().collect();
        let mut columns: Vec<String> = Vec::new();
        let mut known: std::collections::BTreeSet<String> = std::collections::BTreeSet::new();
        for record in &records {
            let mut before: Option<&str> = None;
            for (name, _) in &record.cells {
                if known.insert(name.clone()) {
                    let at = place(&columns, before);
                    columns.insert(at, name.clone());
                }
                before = Some(name);
            }
        }
        let at: BTreeMap<&str, usize> = columns.iter().enumerate().map(|(i, name)| (name.as_str(), i)).collect();
        let row = |record: Record| {
            let mut row = vec![Value::Null; columns.len()];
            for (name, value) in record.cells {
                if let Some(cell) = at.get(name.as_str()).and_then(|i| row.get_mut(*i)) {
                    *cell = value;
                }
            }
            row
        };
        let rows = records.into_iter().map(row).collect();
        drop(at);
        Self { columns, rows }
    }
}

/// A cell of CSV: numbers with the fewest digits that read back as the same double, an empty one for nothing.
fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

impl Table {
    /// How many rows there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// With columns that stand first, in this order, whether or not a record has them: an empty table has them too.
    #[must_use]
    pub fn beginning_with(self, names: &[&str]) -> Self {
        let rest: Vec<usize> = (0..self.columns.len()).filter(|i| !names.contains(&&*self.columns[*i])).collect();
        let at: Vec<Option<usize>> = names.iter().map(|name| self.columns.iter().position(|own| own == name)).collect();
        let order: Vec<Option<usize>> = at.into_iter().chain(rest.iter().copied().map(Some)).collect();
        let mut columns: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        columns.extend(rest.iter().map(|i| self.columns[*i].clone()));
        let moved = |row: Vec<Value>| order.iter().map(|i| i.map_or(Value::Null, |i| row[i].clone())).collect();
        Self { columns, rows: self.rows.into_iter().map(moved).collect() }
    }

    /// As CSV (RFC 4180) with a header.
    #[must_use]
    pub fn csv(&self) -> Vec<u8> {
        let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new());
        // Writing to memory does not fail.
        let _ = writer.write_record(&self.columns);
        for row in &self.rows {
            let _ = writer.write_record(row.iter().map(cell));
        }
        writer.into_inner().unwrap_or_default()
    }

    /// As JSON objects, one a line, every one with every column.
    #[must_use]
    pub fn ndjson(&self) -> Vec<u8> {
        let mut text = Vec::new();
        let names: Vec<String> = self.columns.iter().map(|name| Value::from(name.as_str()).to_string()).collect();
        for row in &self.rows {
            // In the order of the columns, which a map would not keep.
            let members: Vec<String> = names.iter().zip(row).map(|(name, value)| format!("{name}:{value}")).collect();
            text.extend(format!("{{{}}}\n", members.join(",")).into_bytes());
        }
        text
    }
}

/// What serialises to one word, as that word.
fn word(value: &impl serde::Serialize) -> Value {
    serde_json::to_value(value).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_of_all_records_keep_their_neighbours_and_cells_their_bits() {
        let table: Table = [
            Record::default().with("a", 1).with("c", 0.1 + 0.2).with("z", "x, \"y\"\r\n=1"),
            Record::default().with("a", Value::Null).with("b", true).with("c", 1e-300).with("d", f64::NAN),
        ]
        .into_iter()
        .collect();
        let text = String::from_utf8(table.csv()).unwrap();
        assert_eq!(text, "a,b,c,d,z\r\n1,,0.30000000000000004,,\"x, \"\"y\"\"\r\n=1\"\r\n,true,1e-300,,\r\n");
        let lines = String::from_utf8(table.ndjson()).unwrap();
        let second: Value = serde_json::from_str(lines.lines().nth(1).unwrap()).unwrap();
        assert_eq!(second, serde_json::json!({"a": null, "b": true, "c": 1e-300, "d": null, "z": null}));
        let moved = table.beginning_with(&["q", "c"]);
        assert!(String::from_utf8(moved.csv()).unwrap().starts_with("q,c,a,b,d,z\r\n,0.30000000000000004,1,,,"));
        assert_eq!(Table::default().beginning_with(&["a", "b"]).csv(), b"a,b\r\n");
    }
}
