//! Requests that were made before.

use super::error::{StoreError, StoreResult};
use super::records::IdempotencyKey;
use super::rows::{sha256, to_json};
use sqlx::SqliteConnection;

/// The ids that this request made when it came first; `None` where it is new.
pub(super) async fn replay(
    connection: &mut SqliteConnection,
    scope: &str,
    key: Option<&IdempotencyKey>,
) -> StoreResult<Option<Vec<String>>> {
    let Some(key) = key else { return Ok(None) };
    let found: Option<(String, String)> =
        sqlx::query_as("SELECT request_sha256, result_ids FROM idempotency_keys WHERE scope = $1 AND key_sha256 = $2")
            .bind(scope)
            .bind(sha256(&key.key))
            .fetch_optional(connection)
            .await?;
    match found {
        None => Ok(None),
        Some((request, _)) if request != key.request_sha256 => Err(StoreError::KeyReused),
        Some((_, ids)) => serde_json::from_str(&ids)
            .map(Some)
            .map_err(|error| StoreError::Damaged(format!("the results of an idempotency key: {error}"))),
    }
}

/// Notes what a request made, in the transaction that made it.
pub(super) async fn remember(
    connection: &mut SqliteConnection,
    scope: &str,
    key: Option<&IdempotencyKey>,
    ids: &[String],
    now: i64,
) -> StoreResult<()> {
    let Some(key) = key else { return Ok(()) };
    sqlx::query(
        "INSERT INTO idempotency_keys (scope, key_sha256, request_sha256, result_ids, created_at)
         VALUES ($1, $2, $3, $4, $5)",
    )
    .bind(scope)
    .bind(sha256(&key.key))
    .bind(&key.request_sha256)
    .bind(to_json(&ids)?)
    .bind(now)
    .execute(connection)
    .await?;
    Ok(())
}

/// What a repeated request made first is not there any more.
pub(super) fn or_deleted<T>(outcome: StoreResult<T>) -> StoreResult<T> {
    outcome.map_err(|error| match error {
        StoreError::NotFound { noun, id } => StoreError::Conflict {
            rule: "idempotent_result_deleted",
            detail: format!("this request was made before; the {noun} {id} that it made was deleted since"),
        },
        other => other,
    })
}
