//! The index of a folder of trials: which file is which trial of whom.
//!
//! A CSV index has a header with the columns `file`, `subject` and `trial`, and where wanted `group`, `session`,
//! `plant` and `display_limit`. A JSON index is an array of objects with the same members, and may give the plant by
//! `plant_num`, `plant_den` and `plant_sample_time_s`. Other columns are kept as they are.

use crate::control::model::TransferFunctionModel;
use anyhow::{Context as _, bail};
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};

/// The names looked for in a folder, in this order.
const NAMES: [&str; 3] = ["index.csv", "index.json", "truth.json"];

/// A trial as its index describes it.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// The file, relative to the folder.
    pub file: String,
    /// The subject's pseudonym.
    pub subject: String,
    /// The trial's number.
    pub number: i64,
    /// Its session.
    pub session: Option<i64>,
    /// The subject's group.
    pub group: Option<String>,
    /// The plant, by a name or as text.
    pub plant: Option<String>,
    /// The plant's transfer function, where the index gives it.
    pub model: Option<TransferFunctionModel>,
    /// The display limit.
    pub display_limit: Option<f64>,
    /// All other columns.
    pub extras: Map<String, Value>,
}

/// A row that cannot be used, or a file that was not imported.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refused {
    /// The file, or the place in the index where no file is named.
    pub file: String,
    /// Why.
    pub reason: String,
}

/// A folder's index.
#[derive(Debug, Clone, PartialEq)]
pub struct Index {
    /// Where it was found.
    pub path: PathBuf,
    /// Its rows in order, or why one cannot be used.
    pub rows: Vec<Result<Row, Refused>>,
    /// The names of the other columns, in order of their names.
    pub extra_columns: Vec<String>,
    /// Rows that the filter left out.
    pub filtered: usize,
}

/// A condition `COLUMN=VALUE` on rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Condition {
    /// The column.
    pub column: String,
    /// The text that it must have.
    pub value: String,
}

impl std::str::FromStr for Condition {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (column, value) = text.split_once('=').ok_or("a condition is written COLUMN=VALUE")?;
        Ok(Self { column: column.to_owned(), value: value.to_owned() })
    }
}

/// Reads the index of `folder`: `name`, or else the first of `index.csv`, `index.json` and `truth.json` that is there.
///
/// # Errors
/// When there is none, or it cannot be read at all. A row that cannot be used is refused on its own.
pub fn read(folder: &Path, name: Option<&Path>, conditions: &[Condition]) -> anyhow::Result<Index> {
    let path = match name {
        Some(name) => folder.join(name),
        None => NAMES.iter().map(|n| folder.join(n)).find(|p| p.is_file()).with_context(|| {
            format!("there is no index in {}: expected one of {}", folder.display(), NAMES.join(", "))
        })?,
    };
    let json = path.extension().is_some_and(|e| e == "json");
    let records = if json { read_json(&path) } else { read_csv(&path) };
    let records = records.with_context(|| format!("cannot read the index {}", path.display()))?;
    for condition in conditions {
        if !records.iter().any(|(_, r)| r.contains_key(&condition.column)) {
            bail!("the index {} has no column {:?}", path.display(), condition.column);
        }
    }
    let total = records.len();
    let kept = records
        .into_iter()
        .filter(|(_, record)| conditions.iter().all(|c| record.get(&c.column).is_some_and(|v| text_of(v) == c.value)));
    let rows: Vec<_> = kept.map(|(place, record)| row(&place, record)).collect();
    let mut extra_columns: Vec<String> = rows.iter().flatten().flat_map(|r| r.extras.keys().cloned()).collect();
    extra_columns.sort();
    extra_columns.dedup();
    let filtered = total - rows.len();
    Ok(Index { path, rows, extra_columns, filtered })
}

type Record = (String, Map<String, Value>);

fn read_csv(path: &Path) -> anyhow::Result<Vec<Record>> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_path(path)?;
    let header = reader.headers()?.clone();
    for name in ["file", "subject", "trial"] {
        if !header.iter().any(|h| h == name) {
            bail!("it has no column {name:?}; its columns are {}", header.iter().collect::<Vec<_>>().join(", "));
        }
    }
    if let Some(twice) = header.iter().enumerate().find(|(i, h)| header.iter().take(*i).any(|earlier| earlier == *h)) {
        bail!("it has the column {:?} twice", twice.1);
    }
    let mut records = Vec::new();
    for record in reader.records() {
        let record = record?;
        let line = record.position().map_or(0, csv::Position::line);
        // An empty cell is a value that is not given.
        let cells = header.iter().zip(&record).filter(|(_, cell)| !cell.is_empty());
        let cells = cells.map(|(name, cell)| (name.to_owned(), Value::from(cell)));
        records.push((format!("line {line} of the index"), cells.collect()));
    }
    Ok(records)
}

fn read_json(path: &Path) -> anyhow::Result<Vec<Record>> {
    let records: Vec<Map<String, Value>> =
        serde_json::from_str(&std::fs::read_to_string(path)?).context("it must be a JSON array of objects")?;
    let numbered = records.into_iter().enumerate();
    Ok(numbered
        .map(|(i, r)| (format!("entry {i} of the index"), r.into_iter().filter(|(_, v)| !v.is_null()).collect()))
        .collect())
}

fn text_of(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

fn row(place: &str, mut record: Map<String, Value>) -> Result<Row, Refused> {
    let file = match record.get("file").map(text_of) {
        Some(file) => file,
        None => return Err(Refused { file: place.to_owned(), reason: "it names no file".to_owned() }),
    };
    let read = |record: &mut Map<String, Value>| -> Result<Row, String> {
        record.remove("file");
        let mut text = |name: &str| record.remove(name).map(|v| text_of(&v)).filter(|t| !t.is_empty());
        let subject = text("subject").ok_or("it names no subject")?;
        let number = integer("trial", text("trial"))?.ok_or("it has no trial number")?;
        if number < 1 {
            return Err(format!("trials are numbered from 1, and this is {number}"));
        }
        let session = integer("session", text("session"))?;
        let (group, plant) = (text("group"), text("plant"));
        let display_limit = match text("display_limit") {
            None => None,
            Some(t) => Some(t.parse().map_err(|_| format!("the display limit {t:?} is no number"))?),
        };
        let model = model(record)?;
        let extras = std::mem::take(record);
        Ok(Row { file: file.clone(), subject, number, session, group, plant, model, display_limit, extras })
    };
    read(&mut record).map_err(|reason| Refused { file: file.clone(), reason: format!("{place}: {reason}") })
}

fn integer(name: &str, text: Option<String>) -> Result<Option<i64>, String> {
    text.map(|t| t.parse().map_err(|_| format!("the {name} {t:?} is no whole number"))).transpose()
}

/// `plant_num`, `plant_den` and `plant_sample_time_s`, where they are lists and a number. In a CSV index these are
/// plain columns and stay what they are.
fn model(record: &mut Map<String, Value>) -> Result<Option<TransferFunctionModel>, String> {
    if !record.get("plant_num").is_some_and(Value::is_array) {
        return Ok(None);
    }
    let num = coefficients("plant_num", record.remove("plant_num"))?;
    let den = coefficients("plant_den", record.remove("plant_den"))?;
    let sample_time_s = match record.remove("plant_sample_time_s") {
        None => None,
        Some(v) => Some(v.as_f64().ok_or("plant_sample_time_s is no number")?),
    };
    Ok(Some(TransferFunctionModel { num, den, sample_time_s, delay_s: None }))
}

fn coefficients(name: &str, value: Option<Value>) -> Result<Vec<f64>, String> {
    let list = value.as_ref().and_then(Value::as_array).ok_or_else(|| format!("{name} is no list of numbers"))?;
    list.iter().map(|v| v.as_f64().ok_or_else(|| format!("{name} is no list of numbers"))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn index(name: &str, text: &str, conditions: &[Condition]) -> anyhow::Result<Index> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(name), text).unwrap();
        read(folder.path(), None, conditions)
    }

    #[test]
    fn a_table_with_extra_columns() {
        let text = "file,subject,trial,session,group,plant,hand\na.csv,S1,3,2,g,1/s,left\nb.csv,S1,x,,,,\n,S1,1,,,,\n";
        let index = index("index.csv", text, &[]).unwrap();
        let first = index.rows[0].as_ref().unwrap();
        assert_eq!((first.number, first.session, first.group.as_deref()), (3, Some(2), Some("g")));
        assert_eq!(first.extras.get("hand"), Some(&Value::from("left")));
        assert_eq!(index.extra_columns, ["hand"]);
        let second = index.rows[1].as_ref().unwrap_err();
        assert_eq!(second.file, "b.csv");
        assert!(second.reason.contains("line 3") && second.reason.contains("\"x\""), "{second:?}");
        assert!(index.rows[2].as_ref().unwrap_err().file.contains("line 4"));
    }

    #[test]
    fn an_array_with_plants_and_a_filter() {
        let text = r#"[{"file": "a.csv", "subject": "S1", "trial": 1, "study": "x",
                        "plant_num": [1], "plant_den": [1, 0]},
                       {"file": "b.csv", "subject": "S1", "trial": 0, "study": "x"},
                       {"file": "c.csv", "subject": "S1", "trial": 2, "study": "y"}]"#;
        let condition = "study=x".parse().unwrap();
        let found = index("truth.json", text, &[condition]).unwrap();
        assert_eq!((found.rows.len(), found.filtered), (2, 1));
        let model = found.rows[0].as_ref().unwrap().model.as_ref().unwrap();
        assert_eq!((model.num.as_slice(), model.den.as_slice()), ([1.0].as_slice(), [1.0, 0.0].as_slice()));
        assert!(found.rows[1].as_ref().unwrap_err().reason.contains("from 1"));
        let unknown = index("index.json", text, &["nothing=1".parse().unwrap()]).unwrap_err();
        assert!(unknown.to_string().contains("nothing"));
    }

    #[test]
    fn an_index_that_cannot_be_read_says_why() {
        assert!(index("other.csv", "", &[]).unwrap_err().to_string().contains("no index"));
        let missing = format!("{:#}", index("index.csv", "file,trial\na,1\n", &[]).unwrap_err());
        assert!(missing.contains("\"subject\""), "{missing}");
        assert!(format!("{:#}", index("index.csv", "file,file,subject,trial\n", &[]).unwrap_err()).contains("twice"));
        assert!(format!("{:#}", index("index.json", "{}", &[]).unwrap_err()).contains("array"));
    }
}
