//! A copy of a database at one moment, whole or not there.

use super::blocking::off_runtime;
use super::error::{StoreError, StoreResult};
use super::place::{beside, create_private};
use sqlx::SqliteConnection;
use std::path::Path;
use uuid::Uuid;

/// A copy of a database under a name that nothing has yet: whole, or not there.
pub(super) async fn copy_into(connection: &mut SqliteConnection, copy: &Path) -> StoreResult<()> {
    let part = beside(copy, &format!(".{}.part", Uuid::new_v4()));
    let written = async {
        vacuum_into(connection, &part).await?;
        let (from, to) = (part.clone(), copy.to_owned());
        off_runtime(move || settle(&from, &to).map_err(failed)).await
    }
    .await;
    if written.is_err() {
        forget(&part);
    }
    written
}

/// Copies the database into a new file that only its owner can read.
pub(super) async fn vacuum_into(connection: &mut SqliteConnection, part: &Path) -> StoreResult<()> {
    // An empty file of ours, since SQLite would make one that everybody can read.
    drop(create_private(part).map_err(failed)?);
    let name = part.to_str().ok_or_else(|| StoreError::CannotOpen {
        path: part.display().to_string(),
        reason: "its name is not text".to_owned(),
    })?;
    sqlx::query("VACUUM INTO $1").bind(name).execute(connection).await?;
    Ok(())
}

/// What went wrong with a file.
pub(super) fn failed(error: std::io::Error) -> StoreError {
    sqlx::Error::Io(error).into()
}

/// Gives a file that is safe on disk its name.
pub(super) fn settle(part: &Path, name: &Path) -> std::io::Result<()> {
    std::fs::File::open(part)?.sync_all()?;
    std::fs::rename(part, name)?;
    match name.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        Some(parent) => std::fs::File::open(parent)?.sync_all(),
        None => std::fs::File::open(".")?.sync_all(),
    }
}

/// Removes what is left of a copy that was not finished.
pub(super) fn forget(part: &Path) {
    for ending in ["", "-journal", "-wal", "-shm"] {
        let _ = std::fs::remove_file(beside(part, ending));
    }
}
