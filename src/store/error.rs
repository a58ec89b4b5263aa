//! Why the store could not do what was asked.

/// Why the store could not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// There is no such thing.
    #[error("there is no {noun} {id}")]
    NotFound {
        /// The sort of thing.
        noun: &'static str,
        /// Its id.
        id: String,
    },
    /// It contradicts something stored: a code or number already taken, a plant still in use.
    #[error("{detail}")]
    Conflict {
        /// A stable name of the rule broken, such as `subject_code_taken`.
        rule: &'static str,
        /// In words, with the values.
        detail: String,
    },
    /// `If-Match` named another version than the stored one.
    #[error("the {noun} changed since it was read")]
    Stale {
        /// The sort of thing.
        noun: &'static str,
    },
    /// An idempotency key was used before for a different request.
    #[error("the idempotency key was used before for a different request")]
    KeyReused,
    /// Stored bytes do not match their checksum.
    #[error("stored data is damaged: {0}")]
    Damaged(String),
    /// The database file cannot be used.
    #[error("cannot use '{path}' as a database: {reason}")]
    CannotOpen {
        /// The file.
        path: String,
        /// Why not, in words.
        reason: String,
    },
    /// The database failed.
    #[error("the database failed: {0}")]
    Database(#[from] sqlx::Error),
    /// The schema could not be brought up to date.
    #[error("the database schema could not be migrated: {0}")]
    Migration(#[from] sqlx::migrate::MigrateError),
}

/// Result of the store.
pub type StoreResult<T> = Result<T, StoreError>;

impl StoreError {
    /// Whether the same call may succeed a little later: the file was locked, the disk was full, no connection was
    /// free.
    #[must_use]
    pub(crate) fn is_transient(&self) -> bool {
        let Self::Database(error) = self else { return false };
        match error {
            sqlx::Error::PoolTimedOut | sqlx::Error::Io(_) => true,
            // SQLite's primary result codes: BUSY, LOCKED, IOERR, FULL.
            sqlx::Error::Database(error) => matches!(primary_code(error.as_ref()), Some(5 | 6 | 10 | 13)),
            _ => false,
        }
    }

    pub(super) fn not_found(noun: &'static str, id: impl ToString) -> Self {
        Self::NotFound { noun, id: id.to_string() }
    }
}

/// SQLite's primary result code: the low byte of the extended one.
pub(super) fn primary_code(error: &dyn sqlx::error::DatabaseError) -> Option<u32> {
    error.code()?.parse::<u32>().ok().map(|code| code & 0xff)
}

/// Whether an insert or update failed because a unique index over `columns` (as SQLite lists them) holds the value
/// already.
pub(super) fn breaks_unique(error: &sqlx::Error, columns: &[&str]) -> bool {
    let Some(error) = error.as_database_error() else { return false };
    error.is_unique_violation() && columns.iter().any(|list| error.message().ends_with(list))
}
