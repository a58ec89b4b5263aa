//! Copies of the database while it is used, proven to be whole.
//!
//! `VACUUM INTO` writes the state of one moment; writers go on meanwhile. The copy holds no stale pages, so that what
//! was deleted is in no copy made afterwards. It is made under another name, checked, and given its name when it is
//! safe on disk; its manifest says what it holds.

use super::blocking::off_runtime;
use super::copy::{failed, forget, settle, vacuum_into};
use super::error::{StoreError, StoreResult, Trouble};
use super::open::Store;
use super::place::{beside, create_private};
use super::verify::{Verified, verify_file};
use crate::num::hexadecimal::hexadecimal;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;
use uuid::Uuid;

/// How the names of backups begin.
const PREFIX: &str = "volition-";

/// Version of the manifest's layout.
const LAYOUT: u32 = 1;

/// Bytes hashed at once.
const CHUNK: usize = 1 << 20;

/// What a backup holds, written beside it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of this layout.
    pub layout: u32,
    /// Counts the backups of a folder, from 1: which is newer, whatever the clock said.
    pub number: u64,
    /// The file's name, in the manifest's own folder.
    pub file: String,
    /// Its size in bytes.
    pub bytes: u64,
    /// SHA-256 of its content, in hexadecimal.
    pub sha256: String,
    /// The last step of its schema.
    pub schema_step: i64,
    /// When it was made.
    pub made_at: String,
    /// Version of the program that made it.
    pub program: String,
    /// Rows of each sort.
    pub rows: BTreeMap<String, u64>,
    /// Rows that were damaged in the database already, and why.
    pub damaged: Vec<String>,
}

impl Manifest {
    /// A file's size in bytes, and SHA-256 of its content in hexadecimal.
    ///
    /// # Errors
    /// The file system's.
    pub fn measure(file: &Path) -> std::io::Result<(u64, String)> {
        sha256_of(file)
    }
}

fn sha256_of(file: &Path) -> std::io::Result<(u64, String)> {
    let mut reader = std::fs::File::open(file)?;
    let mut hasher = Sha256::new();
    let mut chunk = vec![0; CHUNK];
    let mut bytes = 0;
    loop {
        let many = reader.read(&mut chunk)?;
        if many == 0 {
            return Ok((bytes, hexadecimal(&hasher.finalize())));
        }
        hasher.update(&chunk[..many]);
        bytes += many as u64;
    }
}

/// The manifests of a folder, by number. What is no manifest is passed over.
fn manifests(folder: &Path) -> std::io::Result<Vec<(Manifest, PathBuf)>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name.starts_with(PREFIX)
            && let Some(file) = name.strip_suffix(".json")
            && let Ok(text) = std::fs::read(&path)
            && let Ok(manifest) = serde_json::from_slice::<Manifest>(&text)
            && manifest.file == file
        {
            found.push((manifest, path));
        }
    }
    found.sort_by_key(|(manifest, _)| manifest.number);
    Ok(found)
}

fn write_manifest(manifest: &Manifest, folder: &Path) -> std::io::Result<()> {
    let path = folder.join(format!("{}.json", manifest.file));
    let part = beside(&path, ".part");
    let _ = std::fs::remove_file(&part);
    let mut file = create_private(&part)?;
    file.write_all(&serde_json::to_vec_pretty(manifest)?)?;
    drop(file);
    settle(&part, &path)
}

impl Store {
    /// Copies the database as it is at one moment into a folder, which is made if it does not exist; checks the copy
    /// (its pages, its references, every hash in it), and writes a manifest beside it. Others go on to read and write.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] where the copy's pages or references are not in order, [`StoreError::Full`] where
    /// there is no room for it, the database's own. Nothing is left in the folder then. Rows that were damaged before
    /// are copied as they are, and named in the manifest.
    pub async fn backup(&self, folder: &Path) -> StoreResult<Manifest> {
        let (store, folder) = (self.clone(), folder.to_owned());
        // A task of its own, so that a copy that nobody waits for any more leaves nothing half-way.
        match tokio::spawn(async move { store.write_backup(&folder).await }).await {
            Ok(outcome) => outcome,
            Err(error) if error.is_panic() => std::panic::resume_unwind(error.into_panic()),
            Err(_) => Err(sqlx::Error::PoolClosed.into()),
        }
    }

    async fn write_backup(&self, folder: &Path) -> StoreResult<Manifest> {
        let made = folder.to_owned();
        let last =
            off_runtime(move || std::fs::create_dir_all(&made).and_then(|()| manifests(&made)).map_err(failed)).await?;
        let number = last.last().map_or(1, |(manifest, _)| manifest.number + 1);
        let now = self.now();
        let part = folder.join(format!("{PREFIX}{}.part", Uuid::new_v4()));
        let outcome = self.copied(folder, &part, number, now).await;
        if outcome.is_err() {
            forget(&part);
        }
        outcome.map_err(|error| match error.trouble() {
            Some(Trouble::Full) => StoreError::Full(format!("the copy does not fit into '{}'", folder.display())),
            _ => error,
        })
    }

    async fn copied(&self, folder: &Path, part: &Path, number: u64, now: OffsetDateTime) -> StoreResult<Manifest> {
        vacuum_into(&mut self.connection_of_its_own().await?, part).await?;
        let Verified { step, rows, pages, references, findings } = verify_file(part).await?;
        if let Some(why) = pages.first().or(references.first()) {
            return Err(StoreError::Damaged(format!("the copy is not in order: {why}")));
        }
        let made_at = now.format(&Rfc3339).map_err(|error| StoreError::Damaged(error.to_string()))?;
        let stamp: String = made_at.chars().take(19).filter(|c| !matches!(c, '-' | ':')).collect();
        let file = format!("{PREFIX}{number:06}-{stamp}Z.db");
        let (folder, part) = (folder.to_owned(), part.to_owned());
        off_runtime(move || {
            let (bytes, sha256) = sha256_of(&part).map_err(failed)?;
            let manifest = Manifest {
                layout: LAYOUT,
                number,
                bytes,
                sha256,
                schema_step: step,
                made_at,
                program: env!("CARGO_PKG_VERSION").to_owned(),
                rows,
                damaged: findings.iter().map(ToString::to_string).collect(),
                file,
            };
            settle(&part, &folder.join(&manifest.file))
                .and_then(|()| write_manifest(&manifest, &folder))
                .map_err(failed)?;
            Ok(manifest)
        })
        .await
    }

    /// How long ago the newest backup of a folder was made; `None` where there is none, or where the clock has been set
    /// back since.
    #[must_use]
    pub fn age_of_newest_backup(&self, folder: &Path) -> Option<std::time::Duration> {
        let (newest, _) = manifests(folder).ok()?.pop()?;
        let made_at = OffsetDateTime::parse(&newest.made_at, &Rfc3339).ok()?;
        (self.now() - made_at).try_into().ok()
    }

    /// Deletes all but the newest `keep` backups of a folder, with their manifests; returns their names. Other files
    /// are left alone.
    ///
    /// # Errors
    /// The file system's.
    pub async fn retain_backups(folder: &Path, keep: usize) -> StoreResult<Vec<String>> {
        let folder = folder.to_owned();
        off_runtime(move || {
            let all = manifests(&folder).map_err(failed)?;
            let many = all.len().saturating_sub(keep.max(1));
            let mut gone = Vec::with_capacity(many);
            for (manifest, path) in all.into_iter().take(many) {
                match std::fs::remove_file(folder.join(&manifest.file)) {
                    Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(failed(error)),
                    _ => {}
                }
                std::fs::remove_file(path).map_err(failed)?;
                gone.push(manifest.file);
            }
            Ok(gone)
        })
        .await
    }
}
