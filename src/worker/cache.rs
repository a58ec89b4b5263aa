//! Pools and trees on disk, for the next process.
//!
//! A folder of files, each named by the hash of what its content was made from, so that nothing has to be kept in step
//! with anything:
//!
//! ```text
//! magic (8 bytes)  format (4)  key (32)  content, little-endian  SHA-256 of all before (32)
//! ```
//! A file is written under another name, and renamed when it is whole; where two processes make the same one, the later
//! takes the place of the earlier, and both are right. A file that is damaged, of another format or under another's
//! name is not believed: it is passed over, made again and replaced. (A hash finds accidents, not malice: whoever may
//! write here may write to the database.) Files that were not used for longest go first when the folder has grown to
//! its limit. Without a folder that can be written to, everything works as it would without a cache.

use crate::cache::{ByteStore, Key, ReadBytes, WriteBytes};
use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

/// The first bytes of a file.
const MAGIC: &[u8; 8] = b"VOLITREE";

/// Changes with the meaning of the bytes around the content. What the content means is a matter of the key.
const FORMAT: u32 = 1;

const HEAD: u64 = 8 + 4 + 32;
const TAIL: u64 = 32;

/// How a file's name ends, and that of one which is being written.
const ENDING: &str = "kept";
const UNFINISHED: &str = "unfinished";

/// What is unfinished for so long was left by a process that died.
const GIVEN_UP: Duration = Duration::from_secs(3600);

/// Read and written at a time.
const BUFFER: usize = 1 << 20;

/// Tells backup programs to pass over the folder (<https://bford.info/cachedir/>).
const TAG: &str = "CACHEDIR.TAG";
const TAG_TEXT: &str = "Signature: 8a477f597d28d172789f06886806bc55\n\
    # Pools and trees that Volition makes again when they are gone. This folder may be deleted at any time.\n";

/// A [`ByteStore`] in a folder.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    most_bytes: u64,
    /// Whether somebody was told that nothing can be kept.
    warned: AtomicBool,
}

impl Folder {
    /// In this folder, which is made when there is something to keep, with files of at most so many bytes in all.
    #[must_use]
    pub fn new(path: impl Into<PathBuf>, most_bytes: u64) -> Self {
        Self { path: path.into(), most_bytes, warned: AtomicBool::new(false) }
    }

    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn file_of(&self, key: &Key) -> PathBuf {
        self.path.join(format!("{}-{}.{ENDING}", key.kind(), key.hexadecimal()))
    }

    /// Writes the file; what it is called, and its bytes.
    fn write(&self, key: &Key, write: &mut WriteBytes<'_>) -> io::Result<(PathBuf, u64)> {
        fs::create_dir_all(&self.path)?;
        let tag = self.path.join(TAG);
        if !tag.exists() {
            fs::write(tag, TAG_TEXT)?;
        }
        let unfinished = Unfinished::new(self.path.join(format!("{}.{UNFINISHED}", uuid::Uuid::now_v7())))?;
        let bytes = fill(&unfinished.file, key, self.most_bytes, write)?;
        let path = self.file_of(key);
        self.make_room(bytes, [&path, &unfinished.path])?;
        // Not synced: what a failure of power leaves half written is found out by its hash.
        unfinished.finish(&path)?;
        Ok((path, bytes))
    }

    /// Deletes the files that were not used for longest, until so many bytes more are within the limit. Not counted are
    /// the file that these bytes are in and the one whose place it takes.
    fn make_room(&self, bytes: u64, own: [&Path; 2]) -> io::Result<()> {
        let mut files = Vec::new();
        for entry in fs::read_dir(&self.path)? {
            let path = entry?.path();
            if own.contains(&path.as_path()) {
                continue;
            }
            let ending = path.extension().and_then(|ending| ending.to_str());
            // What is not ours is left alone; what another process deletes at this moment is gone.
            let (true, Ok(about)) = (matches!(ending, Some(ENDING | UNFINISHED)), fs::metadata(&path)) else {
                continue;
            };
            let used = about.modified().unwrap_or(SystemTime::UNIX_EPOCH);
            if ending == Some(UNFINISHED) {
                let age = SystemTime::now().duration_since(used).unwrap_or_default();
                if age > GIVEN_UP {
                    let _ = fs::remove_file(&path);
                }
            } else {
                files.push((used, path, about.len()));
            }
        }
        files.sort();
        let mut all = bytes + files.iter().map(|(_, _, bytes)| bytes).sum::<u64>();
        for (_, path, bytes) in files {
            if all <= self.most_bytes {
                break;
            }
            match fs::remove_file(&path) {
                Ok(()) => tracing::info!(file = %path.display(), bytes, "deleted from the cache, which is full"),
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
            all -= bytes;
        }
        Ok(())
    }
}

impl ByteStore for Folder {
    fn load(&self, key: &Key, read: &mut ReadBytes<'_>) -> bool {
        let begin = Instant::now();
        let path = self.file_of(key);
        let file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return false,
            Err(error) => {
                tracing::warn!(file = %path.display(), %error, "a file of the cache cannot be read; its content is \
                    made again");
                return false;
            }
        };
        match believe(&file, key, read) {
            Ok(bytes) => {
                // For whoever makes room. Where it cannot be noted, the file counts as older than it is.
                let _ = file.set_modified(SystemTime::now());
                tracing::info!(file = %path.display(), bytes, elapsed_s = begin.elapsed().as_secs_f64(), "read from \
                    the cache");
                true
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => false,
            Err(error) => {
                tracing::warn!(file = %path.display(), %error, "a file of the cache is not to be believed; its content \
                    is made again");
                false
            }
        }
    }

    fn save(&self, key: &Key, write: &mut WriteBytes<'_>) {
        let begin = Instant::now();
        match self.write(key, write) {
            Ok((path, bytes)) => {
                tracing::info!(file = %path.display(), bytes, elapsed_s = begin.elapsed().as_secs_f64(), "kept in the \
                    cache");
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => {
                if !self.warned.swap(true, Ordering::Relaxed) {
                    tracing::warn!(folder = %self.path.display(), %error, "nothing can be kept in the cache; going on \
                        without");
                }
            }
        }
    }
}

/// Writes a file, of at most so many bytes; how many it has.
fn fill(file: &File, key: &Key, most: u64, write: &mut WriteBytes<'_>) -> io::Result<u64> {
    let buffered = BufWriter::with_capacity(BUFFER, file);
    let mut to = Hashing { inner: buffered, hash: Sha256::new(), bytes: 0, most: most.saturating_sub(TAIL) };
    to.write_all(MAGIC)?;
    to.write_all(&FORMAT.to_le_bytes())?;
    to.write_all(key.sha256())?;
    write(&mut to)?;
    let tail = to.hash.clone().finalize();
    to.inner.write_all(&tail)?;
    to.inner.flush()?;
    Ok(to.bytes + TAIL)
}

/// Reads a file to its end; how many bytes it has.
fn believe(file: &File, key: &Key, read: &mut ReadBytes<'_>) -> io::Result<u64> {
    let bad = |what: &str| Err(io::Error::new(io::ErrorKind::InvalidData, what));
    let bytes = file.metadata()?.len();
    let Some(content) = bytes.checked_sub(HEAD + TAIL) else { return bad("it is too short") };
    let mut from =
        Hashing { inner: BufReader::with_capacity(BUFFER, file), hash: Sha256::new(), bytes: 0, most: bytes - TAIL };
    let mut head = [0; HEAD as usize];
    from.read_exact(&mut head)?;
    if head[..8] != *MAGIC {
        return bad("it is no file of this program");
    }
    if head[8..12] != FORMAT.to_le_bytes() {
        return bad("it is of another format");
    }
    if head[12..] != *key.sha256() {
        return bad("it is of another content");
    }
    read(&mut from, content)?;
    if from.bytes != bytes - TAIL {
        return bad("it has something left over");
    }
    let mut tail = [0; TAIL as usize];
    from.inner.read_exact(&mut tail)?;
    if tail[..] != from.hash.finalize()[..] {
        return bad("its hash is wrong");
    }
    Ok(bytes)
}

/// Hashes and counts what passes, up to a limit.
struct Hashing<T> {
    inner: T,
    hash: Sha256,
    bytes: u64,
    most: u64,
}

impl<T: Read> Read for Hashing<T> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let left = usize::try_from(self.most - self.bytes).unwrap_or(usize::MAX);
        let most = into.len().min(left);
        let read = self.inner.read(&mut into[..most])?;
        self.hash.update(&into[..read]);
        self.bytes += read as u64;
        Ok(read)
    }
}

impl<T: Write> Write for Hashing<T> {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        if from.len() as u64 > self.most.saturating_sub(self.bytes) {
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, "it is larger than the cache may be"));
        }
        let written = self.inner.write(from)?;
        self.hash.update(&from[..written]);
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

/// A file that is being written, and goes unless it is finished.
struct Unfinished {
    path: PathBuf,
    file: File,
    finished: bool,
}

impl Unfinished {
    fn new(path: PathBuf) -> io::Result<Self> {
        let file = File::options().write(true).create_new(true).open(&path)?;
        Ok(Self { path, file, finished: false })
    }

    fn finish(mut self, path: &Path) -> io::Result<()> {
        fs::rename(&self.path, path)?;
        self.finished = true;
        Ok(())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if !self.finished {
            // What stays behind goes later, as that of a process that died.
            let _ = fs::remove_file(&self.path);
        }
    }
}
