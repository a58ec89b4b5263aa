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

    /// The statement of a page after a row.
    pub(super) fn page<N: Noun>(&self, order: Order) -> String {
        self.select::<N>(&[&order.after::<N>()], &order.clause())
    }

    /// The statement of the first page.
    fn first_page<N: Noun>(&self, order: Order) -> String {
        self.select::<N>(&[], &order.clause())
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

/// In which order a list comes: by expressions of a row, and by its id where these are equal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Order {
    /// Expressions of the row under the alias `n`, none of them ever null.
    pub(super) keys: &'static [&'static str],
    /// From the greatest to the least.
    pub(super) descending: bool,
}

impl Order {
    /// In the order in which the rows were made.
    pub(super) const CREATED: Self = Self { keys: &[], descending: false };

    /// The keys with the id.
    fn all(self) -> Vec<&'static str> {
        self.keys.iter().copied().chain(["n.id"]).collect()
    }

    /// The condition that a row comes after the one whose id is bound. What that row's keys are is read from the row
    /// itself, so that a cursor needs to name nothing but the row.
    fn after<N: Noun>(self) -> String {
        let than = if self.descending { '<' } else { '>' };
        if self.keys.is_empty() {
            return format!("n.id {than} ?");
        }
        let keys = self.all().join(", ");
        format!("({keys}) {than} (SELECT {keys} FROM {} n WHERE n.id = ?)", N::TABLE)
    }

    fn clause(self) -> String {
        let way = if self.descending { " DESC" } else { "" };
        let keys: Vec<String> = self.all().into_iter().map(|key| format!("{key}{way}")).collect();
        format!("ORDER BY {} LIMIT ?", keys.join(", "))
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

    /// A page of the rows that meet the conditions, in the order in which they were made.
    pub(super) async fn page_of<N: Noun>(
        &self,
        connection: &mut SqliteConnection,
        filter: &Filter,
        page: Page,
    ) -> StoreResult<Vec<N>> {
        self.sorted_page(connection, filter, Order::CREATED, page).await
    }

    /// A page of the rows that meet the conditions, in an order. A damaged row is left out, and the page filled from
    /// the rows behind it: one that is shorter than asked for is the last.
    pub(super) async fn sorted_page<N: Noun>(
        &self,
        connection: &mut SqliteConnection,
        filter: &Filter,
        order: Order,
        page: Page,
    ) -> StoreResult<Vec<N>> {
        let wanted = page.limit as usize;
        let mut found = Vec::new();
        let mut after = page.after.map(|id| id.to_string());
        if let Some(row) = after.as_deref().filter(|_| !order.keys.is_empty()) {
            still_there::<N>(connection, row).await?;
        }
        loop {
            let left = wanted - found.len();
            let most = Value::Integer(i64::try_from(left).unwrap_or(i64::MAX));
            let rows = match after.take() {
                Some(row) => filter.rows(connection, filter.page::<N>(order), &[Value::Text(row), most]).await?,
                None => filter.rows(connection, filter.first_page::<N>(order), &[most]).await?,
            };
            for row in &rows {
                found.extend(self.sound::<N>(row)?);
            }
            match rows.last() {
                Some(last) if rows.len() == left && found.len() < wanted => after = Some(last.try_get("id")?),
                _ => return Ok(found),
            }
        }
    }
}

/// Where the last row of the page before is gone, nobody knows where the list goes on.
async fn still_there<N: Noun>(connection: &mut SqliteConnection, id: &str) -> StoreResult<()> {
    let exists = AssertSqlSafe(format!("SELECT 1 FROM {} WHERE id = $1", N::TABLE));
    let found: Option<i64> = sqlx::query_scalar(exists).bind(id).fetch_optional(connection).await?;
    found.map(drop).ok_or_else(|| StoreError::Conflict {
        rule: "cursor_gone",
        detail: format!("the {} that ended the page before was deleted; start the list again", N::NAME),
    })
}
