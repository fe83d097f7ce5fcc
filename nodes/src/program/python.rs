//! Packages of an installed Python.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};

/// A Python and the code that locates a package.
type Asked = (PathBuf, &'static str);

/// The file that `locate`, the code of a Python program, prints the path of: the compiled part of a package, whose content
/// identifies its version. `None` if there is no such file. Each Python is asked once.
pub fn library_of(python: &Path, locate: &'static str) -> Option<PathBuf> {
    static KNOWN: Mutex<BTreeMap<Asked, PathBuf>> = Mutex::new(BTreeMap::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let asked = (python.to_owned(), locate);
    if let Some(library) = known.get(&asked).filter(|library| library.is_file()) {
        return Some(library.clone());
    }
    let found = Command::new(python).args(["-c", locate]).stdin(Stdio::null()).stderr(Stdio::null()).output();
    let text = String::from_utf8(found.ok()?.stdout).ok()?;
    let library = PathBuf::from(text.trim());
    library.is_file().then(|| {
        known.insert(asked, library.clone());
        library
    })
}
