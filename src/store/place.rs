//! Where the file is, and whether it still is the one that was opened.

use super::error::{StoreError, StoreResult};
use std::path::{Path, PathBuf};

/// The file of an open database.
#[derive(Debug)]
pub(super) struct Place {
    file: PathBuf,
    identity: Option<Identity>,
}

/// What tells a file from another of the same name.
type Identity = (u64, u64);

impl Place {
    /// The place of a file that was just opened.
    pub(super) fn of(file: &Path) -> Self {
        Self { file: file.to_owned(), identity: std::fs::metadata(file).ok().and_then(|found| identity(&found)) }
    }

    pub(super) fn file(&self) -> &Path {
        &self.file
    }

    /// Refuses to go on with a file that is deleted, or that another one took the place of: SQLite would write into
    /// what nobody finds again, and say that all is well. Works again as soon as the file is back.
    pub(super) fn unmoved(&self) -> StoreResult<()> {
        let moved = |what| StoreError::Moved { path: self.file.display().to_string(), what };
        match std::fs::metadata(&self.file) {
            Ok(found) if identity(&found) == self.identity => Ok(()),
            Ok(_) => Err(moved("was replaced by another file; put it back, or restart the program")),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Err(moved("is gone; put it back")),
            Err(_) => Err(moved("cannot be reached")),
        }
    }
}

#[cfg(unix)]
fn identity(found: &std::fs::Metadata) -> Option<Identity> {
    use std::os::unix::fs::MetadataExt as _;
    Some((found.dev(), found.ino()))
}

#[cfg(not(unix))]
fn identity(_: &std::fs::Metadata) -> Option<Identity> {
    None
}

/// Refuses what SQLite would report badly or not at all, and creates the file so that only its owner can read it.
pub(super) fn check_file(file: &Path) -> StoreResult<()> {
    let cannot = |reason: String| StoreError::CannotOpen { path: file.display().to_string(), reason };
    match std::fs::metadata(file) {
        Ok(metadata) if metadata.is_dir() => Err(cannot("it is a directory; name a file".to_owned())),
        Ok(metadata) if !metadata.is_file() => Err(cannot("it is not a regular file".to_owned())),
        // Not opened here: closing it again would drop the locks that SQLite may hold on it in this process (POSIX
        // locks belong to process and file, not to the handle).
        Ok(_) => Ok(()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => match create_private(file) {
            Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
                Err(cannot(format!("it cannot be created: {error}")))
            }
            // Created by another process at the same moment is as good.
            _ => Ok(()),
        },
        Err(error) => Err(cannot(error.to_string())),
    }
}

/// A new file that only its owner can read.
pub(super) fn create_private(file: &Path) -> std::io::Result<std::fs::File> {
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(file)
}

/// A file's name with something after it: `lab.db.reserve` beside `lab.db`.
pub(super) fn beside(file: &Path, ending: &str) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(ending);
    PathBuf::from(name)
}

/// A directory of our own, removed when dropped.
#[derive(Debug)]
pub(super) struct TemporaryDirectory(pub(super) PathBuf);

impl TemporaryDirectory {
    pub(super) fn create() -> StoreResult<Self> {
        let path = std::env::temp_dir().join(format!("volition-{}", uuid::Uuid::now_v7()));
        let mut builder = std::fs::DirBuilder::new();
        #[cfg(unix)]
        std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
        builder.create(&path).map_err(|error| StoreError::CannotOpen {
            path: path.display().to_string(),
            reason: format!("the temporary directory cannot be created: {error}"),
        })?;
        Ok(Self(path))
    }
}

impl Drop for TemporaryDirectory {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.0) {
            tracing::warn!(path = %self.0.display(), %error, "a temporary database was left behind");
        }
    }
}
