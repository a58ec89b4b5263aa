//! Lists: which rows, in the words of the database, and a page of them.

use super::error::{StoreError, StoreResult};
use super::nouns::Noun;
use super::open::Store;
use super::records::Page;
use sqlx::sqlite::SqliteRow;
use sqlx::{AssertSqlSafe, Row as _, SqliteConnection};

/// What a column is compared with.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value {
    Text(String),
    Integer(i64),
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<i64> for Value {
    fn from(number: i64) -> Self {
        Self::Integer(number)
    }
}

/// Conditions that rows must meet. Only those that are asked for stand in the statement: one that says "or nothing is
/// asked for" keeps the database from using an index.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Filter {
    conditions: Vec<&'static str>,
    values: Vec<Value>,
}

impl Filter {
    /// With a condition on a value, which stands in it as `?`; without one where there is no value.
    pub(super) fn and(mut self, condition: &'static str, value: Option<impl Into<Value>>) -> Self {
        if let Some(value) = value {
            self.conditions.push(condition);
            self.values.push(value.into());
        }
        self
    }

    /// With a condition as it stands.
    pub(super) fn plain(mut self, condition: &'static str) -> Self {
        self.conditions.push(condition);
        self
    }

    /// The rows of `N` that meet the conditions, and then `rest`.
    pub(super) fn select<N: Noun>(&self, more: &[&str], rest: &str) -> String {
        self.of(N::SELECT, more, rest)
    }

    /// What `select` selects of the rows that meet the conditions, and then `rest`.
    pub(super) fn of(&self, select: &str, more: &[&str], rest: &str) -> String {
        let conditions: Vec<&str> = self.conditions.iter().copied().chain(more.iter().copied()).collect();
        let conditions = if conditions.is_empty() { "TRUE".to_owned() } else { conditions.join(" AND ") };
        format!("{select} WHERE {conditions} {rest}")
    }

    /// The statement of one page.
    pub(super) fn page<N: Noun>(&self) -> String {
        self.select::<N>(&["n.id > ?"], "ORDER BY n.id LIMIT ?")
    }

    /// The rows of a statement that this filter wrote, with what stands in it beyond the conditions.
    pub(super) async fn rows(
        &self,
        connection: &mut SqliteConnection,
        sql: String,
        more: &[Value],
    ) -> StoreResult<Vec<SqliteRow>> {
        let mut query = sqlx::query(AssertSqlSafe(sql));
        for value in self.values.iter().chain(more) {
            query = match value {
                Value::Text(text) => query.bind(text.clone()),
                Value::Integer(number) => query.bind(*number),
            };
        }
        Ok(query.fetch_all(connection).await?)
    }
}

impl Store {
    /// The thing that a row holds; `None` where it is damaged, which is noted.
    pub(super) fn sound<N: Noun>(&self, row: &SqliteRow) -> StoreResult<Option<N>> {
        match N::from_row(row) {
            Ok(thing) => Ok(Some(thing)),
            Err(StoreError::Damaged(why)) => {
                let id: String = row.try_get("id").unwrap_or_else(|_| "without an id".to_owned());
                self.inner().damage.note(N::NAME, &id, &why);
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// How many rows are damaged, as far as is known: met by this process, or found by the last verification.
    ///
    /// # Errors
    /// The database's own.
    pub async fn count_damaged(&self) -> StoreResult<u64> {
        let found: Vec<(String, String)> =
            sqlx::query_as("SELECT noun, row_id FROM quarantine").fetch_all(self.readers()?).await?;
        let mut all = self.inner().damage.met();
        all.extend(found);
        Ok(all.len() as u64)
    }

    /// A page of the rows that meet the conditions, in the order in which they were made. A damaged row is left out,
    /// and the page filled from the rows behind it: one that is shorter than asked for is the last.
    pub(super) async fn page_of<N: Noun>(
        &self,
        connection: &mut SqliteConnection,
        filter: &Filter,
        page: Page,
    ) -> StoreResult<Vec<N>> {
        let wanted = page.limit as usize;
        let mut found = Vec::new();
        let mut after = page.after_id();
        loop {
            let left = wanted - found.len();
            let more = [Value::Text(after.clone()), Value::Integer(i64::try_from(left).unwrap_or(i64::MAX))];
            let rows = filter.rows(connection, filter.page::<N>(), &more).await?;
            for row in &rows {
                found.extend(self.sound::<N>(row)?);
            }
            match rows.last() {
                Some(last) if rows.len() == left && found.len() < wanted => after = last.try_get("id")?,
                _ => return Ok(found),
            }
        }
    }
}
