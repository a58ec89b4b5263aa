//! From rows to the words of the domain. What cannot be read back is damage, and says where.

use super::error::{StoreError, StoreResult};
use crate::num::hexadecimal::hexadecimal;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use sqlx::sqlite::SqliteRow;
use sqlx::{Decode, Row, Sqlite, Type};
use std::fmt::Display;
use std::str::FromStr;
use time::OffsetDateTime;

/// A column as it is.
pub(super) fn get<'r, T: Decode<'r, Sqlite> + Type<Sqlite>>(row: &'r SqliteRow, column: &str) -> StoreResult<T> {
    Ok(row.try_get(column)?)
}

/// A text column that parses, such as an id.
pub(super) fn parsed<T: FromStr<Err: Display>>(row: &SqliteRow, column: &str) -> StoreResult<T> {
    let text: String = get(row, column)?;
    text.parse().map_err(|error| StoreError::Damaged(format!("column {column} holds '{text}': {error}")))
}

/// A nullable text column that parses.
pub(super) fn parsed_opt<T: FromStr<Err: Display>>(row: &SqliteRow, column: &str) -> StoreResult<Option<T>> {
    match get::<Option<String>>(row, column)? {
        None => Ok(None),
        Some(_) => parsed(row, column).map(Some),
    }
}

/// A JSON column.
pub(super) fn json<T: DeserializeOwned>(row: &SqliteRow, column: &str) -> StoreResult<T> {
    let text: &str = row.try_get(column)?;
    serde_json::from_str(text).map_err(|error| StoreError::Damaged(format!("column {column} is no such JSON: {error}")))
}

/// A JSON column whose SHA-256 is in another column.
pub(super) fn json_verified<T: DeserializeOwned>(row: &SqliteRow, column: &str, sha256_column: &str) -> StoreResult<T> {
    let (text, stored): (&str, &str) = (row.try_get(column)?, row.try_get(sha256_column)?);
    let found = sha256(text);
    if found != stored {
        let id: String = get(row, "id")?;
        return Err(StoreError::Damaged(format!("the {column} of {id} has the hash {found}, not {stored}")));
    }
    json(row, column)
}

/// SHA-256 of a text, in hexadecimal.
pub(super) fn sha256(text: &str) -> String {
    hexadecimal(&Sha256::digest(text))
}

/// A nullable JSON column.
pub(super) fn json_opt<T: DeserializeOwned>(row: &SqliteRow, column: &str) -> StoreResult<Option<T>> {
    match get::<Option<&str>>(row, column)? {
        None => Ok(None),
        Some(_) => json(row, column).map(Some),
    }
}

/// A time column.
pub(super) fn time(row: &SqliteRow, column: &str) -> StoreResult<OffsetDateTime> {
    from_micros(get(row, column)?)
}

/// A nullable time column.
pub(super) fn time_opt(row: &SqliteRow, column: &str) -> StoreResult<Option<OffsetDateTime>> {
    get::<Option<i64>>(row, column)?.map(from_micros).transpose()
}

fn from_micros(micros: i64) -> StoreResult<OffsetDateTime> {
    OffsetDateTime::from_unix_timestamp_nanos(i128::from(micros) * 1000)
        .map_err(|error| StoreError::Damaged(format!("the time {micros} us: {error}")))
}

/// A column that cannot be negative.
pub(super) fn unsigned(row: &SqliteRow, column: &str) -> StoreResult<u64> {
    let value: i64 = get(row, column)?;
    u64::try_from(value).map_err(|_| StoreError::Damaged(format!("column {column} is {value}")))
}

/// A count as the database holds it. Counts beyond 2^63 do not occur; they are held at the end of the range.
pub(super) fn signed(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// A value that always has a JSON form, as text.
pub(super) fn to_json(value: &impl serde::Serialize) -> StoreResult<String> {
    serde_json::to_string(value).map_err(|error| sqlx::Error::Encode(Box::new(error)).into())
}
