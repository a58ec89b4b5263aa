//! A study in one archive, with the hash of every file and of the archive itself.
//!
//! ```text
//! files ─► zip, in the order given, under one fixed time ─► manifest.json (name, length, SHA-256 of each) ─► seal
//! ```
//! The seal is the archive's comment: SHA-256 of every byte before it. So a bit that flips anywhere is found, and the
//! manifest says in which file. The same files give the same bytes.

use super::write::zip as archive;
use crate::analysis::{Code, Problem};
use crate::num::hexadecimal::hexadecimal;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom, Write};
use zip::{ZipArchive, ZipWriter};

/// The name and version of the form.
const FORMAT: &str = "volition.bundle/1";

/// The file that lists the others.
const MANIFEST: &str = "manifest.json";

/// What the seal begins with.
const SEAL: &str = "volition.bundle/1 sha256:";

/// Digits of the seal.
const DIGITS: usize = 64;

/// One file of a bundle unpacks to so many bytes at most.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// Bytes hashed at once.
const CHUNK: usize = 1 << 16;

/// A file as the manifest lists it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Listed {
    name: String,
    bytes: u64,
    sha256: String,
}

/// What `manifest.json` says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    format: String,
    files: Vec<Listed>,
}

fn sha256(bytes: &[u8]) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

/// A bundle that is being written.
pub struct BundleWriter<W: Write + Seek> {
    zip: ZipWriter<W>,
    files: Vec<Listed>,
}

fn unwritable(error: impl std::fmt::Display) -> Problem {
    Problem::new(Code::Internal, "the bundle cannot be written", error.to_string())
        .mend("See whether the disk is full, or write it elsewhere.")
}

impl<W: Read + Write + Seek> BundleWriter<W> {
    /// A bundle without files.
    #[must_use]
    pub fn new(out: W) -> Self {
        Self { zip: ZipWriter::new(out), files: Vec::new() }
    }

    /// Adds a file; names are given once.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn add(&mut self, name: &str, bytes: &[u8]) -> Result<(), Problem> {
        archive::add(&mut self.zip, name, bytes).map_err(unwritable)?;
        self.files.push(Listed { name: name.to_owned(), bytes: bytes.len() as u64, sha256: sha256(bytes) });
        Ok(())
    }

    /// Writes the manifest and the seal.
    ///
    /// # Errors
    /// Where they cannot be written.
    pub fn finish(mut self) -> Result<W, Problem> {
        let manifest = Manifest { format: FORMAT.to_owned(), files: std::mem::take(&mut self.files) };
        let mut text = serde_json::to_vec_pretty(&manifest).map_err(unwritable)?;
        text.push(b'\n');
        archive::add(&mut self.zip, MANIFEST, &text).map_err(unwritable)?;
        // The comment is the last thing in an archive: its digits are filled in when everything before them is known.
        self.zip
            .set_raw_comment(format!("{SEAL}{}", "0".repeat(DIGITS)).into_bytes().into_boxed_slice())
            .map_err(unwritable)?;
        let mut out = self.zip.finish().map_err(unwritable)?;
        let digits = digest_before_digits(&mut out).map_err(unwritable)?.0;
        out.seek(SeekFrom::End(-(DIGITS as i64))).map_err(unwritable)?;
        out.write_all(digits.as_bytes()).and_then(|()| out.flush()).map_err(unwritable)?;
        Ok(out)
    }
}

/// SHA-256 of all bytes but the last so many digits, and those.
fn digest_before_digits<R: Read + Seek>(file: &mut R) -> std::io::Result<(String, Vec<u8>)> {
    let length = file.seek(SeekFrom::End(0))?;
    let mut left = length.saturating_sub(DIGITS as u64);
    file.seek(SeekFrom::Start(0))?;
    let mut hasher = Sha256::new();
    let mut chunk = vec![0; CHUNK];
    while left > 0 {
        let wanted = usize::try_from(left.min(CHUNK as u64)).unwrap_or(CHUNK);
        file.read_exact(&mut chunk[..wanted])?;
        hasher.update(&chunk[..wanted]);
        left -= wanted as u64;
    }
    let mut last = Vec::new();
    file.take(DIGITS as u64).read_to_end(&mut last)?;
    Ok((hexadecimal(&hasher.finalize()), last))
}

/// A bundle whose seal and manifest hold.
pub struct Bundle<R: Read + Seek> {
    zip: ZipArchive<R>,
    files: BTreeMap<String, Listed>,
}

fn damaged(why: impl Into<String>) -> Problem {
    Problem::new(Code::Malformed, "damaged bundle", why)
        .mend("Copy it again from where it was written, or export the study anew; nothing of it was taken in.")
}

/// Unpacks a file of an archive.
fn unpack<R: Read + Seek>(zip: &mut ZipArchive<R>, name: &str) -> Result<Vec<u8>, Problem> {
    let whole = |error: &dyn std::fmt::Display| damaged(format!("it cannot be unpacked: {error}")).at(name.to_owned());
    let file = zip.by_name(name).map_err(|error| whole(&error))?;
    let mut bytes = Vec::new();
    file.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(|error| whole(&error))?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        let why = format!("it unpacks to more than {MAX_FILE_BYTES} bytes");
        return Err(Problem::new(Code::TooLarge, "too many bytes", why).at(name.to_owned()));
    }
    Ok(bytes)
}

fn manifest<R: Read + Seek>(zip: &mut ZipArchive<R>) -> Result<Manifest, Problem> {
    let bytes = unpack(zip, MANIFEST)?;
    let manifest: Manifest =
        serde_json::from_slice(&bytes).map_err(|error| damaged(error.to_string()).at(MANIFEST.to_owned()))?;
    if manifest.format != FORMAT {
        let why = format!("it is of the form {}, and this program reads {FORMAT}", manifest.format);
        return Err(Problem::new(Code::Malformed, "a bundle of another form", why)
            .at(MANIFEST)
            .mend("Read it with the version of the program that wrote it, or with a newer one."));
    }
    Ok(manifest)
}

/// Whether what is read is an archive with a manifest of ours: an import tells it from a folder of recordings.
pub fn is_one<R: Read + Seek>(file: R) -> bool {
    ZipArchive::new(file)
        .is_ok_and(|zip| zip.comment().starts_with(SEAL.as_bytes()) || zip.index_for_name(MANIFEST).is_some())
}

impl<R: Read + Seek> Bundle<R> {
    /// Opens a bundle, and verifies its seal and every file that it lists.
    ///
    /// # Errors
    /// `malformed`, with the name of the file that is not what was written, where there is one.
    pub fn open(mut file: R) -> Result<Self, Problem> {
        let (found, stored) = digest_before_digits(&mut file).map_err(|error| damaged(error.to_string()))?;
        let stored = String::from_utf8_lossy(&stored).into_owned();
        let sealed = found == stored;
        let mut zip = ZipArchive::new(file).map_err(|error| damaged(format!("it is no whole archive: {error}")))?;
        let manifest = manifest(&mut zip)?;
        let mut files = BTreeMap::new();
        for listed in manifest.files {
            let bytes = unpack(&mut zip, &listed.name)?;
            let own = sha256(&bytes);
            if own != listed.sha256 || bytes.len() as u64 != listed.bytes {
                let why =
                    format!("its {} bytes have the hash {own}, and the manifest says {}", bytes.len(), listed.sha256);
                return Err(damaged(why).at(listed.name));
            }
            files.insert(listed.name.clone(), listed);
        }
        if !sealed {
            let why = format!(
                "every file is as the manifest says, but not what lies around them: the archive has the hash {found}, \
                 and its seal says {stored}"
            );
            return Err(damaged(why).at("the archive's own lists"));
        }
        let mut names =
            zip.file_names().map(|name| name.map_or_else(|_| "a name".to_owned(), |name| name.into_owned()));
        if let Some(foreign) = names.find(|name| name != MANIFEST && !files.contains_key(name)) {
            return Err(damaged("the manifest does not list it").at(foreign));
        }
        drop(names);
        Ok(Self { zip, files })
    }

    /// The names of all files but the manifest.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.files.keys().map(String::as_str)
    }

    /// A file, verified once more: it is read again.
    ///
    /// # Errors
    /// Where there is none of this name, or it changed since the bundle was opened.
    pub fn file(&mut self, name: &str) -> Result<Vec<u8>, Problem> {
        let listed = self.files.get(name).ok_or_else(|| damaged("it is missing").at(name.to_owned()))?;
        let bytes = unpack(&mut self.zip, name)?;
        if sha256(&bytes) != listed.sha256 {
            return Err(damaged("it changed while it was read").at(name.to_owned()));
        }
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn bundle() -> Vec<u8> {
        let mut writer = BundleWriter::new(Cursor::new(Vec::new()));
        writer.add("a.txt", b"the same words, the same words, the same words").unwrap();
        writer.add("b/c.csv", b"t,r\r\n0.0,1.0\r\n").unwrap();
        writer.finish().unwrap().into_inner()
    }

    #[test]
    fn the_same_files_give_the_same_bytes_and_come_back() {
        let bytes = bundle();
        assert_eq!(bytes, bundle());
        assert!(is_one(Cursor::new(&bytes)));
        let mut read = Bundle::open(Cursor::new(&bytes)).unwrap_or_else(|problem| panic!("{problem:?}"));
        assert_eq!(read.names().collect::<Vec<_>>(), ["a.txt", "b/c.csv"]);
        assert_eq!(read.file("b/c.csv").unwrap(), b"t,r\r\n0.0,1.0\r\n");
    }

    #[test]
    fn any_flipped_bit_is_found() {
        let bytes = bundle();
        let mut named = 0;
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut flipped = bytes.clone();
                flipped[at] ^= 1 << bit;
                let refused = Bundle::open(Cursor::new(&flipped)).map(drop).unwrap_err();
                named += usize::from(refused.location.is_some());
            }
        }
        // All but those that make it no archive are placed.
        assert!(named > 6 * bytes.len(), "{named} of {}", 8 * bytes.len());
    }
}
