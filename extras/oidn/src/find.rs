//! Search for the library.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// The file that a program loads. It depends on the file with the code and the weights, whose name has the full
/// version.
const FILE: &str = "libOpenImageDenoise.so.2";
const CORE: &[u8] = b"libOpenImageDenoise_core.so.";
/// Environment variable with the folder of the library, if it is not one of the usual ones.
const FOLDER: &str = "LIGHTHARMONY_OIDN";
/// Usual folders of shared libraries: for libraries built by an administrator, and those of Debian, Fedora and
/// Arch.
const USUAL: [&str; 5] =
    ["/usr/local/lib", "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib"];

/// The library on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Path of the file. It contains the version, so its bytes differ between versions.
    pub path: PathBuf,
    /// Version, such as `2.3.3`.
    pub version: String,
}

/// The error if no folder contains the library.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("Open Image Denoise 2 is not installed: `{FILE}` was not found in {}{}", listed(.looked), but(.others))]
pub struct Missing {
    /// The searched folders, in order.
    pub looked: Vec<PathBuf>,
    /// Files with the name of the library that are another version or not the library.
    pub others: Vec<PathBuf>,
}

impl Missing {
    /// The remedy in the error message.
    pub const HINT: &str =
        "install it (https://www.openimagedenoise.org), or set LIGHTHARMONY_OIDN to the folder that holds it";
}

fn listed(folders: &[PathBuf]) -> String {
    folders.iter().map(|folder| format!("`{}`", folder.display())).collect::<Vec<_>>().join(", ")
}

fn but(others: &[PathBuf]) -> String {
    if others.is_empty() {
        String::new()
    } else {
        format!(" of version 2; other versions: {}", listed(others))
    }
}

/// Looks for the library in the folder that `LIGHTHARMONY_OIDN` names; where that is not set, in those of
/// `LD_LIBRARY_PATH` and the usual ones. A graph cannot name it, because loading a library runs its code.
///
/// # Errors
/// If none of them holds a file of the library's name with a version.
pub fn find() -> Result<Found, Missing> {
    find_in(folders(std::env::var_os(FOLDER), std::env::var_os("LD_LIBRARY_PATH")))
}

fn folders(named: Option<OsString>, linked: Option<OsString>) -> Vec<PathBuf> {
    if let Some(folder) = named.filter(|folder| !folder.is_empty()) {
        return vec![folder.into()];
    }
    let linked = linked.unwrap_or_default();
    // An empty entry is the current folder, which holds no library of ours.
    let linked = std::env::split_paths(&linked).filter(|folder| folder.is_absolute());
    linked.chain(USUAL.map(PathBuf::from)).collect()
}

fn find_in(looked: Vec<PathBuf>) -> Result<Found, Missing> {
    let found = |folder: &PathBuf| {
        let path = folder.join(FILE);
        version_of(&path).map(|version| Found { path, version })
    };
    looked.iter().find_map(found).ok_or_else(|| {
        let others = looked.iter().map(|folder| folder.join(FILE)).filter(|path| path.exists()).collect();
        Missing { looked, others }
    })
}

/// The version of the core library that the file at `path` depends on.
fn version_of(path: &Path) -> Option<String> {
    let bytes = std::fs::read(path).ok()?;
    let start = bytes.windows(CORE.len()).position(|window| window == CORE)? + CORE.len();
    let digits = bytes[start..].iter().take_while(|byte| byte.is_ascii_digit() || **byte == b'.');
    let version: String = digits.map(|byte| char::from(*byte)).collect();
    version.starts_with("2.").then_some(version)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(name: &str, bytes: &[u8]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join(name), bytes).expect("is written");
        folder
    }

    // Mutation: `starts_with("2.")` left out of `version_of`.
    #[test]
    fn the_first_folder_that_holds_version_2_is_taken() {
        let empty = tempfile::tempdir().expect("a folder");
        let old = place(FILE, b"\x7fELF\0libOpenImageDenoise_core.so.1.4.3\0");
        let other = place(FILE, b"something else");
        let good = place(FILE, b"\x7fELF\0libOpenImageDenoise_core.so.2.3.3\0libm.so.6\0");
        let paths = |of: &[&tempfile::TempDir]| of.iter().map(|d| d.path().to_owned()).collect::<Vec<_>>();
        let found = find_in(paths(&[&empty, &old, &other, &good])).expect("is there");
        assert_eq!(found, Found { path: good.path().join(FILE), version: "2.3.3".to_owned() });
        let missing = find_in(paths(&[&empty, &old])).expect_err("is not there");
        assert_eq!(missing.looked, paths(&[&empty, &old]));
        let text = missing.to_string();
        assert!(text.contains(FILE) && text.contains(&empty.path().display().to_string()), "{text}");
        assert!(
            text.ends_with(&format!(" of version 2; other versions: `{}`", old.path().join(FILE).display())),
            "{text}"
        );
    }

    #[test]
    fn a_folder_that_is_named_is_the_only_one() {
        let os = |text: &str| Some(OsString::from(text));
        assert_eq!(folders(os("/opt/oidn/lib"), os("/a:/b")), [PathBuf::from("/opt/oidn/lib")]);
        let usual = USUAL.map(PathBuf::from).to_vec();
        assert_eq!(
            folders(None, os("/a::here:/b")),
            [vec!["/a".into(), "/b".into()], usual.clone()].concat()
        );
        assert_eq!(folders(os(""), None), usual);
    }
}
