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
    /// There is no room: the disk is full, and what is left is kept for deleting and cancelling.
    #[error("the disk is full: {0}")]
    Full(String),
    /// The file that was opened is not at its place any more, or another one is.
    #[error("the database file '{path}' {what}")]
    Moved {
        /// Where it was.
        path: String,
        /// What is found there.
        what: &'static str,
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

/// Why a database fails that may work again without anybody's touching this program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trouble {
    /// It is locked, or no connection was free.
    Busy,
    /// The disk is full.
    Full,
    /// The disk fails, is read-only, or the file is gone.
    Unusable,
}

impl StoreError {
    /// What is wrong with the database for the time being; `None` where nothing is, or where it stays wrong.
    #[must_use]
    pub fn trouble(&self) -> Option<Trouble> {
        let error = match self {
            Self::Full(_) => return Some(Trouble::Full),
            Self::Moved { .. } => return Some(Trouble::Unusable),
            Self::Database(error) => error,
            _ => return None,
        };
        match error {
            sqlx::Error::PoolTimedOut => Some(Trouble::Busy),
            sqlx::Error::Io(error) if is_no_room(error) => Some(Trouble::Full),
            sqlx::Error::Io(_) => Some(Trouble::Unusable),
            sqlx::Error::Database(error) => match primary_code(error.as_ref()) {
                // SQLite's primary result codes: BUSY and LOCKED, FULL, then READONLY, IOERR and CANTOPEN.
                Some(5 | 6) => Some(Trouble::Busy),
                Some(13) => Some(Trouble::Full),
                Some(8 | 10 | 14) => Some(Trouble::Unusable),
                _ => None,
            },
            _ => None,
        }
    }

    /// Whether the same call may succeed a little later.
    #[must_use]
    pub(crate) fn is_transient(&self) -> bool {
        self.trouble().is_some()
    }

    pub(super) fn not_found(noun: &'static str, id: impl ToString) -> Self {
        Self::NotFound { noun, id: id.to_string() }
    }
}

/// Whether a file could not be written because there was no room for it.
pub(super) fn is_no_room(error: &std::io::Error) -> bool {
    matches!(error.kind(), std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded)
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
