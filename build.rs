//! Names the code that makes pools and trees, so that trees which other code left on disk are not taken for those of
//! this program.
#![allow(clippy::print_stdout)]

use std::path::{Path, PathBuf};

/// What pools and trees depend on.
const FOLDERS: [&str; 4] = ["src/cache", "src/control", "src/identify", "src/num"];

/// The versions of the crates that they compute with.
const LOCK: &str = "Cargo.lock";

fn main() -> std::io::Result<()> {
    let mut files = vec![PathBuf::from(LOCK)];
    println!("cargo::rerun-if-changed={LOCK}");
    for folder in FOLDERS {
        println!("cargo::rerun-if-changed={folder}");
        list(Path::new(folder), &mut files)?;
    }
    files.sort();
    // FNV-1a: it only has to tell one state of the files from another, not from what somebody makes up.
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for file in &files {
        let text = std::fs::read(file).unwrap_or_default();
        for byte in file.to_string_lossy().bytes().chain((text.len() as u64).to_le_bytes()).chain(text) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
    println!("cargo::rustc-env=VOLITION_TREES_CODE={hash:016x}");
    Ok(())
}

fn list(folder: &Path, into: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            list(&path, into)?;
        } else {
            into.push(path);
        }
    }
    Ok(())
}
