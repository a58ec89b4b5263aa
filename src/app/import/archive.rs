//! An archive of a folder, unpacked for the time of an import.

use crate::app::bundle::said;
use crate::exchange::archive::{folder, is_folder};
use anyhow::{Context as _, bail};
use std::path::{Component, Path, PathBuf};

/// An archive unpacks to so many bytes at most.
const MAX_BYTES: u64 = 4 << 30;

/// A folder that is gone when it is dropped.
pub(super) struct Unpacked {
    root: PathBuf,
    /// Where the index is: the archive's own top, or the one folder in it.
    pub(super) folder: PathBuf,
}

impl Drop for Unpacked {
    fn drop(&mut self) {
        // What is left in the folder for temporary files is the system's to clear.
        let _ = std::fs::remove_dir_all(&self.root);
    }
}

/// The one folder that all of these paths are in, if there is one.
fn common<'a>(mut names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let first = names.next()?.split_once('/')?.0;
    names.all(|name| name.split_once('/').is_some_and(|(own, _)| own == first)).then_some(first)
}

/// Unpacks an archive of a folder; `None` where the path is none.
///
/// # Errors
/// Where it is damaged, too large, leads out of its own folder, or cannot be written.
pub(super) fn unpack(path: &Path) -> anyhow::Result<Option<Unpacked>> {
    if !path.is_file() {
        return Ok(None);
    }
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    if !is_folder(&bytes) {
        return Ok(None);
    }
    let files = folder(&bytes, MAX_BYTES).map_err(said)?;
    let root = std::env::temp_dir().join(format!("volition-import-{}", uuid::Uuid::new_v4()));
    let mut unpacked = Unpacked { folder: root.clone(), root };
    for (name, bytes) in &files {
        let own = Path::new(name);
        if name.contains('\\') || !own.components().all(|part| matches!(part, Component::Normal(_))) {
            bail!("{}: the file {name:?} lies outside of the archive's folder", path.display());
        }
        let target = unpacked.root.join(own);
        let place = target.parent().unwrap_or(&unpacked.root);
        std::fs::create_dir_all(place).with_context(|| format!("cannot make {}", place.display()))?;
        std::fs::write(&target, bytes).with_context(|| format!("cannot write {}", target.display()))?;
    }
    if let Some(top) = common(files.iter().map(|(name, _)| name.as_str())) {
        unpacked.folder = unpacked.root.join(top);
    }
    Ok(Some(unpacked))
}
