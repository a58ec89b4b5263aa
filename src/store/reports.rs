//! Reports of finished analyses.

use super::error::{StoreError, StoreResult};
use super::nouns::Noun as _;
use super::open::Store;
use super::records::AnalysisRecord;
use super::rows::{get, sha256};
use crate::analysis::ids::AnalysisId;
use sqlx::sqlite::SqliteRow;

const NOUN: &str = AnalysisRecord::NAME;

/// The report's text, its hash verified.
pub(super) fn verified(row: &SqliteRow) -> StoreResult<Option<String>> {
    let Some(text) = get::<Option<String>>(row, "report")? else { return Ok(None) };
    let (found, stored) = (sha256(&text), get::<Option<String>>(row, "report_sha256")?);
    if stored.as_deref() != Some(&found) {
        let id: String = get(row, "id")?;
        let stored = stored.unwrap_or_default();
        return Err(StoreError::Damaged(format!("the report of {NOUN} {id} has the hash {found}, not {stored}")));
    }
    Ok(Some(text))
}

impl Store {
    /// The report's bytes exactly as the worker wrote them; `None` until it succeeded.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Damaged`], the database's own.
    pub async fn report_json(&self, id: AnalysisId) -> StoreResult<Option<String>> {
        let row = sqlx::query("SELECT id, report, report_sha256 FROM analyses WHERE id = $1")
            .bind(id.to_string())
            .fetch_optional(self.readers()?)
            .await?
            .ok_or_else(|| StoreError::not_found(NOUN, id))?;
        verified(&row)
    }
}
