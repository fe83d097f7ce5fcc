//! `SHA256SUMS`: digests of the files of a set.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use sha2::{Digest, Sha256};

use crate::error::{Error, Mistakes};

/// Name of the file with the digests.
pub const FILE: &str = "SHA256SUMS";

/// Compares every file of a set with `SHA256SUMS`. Returns the number of files.
///
/// # Errors
/// [`Error::Set`] if a file differs, is missing or is not listed, or if `SHA256SUMS` cannot be read.
pub fn check(folder: &Path) -> Result<usize, Error> {
    let mut mistakes = Mistakes::default();
    let whole = |mistakes| Error::Set { folder: folder.display().to_string(), mistakes };
    let text = match std::fs::read_to_string(folder.join(FILE)) {
        Ok(text) => text,
        Err(error) => {
            let how = "make it by `find . -type f ! -name SHA256SUMS -printf '%P\\n' | LC_ALL=C sort | xargs sha256sum`";
            mistakes.add(FILE, "", format!("cannot be read: {error}; {how}"));
            return Err(whole(mistakes));
        }
    };
    let mut listed = BTreeMap::new();
    for (number, line) in text.lines().enumerate() {
        match line.split_once("  ") {
            Some((digest, name)) if digest.len() == 64 && digest.bytes().all(|b| b.is_ascii_hexdigit()) => {
                listed.insert(name.to_owned(), digest.to_ascii_lowercase());
            }
            _ => {
                let text = "is not a digest of 64 hexadecimal digits, two spaces and a path";
                mistakes.add(FILE, &format!("line {}", number + 1), text);
            }
        }
    }
    let mut present = Vec::new();
    files(folder, "", &mut present).unwrap_or_else(|error| {
        mistakes.add("", "", format!("the folder cannot be read: {error}"));
    });
    for name in present.iter().filter(|name| *name != FILE) {
        let Some(wanted) = listed.remove(name) else {
            mistakes.add(FILE, "", format!("does not list `{name}`"));
            continue;
        };
        match digest(&folder.join(name)) {
            Ok(found) if found == wanted => {}
            Ok(found) => {
                mistakes.add(name, "", format!("has the digest {found}, but {FILE} states {wanted}"));
            }
            Err(error) => mistakes.add(name, "", format!("cannot be read: {error}")),
        }
    }
    listed.keys().for_each(|name| mistakes.add(name, "", format!("is listed in {FILE}, but does not exist")));
    if mistakes.0.is_empty() { Ok(present.len().saturating_sub(1)) } else { Err(whole(mistakes)) }
}

/// Paths of all files below a folder, relative to it, sorted by name within each folder.
fn files(folder: &Path, prefix: &str, found: &mut Vec<String>) -> io::Result<()> {
    let mut entries = std::fs::read_dir(folder.join(prefix))?.collect::<io::Result<Vec<_>>>()?;
    entries.sort_by_key(std::fs::DirEntry::file_name);
    for entry in entries {
        let name = entry.file_name();
        let name = if prefix.is_empty() {
            name.to_string_lossy().into_owned()
        } else {
            format!("{prefix}/{}", name.to_string_lossy())
        };
        if entry.file_type()?.is_dir() {
            files(folder, &name, found)?;
        } else {
            found.push(name);
        }
    }
    Ok(())
}

/// SHA-256 of a file in hexadecimal digits.
fn digest(path: &Path) -> io::Result<String> {
    let (mut file, mut hash, mut buffer) = (File::open(path)?, Sha256::new(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut buffer)? {
            0 => break,
            n => hash.update(&buffer[..n]),
        }
    }
    Ok(hash.finalize().iter().fold(String::new(), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    }))
}
